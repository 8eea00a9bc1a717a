"""Vortex-lattice method: thin surfaces in any onset flow, subsonic, small angles (Katz & Plotkin, ch. 12).

Each panel carries a horseshoe vortex: bound along the quarter of its chord, legs straight aft (-x). The flow is
tangent to the surface at three quarters of the chord: (onset + induced) . n = 0. Incidence, camber and deflected
controls turn the normals n and leave the panels where they are. Forces by Kutta and Joukowski, rho Gamma V x l with the
local V, on the bound vortices and, unless told otherwise, on the legs as far as they lie on the surface: they bear load
in sideslip.

Compressibility: Goethert's rule. Induced velocities are those of the lattice with x divided by
beta = sqrt(1 - Mach^2) at equal normal wash, so circulations come out as those of the compressible flow, and forces are
taken on the real geometry; in two dimensions this is Prandtl and Glauert's 1/beta.

Axes ``frd``: forward, right, down, metres. Moments, rates and coefficients have the signs of flight dynamics: Cl right
wing down, Cm nose up, Cn nose right, all and CY in body axes; CL and CD across and along the undisturbed stream.
Leading-edge suction is whole (no vortex lift, no separation); thickness and friction are left out. Strips of equal
width reach to the very tip, so the span acts a quarter of a strip too wide at either tip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat, Vec

Point = tuple[float, float, float]
Onset = Callable[[Mat], Mat]
"""Velocity of the air relative to the aircraft, (n, 3) m/s in frd, at points (n, 3) m."""
AFT = np.array([-1.0, 0.0, 0.0])
ON_LINE = 1e-18
"""Square of the sine below which a point counts as lying on a vortex, which induces nothing there."""


@dataclass(frozen=True, slots=True)
class Control:
    """A part of the chord that turns about its hinge.

    ``start`` and ``end``: where it begins and ends, in shares of the chord, at the left and right end of its trapezoid.
    ``gain`` 1: trailing edge down is positive; -1 for leading-edge flaps: leading edge down is positive.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float] = (1.0, 1.0)
    gain: float = 1.0


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """A surface between two chords along x, the first to the left (of a fin: below; lift is then to the left).

    Leading-edge points in frd, chords in m, incidence of either end in rad (nose up), ``camber`` as height of a
    parabolic mean line over chord, ``n_span`` times ``n_chord`` panels of equal shares.
    """

    left_frd_m: Point
    right_frd_m: Point
    left_chord_m: float
    right_chord_m: float
    n_span: int
    n_chord: int
    left_incidence_rad: float = 0.0
    right_incidence_rad: float = 0.0
    camber: float = 0.0
    controls: tuple[Control, ...] = ()

    def mirrored(self) -> Trapezoid:
        """Return its mirror image in y = 0; controls named ``*_r`` become ``*_l`` and the other way round."""
        (lx, ly, lz), (rx, ry, rz) = self.left_frd_m, self.right_frd_m
        other = {"_r": "_l", "_l": "_r"}
        controls = tuple(
            replace(c, name=c.name[:-2] + other.get(c.name[-2:], c.name[-2:]), start=c.start[::-1], end=c.end[::-1])
            for c in self.controls
        )
        return replace(
            self,
            left_frd_m=(rx, -ry, rz),
            right_frd_m=(lx, -ly, lz),
            left_chord_m=self.right_chord_m,
            right_chord_m=self.left_chord_m,
            left_incidence_rad=self.right_incidence_rad,
            right_incidence_rad=self.left_incidence_rad,
            controls=controls,
        )


@dataclass(frozen=True, slots=True)
class Reference:
    """What coefficients refer to; ``point_frd_m`` is where moments are taken and rotations turn about."""

    area_m2: float
    span_m: float
    chord_m: float
    point_frd_m: Point = (0.0, 0.0, 0.0)


class Coefficients(NamedTuple):
    """In the order in which the plant takes the wake's increments."""

    CD: float
    CL: float
    Cm: float
    Cl: float
    Cn: float
    CY: float


class Solution(NamedTuple):
    """Circulations (..., n) in m2/s, positive lifts; force and moment (..., 3) over rho, about the origin of frd."""

    gamma: Mat
    force: Mat
    moment: Mat


