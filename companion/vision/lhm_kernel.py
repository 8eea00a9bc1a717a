"""Orthogonal iteration, compiled: sums over the points, the iteration, its errors (see ``companion.vision.lhm``).

With points centred, rays v, F_i = v v^T / v^T v (thesis eq. 6.17) and r = vec(R) row by row:

* t(R) = T r with T (3, 9) = (n I - sum F)^-1 sum F_i (.) p_i (thesis eq. 6.19)
* M(R) = sum F_i (R p_i + t) p_i^T = H r with H (9, 9), symmetric (thesis eq. 6.23)
* E(R) = S2 - r.(H r) with S2 = sum |p|^2 (thesis eq. 6.22)

Rules
-----
* Only a table of 6 by 10 products is summed over the points. ``A`` (12, 9) is H with T below it.
* (3, 3) matrices of the inner loop are tuples of nine, which live in registers.
* A kernel that Python calls writes arrays it was given: to hand arrays back costs as much as several iterations.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.absolute_orientation import (
    LARGEST_ROOT,
    Nine,
    rotation_closed_form,
    rotation_quaternion,
    rotation_svd,
)

MAX_ITERATIONS = 1000
"""The listing has no limit. Warm solves take tens; flat clouds of points with clean data can take hundreds."""

OK, WRONG_SHAPE, FEW_POINTS, NOT_FINITE, ON_A_LINE, ONE_RAY, NOT_A_ROTATION = range(7)

SYMMETRIC = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
"""Place of element (i, j) of a symmetric 3x3 matrix in the list of its six."""

Three = tuple[float, float, float]
Folded = tuple[int, Mat, Mat, Three, float]


@njit(cache=True, nogil=True, error_model="numpy")
def fold(points: Mat, uv: Mat) -> Folded:
    """Sum the points into matrices: (status, A (12, 9), centred points (n, 3), their mean, S2)."""
    n = points.shape[0]
    A, p = np.empty((12, 9)), np.empty((n, 3))
    if points.shape[1] != 3 or uv.shape[0] != n or uv.shape[1] != 2:
        return WRONG_SHAPE, A, p, (0.0, 0.0, 0.0), 0.0
    if n < 3:
        return FEW_POINTS, A, p, (0.0, 0.0, 0.0), 0.0
    mx, my, mz = 0.0, 0.0, 0.0
    for i in range(n):
        mx, my, mz = mx + points[i, 0], my + points[i, 1], mz + points[i, 2]
    mx, my, mz = mx / n, my / n, mz / n
    sums, f, b = np.zeros((7, 10)), np.ones(7), np.ones(10)
    for i in range(n):
        x, y, z = points[i, 0] - mx, points[i, 1] - my, points[i, 2] - mz
        u, v = uv[i, 0], uv[i, 1]
        w = 1.0 / (u * u + v * v + 1.0)
        p[i, 0], p[i, 1], p[i, 2] = x, y, z
        b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8], b[9] = x, y, z, x * x, x * y, x * z, y * y, y * z, z * z
        f[0], f[1], f[2], f[3], f[4], f[5] = u * u * w, u * v * w, u * w, v * v * w, v * w, w
        for s in range(7):  # the last row sums the points without their rays
            for c in range(10):
                sums[s, c] += f[s] * b[c]
    status = judge(n, sums)
    if status == OK:
        fill(n, sums, A)
    return status, A, p, (mx, my, mz), sums[6, 4] + sums[6, 7] + sums[6, 9]


@njit(cache=True, nogil=True)
def judge(n: int, sums: Mat) -> int:
    """Say whether the sums of ``fold`` can fix a pose."""
    xx, xy, xz, yy, yz, zz = sums[6, 4], sums[6, 5], sums[6, 6], sums[6, 7], sums[6, 8], sums[6, 9]
    F = sums[:6, 0]
    if not (np.isfinite(xx + yy + zz) and np.isfinite(F[0] + F[1] + F[2] + F[3] + F[4] + F[5])):
        return NOT_FINITE
    # Sum of the products of two eigenvalues of the scatter matrix: zero when only one differs from zero.
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    if not minors > 1e-12 * (xx + yy + zz) ** 2:
        return ON_A_LINE
    # n - |sum v v^T| vanishes when all rays are one.
    spread = n * n - (F[0] ** 2 + F[3] ** 2 + F[5] ** 2 + 2 * (F[1] ** 2 + F[2] ** 2 + F[4] ** 2))
    return OK if spread > 1e-14 * n * n else ONE_RAY


@njit(cache=True, nogil=True, error_model="numpy")
def fill(n: int, sums: Mat, A: Mat) -> None:
    """Write H and T into A from the sums over the points: T = (n I - F)^-1 Fp, H = Fpp + Fp^T T, reordered."""
    a, b, c = n - sums[0, 0], -sums[1, 0], -sums[2, 0]
    d, e, f = n - sums[3, 0], -sums[4, 0], n - sums[5, 0]
    i0, i1, i2 = d * f - e * e, c * e - b * f, b * e - c * d
    i3, i4, i5 = a * f - c * c, b * c - a * e, a * d - b * b
    w = 1.0 / (a * i0 + b * i1 + c * i2)
    i0, i1, i2, i3, i4, i5 = i0 * w, i1 * w, i2 * w, i3 * w, i4 * w, i5 * w
    for u in range(3):
        for j in range(3):
            x, y, z = sums[SYMMETRIC[0][u], 1 + j], sums[SYMMETRIC[1][u], 1 + j], sums[SYMMETRIC[2][u], 1 + j]
            A[9, 3 * u + j] = i0 * x + i1 * y + i2 * z
            A[10, 3 * u + j] = i1 * x + i3 * y + i4 * z
            A[11, 3 * u + j] = i2 * x + i4 * y + i5 * z
    for i in range(3):
        for m in range(3):
            x, y, z = sums[SYMMETRIC[i][0], 1 + m], sums[SYMMETRIC[i][1], 1 + m], sums[SYMMETRIC[i][2], 1 + m]
            for u in range(3):
                for j in range(3):
                    k = 3 * u + j
                    both = x * A[9, k] + y * A[10, k] + z * A[11, k]
                    A[3 * i + m, k] = sums[SYMMETRIC[i][u], 4 + SYMMETRIC[m][j]] + both


@njit(cache=True, nogil=True, forceinline=True)
def row_dot(A: Mat, i: int, r: Nine) -> float:
    """Return row i of A (k, 9) times r."""
    return (
        (A[i, 0] * r[0] + A[i, 1] * r[1] + A[i, 2] * r[2])
        + (A[i, 3] * r[3] + A[i, 4] * r[4] + A[i, 5] * r[5])
        + (A[i, 6] * r[6] + A[i, 7] * r[7] + A[i, 8] * r[8])
    )


@njit(cache=True, nogil=True, forceinline=True)
def times(A: Mat, r: Nine) -> Nine:
    """Return M(R) = H r, row by row (thesis eq. 6.23)."""
    return (
        row_dot(A, 0, r), row_dot(A, 1, r), row_dot(A, 2, r),
        row_dot(A, 3, r), row_dot(A, 4, r), row_dot(A, 5, r),
        row_dot(A, 6, r), row_dot(A, 7, r), row_dot(A, 8, r),
    )  # fmt: skip


@njit(cache=True, nogil=True, forceinline=True)
def dot(a: Nine, b: Nine) -> float:
    """Return tr(A^T B)."""
    return (
        (a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
        + (a[3] * b[3] + a[4] * b[4] + a[5] * b[5])
        + (a[6] * b[6] + a[7] * b[7] + a[8] * b[8])
    )


@njit(cache=True, nogil=True, forceinline=True)
def moved(p: Mat, i: int, r: Nine, t: Three) -> Three:
    """Return R p_i + t."""
    x, y, z = p[i, 0], p[i, 1], p[i, 2]
    return (
        r[0] * x + r[1] * y + r[2] * z + t[0],
        r[3] * x + r[4] * y + r[5] * z + t[1],
        r[6] * x + r[7] * y + r[8] * z + t[2],
    )


@njit(cache=True, nogil=True, forceinline=True)
def translation(A: Mat, r: Nine) -> Three:
    """Return the best translation of the centred points (thesis eq. 6.19)."""
    return row_dot(A, 9, r), row_dot(A, 10, r), row_dot(A, 11, r)


@njit(cache=True, nogil=True)
def error_by_points(A: Mat, p: Mat, uv: Mat, r: Nine) -> float:
    """Return the sum of squared object-space errors of r, point by point (thesis eq. 6.18).

    S2 - r.(H r) loses about 1e-15 S2 to cancellation: this is for where the stopping rule could feel that.
    """
    error, t = 0.0, translation(A, r)
    for i in range(p.shape[0]):
        x, y, z = moved(p, i, r, t)
        u, v = uv[i, 0], uv[i, 1]
        a, b, c = y - v * z, u * z - x, v * x - u * y  # the cross product with the ray (u, v, 1)
        error += (a * a + b * b + c * c) / (u * u + v * v + 1.0)
    return error


@njit(cache=True, nogil=True)
def decomposed(m: Nine, method: int) -> Nine:
    """Return the rotation that maximises tr(R^T M) by a decomposition: SVD for method 0, quaternion for 1."""
    M = np.empty((3, 3))
    M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2] = m
    R = rotation_quaternion(M) if method == 1 else rotation_svd(M)
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@njit(cache=True, nogil=True)
def rotation_step(m: Nine, method: int, guess: float) -> tuple[Nine, float]:
    """Return the rotation that maximises tr(R^T M), and where to start the next closed form."""
    if method == 0:
        found, r, root = rotation_closed_form(m, guess)
        if found:
            return r, root
    return decomposed(m, method), LARGEST_ROOT


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
def settle(
    A: Mat, S2: float, p: Mat, uv: Mat, start: Nine, tol: float, epsilon: float, method: int
) -> tuple[Nine, int, float, bool]:
    """Iterate as the listing does from a rotation: (r, iterations, squared object error, stopping rule met)."""
    r, root, iterations, old = start, LARGEST_ROOT, 0, np.inf
    lost = S2 * max(1e-9, 1e-14 / tol)
    while True:
        m = times(A, r)
        error = S2 - dot(m, r)
        if error < lost:
            error = error_by_points(A, p, uv, r)
        settled = not (abs(old - error) > tol * old and error > epsilon)
        if (settled and iterations > 0) or iterations == MAX_ITERATIONS:
            return r, iterations, error, settled
        old, found = error, False
        if method == 0:
            found, r, root = rotation_closed_form(m, root)
        if not found:
            r, root = decomposed(m, method), LARGEST_ROOT
        iterations += 1


@njit(cache=True, nogil=True, error_model="numpy")
def image_error(p: Mat, uv: Mat, r: Nine, t: Three) -> tuple[float, bool]:
    """Return the sum of squared distances on the plane z = 1 and whether all points are before the camera."""
    squared, ahead = 0.0, True
    for i in range(p.shape[0]):
        x, y, z = moved(p, i, r, t)
        ahead = ahead and z > 1e-9 * (abs(x) + abs(y))  # in the camera's plane but for rounding is not ahead
        u, v = x / z - uv[i, 0], y / z - uv[i, 1]
        squared += u * u + v * v
    return squared, ahead


@njit(cache=True, nogil=True)
def write_pose(r: Nine, shift: Three, mean: Three, R: Mat, t: Vec) -> None:
    """Write the pose of the points as they came, not centred, into R (3, 3) and t (3,)."""
    R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2] = r
    t[0], t[1], t[2] = shift
    for k in range(3):
        t[k] -= R[k, 0] * mean[0] + R[k, 1] * mean[1] + R[k, 2] * mean[2]


@njit(cache=True, nogil=True, error_model="numpy")
def solve_from(
    points: Mat, uv: Mat, R0: Mat, tol: float, epsilon: float, method: int, R: Mat, t: Vec
) -> tuple[int, int, float, float, bool]:
    """Iterate from R0 into R (3, 3) and t (3,): (status, iterations, RMS object error, RMS image error, converged)."""
    status, A, p, mean, S2 = fold(points, uv)
    if status == OK and R0.shape != (3, 3):
        status = NOT_A_ROTATION
    if status == OK and not np.isfinite(R0.sum()):
        status = NOT_FINITE
    if status == OK and not is_rotation(R0):
        status = NOT_A_ROTATION
    if status != OK:
        return status, 0, np.nan, np.nan, False
    start = R0[0, 0], R0[0, 1], R0[0, 2], R0[1, 0], R0[1, 1], R0[1, 2], R0[2, 0], R0[2, 1], R0[2, 2]
    r, iterations, squared, settled = settle(A, S2, p, uv, start, tol, epsilon, method)
    shift = translation(A, r)
    squared_image, ahead = image_error(p, uv, r, shift)
    write_pose(r, shift, mean, R, t)
    n = points.shape[0]
    return status, iterations, np.sqrt(squared / n), np.sqrt(squared_image / n), settled and ahead
