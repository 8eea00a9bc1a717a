"""The reference path: a cubic in time from where the receiver is to the box (thesis 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.geometry import Vec
from companion.messages import NS


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where BR should be: position, velocity, acceleration (3,) in ``mrf``."""

    p_m: Vec
    v_m_s: Vec
    a_m_s2: Vec


@dataclass(frozen=True, slots=True, eq=False)
class CubicPath:
    """``p(s) = p0 + (p1 - p0)(3 s^2 - 2 s^3)``, s = (t - t0) / duration in 0..1: at rest at both ends."""

    t0_ns: int
    start_m: Vec
    end_m: Vec
    duration_s: float

    def at(self, t_ns: int) -> Reference:
        """Return the reference at an instant; before the start and past the end it stands still."""
        s = (t_ns - self.t0_ns) * NS / self.duration_s
        if not 0.0 < s < 1.0:
            p = self.end_m if s >= 1.0 else self.start_m
            return Reference(p, np.zeros(3), np.zeros(3))
        way = self.end_m - self.start_m
        T = self.duration_s
        return Reference(
            self.start_m + way * (s * s * (3.0 - 2.0 * s)),
            way * (6.0 * s * (1.0 - s) / T),
            way * (6.0 * (1.0 - 2.0 * s) / (T * T)),
        )

    def done(self, t_ns: int) -> bool:
        """Tell whether the end has been reached."""
        return (t_ns - self.t0_ns) * NS >= self.duration_s


def station(p_m: Vec) -> Reference:
    """Return the reference that stands still at a point."""
    return Reference(p_m, np.zeros(3), np.zeros(3))
