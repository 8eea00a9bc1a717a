"""Bad input on the command lines: one line on stderr that names culprit and remedy, exit code 2, nothing written."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import zmq

import companion.__main__
import sim_bridge.__main__
from companion.config import FIRMWARE_CONFIGS
from sim_bridge.scenario import SCENARIOS

SITL = FIRMWARE_CONFIGS / "sitl" / "thesis.toml"
PROGRAMS = {"companion": companion.__main__.main, "sim_bridge": sim_bridge.__main__.main}


@pytest.fixture(autouse=True)
def handlers():
    """The programs take signals over; give them back."""
    kept = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def companion_toml(folder, extra="", **files):
    """Write a companion TOML that names the shipped files, or others."""
    named = {k: FIRMWARE_CONFIGS / f"{k}s" / f"{v}.toml" for k, v in
             {"camera": "thesis", "tanker": "kc135r", "airframe": "ice101"}.items()} | files
    path = folder / "companion.toml"
    path.write_text("".join(f'{k} = "{v}"\n' for k, v in named.items()) + extra, encoding="utf-8")
    return str(path)


def scenario_toml(folder, extra="", companion=SITL):
    path = folder / "flight.toml"
    path.write_text(f'name = "flight"\ncompanion = "{companion}"\n{extra}', encoding="utf-8")
    return str(path)


def one_line(text):
    """Return the only line of ``text``."""
    assert "Traceback" not in text
    assert text.endswith("\n")
    assert text.count("\n") == 1
    return text.rstrip()


def refusal(capfd, program, *arguments):
    """Run a program's ``main`` here; return its one line on stderr."""
    try:
        code = PROGRAMS[program]([str(a) for a in arguments])
    except SystemExit as left:  # what argparse does
        code = left.code
    out, err = capfd.readouterr()
    assert code == 2
    assert out == ""
    return one_line(err)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[guidance]\nrate_hertz = 50.0\n", "unknown key 'guidance.rate_hertz'; did you mean 'rate_hz'?"),
        ('[guidance]\npath_duration_s = "50"\n', "guidance.path_duration_s: Expected `float`, got `str` (seconds)"),
        ("[guidance]\nmax_roll_rad = 20.0\n", "max_roll_rad"),
        ("[guidance]\nestimate_stale_s = 300.0\n", "estimate_stale_s"),
        ("[fusion]\nd1_m = 10.0\n", "d1_m must be larger than d2_m, both in metres"),
        ("[links]\nmavlink = 14540\n", "links.mavlink: Expected `str`, got `int`"),
        ("[links]\nsystem_id = 300\n", "ids must be in 1..255"),
        ("[vision]\nsolver = \"epnp\"\n", "vision.solver"),
        ("[fusion]\nd1_m = nan\n", "fusion.d1_m is not a finite number"),
        ("[recorder]\njpeg_quality = 500\n", "recorder.jpeg_quality"),
        ("[[[\n", "not valid TOML"),
    ],
)
def test_configuration_that_cannot_be(tmp_path, capfd, text, words):
    path = companion_toml(tmp_path, text)
    line = refusal(capfd, "companion", "run", path)
    assert line.startswith(f"companion: {path}: ")
    assert words in line


@pytest.mark.parametrize("kind", ["camera", "tanker", "airframe"])
def test_file_named_in_the_configuration_that_is_missing(tmp_path, capfd, kind):
    path = companion_toml(tmp_path, **{kind: "nowhere.toml"})
    assert refusal(capfd, "companion", "run", path) == f"companion: {tmp_path}/nowhere.toml: no such file"


def test_missing_configuration(tmp_path, capfd):
    line = refusal(capfd, "companion", "run", tmp_path / "none.toml")
    assert line == f"companion: {tmp_path}/none.toml: no such file"


