"""``companion command`` against a real link on the loopback."""

import math
import socket
import subprocess
import sys
import threading
import time

import pytest

from companion.config import FIRMWARE_CONFIGS, ConfigError, LinksConfig
from companion.guidance.modes import OBEYED
from companion.io.clock import SimulatedClock
from companion.io.mavlink import AutopilotLink, MavlinkUdp, dialect
from companion.io.mavlink_codec import MavlinkCodec
from companion.io.operator import GCS_COMPONENT_ID, Operator, send_command
from companion.io.telemetry import COMMANDS
from companion.messages import Command, OperatorCommand, Phase
from sim_bridge.operator import ScheduledOperator
from sim_bridge.scenario import TimedCommand

LINKS = LinksConfig()


@pytest.fixture
def listening():
    """Return the port of a companion's link, and what it has heard; its loop runs in a thread."""
    clock, heard, stop = SimulatedClock(), [], threading.Event()
    clock.set_ns(1_000_000_000)
    link = MavlinkUdp(LinksConfig(mavlink="udpin:127.0.0.1:0"), clock)
    port = link._transport.local[1]

    def loop():
        while not stop.wait(0.002):
            heard.extend(link.poll())

    thread = threading.Thread(target=loop)
    thread.start()
    yield port, heard
    stop.set()
    thread.join()
    link.close()


@pytest.mark.parametrize("command", list(Command))
def test_a_command_arrives_and_is_answered(listening, command):
    """By a companion in standby."""
    port, heard = listening
    useful = Phase.STANDBY in OBEYED.get(command, set(Phase))
    answer = "accepted" if useful else "refused, the present phase has no use for it"
    assert send_command(f"udpout:127.0.0.1:{port}", command, LinksConfig()) == answer
    assert {e.command for e in heard if isinstance(e, OperatorCommand)} == ({command} if useful else set())


def test_a_stranger_is_denied(listening):
    port, heard = listening
    assert send_command(f"udpout:127.0.0.1:{port}", Command.ENGAGE, LinksConfig(gcs_system_id=77)) == "denied"
    assert not [e for e in heard if isinstance(e, OperatorCommand)]


def test_nobody_there_is_one_line():
    with pytest.raises(ConfigError, match="no answer to engage; is a companion running"):
        send_command("udpout:127.0.0.1:9", Command.ENGAGE, LinksConfig())


@pytest.mark.parametrize(("name", "code", "answer"), [
    ("simulated_vision", 0, "accepted"), ("contact", 1, "refused, the present phase has no use for it")])
def test_the_command_line_speaks(listening, name, code, answer):
    port, heard = listening
    call = [sys.executable, "-m", "companion", "command", name, "--mavlink", f"udpout:127.0.0.1:{port}"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, f"{name}: {answer}\n", "")
    assert {e.command for e in heard if isinstance(e, OperatorCommand)} == (set() if code else {Command(name)})


def told(number, *parameters, kind="long", phase=Phase.STANDBY):
    """Return what the link makes of a command, and what it answers."""
    codec, link = MavlinkCodec(LINKS.gcs_system_id, GCS_COMPONENT_ID), AutopilotLink(LINKS)
    link.phase(phase)
    target = (LINKS.system_id, LINKS.component_id)
    p = (*parameters, *[0.0] * (7 - len(parameters)))
    if kind == "long":
        message = dialect.MAVLink_command_long_message(*target, number, 0, *p)
    else:
        message = dialect.MAVLink_command_int_message(*target, 0, number, 0, 0, *p[:4], 0, 0, 0.0)
    events = link.receive(codec.pack(message), 1_000_000_000)
    [(answer, _)] = MavlinkCodec(1, 1).feed(link.replies())
    assert (answer.get_type(), answer.command) == ("COMMAND_ACK", number)
    return [e.command for e in events], answer.result


@pytest.mark.parametrize("param1", [-1.0, 4.0, 0.5, 1.0000001, math.nan, math.inf, -math.inf, 1e30])
def test_a_gate_that_there_is_not_is_denied(param1):
    assert told(dialect.MAV_CMD_USER_1, param1) == ([], dialect.MAV_RESULT_DENIED)


