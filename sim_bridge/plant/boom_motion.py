"""One step of the boom: where its pivot goes, its control loops and actuators, and its motion by Runge-Kutta.

Rules
-----
* ``PRESCRIBED`` holds tanker, receiver and air at the end of the step; inside it the receptacle runs straight and the
  rest stands still. Forces, loops and actuators see what the boom was at its beginning.
* Free, the stick commands rates and the loops hold angles and length: the operator moves a reference, and ruddevators
  and drive follow it (elevation by both surfaces alike, azimuth by their difference). Gains are in units of motion, and
  inertia and dynamic pressure turn them into deflections, so that they are the same at any speed and length. What the
  surfaces' own stiffness in the flow asks for at the reference is added, so that the loops have less to find.
* Latched, angles and length are the receptacle's business: surfaces and drive move until it neither pulls nor pushes.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from companion.geometry import GRAVITY_M_S2
from sim_bridge.plant.boom_dynamics import direction_of, jacobian_of, masses_of
from sim_bridge.plant.boom_forces import INNER_NODES, accelerations, nozzle_force

K_ANGLE, K_ANGLE_RATE, K_ANGLE_SUM = 20.0, 9.0, 30.0
"""Of the boom's angles: rad/s2 per rad, per rad/s, per rad s. About 4 rad/s beside the boom's own 5 in the air."""
K_LENGTH, K_LENGTH_RATE, K_LENGTH_SUM = 30.0, 10.0, 20.0
"""Of its length: m/s2 per m, per m/s, per m s. About 5 rad/s."""
RELIEF_RAD_S = 1.5
"""How fast surfaces and drive take the nozzle's load over."""

Vector = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]


