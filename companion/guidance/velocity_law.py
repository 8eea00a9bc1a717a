"""The docking law ``velocity``: position error to velocity; the autopilot's own loop, near the sensors, does the rest.

With e the error of BR and v, a the velocity and acceleration of the place to be at (``feed_forward``)::

    v_cmd = v + R (-K e - K_I int e),   a_cmd = a - R K e'

R = R_ned_mrf, K and K_I diagonal (``guidance.velocity``). A velocity loop of bandwidth k_v that gets both leaves
e with the poles -K and -k_v, whatever the tanker does. e is bounded (``FAR_M``), and so is the speed of closing in.
The receptacle's lever turns with the aircraft: its part of e' is what attitude does, and is not asked of velocity.
"""

from __future__ import annotations

import numpy as np

from companion.config import GuidanceConfig
from companion.geometry import Vec, rotation_from_euler
from companion.guidance.feed_forward import place
from companion.guidance.law import FAR_M
from companion.guidance.path import Reference
from companion.messages import RelativeState, VelocitySetpoint

INTEGRAL_MAX_M_S = 0.5
"""Of what the integral adds to the velocity."""


class VelocityLaw:
    """``step`` once per guidance period; ``reset`` when guidance starts afresh."""

    def __init__(self, config: GuidanceConfig) -> None:
        gains = config.velocity
        self._K = np.array(gains.position_per_s)
        self._K_I = np.array(gains.integral_per_s2)
        self._dt_s = 1.0 / config.rate_hz
        self.reset()

    def reset(self) -> None:
        """Forget the integral."""
        self.integral_m_s = np.zeros(3)

    def step(self, state: RelativeState, reference: Reference) -> VelocitySetpoint:
        """Return the setpoint for a relative state and where BR should be."""
        e = np.clip(state.p_mrf_br_m - reference.p_m, -FAR_M, FAR_M)
        e_rate = np.where(np.abs(e) == FAR_M, 0.0, state.v_mrf_br_m_s - reference.v_m_s)
        bound = INTEGRAL_MAX_M_S / np.maximum(self._K_I, 1e-9)
        self.integral_m_s = np.where(
            np.abs(e) == FAR_M, self.integral_m_s, np.clip(self.integral_m_s + e * self._dt_s, -bound, bound)
        )
        at = place(state, reference)
        R_ned_mrf = rotation_from_euler(state.heading0_rad, 0.0, 0.0)
        v = at.v_ned_m_s - R_ned_mrf @ (self._K * e + self._K_I * self.integral_m_s)
        a = at.a_ned_m_s2 - R_ned_mrf @ (self._K * e_rate)
        return VelocitySetpoint(state.t_ns, triple(v), state.heading0_rad, triple(a))


def triple(v: Vec) -> tuple[float, float, float]:
    """Return a vector (3,) as plain floats."""
    x, y, z = v.tolist()
    return x, y, z
