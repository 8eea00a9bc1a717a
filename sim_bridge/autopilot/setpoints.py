"""Setpoints that the stand-in autopilot obeys, checked before they are believed.

Rules
-----
* SET_ATTITUDE_TARGET: roll, pitch and thrust are flown, the rudder stays with the inner loops. Masks 0x07 (attitude and
  thrust, as PX4 takes it) and 0x84 (as ArduPlane takes it: its "ignore attitude" bit only hides the yaw) mean the same.
* SET_POSITION_TARGET_LOCAL_NED: velocity, or position and velocity; accelerations and yaw must be marked as ignored.
* SET_POSITION_TARGET_LOCAL_NED in LOCAL_OFFSET_NED: offset from the receptacle to where it should be, that place's
  velocity, and the heading of the formation as yaw, all at time_boot_ms on this vehicle's clock, which lies in the last
  half second. Accelerations and yaw rate must be marked as ignored.
* A number that is not finite, a quaternion that is not unit, or a value out of range makes the whole setpoint invalid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.config import AirframeConfig, ConfigError
from companion.io.mavlink_codec import Message, dialect
from sim_bridge.sensors import InertialSample, Triple

ATTITUDE_MASKS = (0x07, 0x84)
VELOCITY_MASK = 0x0DC7
POSITION_VELOCITY_MASK = 0x0DC0
OFFSET_MASK = 0x09C0
OFFSET_MAX_M = 200.0
OFFSET_SPEED_MAX_M_S = 350.0
OFFSET_AGE_MS = (-50, 500)
"""How long ago an offset may have been true: negative by what the two clocks may differ."""
QUATERNION_TOLERANCE = 0.01
GRAVITY_M_S2 = 9.80665


class SetpointError(ValueError):
    """A setpoint that cannot be flown; its text is the reason that is counted."""


@dataclass(frozen=True, slots=True)
class AttitudeCommand:
    """What the inner loops fly: roll and pitch in rad, thrust 0..1."""

    roll_rad: float
    pitch_rad: float
    thrust: float


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Velocity to fly and, if given, the point to be at: at ``t_ns``, moving with that velocity afterwards."""

    t_ns: int
    v_ned_m_s: Triple
    p_ned_m: Triple | None


@dataclass(frozen=True, slots=True)
class OffsetCommand:
    """Where the receptacle should be as seen from where it was at ``t_ns``, how fast that place moves, the heading of
    the formation: what the regulator of the surfaces flies.
    """

    t_ns: int
    offset_ned_m: Triple
    v_ned_m_s: Triple
    heading_rad: float


def attitude_command(message: Message) -> AttitudeCommand:
    """Read SET_ATTITUDE_TARGET; raises SetpointError."""
    if message.type_mask not in ATTITUDE_MASKS:
        raise SetpointError("unsupported_mask")
    w, x, y, z = message.q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:  # also true for NaN
        raise SetpointError("bad_quaternion")
    if not 0.0 <= message.thrust <= 1.0:
        raise SetpointError("bad_thrust")
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll = math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z))))
    return AttitudeCommand(roll, pitch, message.thrust)


def position_target_command(message: Message, t_ns: int) -> VelocityCommand | OffsetCommand:
    """Read SET_POSITION_TARGET_LOCAL_NED that arrived at ``t_ns``, of either kind; raises SetpointError."""
    if message.coordinate_frame == dialect.MAV_FRAME_LOCAL_OFFSET_NED:
        return offset_command(message, t_ns)
    return velocity_command(message, t_ns)


