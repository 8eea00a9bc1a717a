"""Gauss-Newton on the image error, compiled (see ``companion.vision.glsdc``).

X = (x, y, z, psi, theta, phi): the tanker's origin in the thesis' camera axes (forward, right, down), m, and the angles
in rad of R_crf_tanker = Rx(phi) Ry(theta) Rz(psi) (thesis eq. 5.41).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.absolute_orientation import Nine
from companion.vision.lhm_kernel import NOT_A_ROTATION, NOT_FINITE, OK, WRONG_SHAPE, is_rotation

SETTLED = 1e-3
"""Largest last step of a converged solution: radians, and for the translation its fraction of the distance."""

FEW_MARKERS = 100
"""Status when fewer markers have weight than ``min_markers``; the others are those of ``lhm_kernel``."""

Seen = tuple[float, float, float]


@njit(cache=True, nogil=True)
def attitude(X: Vec) -> tuple[Nine, Nine]:
    """Return R_crf_tanker (thesis eq. 5.41), and its derivative by theta in the first row, the sines in the rest."""
    cps, sps, cth, sth, cph, sph = np.cos(X[3]), np.sin(X[3]), np.cos(X[4]), np.sin(X[4]), np.cos(X[5]), np.sin(X[5])
    R = (
        cth * cps, cth * sps, -sth,
        sph * sth * cps - cph * sps, sph * sth * sps + cph * cps, sph * cth,
        cph * sth * cps + sph * sps, cph * sth * sps - sph * cps, cph * cth,
    )  # fmt: skip
    return R, (-sth * cps, -sth * sps, -cth, sph, cph, 0.0, 0.0, 0.0, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def see(points: Mat, i: int, X: Vec, R: Nine, slope: Nine, J: Mat) -> Seen:
    """Return (u, v, depth) of marker i (thesis eq. 5.49) and write its rows of the Jacobian (5.55) into J (2, 6)."""
    a, b, c = points[i, 0], points[i, 1], points[i, 2]
    x = R[0] * a + R[1] * b + R[2] * c
    y = R[3] * a + R[4] * b + R[5] * c
    z = R[6] * a + R[7] * b + R[8] * c
    depth = x + X[0]
    k = 1.0 / depth
    u, v = (y + X[1]) * k, (z + X[2]) * k
    psi_x, psi_y, psi_z = R[0] * b - R[1] * a, R[3] * b - R[4] * a, R[6] * b - R[7] * a
    theta_x = slope[0] * a + slope[1] * b + slope[2] * c
    J[0, 0], J[0, 1], J[0, 2] = -u * k, k, 0.0
    J[1, 0], J[1, 1], J[1, 2] = -v * k, 0.0, k
    J[0, 3], J[0, 4], J[0, 5] = (psi_y - u * psi_x) * k, (slope[3] * x - u * theta_x) * k, z * k
    J[1, 3], J[1, 4], J[1, 5] = (psi_z - v * psi_x) * k, (slope[4] * x - v * theta_x) * k, -y * k
    return u, v, depth


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    points: Mat, uv: Mat, W: Mat, X: Vec, J: Mat, P: Mat, b: Vec, linearise: bool
) -> tuple[float, float, float]:
    """Write A^T W A, lower half, into P (6, 6) and A^T W (uv - G) into b (6,) (thesis eq. 5.51 to 5.53).

    Returns the squared error, weighted and plain, and the smallest depth. W (n, 2), or (0, 2) for all alike. Only these
    without ``linearise``.
    """
    R, slope = attitude(X)
    P[:], b[:] = 0.0, 0.0
    weighted, plain, nearest = 0.0, 0.0, np.inf
    for i in range(points.shape[0]):
        u, v, depth = see(points, i, X, R, slope, J)
        du, dv, wu, wv = uv[i, 0] - u, uv[i, 1] - v, 1.0, 1.0
        if W.shape[0] > 0:
            wu, wv = W[i, 0], W[i, 1]
        nearest = min(nearest, depth)
        plain += du * du + dv * dv
        weighted += wu * du * du + wv * dv * dv
        if linearise:
            for r in range(6):
                au, av = wu * J[0, r], wv * J[1, r]
                b[r] += au * du + av * dv
                for c in range(r + 1):
                    P[r, c] += au * J[0, c] + av * J[1, c]
    return weighted, plain, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def solve_spd(P: Mat, b: Vec) -> bool:
    """Overwrite b (n,) with P^-1 b by Cholesky, P (n, n), of which the lower half is read, with its factor.

    False when P is not positive definite or the solution is not finite.
    """
    n, size = len(b), 0.0
    for i in range(n):
        scale = P[i, i]
        for j in range(i):
            total = P[i, j]
            for k in range(j):
                total -= P[i, k] * P[j, k]
            P[i, j] = total * P[j, j]
        total = P[i, i]
        for k in range(i):
            total -= P[i, k] * P[i, k]
        if not total > 1e-14 * scale:
            return False
        P[i, i] = 1.0 / np.sqrt(total)  # the inverse of the diagonal is what is needed below
        total = b[i]
        for k in range(i):
            total -= P[i, k] * b[k]
        b[i] = total * P[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, n):
            total -= P[k, i] * b[k]
        b[i] = total * P[i, i]
        size += abs(b[i])
    return np.isfinite(size)


@njit(cache=True, nogil=True, error_model="numpy")
def begin(R_cam: Mat, t_cam: Vec, X: Vec) -> None:
    """Write X of a pose in optical axes. At theta = +-pi/2 phi is 0."""
    X[0], X[1], X[2] = t_cam[2], t_cam[0], t_cam[1]  # thesis: forward, right, down
    sin_theta = -R_cam[2, 2]
    if abs(sin_theta) > 1.0 - 1e-12:
        X[3], X[4], X[5] = np.arctan2(-R_cam[0, 0], R_cam[0, 1]), np.copysign(0.5 * np.pi, sin_theta), 0.0
    else:
        X[3], X[4] = np.arctan2(R_cam[2, 1], R_cam[2, 0]), np.arcsin(sin_theta)
        X[5] = np.arctan2(R_cam[0, 2], R_cam[1, 2])


@njit(cache=True, nogil=True)
def check(points: Mat, uv: Mat, R_init: Mat, t_init: Vec, W: Mat, min_markers: int) -> tuple[int, float]:
    """Return what is wrong with the input, OK for nothing, and the sum of the weights."""
    n = points.shape[0]
    if points.shape[1] != 3 or uv.shape[0] != n or uv.shape[1] != 2:
        return WRONG_SHAPE, 0.0
    if R_init.shape != (3, 3) or t_init.shape != (3,):
        return NOT_A_ROTATION, 0.0
    total, seen, weight = R_init.sum() + t_init[0] + t_init[1] + t_init[2], 0, 0.0
    for i in range(n):
        total += points[i, 0] + points[i, 1] + points[i, 2] + uv[i, 0] + uv[i, 1]
        here = W[i, 0] + W[i, 1] if W.shape[0] > 0 else 2.0
        weight += here
        seen += 1 if here > 0.0 else 0
    if seen < min_markers:
        return FEW_MARKERS, weight
    if not np.isfinite(total):
        return NOT_FINITE, weight
    return OK if is_rotation(R_init) else NOT_A_ROTATION, weight


@njit(cache=True, nogil=True, error_model="numpy")
def correct(
    points: Mat, uv: Mat, R_init: Mat, t_init: Vec, iterations: int, W: Mat, min_markers: int, R_cam: Mat, t_cam: Vec
) -> tuple[int, int, float, bool]:
    """Iterate thesis eq. 5.51 to 5.55 into R_cam (3, 3) and t_cam (3,): (status, done, RMS image error, converged)."""
    status, weight = check(points, uv, R_init, t_init, W, min_markers)
    if status != OK:
        return status, 0, np.nan, False
    work = np.empty((10, 6))
    P, J, X, step = work[:6], work[6:8], work[8], work[9]
    begin(R_init, t_init, X)
    weighted, plain, nearest = normal_equations(points, uv, W, X, J, P, step, iterations > 0)
    at_start, move, turn, regular, done = weighted, 0.0, 0.0, True, 0
    for i in range(iterations):
        regular = solve_spd(P, step)
        for k in range(6):
            regular = regular and np.isfinite(X[k] + step[k])
        if not regular:
            break
        for k in range(6):
            X[k] += step[k]
        move = step[0] ** 2 + step[1] ** 2 + step[2] ** 2
        turn = step[3] ** 2 + step[4] ** 2 + step[5] ** 2
        done += 1
        weighted, plain, nearest = normal_equations(points, uv, W, X, J, P, step, i + 1 < iterations)
    distance = X[0] ** 2 + X[1] ** 2 + X[2] ** 2
    settled = regular and done > 0 and move < SETTLED**2 * distance and turn < SETTLED**2
    improved = weighted <= at_start * (1.0 + 1e-9) + 1e-18 * weight
    R = attitude(X)[0]
    t_cam[0], t_cam[1], t_cam[2] = X[1], X[2], X[0]
    for k in range(3):
        R_cam[0, k], R_cam[1, k], R_cam[2, k] = R[3 + k], R[6 + k], R[k]
    return status, done, np.sqrt(plain / points.shape[0]), settled and improved and nearest > 0.0