@njit(cache=True, nogil=True)
def rotation(yaw: float, pitch: float, roll: float) -> Rotation:
    """Return R_ned_body by rows."""
    cps, sps, cth, sth = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    cph, sph = math.cos(roll), math.sin(roll)
    return (
        cth * cps, sph * sth * cps - cph * sps, cph * sth * cps + sph * sps,
        cth * sps, sph * sth * sps + cph * cps, cph * sth * sps - sph * cps,
        -sth, sph * cth, cph * cth,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def turned(R: Rotation, x: float, y: float, z: float) -> Vector:
    """Return R x."""
    return (
        R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def turned_back(R: Rotation, x: float, y: float, z: float) -> Vector:
    """Return R^T x."""
    return (
        R[0] * x + R[3] * y + R[6] * z, R[1] * x + R[4] * y + R[7] * z, R[2] * x + R[5] * y + R[8] * z,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Vector:
    """Return a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True, nogil=True)
def advance(par_: Any, given_: Any, s_: Any, seen_: Any, dt_s: float) -> bool:
    """Advance the boom by one step and tell what its operator sees; False when something is no longer finite."""
    par, given, s, seen = par_[0], given_[0], s_[0], seen_[0]
    R_t = rotation(given.t_yaw, given.t_pitch, given.t_roll)
    R_r = rotation(given.r_yaw, given.r_pitch, given.r_roll)
    carry(par, given, s, R_t)
    aim(par, given, s, R_t, R_r)
    if given.latched > 0.0:
        relieve(par, s, seen, dt_s)
    else:
        steer(par, given, s, dt_s)
    move_surfaces(par, s, dt_s)
    integrate(par, given, s, dt_s)
    look(par, given, s, seen, R_t, R_r)
    total = s.theta4 + s.theta5 + s.d6 + s.rate4 + s.rate5 + s.rate6 + s.right + s.left + s.drive
    return math.isfinite(total + seen.gap + seen.pull_along)


@njit(cache=True, nogil=True)
def carry(par: Any, given: Any, s: Any, R_t: Rotation) -> None:
    """Fill in the pivot's motion (thesis eq. 2.2) in tanker axes: velocity through the air, specific force, turning."""
    p, q, r = given.t_p, given.t_q, given.t_r
    s.p, s.q, s.r, s.pd, s.qd, s.rd = p, q, r, given.t_pdot, given.t_qdot, given.t_rdot
    x, y, z = par.pivot_x, par.pivot_y, par.pivot_z
    u, v, w = turned_back(R_t, given.t_vn, given.t_ve, given.t_vd)
    sx, sy, sz = cross(p, q, r, x, y, z)
    cx, cy, cz = cross(p, q, r, u + sx, v + sy, w + sz)
    dx, dy, dz = cross(s.pd, s.qd, s.rd, x, y, z)
    gx, gy, gz = turned_back(R_t, 0.0, 0.0, GRAVITY_M_S2)
    s.f_x, s.f_y, s.f_z = given.t_udot + cx + dx - gx, given.t_vdot + cy + dy - gy, given.t_wdot + cz + dz - gz
    wx, wy, wz = turned_back(R_t, given.wind_n, given.wind_e, given.wind_d)
    s.air_x, s.air_y, s.air_z = u + sx - wx, v + sy - wy, w + sz - wz
    s.density = given.density


@njit(cache=True, nogil=True)
def aim(par: Any, given: Any, s: Any, R_t: Rotation, R_r: Rotation) -> None:
    """Fill in the receptacle from the pivot, its velocity as the tanker sees it, and the receiver's bow wave."""
    ox, oy, oz = turned(R_r, given.at_x, given.at_y, given.at_z)
    x, y, z = turned_back(R_t, given.r_n - given.t_n + ox, given.r_e - given.t_e + oy, given.r_d - given.t_d + oz)
    s.goal_x, s.goal_y, s.goal_z = x - par.pivot_x, y - par.pivot_y, z - par.pivot_z
    tx, ty, tz = cross(given.r_p, given.r_q, given.r_r, given.at_x, given.at_y, given.at_z)
    tx, ty, tz = turned(R_r, tx, ty, tz)
    tx, ty, tz = turned_back(
        R_t, given.r_vn - given.t_vn + tx, given.r_ve - given.t_ve + ty, given.r_vd - given.t_vd + tz
    )
    cx, cy, cz = cross(s.p, s.q, s.r, x, y, z)
    s.goal_vx, s.goal_vy, s.goal_vz = tx - cx, ty - cy, tz - cz
    n, e, d = turned(R_r, given.bow_u0, given.bow_v0, given.bow_w0)
    s.bow_x0, s.bow_y0, s.bow_z0 = turned_back(R_t, n, e, d)
    n, e, d = turned(R_r, given.bow_u1, given.bow_v1, given.bow_w1)
    s.bow_x1, s.bow_y1, s.bow_z1 = turned_back(R_t, n, e, d)


@njit(cache=True, nogil=True)
def authority(par: Any, s: Any) -> tuple[float, float]:
    """Return the moments in N m per rad of both surfaces alike (upwards) and of their difference (to the right)."""
    pressure = 0.5 * s.density * (s.air_x * s.air_x + s.air_y * s.air_y + s.air_z * s.air_z)
    both = 2.0 * pressure * par.area * par.slope * par.at
    return both * par.cos_v, both * par.sin_v


@njit(cache=True, nogil=True)
def weathercock(par: Any, elevation: float, azimuth: float) -> tuple[float, float]:
    """Return the deflections (up, right) with which the surfaces make no lift there, in flow along the tanker."""
    return par.rigged - math.atan(math.tan(elevation) * par.cos_v), math.atan(math.tan(azimuth) * par.sin_v)


@njit(cache=True, nogil=True)
def steer(par: Any, given: Any, s: Any, dt_s: float) -> None:
    """Command surfaces and drive towards the operator's reference."""
    m4, m5, m6 = masses_of(
        s.theta4, s.theta5, s.d6, par.m_outer, par.com_outer, par.m_inner, par.com_inner, par.j_across, par.j_along
    )
    up, right = authority(par, s)
    up_there, right_there = weathercock(par, given.elevation, given.azimuth)
    off = (math.pi - s.theta4) - given.elevation
    wanted = K_ANGLE * off + K_ANGLE_RATE * (-s.rate4 - given.elevation_rate)
    command = up_there + m4 * (wanted + K_ANGLE_SUM * s.sum_e) / max(up, 1.0)
    s.up_command = min(max(command, -par.limit), par.limit)
    if s.up_command == command:
        s.sum_e += off * dt_s
    off = given.azimuth - (s.theta5 + 0.5 * math.pi)
    wanted = K_ANGLE * off + K_ANGLE_RATE * (given.azimuth_rate - s.rate5)
    command = right_there + m5 * (wanted + K_ANGLE_SUM * s.sum_a) / max(right, 1.0)
    s.right_command = min(max(command, -par.limit), par.limit)
    if s.right_command == command:
        s.sum_a += off * dt_s
    off = given.length - s.d6
    wanted = K_LENGTH * off + K_LENGTH_RATE * (given.length_rate - s.rate6)
    command = m6 * (wanted + K_LENGTH_SUM * s.sum_l)
    s.drive = min(max(command, -par.drive_force), par.drive_force)
    if s.drive == command:
        s.sum_l += off * dt_s


@njit(cache=True, nogil=True)
def relieve(par: Any, s: Any, seen: Any, dt_s: float) -> None:
    """Let surfaces and drive take over what the receptacle does to the nozzle; the loops start afresh from there."""
    m4, m5, m6 = masses_of(
        s.theta4, s.theta5, s.d6, par.m_outer, par.com_outer, par.m_inner, par.com_inner, par.j_across, par.j_along
    )
    up, right = authority(par, s)
    share = RELIEF_RAD_S * dt_s
    s.up_command += share * seen.pull_up * s.d6 / max(up, 1.0)
    s.up_command = min(max(s.up_command, -par.limit), par.limit)
    s.right_command += share * seen.pull_right * s.d6 / max(right, 1.0)
    s.right_command = min(max(s.right_command, -par.limit), par.limit)
    s.drive = min(max(s.drive + share * seen.pull_along, -par.drive_force), par.drive_force)
    up_there, right_there = weathercock(par, math.pi - s.theta4, s.theta5 + 0.5 * math.pi)
    s.sum_e = (s.up_command - up_there) * up / (m4 * K_ANGLE_SUM)
    s.sum_a = (s.right_command - right_there) * right / (m5 * K_ANGLE_SUM)
    s.sum_l = s.drive / (m6 * K_LENGTH_SUM)


@njit(cache=True, nogil=True)
def move_surfaces(par: Any, s: Any, dt_s: float) -> None:
    """Move both ruddevators towards their commands: lag, rate limit, stops."""
    share, most = 1.0 - math.exp(-dt_s / par.lag), par.surface_rate * dt_s
    wanted = min(max(s.up_command - s.right_command, -par.limit), par.limit)
    s.right += min(max(share * (wanted - s.right), -most), most)
    wanted = min(max(s.up_command + s.right_command, -par.limit), par.limit)
    s.left += min(max(share * (wanted - s.left), -most), most)


@njit(cache=True, nogil=True)
def integrate(par: Any, given: Any, s: Any, dt_s: float) -> None:
    """Advance coordinates and rates by one step of the classical Runge-Kutta method."""
    x4, x5, x6, v4, v5, v6 = s.theta4, s.theta5, s.d6, s.rate4, s.rate5, s.rate6
    y4, y5, y6, r4, r5, r6 = x4, x5, x6, v4, v5, v6
    at_s = 0.0
    for k in range(4):
        a4, a5, a6 = accelerations(
            par, s, y4, y5, y6, r4, r5, r6, given.latched, given.rest_x, given.rest_y, given.rest_z, dt_s - at_s
        )
        share = dt_s / 6.0 if k in (0, 3) else dt_s / 3.0
        s.theta4, s.theta5, s.d6 = s.theta4 + share * r4, s.theta5 + share * r5, s.d6 + share * r6
        s.rate4, s.rate5, s.rate6 = s.rate4 + share * a4, s.rate5 + share * a5, s.rate6 + share * a6
        at_s = 0.5 * dt_s if k < 2 else dt_s
        y4, y5, y6 = x4 + at_s * r4, x5 + at_s * r5, x6 + at_s * r6
        r4, r5, r6 = v4 + at_s * a4, v5 + at_s * a5, v6 + at_s * a6


@njit(cache=True, nogil=True)
def look(par: Any, given: Any, s: Any, seen: Any, R_t: Rotation, R_r: Rotation) -> None:
    """Fill in ``SEEN``."""
    seen.elevation, seen.azimuth, seen.length = math.pi - s.theta4, s.theta5 + 0.5 * math.pi, s.d6
    seen.elevation_rate, seen.azimuth_rate, seen.length_rate = -s.rate4, s.rate5, s.rate6
    seen.right, seen.left, seen.drive = s.right, s.left, s.drive
    x, y, z, vx, vy, vz = s.goal_x, s.goal_y, s.goal_z, s.goal_vx, s.goal_vy, s.goal_vz
    seen.aim_length = math.sqrt(x * x + y * y + z * z)
    flat2 = max(x * x + z * z, 1e-6)
    seen.aim_azimuth, seen.aim_elevation = math.atan2(y, math.sqrt(flat2)), math.atan2(z, -x)
    seen.aim_length_rate = (x * vx + y * vy + z * vz) / max(seen.aim_length, 1e-3)
    seen.aim_elevation_rate = (z * vx - x * vz) / flat2
    seen.aim_azimuth_rate = (vy - y * seen.aim_length_rate / max(seen.aim_length, 1e-3)) / math.sqrt(flat2)
    seen.relative_speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    tell_gap(par, given, s, seen, R_t)
    tell_box(par, given, s, seen, R_t)
    tell_bow(par, given, s, seen, R_t, R_r)


@njit(cache=True, nogil=True)
def tell_gap(par: Any, given: Any, s: Any, seen: Any, R_t: Rotation) -> None:
    """Fill in how far the nozzle is from the receptacle, and what they do to each other."""
    ax, ay, az = direction_of(s.theta4, s.theta5)
    ex, ey, ez, gx, gy, gz = jacobian_of(s.theta4, s.theta5)
    x, y, z = s.d6 * ax, s.d6 * ay, s.d6 * az
    vx = s.d6 * (s.rate4 * ex + s.rate5 * gx) + s.rate6 * ax
    vy = s.d6 * (s.rate4 * ey + s.rate5 * gy) + s.rate6 * ay
    vz = s.d6 * (s.rate4 * ez + s.rate5 * gz) + s.rate6 * az
    dx, dy, dz = s.goal_x - x, s.goal_y - y, s.goal_z - z
    seen.gap_x, seen.gap_y, seen.gap_z = dx, dy, dz
    seen.gap = math.sqrt(dx * dx + dy * dy + dz * dz)
    opening = dx * (s.goal_vx - vx) + dy * (s.goal_vy - vy) + dz * (s.goal_vz - vz)
    seen.closing = -opening / max(seen.gap, 1e-6)
    fx = fy = fz = 0.0
    if given.latched > 0.0:
        fx, fy, fz = nozzle_force(par, s, x, y, z, vx, vy, vz, given.rest_x, given.rest_y, given.rest_z, 0.0)
    across = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
    seen.pull_along = fx * ax + fy * ay + fz * az
    seen.pull_up = across * (fx * ex + fy * ey + fz * ez)
    seen.pull_right = fx * gx + fy * gy + fz * gz
    seen.force_n, seen.force_e, seen.force_d = turned(R_t, -fx, -fy, -fz)


@njit(cache=True, nogil=True)
def tell_box(par: Any, given: Any, s: Any, seen: Any, R_t: Rotation) -> None:
    """Fill in BR in the psi frame: ``ned`` turned by the tanker's heading."""
    n, e, d = turned(
        R_t, s.goal_x + par.pivot_x - par.box_x, s.goal_y + par.pivot_y - par.box_y,
        s.goal_z + par.pivot_z - par.box_z,
    )
    c, si = math.cos(given.t_yaw), math.sin(given.t_yaw)
    seen.br_x, seen.br_y, seen.br_z = c * n + si * e, c * e - si * n, d


@njit(cache=True, nogil=True)
def tell_bow(par: Any, given: Any, s: Any, seen: Any, R_t: Rotation, R_r: Rotation) -> None:
    """Fill in the receiver's flow, and where on it the two places of the telescope are that feel its bow wave."""
    u, v, w = turned_back(
        R_r, given.r_vn - given.wind_n, given.r_ve - given.wind_e, given.r_vd - given.wind_d
    )
    seen.airspeed, seen.alpha = math.sqrt(u * u + v * v + w * w), math.atan2(w, u)
    ax, ay, az = direction_of(s.theta4, s.theta5)
    shown = max(s.d6 - par.outer_length, 0.0)
    for k in range(2):
        at = par.outer_length + INNER_NODES[k] * shown
        n, e, d = turned(R_t, at * ax - s.goal_x, at * ay - s.goal_y, at * az - s.goal_z)
        x, y, z = turned_back(R_r, n, e, d)
        if k == 0:
            seen.at_x0, seen.at_y0, seen.at_z0 = x + given.at_x, y + given.at_y, z + given.at_z
        else:
            seen.at_x1, seen.at_y1, seen.at_z1 = x + given.at_x, y + given.at_y, z + given.at_z
