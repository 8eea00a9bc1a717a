"""What a ground station hears of the companion's health: heartbeats, texts and SYS_STATUS, from the bytes."""

import itertools
import time

from hypothesis import given
from hypothesis import strategies as st

from companion.config import LinksConfig
from companion.health import STAGES
from companion.io.clock import MonotonicClock
from companion.io.mavlink import AutopilotLink, MavlinkCodec, MavlinkUdp, dialect
from companion.io.status import BITS, TEXTS_HZ, HealthReport
from companion.io.transport import UdpTransport
from companion.messages import Health, StageHealth

S, MS = 1_000_000_000, 1_000_000
SIGHT = dialect.MAV_SYS_STATUS_SENSOR_VISION_POSITION
CONTROL = dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL | dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL


def health_of(t_ns=0, *, absent=(), unused=(), **ill):
    """Return a health in which all is well but what is told: ``camera="frozen"``."""
    return Health(t_ns, tuple(
        StageHealth(n, n not in absent, n not in unused, n not in ill, ill.get(n, "")) for n in STAGES))


def decoded(data):
    return [message for message, _ in MavlinkCodec(1, 1).feed(data)]


def heard(link, start_s, seconds):
    """Return what leaves in so many seconds, polled every 5 ms: [(s, message)]."""
    start_ns = round(start_s * S)
    return [
        (t_ns / S, m) for t_ns in range(start_ns, start_ns + round(seconds * S), 5 * MS)
        for m in decoded(link.outgoing(t_ns)) if m.get_type() != "TIMESYNC"
    ]


def kinds(messages, kind):
    return [(at_s, m) for at_s, m in messages if m.get_type() == kind]


def texts(messages):
    return [m.text for _, m in kinds(messages, "STATUSTEXT")]


def bits(messages):
    _, m = kinds(messages, "SYS_STATUS")[-1]
    return (m.onboard_control_sensors_present, m.onboard_control_sensors_enabled, m.onboard_control_sensors_health)


def test_heartbeats_leave_only_while_all_that_is_used_is_well():
    link = AutopilotLink(LinksConfig())
    assert kinds(heard(link, 0, 3), "HEARTBEAT") == []
    for start_s, health, count in (
        (3, health_of(camera="frozen"), 0), (6, health_of(), 3), (9, health_of(unused=("camera",), camera="frozen"), 3),
        (12, health_of(camera="frozen", datalink="stale"), 0), (15, health_of(absent=("integrity",)), 3),
    ):
        link.health(health)
        assert len(kinds(heard(link, start_s, 3), "HEARTBEAT")) == count


def test_a_stage_that_fails_and_is_well_again_is_one_text_each():
    link = AutopilotLink(LinksConfig())
    link.health(health_of())
    assert texts(heard(link, 0, 2)) == []
    link.health(health_of(camera="frozen"))
    [(at_s, text)] = kinds(heard(link, 2, 2), "STATUSTEXT")
    assert at_s < 2.01
    assert "camera" in text.text
    assert "frozen" in text.text
    assert text.severity == dialect.MAV_SEVERITY_WARNING
    link.health(health_of(camera="frozen"))  # told again because something else has changed
    assert texts(heard(link, 4, 2)) == []
    link.health(health_of())
    [(_, text)] = kinds(heard(link, 6, 2), "STATUSTEXT")
    assert "camera" in text.text
    assert "well" in text.text
    assert text.severity == dialect.MAV_SEVERITY_INFO


def test_what_has_to_begin_first_is_not_called_a_failure_but_what_never_does_is():
    for back_s, told in ((1.5, 0), (3.0, 2)):
        link = AutopilotLink(LinksConfig())
        link.health(health_of(camera="nothing yet"))
        before = texts(heard(link, 0, back_s))
        link.health(health_of())
        assert len(before + texts(heard(link, back_s, 3))) == told


def test_what_is_not_used_is_not_told():
    link = AutopilotLink(LinksConfig())
    link.health(health_of(unused=("datalink",), datalink="nothing yet"))
    assert texts(heard(link, 0, 2)) == []


