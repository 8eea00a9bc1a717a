"""The link without a socket: what is believed, how it is stamped, what is answered and what never leaves."""

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import LinksConfig
from companion.geometry import rotation_from_euler, rotation_from_quaternion
from companion.guidance.modes import OBEYED
from companion.io.mavlink import AutopilotLink, MavlinkCodec, Message, dialect
from companion.io.telemetry import COMMANDS
from companion.messages import (
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Command,
    Event,
    Health,
    OperatorCommand,
    OwnAttitude,
    OwnPosition,
    Phase,
    Reject,
)

MS = 1_000_000
S = 1_000 * MS
ALL_WELL = Health(0, ())
AHEAD_NS = 1234 * S  # autopilot's clock minus ours


def packed(message: Message, system: int = 1, component: int = 1) -> bytes:
    return MavlinkCodec(system, component).pack(message)


def attitude(
    t_ns: int, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0), rates: tuple[float, ...] = (0.1, 0.2, 0.3)
) -> Message:
    return dialect.MAVLink_attitude_quaternion_message(t_ns // MS % 2**32, *q, *rates)


def position(t_ns: int, p: tuple[float, ...] = (1.0, 2.0, 3.0), v: tuple[float, ...] = (200.0, 0.0, 1.0)) -> Message:
    return dialect.MAVLink_local_position_ned_message(t_ns // MS % 2**32, *p, *v)


def decoded(data: bytes) -> list[Message]:
    return [message for message, _ in MavlinkCodec(1, 1).feed(data)]


def synced(now_ns: int = 10 * S, ahead_ns: int = AHEAD_NS) -> AutopilotLink:
    """A link that has had one round trip of 2 ms, ending at ``now_ns``."""
    link = AutopilotLink(LinksConfig())
    sent_ns = now_ns - 2 * MS
    [request] = [m for m in decoded(link.outgoing(sent_ns)) if m.get_type() == "TIMESYNC"]
    answer = dialect.MAVLink_timesync_message(sent_ns + MS + ahead_ns, request.ts1)
    assert link.receive(packed(answer), now_ns) == []
    return link


def reasons(events: list[Event]) -> list[str]:
    return [event.reason for event in events if isinstance(event, Reject)]


def test_nothing_stamped_is_believed_before_the_clocks_are_known():
    link = AutopilotLink(LinksConfig())
    assert reasons(link.receive(packed(attitude(5 * S)) + packed(position(5 * S)), 5 * S)) == ["no_timesync"] * 2
    with pytest.raises(ValueError, match="not known yet"):
        link.to_companion_ns(0)


def test_telemetry_comes_with_the_companions_time():
    link = synced()
    assert link.offset_ns == AHEAD_NS
    valid_ns = 10 * S - 7 * MS
    data = packed(attitude(valid_ns + AHEAD_NS)) + packed(position(valid_ns + AHEAD_NS))
    own_attitude, own_position = link.receive(data, 10 * S)
    assert isinstance(own_attitude, OwnAttitude)
    assert isinstance(own_position, OwnPosition)
    assert own_attitude.t_ns == own_position.t_ns == valid_ns
    assert np.allclose(own_attitude.R_ned_frd, np.eye(3))
    assert np.allclose(own_attitude.omega_frd_rad_s, [0.1, 0.2, 0.3])
    assert own_position.p_ned_m.tolist() == [1.0, 2.0, 3.0]
    assert own_position.v_ned_m_s.tolist() == [200.0, 0.0, 1.0]


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_the_quaternion_is_hamilton_wxyz_from_body_to_ned(yaw: float, pitch: float, roll: float):
    half = 0.5 * np.array([yaw, pitch, roll])
    (cy, cp, cr), (sy, sp, sr) = np.cos(half), np.sin(half)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    [event] = synced().receive(packed(attitude(10 * S + AHEAD_NS, (w, x, y, z))), 10 * S)
    assert isinstance(event, OwnAttitude)
    assert np.allclose(event.R_ned_frd, rotation_from_euler(yaw, pitch, roll), atol=1e-6)


def test_milliseconds_since_boot_may_wrap():
    ahead_ns = (2**32 - 5) * MS - 10 * S  # the autopilot's counter wraps 5 ms after now
    link = synced(ahead_ns=ahead_ns)
    for k in range(20):
        now_ns = 10 * S + k * MS
        [event] = link.receive(packed(attitude(now_ns + ahead_ns)), now_ns)
        assert isinstance(event, OwnAttitude)
        assert event.t_ns == now_ns


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (lambda t: attitude(t, (math.nan, 0.0, 0.0, 0.0)), "not_finite"),
        (lambda t: attitude(t, rates=(0.0, math.inf, 0.0)), "not_finite"),
        (lambda t: attitude(t, rates=(0.0, 0.0, 99.0)), "out_of_range"),
        (lambda t: attitude(t, (0.0, 0.0, 0.0, 0.0)), "bad_quaternion"),
        (lambda t: attitude(t, (2.0, 0.0, 0.0, 0.0)), "bad_quaternion"),
        (lambda t: position(t, p=(math.nan, 0.0, 0.0)), "not_finite"),
        (lambda t: position(t, v=(0.0, -math.inf, 0.0)), "not_finite"),
        (lambda t: position(t, p=(2e6, 0.0, 0.0)), "out_of_range"),
        (lambda t: position(t, v=(0.0, 0.0, 5000.0)), "out_of_range"),
        (lambda t: position(t - 3 * S), "stale_stamp"),
        (lambda t: position(t + S), "future_stamp"),
    ],
)
def test_what_cannot_be_is_rejected(message: Callable[[int], Message], reason: str):
    link = synced()
    events = link.receive(packed(message(10 * S + AHEAD_NS)) + packed(position(10 * S + AHEAD_NS)), 10 * S)
    assert reasons(events) == [reason]
    assert isinstance(events[1], OwnPosition)


