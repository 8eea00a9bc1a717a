"""The velocity loop against a point mass with the airframe's own slopes."""

import math

import msgspec
import numpy as np
import pytest
from level_flight import (
    ALPHA_RAD,
    LIFT_M_S2_RAD,
    SPEED_M_S,
    STEP_NS,
    THROTTLE,
    THRUST_M_S2,
    Quiet,
    airframe,
    state_at,
)

from companion.config import ConfigError
from companion.geometry import GRAVITY_M_S2, rotation_from_euler
from companion.io.telemetry import setpoint_message
from companion.messages import Reject, VelocitySetpoint
from sim_bridge.autopilot.setpoints import SetpointError, VelocityCommand, velocity_command
from sim_bridge.autopilot.velocity_loop import VelocityLoop
from sim_bridge.sensors import InertialSample, InertialSensor

DT_S = STEP_NS * 1e-9


def sample_of(
    t_ns: int, v_ned: np.ndarray, euler: tuple[float, float, float] = (0.0, ALPHA_RAD, 0.0),
    a_ned: np.ndarray | None = None,
) -> InertialSample:
    """Return what sensors say of an aircraft that flies at ``v_ned`` and accelerates by ``a_ned``."""
    base = InertialSensor(Quiet()).sample(state_at(t_ns))
    speed = float(np.linalg.norm(v_ned))
    force = np.zeros(3) if a_ned is None else a_ned
    force = rotation_from_euler(*euler).T @ (force - [0.0, 0.0, GRAVITY_M_S2])
    return InertialSample(
        t_ns, euler, base.omega_rad_s, speed, ALPHA_RAD, 0.0, tuple(v_ned.tolist()), tuple(force.tolist()), speed
    )


