"""Absolute orientation: the rotation and translation between two sets of matched points (thesis 5.1, 6.2.1).

Rules
-----
* Three kernels solve R = argmax tr(R^T M) over rotations (thesis eq. 6.13) for a (3, 3) matrix M = sum w q p^T; all
  of them answer with a proper rotation, det R = +1, always:

  - ``rotation_svd`` by singular values, the thesis' eq. 5.26 and 6.15 as its listing 10.3.2 has it, with a guard: where
    the thesis can answer with a reflection, the axis of the smallest singular value is turned.
  - ``rotation_quaternion`` by the largest eigenvalue of Horn's symmetric (4, 4) matrix (Horn 1987).
  - ``rotation_closed_form`` by the largest root of that matrix' characteristic polynomial (FOAM, Markley 1993): the
    same rotation without a decomposition, fast enough for the inner loop of LHM.
* Weights multiply squared distances (thesis eq. 5.2). They belong into A of the thesis' eq. 5.18 too, where the text
  leaves them out; A drops out of the solution, so nothing hangs on it.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

from companion.geometry import SE3, Mat, Vec

SMALLEST_GAP = 1e-4
"""Below this value of (s1 + s2)(s2 + s3)(s3 + s1) / |M|^3 the closed form loses digits and the SVD takes over."""

LARGEST_ROOT = float(np.sqrt(3.0))
"""The sum of three singular values whose squares sum to one is never larger."""

THINNEST = 1e-9
"""Smallest ratio of the second to the first singular value of a set of points that is not called a line."""

Nine = tuple[float, float, float, float, float, float, float, float, float]
"""A (3, 3) matrix row by row: in registers where an array would be on the heap."""


@njit(cache=True, nogil=True)
def rotation_svd(M: Mat) -> Mat:
    """Return the rotation (3, 3) that maximises tr(R^T M), by singular values, det R = +1 always."""
    U, _, Vt = np.linalg.svd(M)
    R = U @ Vt
    x, y, z = R[0], R[1], R[2]
    triple = (
        x[0] * (y[1] * z[2] - y[2] * z[1]) + x[1] * (y[2] * z[0] - y[0] * z[2]) + x[2] * (y[0] * z[1] - y[1] * z[0])
    )
    if triple < 0.0:
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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def largest_root(det: float, cofactors: float, guess: float) -> float:
    """Return the largest root l of (l^2 - 1)^2 - 8 det l - 4 cofactors, by Newton's method from a guess.

    The polynomial is convex right of 1 / sqrt(3), so that from any point there with a positive slope the first step
    lands right of the root, and the next ones come down to it. Where the slope is not positive, start from the far
    right.
    """
    root = guess
    for _ in range(60):
        q = root * root - 1.0
        slope = 4.0 * root * q - 8.0 * det
        if not slope > 0.0:
            if root == LARGEST_ROOT:
                break
            root = LARGEST_ROOT
            continue
        step = (q * q - 8.0 * det * root - 4.0 * cofactors) / slope
        root -= step
        if not abs(step) > 1e-10:  # the next step would be its square
            break
    return root


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def rotation_closed_form(m: Nine, guess: float) -> tuple[bool, Nine, float]:
    """Return (found, r, l): the rotation that maximises tr(R^T M), rows of M in m, rows of R in r.

    With M scaled to |M| = 1, l the sum of its singular values (the last one signed), k = (l^2 - 1) / 2 and C its
    cofactors, R = [(k + 1) M + l C - M M^T M] / (k l - det M). ``guess`` is where the search for l starts: that of a
    similar M, or ``LARGEST_ROOT``; above 1 / sqrt(3). Not found when M is too degenerate: r is m then.
    """
    norm = np.sqrt(
        m[0] * m[0] + m[1] * m[1] + m[2] * m[2] + m[3] * m[3] + m[4] * m[4] + m[5] * m[5] + m[6] * m[6] + m[7] * m[7]
        + m[8] * m[8]
    )  # fmt: skip
    if not norm > 0.0:
        return False, m, LARGEST_ROOT
    s = 1.0 / norm
    a, b, c = m[0] * s, m[1] * s, m[2] * s
    d, e, f = m[3] * s, m[4] * s, m[5] * s
    g, h, i = m[6] * s, m[7] * s, m[8] * s
    ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
    cd, ce, cf = c * h - b * i, a * i - c * g, b * g - a * h
    cg, ch, ci = b * f - c * e, c * d - a * f, a * e - b * d
    det = a * ca + b * cb + c * cc
    cofactors = ca * ca + cb * cb + cc * cc + cd * cd + ce * ce + cf * cf + cg * cg + ch * ch + ci * ci
    root = largest_root(det, cofactors, guess)
    k = 0.5 * (root * root - 1.0)
    gap = k * root - det
    if not gap > SMALLEST_GAP:
        return False, m, LARGEST_ROOT
    k, w = k + 1.0, 1.0 / gap
    # Rows of M M^T, symmetric.
    aa, dd, gg = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i
    ad, ag, dg = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    r = (
        (k * a + root * ca - (aa * a + ad * d + ag * g)) * w,
        (k * b + root * cb - (aa * b + ad * e + ag * h)) * w,
        (k * c + root * cc - (aa * c + ad * f + ag * i)) * w,
        (k * d + root * cd - (ad * a + dd * d + dg * g)) * w,
        (k * e + root * ce - (ad * b + dd * e + dg * h)) * w,
        (k * f + root * cf - (ad * c + dd * f + dg * i)) * w,
        (k * g + root * cg - (ag * a + dg * d + gg * g)) * w,
        (k * h + root * ch - (ag * b + dg * e + gg * h)) * w,
        (k * i + root * ci - (ag * c + dg * f + gg * i)) * w,
    )
    return True, r, root


def check_weights(weights: Mat | Vec, n: int, columns: int) -> Mat:
    """Return weights (n,), or (n, columns), as float64 (n, columns); ValueError when they are something else."""
    W = np.asarray(weights, dtype=np.float64)
    if W.shape not in {(n,), (n, columns)} or not (np.isfinite(W).all() and (W >= 0.0).all()):
        shapes = f"({n},)" if columns == 1 else f"({n},) or ({n}, {columns})"
        msg = f"weights must be {shapes}, finite and not negative"
        raise ValueError(msg)
    return np.array(np.broadcast_to(W.reshape(n, -1), (n, columns)), order="C")


def absolute_orientation(
    points_b: Mat, points_a: Mat, method: Literal["svd", "quaternion"] = "svd", weights: Vec | None = None
) -> SE3:
    """Return ``T_a_b`` that takes points (n, 3) of frame b to their matches in frame a (thesis eq. 5.2, 6.9 to 6.15).

    Minimises the sum of w |R p_b + t - p_a|^2 over rotations and translations; ``weights`` (n,) are all alike when
    None, and a point of weight zero is as good as absent.

    Raises ValueError for wrong shapes, numbers that are not finite, negative weights, and points that do not fix a
    rotation: fewer than three, or on one line, in either frame.
    """
    b, a = np.asarray(points_b, dtype=np.float64), np.asarray(points_a, dtype=np.float64)
    if b.ndim != 2 or b.shape[1] != 3 or a.shape != b.shape:
        msg = f"points must be two sets (n, 3) of the same size, not {b.shape} and {a.shape}"
        raise ValueError(msg)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        msg = "points must be finite numbers"
        raise ValueError(msg)
    if method not in {"svd", "quaternion"}:
        msg = f"method must be 'svd' or 'quaternion', not {method!r}"
        raise ValueError(msg)
    w = np.ones(len(b)) if weights is None else check_weights(weights, len(b), 1)[:, 0]
    used = np.count_nonzero(w)
    if used < 3:
        msg = f"absolute orientation needs at least 3 points of weight above zero, not {used}"
        raise ValueError(msg)
    w = w / w.max()
    mean_b, mean_a = w @ b / w.sum(), w @ a / w.sum()
    root = np.sqrt(w)[:, None]
    for centred in (root * (b - mean_b), root * (a - mean_a)):
        singular = np.linalg.svd(centred, compute_uv=False)
        if not singular[1] > THINNEST * singular[0]:
            msg = "points lie on one line: they do not fix a rotation"
            raise ValueError(msg)
    M = np.ascontiguousarray((a - mean_a).T @ (w[:, None] * (b - mean_b)))
    R = rotation_svd(M) if method == "svd" else rotation_quaternion(M)
    return SE3(R, mean_a - R @ mean_b)
