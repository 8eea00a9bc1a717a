"""Newton's way down the object-space error from any rotation, compiled (see ``companion.vision.lhm_search``)."""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat
from companion.vision.absolute_orientation import LARGEST_ROOT, Nine
from companion.vision.lhm_kernel import Three, dot, rotation_step, times

MAX_STEPS = 60
"""Steps from one start at most; a handful is usual, some tens along a curved valley."""

LONGEST = 0.5
"""Longest Newton step in rad."""

CHEAP_STEPS = 8
"""Where the error is not convex, steps of LHM are taken so many times before eigenvectors are asked for the way."""

SHORTENINGS = 10
"""Times a step is shortened to a quarter until it goes down."""


@njit(cache=True, nogil=True)
def tangents(r: Nine) -> tuple[Nine, Nine, Nine]:
    """Return the derivatives of exp(x) R at x = 0 by the three elements of the rotation vector x."""
    return (
        (0.0, 0.0, 0.0, -r[6], -r[7], -r[8], r[3], r[4], r[5]),
        (r[6], r[7], r[8], 0.0, 0.0, 0.0, -r[0], -r[1], -r[2]),
        (-r[3], -r[4], -r[5], r[0], r[1], r[2], 0.0, 0.0, 0.0),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def newton_step(A: Mat, r: Nine, m: Nine) -> tuple[bool, Three, Three, Three, Three]:
    """Return (convex, x, ...): the rotation vector x for which exp(x) R has the least E in second order, m = H r.

    E = S2 - r.(H r). With a, b, c the tangents and N = M R^T, half of the gradient is -a.m and half of the Hessian is
    -a.(H b) - (N_ab + N_ba) / 2 + delta_ab tr N. Its diagonal, what is beside it, and the gradient follow x.
    """
    a, b, c = tangents(r)
    g = dot(a, m), dot(b, m), dot(c, m)
    Ha, Hb, Hc = times(A, a), times(A, b), times(A, c)
    n00 = m[0] * r[0] + m[1] * r[1] + m[2] * r[2]
    n11 = m[3] * r[3] + m[4] * r[4] + m[5] * r[5]
    n22 = m[6] * r[6] + m[7] * r[7] + m[8] * r[8]
    n01 = m[0] * r[3] + m[1] * r[4] + m[2] * r[5] + m[3] * r[0] + m[4] * r[1] + m[5] * r[2]
    n02 = m[0] * r[6] + m[1] * r[7] + m[2] * r[8] + m[6] * r[0] + m[7] * r[1] + m[8] * r[2]
    n12 = m[3] * r[6] + m[4] * r[7] + m[5] * r[8] + m[6] * r[3] + m[7] * r[4] + m[8] * r[5]
    diagonal = n11 + n22 - dot(a, Ha), n00 + n22 - dot(b, Hb), n00 + n11 - dot(c, Hc)
    beside = -dot(b, Ha) - 0.5 * n01, -dot(c, Ha) - 0.5 * n02, -dot(c, Hb) - 0.5 * n12
    convex, x = solve_three(diagonal, beside, g)
    return convex, x, diagonal, beside, g


@njit(cache=True, nogil=True, error_model="numpy")
def solve_three(diagonal: Three, beside: Three, g: Three) -> tuple[bool, Three]:
    """Return (positive, x) of Q x = g, Q symmetric with the elements 01, 02, 12 beside its diagonal."""
    a, b, c = diagonal
    least = 1e-12 * (abs(a) + abs(b) + abs(c))
    l10, l20 = beside[0] / a, beside[1] / a  # L D L^T
    d1 = b - l10 * beside[0]
    l21 = (beside[2] - l20 * beside[0]) / d1
    d2 = c - l20 * beside[1] - l21 * l21 * d1
    y1 = g[1] - l10 * g[0]
    z = (g[2] - l20 * g[0] - l21 * y1) / d2
    y = y1 / d1 - l21 * z
    return a > least and d1 > least and d2 > least, (g[0] / a - l10 * y - l20 * z, y, z)


@njit(cache=True, nogil=True, error_model="numpy")
def way_down(diagonal: Three, beside: Three, g: Three) -> Three:
    """Return x of Q x = g with the absolute values of the eigenvalues of Q."""
    Q = np.empty((3, 3))
    Q[0, 0], Q[1, 1], Q[2, 2] = diagonal
    Q[1, 0], Q[2, 0], Q[2, 1] = beside
    Q[0, 1], Q[0, 2], Q[1, 2] = beside
    values, axes = np.linalg.eigh(Q)
    least, x, y, z = 1e-12 * (abs(values[0]) + abs(values[2])), 0.0, 0.0, 0.0
    for k in range(3):
        along = axes[0, k] * g[0] + axes[1, k] * g[1] + axes[2, k] * g[2]
        along /= max(abs(values[k]), least)
        x, y, z = x + along * axes[0, k], y + along * axes[1, k], z + along * axes[2, k]
    return x, y, z


@njit(cache=True, nogil=True, error_model="numpy")
def turned(r: Nine, x: Three) -> Nine:
    """Return R turned by about x rad: by the quaternion (1, x / 2), which agrees with exp(x) to second order."""
    a, b, c = 0.5 * x[0], 0.5 * x[1], 0.5 * x[2]
    s = 2.0 / (1.0 + a * a + b * b + c * c)
    q00, q11, q22 = 1.0 - s * (b * b + c * c), 1.0 - s * (a * a + c * c), 1.0 - s * (a * a + b * b)
    q01, q02, q12 = s * (a * b - c), s * (a * c + b), s * (b * c - a)
    q10, q20, q21 = s * (a * b + c), s * (a * c - b), s * (b * c + a)
    return (
        q00 * r[0] + q01 * r[3] + q02 * r[6],
        q00 * r[1] + q01 * r[4] + q02 * r[7],
        q00 * r[2] + q01 * r[5] + q02 * r[8],
        q10 * r[0] + q11 * r[3] + q12 * r[6],
        q10 * r[1] + q11 * r[4] + q12 * r[7],
        q10 * r[2] + q11 * r[5] + q12 * r[8],
        q20 * r[0] + q21 * r[3] + q22 * r[6],
        q20 * r[1] + q21 * r[4] + q22 * r[7],
        q20 * r[2] + q21 * r[5] + q22 * r[8],
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def descend(A: Mat, S2: float, start: Nine) -> tuple[Nine, float, int, bool]:
    """Go down from a rotation: (r, squared object error, steps, r is a minimum)."""
    r, root = start, LARGEST_ROOT
    m = times(A, r)
    error = S2 - dot(m, r)
    for steps in range(1, MAX_STEPS + 1):
        convex, x, diagonal, beside, g = newton_step(A, r, m)
        if not convex:
            if steps <= CHEAP_STEPS:
                r, root = rotation_step(m, 0, root)
                m = times(A, r)
                error = S2 - dot(m, r)
                continue
            x = way_down(diagonal, beside, g)
        far = np.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        w, trial, trial_m, trial_error = min(1.0, LONGEST / far), r, m, error
        for _ in range(SHORTENINGS):
            trial = turned(r, (w * x[0], w * x[1], w * x[2]))
            trial_m = times(A, trial)
            trial_error = S2 - dot(trial_m, trial)
            if trial_error <= error + 1e-14 * S2:
                break
            w *= 0.25
        else:
            return r, error, steps, False
        r, m, error = trial, trial_m, trial_error
        if far < 1e-6:  # the next step would be its square
            return r, error, steps, convex
    return r, error, MAX_STEPS, False
