"""Active forces of the boom's equations, F of thesis eq. 2.1: air on tubes and ruddevators, stops, friction, nozzle.

Rules
-----
* A force on a point of the boom acts on a coordinate through the point's derivative by it (virtual work).
* Tubes by the crossflow principle: the air's component across the axis makes drag like a cylinder across the flow, the
  one along it skin friction. Sound for inclinations well away from zero, as a boom's 20 to 40 degrees.
* A ruddevator lies along the boom at zero deflection but for ``rigged``. Its lift is across the flow, in the plane of
  the boom's axis and its own normal; the lift coefficient bends over smoothly at ``max_lift``. Downwash of one surface
  on the other and the wake of the tube are left out.
* Stops and friction are springs and smooth functions whose fastest motion (30 rad/s) a step of 5 ms follows.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from sim_bridge.plant.boom_dynamics import bias_forces, direction_of, jacobian_of, masses_of

STOP_N_M = 2.0e5
"""Stiffness of the telescope's stops; those of the joints are as stiff at ``STOP_ARM_M``. Estimated: a boom that runs
at 1 m/s into its stop goes 4 cm into it."""
STOP_DAMPING = 7.0e3
STOP_ARM_M = 10.0
SLIP_M_S = 0.02
"""Dry friction is whole from about this speed on; below, it is viscous."""
NODES = (0.1127016653792583, 0.5, 0.8872983346207417)
NODE_WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
"""Gauss-Legendre on 0..1 for the outer tube."""
INNER_NODES = (0.2113248654051871, 0.7886751345948129)
"""The same for what the telescope shows of itself; each has half of it."""

Forces = tuple[float, float, float]


@njit(cache=True, nogil=True)
def accelerations(
    par: Any, s: Any, theta4: float, theta5: float, d6: float, rate4: float, rate5: float, rate6: float,
    latched: float, rest_x: float, rest_y: float, rest_z: float, before_end_s: float,
) -> Forces:
    """Return theta4'', theta5'', d6'' of the boom there, ``before_end_s`` before the instant that ``s`` tells of."""
    ax, ay, az = direction_of(theta4, theta5)
    ex, ey, ez, gx, gy, gz = jacobian_of(theta4, theta5)
    wx, wy, wz = rate4 * ex + rate5 * gx, rate4 * ey + rate5 * gy, rate4 * ez + rate5 * gz
    f4, f5, f6 = tube_forces(par, s, ax, ay, az, ex, ey, ez, gx, gy, gz, wx, wy, wz, d6, rate6)
    v4, v5 = ruddevator_forces(par, s, ax, ay, az, ex, ey, ez, gx, gy, gz, wx, wy, wz)
    j4, j5, j6 = joint_forces(par, math.pi - theta4, theta5 + 0.5 * math.pi, d6, rate4, rate5, rate6)
    f4, f5, f6 = f4 + v4 + j4, f5 + v5 + j5, f6 + j6 + s.drive
    if latched > 0.0:
        nx, ny, nz = nozzle_force(
            par, s, d6 * ax, d6 * ay, d6 * az, d6 * wx + rate6 * ax, d6 * wy + rate6 * ay, d6 * wz + rate6 * az,
            rest_x, rest_y, rest_z, before_end_s,
        )
        f4 += d6 * (nx * ex + ny * ey + nz * ez)
        f5 += d6 * (nx * gx + ny * gy + nz * gz)
        f6 += nx * ax + ny * ay + nz * az
    m4, m5, m6 = masses_of(
        theta4, theta5, d6, par.m_outer, par.com_outer, par.m_inner, par.com_inner, par.j_across, par.j_along
    )
    h4, h5, h6 = bias_forces(
        theta4, theta5, d6, rate4, rate5, rate6, par.m_outer, par.com_outer, par.m_inner, par.com_inner, par.j_across,
        par.j_along, s.p, s.q, s.r, s.pd, s.qd, s.rd, s.f_x, s.f_y, s.f_z,
    )
    return (f4 - h4) / m4, (f5 - h5) / m5, (f6 - h6) / m6


@njit(cache=True, nogil=True)
def flow_at(
    s: Any, at: float, ax: float, ay: float, az: float, wx: float, wy: float, wz: float, slide: float
) -> Forces:
    """Return the air's velocity past the point ``at`` m along the boom, which slides outwards at ``slide``."""
    x, y, z = at * ax, at * ay, at * az
    return (
        -(s.air_x + s.q * z - s.r * y + at * wx + slide * ax),
        -(s.air_y + s.r * x - s.p * z + at * wy + slide * ay),
        -(s.air_z + s.p * y - s.q * x + at * wz + slide * az),
    )


@njit(cache=True, nogil=True)
def crossflow(
    density: float, cross: float, skin: float, u: float, v: float, w: float, ax: float, ay: float, az: float
) -> tuple[float, float, float, float]:
    """Return the force on a metre of tube across its axis (tanker axes) and along it, outwards, in N/m."""
    along = u * ax + v * ay + w * az
    nx, ny, nz = u - along * ax, v - along * ay, w - along * az
    across = 0.5 * density * cross * math.sqrt(nx * nx + ny * ny + nz * nz)
    drag = 0.5 * density * skin * math.sqrt(u * u + v * v + w * w) * along
    return across * nx, across * ny, across * nz, drag


