"""The tanker's wake as increments of the receiver's six coefficients (thesis 3.4).

The thesis interpolates wind-tunnel data that is not public; here the wake is one horseshoe vortex of the tanker's wing.
An elliptic wing of span b sheds Gamma = W / (rho V b') along two lines b' = pi b / 4 apart (Prandtl). Its velocity, by
Biot and Savart with a smoothed core, is taken at strips of the receiver, and strip theory with the receiver's own
derivatives turns it into increments. Sinking and bending of the wake are left out: 0.2 m at the box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numba import njit

SPAN_M = 39.88
"""Of the tanker (public fact sheets)."""
CORE_M = 2.0
"""Radius of the smoothed core: estimated, 5 % of the span."""
BOUND_X_M = 0.0
"""The bound vortex, forward of the tanker's centre of mass: estimated."""


@dataclass(frozen=True, slots=True)
class Receiver:
    """What the increments need to know of the receiver; values of ``aircraft/ice101/ice101.xml``, rad."""

    span_m: float = 11.43
    chord_m: float = 8.76
    CL: float = 0.139
    CL_alpha: float = 2.13
    Cm_alpha: float = -0.060
    Cm_q: float = -0.56
    Cl_beta: float = -0.051
    Cn_beta: float = -0.025
    CY_beta: float = -0.10


def circulation_m2_s(weight_n: float, density_kg_m3: float, speed_m_s: float) -> float:
    """Return Gamma of the horseshoe that carries ``weight_n``."""
    return weight_n / (density_kg_m3 * speed_m_s * math.pi / 4.0 * SPAN_M)


class Wake:
    """Wake of a tanker in steady flight."""

    def __init__(
        self, weight_n: float, density_kg_m3: float, speed_m_s: float, receiver: Receiver | None = None
    ) -> None:
        """Fix the strength of the vortex."""
        r = receiver or Receiver()
        self._gamma = circulation_m2_s(weight_n, density_kg_m3, speed_m_s)
        self._fixed = (r.span_m, r.chord_m, r.CL, r.CL_alpha, r.Cm_alpha, r.Cm_q, r.Cl_beta, r.Cn_beta, r.CY_beta)
        self._speed = speed_m_s

    def increments(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float, float, float, float]:
        """Return (dCD, dCL, dCm, dCl, dCn, dCY) for a receiver at (forward, right, down) of the tanker."""
        return increments(x_m, y_m, z_m, self._gamma, self._speed, self._fixed)


@njit(cache=True, nogil=True)
def trailing(x: float, dy: float, dz: float, gamma: float) -> tuple[float, float]:
    """Return (v, w) of one leg that trails aft from x = BOUND_X_M; ``dy``, ``dz`` from the leg, gamma > 0 turns aft."""
    r2 = dy * dy + dz * dz + CORE_M * CORE_M
    behind = BOUND_X_M - x
    k = gamma / (4.0 * math.pi * r2) * (1.0 + behind / math.sqrt(behind * behind + r2))
    return k * dz, -k * dy


@njit(cache=True, nogil=True)
def bound(x: float, y: float, z: float, half: float, gamma: float) -> float:
    """Return w (down) of the bound vortex between y = -half and y = half; its u is left out."""
    dx = BOUND_X_M - x
    r2 = dx * dx + z * z + CORE_M * CORE_M
    right = (half - y) / math.sqrt((half - y) * (half - y) + r2)
    left = (half + y) / math.sqrt((half + y) * (half + y) + r2)
    return gamma / (4.0 * math.pi * r2) * (right + left) * dx


@njit(cache=True, nogil=True)
def velocity(x: float, y: float, z: float, gamma: float) -> tuple[float, float]:
    """Return the wake's (v right, w down) in m/s at a point (forward, right, down) of the tanker."""
    half = math.pi / 8.0 * SPAN_M
    v_r, w_r = trailing(x, y - half, z, gamma)
    v_l, w_l = trailing(x, y + half, z, -gamma)
    return v_r + v_l, w_r + w_l + bound(x, y, z, half, gamma)


@njit(cache=True, nogil=True)
def increments(
    x: float, y: float, z: float, gamma: float, speed: float, receiver: tuple[float, ...]
) -> tuple[float, float, float, float, float, float]:
    """Return (dCD, dCL, dCm, dCl, dCn, dCY) by strips at +-0.10 and +-0.25 spans and points 0.35 chords fore and aft.

    With these strips a rolling receiver has the Clp of the vortex-lattice run, -0.158.
    """
    span, chord, CL, CL_alpha, Cm_alpha, Cm_q, Cl_beta, Cn_beta, CY_beta = receiver
    alpha = 0.0
    beta = 0.0
    moment = 0.0
    for side in (-1.0, 1.0):
        for share in (0.10, 0.25):
            v, w = velocity(x, y + side * share * span, z, gamma)
            alpha -= 0.25 * w / speed
            beta -= 0.25 * v / speed
            moment += 0.25 * side * share * w / speed
    arm = 0.35 * chord
    _, w_fore = velocity(x + arm, y, z, gamma)
    _, w_aft = velocity(x - arm, y, z, gamma)
    q_hat = 0.5 * chord * (w_fore - w_aft) / (2.0 * arm * speed)
    return (
        -CL * alpha,
        CL_alpha * alpha,
        Cm_alpha * alpha + Cm_q * q_hat,
        CL_alpha * moment + Cl_beta * beta,
        Cn_beta * beta,
        CY_beta * beta,
    )
