"""The MAVLink vehicle: real frames in, commands and real frames out."""

import math
from collections import Counter

import numpy as np
import pytest
from level_flight import EULER_RAD, SPEED_M_S, STEP_NS, Quiet, airframe, state_at

from companion.geometry import rotation_from_euler, rotation_from_quaternion
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from sim_bridge.autopilot.setpoints import AttitudeCommand
from sim_bridge.autopilot.telemetry import MAX_RATE_HZ
from sim_bridge.autopilot.vehicle import MODES, Vehicle
from sim_bridge.sensors import GpsFix, InertialSensor, Triple

NS = 1_000_000_000


class Link:
    """A vehicle in straight flight and the companion's end of its link."""

    def __init__(self) -> None:
        self.vehicle = Vehicle(airframe())
        self.codec = MavlinkCodec(1, 191)
        self.t_ns = 0
        self.command: AttitudeCommand | None = None
        self._sensor = InertialSensor(Quiet())

    def send(self, message: Message, codec: MavlinkCodec | None = None) -> None:
        self.vehicle.feed((codec or self.codec).pack(message), self.t_ns)

    def fly(self, duration_s: float, *, located: bool = True) -> list[Message]:
        """Step for a while and return everything that the vehicle said."""
        heard = []
        for _ in range(round(duration_s * NS / STEP_NS)):
            truth = state_at(self.t_ns)
            p: Triple = tuple(truth.p_ned_m.tolist())
            fix = GpsFix(self.t_ns, p) if located else None
            self.command = self.vehicle.step(self._sensor.sample(truth), p if located else None, fix)
            heard += [message for message, _ in self.codec.feed(self.vehicle.outgoing(self.t_ns))]
            self.t_ns += STEP_NS
        assert not self.codec.rejects
        return heard

    def ask(self, command: int, *params: float) -> tuple[int, list[Message]]:
        """Send a COMMAND_LONG; return the result that was acknowledged and everything heard in that step."""
        filled = (*params, *(0.0,) * (7 - len(params)))
        self.send(dialect.MAVLink_command_long_message(1, 1, command, 0, *filled))
        heard = self.fly(0.005)
        acks = of_kind(heard, "COMMAND_ACK")
        assert [ack.command for ack in acks] == [command]
        assert (acks[0].target_system, acks[0].target_component) == (1, 191)
        return acks[0].result, heard


@pytest.fixture
def link() -> Link:
    return Link()


def of_kind(messages: list[Message], kind: str) -> list[Message]:
    return [m for m in messages if m.get_type() == kind]


def texts(messages: list[Message]) -> list[str]:
    return [m.text for m in of_kind(messages, "STATUSTEXT")]


def quaternion(yaw: float, pitch: float, roll: float) -> list[float]:
    cy, cp, cr = (math.cos(0.5 * a) for a in (yaw, pitch, roll))
    sy, sp, sr = (math.sin(0.5 * a) for a in (yaw, pitch, roll))
    return [
        cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]  # fmt: skip


def attitude_target(
    q: list[float] | None = None, thrust: float = 0.5, mask: int = 0x07, system: int = 1, component: int = 1
) -> Message:
    q = quaternion(1.0, 0.08, -0.2) if q is None else q
    return dialect.MAVLink_set_attitude_target_message(0, system, component, mask, q, 0.0, 0.0, 0.0, thrust)


def velocity_target(v: Triple, p: Triple | None = None, mask: int | None = None, frame: int = 1) -> Message:
    mask = (0x0DC7 if p is None else 0x0DC0) if mask is None else mask
    x, y, z = p or (0.0, 0.0, 0.0)
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, x, y, z, *v, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def test_holds_before_any_setpoint_and_says_nothing_of_losing_one(link: Link) -> None:
    heard = link.fly(2.0)
    assert link.command is None
    assert texts(heard) == []
    assert {m.system_status for m in of_kind(heard, "HEARTBEAT")} == {dialect.MAV_STATE_ACTIVE}


@pytest.mark.parametrize("mask", [0x07, 0x84])
@pytest.mark.parametrize("component", [1, 0])
def test_attitude_setpoint_is_flown(link: Link, mask: int, component: int) -> None:
    link.send(attitude_target(mask=mask, component=component))
    heard = link.fly(0.005)
    assert link.command is not None
    assert link.command.roll_rad == pytest.approx(-0.2, abs=1e-6)
    assert link.command.pitch_rad == pytest.approx(0.08, abs=1e-6)
    assert link.command.thrust == pytest.approx(0.5)
    assert texts(heard) == ["following setpoints"]
    assert not link.vehicle.rejects


