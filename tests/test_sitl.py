"""How flights end that do not end well: a companion that breaks or never answers, Ctrl-C, a plant that fails."""

import json
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest

import companion.__main__
import sim_bridge.__main__
from companion.config import CompanionConfig, ConfigError, load
from companion.messages import Phase, PhaseChange, RelativeState
from sim_bridge import sitl
from sim_bridge.datalink import PtyLink
from sim_bridge.faults import parse_fault
from sim_bridge.flight import Flown, fly
from sim_bridge.scenario import load_scenario
from sim_bridge.scoring import score
from sim_bridge.sitl import fly_sitl, recorded_phases

SLEEPS = "import time; time.sleep(60)"


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture
def flight(tmp_path):
    """Scenario and setup on wires of their own, recorded in a folder of their own."""
    scenario = load_scenario("thesis")
    setup, replace = scenario.setup(), msgspec.structs.replace
    config = setup.config
    links = replace(config.links, mavlink=f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
                    datalink=f"{tmp_path}/tanker,19600", camera=f"tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}")
    config = replace(config, links=links, recorder=replace(config.recorder, out=str(tmp_path / "runs")))
    return scenario, replace(setup, config=config)


@pytest.fixture
def program(monkeypatch):
    """Let another program be the companion."""

    def use(code):
        monkeypatch.setattr(sitl, "companion_command", lambda *_: [sys.executable, "-c", code])

    return use


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("raise SystemExit(1)", "the companion ended with code 1; its message is above"),
        ("import os; os.kill(os.getpid(), 9)", "the companion ended with code -9; its message is above"),
        ("import os; os.kill(os.getpid(), 15)", "the companion ended with code -15; its message is above"),
        ("raise SystemExit(2)", "the companion did not start; its message is above"),
    ],
)
def test_a_companion_that_breaks_is_no_flight_that_did_not_dock(flight, program, code, words):
    program(code)
    with pytest.raises(ConfigError) as refused:
        fly_sitl(*flight)
    assert str(refused.value) == words


def test_a_companion_that_never_answers_is_given_up_and_stopped(flight, program, monkeypatch):
    program(SLEEPS)
    monkeypatch.setattr(sitl, "START_S", 0.2)
    with pytest.raises(ConfigError, match="has not answered within 0 s; is udpin:"):
        fly_sitl(*flight)


def test_a_companion_that_ends_before_it_records_did_not_dock(flight, program):
    program("pass")
    flown = fly_sitl(*flight)
    assert recorded_phases(flown.folder) == []
    assert not flown.summary["docked"]
    assert json.loads((flown.folder / "summary.json").read_text()) == flown.summary


PARENT = """
import sys
import time
from sim_bridge.sitl import CompanionProcess

CompanionProcess(sys.argv[1:]).start()
time.sleep(600)
"""


def test_a_companion_does_not_outlive_a_simulator_that_is_killed(flight, tmp_path):
    """It stops by itself, as if it had been asked to: its recording is whole."""
    scenario, setup = flight
    folder = tmp_path / "run"
    command = sitl.companion_command(scenario, setup, folder, 0)
    with (closing(PtyLink(19600, tmp_path / "tanker")),
          subprocess.Popen([sys.executable, "-c", PARENT, *command]) as parent):
        wait_for(lambda: (folder / "events.jsonl").exists() and (folder / "events.jsonl").stat().st_size > 0)
        parent.kill()
    wait_for((folder / "summary.json").exists)
    assert json.loads((folder / "summary.json").read_text())["phase"] == "standby"


def wait_for(what):
    end_s = time.monotonic() + 60.0
    while not what():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def test_the_companion_flies_what_the_command_line_says(flight, tmp_path):
    """Whatever both commands let people choose reaches the companion's process."""
    scenario, setup = flight
    given = ["--law", "velocity", "--fusion", "blend", "--pose", "glsdc", "--detector", "corners",
             "--labeling", "mutual_nearest", "--vision", "sv"]
    scenario, asked = sim_bridge.__main__.load(sim_bridge.__main__.parser().parse_args(["sitl", "thesis", *given]))
    command = sitl.companion_command(scenario, asked, tmp_path, 0)
    arguments = companion.__main__.parser().parse_args(command[3:])
    got = companion.__main__._with_options(load(Path(scenario.companion), CompanionConfig), arguments)
    assert got == asked.config
    assert got != setup.config


BREAKS_AWAY = """
import json
import pathlib
import socket
import sys
import time

folder, port = pathlib.Path(sys.argv[1]), int(sys.argv[2])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
    s.bind(("127.0.0.1", port))
    _, simulator = s.recvfrom(1024)
    s.sendto(b"here", simulator)
    time.sleep(2.0)
change = {"kind": "PhaseChange", "t_ns": time.monotonic_ns(), "old": "hold", "new": "breakaway", "reason": "sight lost"}
(folder / "events.jsonl").write_text(json.dumps(change) + chr(10))
"""


def test_on_the_wall_clock_too_a_breakaway_counts_from_its_fault(flight, monkeypatch):
    """The companion breaks away 2 s after the first call; the fault comes 0.2 s into the flight, which is later."""
    scenario, setup = flight
    scenario = msgspec.structs.replace(scenario, faults=(parse_fault("camera.off@0.2"),))
    port = setup.config.links.mavlink.rpartition(":")[2]
    monkeypatch.setattr(sitl, "companion_command",
                        lambda scenario, setup, folder, t0_ns: [sys.executable, "-c", BREAKS_AWAY, str(folder), port])
    summary = fly_sitl(scenario, setup).summary
    assert summary["faults"] == ["camera.off@0.2"]
    assert 0.0 < summary["breakaway_delay_s"] <= 1.9


def test_ctrl_c_in_sitl_leaves_a_summary(flight, program, monkeypatch):
    def interrupted(transport, stop):
        raise KeyboardInterrupt

    program(SLEEPS)
    monkeypatch.setattr("sim_bridge.serve.wait_for_companion", interrupted)
    flown = fly_sitl(*flight)
    assert flown.summary["interrupted"]
    assert {f.name for f in flown.folder.iterdir()} == {"summary.json", "truth.npz", "truth.rrd"}


def test_ctrl_c_in_lockstep_leaves_a_whole_recording(flight):
    def watch(output):
        if isinstance(output, RelativeState) and output.t_ns > 1_000_000_000:
            raise KeyboardInterrupt

    flown = fly(*flight, watch)
    written = json.loads((flown.folder / "summary.json").read_text())
    assert (written["interrupted"], written["docked"], written["plant_failure"]) == (True, False, None)
    assert 1.0 <= written["flown_s"] < 2.0
    assert len(np.load(flown.folder / "truth.npz")["t_ns"]) >= 50


@pytest.mark.parametrize(
    ("docked", "plant_failure", "interrupted", "code"),
    [(True, None, False, 0), (False, None, False, 3), (False, "NaN", False, 1), (True, "NaN", False, 1),
     (False, None, True, 130)],
)
def test_exit_code_says_how_it_ended(flight, tmp_path, capsys, docked, plant_failure, interrupted, code):
    scenario, setup = flight
    nothing = score((np.empty(0, dtype=np.int64), np.empty((0, 3))),
                    [PhaseChange(0, Phase.STANDBY, Phase.JOIN, "")], setup.tanker.window, scenario)
    summary = {**nothing, "docked": docked, "plant_failure": plant_failure, "interrupted": interrupted,
               "latency_ms": {}, "rejects": {}}
    assert sim_bridge.__main__._told(Flown(tmp_path, summary), setup) == code
    assert ("plant failed: NaN" in capsys.readouterr().err) == (code == 1)
