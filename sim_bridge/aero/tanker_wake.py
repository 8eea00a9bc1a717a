"""The air behind the tanker: bound vortices of wing and tailplane, and the sheets that they trail as they roll up.

Axes here are level: x forward along the flight path, y right, z down, from the tanker's centre of mass. Velocities are
in units of the airspeed. All is symmetric, so only right-hand vortices are kept; kernels add their mirror images.

The lattice of the tanker gives the loading along the span of wing and tailplane. Each strip's load becomes one bound
vortex on its quarter-chord line, each edge between strips one trailing filament. Filaments leave the trailing edge and
then move with the air (v / V per metre), all others and the bound vortices acting on them, themselves not: this is the
roll-up, and the sink too. At any x a filament acts as if it were straight along x where it is then, from its bound
vortex to far aft; what it bends within the few metres that count cancels fore and aft to first order. Distances along x
count 1 / sqrt(1 - Mach^2) fold (Goethert).

Cores: v ~ h / (h^2 + core^2), Burnham and Hallock's profile. The core starts at 3.5 % of the span, which is estimated
(between the few per cent that are quoted for rolled-up wakes of airliners and the filaments' spacing), and grows as
Squire has it: core^2 = core0^2 + 4 1.256 a1 Gamma t, a1 = 2e-4 (Bhagwat & Leishman, 2002): 3 % in 100 m.

Left out: the fuselage's displacement and the engines' jets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from sim_bridge.aero.planforms import KC135R, kc135r
from sim_bridge.aero.vortex_lattice import Lattice, Trapezoid
from sim_bridge.plant.wake import WEIGHT_OVER_RHO_V2_M2

MACH = 0.65
BETA = math.sqrt(1.0 - MACH * MACH)
LIFT_COEFFICIENT = WEIGHT_OVER_RHO_V2_M2 / (0.5 * KC135R.area_m2)
"""Of the tanker at 110 t, Mach 0.65, 6000 m: 0.342."""
TAIL_SHARE = -0.05
"""Lift of the tailplane over the weight. Estimated: a wing section's Cm of -0.05 on a mean chord of 6.1 m, balanced
18.6 m behind."""
WASHOUT_RAD = math.radians(2.0)
"""Twist of the wing, root to tip: estimated, that with the least induced drag of this lattice in cruise (by whole
degrees); a swept wing without it would load its tips."""
PITCH_RAD = 0.0276
"""Of the tanker's body in trim; its wing is set at the rest of the incidence."""
CORE_M = 0.035 * KC135R.span_m
GROWTH_M = 4.0 * 1.25643 * 2e-4
"""Of core^2 per metre travelled and m2/s of circulation over airspeed."""
STEP_M = 1.0
END_X_M = -220.0
STRIPS = (24, 12)
"""Along the half span of wing and tailplane."""


@dataclass(frozen=True, slots=True)
class TankerWake:
    """Vortices of the right half, with strengths over airspeed (m).

    ``bound`` (b, 7): left and right end, strength. ``strength``, ``begin`` (f,): of the filaments, and the x where they
    begin. ``path`` (s, f, 2): y and z of each at x = first_x - k STEP_M. ``core2`` (s,): square of the core, m2.
    """

    bound: Mat
    strength: Vec
    begin: Vec
    path: Mat
    core2: Vec
    first_x_m: float

    def velocity(self, points_m: Mat) -> Mat:
        """Return (n, 3), velocities of the air over airspeed (forward, right, down) at points (n, 3)."""
        flat = np.ascontiguousarray(points_m.reshape(-1, 3))
        at = _velocities(flat, self.bound, self.strength, self.begin, self.path, self.core2, self.first_x_m)
        return at.reshape(points_m.shape)


def trimmed_wake() -> TankerWake:
    """Return the wake of the tanker in steady flight."""
    wing, _, tail, *_ = kc135r()
    wing = replace(wing, n_span=STRIPS[0], right_incidence_rad=wing.left_incidence_rad - WASHOUT_RAD)
    tail = replace(tail, n_span=STRIPS[1])
    lattice, gamma = trimmed_circulation(wing, tail)
    bound, edges, first = [], [], 0
    for s in (wing, tail):
        rows = slice(first, first + s.n_span * s.n_chord)
        strip = gamma[rows].reshape(s.n_span, s.n_chord).sum(axis=1)
        left, right = (_quarter_line(ends[rows], s) for ends in (lattice.left, lattice.right))
        bound.append(np.column_stack((left, right, strip)))
        chords = np.linspace(s.left_chord_m, s.right_chord_m, s.n_span + 1)[1:]
        # The edge at y = 0 sheds nothing: what both halves leave there cancels.
        edges.append(np.column_stack((right, right[:, 0] - 0.75 * chords, strip - np.append(strip[1:], 0.0))))
        first = rows.stop
    return _roll_up(np.vstack(bound), np.vstack(edges))