def test_setpoint_lives_half_a_second_then_wings_level_then_recovers(link: Link) -> None:
    link.send(attitude_target())
    link.fly(0.505)
    assert link.command is not None
    heard = link.fly(1.5)
    assert link.command is None
    assert texts(heard) == ["setpoints lost: holding wings level and speed"]
    assert of_kind(heard, "HEARTBEAT")[-1].system_status == dialect.MAV_STATE_CRITICAL
    heard = []
    for _ in range(10):
        link.send(attitude_target(thrust=0.25))
        heard += link.fly(0.1)
        assert link.command is not None
        assert link.command.thrust == 0.25
    assert texts(heard) == ["following setpoints"]
    assert of_kind(heard, "HEARTBEAT")[-1].system_status == dialect.MAV_STATE_ACTIVE


def test_stream_of_setpoints_is_followed_without_a_break(link: Link) -> None:
    heard = []
    for _ in range(50):
        link.send(attitude_target())
        heard += link.fly(0.05)
        assert link.command is not None
    assert texts(heard) == ["following setpoints"]


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (attitude_target(q=[math.nan, 0.0, 0.0, 0.0]), "bad_quaternion"),
        (attitude_target(q=[1.0, math.inf, 0.0, 0.0]), "bad_quaternion"),
        (attitude_target(q=[0.0, 0.0, 0.0, 0.0]), "bad_quaternion"),
        (attitude_target(q=[2.0, 0.0, 0.0, 0.0]), "bad_quaternion"),
        (attitude_target(thrust=math.nan), "bad_thrust"),
        (attitude_target(thrust=1.5), "bad_thrust"),
        (attitude_target(thrust=-0.1), "bad_thrust"),
        (attitude_target(mask=0x47), "unsupported_mask"),
        (attitude_target(mask=0x80), "unsupported_mask"),
        (velocity_target((math.nan, 0.0, 0.0)), "not_finite"),
        (velocity_target((SPEED_M_S, 0.0, 0.0), (0.0, math.inf, 0.0)), "not_finite"),
        (velocity_target((SPEED_M_S, 0.0, 0.0), mask=0x0FFF), "unsupported_mask"),
        (velocity_target((SPEED_M_S, 0.0, 0.0), frame=8), "unsupported_frame"),
    ],
)
def test_bad_setpoint_is_counted_and_changes_nothing(link: Link, message: Message, reason: str) -> None:
    link.send(attitude_target())
    link.fly(0.005)
    before = link.command
    link.send(message)
    link.fly(0.005)
    assert link.vehicle.rejects == Counter({reason: 1})
    assert link.command == before
    link.fly(0.6)
    assert link.command is None  # the bad one has not prolonged the good one's life


@pytest.mark.parametrize(("system", "component"), [(2, 1), (0, 1), (1, 2), (255, 0)])
def test_setpoint_for_somebody_else_is_left_alone(link: Link, system: int, component: int) -> None:
    link.send(attitude_target(system=system, component=component))
    heard = link.fly(0.005)
    assert link.command is None
    assert texts(heard) == []
    assert not link.vehicle.rejects


def test_own_echo_is_left_alone(link: Link) -> None:
    link.send(attitude_target(), MavlinkCodec(1, 1))
    link.fly(0.005)
    assert link.command is None


def test_garbage_between_frames_costs_no_setpoint(link: Link) -> None:
    link.vehicle.feed(b"\xfd\x00garbage" + link.codec.pack(attitude_target()) + b"\xfe\x01", link.t_ns)
    link.fly(0.005)
    assert link.command is not None
    assert link.vehicle.rejects.total() > 0


def test_frame_that_comes_byte_by_byte_is_obeyed(link: Link) -> None:
    for byte in link.codec.pack(attitude_target()):
        link.vehicle.feed(bytes([byte]), link.t_ns)
    link.fly(0.005)
    assert link.command is not None


RATES_HZ = {
    "HEARTBEAT": 1, "ATTITUDE_QUATERNION": 50, "LOCAL_POSITION_NED": 50, "HIGHRES_IMU": 50, "GLOBAL_POSITION_INT": 10,
    "GPS_RAW_INT": 10, "VFR_HUD": 10, "SYS_STATUS": 2, "SYSTEM_TIME": 1,
}  # fmt: skip


def test_streams_come_at_their_rates_and_nothing_else_comes(link: Link) -> None:
    assert Counter(m.get_type() for m in link.fly(4.0)) == Counter({k: 4 * n for k, n in RATES_HZ.items()})


