"""Bring what was measured at different times to one instant.

Two positions are only differenced at one instant: at 206 m/s one millisecond is 0.21 m. A history keeps the last
seconds of one aircraft's samples, interpolates between them and extrapolates a short way past the newest one by what
is inertial: attitude by the body rates, position by velocity and by the acceleration that the velocities show.

Rules
-----
* Samples may come out of order: one that is late is put where it belongs, as long as the history reaches back to it.
  An equal stamp is a duplicate: it is refused, and so is what is older than the span (``add`` says which).
* ``travel_m`` at any instant stays what it was for all instants at and after the sample behind a late one: what was
  measured against it (the anchor of a fusion) stays right. What the late sample adds is put on the side of the past.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Generic, TypeVar

import msgspec
import numpy as np

from companion.geometry import Mat, Vec, exp_so3, log_so3
from companion.messages import NS

S = TypeVar("S")

SPAN_S = 3.0
ACCELERATION_S = 0.4
"""Velocities of so long tell the acceleration: their noise, 0.04 m/s held for 50 ms, makes it uncertain by 0.13 m/s²,
which is 0.01 m/s after 70 ms; a turn at 15 degrees of bank has 2.6 m/s²."""
ACCELERATED_S = 0.3
"""For longer past the newest sample the velocity is not let change: nothing says that a manoeuvre lasts."""
MAX_ACCELERATION_M_S2 = 30.0
GAP_S = 0.1
"""Samples further apart than this leave something untold between them: several are missing."""


class Attitude(msgspec.Struct, frozen=True, eq=False):
    """Attitude ``R_ned_body`` (3, 3) and body rates (3,) in rad/s at one instant."""

    R_ned_body: Mat
    omega_body_rad_s: Vec


class Motion(msgspec.Struct, frozen=True, eq=False):
    """Position and velocity (3,) in ``ned`` at one instant; ``travel_m`` is the running integral of velocity.

    ``carried``: the position was not told, but carried on by velocities. ``gaps``: the sums of T^2 and of T^4 over all
    gaps T in s (longer than ``GAP_S``) that the travel goes across.
    """

    p_ned_m: Vec
    v_ned_m_s: Vec
    travel_m: Vec
    carried: bool = False
    gaps: tuple[float, float] = (0.0, 0.0)


class Bracket(msgspec.Struct, Generic[S], frozen=True, eq=False):
    """Where an instant lies: ``dt_s`` after ``before``, at the share ``s`` of the way to ``after`` (None: newest)."""

    before: S
    after: S | None
    dt_s: float
    s: float


class History(Generic[S]):
    """Samples with stamps in rising order and a bounded span; the newest is last."""

    def __init__(self, span_s: float = SPAN_S) -> None:
        self._t_ns: list[int] = []
        self._samples: list[S] = []
        self._span_ns = int(span_s / NS)

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest sample."""
        return self._t_ns[-1] if self._t_ns else None

    def fault(self, t_ns: int) -> str:
        """Say why a stamp cannot be taken: ``duplicate``, ``time_not_forward`` (older than the span), or nothing."""
        t = self._t_ns
        if not t or t_ns > t[-1]:
            return ""
        if t_ns < t[-1] - self._span_ns:
            return "time_not_forward"
        return "duplicate" if t[bisect_left(t, t_ns)] == t_ns else ""

    def insert(self, t_ns: int, sample: S) -> int:
        """Put in a sample whose stamp has no fault, and return where; cut the old end in lumps, since lists shift."""
        at = bisect_left(self._t_ns, t_ns)
        self._t_ns.insert(at, t_ns)
        self._samples.insert(at, sample)
        surplus = bisect_right(self._t_ns, self._t_ns[-1] - self._span_ns)
        if surplus > 50:
            del self._t_ns[:surplus], self._samples[:surplus]
            at = max(0, at - surplus)
        return at

    def shift(self, step_ns: int) -> None:
        """Move all samples in time together; distances flown between them stay."""
        self._t_ns = [t_ns + step_ns for t_ns in self._t_ns]

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

    def add(self, t_ns: int, R_ned_body: Mat, omega_body_rad_s: Vec) -> str:
        """Take a sample; return why not, or nothing."""
        fault = self.fault(t_ns)
        if not fault:
            self.insert(t_ns, Attitude(R_ned_body, omega_body_rad_s))
        return fault

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

    def __init__(self, span_s: float = SPAN_S) -> None:
        super().__init__(span_s)
        self._acceleration: Vec | None = None
        self._lead_m = np.zeros(3)  # travels are kept without it: what late samples have moved all before them by
        self._fixed_ns: int | None = None

    @property
    def fixed_ns(self) -> int | None:
        """Return the stamp of the newest position that was told, not carried."""
        return self._fixed_ns

    def shift(self, step_ns: int) -> None:
        """Move all samples in time together; distances flown between them stay."""
        super().shift(step_ns)
        self._fixed_ns = None if self._fixed_ns is None else self._fixed_ns + step_ns

    def add(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec, *, carried: bool = False) -> str:
        """Take a sample; return why not, or nothing."""
        fault = self.fault(t_ns)
        if fault:
            return fault
        self._acceleration = None
        newest_ns = self.newest_ns
        if newest_ns is None or t_ns > newest_ns:
            travel_m, gaps = np.zeros(3), (0.0, 0.0)
            if newest_ns is not None:
                last = self._samples[-1]
                travel_m = last.travel_m + trapezium(t_ns - newest_ns, last.v_ned_m_s, v_ned_m_s)
                gaps = with_gap(last.gaps, (t_ns - newest_ns) * NS)
            self.insert(t_ns, Motion(p_ned_m, v_ned_m_s, travel_m, carried, gaps))
        else:
            self._put_between(t_ns, p_ned_m, v_ned_m_s)
        if not carried:
            self._fixed_ns = t_ns if self._fixed_ns is None else max(t_ns, self._fixed_ns)
        return ""

    def _put_between(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec) -> None:
        """Insert a late sample; what it changes of the distance flown moves the travel of the samples before it.

        Few come after it: those are moved the other way, and all together by ``_lead_m``.
        """
        k = self.insert(t_ns, Motion(p_ned_m, v_ned_m_s, np.zeros(3)))
        t, samples = self._t_ns, self._samples
        after = samples[k + 1]
        travel_m = after.travel_m - trapezium(t[k + 1] - t_ns, v_ned_m_s, after.v_ned_m_s)
        samples[k] = Motion(p_ned_m, v_ned_m_s, travel_m, False, after.gaps)
        if k > 0:
            before = samples[k - 1]
            moved_m = travel_m - trapezium(t_ns - t[k - 1], before.v_ned_m_s, v_ned_m_s) - before.travel_m
            samples[k:] = [Motion(s.p_ned_m, s.v_ned_m_s, s.travel_m - moved_m, s.carried, s.gaps) for s in samples[k:]]
            self._lead_m = self._lead_m + moved_m

    @property
    def acceleration_m_s2(self) -> Vec:
        """Return the acceleration (3,) of the last moments in ``ned``: the slope of the velocities, least squares."""
        if self._acceleration is None:
            self._acceleration = self._slope()
        return self._acceleration

    def _slope(self) -> Vec:
        first = bisect_left(self._t_ns, self._t_ns[-1] - int(ACCELERATION_S / NS))
        t_s = [NS * (t_ns - self._t_ns[-1]) for t_ns in self._t_ns[first:]]
        if len(t_s) < 3 or t_s[0] > -0.5 * ACCELERATION_S:
            return np.zeros(3)  # too few, or too close together, to tell
        mean_s = sum(t_s) / len(t_s)
        n = e = d = squares = 0.0
        for at_s, sample in zip(t_s, self._samples[first:], strict=True):  # numbers: arrays so short cost more
            off_s = at_s - mean_s
            v_n, v_e, v_d = sample.v_ned_m_s.tolist()
            n, e, d, squares = n + off_s * v_n, e + off_s * v_e, d + off_s * v_d, squares + off_s * off_s
        a = np.array((n, e, d)) / squares
        size = float(np.sqrt(a @ a))
        return a if size <= MAX_ACCELERATION_M_S2 else a * (MAX_ACCELERATION_M_S2 / size)

    def at(self, t_ns: int) -> Motion | None:
        """Return the motion at an instant, or None when there is no sample at or before it."""
        at = self.bracket(t_ns)
        if at is None:
            return None
        a, b = at.before, at.after
        if at.dt_s == 0.0:
            return Motion(a.p_ned_m, a.v_ned_m_s, a.travel_m + self._lead_m, a.carried, a.gaps)
        if b is not None:
            v = (1.0 - at.s) * a.v_ned_m_s + at.s * b.v_ned_m_s
            step = 0.5 * at.dt_s * (a.v_ned_m_s + v)
        else:
            pushed_s = min(at.dt_s, ACCELERATED_S)
            v = a.v_ned_m_s + pushed_s * self.acceleration_m_s2
            step = at.dt_s * a.v_ned_m_s + (at.dt_s - 0.5 * pushed_s) * (v - a.v_ned_m_s)
        gaps = a.gaps if b is None else b.gaps
        return Motion(a.p_ned_m + step, v, a.travel_m + step + self._lead_m, a.carried, gaps)


def trapezium(dt_ns: int, v0_m_s: Vec, v1_m_s: Vec) -> Vec:
    """Return the distance (3,) flown in ``dt_ns`` while the velocity goes from the one to the other."""
    return 0.5 * NS * dt_ns * (v0_m_s + v1_m_s)


def with_gap(gaps: tuple[float, float], gap_s: float) -> tuple[float, float]:
    """Return ``Motion.gaps`` with the time from one sample to the next."""
    if gap_s <= GAP_S:
        return gaps
    return gaps[0] + gap_s**2, gaps[1] + gap_s**4