@pytest.mark.parametrize(("system", "component"), [(2, 1), (1, 2), (255, 190), (0, 0)])
def test_telemetry_of_others_is_rejected(system: int, component: int):
    now = 10 * S + AHEAD_NS
    other_heartbeat = dialect.MAVLink_heartbeat_message(1, dialect.MAV_AUTOPILOT_GENERIC, 8 | 128, 0, 4, 3)
    data = b"".join(packed(m, system, component) for m in (attitude(now), position(now), other_heartbeat))
    assert reasons(synced().receive(data, 10 * S)) == ["foreign_source"] * 3


def test_a_ground_stations_own_traffic_is_nobodys_fault():
    gcs_heartbeat = dialect.MAVLink_heartbeat_message(6, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    answer_to_it = dialect.MAVLink_timesync_message(5, 6)
    assert synced().receive(packed(gcs_heartbeat, 255, 190) + packed(answer_to_it, 1, 1), 10 * S) == []


def test_a_forged_timesync_does_not_move_the_clock():
    link = synced()
    [request] = [m for m in decoded(link.outgoing(11 * S)) if m.get_type() == "TIMESYNC"]
    link.receive(packed(dialect.MAVLink_timesync_message(1, request.ts1), 42, 1), 11 * S + MS)
    link.receive(packed(dialect.MAVLink_timesync_message(1, request.ts1 + 1)), 11 * S + MS)
    assert link.offset_ns == AHEAD_NS


def test_timesync_requests_are_answered_and_never_with_a_request():
    link = AutopilotLink(LinksConfig())
    for now_ns in (0, 7 * S):
        link.receive(packed(dialect.MAVLink_timesync_message(0, 99)), now_ns)
        [answer] = decoded(link.replies())
        assert answer.ts1 == 99
        assert answer.tc1 == max(now_ns, 1)


@pytest.mark.parametrize(
    ("autopilot", "base_mode", "custom_mode", "mode", "armed"),
    [
        (dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 128 | 1, 15, AutopilotMode.GUIDED, True),
        (dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 8 | 1, 10, AutopilotMode.MANUAL, False),
        (dialect.MAV_AUTOPILOT_PX4, 128 | 1, 6 << 16, AutopilotMode.GUIDED, True),
        (dialect.MAV_AUTOPILOT_PX4, 128 | 1, 4 << 16, AutopilotMode.MANUAL, True),
        (dialect.MAV_AUTOPILOT_GENERIC, 128 | 8, 0, AutopilotMode.GUIDED, True),
        (dialect.MAV_AUTOPILOT_GENERIC, 64, 0, AutopilotMode.MANUAL, False),
    ],
)
def test_heartbeats_tell_mode_and_arming(
    autopilot: int, base_mode: int, custom_mode: int, mode: AutopilotMode, armed: bool
):
    message = dialect.MAVLink_heartbeat_message(1, autopilot, base_mode, custom_mode, 4, 3)
    [event] = AutopilotLink(LinksConfig()).receive(packed(message), 3 * S)
    assert event == AutopilotStatus(3 * S, mode, armed)


def command(number: int, target: tuple[int, int] = (1, 191)) -> Message:
    return dialect.MAVLink_command_long_message(*target, number, 0, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("number", "expected"),
    [(31010, Command.ENGAGE), (31011, Command.BREAKAWAY), (31012, Command.CLEAR), (31013, Command.REAL_VISION),
     (31014, Command.SIMULATED_VISION)],
)
def test_an_operators_commands_arrive_and_are_acknowledged(number: int, expected: Command):
    link = AutopilotLink(LinksConfig())
    assert link.receive(packed(command(number), 255, 190), S) == [OperatorCommand(S, expected)]
    [ack] = decoded(link.replies())
    assert (ack.command, ack.result) == (number, dialect.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == (255, 190)


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize("asked", list(Command))
def test_what_the_phase_has_no_use_for_is_answered_so_and_counted(phase: Phase, asked: Command):
    """An operator who is told accepted may rely on it that the phases will look at it."""
    link = AutopilotLink(LinksConfig())
    link.phase(phase)
    number, param1 = COMMANDS[asked]
    message = dialect.MAVLink_command_long_message(1, 191, number, 0, param1 or 0.0, 0, 0, 0, 0, 0, 0)
    [event] = link.receive(packed(message, 255, 190), S)
    [ack] = decoded(link.replies())
    if asked in OBEYED and phase not in OBEYED[asked]:
        assert event == Reject(S, "operator", f"{asked}_not_now", f"phase {phase}")
        assert ack.result == dialect.MAV_RESULT_TEMPORARILY_REJECTED
    else:
        assert event == OperatorCommand(S, asked)
        assert ack.result == dialect.MAV_RESULT_ACCEPTED


def test_other_commands_to_us_are_unsupported_and_commands_to_others_left_alone():
    link = AutopilotLink(LinksConfig())
    unknown = command(dialect.MAV_CMD_NAV_LAND)
    as_int = dialect.MAVLink_command_int_message(1, 191, 0, 31010, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert link.receive(packed(unknown, 255, 190) + packed(as_int, 255, 190), S) == []
    assert [ack.result for ack in decoded(link.replies())] == [dialect.MAV_RESULT_UNSUPPORTED] * 2
    elsewhere = [command(31010, (1, 1)), command(31010, (2, 191)), command(31010, (1, 0))]
    assert link.receive(b"".join(packed(m, 255, 190) for m in elsewhere), S) == []
    assert link.replies() == b""


def test_a_strangers_command_is_denied():
    link = AutopilotLink(LinksConfig())
    assert reasons(link.receive(packed(command(31010), 77, 1), S)) == ["foreign_source"]
    assert [ack.result for ack in decoded(link.replies())] == [dialect.MAV_RESULT_DENIED]


def test_periodic_messages_keep_their_times():
    link = AutopilotLink(LinksConfig())
    link.health(ALL_WELL)
    [beat, *more] = [m for ms in range(0, 10_000, 5) for m in decoded(link.outgoing(ms * MS))]
    assert Counter(m.get_type() for m in [beat, *more]) == {"HEARTBEAT": 10, "TIMESYNC": 20 + 8}
    assert (beat.type, beat.get_srcSystem(), beat.get_srcComponent()) == (dialect.MAV_TYPE_ONBOARD_CONTROLLER, 1, 191)


def test_there_is_no_heartbeat_before_anything_has_said_that_all_is_well():
    assert [m.get_type() for m in decoded(AutopilotLink(LinksConfig()).outgoing(0))] == ["TIMESYNC"]


def rate_requests(link: AutopilotLink, now_ns: int) -> dict[int, float]:
    sent = [m for m in decoded(link.outgoing(now_ns)) if m.get_type() == "COMMAND_LONG"]
    assert all(m.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL for m in sent)
    return {int(m.param1): m.param2 for m in sent}


def rate_answer(result: int) -> bytes:
    return packed(dialect.MAVLink_command_ack_message(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, result, 0, 0, 1, 191))


def test_rates_are_asked_for_when_the_autopilot_appears_until_it_answers():
    link = AutopilotLink(LinksConfig())
    beat = packed(dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 4, 3))
    assert rate_requests(link, 0) == {}
    link.receive(beat, S)
    assert rate_requests(link, S) == {31: 20_000.0, 32: 20_000.0}
    assert rate_requests(link, S + 500 * MS) == {}
    assert rate_requests(link, 2 * S) == {31: 20_000.0, 32: 20_000.0}
    link.receive(rate_answer(dialect.MAV_RESULT_ACCEPTED) * 2, 2 * S + MS)
    assert rate_requests(link, 3 * S + MS) == {}
    link.receive(beat, 9 * S)  # it was away: a reboot has forgotten the rates
    assert rate_requests(link, 9 * S) == {31: 20_000.0, 32: 20_000.0}


def test_a_refused_rate_is_halved_once_per_round():
    link = AutopilotLink(LinksConfig())
    link.receive(packed(dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 4, 3)), S)
    rate_requests(link, S)
    link.receive(rate_answer(dialect.MAV_RESULT_DENIED) * 2, S + MS)
    assert rate_requests(link, S + 2 * MS) == {31: 40_000.0, 32: 40_000.0}
    link.receive(rate_answer(dialect.MAV_RESULT_ACCEPTED) * 2, S + 3 * MS)
    assert rate_requests(link, 3 * S) == {}


angles = st.floats(-1.5, 1.5)


@given(angles, angles, st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
def test_a_setpoint_arrives_as_it_was_meant(roll: float, pitch: float, yaw: float, thrust: float):
    link = synced()
    frame = link.encode_setpoint(AttitudeSetpoint(10 * S, roll, pitch, yaw, thrust), 10 * S)
    assert frame is not None
    [message] = decoded(frame)
    assert message.type_mask == 0x07
    assert message.time_boot_ms == (10 * S + AHEAD_NS) // MS
    assert message.thrust == np.float32(thrust)
    assert (message.target_system, message.target_component) == (1, 1)
    R = rotation_from_quaternion(np.array(message.q))
    assert np.allclose(R, rotation_from_euler(yaw, pitch, roll), atol=1e-6)


@pytest.mark.parametrize("field", ["roll_rad", "pitch_rad", "yaw_rad", "thrust"])
@pytest.mark.parametrize(
    ("value", "reason"),
    [(math.nan, "setpoint_not_finite"), (math.inf, "setpoint_not_finite"), (-7.0, "setpoint_out_of_range")],
)
def test_a_setpoint_that_is_none_never_leaves(field: str, value: float, reason: str):
    if field == "yaw_rad" and value == -7.0:
        value, reason = -math.inf, "setpoint_not_finite"  # any finite heading is a heading
    fields = {"roll_rad": 0.1, "pitch_rad": 0.1, "yaw_rad": 0.1, "thrust": 0.5, field: value}
    link = synced()
    assert link.encode_setpoint(AttitudeSetpoint(t_ns=10 * S, **fields), 10 * S) is None
    assert reasons(link.receive(b"", 10 * S)) == [reason]
    assert reasons(link.receive(b"", 10 * S)) == []


def test_status_text_is_cut_at_fifty_bytes():
    [message] = decoded(AutopilotLink(LinksConfig()).encode_text("approach – " + "x" * 60, 0))
    assert message.text == ("approach ? " + "x" * 60)[:50]


def test_the_log_sees_every_frame_in_and_out():
    seen: list[tuple[int, bytes]] = []
    link = AutopilotLink(LinksConfig(), lambda t_ns, frame: seen.append((t_ns, frame)))
    incoming = packed(command(31010), 255, 190)
    link.receive(b"\x00\x01" + incoming, S)
    outgoing = link.outgoing(2 * S)
    assert seen[0] == (S, incoming)
    assert b"".join(frame for _, frame in seen[1:]) == outgoing


def test_garbage_is_counted_and_costs_nothing_else():
    link = synced()
    events = link.receive(b"\xfd\x09\x00" + packed(position(10 * S + AHEAD_NS)), 10 * S)
    assert reasons(events)
    assert isinstance(events[-1], OwnPosition)


@given(st.binary(max_size=400))
def test_nothing_that_comes_in_breaks_the_link(data: bytes):
    link = synced()
    assert all(isinstance(event, Reject) for event in link.receive(data, 10 * S))


FIELD_VALUES = st.one_of(st.just(math.nan), st.just(math.inf), st.floats(width=32))


@given(st.lists(FIELD_VALUES, min_size=7, max_size=7), st.integers(0, 2**32 - 1))
def test_telemetry_is_finite_or_rejected(values: list[float], t_ms: int):
    link = synced()
    message = dialect.MAVLink_attitude_quaternion_message(t_ms, *values)
    other = dialect.MAVLink_local_position_ned_message((10 * S + AHEAD_NS) // MS, *values[:6])
    for event in link.receive(packed(message) + packed(other), 10 * S):
        if isinstance(event, OwnAttitude):
            assert np.allclose(event.R_ned_frd @ event.R_ned_frd.T, np.eye(3), atol=1e-9)
            assert np.isfinite(event.omega_frd_rad_s).all()
        elif isinstance(event, OwnPosition):
            assert np.isfinite([event.p_ned_m, event.v_ned_m_s]).all()
        else:
            assert isinstance(event, Reject)
