"""Velocity (and position) to roll, pitch, thrust and direct lift, at the autopilot's own rate.

The wanted acceleration::

    a = a_cmd + k_v (v_cmd - v) - d

has three parts: what the setpoint says, what brings the velocity back, and the negative of what pushes the aircraft.
v_cmd goes on with a_cmd until the next setpoint; a point to be at adds a bounded k_p (p_cmd - p) to it. d is what the
accelerometers show beyond what attitude, thrust and direct lift explain (gusts, wake, errors of trim, mass), through
a first-order filter of ``PUSH_RAD_S``; so there is no integral, and nothing winds up.

Attitude and thrust from it, with the airframe's own slopes near trim: roll = atan(a_right / (g + a_up)), the incidence
that the lift needs over -A[alpha, alpha] V per rad, B[V, throttle] per unit of thrust. Axes are the nose's: in a wind
across, the track is not where a bank pulls. Pitch takes its time; what it does not give yet is asked of the flaps.
"""

from __future__ import annotations

import math

from companion.config import AirframeConfig, ConfigError
from companion.geometry import GRAVITY_M_S2
from companion.guidance.slopes import slopes_of
from sim_bridge.autopilot.setpoints import AttitudeCommand, VelocityCommand
from sim_bridge.sensors import InertialSample, Triple

LONGEST_LEAD_S = 0.1
"""A setpoint's acceleration is carried on no longer than this."""