@pytest.mark.parametrize(("param1", "command"), [
    (0.0, Command.ENGAGE), (-0.0, Command.ENGAGE), (1.0, Command.PRE_CONTACT), (2.0, Command.CONTACT),
    (3.0, Command.DISCONNECT),
])
@pytest.mark.parametrize("others", [(), (math.nan,) * 6])
def test_gates_are_told_by_their_first_parameter_alone(param1, command, others):
    phase = min(OBEYED[command])
    assert told(dialect.MAV_CMD_USER_1, param1, *others, phase=phase) == ([command], dialect.MAV_RESULT_ACCEPTED)


@pytest.mark.parametrize("param1", [0.0, 7.0, math.nan])
def test_what_is_urgent_is_taken_whatever_its_parameters(param1):
    assert told(dialect.MAV_CMD_USER_2, param1) == ([Command.BREAKAWAY], dialect.MAV_RESULT_ACCEPTED)


def test_other_commands_and_other_messages_are_not_supported():
    assert told(dialect.MAV_CMD_DO_SET_MODE, 1.0) == ([], dialect.MAV_RESULT_UNSUPPORTED)
    assert told(dialect.MAV_CMD_USER_1, 1.0, kind="int") == ([], dialect.MAV_RESULT_UNSUPPORTED)


def test_no_two_commands_are_the_same_on_the_link():
    assert set(COMMANDS) == set(Command)
    assert len(set(COMMANDS.values())) == len(COMMANDS)
    alone = [number for number, param1 in COMMANDS.values() if param1 is None]
    assert not set(alone) & {number for number, param1 in COMMANDS.values() if param1 is not None}


@pytest.mark.parametrize("command", list(Command))
def test_a_scenarios_operator_says_the_same(command):
    scheduled = ScheduledOperator(LINKS, (TimedCommand(at_s=2.0, command=command),))
    assert scheduled.due(1_999_999_999) == []
    assert scheduled.due(2_000_000_000) == [command]
    assert scheduled.due(2_000_000_000) == []
    assert scheduled.frame(command) == Operator(LINKS).frame(command)
    link = AutopilotLink(LINKS)
    link.phase(min(OBEYED.get(command, set(Phase))))
    events = link.receive(scheduled.frame(command), 1)
    assert [e.command for e in events] == [command]


@pytest.mark.slow
def test_a_command_that_the_phase_has_no_use_for_is_told_in_words(tmp_path):
    """A running companion refuses CONTACT on the link, and says itself that its phase has no use for it."""
    text = (FIRMWARE_CONFIGS / "sitl" / "docking.toml").read_text(encoding="utf-8")
    text = text.replace('"../', f'"{FIRMWARE_CONFIGS}/').replace("runs/tanker-datalink,19600", "")
    text = text.replace("tcp://127.0.0.1:14560", "")
    config = tmp_path / "alone.toml"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config.write_text(text.replace("udpin:127.0.0.1:14540", f"udpin:127.0.0.1:{port}"), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "companion", "run", str(config), "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )
    try:
        said = talk(port)
    finally:
        process.terminate()
        process.communicate(timeout=20)
    assert "contact_not_now: phase standby" in said


def talk(port, for_s=60.0):
    """Be an autopilot and an operator until a STATUSTEXT tells of the contact; return the texts."""
    autopilot, ours = MavlinkCodec(1, 1), MavlinkCodec(1, 1)
    beat = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_GENERIC, 0, 0, dialect.MAV_STATE_ACTIVE, 3)
    texts, end_s = [], time.monotonic() + for_s
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        link.settimeout(0.2)
        while time.monotonic() < end_s and not any(text.startswith("contact") for text in texts):
            try:
                link.send(autopilot.pack(beat))
                link.send(Operator(LINKS).frame(Command.CONTACT))
                texts += [m.text for m, _ in ours.feed(link.recv(4096)) if m.get_type() == "STATUSTEXT"]
            except (TimeoutError, ConnectionRefusedError):
                time.sleep(0.2)  # not listening yet
    return texts
