"""The arithmetic of the inner loops at 200 Hz, compiled; ``inner_loops`` says what it is for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from companion.geometry import GRAVITY_M_S2 as G
from companion.geometry import Mat, Vec

INTEGRAL_MAX = 0.1
"""Of the attitude errors, rad s."""
ROLL_MAX = (0.35, 5.0, 40.0)
PITCH_MAX = (0.12, 1.5, 15.0)
"""Limits of the references: rate (rad/s), acceleration, its slope; well inside what flaps of 150 deg/s can follow."""

NEWTON_STEPS = 12
HALVINGS = 12
MISS = (0.02, 0.02, 0.01)
"""Inverse price of the square of a missed roll, pitch and yaw acceleration (rad^2/s^4)."""

# Places in the law's state vector.
ROLL_SUM, PITCH_SUM = 0, 1  # integrals of the attitude errors
GIVEN = 2  # three: angular accelerations that the effectors give by now, by the lag of the design model
ROLL_REF, ROLL_REF_RATE, ROLL_REF_ACC = 5, 6, 7
PITCH_REF, PITCH_REF_RATE, PITCH_REF_ACC, ALPHA_REF = 8, 9, 10, 11  # incidence from trim
PATH, PATH_OFFSET = 12, 13  # flight-path angle in calm air, and what lasts of its difference
STARTED = 14
SURFACES = 15  # nine: deflections from trim that were commanded last
LIFT_ASKED, LIFT_GIVEN = 24, 25  # direct lift by now, by the lag of the design model: asked for from outside; in all
LIFT_GUST = 26  # upward acceleration that neither attitude nor direct lift explain
SIDE = 27  # what lasts of the difference between inertial sideslip and that by the side force: wind
LAW_STATES = 28


class Constants(NamedTuple):
    """What stays: gains, references, effectors. Arrays over the nine surfaces are deflections from trim, rad."""

    dt_s: float
    alpha0: float
    lag_share: float
    K_pitch: Vec  # (5,) over alpha, q, theta, its integral, lagged q'
    K_lateral: Mat  # (2, 7) over beta, p, r, phi, its integral, lagged p', lagged r'
    reference: tuple[float, float, float, float]  # roll frequency, damping, pitch frequency, damping
    L_p: float
    M_alpha: float
    M_q: float
    Z_alpha: float  # positive, 1/s
    moments: Mat  # (3, 9) p', q', r' for a radian of each surface
    squares: Vec  # (9,) inverse costs
    low: Vec
    high: Vec
    slew: Vec  # in one step
    lift: Vec  # for 1 m/s2 upward without moment
    lift_gain: float
    lift_fade: float
    lift_max: float
    gust_share: float  # of the difference that the estimate of the gust follows in one step
    gust_gain: float  # how much of it the flaps cancel
    side_m_s2: float  # side acceleration for a radian of sideslip, negative
    side_share: float


class Motion(NamedTuple):
    """The sensed motion as the loops use it: inertial flow angles, attitude, rates of a coordinated turn.

    ``up`` is the measured upward acceleration.
    """

    speed: float
    alpha: float
    beta: float
    roll: float
    pitch: float
    path: float
    turn_q: float
    turn_r: float
    up: float


@njit(cache=True, nogil=True)
def inner_step(
    roll_cmd: float, pitch_cmd: float, lift_cmd: float, R: Mat, omega: Vec, v_ned: Vec, force: Vec, law: Vec,
    c: Constants, surfaces: Vec,
) -> None:
    """Write deflections from trim into ``surfaces`` (9,); ``law`` (LAW_STATES,) is read and updated."""
    m = sense(R, v_ned, force, law, c)
    if law[STARTED] == 0.0:
        law[STARTED] = 1.0
        law[ROLL_REF], law[PITCH_REF], law[ALPHA_REF], law[PATH] = m.roll, m.pitch, m.alpha - c.alpha0, m.path
    references(roll_cmd, pitch_cmd, law, c)
    p_acc, r_acc = lateral(m, omega, law, c)
    q_acc = longitudinal(m, omega, law, c)
    lift_acc = direct_lift(m, lift_cmd, law, c)
    now = law[SURFACES : SURFACES + 9]
    low = np.maximum(c.low, now - c.slew)
    high = np.minimum(c.high, now + c.slew)
    for i in range(9):
        now[i] = min(max(c.lift[i] * lift_acc, low[i]), high[i])
    allocate(p_acc, q_acc, r_acc, c, low, high, now)
    for a in range(3):
        law[GIVEN + a] += c.lag_share * (moment_of(c.moments, a, now) - law[GIVEN + a])
    surfaces[:] = now


@njit(cache=True, nogil=True)
def sense(R: Mat, v: Vec, force: Vec, law: Vec, c: Constants) -> Motion:
    """Return the motion from attitude (3, 3), inertial velocity (3,) and specific force (3,).

    Sideslip is inertial but for what lasts: in a steady wind, the side force says which part of it is the wind's.
    """
    u = R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2]
    side = R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2]
    w = R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2]
    speed = max(math.sqrt(u * u + side * side + w * w), 1.0)
    roll = math.atan2(R[2, 1], R[2, 2])
    turn_r = G / speed * math.sin(roll)
    turn_q = turn_r * math.tan(clip(roll, 1.2))
    pitch = -math.asin(clip(R[2, 0], 1.0))
    up = -(R[2, 0] * force[0] + R[2, 1] * force[1] + R[2, 2] * force[2]) - G
    beta = math.asin(side / speed)
    wind = beta - force[1] / c.side_m_s2
    if law[STARTED] == 0.0:
        law[SIDE] = wind
    law[SIDE] += c.side_share * (wind - law[SIDE])
    return Motion(speed, math.atan2(w, u), beta - law[SIDE], roll, pitch, -v[2] / speed, turn_q, turn_r, up)


@njit(cache=True, nogil=True)
def clip(value: float, limit: float) -> float:
    """Return ``value`` within +-limit."""
    return min(max(value, -limit), limit)


@njit(cache=True, nogil=True)
def references(roll_cmd: float, pitch_cmd: float, law: Vec, c: Constants) -> None:
    """Advance the references of roll and pitch, and the incidence that goes with the latter."""
    w_roll, z_roll, w_pitch, z_pitch = c.reference
    law[ROLL_REF_ACC] = follow(
        roll_cmd - law[ROLL_REF], law[ROLL_REF_RATE], law[ROLL_REF_ACC], w_roll, z_roll, ROLL_MAX, c.dt_s
    )
    law[PITCH_REF_ACC] = follow(
        pitch_cmd - law[PITCH_REF], law[PITCH_REF_RATE], law[PITCH_REF_ACC], w_pitch, z_pitch, PITCH_MAX, c.dt_s
    )
    law[ROLL_REF_RATE] += c.dt_s * law[ROLL_REF_ACC]
    law[ROLL_REF] += c.dt_s * law[ROLL_REF_RATE]
    law[PITCH_REF_RATE] += c.dt_s * law[PITCH_REF_ACC]
    law[PITCH_REF] += c.dt_s * law[PITCH_REF_RATE]
    law[ALPHA_REF] += c.dt_s * (law[PITCH_REF_RATE] - c.Z_alpha * law[ALPHA_REF])


@njit(cache=True, nogil=True)
def follow(
    error: float, rate: float, acceleration: float, w: float, z: float, limits: tuple[float, float, float], dt_s: float
) -> float:
    """Return the new acceleration of a second-order reference, limited in rate, acceleration and slope."""
    wanted = clip(2.0 * z * w * (clip(w / (2.0 * z) * error, limits[0]) - rate), limits[1])
    return acceleration + clip(wanted - acceleration, limits[2] * dt_s)


@njit(cache=True, nogil=True)
def lateral(m: Motion, omega: Vec, law: Vec, c: Constants) -> tuple[float, float]:
    """Return the roll and yaw accelerations (rad/s2): feed-forward of the reference and LQR about it."""
    lean = math.tan(c.alpha0)  # a roll about the path needs this share of it as yaw
    p_ff = law[ROLL_REF_ACC] - c.L_p * law[ROLL_REF_RATE]
    r_ff = lean * law[ROLL_REF_ACC]
    error = m.roll - law[ROLL_REF]
    law[ROLL_SUM] = clip(law[ROLL_SUM] + c.dt_s * error, INTEGRAL_MAX)
    p_error = omega[0] - law[ROLL_REF_RATE]
    r_error = omega[2] - m.turn_r - lean * law[ROLL_REF_RATE]
    x = (m.beta, p_error, r_error, error, law[ROLL_SUM], law[GIVEN] - p_ff, law[GIVEN + 2] - r_ff)
    for i in range(7):
        p_ff -= c.K_lateral[0, i] * x[i]
        r_ff -= c.K_lateral[1, i] * x[i]
    return p_ff, r_ff


@njit(cache=True, nogil=True)
def longitudinal(m: Motion, omega: Vec, law: Vec, c: Constants) -> float:
    """Return the pitch acceleration (rad/s2): feed-forward of the reference and LQR about it."""
    q_ff = law[PITCH_REF_ACC] - c.M_alpha * law[ALPHA_REF] - c.M_q * law[PITCH_REF_RATE]
    error = m.pitch - law[PITCH_REF]
    law[PITCH_SUM] = clip(law[PITCH_SUM] + c.dt_s * error, INTEGRAL_MAX)
    alpha_error = m.alpha - c.alpha0 - law[ALPHA_REF]
    q_error = omega[1] - m.turn_q - law[PITCH_REF_RATE]
    x = (alpha_error, q_error, error, law[PITCH_SUM], law[GIVEN + 1] - q_ff)
    for i in range(5):
        q_ff -= c.K_pitch[i] * x[i]
    return q_ff


@njit(cache=True, nogil=True)
def direct_lift(m: Motion, lift_cmd: float, law: Vec, c: Constants) -> float:
    """Return the upward acceleration (m/s2) that the flaps should give.

    In calm air attitude gives (g + V Z_alpha (incidence - alpha0 + d)) cos(roll) - g, incidence = (pitch - gamma) /
    cos(roll), and the flaps what is asked of them. The path that follows from this is the reference; d, which lasts
    (wake, speed, mass), is learned at the rate ``lift_fade``. What the accelerometer shows beyond is a gust: the flaps
    take ``gust_gain`` of it, and what is left moves the path from its reference, which they bring back.
    """
    cos = max(math.cos(m.roll), 0.3)
    slope = m.speed * c.Z_alpha
    law[LIFT_ASKED] += c.lag_share * (clip(lift_cmd, c.lift_max) - law[LIFT_ASKED])
    still = (m.pitch - law[PATH]) / cos - c.alpha0 + law[PATH_OFFSET]
    off = m.path - law[PATH]
    law[PATH] += c.dt_s * (((G + slope * still) * cos - G + law[LIFT_ASKED]) / m.speed + c.lift_fade * off)
    now = (m.pitch - m.path) / cos - c.alpha0 + law[PATH_OFFSET]
    beyond = m.up - ((G + slope * now) * cos - G) - law[LIFT_GIVEN]
    law[LIFT_GUST] += c.gust_share * (beyond - law[LIFT_GUST])
    law[PATH_OFFSET] += c.dt_s * c.lift_fade * (off + law[LIFT_GUST] / slope)
    lift = clip(lift_cmd - c.lift_gain * m.speed * off - c.gust_gain * law[LIFT_GUST], c.lift_max)
    law[LIFT_GIVEN] += c.lag_share * (lift - law[LIFT_GIVEN])
    return lift


@njit(cache=True, nogil=True)
def allocate(p_acc: float, q_acc: float, r_acc: float, c: Constants, low: Vec, high: Vec, now: Vec) -> None:
    """Move the deflections ``now`` (9,) so that they give the three angular accelerations with the least moves.

    Exact, with weights 1 / ``squares``, while nothing meets ``low`` or ``high`` (9,). Else the least sum of the moves'
    squares and the ``MISS``-priced squares of what is missed: its optimum is clip(start + squares moments^T y) with
    missed = MISS y, and Newton's method on this piecewise linear equation in three unknowns finds y in a few steps.
    """
    start = now.copy()
    wanted = np.array((p_acc, q_acc, r_acc))
    for a in range(3):
        wanted[a] -= moment_of(c.moments, a, start)
    y = np.zeros(3)
    add_solution(normal_matrix(c.moments, c.squares), wanted, y)
    free = put(y, start, c, low, high, now)
    if (free == c.squares).all():
        return
    missed = residual(y, wanted, start, now, c)
    for _ in range(NEWTON_STEPS):
        M = normal_matrix(c.moments, free)
        for a in range(3):
            M[a, a] += MISS[a]
        step = np.zeros(3)
        add_solution(M, missed, step)
        before = free
        downhill = step[0] * missed[0] + step[1] * missed[1] + step[2] * missed[2]
        for _ in range(HALVINGS):
            free = put(y + step, start, c, low, high, now)
            missed = residual(y + step, wanted, start, now, c)
            if step[0] * missed[0] + step[1] * missed[1] + step[2] * missed[2] >= -0.5 * downhill:
                break
            step *= 0.5
            downhill *= 0.5
        y += step
        if (free == before).all() and np.abs(missed).max() < 1e-9:
            return


@njit(cache=True, nogil=True)
def residual(y: Vec, wanted: Vec, start: Vec, now: Vec, c: Constants) -> Vec:
    """Return what is missed less MISS y, (3,): downhill of a convex function of y, zero at the optimum."""
    out = np.empty(3)
    for a in range(3):
        out[a] = wanted[a] + moment_of(c.moments, a, start) - moment_of(c.moments, a, now) - MISS[a] * y[a]
    return out


@njit(cache=True, nogil=True)
def put(y: Vec, start: Vec, c: Constants, low: Vec, high: Vec, now: Vec) -> Vec:
    """Put ``now`` at clip(start + squares moments^T y); return the squares (9,) with zeros where a limit holds."""
    free = c.squares.copy()
    for i in range(9):
        to = start[i] + free[i] * (c.moments[0, i] * y[0] + c.moments[1, i] * y[1] + c.moments[2, i] * y[2])
        now[i] = min(max(to, low[i]), high[i])
        if now[i] != to:
            free[i] = 0.0
    return free


@njit(cache=True, nogil=True)
def moment_of(moments: Mat, axis: int, now: Vec) -> float:
    """Return the acceleration about one axis that deflections (9,) give."""
    total = 0.0
    for i in range(9):
        total += moments[axis, i] * now[i]
    return total


@njit(cache=True, nogil=True)
def normal_matrix(moments: Mat, free: Vec) -> Mat:
    """Return moments diag(free) moments^T, (3, 3)."""
    M = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for i in range(9):
                M[a, b] += moments[a, i] * free[i] * moments[b, i]
    return M


@njit(cache=True, nogil=True)
def add_solution(M: Mat, b: Vec, x: Vec) -> None:
    """Add to ``x`` (3,) the solution of M s = b by Cramer's rule; M regular."""
    c0 = M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1]
    c1 = M[1, 2] * M[2, 0] - M[1, 0] * M[2, 2]
    c2 = M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0]
    d0, d1 = M[0, 2] * M[2, 1] - M[0, 1] * M[2, 2], M[0, 1] * M[1, 2] - M[0, 2] * M[1, 1]
    d2, d3 = M[0, 0] * M[2, 2] - M[0, 2] * M[2, 0], M[0, 2] * M[1, 0] - M[0, 0] * M[1, 2]
    d4, d5 = M[0, 1] * M[2, 0] - M[0, 0] * M[2, 1], M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    det = M[0, 0] * c0 + M[0, 1] * c1 + M[0, 2] * c2
    x[0] += (b[0] * c0 + b[1] * d0 + b[2] * d1) / det
    x[1] += (b[0] * c1 + b[1] * d2 + b[2] * d3) / det
    x[2] += (b[0] * c2 + b[1] * d4 + b[2] * d5) / det