class Lattice:
    """All panels of an aircraft; influence coefficients are made once, any number of flows solved after."""

    def __init__(self, surfaces: Sequence[Trapezoid], mach: float = 0.0, legs_bear_load: bool = True) -> None:
        """Make the panels; raises ValueError when there are none or the Mach number is not subsonic."""
        if not surfaces or not 0.0 <= mach < 1.0:
            msg = f"a lattice needs at least one surface and 0 <= Mach < 1, not {len(surfaces)} and {mach}"
            raise ValueError(msg)
        parts = [_panels(s) for s in surfaces]
        self.left, self.right, self.collocation, self._flat, self._hinge, next_l, next_r = (
            np.concatenate([p.arrays[k] for p in parts]) for k in range(7)
        )
        self.n = len(self.left)
        self._gains = _gather_gains(parts, self.n)
        self._beta = math.sqrt(1.0 - mach * mach)
        self._at_collocation = self.influence(self.collocation)
        # Load-bearing segments: bound vortices, then left and right legs as far as the next bound vortex of their strip
        # or the trailing edge; these carry the circulations of all panels ahead.
        upstream = np.zeros((self.n, self.n))
        first = 0
        for p, s in zip(parts, surfaces, strict=True):
            m = len(p.arrays[0])
            upstream[first : first + m, first : first + m] = np.kron(np.eye(s.n_span), np.tri(s.n_chord))
            first += m
        lines = [(self.left, self.right, np.eye(self.n))]
        if legs_bear_load:
            lines += [(next_l, self.left, upstream), (self.right, next_r, upstream)]
        self._segment = np.concatenate([b - a for a, b, _ in lines])
        self.force_points = np.concatenate([0.5 * (a + b) for a, b, _ in lines])
        """(m, 3): the middles of the load-bearing segments, where ``solve`` wants the onset too."""
        self._carried = np.concatenate([c for _, _, c in lines])
        self._at_force = self.influence(self.force_points)

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of all controls."""
        return tuple(self._gains)

    def influence(self, points: Mat) -> Mat:
        """Return the velocities (k, n, 3) at ``points`` (k, 3) of horseshoes with circulation one."""
        stretch = np.array([1.0 / self._beta, 1.0, 1.0])
        p, a, b = points * stretch, self.left * stretch, self.right * stretch
        q = _segment_velocity(p, a, b) + _leg_velocity(p, b) - _leg_velocity(p, a)
        return q * stretch  # d/dx of the potential, too, is 1 / beta of the stretched one's

    def normals(self, deflections: Mapping[str, float] | None = None) -> Mat:
        """Return (n, 3) unit normals with controls turned by the angles given (rad)."""
        angle = np.zeros(self.n)
        for name, rad in (deflections or {}).items():
            if name not in self._gains:
                msg = f"no control {name!r}; there are {', '.join(self._gains) or 'none'}"
                raise ValueError(msg)
            angle = angle + self._gains[name] * rad
        turned = np.cross(self._hinge, self._flat)
        return np.cos(angle)[:, None] * self._flat + np.sin(angle)[:, None] * turned

    def solve(self, at_collocation: Mat, at_force: Mat, deflections: Mapping[str, float] | None = None) -> Solution:
        """Return what onset velocities (..., n, 3), (..., m, 3) m/s at ``collocation``, ``force_points`` cause."""
        normals = self.normals(deflections)
        matrix = np.einsum("ijk,ik->ij", self._at_collocation, normals)
        wash = np.einsum("...ik,ik->...i", at_collocation, normals)
        gamma = np.linalg.solve(matrix, -wash.reshape(-1, self.n).T).T.reshape(wash.shape)
        velocity = at_force + np.einsum("ijk,...j->...ik", self._at_force, gamma, optimize=True)
        forces = (gamma @ self._carried.T)[..., None] * np.cross(velocity, self._segment)
        return Solution(gamma, forces.sum(axis=-2), np.cross(self.force_points, forces).sum(axis=-2))

    def solve_in(self, onset: Onset, deflections: Mapping[str, float] | None = None) -> Solution:
        """Solve in an onset flow that is given as a function of place."""
        return self.solve(onset(self.collocation), onset(self.force_points), deflections)


def uniform(speed_m_s: float, alpha_rad: float, beta_rad: float = 0.0) -> Vec:
    """Return the velocity of the air relative to an aircraft with these flow angles, (3,) m/s in frd."""
    ca, sa, cb, sb = math.cos(alpha_rad), math.sin(alpha_rad), math.cos(beta_rad), math.sin(beta_rad)
    return -speed_m_s * np.array([ca * cb, sb, sa * cb])


def moving(
    speed_m_s: float, alpha_rad: float, beta_rad: float = 0.0, rates_rad_s: Point = (0.0, 0.0, 0.0),
    about_frd_m: Point = (0.0, 0.0, 0.0),
) -> Onset:
    """Return the onset of an aircraft that flies and turns (p, q, r) about a point, in air at rest."""
    stream, omega, about = uniform(speed_m_s, alpha_rad, beta_rad), np.array(rates_rad_s), np.array(about_frd_m)

    def onset(points: Mat) -> Mat:
        return stream - np.cross(omega, points - about)

    return onset


def coefficients(solution: Solution, reference: Reference, speed_m_s: float, alpha_rad: float | Vec) -> Mat:
    """Return (..., 6) in the order of ``Coefficients``; lift and drag about a stream with ``alpha_rad`` (...)."""
    scale = 2.0 / (speed_m_s * speed_m_s * reference.area_m2)
    fx, fy, fz = np.moveaxis(scale * solution.force, -1, 0)
    about = solution.moment - np.cross(np.array(reference.point_frd_m), solution.force)
    roll, pitch, yaw = np.moveaxis(scale * about, -1, 0)
    ca, sa = np.cos(alpha_rad), np.sin(alpha_rad)
    b, c = reference.span_m, reference.chord_m
    return np.stack([-fx * ca - fz * sa, fx * sa - fz * ca, pitch / c, roll / b, yaw / b, fy], axis=-1)


def fly(
    lattice: Lattice, reference: Reference, alpha_rad: float, beta_rad: float = 0.0,
    rates: Point = (0.0, 0.0, 0.0), deflections: Mapping[str, float] | None = None,
) -> Coefficients:
    """Return the coefficients in calm air; ``rates`` are p b / 2V, q c / 2V, r b / 2V."""
    b, c = reference.span_m, reference.chord_m
    omega = (2.0 * rates[0] / b, 2.0 * rates[1] / c, 2.0 * rates[2] / b)
    solution = lattice.solve_in(moving(1.0, alpha_rad, beta_rad, omega, reference.point_frd_m), deflections)
    return Coefficients(*(float(v) for v in coefficients(solution, reference, 1.0, alpha_rad)))


def derivatives(
    lattice: Lattice, reference: Reference, alpha_rad: float, step: float = 1e-3
) -> dict[str, Coefficients]:
    """Return derivatives at ``alpha_rad`` by central differences.

    ``alpha``, ``beta`` and each control by its name per rad; ``p``, ``q``, ``r`` per p b / 2V, q c / 2V, r b / 2V.
    """

    def slope(at: Callable[[float], Coefficients]) -> Coefficients:
        return Coefficients(*(np.subtract(at(step), at(-step)) / (2.0 * step)).tolist())

    found = {
        "alpha": slope(lambda d: fly(lattice, reference, alpha_rad + d)),
        "beta": slope(lambda d: fly(lattice, reference, alpha_rad, d)),
    }
    found["p"] = slope(lambda d: fly(lattice, reference, alpha_rad, rates=(d, 0.0, 0.0)))
    found["q"] = slope(lambda d: fly(lattice, reference, alpha_rad, rates=(0.0, d, 0.0)))
    found["r"] = slope(lambda d: fly(lattice, reference, alpha_rad, rates=(0.0, 0.0, d)))

    def deflected(name: str) -> Coefficients:
        return slope(lambda d: fly(lattice, reference, alpha_rad, deflections={name: d}))

    return found | {name: deflected(name) for name in lattice.control_names}


class _Panels(NamedTuple):
    """Of one trapezoid, strip by strip from left to right, each strip from nose to tail.

    ``arrays``, (n, 3) each: left and right ends of the bound vortices, collocation points, normals, hinge axes, the
    next vertices of the left and right legs. ``gains``: (n,) of each control.
    """

    arrays: tuple[Mat, ...]
    gains: dict[str, NDArray[np.float64]]


def _panels(s: Trapezoid) -> _Panels:
    left, right = np.array(s.left_frd_m), np.array(s.right_frd_m)
    if right[0] == left[0] and right[1] == left[1] and right[2] == left[2]:
        msg = f"trapezoid at {s.left_frd_m} has no span"
        raise ValueError(msg)
    edge = np.linspace(0.0, 1.0, s.n_span + 1)
    row = np.arange(s.n_chord) / s.n_chord

    def at(eta: Vec, share: Vec) -> Mat:
        nose = left + eta[:, None] * (right - left)
        chord = s.left_chord_m + eta * (s.right_chord_m - s.left_chord_m)
        return (nose[:, None] + (chord[:, None] * share)[..., None] * AFT).reshape(-1, 3)

    middle = 0.5 * (edge[1:] + edge[:-1])
    bound, after = row + 0.25 / s.n_chord, np.append(row[1:] + 0.25 / s.n_chord, 1.0)
    collocation = row + 0.75 / s.n_chord
    across = np.cross(AFT, right - left)
    up = np.broadcast_to(across / np.linalg.norm(across), (s.n_span * s.n_chord, 3))
    axis = np.cross(up[0], AFT)  # across the stream, in the surface
    incidence = s.left_incidence_rad + middle * (s.right_incidence_rad - s.left_incidence_rad)
    slope = incidence[:, None] - 4.0 * s.camber * (1.0 - 2.0 * collocation)
    angle = slope.reshape(-1, 1)
    flat = np.cos(angle) * up + np.sin(angle) * np.cross(axis, up)
    hinge = at(edge[1:], collocation) - at(edge[:-1], collocation)
    hinge -= (hinge * up).sum(axis=1, keepdims=True) * up
    hinge /= np.linalg.norm(hinge, axis=1, keepdims=True)
    gains = {c.name: c.gain * _covered(c, middle, row, 1.0 / s.n_chord) for c in s.controls}
    ends = (at(edge[:-1], bound), at(edge[1:], bound), at(middle, collocation))
    return _Panels((*ends, flat, hinge, at(edge[:-1], after), at(edge[1:], after)), gains)


def _covered(c: Control, eta: Vec, row: Vec, length: float) -> Vec:
    """Return the share (n,) of each panel's chord that the control covers."""
    start = c.start[0] + eta * (c.start[1] - c.start[0])
    end = c.end[0] + eta * (c.end[1] - c.end[0])
    overlap = np.minimum(row + length, end[:, None]) - np.maximum(row, start[:, None])
    return (np.clip(overlap, 0.0, length) / length).ravel()


