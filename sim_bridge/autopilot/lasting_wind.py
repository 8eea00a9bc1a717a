"""The wind that lasts, as the receiver tells it without vanes, and the flow angles of its motion within that wind.

Airspeed says how fast it goes through the air, the side force with which sideslip, and as wind is horizontal, the
velocity down is that through the air too. What is missing to the velocity over the ground is wind. It is followed with
the time constant ``WIND_S`` and kept in ``ned``, so that turns do not disturb it; gusts are quicker than that and stay
out of the flow angles.
"""

from __future__ import annotations

import math

from companion.config import AirframeConfig
from companion.geometry import Mat
from sim_bridge.sensors import InertialSample, Triple

WIND_S = 15.0


class LastingWind:
    """Low-passed horizontal wind; begins with that of the first sample."""

    def __init__(self, airframe: AirframeConfig, dt_s: float) -> None:
        """Know nothing of the wind yet; the airframe's linear model says how sideslip and side force go together."""
        self.north_m_s = self.east_m_s = 0.0
        self._side_m_s2 = airframe.A[2][2] * airframe.trim.airspeed_m_s  # for a radian of sideslip, negative
        self._share, self._later_share = 1.0, 1.0 - math.exp(-dt_s / WIND_S)

    def watch(self, sample: InertialSample, R_ned_frd: Mat) -> None:
        """Take one step's sample; the attitude is the sample's."""
        row0, row1, row2 = R_ned_frd.tolist()
        air = self._air(sample, row2)
        north, east = (sum(r * a for r, a in zip(row, air, strict=True)) for row in (row0, row1))
        self.north_m_s += self._share * (sample.v_ned_m_s[0] - north - self.north_m_s)
        self.east_m_s += self._share * (sample.v_ned_m_s[1] - east - self.east_m_s)
        self._share = self._later_share

    def _air(self, sample: InertialSample, down: list[float]) -> Triple:
        """Return the velocity through the air in body axes, of which ``down``, a unit vector, takes the sink rate."""
        V = max(sample.airspeed_m_s, 1.0)
        beta = sample.specific_force_m_s2[1] / self._side_m_s2
        x, y, z = down
        sunk = (sample.v_ned_m_s[2] / V - y * math.sin(beta)) / max(math.cos(beta) * math.hypot(x, z), 0.1)
        alpha = math.asin(min(max(sunk, -1.0), 1.0)) - math.atan2(x, z)
        forward = V * math.cos(beta)
        return forward * math.cos(alpha), V * math.sin(beta), forward * math.sin(alpha)

    def flow(self, sample: InertialSample, R_ned_frd: Mat) -> Triple:
        """Return V, alpha, beta (m/s, rad) of the velocity over the ground less the lasting wind."""
        n, e, d = sample.v_ned_m_s
        n, e = n - self.north_m_s, e - self.east_m_s
        row0, row1, row2 = R_ned_frd.tolist()
        u, v, w = (n * row0[k] + e * row1[k] + d * row2[k] for k in range(3))
        V = math.sqrt(u * u + v * v + w * w)
        return V, math.atan2(w, u), math.asin(v / V) if V > 0.0 else 0.0
