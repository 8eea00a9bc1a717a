"""What pushes the receiver beyond what its attitude and thrust explain: gusts, wake, errors of trim and mass.

The airframe near trim, coordinated, gives in axes turned by its own yaw::

    lift = g + L (incidence - alpha0),  incidence = (theta - gamma) / cos(phi),  gamma = -v_down / V0
    a_forward = D (incidence - alpha0) + X_T T - g gamma,  a_right = lift sin(phi),  a_down = g - lift cos(phi)

L = -V0 A[alpha, alpha], D = A[V, alpha] + A[V, theta], X_T = B[V, throttle], T the lagged thrust from trim. The
inertial velocity, which a gust does not blur, shows the rest: v' = a + d + (innovation), d' = (innovation), critically
damped; v without what the flaps that pitch the aircraft do to it, ``pitch_sink_m`` q. Both aircraft fly through the
same gusts, so what is fed forward is the motion of the place less d: a gust that carries both alike asks for nothing.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import AirframeConfig, Vec3
from companion.geometry import GRAVITY_M_S2, Vec, rotation_from_euler
from companion.guidance.slopes import slopes_of

LARGEST_M_S2 = 8.0
"""Of the disturbance, per axis: the wake's 4 and gusts of moderate turbulence; more is no disturbance."""


class Disturbance:
    """Observer of d (3,) in ``ned``, m/s2; ``step`` once per guidance period."""

    def __init__(self, airframe: AirframeConfig, bandwidth_rad_s: Vec3, dt_s: float) -> None:
        """``bandwidth_rad_s`` forward, right, down: forward, thrust follows slowly and within its rate."""
        self._alpha0 = airframe.trim.alpha_rad
        self._speed_m_s = airframe.trim.airspeed_m_s
        self._slopes = slopes_of(airframe)
        self._sink_m = airframe.response.pitch_sink_m
        fade = np.exp(-np.array(bandwidth_rad_s) * dt_s)
        self._dt_s = dt_s
        self._v_share, self._d_share = 1.0 - fade * fade, (1.0 - fade) ** 2 / dt_s
        self.reset()

    def reset(self) -> None:
        """Start afresh, from no disturbance."""
        self._v: Vec | None = None
        self._a = np.zeros(3)
        self.d_ned_m_s2 = np.zeros(3)
        self.v_ned_m_s = np.zeros(3)

    def step(
        self, v_ned_m_s: Vec, yaw_pitch_roll: tuple[float, float, float], pitch_rate_rad_s: float, thrust: float
    ) -> Vec:
        """Take the motion now (``thrust`` lagged, from trim); return d (3,)."""
        sinks = np.array([0.0, 0.0, self._sink_m * pitch_rate_rad_s])
        v = v_ned_m_s - sinks
        if self._v is None:
            self._v = v
        R_ned_nose = rotation_from_euler(yaw_pitch_roll[0], 0.0, 0.0)
        predicted = self._v + self._dt_s * (self._a + self.d_ned_m_s2)
        innovation = R_ned_nose.T @ (v - predicted)
        self._v = predicted + R_ned_nose @ (self._v_share * innovation)
        self.v_ned_m_s = self._v + sinks
        d = self.d_ned_m_s2 + R_ned_nose @ (self._d_share * innovation)
        self.d_ned_m_s2 = np.clip(d, -LARGEST_M_S2, LARGEST_M_S2)
        self._a = R_ned_nose @ self._explained(float(self._v[2]), yaw_pitch_roll, thrust)
        return self.d_ned_m_s2

    def _explained(self, v_down: float, yaw_pitch_roll: tuple[float, float, float], thrust: float) -> Vec:
        _, pitch, roll = yaw_pitch_roll
        cos = math.cos(roll)
        gamma = -v_down / self._speed_m_s
        alpha = (pitch - gamma) / cos - self._alpha0
        lift = GRAVITY_M_S2 + self._slopes.lift_m_s2_rad * alpha
        forward = self._slopes.drag_m_s2_rad * alpha + self._slopes.thrust_m_s2 * thrust - GRAVITY_M_S2 * gamma
        return np.array([forward, lift * math.sin(roll), GRAVITY_M_S2 - lift * cos])