class VelocityLoop:
    """See the head of the file."""

    K_P = 0.4
    K_V = (1.5, 2.5, 2.5)  # 1/s: along, right, down
    MAX_CLOSURE_M_S = 5.0
    MAX_ROLL_RAD = 0.5
    MAX_PITCH_OFFSET_RAD = 0.15
    MAX_PUSH_M_S2 = 8.0
    MAX_LIFT_M_S2 = 1.5
    PUSH_RAD_S = 2.0
    SLOW_RAD_S = 4.0
    LIFT_LAG_S = 0.035
    LIFT_SHARE = 0.5

    def __init__(self, airframe: AirframeConfig, dt_s: float) -> None:
        """Take the airframe's slopes and the step; raises ConfigError when its model gives neither lift nor thrust."""
        self._trim = airframe.trim
        self._slopes = slopes_of(airframe)
        if self._slopes.lift_m_s2_rad <= 0 or self._slopes.thrust_m_s2 <= 0:
            msg = f"airframe {airframe.name}: A[1][1] must be negative (lift) and B[0][0] positive (thrust)"
            raise ConfigError(msg)
        self._sink_m = airframe.response.pitch_sink_m
        self._slow_share = 1.0 - math.exp(-dt_s * self.SLOW_RAD_S)
        self._push_share = 1.0 - math.exp(-dt_s * self.PUSH_RAD_S)
        self._thrust_share = 1.0 - math.exp(-dt_s / airframe.response.thrust_lag_s)
        self._lift_share = 1.0 - math.exp(-dt_s / self.LIFT_LAG_S)
        self.reset()

    def reset(self) -> None:
        """Forget what was commanded: somebody else flew in between."""
        self._push = [0.0, 0.0, 0.0]
        self._pitch_rate = self._slow_up = 0.0
        self._thrust = self._lift = 0.0

    def step(self, command: VelocityCommand, sample: InertialSample, p_ned_m: Triple | None) -> AttitudeCommand:
        """Return what the inner loops shall fly now."""
        yaw, pitch, roll_now = sample.euler_rad
        c, s = math.cos(yaw), math.sin(yaw)
        climb = -sample.v_ned_m_s[2] / self._trim.airspeed_m_s
        attitude_up = self._attitude_up(pitch, roll_now, climb)
        self._watch(sample, climb, attitude_up)
        e_n, e_e, e_d = self._velocity_error(command, sample, p_ned_m)
        a_n, a_e, a_d = command.a_ned_m_s2
        along = c * a_n + s * a_e + self.K_V[0] * (c * e_n + s * e_e) - self._push[0]
        right = c * a_e - s * a_n + self.K_V[1] * (c * e_e - s * e_n) - self._push[1]
        flaps_up = -self._sink_m * self.PUSH_RAD_S * (sample.omega_rad_s[1] - self._pitch_rate)
        up = -a_d - self.K_V[2] * e_d - (self._push[2] - flaps_up)
        roll = clip(math.atan2(right, GRAVITY_M_S2 + up), self.MAX_ROLL_RAD)
        cos_roll = math.cos(roll)
        self._slow_up += self._slow_share * (up - self._slow_up)
        alpha = ((GRAVITY_M_S2 + self._slow_up) / cos_roll - GRAVITY_M_S2) / self._slopes.lift_m_s2_rad
        offset = (self._trim.alpha_rad + alpha) * cos_roll - self._trim.alpha_rad
        offset = clip(climb + offset, self.MAX_PITCH_OFFSET_RAD)
        thrust = (along + GRAVITY_M_S2 * climb - self._slopes.drag_m_s2_rad * alpha) / self._slopes.thrust_m_s2
        thrust = max(0.0, min(1.0, self._trim.throttle + thrust))
        lift = clip(self.LIFT_SHARE * (up - attitude_up), self.MAX_LIFT_M_S2)
        self._thrust += self._thrust_share * (thrust - self._trim.throttle - self._thrust)
        self._lift += self._lift_share * (lift - self._lift)
        return AttitudeCommand(roll, self._trim.alpha_rad + offset, thrust, lift)

    def _attitude_up(self, pitch: float, roll: float, climb: float) -> float:
        """Return the upward acceleration that the present attitude gives in calm air."""
        cos = max(math.cos(roll), 0.3)
        alpha = (pitch - climb) / cos - self._trim.alpha_rad
        return (GRAVITY_M_S2 + self._slopes.lift_m_s2_rad * alpha) * cos - GRAVITY_M_S2

    def _watch(self, sample: InertialSample, climb: float, attitude_up: float) -> None:
        """Move on what pushes: measured less explained acceleration, along the nose, right of it and up."""
        _, pitch, roll = sample.euler_rad
        fx, fy, fz = sample.specific_force_m_s2
        down = fy * math.sin(roll) + fz * math.cos(roll)
        along = fx * math.cos(pitch) + down * math.sin(pitch)
        right = fy * math.cos(roll) - fz * math.sin(roll)
        up = fx * math.sin(pitch) - down * math.cos(pitch) - GRAVITY_M_S2
        alpha = (pitch - climb) / max(math.cos(roll), 0.3) - self._trim.alpha_rad
        explained = (
            self._slopes.thrust_m_s2 * self._thrust + self._slopes.drag_m_s2_rad * alpha - GRAVITY_M_S2 * climb,
            (GRAVITY_M_S2 + self._slopes.lift_m_s2_rad * alpha) * math.sin(roll),
            attitude_up + self._lift,
        )
        for k, (measured, known) in enumerate(zip((along, right, up), explained, strict=True)):
            push = self._push[k] + self._push_share * (measured - known - self._push[k])
            self._push[k] = clip(push, self.MAX_PUSH_M_S2)
        self._pitch_rate += self._push_share * (sample.omega_rad_s[1] - self._pitch_rate)

    def _velocity_error(self, command: VelocityCommand, sample: InertialSample, p_ned_m: Triple | None) -> Triple:
        """Return commanded minus own velocity, with the part that closes the distance to the commanded point."""
        age_s = (sample.t_ns - command.t_ns) * 1e-9
        lead_s = min(max(age_s, 0.0), LONGEST_LEAD_S)
        x, y, z = (
            v + lead_s * a - own
            for v, a, own in zip(command.v_ned_m_s, command.a_ned_m_s2, sample.v_ned_m_s, strict=True)
        )
        if command.p_ned_m is None or p_ned_m is None:
            return x, y, z
        away = [p + v * age_s - own for p, v, own in zip(command.p_ned_m, command.v_ned_m_s, p_ned_m, strict=True)]
        distance = math.hypot(*away)
        gain = min(self.K_P, self.MAX_CLOSURE_M_S / distance) if distance > 0 else 0.0
        return x + gain * away[0], y + gain * away[1], z + gain * away[2]


def clip(value: float, limit: float) -> float:
    """Return ``value`` within +-limit."""
    return min(max(value, -limit), limit)
