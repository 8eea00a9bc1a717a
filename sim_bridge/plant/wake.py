"""The tanker's wake as increments of the receiver's six coefficients, interpolated over relative position (thesis 3.4).

Rules
-----
* The table is what ``sim_bridge.aero.wake_table`` computes: a vortex model of the tanker in trim and the receiver's
  lattice in it. Position: the receiver's centre of mass from the tanker's, forward, right, down in level axes.
* Between the grid's points cubic along each axis, with slopes by the parabola through three points: continuous, and its
  slopes too. On the left it is the mirror image, bit for bit.
* Outside the grid: that of the nearest point, aft without end (the wake goes on); ahead, aside, above and below it
  fades to nought within ``FADE_M``.
* Increments go with the tanker's circulation over airspeed, which is weight / (rho V^2). That is exact for the lift and
  moments but for the receiver's response to it squared, and for a wake that rolls up and sinks a little faster.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numba import njit

from companion.geometry import GRAVITY_M_S2, Vec
from sim_bridge.plant.fdm import PlantError

TABLE = Path(__file__).parent.parent / "aircraft" / "wake.csv"
REMAKE = "make it with: python -m sim_bridge.aero.wake_table --write"
RHO_V2_PA = 0.66012 * 205.7**2
"""Twice the dynamic pressure at Mach 0.65, 6000 m."""
WEIGHT_OVER_RHO_V2_M2 = 110e3 * GRAVITY_M_S2 / RHO_V2_PA
"""Of the tanker that the table is for."""
FADE_M = 25.0
MIRRORED = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])


class Wake:
    """Wake of a tanker in steady flight."""

    def __init__(self, weight_n: float, density_kg_m3: float, speed_m_s: float, table: Path = TABLE) -> None:
        """Fix the strength; raises PlantError when the table is missing or not whole."""
        self._strength = weight_n / (density_kg_m3 * speed_m_s**2) / WEIGHT_OVER_RHO_V2_M2
        self._x, self._y, self._z, self._values = load_table(table)

    def increments(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float, float, float, float]:
        """Return (dCD, dCL, dCm, dCl, dCn, dCY) for a receiver at (forward, right, down) of the tanker."""
        return interpolate(x_m, y_m, z_m, self._strength, self._x, self._y, self._z, self._values)


@lru_cache(maxsize=4)
def load_table(path: Path) -> tuple[Vec, Vec, Vec, Vec]:
    """Return knots x, y, z (m, increasing, y from left to right) and values (x, y, z, 6)."""
    try:
        rows = np.loadtxt(path, delimiter=",", comments=("#", "x_m"), ndmin=2)
    except (OSError, ValueError) as error:
        msg = f"the wake's table {path} cannot be read ({error}); {REMAKE}"
        raise PlantError(msg) from error
    if rows.shape[1] != 9 or not np.all(np.isfinite(rows)):
        msg = f"the wake's table {path} is not nine columns of finite numbers; {REMAKE}"
        raise PlantError(msg)
    x, y, z = (np.unique(rows[:, k]) for k in range(3))
    places = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    if min(len(x), len(y), len(z)) < 3 or y[0] != 0.0 or not np.array_equal(places, rows[:, :3]):
        msg = f"the wake's table {path} is not a grid with y from 0 and z fastest; {REMAKE}"
        raise PlantError(msg)
    right = rows[:, 3:].reshape(len(x), len(y), len(z), 6)
    left = right[:, :0:-1] * MIRRORED
    return x, np.concatenate((-y[:0:-1], y)), z, np.ascontiguousarray(np.concatenate((left, right), axis=1))


@njit(cache=True, nogil=True)
def interpolate(
    x: float, y: float, z: float, strength: float, xs: Vec, ys: Vec, zs: Vec, values: Vec
) -> tuple[float, float, float, float, float, float]:
    """Return the six increments at a place, ``strength`` times those of the table."""
    side = -1.0 if y < 0.0 else 1.0
    y = abs(y)
    far = max(x - xs[-1], 0.0) + max(y - ys[-1], 0.0) + max(zs[0] - z, 0.0) + max(z - zs[-1], 0.0)
    if far >= FADE_M:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fade = strength * (1.0 - far / FADE_M)
    i, a0, a1, a2, a3 = weights(xs, x)
    j, b0, b1, b2, b3 = weights(ys, y)
    k, c0, c1, c2, c3 = weights(zs, z)
    CD, CL, Cm, Cl, Cn, CY = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p, a in ((max(i - 1, 0), a0), (i, a1), (i + 1, a2), (min(i + 2, xs.size - 1), a3)):
        for q, b in ((max(j - 1, 0), b0), (j, b1), (j + 1, b2), (min(j + 2, ys.size - 1), b3)):
            for r, c in ((max(k - 1, 0), c0), (k, c1), (k + 1, c2), (min(k + 2, zs.size - 1), c3)):
                w = a * b * c
                CD += w * values[p, q, r, 0]
                CL += w * values[p, q, r, 1]
                Cm += w * values[p, q, r, 2]
                Cl += w * values[p, q, r, 3]
                Cn += w * values[p, q, r, 4]
                CY += w * values[p, q, r, 5]
    turned = side * fade
    return fade * CD, fade * CL, fade * Cm, turned * Cl, turned * Cn, turned * CY


@njit(cache=True, nogil=True)
def weights(knots: Vec, at: float) -> tuple[int, float, float, float, float]:
    """Return the cell k and the weights of knots k - 1 to k + 2 at ``at``, which is held within the knots.

    Hermite's cubic; the slope at an inner knot is that of the parabola through it and its neighbours, at the first and
    last that of the straight line.
    """
    last = knots.size - 1
    at = min(max(at, knots[0]), knots[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= at:
            low = middle
        else:
            high = middle
    h = knots[low + 1] - knots[low]
    t = (at - knots[low]) / h
    rise = t * t * (3.0 - 2.0 * t)
    m0, m1 = h * t * (1.0 - t) * (1.0 - t), -h * t * t * (1.0 - t)
    w0, w1, w2, w3 = 0.0, 1.0 - rise, rise, 0.0
    # Slope at the left knot: (h before-slope + g own-slope) / (g + h), g the interval before; likewise on the right.
    own_left, own_right = 1.0, 1.0
    if low > 0:
        g = knots[low] - knots[low - 1]
        own_left = g / (g + h)
        w0 = -m0 * (1.0 - own_left) / g
        w1 -= w0
    if low + 2 <= last:
        g = knots[low + 2] - knots[low + 1]
        own_right = g / (g + h)
        w3 = m1 * (1.0 - own_right) / g
        w2 -= w3
    secant = (m0 * own_left + m1 * own_right) / h
    return low, w0, w1 - secant, w2 + secant, w3