def _gather_gains(parts: Sequence[_Panels], n: int) -> dict[str, NDArray[np.float64]]:
    gains: dict[str, NDArray[np.float64]] = {}
    first = 0
    for p in parts:
        m = len(p.arrays[0])
        for name, gain in p.gains.items():
            gains.setdefault(name, np.zeros(n))[first : first + m] += gain
        first += m
    return gains


def _segment_velocity(p: Mat, a: Mat, b: Mat) -> Mat:
    """Return (k, n, 3) at points p (k, 3) of straight vortices a to b (n, 3), circulation one (Biot and Savart)."""
    ra, rb = p[:, None] - a, p[:, None] - b
    na, nb = np.linalg.norm(ra, axis=-1), np.linalg.norm(rb, axis=-1)
    normal = np.cross(ra, rb)
    size = (normal * normal).sum(axis=-1)
    along = ((b - a) * (ra * nb[..., None] - rb * na[..., None])).sum(axis=-1)
    product = na * nb
    off = size > ON_LINE * product * product
    k = np.divide(along, 4.0 * math.pi * size * product, out=np.zeros_like(size), where=off)
    return k[..., None] * normal


def _leg_velocity(p: Mat, start: Mat) -> Mat:
    """Return (k, n, 3) of half-lines aft from ``start`` (n, 3), vorticity aft, circulation one."""
    r = p[:, None] - start
    size = np.linalg.norm(r, axis=-1)
    normal = np.cross(AFT, r)
    h2 = (normal * normal).sum(axis=-1)
    off = h2 > ON_LINE * size * size
    k = np.divide(size - r[..., 0], 4.0 * math.pi * h2 * size, out=np.zeros_like(size), where=off)
    return k[..., None] * normal