def trimmed_circulation(wing: Trapezoid, tail: Trapezoid) -> tuple[Lattice, Vec]:
    """Return the lattice of right wing, right tail and their images, and circulations over airspeed (n,) m in trim.

    The lift is linear in incidence and elevator, which are found from three flows: together they have the tanker's
    lift, the tail its share of it.
    """
    lattice = Lattice((wing, tail, wing.mirrored(), tail.mirrored()), MACH)
    on_tail = np.tile(np.repeat((0.0, 1.0), (wing.n_span * wing.n_chord, tail.n_span * tail.n_chord)), 2)
    width = (lattice.right - lattice.left)[:, 1]
    ahead, rise = (np.tile(v, (lattice.n, 1)) for v in ((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
    nowhere = np.zeros_like(lattice.force_points)
    step = 0.01
    none = lattice.solve(ahead, nowhere).gamma
    of_incidence = lattice.solve(rise, nowhere).gamma
    of_elevator = (lattice.solve(ahead, nowhere, {"elevator": step}).gamma - none) / step
    flows = np.column_stack((none, of_incidence, of_elevator))
    lift = 2.0 / KC135R.area_m2 * np.array([width, on_tail * width]) @ flows
    trim = np.linalg.solve(lift[:, 1:], LIFT_COEFFICIENT * np.array([1.0, TAIL_SHARE]) - lift[:, 0])
    return lattice, flows @ np.append(1.0, trim)


def _quarter_line(ends: Mat, s: Trapezoid) -> Mat:
    """Return the quarter-chord points (strips, 3), level, from the ends of all bound vortices of a surface."""
    rows = ends.reshape(s.n_span, s.n_chord, 3)
    x, y, z = (rows[:, 0] + 0.25 * (rows[:, -1] - rows[:, 0])).T
    cos, sin = math.cos(PITCH_RAD), math.sin(PITCH_RAD)
    return np.column_stack((x * cos + z * sin, y, z * cos - x * sin))


def _roll_up(bound: Mat, edges: Mat) -> TankerWake:
    """Follow the filaments; ``edges`` (f, 5): where they begin, x of the trailing edge, strength."""
    begin, trailing, strength = np.ascontiguousarray(edges[:, [0, 3, 4]].T)
    first = float(np.ceil(trailing.max()))
    n = round((first - END_X_M) / STEP_M) + 1
    core2 = CORE_M**2 + GROWTH_M * float(bound[:, 6].max()) * STEP_M * np.arange(n, dtype=np.float64)
    path = np.empty((n, len(edges), 2))
    path[0] = edges[:, 1:3]
    for k in range(n - 1):
        x = first - k * STEP_M
        free = (trailing >= x)[:, None]
        middle = path[k] + 0.5 * STEP_M * free * _drift(x, path[k], bound, strength, begin, core2[k])
        path[k + 1] = path[k] + STEP_M * free * _drift(x - 0.5 * STEP_M, middle, bound, strength, begin, core2[k])
    return TankerWake(bound, strength, begin, path, core2, first)


def _drift(x: float, here: Mat, bound: Mat, strength: Vec, begin: Vec, core2: float) -> Mat:
    points = np.column_stack((np.full(len(here), x), here))
    return _velocities(points, bound, strength, begin, here[None], np.array([core2]), x)[:, 1:]


@njit(cache=True, nogil=True)
def _velocities(points: Mat, bound: Mat, strength: Vec, begin: Vec, path: Mat, core2: Vec, first_x: float) -> Mat:
    out = np.empty_like(points)
    last = path.shape[0] - 1
    for i in range(points.shape[0]):
        x, y, z = points[i]
        at = min(max((first_x - x) / STEP_M, 0.0), float(last))
        k = min(int(at), max(last - 1, 0))
        part = at - k
        nearer, next_k = 1.0 - part, min(k + 1, last)
        u, v, w = bound_velocity(x, y, z, bound, core2[0])
        core = nearer * core2[k] + part * core2[next_k]
        for f in range(strength.shape[0]):
            yf = nearer * path[k, f, 0] + part * path[next_k, f, 0]
            dz = z - (nearer * path[k, f, 1] + part * path[next_k, f, 1])
            aft = (begin[f] - x) / BETA
            for side in (1.0, -1.0):
                dy = y - side * yf
                h2 = dy * dy + dz * dz
                reach = 1.0 + aft / math.sqrt(aft * aft + h2 + core)
                strong = side * strength[f] / (4.0 * math.pi * (h2 + core)) * reach
                v += strong * dz
                w -= strong * dy
        out[i, 0], out[i, 1], out[i, 2] = u, v, w
    return out


@njit(cache=True, nogil=True)
def bound_velocity(x: float, y: float, z: float, bound: Mat, core2: float) -> tuple[float, float, float]:
    """Return (u, v, w) over airspeed of the bound vortices (b, 7) and their mirror images."""
    u, v, w = 0.0, 0.0, 0.0
    for k in range(bound.shape[0]):
        ax, ay, az, bx, by, bz, strength = bound[k]
        lx, ly, lz = (bx - ax) / BETA, by - ay, bz - az
        length2 = lx * lx + ly * ly + lz * lz
        ex, ez, fx, fz = (x - ax) / BETA, z - az, (x - bx) / BETA, z - bz
        for side in (1.0, -1.0):
            # The mirror image at y is the vortex itself at -y, with v turned round.
            ey, fy = side * y - ay, side * y - by
            e = math.sqrt(ex * ex + ey * ey + ez * ez)
            f = math.sqrt(fx * fx + fy * fy + fz * fz)
            nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
            along = lx * (ex * f - fx * e) + ly * (ey * f - fy * e) + lz * (ez * f - fz * e)
            size = (nx * nx + ny * ny + nz * nz + core2 * length2) * e * f
            strong = strength * along / (4.0 * math.pi * size + 1e-12)
            u += strong * nx / BETA
            v += side * strong * ny
            w += strong * nz
    return u, v, w
