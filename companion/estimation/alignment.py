"""Bring what was measured at different times to one instant.

Two positions are only differenced at one instant: at 206 m/s one millisecond is 0.21 m. A history keeps the last
seconds of one aircraft's samples, interpolates between them and extrapolates a short way past the newest one by its
rates. Time must go forward: an older or equal stamp is refused (``append`` returns False) and the caller counts it.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Generic, TypeVar

import msgspec
import numpy as np

from companion.geometry import Mat, Vec, exp_so3, log_so3
from companion.messages import NS

S = TypeVar("S")


class Attitude(msgspec.Struct, frozen=True, eq=False):
    """Attitude ``R_ned_body`` (3, 3) and body rates (3,) in rad/s at one instant."""

    R_ned_body: Mat
    omega_body_rad_s: Vec


class Motion(msgspec.Struct, frozen=True, eq=False):
    """Position and velocity (3,) in ``ned`` at one instant; ``travel_m`` is the running integral of velocity."""

    p_ned_m: Vec
    v_ned_m_s: Vec
    travel_m: Vec


class Bracket(msgspec.Struct, Generic[S], frozen=True, eq=False):
    """Where an instant lies: ``dt_s`` after ``before``, at the share ``s`` of the way to ``after`` (None: newest)."""

    before: S
    after: S | None
    dt_s: float
    s: float


class History(Generic[S]):
    """Samples with stamps in rising order and a bounded span; the newest is last."""

    def __init__(self, span_s: float = 3.0) -> None:
        self._t_ns: list[int] = []
        self._samples: list[S] = []
        self._span_ns = int(span_s / NS)

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest sample."""
        return self._t_ns[-1] if self._t_ns else None

    def accepts(self, t_ns: int) -> bool:
        """Tell whether a stamp is newer than the newest."""
        return not self._t_ns or t_ns > self._t_ns[-1]

    def push(self, t_ns: int, sample: S) -> None:
        """Add a sample whose stamp is accepted; cut the old end in lumps, since lists shift."""
        self._t_ns.append(t_ns)
        self._samples.append(sample)
        surplus = bisect_right(self._t_ns, t_ns - self._span_ns)
        if surplus > 50:
            del self._t_ns[:surplus], self._samples[:surplus]

    def bracket(self, t_ns: int) -> Bracket[S] | None:
        """Return the samples about an instant, or None when there is none at or before it."""
        k = bisect_right(self._t_ns, t_ns) - 1
        if k < 0:
            return None
        dt_ns = t_ns - self._t_ns[k]
        if k + 1 == len(self._t_ns):
            return Bracket(self._samples[k], None, dt_ns * NS, 0.0)
        return Bracket(self._samples[k], self._samples[k + 1], dt_ns * NS, dt_ns / (self._t_ns[k + 1] - self._t_ns[k]))


class AttitudeHistory(History[Attitude]):
    """Attitudes of one body, interpolated on the rotation group, extrapolated by the body rates."""

    def append(self, t_ns: int, R_ned_body: Mat, omega_body_rad_s: Vec) -> bool:
        """Add a sample; False when its stamp is not newer than the last."""
        if not self.accepts(t_ns):
            return False
        self.push(t_ns, Attitude(R_ned_body, omega_body_rad_s))
        return True

    def at(self, t_ns: int) -> Attitude | None:
        """Return the attitude at an instant, or None when there is no sample at or before it."""
        at = self.bracket(t_ns)
        if at is None:
            return None
        if at.dt_s == 0.0:
            return at.before
        a, b = at.before, at.after
        if b is None:
            return Attitude(a.R_ned_body @ exp_so3(a.omega_body_rad_s * at.dt_s), a.omega_body_rad_s)
        R = a.R_ned_body @ exp_so3(at.s * log_so3(a.R_ned_body.T @ b.R_ned_body))
        return Attitude(R, (1.0 - at.s) * a.omega_body_rad_s + at.s * b.omega_body_rad_s)


class MotionHistory(History[Motion]):
    """Positions and velocities of one body.

    A position fix is carried to an instant by the velocity around it, so the noise of one fix stays the noise of one
    fix. ``travel_m`` differences give the distance flown between two instants from velocity alone, free of the
    jumps of GPS.
    """

    def append(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec) -> bool:
        """Add a sample; False when its stamp is not newer than the last."""
        if not self.accepts(t_ns):
            return False
        travel = np.zeros(3)
        if self._samples:
            last = self._samples[-1]
            travel = last.travel_m + 0.5 * NS * (t_ns - self._t_ns[-1]) * (last.v_ned_m_s + v_ned_m_s)
        self.push(t_ns, Motion(p_ned_m, v_ned_m_s, travel))
        return True

    def at(self, t_ns: int) -> Motion | None:
        """Return the motion at an instant, or None when there is no sample at or before it."""
        at = self.bracket(t_ns)
        if at is None:
            return None
        if at.dt_s == 0.0:
            return at.before
        a = at.before
        v = a.v_ned_m_s if at.after is None else (1.0 - at.s) * a.v_ned_m_s + at.s * at.after.v_ned_m_s
        step = 0.5 * at.dt_s * (a.v_ned_m_s + v)
        return Motion(a.p_ned_m + step, v, a.travel_m + step)
