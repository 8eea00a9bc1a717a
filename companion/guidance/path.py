"""Reference paths: straight lines in ``mrf``, at rest where they end.

Two time laws. ``CubicPath`` is the thesis' cubic in time (3.3). ``LinePath`` is a speed profile over the line: spells
of steady speed, and between them ramps whose acceleration rises and falls without a step, for the law's feed-forward.
``closure`` makes one that closes in slowly near its end, ``retreat`` the way back, which brakes first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.geometry import Vec
from companion.messages import NS

RAMP = 1.5
"""Peak over mean acceleration of a smooth ramp."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where BR should be: position, velocity, acceleration (3,) in ``mrf``."""

    p_m: Vec
    v_m_s: Vec
    a_m_s2: Vec


class Path(Protocol):
    """A reference over time."""

    def at(self, t_ns: int) -> Reference:
        """Return the reference at an instant; before the start and past the end it stands still."""

    def done(self, t_ns: int) -> bool:
        """Tell whether the end has been reached."""


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
            return station(self.end_m if s >= 1.0 else self.start_m)
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


@dataclass(frozen=True, slots=True)
class Spell:
    """A time in which speed goes from ``v0_m_s`` to ``v1_m_s`` by 3 s^2 - 2 s^3, signed along the line."""

    duration_s: float
    v0_m_s: float
    v1_m_s: float

    @property
    def way_m(self) -> float:
        """Return how far it goes."""
        return 0.5 * (self.v0_m_s + self.v1_m_s) * self.duration_s

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Return way, speed and acceleration ``t_s`` after its start."""
        s, change = t_s / self.duration_s, self.v1_m_s - self.v0_m_s
        return (
            self.v0_m_s * t_s + change * self.duration_s * s**3 * (1.0 - 0.5 * s),
            self.v0_m_s + change * s * s * (3.0 - 2.0 * s),
            change * 6.0 * s * (1.0 - s) / self.duration_s,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LinePath:
    """Spells one after another from ``start_m`` along the unit vector ``along`` (3,)."""

    t0_ns: int
    start_m: Vec
    along: Vec
    spells: tuple[Spell, ...]

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
        return sum(spell.duration_s for spell in self.spells)

    def at(self, t_ns: int) -> Reference:
        """Return the reference at an instant; before the start and past the end it stands still."""
        left_s, way_m = (t_ns - self.t0_ns) * NS, 0.0
        if left_s < 0.0:
            return station(self.start_m)
        for spell in self.spells:
            if left_s < spell.duration_s:
                s, v, a = spell.at(left_s)
                return Reference(self.start_m + self.along * (way_m + s), self.along * v, self.along * a)
            left_s -= spell.duration_s
            way_m += spell.way_m
        return station(self.start_m + self.along * way_m)

    def done(self, t_ns: int) -> bool:
        """Tell whether the end has been reached."""
        return (t_ns - self.t0_ns) * NS >= self.duration_s


@dataclass(frozen=True, slots=True)
class Closure:
    """How to close in: at most ``far_m_s``, over the last ``near_m`` at most ``near_m_s``; peak acceleration."""

    far_m_s: float
    near_m_s: float
    near_m: float
    peak_m_s2: float

    def spells(self, way_m: float) -> list[Spell]:
        """Return the spells of a way from rest to rest that ends at the box."""
        near_m = min(self.near_m, way_m)
        a = self.peak_m_s2 / RAMP
        slow = min(self.near_m_s, math.sqrt(a * way_m), math.sqrt(2.0 * a * near_m))
        # From rest to the peak and down to the slow speed: v^2 / 2a + (v^2 - slow^2) / 2a is the way beyond near_m.
        fast = min(self.far_m_s, math.sqrt(a * (way_m - near_m) + 0.5 * slow * slow))
        if fast <= slow:
            return self._stretched([_ramp(0.0, slow, a), _ramp(slow, 0.0, a)], slow, way_m, 1)
        beyond = self._stretched([_ramp(0.0, fast, a), _ramp(fast, slow, a)], fast, way_m - near_m, 1)
        return beyond + self._stretched([_ramp(slow, 0.0, a)], slow, near_m, 0)

    @staticmethod
    def _stretched(ramps: list[Spell], v_m_s: float, way_m: float, place: int) -> list[Spell]:
        """Put a spell of steady speed in at ``place``, so that all together go ``way_m``."""
        steady_s = (way_m - sum(ramp.way_m for ramp in ramps)) / v_m_s if v_m_s > 0.0 else 0.0
        ramps[place:place] = [Spell(steady_s, v_m_s, v_m_s)] if steady_s > 0.0 else []
        return ramps

    def back_spells(self, way_m: float, from_box_m: float) -> list[Spell]:
        """Return the spells, speeds negative, of the way back over ``way_m`` that begins ``from_box_m`` off the box."""
        part = Closure(self.far_m_s, self.near_m_s, max(0.0, self.near_m - from_box_m), self.peak_m_s2)
        return [Spell(s.duration_s, -s.v1_m_s, -s.v0_m_s) for s in reversed(part.spells(way_m))]


def _ramp(v0_m_s: float, v1_m_s: float, mean_m_s2: float) -> Spell:
    return Spell(max(abs(v1_m_s - v0_m_s) / mean_m_s2, 1e-9), v0_m_s, v1_m_s)


def closure(t0_ns: int, start_m: Vec, closing: Closure) -> LinePath:
    """Return the way from rest at ``start_m`` (3,) to rest at the box."""
    way_m = float(np.sqrt(start_m @ start_m))
    along = -start_m / way_m if way_m > 0.0 else np.zeros(3)
    return LinePath(t0_ns, start_m, along, tuple(closing.spells(way_m)))


def retreat(t0_ns: int, now: Reference, to_m: Vec, closing: Closure) -> LinePath:
    """Return the way back to rest at ``to_m`` (3,) from a reference on the line from there to the box.

    A speed towards the box is taken away first, with the same smoothness; then it backs off, slow at first when near.
    """
    way = now.p_m - to_m
    span_m = float(np.sqrt(to_m @ to_m))
    along = -to_m / span_m
    brake = _ramp(max(0.0, float(now.v_m_s @ along)), 0.0, closing.peak_m_s2 / RAMP)
    back_m = max(0.0, float(way @ along)) + brake.way_m
    spells = (brake, *closing.back_spells(back_m, max(0.0, span_m - back_m)))
    return LinePath(t0_ns, to_m + along * (back_m - brake.way_m), along, spells)


def back_off(t0_ns: int, start_m: Vec, to_m: Vec, closing: Closure) -> LinePath:
    """Return the way from rest at ``start_m`` (3,) to rest at ``to_m`` (3,), slow as long as the box is near."""
    way = start_m - to_m
    way_m = float(np.sqrt(way @ way))
    along = way / way_m if way_m > 0.0 else np.zeros(3)
    return LinePath(t0_ns, start_m, along, tuple(closing.back_spells(way_m, float(np.sqrt(start_m @ start_m)))))


def cubic(
    t0_ns: int, start_m: Vec, end_m: Vec, peak_m_s: float, peak_m_s2: float, least_s: float = 1.0
) -> CubicPath:
    """Return the cubic of ``least_s``, or of as much longer as its peak speed and acceleration ask for."""
    way = end_m - start_m
    way_m = float(np.sqrt(way @ way))
    duration_s = max(least_s, 1.5 * way_m / peak_m_s, math.sqrt(6.0 * way_m / peak_m_s2))
    return CubicPath(t0_ns, start_m, end_m, duration_s)


def station(p_m: Vec) -> Reference:
    """Return the reference that stands still at a point."""
    return Reference(p_m, np.zeros(3), np.zeros(3))