def offset_command(message: Message, t_ns: int) -> OffsetCommand:
    """Read an offset that arrived at ``t_ns``; raises SetpointError."""
    if message.type_mask != OFFSET_MASK:
        raise SetpointError("unsupported_mask")
    p, v = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
    if not all(math.isfinite(x) for x in (*p, *v, message.yaw)):
        raise SetpointError("not_finite")
    if math.hypot(*p) > OFFSET_MAX_M or math.hypot(*v) > OFFSET_SPEED_MAX_M_S:
        raise SetpointError("out_of_range")
    age_ms = (t_ns // 1_000_000 - message.time_boot_ms + 2**31) % 2**32 - 2**31  # both clocks wrap
    if not OFFSET_AGE_MS[0] <= age_ms <= OFFSET_AGE_MS[1]:
        raise SetpointError("bad_time")
    return OffsetCommand((t_ns // 1_000_000 - age_ms) * 1_000_000, p, v, message.yaw)


def velocity_command(message: Message, t_ns: int) -> VelocityCommand:
    """Read SET_POSITION_TARGET_LOCAL_NED that arrived at ``t_ns``; raises SetpointError."""
    if message.coordinate_frame != dialect.MAV_FRAME_LOCAL_NED:
        raise SetpointError("unsupported_frame")
    if message.type_mask not in {VELOCITY_MASK, POSITION_VELOCITY_MASK}:
        raise SetpointError("unsupported_mask")
    v = (message.vx, message.vy, message.vz)
    p = (message.x, message.y, message.z) if message.type_mask == POSITION_VELOCITY_MASK else None
    if not all(math.isfinite(x) for x in (*v, *(p or ()))):
        raise SetpointError("not_finite")
    return VelocityCommand(t_ns, v, p)


class VelocityLoop:
    """Velocity and position to roll, pitch and thrust, for joining; the docking law flies attitude.

    The wanted acceleration a = k_v (v_cmd - v) + k_i int(v_cmd - v) dt, with v_cmd including a bounded k_p (p_cmd - p),
    is turned to commands with the airframe's own slopes: roll = atan(a_lateral / g), the lift of angle of attack
    -A[alpha, alpha] V per rad for the vertical, B[V, throttle] per unit of thrust along the track. Valid near trim.
    """

    K_P, K_V, K_I = 0.4, 1.5, 0.2
    MAX_CLOSURE_M_S = 5.0
    MAX_ROLL_RAD = 0.5
    MAX_PITCH_OFFSET_RAD = 0.15
    MAX_INTEGRAL_M_S2 = 1.5

    def __init__(self, airframe: AirframeConfig, dt_s: float) -> None:
        """Take the airframe's slopes and the step; raises ConfigError when its model gives neither lift nor thrust."""
        self._trim = airframe.trim
        self._dt_s = dt_s
        self._lift_m_s2_rad = -airframe.A[1][1] * airframe.trim.airspeed_m_s
        self._thrust_m_s2 = airframe.B[0][0]
        if self._lift_m_s2_rad <= 0 or self._thrust_m_s2 <= 0:
            msg = f"airframe {airframe.name}: A[1][1] must be negative (lift) and B[0][0] positive (thrust)"
            raise ConfigError(msg)
        self._integral = [0.0, 0.0, 0.0]

    def reset(self) -> None:
        """Forget the integral: somebody else flew in between."""
        self._integral = [0.0, 0.0, 0.0]

    def step(self, command: VelocityCommand, sample: InertialSample, p_ned_m: Triple | None) -> AttitudeCommand:
        """Return what the inner loops shall fly now."""
        a = self._acceleration(self._velocity_error(command, sample, p_ned_m))
        vn, ve, vd = sample.v_ned_m_s
        ground_speed = math.hypot(vn, ve)
        cos_track, sin_track = (vn / ground_speed, ve / ground_speed) if ground_speed > 1.0 else (1.0, 0.0)
        along, across, up = a[0] * cos_track + a[1] * sin_track, a[1] * cos_track - a[0] * sin_track, -a[2]
        climb_rad = math.atan2(-vd, ground_speed)
        roll = max(-self.MAX_ROLL_RAD, min(self.MAX_ROLL_RAD, math.atan2(across, GRAVITY_M_S2)))
        cos_roll = math.cos(roll)
        extra_lift = (GRAVITY_M_S2 * math.cos(climb_rad) + up) / cos_roll - GRAVITY_M_S2
        offset = (self._trim.alpha_rad + extra_lift / self._lift_m_s2_rad) * cos_roll - self._trim.alpha_rad
        offset = max(-self.MAX_PITCH_OFFSET_RAD, min(self.MAX_PITCH_OFFSET_RAD, climb_rad + offset))
        thrust = self._trim.throttle + (along + GRAVITY_M_S2 * math.sin(climb_rad)) / self._thrust_m_s2
        return AttitudeCommand(roll, self._trim.alpha_rad + offset, max(0.0, min(1.0, thrust)))

    def _velocity_error(self, command: VelocityCommand, sample: InertialSample, p_ned_m: Triple | None) -> Triple:
        """Return commanded minus own velocity, with the part that closes the distance to the commanded point."""
        x, y, z = (v - own for v, own in zip(command.v_ned_m_s, sample.v_ned_m_s, strict=True))
        if command.p_ned_m is None or p_ned_m is None:
            return x, y, z
        age_s = (sample.t_ns - command.t_ns) * 1e-9
        away = [p + v * age_s - own for p, v, own in zip(command.p_ned_m, command.v_ned_m_s, p_ned_m, strict=True)]
        distance = math.hypot(*away)
        gain = min(self.K_P, self.MAX_CLOSURE_M_S / distance) if distance > 0 else 0.0
        return x + gain * away[0], y + gain * away[1], z + gain * away[2]

    def _acceleration(self, error: Triple) -> list[float]:
        """Return the wanted acceleration and move the integral on, within its bound."""
        bound = self.MAX_INTEGRAL_M_S2
        for k in range(3):
            step = self.K_I * self._dt_s * error[k]
            self._integral[k] = max(-bound, min(bound, self._integral[k] + step))
        return [self.K_V * e + i for e, i in zip(error, self._integral, strict=True)]
