"""The autopilot's clock and telemetry through the link: steps, wraps, GPS status, who is believed."""

import math

import numpy as np
import pytest

from companion.config import FusionConfig, LinksConfig
from companion.estimation.aircraft import Aircraft
from companion.geometry import SE3
from companion.io.mavlink import AutopilotLink, MavlinkCodec, Message, dialect
from companion.io.rate_requests import GPS_RATE_HZ, GPS_SILENT_NS
from companion.messages import GpsStatus, OwnAttitude, OwnPosition, Reject, TimeStep

MS = 1_000_000
S = 1_000 * MS
BEAT = dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 4, 3)


def packed(message: Message, system: int = 1, component: int = 1) -> bytes:
    return MavlinkCodec(system, component).pack(message)


def decoded(data: bytes) -> list[Message]:
    return [message for message, _ in MavlinkCodec(1, 1).feed(data)]


class Autopilot:
    """The other end, with a clock of its own: ``ahead_ns`` of ours; answers TIMESYNC, tells where it is."""

    def __init__(self, ahead_ns: int) -> None:
        self.link, self.ahead_ns, self.events = AutopilotLink(LinksConfig()), ahead_ns, []
        self.garbage = self.silent = False
        self.requests = 0

    def run(self, start_ns: int, end_ns: int) -> list:
        """Flow both ways in steps of 10 ms, 1 ms each way; return what was made of it."""
        self.events = []
        for now_ns in range(start_ns, end_ns, 10 * MS):
            boot_ms = (now_ns + self.ahead_ns) // MS % 2**32
            t = now_ns / S
            self.hear(dialect.MAVLink_local_position_ned_message(boot_ms, 206.0 * t, 0, 0, 206.0, 0, 0.1 * math.sin(t)),
                      now_ns)
            for message in decoded(self.link.outgoing(now_ns)):
                if message.get_type() == "TIMESYNC" and not self.silent:
                    self.requests += 1
                    tc1 = 77 if self.garbage else now_ns + MS + self.ahead_ns
                    self.hear(dialect.MAVLink_timesync_message(tc1, message.ts1), now_ns + 2 * MS)
        return self.events

    def hear(self, message: Message, now_ns: int, system: int = 1) -> list:
        events = self.link.receive(packed(message, system), now_ns)
        self.events += events
        return events

    def of(self, kind: type) -> list:
        return [e for e in self.events if isinstance(e, kind)]

    def reasons(self) -> set[str]:
        return {e.reason for e in self.of(Reject)}


def synced(ahead_ns: int = 1234 * S) -> Autopilot:
    autopilot = Autopilot(ahead_ns)
    autopilot.run(10 * S, 14 * S)
    assert autopilot.link.offset_ns == ahead_ns
    return autopilot


@pytest.mark.parametrize("step_s", [-1230.0, -0.29, 0.5, 4000.0])
def test_a_step_of_its_clock_is_told_within_a_second_and_before_anything_stamped_the_new_way(step_s: float):
    autopilot = synced()
    autopilot.ahead_ns += round(step_s * S)
    events = autopilot.run(14 * S, 16 * S)
    [step] = autopilot.of(TimeStep)
    assert step.t_ns < 15 * S
    assert step.step_ns == -round(step_s * S)
    assert not step.continuous  # its stamps have jumped
    after = events[events.index(step) + 1 :]
    late_ns = [e.t_ns - 14 * S for e in after if isinstance(e, OwnPosition)]
    assert late_ns == list(range(late_ns[0], 2 * S, 10 * MS))
    assert set(autopilot.reasons()) <= {"timesync_outlier", "stale_stamp", "future_stamp"}
    assert autopilot.run(16 * S, 20 * S)
    assert (autopilot.of(TimeStep), autopilot.reasons()) == ([], set())


def test_wild_answers_are_counted_and_asked_again_soon():
    autopilot = synced()
    autopilot.garbage, autopilot.requests = True, 0
    autopilot.run(14 * S, 16 * S)
    assert autopilot.reasons() == {"timesync_outlier"}
    assert autopilot.of(TimeStep) == []
    assert autopilot.requests >= 8
    assert autopilot.link.offset_ns == autopilot.ahead_ns


def test_without_answers_the_offset_stays():
    autopilot = synced()
    autopilot.silent = True
    autopilot.run(14 * S, 40 * S)
    assert autopilot.reasons() == set()
    assert autopilot.link.offset_ns == autopilot.ahead_ns


def test_its_milliseconds_wrap_after_49_days_in_flight():
    autopilot = synced(ahead_ns=2**32 * MS - 15 * S)
    events = autopilot.run(14 * S, 17 * S)
    assert [e.t_ns for e in events if isinstance(e, OwnPosition)] == list(range(14 * S, 17 * S, 10 * MS))
    assert autopilot.reasons() == set()


