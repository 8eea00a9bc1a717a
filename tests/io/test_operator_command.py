"""``companion command`` against a real link on the loopback."""

import subprocess
import sys
import threading

import pytest

from companion.config import ConfigError, LinksConfig
from companion.io.clock import SimulatedClock
from companion.io.mavlink import MavlinkUdp
from companion.io.operator import send_command
from companion.messages import Command, OperatorCommand


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
    port, heard = listening
    assert send_command(f"udpout:127.0.0.1:{port}", command, LinksConfig()) == "accepted"
    assert {e.command for e in heard if isinstance(e, OperatorCommand)} == {command}


def test_a_stranger_is_denied(listening):
    port, heard = listening
    assert send_command(f"udpout:127.0.0.1:{port}", Command.ENGAGE, LinksConfig(gcs_system_id=77)) == "denied"
    assert not [e for e in heard if isinstance(e, OperatorCommand)]


def test_nobody_there_is_one_line():
    with pytest.raises(ConfigError, match="no answer to engage; is a companion running"):
        send_command("udpout:127.0.0.1:9", Command.ENGAGE, LinksConfig())


def test_the_command_line_speaks(listening):
    port, heard = listening
    call = [sys.executable, "-m", "companion", "command", "simulated_vision", "--mavlink", f"udpout:127.0.0.1:{port}"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "simulated_vision: accepted\n", "")
    assert heard
