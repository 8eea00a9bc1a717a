"""Maximum-likelihood pose, compiled: normal equations, Levenberg-Marquardt, covariance (see ``refinement``).

Rules
-----
* A pose is moved from the left: t + d[:3] and exp(d[3:]) R, d = (translation in m, rotation in rad), camera axes.
* Of symmetric matrices (6, 6) the lower triangle is written and read, except in what is handed out.
* The answer is one flat array: the head below, then the squared residuals (n,) and the studentised ones (n,).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.small_systems import attitude_error, factor, invert, is_rotation, move, solve

OK, NOT_FINITE, BAD_SIGMA, NOT_A_ROTATION, BAD_ATTITUDE, WEAK, BAD_START = range(7)

ROTATION, TRANSLATION, COVARIANCE = 0, 9, 12
STATUS, CHI2, IMAGE, NEAREST, ITERATIONS, SETTLED = 48, 49, 50, 51, 52, 53
HEAD = 54
"""Places in the flat answer, the six from STATUS on in this order: IMAGE is the sum of the squared distances on z = 1,
NEAREST the smallest depth in m."""

SMALL_STEP = 1e-9
"""A step is not worth taking when chi2 would fall by less than this part of 1 + chi2.

With chi2 at its usual dozen that is a ten-thousandth of a standard deviation of the pose.
"""

MAX_STEPS = 50
FIRST_DAMPING = 1e-2

UNTESTED = 1e-6
"""Share of a marker's own variance in its residual below which the residual tells nothing: the pose follows it."""


@njit(cache=True, nogil=True, error_model="numpy")
def project_marker(p: Vec, R: Mat, t: Vec, J: Mat) -> tuple[float, float, float]:
    """Return u, v and depth of marker p (3,), and write their Jacobian J (2, 6) by the move of the pose."""
    a = R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2]
    b = R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2]
    c = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2]
    depth = c + t[2]
    i = 1.0 / depth
    u, v = (a + t[0]) * i, (b + t[1]) * i
    J[0, 0], J[0, 1], J[0, 2], J[0, 3], J[0, 4], J[0, 5] = i, 0.0, -u * i, -b * u * i, (c + a * u) * i, -b * i
    J[1, 0], J[1, 1], J[1, 2], J[1, 3], J[1, 4], J[1, 5] = 0.0, i, -v * i, -(c + b * v) * i, a * v * i, a * i
    return u, v, depth


@njit(cache=True, nogil=True, error_model="numpy")
def sum_markers(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, N: Mat, g: Vec, J: Mat
) -> tuple[float, float, float]:
    """Write J^T W J into N (6, 6) and J^T W r into g (6,): (r^T W r, squared image error, smallest depth).

    The first is infinite when a marker is not before the camera.
    """
    for r in range(6):
        g[r] = 0.0
        for c in range(r + 1):
            N[r, c] = 0.0
    chi2, image, nearest = 0.0, 0.0, np.inf
    for i in range(points.shape[0]):
        u, v, depth = project_marker(points[i], R, t, J)
        du, dv, w = uv[i, 0] - u, uv[i, 1] - v, 1.0 / (sigma[i] * sigma[i])
        image += du * du + dv * dv
        chi2 += w * (du * du + dv * dv)
        nearest = min(nearest, depth)
        for r in range(6):
            x, y = w * J[0, r], w * J[1, r]
            g[r] += x * du + y * dv
            for c in range(r + 1):
                N[r, c] += x * J[0, c] + y * J[1, c]
    return (chi2 if nearest > 0.0 else np.inf), image, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def add_attitude(R: Mat, R_prior: Mat, information: Mat, N: Mat, g: Vec) -> float:
    """Add a measured attitude, whose error e has covariance information^-1, to N and g; return e^T information e.

    Infinite near a half turn.
    """
    e, A, weighted = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    if not attitude_error(R, R_prior, e, A):
        return np.inf
    for r in range(3):
        for c in range(3):
            weighted[r, c] = A[0, r] * information[0, c] + A[1, r] * information[1, c] + A[2, r] * information[2, c]
    squared = 0.0
    for r in range(3):
        for c in range(3):
            squared += e[r] * information[r, c] * e[c]
            g[3 + r] -= weighted[r, c] * e[c]
        for c in range(r + 1):
            for k in range(3):
                N[3 + r, 3 + c] += weighted[r, k] * A[k, c]
    return squared


