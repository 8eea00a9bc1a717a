import socket
import time

import pytest

from companion.config import ConfigError
from companion.io.mavlink_codec import MavlinkCodec, dialect
from sim_bridge.stick import AT_REST, StickPort, stick_of

S = 1_000_000_000


@pytest.fixture
def port():
    p = StickPort("udpin:127.0.0.1:0")
    yield p
    p.close()


def manual(x, y, z):
    return dialect.MAVLink_manual_control_message(1, x, y, z, 0, 0)


def send(port, *messages, tail=b""):
    data = b"".join(MavlinkCodec(255, 190).pack(m) for m in messages) + tail
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto(data, port.local)
    time.sleep(0.02)


def test_back_is_up_right_is_right_and_the_middle_of_the_throttle_is_rest():
    assert stick_of(manual(-1000, 500, 500)) == (1.0, 0.5, 0.0)
    assert stick_of(manual(1000, -1000, 1000)) == (-1.0, -1.0, 1.0)
    assert stick_of(manual(0, 0, 0)) == (0.0, 0.0, -1.0)
    assert stick_of(manual(32767, 32767, 32767)) == (0.0, 0.0, 0.0)


def test_a_stick_over_the_wire_holds_until_it_falls_silent(port):
    assert port.poll(0) == AT_REST
    send(port, manual(-200, 0, 500))
    assert port.poll(1 * S) == (0.2, 0.0, 0.0)
    assert port.poll(round(1.4 * S)) == (0.2, 0.0, 0.0)
    assert port.poll(round(1.6 * S)) == AT_REST


def test_what_is_out_of_range_is_counted_and_changes_nothing(port):
    send(port, manual(-200, 0, 500), manual(1001, 0, 500), tail=b"\xfd\x09noise")
    assert port.poll(1 * S) == (0.2, 0.0, 0.0)
    assert port.rejects["stick_out_of_range"] == 1


def test_an_address_that_is_none_is_one_clear_line():
    with pytest.raises(ConfigError, match=r"stick .*udpin:HOST:PORT"):
        StickPort("joystick")
