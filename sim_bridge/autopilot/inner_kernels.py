"""The arithmetic of the inner loops at 200 Hz, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

G = 9.80665
LAW_STATES = 14
"""Integrals of roll and pitch error (0, 1), lagged p' q' r' commands (2, 3, 4), calm-air path angle and whether it has started
(5, 6), reference roll and its rate (7, 8), reference pitch, its rate and its incidence from trim (9, 10, 11), whether the
references have started (12), lasting offset of incidence (13)."""
INTEGRAL_MAX = 0.1
ROLL_ACC_MAX = 6.0
PITCH_ACC_MAX = 2.5
"""Of the references (rad/s2): about half of what the flaps can give."""


@njit(cache=True, nogil=True)
def inner_step(  # type: ignore[no-untyped-def]
    roll_cmd, pitch_cmd, R, omega, v_ned, law, K_pitch, K_lateral, model, surfaces, squares, low, high, lift, trim, fixed, out
):
    """Write surface commands into ``out[1:]``; ``law`` (LAW_STATES,) is read and updated. See ``InnerLoops``."""
    dt, alpha0, share, lift_gain, fade, lift_max = fixed
    u = R[0, 0] * v_ned[0] + R[1, 0] * v_ned[1] + R[2, 0] * v_ned[2]
    v = R[0, 1] * v_ned[0] + R[1, 1] * v_ned[1] + R[2, 1] * v_ned[2]
    w = R[0, 2] * v_ned[0] + R[1, 2] * v_ned[1] + R[2, 2] * v_ned[2]
    speed = max(math.sqrt(u * u + v * v + w * w), 1.0)
    pitch = -math.asin(min(max(R[2, 0], -1.0), 1.0))
    roll = math.atan2(R[2, 1], R[2, 2])
    turn = G / speed * math.sin(roll)
    q_turn = turn * math.tan(roll) if abs(roll) < 1.2 else 0.0

    if law[12] == 0.0:
        law[7], law[9], law[12] = roll, pitch, 1.0
    roll_ff, pitch_ff = references(roll_cmd, pitch_cmd, law, model, dt)
    law[0] = clip(law[0] + dt * (roll - law[7]), INTEGRAL_MAX)
    law[1] = clip(law[1] + dt * (pitch - law[9]), INTEGRAL_MAX)
    x = (math.asin(v / speed), omega[0] - law[8], omega[2] - turn, roll - law[7], law[0], law[2] - roll_ff, law[4])
    roll_acc = roll_ff
    yaw_acc = 0.0
    for i in range(7):
        roll_acc -= K_lateral[0, i] * x[i]
        yaw_acc -= K_lateral[1, i] * x[i]
    y = (math.atan2(w, u) - alpha0 - law[11], omega[1] - q_turn - law[10], pitch - law[9], law[1], law[3] - pitch_ff)
    pitch_acc = pitch_ff
    for i in range(5):
        pitch_acc -= K_pitch[i] * y[i]
    law[2] += share * (roll_acc - law[2])
    law[3] += share * (pitch_acc - law[3])
    law[4] += share * (yaw_acc - law[4])

    acceleration = direct_lift(pitch, v_ned[2], speed, law, dt, alpha0, model[7], lift_gain, fade, lift_max)
    for i in range(9):
        out[i + 1] = lift[i] * acceleration
    allocate(roll_acc, pitch_acc, yaw_acc, surfaces, squares, low, high, out)
    for i in range(1, 10):
        out[i] += trim[i]


@njit(cache=True, nogil=True)
def references(roll_cmd, pitch_cmd, law, model, dt):  # type: ignore[no-untyped-def]
    """Advance the second-order references of roll and pitch; return the accelerations that fly them (rad/s2).

    ``model`` is (roll frequency, damping, pitch frequency, damping, L_p, M_alpha, M_q, -Z_alpha).
    """
    w_roll, z_roll, w_pitch, z_pitch, l_p, m_alpha, m_q, z_alpha = model
    p_dot = clip(w_roll * w_roll * (roll_cmd - law[7]) - 2.0 * z_roll * w_roll * law[8], ROLL_ACC_MAX)
    q_dot = clip(w_pitch * w_pitch * (pitch_cmd - law[9]) - 2.0 * z_pitch * w_pitch * law[10], PITCH_ACC_MAX)
    law[8] += dt * p_dot
    law[7] += dt * law[8]
    law[10] += dt * q_dot
    law[9] += dt * law[10]
    law[11] += dt * (law[10] - z_alpha * law[11])
    return p_dot - l_p * law[8], q_dot - m_alpha * law[11] - m_q * law[10]


@njit(cache=True, nogil=True)
def clip(value, limit):  # type: ignore[no-untyped-def]
    """Return ``value`` within +-limit."""
    return min(max(value, -limit), limit)


@njit(cache=True, nogil=True)
def direct_lift(pitch, v_down, speed, law, dt, alpha0, z_alpha, gain, fade, limit):  # type: ignore[no-untyped-def]
    """Return the upward acceleration (m/s2) that the flaps should give.

    In calm air the path angle follows pitch: gamma' = Z_alpha (theta - alpha0 + d - gamma). The observer ``law[5]`` obeys
    this, and learns with the rate ``fade`` what lasts (d, ``law[13]``: wake, speed), so that only gusts are left to the flaps.
    """
    gamma = -v_down / speed
    if law[6] == 0.0:
        law[5] = gamma
        law[6] = 1.0
    innovation = gamma - law[5]
    law[5] += dt * (z_alpha * (pitch - alpha0 + law[13] - law[5]) + fade * innovation)
    law[13] += dt * fade * innovation
    return clip(-gain * speed * innovation, limit)


@njit(cache=True, nogil=True)
def allocate(p_acc, q_acc, r_acc, surfaces, squares, low, high, out):  # type: ignore[no-untyped-def]
    """Add deflections to ``out[1:]`` that give the three angular accelerations, within ``low`` and ``high`` (9,).

    Least squares with weight 1 / ``squares`` over the effectors that are free; those that saturate keep their limit and
    their share goes to the others, three times at most.
    """
    free = squares.copy()
    for i in range(9):
        out[i + 1] = min(max(out[i + 1], low[i]), high[i])
    wanted = np.array((p_acc, q_acc, r_acc))
    M = np.empty((3, 3))
    for _ in range(3):
        for a in range(3):
            for b in range(3):
                total = 0.0
                for i in range(9):
                    total += surfaces[a, i] * free[i] * surfaces[b, i]
                M[a, b] = total
        y0, y1, y2, solved = solve3(M, wanted)
        if not solved:
            return
        again = False
        for i in range(9):
            if free[i] == 0.0:
                continue
            move = free[i] * (surfaces[0, i] * y0 + surfaces[1, i] * y1 + surfaces[2, i] * y2)
            to = out[i + 1] + move
            held = min(max(to, low[i]), high[i])
            if held != to:
                free[i] = 0.0
                again = True
            for a in range(3):
                wanted[a] -= surfaces[a, i] * (held - out[i + 1])
            out[i + 1] = held
        if not again:
            return


@njit(cache=True, nogil=True)
def solve3(M, b):  # type: ignore[no-untyped-def]
    """Return the three unknowns of M x = b by Cramer's rule, and whether M is regular."""
    c0 = M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1]
    c1 = M[1, 2] * M[2, 0] - M[1, 0] * M[2, 2]
    c2 = M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0]
    det = M[0, 0] * c0 + M[0, 1] * c1 + M[0, 2] * c2
    if abs(det) < 1e-9 * abs(M[0, 0] * M[1, 1] * M[2, 2]) or det == 0.0:
        return 0.0, 0.0, 0.0, False
    x = b[0] * c0 + b[1] * (M[0, 2] * M[2, 1] - M[0, 1] * M[2, 2]) + b[2] * (M[0, 1] * M[1, 2] - M[0, 2] * M[1, 1])
    y = b[0] * c1 + b[1] * (M[0, 0] * M[2, 2] - M[0, 2] * M[2, 0]) + b[2] * (M[0, 2] * M[1, 0] - M[0, 0] * M[1, 2])
    z = b[0] * c2 + b[1] * (M[0, 1] * M[2, 0] - M[0, 0] * M[2, 1]) + b[2] * (M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0])
    return x / det, y / det, z / det, True