@njit(cache=True, nogil=True, error_model="numpy")
def prepare(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, R_prior: Mat, cov_rotation: Mat, information: Mat
) -> int:
    """Check the arguments of ``refine`` and write the inverse of cov_rotation into ``information`` (3, 3)."""
    status = complaint(points, uv, sigma, R, t, R_prior, cov_rotation)
    if status != OK or R_prior.shape[0] == 0:
        return status
    for i in range(3):
        for j in range(i):
            if abs(cov_rotation[i, j] - cov_rotation[j, i]) > 1e-9 * (cov_rotation[i, i] + cov_rotation[j, j]):
                return BAD_ATTITUDE
    L = np.empty((3, 3))
    if not factor(cov_rotation, 0.0, L):
        return BAD_ATTITUDE
    invert(L, information)
    return OK


@njit(cache=True, nogil=True, error_model="numpy")
def complaint(points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, R_prior: Mat, cov_rotation: Mat) -> int:
    """Say what is wrong with the arguments of ``refine``, or OK."""
    total = 0.0
    for i in range(3):
        total += t[i] + R[i, 0] + R[i, 1] + R[i, 2]
    for i in range(R_prior.shape[0]):
        for j in range(3):
            total += R_prior[i, j] + cov_rotation[i, j]
    for i in range(points.shape[0]):
        total += points[i, 0] + points[i, 1] + points[i, 2] + uv[i, 0] + uv[i, 1] + sigma[i]
    if not np.isfinite(total):
        return NOT_FINITE
    for i in range(sigma.shape[0]):
        if not sigma[i] > 0.0:
            return BAD_SIGMA
    if not is_rotation(R):
        return NOT_A_ROTATION
    return OK if R_prior.shape[0] == 0 or is_rotation(R_prior) else BAD_ATTITUDE


