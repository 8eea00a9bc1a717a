"""Pose by guessing depths: absolute orientation and new depths in turn (thesis 5.2.1, methods 1 and 2).

Rules
-----
* Each marker has a depth d along the optical axis; with v = (u, v, 1) its place in the camera is d v. Absolute
  orientation of the markers to these places (thesis eq. 5.30) gives a pose, x = R p + t, the pose gives new depths.
* Method 2 takes the depth of the point of the line of sight nearest to x, d = x.v / v.v (thesis eq. 5.35). The error
  cannot grow (eq. 5.40). Its resting points are those of LHM, which differs by putting t at its best for each R: that
  makes tens of iterations of hundreds.
* Method 1 takes d = s x_3, s the size of the markers by the size of the places (thesis eq. 5.31). As printed it cannot
  work: in eq. 5.34 x is R y + t, which has the size of y always, so that s is 1 and the mean depth never moves. The
  size meant is that of the places d v. And D of eq. 5.33 and 5.34 are squared sizes, whose ratio turns a depth that is
  too large into one that is as much too small, further with each iteration: s is the root of the ratio here.
* Weights enter the sizes as they enter the error, so that a marker of weight zero is as good as absent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from companion.geometry import SE3, Mat, Vec
from companion.vision.absolute_orientation import check_weights, rotation_quaternion, rotation_svd
from companion.vision.lhm import as_floats, check_geometry, kernel_of


@dataclass(frozen=True, slots=True, eq=False)
class DepthResult:
    """Outcome of ``solve_depth_iteration``.

    ``depth_m`` (n,) along the optical axis. ``object_error`` RMS distance of the markers from their places in m,
    weighted: the root of eps^2 of thesis eq. 5.30 by the sum of the weights. ``image_error`` RMS distance on the plane
    z = 1. ``converged`` says that no depth changed by more than the tolerance and that all markers that have weight are
    before the camera.
    """

    T_cam_tanker: SE3
    depth_m: Vec
    iterations: int
    object_error: float
    image_error: float
    converged: bool


def solve_depth_iteration(
    points_tanker: Mat,
    uv: Mat,
    method: Literal[1, 2] = 2,
    depth_init_m: float | Vec | None = None,
    weights: Vec | None = None,
    iterations: int = 2000,
    tol: float = 1e-8,
    kernel: Literal["svd", "quaternion"] = "svd",
) -> DepthResult:
    """Return the pose of markers (n, 3), m, tanker axes, seen at ``uv`` (n, 2) on the plane z = 1 (thesis 5.2.1).

    Starts from ``depth_init_m``, one for all or (n,), or from the depth at which the picture has the size of the
    markers (thesis eq. 6.38). Ends when no depth changes by more than its fraction ``tol``, or after ``iterations``.
    ``weights`` (n,) are w of thesis eq. 5.30, all alike when None.

    Raises ValueError for wrong shapes, numbers that are not finite, negative weights, depths that are not positive, and
    markers of weight above zero that do not fix a pose: fewer than three, on one line, on one ray.
    """
    points, rays = as_floats(points_tanker, 2), as_floats(uv, 2)
    if method not in {1, 2}:
        msg = f"method must be 1 or 2, not {method!r}"
        raise ValueError(msg)
    if iterations < 1:
        msg = f"iterations must be at least 1, not {iterations}"
        raise ValueError(msg)
    w = np.ones(len(points)) if weights is None else check_weights(weights, len(points), 1)[:, 0]
    for used in (slice(None), w > 0.0):
        check_geometry(points[used], rays[used])
    v = np.column_stack([rays, np.ones(len(rays))])
    d = np.array(np.broadcast_to(first_depth(points, v, w, depth_init_m), len(points)))
    R, t = np.eye(3), np.zeros(3)
    done, squared, settled = iterate_depths(
        points, v, w / w.max(), d, method == 1, kernel_of(kernel), int(iterations), float(tol), R, t
    )
    T = SE3(R, t)
    x = T.transform(points)
    with np.errstate(all="ignore"):
        image = float(np.sqrt(np.sum((x[:, :2] / x[:, 2:] - rays) ** 2) / len(points)))
    ahead = bool((x[w > 0.0, 2] > 0.0).all())
    return DepthResult(T, d, done, float(np.sqrt(squared / (w.sum() / w.max()))), image, settled and ahead)


def first_depth(points: Mat, v: Mat, w: Vec, depth_init_m: float | Vec | None) -> Vec:
    """Return the depths to start from, () or (n,); ValueError when they cannot be depths."""
    if depth_init_m is None:
        sizes = [np.sum(w[:, None] * (a - w @ a / w.sum()) ** 2) for a in (points, v)]
        return np.asarray(np.sqrt(sizes[0] / sizes[1]))
    d = np.asarray(depth_init_m, dtype=np.float64)
    if d.shape not in {(), (len(points),)} or not (np.isfinite(d).all() and (d > 0.0).all()):
        msg = f"depth_init_m must be one number or ({len(points)},), finite and above zero"
        raise ValueError(msg)
    return d


@njit(cache=True, nogil=True)
def spread(a: Mat, w: Vec) -> tuple[Vec, float]:
    """Return the weighted mean (3,) of a (n, 3) and the weighted sum of squares about it."""
    mean, total, squares = np.zeros(3), w.sum(), 0.0
    for i in range(len(w)):
        for k in range(3):
            mean[k] += w[i] * a[i, k] / total
    for i in range(len(w)):
        for k in range(3):
            squares += w[i] * (a[i, k] - mean[k]) ** 2
    return mean, squares


@njit(cache=True, nogil=True, error_model="numpy")
def orient(points: Mat, q: Mat, w: Vec, kernel: int, R: Mat, t: Vec) -> float:
    """Write the absolute orientation of points to q into R and t (thesis eq. 5.30); return the ratio of their sizes.

    Numbers that are no longer finite leave R and t as they are.
    """
    mean_p, size_p = spread(points, w)
    mean_q, size_q = spread(q, w)
    M = np.zeros((3, 3))
    for i in range(len(w)):
        for j in range(3):
            for k in range(3):
                M[j, k] += w[i] * (q[i, j] - mean_q[j]) * (points[i, k] - mean_p[k])
    scale = np.sqrt(size_p / size_q)
    if not np.isfinite(M.sum() + scale):
        return np.nan
    R[:] = rotation_quaternion(M) if kernel == 1 else rotation_svd(M)
    for j in range(3):
        t[j] = mean_q[j] - (R[j, 0] * mean_p[0] + R[j, 1] * mean_p[1] + R[j, 2] * mean_p[2])
    return scale


@njit(cache=True, nogil=True, error_model="numpy")
def iterate_depths(
    points: Mat, v: Mat, w: Vec, d: Vec, scaled: bool, kernel: int, iterations: int, tol: float, R: Mat, t: Vec
) -> tuple[int, float, bool]:
    """Iterate depths d (n,) and pose R, t in place: (iterations, eps^2 of the last, no depth changed much)."""
    n = len(d)
    q = np.empty((n, 3))
    squared, settled, done = 0.0, False, 0
    while not settled and done < iterations:
        done += 1
        for i in range(n):
            for k in range(3):
                q[i, k] = d[i] * v[i, k]
        scale = orient(points, q, w, kernel, R, t)
        if not np.isfinite(scale):
            return done, np.nan, False
        squared, settled = 0.0, True
        for i in range(n):
            along, length, off = 0.0, 0.0, 0.0
            for k in range(3):
                x = R[k, 0] * points[i, 0] + R[k, 1] * points[i, 1] + R[k, 2] * points[i, 2] + t[k]
                off += (x - q[i, k]) ** 2
                along += x * v[i, k]
                length += v[i, k] * v[i, k]
            squared += w[i] * off
            new = scale * x if scaled else along / length
            settled = settled and abs(new - d[i]) <= tol * abs(new)
            d[i] = new
    return done, squared, settled