@njit(cache=True, nogil=True)
def tube_forces(
    par: Any, s: Any, ax: float, ay: float, az: float, ex: float, ey: float, ez: float, gx: float, gy: float,
    gz: float, wx: float, wy: float, wz: float, d6: float, rate6: float,
) -> Forces:
    """Return what the air on both tubes does to the three coordinates."""
    f4 = f5 = f6 = 0.0
    for k in range(3):
        at = NODES[k] * par.outer_length
        u, v, w = flow_at(s, at, ax, ay, az, wx, wy, wz, 0.0)
        x, y, z, _ = crossflow(s.density, par.outer_cross, par.outer_skin, u, v, w, ax, ay, az)
        share = NODE_WEIGHTS[k] * par.outer_length * at
        f4 += share * (x * ex + y * ey + z * ez)
        f5 += share * (x * gx + y * gy + z * gz)
    shown = max(d6 - par.outer_length, 0.0)
    for k in range(2):
        at = par.outer_length + INNER_NODES[k] * shown
        u, v, w = flow_at(s, at, ax, ay, az, wx, wy, wz, rate6)
        if k == 0:
            u, v, w = u + s.bow_x0, v + s.bow_y0, w + s.bow_z0
        else:
            u, v, w = u + s.bow_x1, v + s.bow_y1, w + s.bow_z1
        x, y, z, along = crossflow(s.density, par.inner_cross, par.inner_skin, u, v, w, ax, ay, az)
        share = 0.5 * shown
        f4 += share * at * (x * ex + y * ey + z * ez)
        f5 += share * at * (x * gx + y * gy + z * gz)
        f6 += share * along
    return f4, f5, f6


@njit(cache=True, nogil=True)
def ruddevator_forces(
    par: Any, s: Any, ax: float, ay: float, az: float, ex: float, ey: float, ez: float, gx: float, gy: float,
    gz: float, wx: float, wy: float, wz: float,
) -> tuple[float, float]:
    """Return what both ruddevators do to theta4 and theta5."""
    u, v, w = flow_at(s, par.at, ax, ay, az, wx, wy, wz, 0.0)
    size = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
    f4 = f5 = 0.0
    for side in (1.0, -1.0):
        deflection = s.right if side > 0.0 else s.left
        nx = par.cos_v * size * ex - side * par.sin_v * gx
        ny = par.cos_v * size * ey - side * par.sin_v * gy
        nz = par.cos_v * size * ez - side * par.sin_v * gz
        along, across = u * ax + v * ay + w * az, u * nx + v * ny + w * nz
        speed2 = along * along + across * across
        incidence = math.atan2(across, along) - par.rigged + deflection
        lift = par.max_lift * math.tanh(par.slope * incidence / par.max_lift)
        drag = par.drag + par.induced * lift * lift
        force = 0.5 * s.density * par.area * math.sqrt(speed2)
        on_axis, on_normal = force * (drag * along - lift * across), force * (drag * across + lift * along)
        x, y, z = on_axis * ax + on_normal * nx, on_axis * ay + on_normal * ny, on_axis * az + on_normal * nz
        f4 += par.at * (x * ex + y * ey + z * ez)
        f5 += par.at * (x * gx + y * gy + z * gz)
    return f4, f5


@njit(cache=True, nogil=True)
def joint_forces(
    par: Any, elevation: float, azimuth: float, d6: float, rate4: float, rate5: float, rate6: float
) -> Forces:
    """Return what stops and friction do to theta4 (whose rate is that of elevation, reversed), theta5 and d6."""
    arm2 = STOP_ARM_M * STOP_ARM_M
    f4 = -par.hinge * rate4 - arm2 * stop(elevation, -rate4, par.stop_e_low, par.stop_e_high)
    f5 = -par.hinge * rate5 + arm2 * stop(azimuth, rate5, -par.stop_a, par.stop_a)
    f6 = -par.friction * math.tanh(rate6 / SLIP_M_S) + stop(d6, rate6, par.outer_length, par.stop_length)
    return f4, f5, f6


@njit(cache=True, nogil=True)
def stop(value: float, rate: float, low: float, high: float) -> float:
    """Return the force of the stops at ``low`` and ``high``: they push and never pull."""
    if value < low:
        return max(STOP_N_M * (low - value) - STOP_DAMPING * rate, 0.0)
    if value > high:
        return min(STOP_N_M * (high - value) - STOP_DAMPING * rate, 0.0)
    return 0.0


@njit(cache=True, nogil=True)
def nozzle_force(
    par: Any, s: Any, x: float, y: float, z: float, vx: float, vy: float, vz: float, rest_x: float, rest_y: float,
    rest_z: float, before_end_s: float,
) -> Forces:
    """Return what the receptacle does to the nozzle at x, y, z from the pivot: a spring and a damper, tanker axes."""
    return (
        par.stiffness * (s.goal_x - s.goal_vx * before_end_s - x - rest_x) + par.damping * (s.goal_vx - vx),
        par.stiffness * (s.goal_y - s.goal_vy * before_end_s - y - rest_y) + par.damping * (s.goal_vy - vy),
        par.stiffness * (s.goal_z - s.goal_vz * before_end_s - z - rest_z) + par.damping * (s.goal_vz - vz),
    )
