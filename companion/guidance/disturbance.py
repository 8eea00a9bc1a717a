"""What pushes the receiver beyond what its attitude and thrust explain: gusts, wake, errors of trim and mass.

The airframe near trim, coordinated, gives in axes turned by its own yaw::

    lift = g + L (incidence - alpha0),  incidence = (theta - gamma) / cos(phi),  gamma = -v_down / V0
    a_forward = D (incidence - alpha0) + X_T T - g gamma,  a_right = lift sin(phi),  a_down = g - lift cos(phi)

L = -V0 A[alpha, alpha], D = A[V, alpha] + A[V, theta], X_T = B[V, throttle], T the lagged thrust from trim. The
inertial velocity, which a gust does not blur, shows the rest: v' = a + d + (innovation), d' = (innovation), critically
damped. Both aircraft fly through the same gusts, so what is fed forward is the motion of the place less d: a gust that
carries both alike asks for nothing.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import AirframeConfig
from companion.geometry import Vec

GRAVITY_M_S2 = 9.80665
LARGEST_M_S2 = 4.0
"""Of the disturbance, per axis: twice what a gust of 3 sigma in moderate turbulence does; more is no gust."""


class Disturbance:
    """Observer of d (3,) in ``ned``, m/s2; ``step`` once per guidance period."""

    def __init__(self, airframe: AirframeConfig, bandwidth_rad_s: float, dt_s: float) -> None:
        self._alpha0 = airframe.trim.alpha_rad
        self._speed_m_s = airframe.trim.airspeed_m_s
        self._lift_m_s2_rad = -airframe.A[1][1] * self._speed_m_s
        self._drag_m_s2_rad = airframe.A[0][1] + airframe.A[0][7]
        self._thrust_m_s2 = airframe.B[0][0]
        fade = math.exp(-bandwidth_rad_s * dt_s)
        self._dt_s = dt_s
        self._v_share, self._d_share = 1.0 - fade * fade, (1.0 - fade) ** 2 / dt_s
        self.reset()

    def reset(self) -> None:
        """Start afresh, from no disturbance."""
        self._v: Vec | None = None
        self.d_ned_m_s2 = np.zeros(3)

    def step(self, v_ned_m_s: Vec, yaw_pitch_roll: tuple[float, float, float], thrust: float) -> Vec:
        """Take the motion now (``thrust`` lagged, from trim); return d (3,)."""
        if self._v is not None:
            predicted = self._v + self._dt_s * (self._a + self.d_ned_m_s2)
            innovation = v_ned_m_s - predicted
            self._v = predicted + self._v_share * innovation
            self.d_ned_m_s2 = np.clip(self.d_ned_m_s2 + self._d_share * innovation, -LARGEST_M_S2, LARGEST_M_S2)
        else:
            self._v = v_ned_m_s
        self._a = self._explained(float(self._v[2]), yaw_pitch_roll, thrust)
        return self.d_ned_m_s2

    def _explained(self, v_down: float, yaw_pitch_roll: tuple[float, float, float], thrust: float) -> Vec:
        yaw, pitch, roll = yaw_pitch_roll
        cos = math.cos(roll)
        gamma = -v_down / self._speed_m_s
        alpha = (pitch - gamma) / cos - self._alpha0
        lift = GRAVITY_M_S2 + self._lift_m_s2_rad * alpha
        forward = self._drag_m_s2_rad * alpha + self._thrust_m_s2 * thrust - GRAVITY_M_S2 * gamma
        right = lift * math.sin(roll)
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([c * forward - s * right, s * forward + c * right, GRAVITY_M_S2 - lift * cos])