def fly(
    command: VelocityCommand, duration_s: float, wind_lift_m_s2: float = 0.0, heading_rad: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Fly a point mass from the origin; attitude, thrust and flaps follow with 0.2, 0.4 and 0.035 s of lag.

    Return p and v.
    """
    loop, p = VelocityLoop(airframe(), DT_S), np.zeros(3)
    v = SPEED_M_S * np.array([math.cos(heading_rad), math.sin(heading_rad), 0.0])
    roll, pitch, thrust, flaps, a = 0.0, ALPHA_RAD, THROTTLE, 0.0, np.zeros(3)
    for k in range(round(duration_s / DT_S)):
        track = math.atan2(v[1], v[0])
        c = loop.step(command, sample_of(k * STEP_NS, v, (track, pitch, roll), a), tuple(p.tolist()))
        roll += DT_S / 0.2 * (c.roll_rad - roll)
        pitch += DT_S / 0.2 * (c.pitch_rad - pitch)
        thrust += DT_S / 0.4 * (c.thrust - thrust)
        flaps += DT_S / 0.035 * (c.lift_m_s2 - flaps)
        climb = math.atan2(-v[2], math.hypot(v[0], v[1]))
        alpha = ALPHA_RAD + (pitch - climb - ALPHA_RAD * math.cos(roll)) / math.cos(roll)
        lift = GRAVITY_M_S2 + LIFT_M_S2_RAD * (alpha - ALPHA_RAD) + wind_lift_m_s2 + flaps
        along = THRUST_M_S2 * (thrust - THROTTLE) - GRAVITY_M_S2 * math.sin(climb)
        right, down = lift * math.sin(roll), GRAVITY_M_S2 - lift * math.cos(roll)
        a = np.array(
            [along * math.cos(track) - right * math.sin(track), along * math.sin(track) + right * math.cos(track), down]
        )
        p, v = p + DT_S * (v + 0.5 * DT_S * a), v + DT_S * a
    return p, v


def test_level_flight_at_the_commanded_velocity_is_left_alone() -> None:
    loop = VelocityLoop(airframe(), DT_S)
    c = loop.step(VelocityCommand(0, (SPEED_M_S, 0.0, 0.0), None), sample_of(0, np.array([SPEED_M_S, 0, 0])), None)
    assert (c.roll_rad, c.pitch_rad, c.thrust) == pytest.approx((0.0, ALPHA_RAD, THROTTLE), abs=1e-9)


@pytest.mark.parametrize("heading_rad", [0.0, 2.0, -1.2])
def test_velocity_is_reached_at_any_heading(heading_rad: float) -> None:
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    forward, right, down = SPEED_M_S + 2.0, 3.0, -1.5
    wanted = (forward * cos - right * sin, forward * sin + right * cos, down)
    _, v = fly(VelocityCommand(0, wanted, None), 30.0, heading_rad=heading_rad)
    np.testing.assert_allclose(v, wanted, atol=0.1)


@pytest.mark.parametrize("wind_lift_m_s2", [0.0, -0.5])
def test_moving_point_is_met_and_a_steady_upset_is_taken_out(wind_lift_m_s2: float) -> None:
    start, v_cmd, seconds = np.array([20.0, 15.0, -10.0]), np.array([SPEED_M_S, 0.0, 0.0]), 50.0
    p, v = fly(VelocityCommand(0, tuple(v_cmd), tuple(start)), seconds, wind_lift_m_s2)
    np.testing.assert_allclose(p, start + v_cmd * seconds, atol=0.5)
    np.testing.assert_allclose(v, v_cmd, atol=0.2)


def test_far_point_is_approached_no_faster_than_the_bound() -> None:
    target = (1000.0, 0.0, 0.0)
    _, v = fly(VelocityCommand(0, (SPEED_M_S, 0.0, 0.0), target), 40.0)
    assert v[0] - SPEED_M_S == pytest.approx(VelocityLoop.MAX_CLOSURE_M_S, abs=0.5)


def test_commands_stay_in_their_bounds_however_far_the_error() -> None:
    loop = VelocityLoop(airframe(), DT_S)
    for v in ((0.0, 200.0, -200.0), (500.0, -500.0, 500.0), (-100.0, 0.0, 0.0)):
        for _ in range(2000):
            c = loop.step(VelocityCommand(0, v, None), sample_of(0, np.array([SPEED_M_S, 0, 0])), None)
        assert abs(c.roll_rad) <= VelocityLoop.MAX_ROLL_RAD
        assert abs(c.pitch_rad - ALPHA_RAD) <= VelocityLoop.MAX_PITCH_OFFSET_RAD + 1e-12
        assert 0.0 <= c.thrust <= 1.0


def test_airframe_without_lift_is_refused() -> None:
    dead = msgspec.structs.replace(airframe(), A=((0.0,) * 9,) * 9)
    with pytest.raises(ConfigError, match=r"A\[1\]\[1\] must be negative"):
        VelocityLoop(dead, DT_S)


def test_what_the_companion_sends_is_what_the_autopilot_reads() -> None:
    sent = VelocitySetpoint(0, (200.0, -3.0, 1.5), 0.3, (0.5, -0.25, 2.0))
    message = setpoint_message(sent, 0, (1, 1))
    assert not isinstance(message, Reject)
    assert velocity_command(message, 7) == VelocityCommand(7, sent.v_ned_m_s, None, sent.a_ned_m_s2)
    message.type_mask |= 0x01C0
    assert velocity_command(message, 7).a_ned_m_s2 == (0.0, 0.0, 0.0)  # marked as ignored
    message.type_mask &= ~0x0040  # one axis of three
    with pytest.raises(SetpointError, match="unsupported_mask"):
        velocity_command(message, 7)


def test_an_acceleration_that_is_no_number_does_not_leave() -> None:
    wrong = VelocitySetpoint(0, (200.0, 0.0, 0.0), 0.0, (math.nan, 0.0, 0.0))
    assert isinstance(setpoint_message(wrong, 0, (1, 1)), Reject)


def test_a_setpoint_that_accelerates_goes_on_doing_so_until_the_next() -> None:
    loop, own = VelocityLoop(airframe(), DT_S), np.array([SPEED_M_S, 0.0, 0.0])
    climbs = VelocityCommand(0, (SPEED_M_S, 0.0, 0.0), None, (0.0, 0.0, -1.0))
    early = loop.step(climbs, sample_of(0, own), None).lift_m_s2
    loop.reset()
    later = loop.step(climbs, sample_of(80_000_000, own), None).lift_m_s2
    assert later == pytest.approx(early + VelocityLoop.LIFT_SHARE * VelocityLoop.K_V[2] * 0.08, abs=1e-6)
