"""Real processes: help everywhere, a companion that waits, is stopped and is killed; a docking on the wall clock."""

import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest
from pymavlink.dialects.v20 import ardupilotmega

import companion.__main__
import sim_bridge.__main__
from companion.config import FIRMWARE_CONFIGS
from companion.io.recorder import read_records
from sim_bridge.datalink import PtyLink

DIRECT = 'auto_engage = true\nprocedure = "direct"\npath_duration_s = 10.0\n'
WHOLE_FOLDER = {"summary.json", "flight.rrd", "telemetry.tlog", "events.jsonl", "config.toml", "versions.json"}
SUMMARY = {
    "phases", "health", "integrity", "filter", "input_latency",
    "docked", "hold_s", "in_window_fraction", "br_mean_m", "br_sigma_m", "br_max_m", "time_to_window_s", "latency_ms",
    "frames", "frames_with_pose", "rejects", "seed", "scenario", "law", "pose_solver", "fusion", "breakaway",
}


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def companion_toml(folder, guidance="auto_engage = true\n"):
    """Write a companion TOML on ports of its own, so that it runs beside others."""
    path = folder / "companion.toml"
    named = {"camera": "cameras/thesis", "tanker": "tankers/kc135r", "airframe": "airframes/ice101"}
    path.write_text(
        "".join(f'{k} = "{FIRMWARE_CONFIGS / v}.toml"\n' for k, v in named.items())
        + f'[links]\nmavlink = "udpin:127.0.0.1:{free_port()}"\ndatalink = "{folder}/tanker,19600"\n'
        + f'camera = "tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}"\n'
        + f'[recorder]\nout = "{folder}/runs"\n[guidance]\n{guidance}',
        encoding="utf-8",
    )
    return path


def start(*arguments, cwd=None):
    command = [sys.executable, "-m", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=cwd)


def read_until(stream, words, seconds):
    """Return what a process has said once it has said ``words``."""
    said, until = b"", time.monotonic() + seconds
    while words not in said:
        left = until - time.monotonic()
        assert left > 0, said.decode()
        if select.select([stream], [], [], left)[0]:
            data = os.read(stream.fileno(), 65536)
            assert data, said.decode()
            said += data
    return said.decode()


def run_folder(folder):
    [run] = (folder / "runs").iterdir()
    return run


@pytest.mark.parametrize("program", [companion.__main__, sim_bridge.__main__])
def test_help_everywhere(capsys, program):
    commands = next(a.choices for a in program.parser()._actions if isinstance(a.choices, dict))
    assert len(commands) >= 2
    for arguments in (["--help"], *([c, "--help"] for c in commands)):
        with pytest.raises(SystemExit) as left:
            program.main(arguments)
        assert left.value.code == 0
        assert "usage:" in capsys.readouterr().out


def test_a_companion_alone_says_what_is_silent_waits_and_ends_when_asked(tmp_path):
    """Wires are there and silent; Ctrl-C and SIGTERM end it alike. Two at once, since each waits for 3 s."""
    folders = {number: tmp_path / number.name for number in (signal.SIGINT, signal.SIGTERM)}
    with ExitStack() as stack:
        running = {}
        for number, folder in folders.items():
            folder.mkdir()
            stack.callback(PtyLink(19600, folder / "tanker").close)
            running[number] = stack.enter_context(start("companion", "run", companion_toml(folder)))
            stack.callback(running[number].kill)
        for number, process in running.items():
            ends_when_asked(process, folders[number], number)


def ends_when_asked(process, folder, number):
    said = read_until(process.stderr, b"camera: nothing for 3 s at tcp://127.0.0.1:", 60)
    assert f"datalink: nothing for 3 s at {folder}/tanker,19600: does the tanker" in said
    assert "mavlink: nothing for 3 s at udpin:127.0.0.1:" in said
    assert process.poll() is None
    process.send_signal(number)
    assert process.wait(20) == 0
    run = run_folder(folder)
    assert {f.name for f in run.iterdir()} == WHOLE_FOLDER
    summary = json.loads((run / "summary.json").read_text())
    assert summary["rejects"] == {"camera.silent": 1, "datalink.silent": 1, "mavlink.silent": 1}
    assert (summary["phase"], summary["setpoints"]) == ("standby", 0)
    assert "Traceback" not in said + process.stderr.read().decode()


def tlog_frames(data):
    """Return instants in us and messages of a tlog, as far as it is whole."""
    parser, found, at = ardupilotmega.MAVLink(None), [], 0
    while at + 18 <= len(data):
        size = 10 + data[at + 9] + 2
        if at + 8 + size > len(data):
            break
        (t_us,) = struct.unpack(">Q", data[at : at + 8])
        found.append((t_us, parser.parse_char(data[at + 8 : at + 8 + size])))
        at += 8 + size
    return found


def serve_and_run(folder):
    """Start a simulator and a companion on free wires; return both."""
    toml = companion_toml(folder)
    (folder / "flight.toml").write_text(f'name = "flight"\ncompanion = "{toml}"\n', encoding="utf-8")
    server = start("sim_bridge", "serve", folder / "flight.toml")
    read_until(server.stdout, b"calling a companion", 60)
    return server, start("companion", "run", toml)