def test_missing_reference(tmp_path, capfd):
    path = tmp_path / "c.toml"
    path.write_text('tanker = "t.toml"\nairframe = "a.toml"\n', encoding="utf-8")
    assert "missing required field `camera`" in refusal(capfd, "companion", "run", path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--mavlink", "udp:127.0.0.1:1"], "not udpin:HOST:PORT"),
        (["--mavlink", "udpin:127.0.0.1:99999"], "not udpin:HOST:PORT"),
        (["--mavlink", "udpin:0.0.0.0:1", "--camera", "usb:0"], "camera 'usb:0': unknown source; use tcp://HOST:PORT"),
        (["--datalink", "/dev/nowhere,19600"], "datalink /dev/nowhere: no such device"),
        (["--datalink", "/dev/nowhere"], "not DEVICE,BAUD"),
        (["--datalink", "/dev/null,19600"], "datalink /dev/null: not a usable serial device"),
        (["--datalink", "", "--camera", "tcp://127.0.0.1"], "not tcp://HOST:PORT"),
        (["--pose", "epnp"], "invalid choice: 'epnp'"),
        (["--stop-after-hold", "soon"], "invalid seconds value: 'soon'"),
        (["--nonsense"], "unrecognized arguments: --nonsense"),
    ],
)
def test_options_of_companion_run(tmp_path, capfd, options, words):
    defaults = ["--mavlink", "udpin:127.0.0.1:0", "--datalink", "", "--camera", "", "--out", str(tmp_path / "runs")]
    line = refusal(capfd, "companion", "run", companion_toml(tmp_path), *defaults, *options)
    assert words in line
    assert not (tmp_path / "runs").exists()  # no empty recording for `view` to find


@pytest.mark.parametrize("out", ["file", "file/below", "/proc/none"])
@pytest.mark.parametrize("program", ["companion", "sim_bridge"])
def test_folder_for_recordings_that_cannot_be(tmp_path, capfd, program, out):
    (tmp_path / "file").write_text("")
    out = tmp_path / out
    quiet = ["--mavlink", "udpin:127.0.0.1:0", "--datalink", "", "--camera", ""]
    what = ["run", companion_toml(tmp_path), *quiet] if program == "companion" else ["fly", "thesis"]
    line = refusal(capfd, program, *what, "--out", out)
    assert str(out) in line
    assert "with --out" in line


@pytest.mark.parametrize("command", ["fly", "sitl", "serve"])
def test_unknown_scenario_names_the_shipped_ones(capfd, command):
    shipped = ", ".join(sorted(file.stem for file in SCENARIOS.glob("*.toml")))
    line = refusal(capfd, "sim_bridge", command, "dokcing")
    assert line.startswith("sim-bridge: dokcing: no such scenario; did you mean 'docking'?")
    assert shipped in line


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--seed", "-1"], "--seed -1: must not be negative"),
        (["--seed", "x"], "invalid int value: 'x'"),
        (["--law", "pid"], "invalid choice: 'pid'"),
        (["--fusion", "ekf"], "invalid choice: 'ekf'"),
        (["--seed", "1", "2"], "unrecognized arguments"),
    ],
)
def test_options_of_sim_bridge_fly(capfd, options, words):
    assert words in refusal(capfd, "sim_bridge", "fly", "thesis", *options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hold_s = \"60\"\n", "hold_s: Expected `float`, got `str` (seconds)"),
        ("heading_rad = 90.0\n", "heading_rad: not within one turn (radians, not degrees)"),
        ("start_tanker_m = [0.0, 0.0, 5.0]\n", "metres is inside the tanker"),
        ("turbulenze = \"light\"\n", "unknown key 'turbulenze'; did you mean 'turbulence'?"),
    ],
)
def test_scenario_that_cannot_be(tmp_path, capfd, text, words):
    path = scenario_toml(tmp_path, text)
    line = refusal(capfd, "sim_bridge", "fly", path)
    assert line.startswith(f"sim-bridge: {path}: ")
    assert words in line


