"""Real sockets on the loopback: both ways, who is answered, who is believed, what a busy port says."""

import re
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from companion.config import ConfigError, LinksConfig
from companion.io.clock import MonotonicClock, SimulatedClock
from companion.io.mavlink import MavlinkCodec, MavlinkUdp, Message, dialect
from companion.io.transport import UdpTransport, UdpUrl, parse_url
from companion.messages import (
    AttitudeSetpoint,
    AutopilotStatus,
    Command,
    Event,
    Health,
    OperatorCommand,
    OwnPosition,
    Reject,
)

S = 1_000_000_000
HEARTBEAT = dialect.MAVLink_heartbeat_message(1, dialect.MAV_AUTOPILOT_GENERIC, 8 | 128, 0, 4, 3)


class Peer:
    """A bare socket that speaks MAVLink as somebody."""

    def __init__(self, system: int, component: int, to: tuple[str, int]) -> None:
        self.codec = MavlinkCodec(system, component)
        self.transport = UdpTransport("peer", f"udpout:{to[0]}:{to[1]}")

    def send(self, *messages: Message) -> None:
        for message in messages:
            self.transport.send(self.codec.pack(message))

    def received(self) -> list[Message]:
        return [message for data, _ in self.transport.poll() for message, _ in self.codec.feed(data)]


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock(100 * S)


@pytest.fixture
def link(clock: SimulatedClock) -> Iterator[MavlinkUdp]:
    opened = MavlinkUdp(LinksConfig(mavlink="udpin:127.0.0.1:0"), clock)
    yield opened
    opened.close()
    opened.close()


@pytest.fixture
def meet(link: MavlinkUdp) -> Iterator[Callable[[int, int], Peer]]:
    """Make peers that talk to ``link``; closes them."""
    peers: list[Peer] = []

    def make(system: int, component: int) -> Peer:
        local = link._transport.local
        assert local is not None
        peers.append(Peer(system, component, local))
        return peers[-1]

    yield make
    for peer in peers:
        peer.transport.close()


def wait_for(poll: Callable[[], list], count: int = 1) -> list:
    """Poll until ``count`` things have come; the loopback needs no two seconds."""
    got: list = []
    until = time.monotonic() + 2.0
    while len(got) < count and time.monotonic() < until:
        got += poll()
        time.sleep(0.001)
    return got


def poll_for_a_while(poll: Callable[[], list]) -> list:
    got: list = []
    for _ in range(20):
        got += poll()
        time.sleep(0.001)
    return got


@pytest.mark.parametrize(
    ("url", "parsed"),
    [
        ("udpin:127.0.0.1:14540", UdpUrl(True, "127.0.0.1", 14540)),
        ("udpin://0.0.0.0:14540", UdpUrl(True, "0.0.0.0", 14540)),
        ("udpin://:14540", UdpUrl(True, "127.0.0.1", 14540)),
        ("udpout:localhost:14550", UdpUrl(False, "localhost", 14550)),
        ("udpout://10.0.0.1:1/", UdpUrl(False, "10.0.0.1", 1)),
    ],
)
def test_both_spellings_of_an_address(url: str, parsed: UdpUrl):
    assert parse_url("mavlink", url) == parsed


@pytest.mark.parametrize(
    "url", ["", "14540", "udp:127.0.0.1:1", "udpin:127.0.0.1", "udpin:h:70000", "tcp:127.0.0.1:5760"]
)
def test_an_address_that_is_none_is_one_clear_line(url: str):
    with pytest.raises(ConfigError, match=re.escape(f"mavlink '{url}': not udpin:HOST:PORT")):
        UdpTransport("mavlink", url)


def test_a_busy_port_names_the_remedy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(ConfigError, match=rf"mavlink '{url}': the port is in use; stop .* with --mavlink"):
            MavlinkUdp(LinksConfig(mavlink=url), MonotonicClock())


def test_a_foreign_address_names_the_remedy():
    with pytest.raises(ConfigError, match="does not have that address"):
        UdpTransport("mavlink", "udpin:192.0.2.1:14540")


def test_nobody_is_spoken_to_before_the_autopilot_has_spoken(link: MavlinkUdp, meet: Callable[[int, int], Peer]):
    stranger = meet(42, 1)
    stranger.transport.send(b"any byte")
    stranger.send(HEARTBEAT)
    rejects = wait_for(link.poll, 2)
    assert {event.reason for event in rejects} == {"garbage", "foreign_source"}
    link.say("hello")
    assert poll_for_a_while(stranger.received) == []