def test_when_everything_fails_at_once_the_texts_come_one_by_one():
    link = AutopilotLink(LinksConfig())
    link.health(health_of(**dict.fromkeys(STAGES, "gone")))
    messages = kinds(heard(link, 0, 5), "STATUSTEXT")
    assert [m.text.split()[0] for _, m in messages] == list(STAGES)
    gaps = [b - a for (a, _), (b, _) in itertools.pairwise(messages)]
    assert min(gaps) >= 1 / TEXTS_HZ - 1e-9


def test_a_text_that_has_been_overtaken_is_not_told():
    """Datalink fails and is well before its turn has come: nobody hears of it."""
    link = AutopilotLink(LinksConfig())
    link.health(health_of())
    heard(link, 0, 3)
    link.health(health_of(camera="frozen", vision="few_labels", datalink="stale"))
    first = texts(heard(link, 3, 0.3))
    assert len(first) == 2
    link.health(health_of(camera="frozen", vision="few_labels"))
    assert texts(heard(link, 3.3, 3)) == []


def test_sys_status_says_once_a_second_whether_the_tanker_is_seen():
    link = AutopilotLink(LinksConfig())
    everything = 0
    for bit in BITS:
        everything |= bit
    assert everything & SIGHT
    for k, (health, present, enabled, healthy) in enumerate((
        (health_of(), everything, everything, everything),
        (health_of(vision="few_labels"), everything, everything, everything & ~SIGHT),
        (health_of(camera="frozen"), everything, everything, everything & ~SIGHT),
        (health_of(unused=("vision",)), everything, everything & ~SIGHT, everything),
        (health_of(absent=("camera", "vision"), camera="not there", vision="not there"), everything & ~SIGHT,
         everything, everything & ~SIGHT),
        (health_of(guidance="estimate_stale"), everything, everything, everything & ~CONTROL),
        (health_of(datalink="stale", integrity="boresight"), everything, everything, everything),
    )):
        link.health(health)
        messages = heard(link, 3 * k, 3)
        assert bits(messages) == (present, enabled, healthy)
        assert len(kinds(messages, "SYS_STATUS")) == 3
        _, message = kinds(messages, "SYS_STATUS")[0]
        assert (message.get_srcComponent(), message.voltage_battery, message.battery_remaining) == (191, 65535, -1)


def test_before_any_health_nothing_is_said_of_it():
    assert heard(AutopilotLink(LinksConfig()), 0, 3) == []


@given(st.lists(st.tuples(st.sets(st.sampled_from(STAGES)), st.sets(st.sampled_from(STAGES)), st.integers(0, 2 * S)),
                max_size=20))
def test_whatever_changes_a_heartbeat_means_that_all_is_well(steps):
    report, t_ns = HealthReport(), 0
    for ill, unused, dt_ns in steps:
        t_ns += dt_ns
        health = health_of(t_ns, unused=unused, **dict.fromkeys(ill, "gone"))
        report.take(health)
        due = [m.get_type() for m in report.due(t_ns)]
        assert health.well or "HEARTBEAT" not in due
        assert due.count("STATUSTEXT") <= 1
        assert max((due.count(kind) for kind in due), default=0) <= 1


def test_over_the_socket_health_reaches_who_listens():
    link = MavlinkUdp(LinksConfig(mavlink="udpin:127.0.0.1:0"), MonotonicClock())
    host, port = link._transport.local
    peer, codec = UdpTransport("peer", f"udpout:{host}:{port}"), MavlinkCodec(1, 1)
    try:
        peer.send(codec.pack(dialect.MAVLink_heartbeat_message(1, dialect.MAV_AUTOPILOT_GENERIC, 8 | 128, 0, 4, 3)))
        link.health(health_of(camera="frozen"))
        found, end_s = set(), time.monotonic() + 5.0
        while not {"STATUSTEXT", "SYS_STATUS"} <= found and time.monotonic() < end_s:
            link.poll()
            found |= {m.get_type() for data, _ in peer.poll() for m, _ in MavlinkCodec(9, 9).feed(data)}
        assert {"STATUSTEXT", "SYS_STATUS"} <= found
        assert "HEARTBEAT" not in found
    finally:
        link.close()
        peer.close()
