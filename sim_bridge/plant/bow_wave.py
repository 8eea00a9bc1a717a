"""The receiver's bow wave: what it does to the air ahead of and above it, where the boom's nozzle and tube are.

Potential flow of two parts. Volume: slender-body sources V dA/ds along the axis (Ashley & Landahl, ch. 6; by Goethert's
rule the distance from the axis counts sqrt(1 - Mach^2) fold), for a body with area A(s) = 4 A_max (s / l) (1 - s / l).
Lift: the horseshoe vortices of a coarse lattice of a triangle with its span and area, their velocity smoothed nearby,
in proportion to sin(alpha); control deflections are left out. Good from about a metre off the skin; nearer, and inside,
it is held.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from companion.geometry import Mat
from sim_bridge.aero.planforms import TIP_M
from sim_bridge.aero.vortex_lattice import Lattice, Trapezoid, uniform

MACH = 0.65
BETA = math.sqrt(1.0 - MACH * MACH)
LENGTH_M = 13.145
"""Of the receiver, nose to tail, which is the root chord of the triangle with its area and span too."""
NOSE_X_M = 7.344
"""Ahead of the centre of mass, as in ``aero.planforms``; written out, since compiled kernels keep it."""
SECTION_M2 = 3.6
"""Largest cross-section: estimated, a centre body 3.5 m wide and 1.3 m deep; the volume is then 32 m3."""
CORE_M = 1.0
"""Within this distance of a lattice vortex its velocity is smoothed: about half a panel."""


def lift_vortices(n_span: int = 3, n_chord: int = 5) -> Mat:
    """Return the horseshoes (n, 7) for one radian at unit speed: left and right end (m, stretched frd), circulation."""
    tip = (NOSE_X_M - LENGTH_M, TIP_M, 0.0)
    right = Trapezoid((NOSE_X_M, 0.0, 0.0), tip, LENGTH_M, 0.0, n_span, n_chord)
    lattice = Lattice([right.mirrored(), right], MACH)
    rise = uniform(1.0, 0.5 * math.pi)
    gamma = lattice.solve_in(lambda points: np.broadcast_to(rise, points.shape)).gamma
    stretch = np.array([1.0 / BETA, 1.0, 1.0])
    return np.column_stack((lattice.left * stretch, lattice.right * stretch, gamma))


_VORTICES = lift_vortices()


def bow_wave_m_s(
    p_frd_m: tuple[float, float, float], airspeed_m_s: float, alpha_rad: float
) -> tuple[float, float, float]:
    """Return the velocity (m/s, receiver's frd) that the receiver adds to the air at a point of its frd (m)."""
    return bow_wave(p_frd_m[0], p_frd_m[1], p_frd_m[2], airspeed_m_s, math.sin(alpha_rad), _VORTICES)


@njit(cache=True, nogil=True)
def bow_wave(
    x: float, y: float, z: float, airspeed: float, sin_alpha: float, vortices: Mat
) -> tuple[float, float, float]:
    """Return (u, v, w) m/s at a point (frd, m) for horseshoes (n, 7) as ``lift_vortices`` gives them."""
    u, radial = body_velocity(x, math.sqrt(y * y + z * z))
    v, w = radial * y, radial * z
    xs = x / BETA
    for k in range(vortices.shape[0]):
        ax, ay, az, bx, by, bz, gamma = vortices[k]
        g = gamma * sin_alpha / (4.0 * math.pi)
        ex, ey, ez = xs - ax, y - ay, z - az
        fx, fy, fz = xs - bx, y - by, z - bz
        e = math.sqrt(ex * ex + ey * ey + ez * ez)
        f = math.sqrt(fx * fx + fy * fy + fz * fz)
        nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        lx, ly, lz = bx - ax, by - ay, bz - az
        along = lx * (ex * f - fx * e) + ly * (ey * f - fy * e) + lz * (ez * f - fz * e)
        size = nx * nx + ny * ny + nz * nz + CORE_M * CORE_M * (lx * lx + ly * ly + lz * lz)
        bound = g * along / (size * e * f + 1e-12)
        left = -g * (e - ex) / ((ey * ey + ez * ez + CORE_M * CORE_M) * e + 1e-12)
        right = g * (f - fx) / ((fy * fy + fz * fz + CORE_M * CORE_M) * f + 1e-12)
        u += bound * nx / BETA
        v += bound * ny + left * ez + right * fz
        w += bound * nz - left * ey - right * fy
    return airspeed * u, airspeed * v, airspeed * w


@njit(cache=True, nogil=True)
def body_velocity(x: float, r: float) -> tuple[float, float]:
    """Return (u, v_r / r) at unit speed of the body's sources at x m forward and r m from the axis.

    Inside the body it is that on its surface.
    """
    behind = NOSE_X_M - x
    share = min(max(behind / LENGTH_M, 0.01), 0.99)
    skin = math.sqrt(4.0 * SECTION_M2 * share * (1.0 - share) / math.pi)
    outside = max(r, skin)
    rho2 = BETA * BETA * outside * outside
    rho = math.sqrt(rho2)
    a = 4.0 * SECTION_M2 / LENGTH_M
    b = -2.0 * a / LENGTH_M
    t0, t1 = -behind, LENGTH_M - behind
    r0, r1 = math.sqrt(t0 * t0 + rho2), math.sqrt(t1 * t1 + rho2)
    here = a + b * behind
    once = 1.0 / r0 - 1.0 / r1
    twice = math.asinh(t1 / rho) - math.asinh(t0 / rho) - t1 / r1 + t0 / r0
    u = (here * once + b * twice) / (4.0 * math.pi)
    radial = BETA * BETA * (here * (t1 / r1 - t0 / r0) / rho2 + b * once) / (4.0 * math.pi)
    return u, radial