def test_streams_tell_the_truth_at_their_stamps(link: Link) -> None:
    link.t_ns = 3 * NS
    heard = link.fly(0.5)
    for m in of_kind(heard, "LOCAL_POSITION_NED"):
        truth = state_at(m.time_boot_ms * 1_000_000)
        np.testing.assert_allclose((m.x, m.y, m.z), truth.p_ned_m, atol=1e-3)
        np.testing.assert_allclose((m.vx, m.vy, m.vz), truth.v_ned_m_s, atol=1e-4)
    for m in of_kind(heard, "ATTITUDE_QUATERNION"):
        R = rotation_from_quaternion(np.array([m.q1, m.q2, m.q3, m.q4]))
        np.testing.assert_allclose(R, rotation_from_euler(*EULER_RAD), atol=1e-6)
        np.testing.assert_allclose((m.rollspeed, m.pitchspeed, m.yawspeed), truth.omega_body_rad_s, atol=1e-7)
    imu = of_kind(heard, "HIGHRES_IMU")[0]
    assert imu.time_usec == 3_000_000
    np.testing.assert_allclose((imu.xacc, imu.yacc, imu.zacc), truth.specific_force_body_m_s2, rtol=1e-6)
    hud = of_kind(heard, "VFR_HUD")[0]
    assert hud.airspeed == pytest.approx(np.linalg.norm(truth.v_air_body_m_s), rel=1e-6)
    assert hud.heading == round(math.degrees(EULER_RAD[0]))
    assert hud.climb == pytest.approx(-truth.v_ned_m_s[2], rel=1e-5)


def test_global_position_is_the_local_one_on_the_earth(link: Link) -> None:
    first, last = (of_kind(link.fly(1.0), "GLOBAL_POSITION_INT")[0] for _ in range(2))
    v = state_at(0).v_ned_m_s
    assert (last.lat - first.lat) * 1e-7 * 111_132 == pytest.approx(v[0], rel=0.003)  # metres a degree at 45 degrees
    assert (last.lon - first.lon) * 1e-7 * 78_847 == pytest.approx(v[1], rel=0.003)
    assert (first.alt - last.alt) * 1e-3 == pytest.approx(v[2], abs=0.002)
    assert first.relative_alt == pytest.approx(30_000, abs=1)
    assert (first.vx, first.vy) == (round(100 * v[0]), round(100 * v[1]))


def test_heartbeat_is_a_fixed_wing_in_guided_and_armed(link: Link) -> None:
    beat = of_kind(link.fly(0.1), "HEARTBEAT")[0]
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    assert beat.type == dialect.MAV_TYPE_FIXED_WING
    assert beat.autopilot == dialect.MAV_AUTOPILOT_GENERIC
    assert beat.custom_mode == MODES["GUIDED"]
    assert beat.base_mode & dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    assert beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED


def test_without_a_position_none_is_sent(link: Link) -> None:
    heard = link.fly(1.0, located=False)
    assert of_kind(heard, "LOCAL_POSITION_NED") == of_kind(heard, "GLOBAL_POSITION_INT") == []
    assert {m.fix_type for m in of_kind(heard, "GPS_RAW_INT")} == {dialect.GPS_FIX_TYPE_NO_FIX}
    health = of_kind(heard, "SYS_STATUS")[0].onboard_control_sensors_health
    assert not health & dialect.MAV_SYS_STATUS_SENSOR_GPS


def test_timesync_is_answered_with_the_instant_of_arrival(link: Link) -> None:
    link.t_ns = 7 * NS
    link.send(dialect.MAVLink_timesync_message(0, 123_456_789_012))
    answers = of_kind(link.fly(0.005), "TIMESYNC")
    assert [(m.tc1, m.ts1) for m in answers] == [(7 * NS, 123_456_789_012)]
    link.send(dialect.MAVLink_timesync_message(5, 6))
    assert of_kind(link.fly(0.1), "TIMESYNC") == []


def test_message_interval_is_obeyed_and_goes_back_to_its_default(link: Link) -> None:
    set_interval, attitude = dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_ATTITUDE
    link.fly(0.5)
    for interval_us, expected in [(1e6 / 30, 60), (1e6 / MAX_RATE_HZ, 200), (0, 0), (-1, 0)]:
        assert link.ask(set_interval, attitude, interval_us)[0] == dialect.MAV_RESULT_ACCEPTED
        assert len(of_kind(link.fly(2.0), "ATTITUDE")) == pytest.approx(expected, abs=1)
    quaternion_id = dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
    for interval_us, expected in [(-1, 0), (1e5, 20), (0, 100)]:
        assert link.ask(set_interval, quaternion_id, interval_us)[0] == dialect.MAV_RESULT_ACCEPTED
        assert len(of_kind(link.fly(2.0), "ATTITUDE_QUATERNION")) == pytest.approx(expected, abs=1)


