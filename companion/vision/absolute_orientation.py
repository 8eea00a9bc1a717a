"""Absolute orientation: the rotation and translation between two sets of matched points (thesis 5.1, 6.2.1).

Three kernels solve R = argmax tr(R^T M) over rotations (thesis eq. 6.13) for a (3, 3) matrix M = sum q p^T:

* ``rotation_svd`` by singular values, the thesis' eq. 6.15 as its listing 10.3.2 has it, with a guard: where the thesis
  can answer with a reflection, the axis of the smallest singular value is turned.
* ``rotation_quaternion`` by the largest eigenvalue of Horn's symmetric (4, 4) matrix (Horn 1987).
* ``rotation_closed_form`` by the largest root of that matrix' characteristic polynomial (FOAM, Markley 1993): the same
  rotation as the first two without a decomposition, always proper, and fast enough for the inner loop of LHM.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

from companion.geometry import SE3, Mat

SMALLEST_GAP = 1e-4
"""Below this value of (s1 + s2)(s2 + s3)(s3 + s1) / |M|^3 the closed form loses digits and the SVD takes over."""


@njit(cache=True, nogil=True)
def rotation_svd(M: Mat) -> Mat:
    """Return the rotation (3, 3) that maximises tr(R^T M), by singular values, det R = +1 always."""
    U, _, Vt = np.linalg.svd(M)
    R = U @ Vt
    if np.linalg.det(R) < 0.0:
        U[:, 2] = -U[:, 2]
        R = U @ Vt
    return R


@njit(cache=True, nogil=True)
def rotation_quaternion(M: Mat) -> Mat:
    """Return the rotation (3, 3) that maximises tr(R^T M), by the quaternion of Horn 1987."""
    K = np.empty((4, 4))
    K[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
    K[0, 1] = K[1, 0] = M[2, 1] - M[1, 2]
    K[0, 2] = K[2, 0] = M[0, 2] - M[2, 0]
    K[0, 3] = K[3, 0] = M[1, 0] - M[0, 1]
    for i in range(3):
        for j in range(3):
            K[i + 1, j + 1] = M[i, j] + M[j, i]
        K[i + 1, i + 1] -= K[0, 0]
    _, vectors = np.linalg.eigh(K)
    w, x, y, z = vectors[0, 3], vectors[1, 3], vectors[2, 3], vectors[3, 3]
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@njit(cache=True, nogil=True, error_model="numpy")
def rotation_closed_form(m: Mat, r: Mat) -> bool:
    """Write the rotation that maximises tr(R^T M) into r; both (9,), row by row. False when M is too degenerate.

    With l the sum of the singular values (the last one signed), k = (l^2 - |M|^2) / 2 and C the cofactors of M,
    R = [(k + |M|^2) M + l C - M M^T M] / (k l - det M). l is the largest root of
    (l^2 - |M|^2)^2 - 8 det(M) l - 4 |C|^2, reached from above by Newton's method.
    """
    norm = np.sqrt(np.dot(m, m))
    if not norm > 0.0:
        return False
    a, b, c = m[0] / norm, m[1] / norm, m[2] / norm
    d, e, f = m[3] / norm, m[4] / norm, m[5] / norm
    g, h, i = m[6] / norm, m[7] / norm, m[8] / norm
    ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
    cd, ce, cf = c * h - b * i, a * i - c * g, b * g - a * h
    cg, ch, ci = b * f - c * e, c * d - a * f, a * e - b * d
    det = a * ca + b * cb + c * cc
    cofactors = ca * ca + cb * cb + cc * cc + cd * cd + ce * ce + cf * cf + cg * cg + ch * ch + ci * ci
    root = np.sqrt(3.0)
    for _ in range(50):
        q = root * root - 1.0
        step = (q * q - 8.0 * det * root - 4.0 * cofactors) / (4.0 * root * q - 8.0 * det)
        root -= step
        if not abs(step) > 1e-15:
            break
    k = 0.5 * (root * root - 1.0)
    gap = k * root - det
    if not gap > SMALLEST_GAP:
        return False
    k += 1.0
    # Rows of M M^T, symmetric.
    aa, dd, gg = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i
    ad, ag, dg = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    r[0] = (k * a + root * ca - (aa * a + ad * d + ag * g)) / gap
    r[1] = (k * b + root * cb - (aa * b + ad * e + ag * h)) / gap
    r[2] = (k * c + root * cc - (aa * c + ad * f + ag * i)) / gap
    r[3] = (k * d + root * cd - (ad * a + dd * d + dg * g)) / gap
    r[4] = (k * e + root * ce - (ad * b + dd * e + dg * h)) / gap
    r[5] = (k * f + root * cf - (ad * c + dd * f + dg * i)) / gap
    r[6] = (k * g + root * cg - (ag * a + dg * d + gg * g)) / gap
    r[7] = (k * h + root * ch - (ag * b + dg * e + gg * h)) / gap
    r[8] = (k * i + root * ci - (ag * c + dg * f + gg * i)) / gap
    return True


def absolute_orientation(points_b: Mat, points_a: Mat, method: Literal["svd", "quaternion"] = "svd") -> SE3:
    """Return ``T_a_b`` that takes points (n, 3) of frame b to their matches in frame a (thesis eq. 6.9 to 6.15).

    Minimises the sum of |R p_b + t - p_a|^2 over rotations and translations. Needs three points that are not on a line.
    """
    mean_b, mean_a = points_b.mean(axis=0), points_a.mean(axis=0)
    M = np.ascontiguousarray((points_a - mean_a).T @ (points_b - mean_b))
    R = rotation_svd(M) if method == "svd" else rotation_quaternion(M)
    return SE3(R, mean_a - R @ mean_b)
