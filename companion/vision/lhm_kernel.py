"""Orthogonal iteration, compiled: sums over the points, the iteration, its errors (see ``companion.vision.lhm``).

With points centred, rays v, F_i = v v^T (thesis eq. 6.17) and r = vec(R) row by row:

* t(R) = T r with T (3, 9) = (n I - sum F)^-1 sum F_i (.) p_i (thesis eq. 6.19)
* M(R) = sum F_i (R p_i + t) p_i^T = H r with H (9, 9) (thesis eq. 6.23)
* E(R) = S2 - r.(H r) with S2 = sum |p|^2 (thesis eq. 6.22)

Only a table of 6 by 6 symmetric products is summed over the points.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.absolute_orientation import rotation_closed_form, rotation_quaternion, rotation_svd

MAX_ITERATIONS = 1000
"""The listing has no limit. Warm solves take tens; flat clouds of points with clean data can take hundreds."""

OK, NOT_FINITE, ON_A_LINE, ONE_RAY, NOT_A_ROTATION = range(5)

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Place of element (i, j) of a symmetric 3x3 matrix in the list of its six."""

Iterated = tuple[int, Mat, Vec, int, float, float, bool, bool]


@njit(cache=True, nogil=True, error_model="numpy")
def fold(points: Mat, uv: Mat) -> tuple[int, Mat, Mat, Vec, float, Mat, Mat]:
    """Sum the points into matrices: (status, H (9, 9), T (3, 9), mean (3,), S2, centred points, unit rays (n, 3)).

    ``T`` gives the best translation of a rotation, t = T vec(R) (thesis eq. 6.19).
    """
    n = points.shape[0]
    mean, p, v = centred(points, uv)
    F, f = np.zeros(6), np.empty(6)
    Fp, Fpp, pp = np.zeros((6, 3)), np.zeros((6, 6)), np.zeros(6)
    for i in range(n):
        for j in range(3):
            for k in range(j, 3):
                f[SYMMETRIC[j, k]] = v[i, j] * v[i, k]
                pp[SYMMETRIC[j, k]] += p[i, j] * p[i, k]
        for s in range(6):
            F[s] += f[s]
            for j in range(3):
                Fp[s, j] += f[s] * p[i, j]
                for k in range(j, 3):
                    Fpp[s, SYMMETRIC[j, k]] += f[s] * p[i, j] * p[i, k]
    S2 = pp[0] + pp[3] + pp[5]
    H, T = np.zeros((9, 9)), np.zeros((3, 9))
    status = judge(n, F, pp, S2)
    if status == OK:
        fill(n, F, Fp, Fpp, H, T)
    return status, H, T, mean, S2, p, v


@njit(cache=True, nogil=True, error_model="numpy")
def centred(points: Mat, uv: Mat) -> tuple[Vec, Mat, Mat]:
    """Return the mean (3,) of the points, the points about it, and the unit rays of uv, both (n, 3)."""
    n = points.shape[0]
    mean, p, v = np.zeros(3), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for j in range(3):
            mean[j] += points[i, j] / n
    for i in range(n):
        x, y = uv[i, 0], uv[i, 1]
        norm = np.sqrt(x * x + y * y + 1.0)
        v[i, 0], v[i, 1], v[i, 2] = x / norm, y / norm, 1.0 / norm
        for j in range(3):
            p[i, j] = points[i, j] - mean[j]
    return mean, p, v


@njit(cache=True, nogil=True)
def judge(n: int, F: Vec, pp: Vec, S2: float) -> int:
    """Say whether the sums of ``fold`` can fix a pose."""
    if not (np.isfinite(S2) and np.isfinite(F[0] + F[1] + F[2] + F[3] + F[4] + F[5])):
        return NOT_FINITE
    # Sum of the products of two eigenvalues of the scatter matrix: zero when only one differs from zero.
    minors = pp[0] * pp[3] - pp[1] ** 2 + pp[0] * pp[5] - pp[2] ** 2 + pp[3] * pp[5] - pp[4] ** 2
    if not minors > 1e-12 * S2 * S2:
        return ON_A_LINE
    # n - |sum v v^T| vanishes when all rays are one.
    spread = n * n - (F[0] ** 2 + F[3] ** 2 + F[5] ** 2 + 2 * (F[1] ** 2 + F[2] ** 2 + F[4] ** 2))
    return OK if spread > 1e-14 * n * n else ONE_RAY