def test_a_killed_companion_leaves_what_it_knew_and_the_simulator_ends_when_asked(tmp_path):
    server, service = serve_and_run(tmp_path)
    try:
        read_until(service.stderr, b"| join", 60)
        time.sleep(1.0)
        killed_ns = time.monotonic_ns()
        service.kill()
        service.wait()
        server.send_signal(signal.SIGTERM)
        assert server.wait(20) == 0
    finally:
        for process in (service, server):
            process.kill()
            process.wait()
    run = run_folder(tmp_path)
    records = list(read_records(run / "events.jsonl"))
    frames = tlog_frames((run / "telemetry.tlog").read_bytes())
    kinds = {"OwnAttitude", "TankerState", "CameraFrame", "RelativeState", "AttitudeSetpoint"}
    assert kinds <= {r["kind"] for r in records}
    newest_ns = max(r["t_ns"] for r in records)
    assert 0 < killed_ns - newest_ns < 700_000_000  # flushed every 0.2 s, on a machine that is shared
    assert {m.get_type() for _, m in frames} >= {"ATTITUDE_QUATERNION", "SET_ATTITUDE_TARGET", "HEARTBEAT"}
    assert 0 < killed_ns - frames[-1][0] * 1000 < 700_000_000
    assert "Traceback" not in (server.stderr.read() + service.stderr.read()).decode()
    for process in (server, service):
        process.stdout.close()
        process.stderr.close()


@pytest.mark.slow
def test_stopping_sitl_leaves_no_companion_behind(tmp_path):
    toml = companion_toml(tmp_path)
    (tmp_path / "flight.toml").write_text(f'name = "flight"\ncompanion = "{toml}"\n', encoding="utf-8")
    sitl = start("sim_bridge", "sitl", tmp_path / "flight.toml")
    try:
        read_until(sitl.stderr, b"| join", 60)
        sitl.send_signal(signal.SIGTERM)
        assert sitl.wait(30) == 130
    finally:
        sitl.kill()
    out, err = sitl.communicate()  # ends only when the companion, which shares the pipe, has ended too
    assert b"Traceback" not in out + err
    summary = json.loads((run_folder(tmp_path) / "summary.json").read_text())
    assert (summary["interrupted"], summary["docked"]) == (True, False)
    assert summary["setpoints"] > 0  # the companion's own part is in it


@pytest.mark.slow
def test_sitl_docks_on_the_wall_clock(tmp_path):
    """The thesis' camera from 5 m behind the box: two processes, UDP, a pty and a frame socket."""
    toml = companion_toml(tmp_path, DIRECT)
    scenario = tmp_path / "thesis-near.toml"
    scenario.write_text(
        f'name = "thesis-near"\ncompanion = "{toml}"\nstart_tanker_m = [-33.0, -2.0, 12.0]\nseed = 230\nhold_s = 8.0\n'
        "timeout_s = 90.0\n", encoding="utf-8")
    process = start("sim_bridge", "sitl", scenario)
    out, err = process.communicate(timeout=150)
    assert process.returncode == 0, (out + err).decode()
    assert b"docked" in out
    run = run_folder(tmp_path)
    assert {f.name for f in run.iterdir()} >= WHOLE_FOLDER
    summary = json.loads((run / "summary.json").read_text())
    assert set(summary) >= SUMMARY
    assert summary["docked"]
    assert summary["hold_s"] == pytest.approx(8.0, abs=0.1)
    assert summary["in_window_fraction"] >= 0.95
    assert (summary["seed"], summary["scenario"], summary["breakaway"]) == (230, "thesis-near", None)
    assert summary["frames_with_pose"] > 0.9 * summary["frames"] > 100
    assert 20.0 <= summary["latency_ms"]["transport"]["p50"] < 25.0  # the camera's 20 ms, a step, two sockets
    assert summary["latency_ms"]["exposure_to_setpoint"]["p50"] < 100.0


@pytest.mark.slow
def test_lockstep_by_command_writes_the_same_summary(tmp_path):
    toml = companion_toml(tmp_path, DIRECT)
    scenario = tmp_path / "flight.toml"
    scenario.write_text(
        f'name = "flight"\ncompanion = "{toml}"\nstart_tanker_m = [-33.0, -2.0, 12.0]\nhold_s = 5.0\n', encoding="utf-8"
    )
    chosen = ("--seed", "231", "--pose", "glsdc", "--labeling", "mutual_nearest")
    process = start("sim_bridge", "fly", scenario, *chosen, "--out", tmp_path / "other")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, (out + err).decode()
    [run] = (tmp_path / "other").iterdir()
    summary = json.loads((run / "summary.json").read_text())
    assert set(summary) >= SUMMARY
    assert (summary["seed"], summary["pose_solver"], summary["labeling"], summary["docked"]) == (
        231, "glsdc", "mutual_nearest", True)


@pytest.mark.slow
def test_a_flight_that_does_not_dock_in_time_ends_with_3(tmp_path):
    toml = companion_toml(tmp_path, "auto_engage = false\n")
    scenario = tmp_path / "flight.toml"
    scenario.write_text(f'name = "flight"\ncompanion = "{toml}"\nhold_s = 1.0\ntimeout_s = 3.0\n', encoding="utf-8")
    process = start("sim_bridge", "fly", scenario)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 3, (out + err).decode()
    assert b"not docked" in out


def test_warm_up_by_command():
    call = [sys.executable, "-m", "companion", "warm-up", str(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
