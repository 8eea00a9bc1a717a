"""Bring what was measured at different times to one instant.

Two positions are only differenced at one instant: at 206 m/s one millisecond is 0.21 m. A history keeps the last
seconds of one aircraft's samples, interpolates between them and extrapolates a short way past the newest one by its
rates. Time must go forward: an older or equal stamp is refused (``append`` returns False) and the caller counts it.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from companion.geometry import Mat, Vec, exp_so3, log_so3
from companion.messages import NS


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """Attitude ``R_ned_body`` (3, 3) and body rates (3,) in rad/s at one instant."""

    R_ned_body: Mat
    omega_body_rad_s: Vec


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Position and velocity (3,) in ``ned`` at one instant; ``travel_m`` is the running integral of velocity."""

    p_ned_m: Vec
    v_ned_m_s: Vec
    travel_m: Vec


class _Stamps:
    """Stamps in rising order with a bounded length; the newest is last."""

    def __init__(self, span_s: float) -> None:
        self.t_ns: list[int] = []
        self._span_ns = int(span_s / NS)

    def accepts(self, t_ns: int) -> bool:
        return not self.t_ns or t_ns > self.t_ns[-1]

    def surplus(self) -> int:
        """Return how many samples at the old end lie beyond the span; cut in lumps, since lists shift."""
        n = bisect_right(self.t_ns, self.t_ns[-1] - self._span_ns)
        return n if n > 50 else 0


class AttitudeHistory:
    """Attitudes of one body, interpolated on the rotation group, extrapolated by the body rates."""

    def __init__(self, span_s: float = 3.0) -> None:
        self._stamps = _Stamps(span_s)
        self._samples: list[Attitude] = []

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest sample."""
        return self._stamps.t_ns[-1] if self._stamps.t_ns else None

    def append(self, t_ns: int, R_ned_body: Mat, omega_body_rad_s: Vec) -> bool:
        """Add a sample; False when its stamp is not newer than the last."""
        if not self._stamps.accepts(t_ns):
            return False
        self._stamps.t_ns.append(t_ns)
        self._samples.append(Attitude(R_ned_body, omega_body_rad_s))
        cut = self._stamps.surplus()
        if cut:
            del self._stamps.t_ns[:cut], self._samples[:cut]
        return True

    def at(self, t_ns: int) -> Attitude | None:
        """Return the attitude at an instant, or None when there is no sample at or before it."""
        stamps = self._stamps.t_ns
        k = bisect_right(stamps, t_ns) - 1
        if k < 0:
            return None
        a = self._samples[k]
        dt = (t_ns - stamps[k]) * NS
        if dt == 0.0:
            return a
        if k + 1 == len(stamps):
            return Attitude(a.R_ned_body @ exp_so3(a.omega_body_rad_s * dt), a.omega_body_rad_s)
        b = self._samples[k + 1]
        s = dt / ((stamps[k + 1] - stamps[k]) * NS)
        R = a.R_ned_body @ exp_so3(s * log_so3(a.R_ned_body.T @ b.R_ned_body))
        return Attitude(R, (1.0 - s) * a.omega_body_rad_s + s * b.omega_body_rad_s)


class MotionHistory:
    """Positions and velocities of one body.

    A position fix is carried to an instant by the velocity around it, so the noise of one fix stays the noise of one
    fix. ``travel_m`` differences give the distance flown between two instants from velocity alone, free of the
    jumps of GPS.
    """

    def __init__(self, span_s: float = 3.0) -> None:
        self._stamps = _Stamps(span_s)
        self._samples: list[Motion] = []

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest sample."""
        return self._stamps.t_ns[-1] if self._stamps.t_ns else None

    def append(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec) -> bool:
        """Add a sample; False when its stamp is not newer than the last."""
        if not self._stamps.accepts(t_ns):
            return False
        travel = np.zeros(3)
        if self._samples:
            last = self._samples[-1]
            dt = (t_ns - self._stamps.t_ns[-1]) * NS
            travel = last.travel_m + 0.5 * dt * (last.v_ned_m_s + v_ned_m_s)
        self._stamps.t_ns.append(t_ns)
        self._samples.append(Motion(p_ned_m, v_ned_m_s, travel))
        cut = self._stamps.surplus()
        if cut:
            del self._stamps.t_ns[:cut], self._samples[:cut]
        return True

    def at(self, t_ns: int) -> Motion | None:
        """Return the motion at an instant, or None when there is no sample at or before it."""
        stamps = self._stamps.t_ns
        k = bisect_right(stamps, t_ns) - 1
        if k < 0:
            return None
        a = self._samples[k]
        dt = (t_ns - stamps[k]) * NS
        if dt == 0.0:
            return a
        v = a.v_ned_m_s
        if k + 1 < len(stamps):
            s = dt / ((stamps[k + 1] - stamps[k]) * NS)
            v = (1.0 - s) * v + s * self._samples[k + 1].v_ned_m_s
        step = 0.5 * dt * (a.v_ned_m_s + v)
        return Motion(a.p_ned_m + step, v, a.travel_m + step)

    def acceleration(self, window_s: float) -> Vec:
        """Return the mean acceleration (3,) over the newest ``window_s`` seconds; zero with fewer than two samples."""
        stamps = self._stamps.t_ns
        if len(stamps) < 2:
            return np.zeros(3)
        k = min(bisect_right(stamps, stamps[-1] - int(window_s / NS)), len(stamps) - 2)
        dt = (stamps[-1] - stamps[k]) * NS
        return (self._samples[-1].v_ned_m_s - self._samples[k].v_ned_m_s) / dt