@njit(cache=True, nogil=True, error_model="numpy")
def fill(n: int, F: Vec, Fp: Mat, Fpp: Mat, H: Mat, T: Mat) -> None:
    """Write H and T from the sums over the points: T = (n I - F)^-1 Fp, H = Fpp + Fp^T T, reordered."""
    a, b, c, d, e, f = n - F[0], -F[1], -F[2], n - F[3], -F[4], n - F[5]
    inverse = np.empty(6)
    inverse[0], inverse[1], inverse[2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[3], inverse[4], inverse[5] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * inverse[0] + b * inverse[1] + c * inverse[2]
    for i in range(3):
        for k in range(3):
            g = inverse[SYMMETRIC[i, k]] / determinant
            for u in range(3):
                for j in range(3):
                    T[i, 3 * u + j] += g * Fp[SYMMETRIC[k, u], j]
    for i in range(3):
        for m in range(3):
            for u in range(3):
                for j in range(3):
                    total = Fpp[SYMMETRIC[i, u], SYMMETRIC[m, j]]
                    for k in range(3):
                        total += Fp[SYMMETRIC[i, k], m] * T[k, 3 * u + j]
                    H[3 * i + m, 3 * u + j] = total


@njit(cache=True, nogil=True)
def rotation_step(m: Vec, r: Vec, method: int) -> None:
    """Write the rotation that maximises tr(R^T M) into r; both (9,)."""
    if method == 0 and rotation_closed_form(m, r):
        return
    M = m.reshape(3, 3)
    R = rotation_quaternion(M) if method == 1 else rotation_svd(M)
    r[:] = R.reshape(9)


@njit(cache=True, nogil=True)
def translation(T: Mat, r: Vec) -> Vec:
    """Return the best translation (3,) of the centred points for r (9,) (thesis eq. 6.19)."""
    t = np.zeros(3)
    for k in range(3):
        for j in range(9):
            t[k] += T[k, j] * r[j]
    return t


@njit(cache=True, nogil=True, error_model="numpy")
def object_error(H: Mat, T: Mat, S2: float, p: Mat, v: Mat, r: Vec, m: Vec) -> float:
    """Write M(R) = H r into m and return the sum of squared object-space errors of r.

    S2 - r.(H r) loses about 1e-15 S2 to cancellation; where that could matter the points are gone through instead.
    """
    product = 0.0
    for i in range(9):
        total = 0.0
        for j in range(9):
            total += H[i, j] * r[j]
        m[i] = total
        product += r[i] * total
    error = S2 - product
    if error > 1e-9 * S2:
        return error
    t = translation(T, r)
    error = 0.0
    for i in range(p.shape[0]):
        x = r[0] * p[i, 0] + r[1] * p[i, 1] + r[2] * p[i, 2] + t[0]
        y = r[3] * p[i, 0] + r[4] * p[i, 1] + r[5] * p[i, 2] + t[1]
        z = r[6] * p[i, 0] + r[7] * p[i, 1] + r[8] * p[i, 2] + t[2]
        along = x * v[i, 0] + y * v[i, 1] + z * v[i, 2]
        error += (x - along * v[i, 0]) ** 2 + (y - along * v[i, 1]) ** 2 + (z - along * v[i, 2]) ** 2
    return error


@njit(cache=True, nogil=True)
def is_rotation(R: Mat) -> bool:
    """Say whether R (3, 3) is a rotation within a hundredth."""
    worst = 0.0
    for i in range(3):
        for j in range(3):
            product = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2] - (1.0 if i == j else 0.0)
            worst = max(worst, abs(product))
    triple = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        + R[0, 1] * (R[1, 2] * R[2, 0] - R[1, 0] * R[2, 2])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return worst < 1e-2 and triple > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def iterate(points: Mat, uv: Mat, R0: Mat, tol: float, epsilon: float, method: int) -> Iterated:
    """Iterate from R0: (status, R, t, iterations, squared object error, squared image error, settled, ahead)."""
    R, t = R0.copy(), np.zeros(3)
    status, H, T, mean, S2, p, v = fold(points, uv)
    if status == OK and not np.isfinite(R0.sum()):
        status = NOT_FINITE
    if status == OK and not is_rotation(R0):
        status = NOT_A_ROTATION
    if status != OK:
        return status, R, t, 0, np.nan, np.nan, False, False
    r, m = R.reshape(9), np.empty(9)
    old = object_error(H, T, S2, p, v, r, m)
    rotation_step(m, r, method)
    new = object_error(H, T, S2, p, v, r, m)
    iterations = 1
    while abs(old - new) > tol * old and new > epsilon and iterations < MAX_ITERATIONS:
        old = new
        rotation_step(m, r, method)
        new = object_error(H, T, S2, p, v, r, m)
        iterations += 1
    settled = not (abs(old - new) > tol * old and new > epsilon)
    t = translation(T, r)
    image, ahead = 0.0, True
    for i in range(p.shape[0]):
        x = r[0] * p[i, 0] + r[1] * p[i, 1] + r[2] * p[i, 2] + t[0]
        y = r[3] * p[i, 0] + r[4] * p[i, 1] + r[5] * p[i, 2] + t[1]
        z = r[6] * p[i, 0] + r[7] * p[i, 1] + r[8] * p[i, 2] + t[2]
        ahead = ahead and z > 0.0
        image += (x / z - uv[i, 0]) ** 2 + (y / z - uv[i, 1]) ** 2
    for k in range(3):
        t[k] -= R[k, 0] * mean[0] + R[k, 1] * mean[1] + R[k, 2] * mean[2]
    return status, R, t, iterations, new, image, settled, ahead