@njit(cache=True, nogil=True, error_model="numpy")
def linearise(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, R_prior: Mat, information: Mat, N: Mat, g: Vec, J: Mat
) -> tuple[float, float, float]:
    """Write the normal equations of markers and attitude at a pose: (chi2, squared image error, smallest depth)."""
    chi2, image, nearest = sum_markers(points, uv, sigma, R, t, N, g, J)
    if R_prior.shape[0] > 0:
        chi2 += add_attitude(R, R_prior, information, N, g)
    return chi2, image, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def take(R_new: Mat, t_new: Vec, N_new: Mat, g_new: Vec, R: Mat, t: Vec, N: Mat, g: Vec) -> None:
    """Copy a pose and its normal equations. (Slice assignments would do, and take seconds to compile.)"""
    for i in range(3):
        t[i] = t_new[i]
        for j in range(3):
            R[i, j] = R_new[i, j]
    for i in range(6):
        g[i] = g_new[i]
        for j in range(i + 1):
            N[i, j] = N_new[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def descend(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, R_prior: Mat, information: Mat, work: Mat, out: Vec
) -> int:
    """Move R, t, in place, to the least chi2 by Levenberg-Marquardt; fill the head of ``out`` but its covariance.

    ``work[:6]`` is left with the normal equations at the end. Steps are Gauss-Newton's while they do what the linear
    model says; damping grows when chi2 falls by less than a quarter of that, and goes when it falls as foretold.
    """
    N, N_new, L, J, g, g_new, d = work[:6], work[6:12], work[12:18], work[18:20], work[20], work[21], work[22]
    R_new, t_new = np.empty((3, 3)), np.empty(3)
    chi2, image, nearest = linearise(points, uv, sigma, R, t, R_prior, information, N, g, J)
    status = OK if np.isfinite(chi2) else BAD_START
    damping, steps, settled = 0.0, 0, False
    while status == OK and steps < MAX_STEPS:
        if not factor(N, 0.0, L):
            status = WEAK
            break
        foretold = solve(L, g, d)
        settled = foretold < SMALL_STEP * (1.0 + chi2)
        if settled:
            break
        if damping > 0.0 and factor(N, damping, L):
            foretold = solve(L, g, d)
        steps += 1
        move(R, t, d, R_new, t_new)
        new = linearise(points, uv, sigma, R_new, t_new, R_prior, information, N_new, g_new, J)
        gain = (chi2 - new[0]) / foretold  # NaN or minus infinity where there is no pose
        if gain > 0.0:
            chi2, image, nearest = new
            take(R_new, t_new, N_new, g_new, R, t, N, g)
        if not gain > 0.25:
            damping = max(5.0 * damping, FIRST_DAMPING)
        elif gain > 0.75:
            damping = 0.1 * damping if damping > FIRST_DAMPING else 0.0
    out[CHI2], out[IMAGE], out[NEAREST] = chi2, image, nearest
    out[ITERATIONS], out[SETTLED] = steps, 1.0 if settled else 0.0
    return status


@njit(cache=True, nogil=True, error_model="numpy")
def refine(points: Mat, uv: Mat, sigma: Vec, R0: Mat, t0: Vec, R_prior: Mat, cov_rotation: Mat) -> Vec:
    """Return the flat answer: the pose that minimises the weighted reprojection error, from R0, t0.

    ``R_prior`` (3, 3) with ``cov_rotation`` (3, 3) is a measured attitude; both (0, 3) for none.
    """
    n = points.shape[0]
    out, work, information = np.full(HEAD + 2 * n, np.nan), np.empty((29, 6)), np.empty((3, 3))
    R, t = R0.copy(), t0.copy()
    status = prepare(points, uv, sigma, R, t, R_prior, cov_rotation, information)
    if status == OK:
        status = descend(points, uv, sigma, R, t, R_prior, information, work, out)
    N, L, J, P = work[:6], work[12:18], work[18:20], work[23:29]
    if status == OK and factor(N, 0.0, L):
        invert(L, P)
        judge_markers(points, uv, sigma, R, t, P, J, out[HEAD : HEAD + n], out[HEAD + n :])
        for i in range(6):
            for j in range(6):
                out[COVARIANCE + 6 * i + j] = P[i, j]
    for i in range(3):
        out[TRANSLATION + i] = t[i]
        for j in range(3):
            out[ROTATION + 3 * i + j] = R[i, j]
    out[STATUS] = status
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def judge_markers(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, P: Mat, J: Mat, squared: Vec, studentised: Vec
) -> None:
    """Write each marker's squared residual over sigma^2 and over its own covariance S = sigma^2 I - J P J^T."""
    for i in range(points.shape[0]):
        u, v, _ = project_marker(points[i], R, t, J)
        du, dv, variance = uv[i, 0] - u, uv[i, 1] - v, sigma[i] * sigma[i]
        squared[i] = (du * du + dv * dv) / variance
        a, b, c = variance, 0.0, variance
        for r in range(6):
            x, y = 0.0, 0.0
            for k in range(6):
                x += P[r, k] * J[0, k]
                y += P[r, k] * J[1, k]
            a -= J[0, r] * x
            b -= J[0, r] * y
            c -= J[1, r] * y
        least = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
        if least > UNTESTED * variance:
            studentised[i] = (c * du * du - 2.0 * b * du * dv + a * dv * dv) / (a * c - b * b)


@njit(cache=True, nogil=True, error_model="numpy")
def bound(
    points: Mat, uv: Mat, sigma: Vec, R: Mat, t: Vec, R_prior: Mat, cov_rotation: Mat, P: Mat
) -> int:
    """Write the covariance of the pose R, t into P (6, 6) and return the status; uv may be anything finite."""
    N, L, J, g, information = np.empty((6, 6)), np.empty((6, 6)), np.empty((2, 6)), np.empty(6), np.empty((3, 3))
    status = prepare(points, uv, sigma, R, t, R_prior, cov_rotation, information)
    if status != OK:
        return status
    chi2, _, _ = linearise(points, uv, sigma, R, t, R_prior, information, N, g, J)
    if not np.isfinite(chi2):
        return BAD_START
    if not factor(N, 0.0, L):
        return WEAK
    invert(L, P)
    return OK
