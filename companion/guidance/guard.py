"""The last gate: no setpoint leaves that is not finite, fresh and inside the envelope.

A setpoint outside the envelope is our bug or a bad estimate, so what is not finite or too old is refused, and what is
merely large is cut to the envelope, which keeps a saturated law flying.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.messages import AttitudeSetpoint, Reject, Setpoint, VelocitySetpoint


@dataclass(frozen=True, slots=True)
class Envelope:
    """What may be asked of the autopilot: |roll|, pitch about ``pitch_trim_rad``, thrust 0..1, age of estimate.

    ``max_speed_m_s``, ``max_acceleration_m_s2`` and ``max_offset_m`` bound velocity and offset setpoints, in length.
    """

    max_roll_rad: float
    pitch_trim_rad: float
    max_pitch_offset_rad: float
    estimate_stale_s: float
    max_speed_m_s: float = 350.0
    max_offset_m: float = 150.0
    max_acceleration_m_s2: float = 20.0


def clip(value: float, low: float, high: float) -> float:
    """Return the value inside low..high."""
    return min(high, max(low, value))


def guard(setpoint: Setpoint, estimate_age_s: float | None, envelope: Envelope) -> Setpoint | Reject:
    """Return the setpoint cut to the envelope, or a Reject that says why none may leave."""
    if estimate_age_s is None or not estimate_age_s <= envelope.estimate_stale_s:  # also true for NaN
        return Reject(setpoint.t_ns, "guard", "estimate_stale")
    if isinstance(setpoint, AttitudeSetpoint):
        return guard_attitude(setpoint, envelope)
    offset_ned_m = (0.0, 0.0, 0.0) if isinstance(setpoint, VelocitySetpoint) else setpoint.offset_ned_m
    a_ned_m_s2 = setpoint.a_ned_m_s2 if isinstance(setpoint, VelocitySetpoint) else (0.0, 0.0, 0.0)
    if not all(map(math.isfinite, (*offset_ned_m, *setpoint.v_ned_m_s, *a_ned_m_s2, setpoint.yaw_rad))):
        return Reject(setpoint.t_ns, "guard", "setpoint_not_finite")
    far, fast = math.hypot(*offset_ned_m), math.hypot(*setpoint.v_ned_m_s)
    if far > envelope.max_offset_m or fast > envelope.max_speed_m_s:
        return Reject(setpoint.t_ns, "guard", "setpoint_outside_envelope")
    if math.hypot(*a_ned_m_s2) > envelope.max_acceleration_m_s2:
        return Reject(setpoint.t_ns, "guard", "setpoint_outside_envelope")
    return setpoint


def guard_attitude(setpoint: AttitudeSetpoint, envelope: Envelope) -> AttitudeSetpoint | Reject:
    """Return an attitude setpoint cut to the envelope, or a Reject when it is not finite."""
    values = (setpoint.roll_rad, setpoint.pitch_rad, setpoint.yaw_rad, setpoint.thrust)
    if not all(math.isfinite(v) for v in values):
        return Reject(setpoint.t_ns, "guard", "setpoint_not_finite")
    low = envelope.pitch_trim_rad - envelope.max_pitch_offset_rad
    high = envelope.pitch_trim_rad + envelope.max_pitch_offset_rad
    return AttitudeSetpoint(
        setpoint.t_ns,
        clip(setpoint.roll_rad, -envelope.max_roll_rad, envelope.max_roll_rad),
        clip(setpoint.pitch_rad, low, high),
        math.remainder(setpoint.yaw_rad, 2.0 * math.pi),
        clip(setpoint.thrust, 0.0, 1.0),
    )