@pytest.mark.parametrize(
    ("message_id", "interval_us"),
    [
        (dialect.MAVLINK_MSG_ID_ATTITUDE, 5000.0),  # faster than the limit
        (dialect.MAVLINK_MSG_ID_ATTITUDE, math.nan),
        (dialect.MAVLINK_MSG_ID_HEARTBEAT, -1.0),  # the link lives by it
        (9999, 1e5),
        (math.nan, 1e5),
    ],
)
def test_message_interval_that_cannot_be_is_denied(link: Link, message_id: float, interval_us: float) -> None:
    assert link.ask(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)[0] == dialect.MAV_RESULT_DENIED
    assert Counter(m.get_type() for m in link.fly(4.0)) == Counter({k: 4 * n for k, n in RATES_HZ.items()})


def test_requested_message_comes_once(link: Link) -> None:
    link.fly(0.1)
    for kind in ("AUTOPILOT_VERSION", "HOME_POSITION", "ATTITUDE"):
        message_id = getattr(dialect, f"MAVLINK_MSG_ID_{kind}")
        result, heard = link.ask(dialect.MAV_CMD_REQUEST_MESSAGE, message_id)
        assert result == dialect.MAV_RESULT_ACCEPTED
        assert len(of_kind(heard + link.fly(0.5), kind)) == 1
    assert link.ask(dialect.MAV_CMD_REQUEST_MESSAGE, 9999)[0] == dialect.MAV_RESULT_UNSUPPORTED


def test_mode_is_changed_on_command_and_setpoints_are_obeyed_in_guided_only(link: Link) -> None:
    set_mode, custom = dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    link.send(attitude_target())
    link.fly(0.1)
    result, heard = link.ask(set_mode, custom, MODES["MANUAL"])
    assert result == dialect.MAV_RESULT_ACCEPTED
    assert "mode MANUAL" in texts(heard)
    link.send(attitude_target())
    beats = of_kind(link.fly(1.0), "HEARTBEAT")
    assert link.command is None
    assert link.vehicle.rejects == Counter({"not_guided": 1})
    assert not beats[0].base_mode & dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    assert link.ask(set_mode, custom, MODES["GUIDED"])[0] == dialect.MAV_RESULT_ACCEPTED
    link.send(attitude_target())
    link.fly(0.1)
    assert link.command is not None


@pytest.mark.parametrize("params", [
    (1.0, 99.0), (0.0, 15.0), (1.0, math.nan), (1.0, -1.0), (math.nan, 0.0), (-1.0, 0.0), (1.5, 0.0), (math.inf, 0.0),
])
def test_mode_that_is_none_is_denied(link: Link, params: tuple[float, float]) -> None:
    assert link.ask(dialect.MAV_CMD_DO_SET_MODE, *params)[0] == dialect.MAV_RESULT_DENIED
    assert link.vehicle.mode == "GUIDED"


def test_other_commands_are_acknowledged(link: Link) -> None:
    assert link.ask(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)[0] == dialect.MAV_RESULT_ACCEPTED
    assert link.ask(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)[0] == dialect.MAV_RESULT_DENIED  # in flight
    assert link.ask(dialect.MAV_CMD_NAV_LAND)[0] == dialect.MAV_RESULT_UNSUPPORTED
    link.send(dialect.MAVLink_command_int_message(1, 1, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    assert of_kind(link.fly(0.005), "COMMAND_ACK")[0].result == dialect.MAV_RESULT_UNSUPPORTED


def test_answers_leave_at_once_and_streams_wait_for_the_sample_of_their_instant(link: Link) -> None:
    link.fly(1.0)
    link.send(dialect.MAVLink_timesync_message(0, 77))
    early = [m for m, _ in link.codec.feed(link.vehicle.outgoing(link.t_ns))]  # before this instant's step
    assert [(m.get_type(), m.tc1, m.ts1) for m in early] == [("TIMESYNC", link.t_ns, 77)]
    assert of_kind(link.fly(0.005), "ATTITUDE_QUATERNION")[0].time_boot_ms == 1000


def test_command_for_somebody_else_is_not_acknowledged(link: Link) -> None:
    link.send(dialect.MAVLink_command_long_message(2, 1, dialect.MAV_CMD_NAV_LAND, 0, *(0.0,) * 7))
    assert of_kind(link.fly(0.1), "COMMAND_ACK") == []


def test_same_input_gives_the_same_bytes() -> None:
    def run() -> bytes:
        vehicle, codec = Vehicle(airframe()), MavlinkCodec(1, 191)
        sensor, said = InertialSensor(np.random.default_rng(5)), b""
        for k in range(400):
            if k % 10 == 0:
                vehicle.feed(codec.pack(attitude_target()), k * STEP_NS)
            vehicle.step(sensor.sample(state_at(k * STEP_NS)), (1.0, 2.0, 3.0))
            said += vehicle.outgoing(k * STEP_NS)
        return said

    assert run() == run()