def gps(fix_type: int, time_us: int) -> Message:
    return dialect.MAVLink_gps_raw_int_message(time_us, fix_type, 0, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(("fix_type", "has_fix"), [(0, False), (1, False), (2, False), (3, True), (4, True), (5, True),
                                                   (6, True), (8, True), (200, False)])
def test_gps_raw_int_says_whether_there_is_a_fix(fix_type: int, has_fix: bool):
    autopilot = synced()
    now_ns = 14 * S
    fix_us = (now_ns - 150 * MS + autopilot.ahead_ns) // 1000
    assert autopilot.hear(gps(fix_type, fix_us), now_ns) == [GpsStatus(now_ns - 150 * MS, has_fix)]


@pytest.mark.parametrize("time_us", [0, 1_700_000_000_000_000, 2**63])
def test_a_fix_stamped_by_another_clock_is_stamped_at_arrival(time_us: int):
    assert synced().hear(gps(3, time_us), 14 * S) == [GpsStatus(14 * S, True)]
    assert Autopilot(0).hear(gps(3, 5), 3 * S) == [GpsStatus(3 * S, True)]  # its clock is not known yet


def gps_requests(link: AutopilotLink, now_ns: int) -> list[float]:
    sent = [m for m in decoded(link.outgoing(now_ns)) if m.get_type() == "COMMAND_LONG"]
    return [m.param2 for m in sent if m.param1 == dialect.MAVLINK_MSG_ID_GPS_RAW_INT]


def test_the_stream_of_gps_is_asked_for_only_where_it_is_not_there():
    link, has_it = AutopilotLink(LinksConfig()), AutopilotLink(LinksConfig())
    link.receive(packed(BEAT), S)
    has_it.receive(packed(BEAT), S)
    asked = []
    for now_ns in range(S, 30 * S, 500 * MS):
        link.receive(packed(BEAT), now_ns)
        has_it.receive(packed(BEAT) + packed(gps(3, 0)), now_ns)
        asked += [(now_ns, us) for us in gps_requests(link, now_ns)]
        assert gps_requests(has_it, now_ns) == []
    assert asked == [(S + GPS_SILENT_NS + k * S, 1e6 / GPS_RATE_HZ) for k in range(5)]


def test_a_refusal_of_gps_lowers_no_other_rate():
    link = AutopilotLink(LinksConfig())
    link.receive(packed(BEAT), S)
    link.outgoing(S)
    link.receive(packed(dialect.MAVLink_command_ack_message(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 0, 0, 1, 191)), S)
    now_ns = S + GPS_SILENT_NS - MS
    link.receive(packed(BEAT), now_ns)
    assert gps_requests(link, S + GPS_SILENT_NS)
    denied = dialect.MAVLink_command_ack_message(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 2, 0, 0, 1, 191)
    link.receive(packed(denied), now_ns + 2 * MS)
    later = decoded(link.outgoing(now_ns + 3 * MS))
    assert [m for m in later if m.get_type() == "COMMAND_LONG"] == []


def test_a_second_vehicle_on_the_link_is_not_listened_to():
    autopilot = synced()
    boot_ms = (14 * S + autopilot.ahead_ns) // MS
    theirs = [dialect.MAVLink_local_position_ned_message(boot_ms, 5000, 0, 0, 100, 0, 0), gps(0, 0), BEAT,
              dialect.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 0, 0, 0)]
    events = [e for m in theirs for e in autopilot.hear(m, 14 * S, system=2)]
    assert [e.reason for e in events[:2]] == ["foreign_source"] * 2
    assert not [e for e in events if not isinstance(e, Reject)]
    answer = dialect.MAVLink_timesync_message(5, autopilot.link.clock.offset.request(14 * S))
    autopilot.hear(answer, 14 * S + MS, system=2)
    assert autopilot.link.offset_ns == autopilot.ahead_ns


def test_a_forged_sysid_among_the_real_ones_is_found_by_what_it_says():
    """On one radio nothing tells two senders of the same sysid apart, but where they say they are."""
    autopilot, aircraft = synced(), Aircraft(FusionConfig(), SE3(np.eye(3), np.zeros(3)))
    reasons = []
    for k in range(200):
        now_ns = 14 * S + k * 20 * MS
        boot_ms, t = (now_ns + autopilot.ahead_ns) // MS, now_ns / S
        real = dialect.MAVLink_local_position_ned_message(boot_ms, 206.0 * t, 0, 0, 206.0, 0, 0.1 * math.sin(t))
        forged = dialect.MAVLink_local_position_ned_message(boot_ms - 5, 206.0 * t, 300, 0, 206.0, 0, 0.1 * math.sin(t))
        both = (real, forged) if k % 2 else (forged, real)
        for message in both if k > 10 else (real,):
            [event] = autopilot.hear(message, now_ns)
            reject = aircraft.own_position_event(event)
            reasons.append((message is forged, reject.reason if reject else ""))
    assert set(reasons) == {(False, ""), (True, "position_jump")}
    assert np.linalg.norm(aircraft.own_motion.at(18 * S).p_ned_m - [206.0 * 18, 0, 0]) < 1.0


def test_telemetry_that_is_late_and_out_of_order_keeps_its_stamps():
    autopilot = synced()
    told = []
    for k in (0, 3, 1, 2, 4):
        t_ns = 14 * S + k * 20 * MS
        boot_ms = (t_ns + autopilot.ahead_ns) // MS
        message = dialect.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 1e-3 * k, 0, 0)
        told += autopilot.hear(message, 14 * S + 100 * MS)
    assert [round((e.t_ns - 14 * S) / MS) for e in told if isinstance(e, OwnAttitude)] == [0, 60, 20, 40, 80]