def test_a_scenario_with_a_bad_companion_names_the_companion_file(tmp_path, capfd):
    bad = companion_toml(tmp_path, "[guidence]\n")
    assert f"sim-bridge: {bad}: unknown key 'guidence'" in refusal(
        capfd, "sim_bridge", "fly", scenario_toml(tmp_path, companion=bad))


def test_busy_camera_port(tmp_path, capfd):
    link = tmp_path / "tanker"
    link.symlink_to("/dev/null")
    with zmq.Context() as context, context.socket(zmq.PUB) as other:
        port = other.bind_to_random_port("tcp://127.0.0.1")
        line = refusal(capfd, "sim_bridge", "serve", "thesis", "--camera", f"tcp://127.0.0.1:{port}",
                       "--datalink", link)
    assert link.readlink() == Path("/dev/null")  # the line of a simulator that runs is left alone
    assert f"camera 'tcp://127.0.0.1:{port}': the port is in use" in line


def test_busy_wire_leaves_no_empty_recording_of_sitl(tmp_path, capfd):
    with zmq.Context() as context, context.socket(zmq.PUB) as other:
        port = other.bind_to_random_port("tcp://127.0.0.1")
        links = f'[links]\nmavlink = "udpin:127.0.0.1:9"\ncamera = "tcp://127.0.0.1:{port}"\n'
        scenario = scenario_toml(tmp_path, companion=companion_toml(tmp_path, links))
        assert "the port is in use" in refusal(capfd, "sim_bridge", "sitl", scenario, "--out", tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_name_of_the_pty_that_is_taken(tmp_path, capfd):
    (tmp_path / "tanker").write_text("")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        camera = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    assert "exists and is no link; remove it" in refusal(
        capfd, "sim_bridge", "serve", "thesis", "--camera", camera, "--datalink", tmp_path / "tanker")


def test_serve_calls_and_does_not_listen(capfd):
    line = refusal(capfd, "sim_bridge", "serve", "thesis", "--mavlink", "udpout:127.0.0.1:14540")
    assert "use udpin:HOST:PORT" in line


@pytest.mark.parametrize("run", ["nowhere", "."])
def test_nothing_to_view(tmp_path, capfd, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    assert "no flight.rrd in it" in refusal(capfd, "companion", "view", run)
    assert "no recording here" in refusal(capfd, "companion", "view")


def in_a_process(*arguments):
    environment = {**os.environ, "PYTHONWARNINGS": "error"}
    return subprocess.Popen([sys.executable, "-m", *map(str, arguments)], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, env=environment)


def test_real_processes_say_the_same(tmp_path):
    """A busy port and an unknown scenario, as their users meet them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        busy = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        toml = companion_toml(tmp_path)
        processes = {
            f"companion: mavlink '{busy}': the port is in use; stop the other program or choose another with --mavlink":
                in_a_process("companion", "run", toml, "--mavlink", busy, "--out", tmp_path / "runs"),
            "sim-bridge: dokcing: no such scenario": in_a_process("sim_bridge", "fly", "dokcing"),
        }
        for words, process in processes.items():
            out, err = process.communicate(timeout=60)
            assert process.returncode == 2, err
            assert out == ""
            assert one_line(err).startswith(words)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("program", ["companion", "sim_bridge"])
def test_corners_of_a_tanker_that_has_none(capfd, tmp_path, program):
    whole = (FIRMWARE_CONFIGS / "tankers" / "kc135r.toml").read_text(encoding="utf-8")
    bare = tmp_path / "bare.toml"
    bare.write_text(whole.partition("[[corners]]")[0], encoding="utf-8")
    config = companion_toml(tmp_path, tanker=bare)
    arguments = ("run", config) if program == "companion" else ("fly", scenario_toml(tmp_path, companion=config))
    line = refusal(capfd, program, *arguments, "--detector", "corners")
    assert "bare.toml" in line
    assert "the tanker has 0 corners" in line