def test_both_ways(link: MavlinkUdp, clock: SimulatedClock, meet: Callable[[int, int], Peer]):
    autopilot = meet(1, 1)
    link.health(Health(0, ()))  # nothing that could be ill
    autopilot.send(HEARTBEAT)
    [status] = wait_for(link.poll)
    assert isinstance(status, AutopilotStatus)
    heard = wait_for(autopilot.received, 4)
    assert {m.get_type() for m in heard} >= {"COMMAND_LONG", "HEARTBEAT", "TIMESYNC"}
    request = next(m for m in heard if m.get_type() == "TIMESYNC")
    autopilot.send(
        dialect.MAVLink_timesync_message(7 * S, request.ts1),
        dialect.MAVLink_local_position_ned_message(7000, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    )
    [own] = wait_for(link.poll)
    assert isinstance(own, OwnPosition)
    assert own.t_ns == clock.now_ns()
    assert link.offset_ns() == 7 * S - clock.now_ns()
    link.send(AttitudeSetpoint(clock.now_ns(), 0.1, 0.2, 0.3, 0.4))
    link.send(AttitudeSetpoint(clock.now_ns(), float("nan"), 0.2, 0.3, 0.4))
    link.say("approach")
    heard = wait_for(autopilot.received, 2)
    assert [m.get_type() for m in heard] == ["SET_ATTITUDE_TARGET", "STATUSTEXT"]
    assert [event.reason for event in link.poll() if isinstance(event, Reject)] == ["setpoint_not_finite"]


def test_an_operator_is_answered_where_he_is_and_does_not_become_the_autopilot(
    link: MavlinkUdp, meet: Callable[[int, int], Peer]
):
    autopilot, operator = meet(1, 1), meet(255, 190)
    autopilot.send(HEARTBEAT)
    wait_for(link.poll)
    wait_for(autopilot.received)
    operator.send(dialect.MAVLink_command_long_message(1, 191, dialect.MAV_CMD_USER_2, 0, 0, 0, 0, 0, 0, 0, 0))
    [event] = wait_for(link.poll)
    assert isinstance(event, OperatorCommand)
    assert event.command is Command.BREAKAWAY
    assert [m.get_type() for m in wait_for(operator.received)] == ["COMMAND_ACK"]
    poll_for_a_while(autopilot.received)
    link.say("breakaway")
    assert [m.get_type() for m in wait_for(autopilot.received)] == ["STATUSTEXT"]
    assert operator.received() == []


def test_a_second_autopilot_is_believed_only_after_the_first_is_silent(
    link: MavlinkUdp, clock: SimulatedClock, meet: Callable[[int, int], Peer]
):
    first, second = meet(1, 1), meet(1, 1)
    first.send(HEARTBEAT)
    wait_for(link.poll)
    second.send(HEARTBEAT)
    [event] = wait_for(link.poll)
    assert isinstance(event, Reject)
    assert event.reason == "foreign_source"
    clock.set_ns(clock.now_ns() + 4 * S)
    second.send(HEARTBEAT)
    [event] = wait_for(link.poll)
    assert isinstance(event, AutopilotStatus)
    poll_for_a_while(second.received)
    link.say("hello")
    assert [m.get_type() for m in wait_for(second.received)] == ["STATUSTEXT"]


def test_half_a_frame_of_one_does_not_spoil_the_frame_of_another(link: MavlinkUdp, meet: Callable[[int, int], Peer]):
    stranger, autopilot = meet(42, 1), meet(1, 1)
    stranger.transport.send(stranger.codec.pack(HEARTBEAT)[:12])
    assert poll_for_a_while(link.poll) == []
    autopilot.send(HEARTBEAT)
    [event] = wait_for(link.poll)
    assert isinstance(event, AutopilotStatus)


def test_udpout_speaks_first_and_survives_nobody_listening(clock: SimulatedClock):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    link = MavlinkUdp(LinksConfig(mavlink=f"udpout:127.0.0.1:{port}"), clock)
    for _ in range(5):
        assert link.poll() == []
        clock.set_ns(clock.now_ns() + S)
    server = UdpTransport("server", f"udpin:127.0.0.1:{port}")
    clock.set_ns(clock.now_ns() + S)
    got = wait_for(lambda: [*server.poll(), *link.poll()])
    server.send(MavlinkCodec(1, 1).pack(HEARTBEAT), got[0][1])
    events: list[Event] = wait_for(link.poll)
    assert isinstance(events[0], AutopilotStatus)
    link.close()
    server.close()
    assert link.poll() == []


def test_a_closed_socket_takes_and_gives_nothing():
    transport = UdpTransport("mavlink", "udpin:127.0.0.1:0")
    transport.close()
    transport.close()
    transport.send(b"x", ("127.0.0.1", 9))
    assert transport.poll() == []
    assert transport.local is None
