"""Setpoints that the stand-in autopilot obeys, checked before they are believed.

Rules
-----
* SET_ATTITUDE_TARGET: roll, pitch and thrust are flown, the rudder stays with the inner loops. Masks 0x07 (attitude and
  thrust, as PX4 takes it) and 0x84 (as ArduPlane takes it: its "ignore attitude" bit only hides the yaw) mean the same.
* SET_POSITION_TARGET_LOCAL_NED: velocity, alone or with the acceleration that goes with it, or position and velocity;
  the yaw is not flown, the aircraft points where it flies.
* SET_POSITION_TARGET_LOCAL_NED in LOCAL_OFFSET_NED: offset from the receptacle to where it should be, that place's
  velocity, and the heading of the formation as yaw, all at time_boot_ms on this vehicle's clock, which lies in the last
  half second. Accelerations and yaw rate must be marked as ignored.
* A number that is not finite, a quaternion that is not unit, or a value out of range makes the whole setpoint invalid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.io.mavlink_codec import Message, dialect
from sim_bridge.sensors import Triple

ATTITUDE_MASKS = (0x07, 0x84)
VELOCITY_MASK = 0x0DC7
POSITION_VELOCITY_MASK = 0x0DC0
WITH_ACCELERATION, WITH_YAW = 0x01C0, 0x0400
"""Bits of the mask that may be cleared when velocity is flown; the yaw is not: the aircraft points where it flies."""
OFFSET_MASK = 0x09C0
OFFSET_MAX_M = 200.0
OFFSET_SPEED_MAX_M_S = 350.0
OFFSET_AGE_MS = (-50, 500)
"""How long ago an offset may have been true: negative by what the two clocks may differ."""
QUATERNION_TOLERANCE = 0.01


class SetpointError(ValueError):
    """A setpoint that cannot be flown; its text is the reason that is counted."""


@dataclass(frozen=True, slots=True)
class AttitudeCommand:
    """What the inner loops fly: roll and pitch in rad, thrust 0..1; upward acceleration by the flaps alone."""

    roll_rad: float
    pitch_rad: float
    thrust: float
    lift_m_s2: float = 0.0


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Velocity to fly and, if given, the point to be at: at ``t_ns``, moving with that velocity afterwards.

    ``a_ned_m_s2`` is how the velocity changes, zero when it was not said.
    """

    t_ns: int
    v_ned_m_s: Triple
    p_ned_m: Triple | None
    a_ned_m_s2: Triple = (0.0, 0.0, 0.0)


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
    mask = message.type_mask | WITH_YAW
    accelerates = mask == VELOCITY_MASK & ~WITH_ACCELERATION
    if not accelerates and mask not in {VELOCITY_MASK, POSITION_VELOCITY_MASK}:
        raise SetpointError("unsupported_mask")
    v = (message.vx, message.vy, message.vz)
    p = (message.x, message.y, message.z) if mask == POSITION_VELOCITY_MASK else None
    a = (message.afx, message.afy, message.afz) if accelerates else (0.0, 0.0, 0.0)
    if not all(math.isfinite(x) for x in (*v, *a, *(p or ()))):
        raise SetpointError("not_finite")
    return VelocityCommand(t_ns, v, p, a)
