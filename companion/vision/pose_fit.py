"""The most probable pose of labelled markers and a prior, and how well each label is foretold by the others; compiled.

Rules
-----
* A pose is a deviation from the prior's (R0, t0): R = exp(d[3:]) R0, t = t0 + d[:3], in metres and rad along camera
  axes. Covariances and information matrices (6, 6) are of d.
* Image points ``uv`` lie on the plane z = 1. The variance of a label, per axis, is its detection's plus that of the
  marker's place on the tanker, ``map_sigma`` in metres, seen from the marker's depth.
* A label is -1 where the marker has no detection. Markers at or behind the camera's plane have NaN for a projection.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from companion.vision.small_systems import factor, invert, move

Ints = NDArray[np.int64]

NEAREST_M = 1e-6
"""Points nearer to the camera's plane than this, in metres, count as behind it."""

LOG_2PI = float(np.log(2.0 * np.pi))

STEPS = 4
"""Gauss-Newton steps at most; from a prior some metres off three bring the pose to a thousandth of its sigma."""


@njit(cache=True, nogil=True, error_model="numpy")
def project(points: Mat, R: Mat, t: Vec, uv: Mat, J: NDArray[np.float64]) -> None:
    """Write the places uv (n, 2) of points (n, 3) and their slopes J (n, 2, 6) by the pose's deviation."""
    for i in range(points.shape[0]):
        x = R[0, 0] * points[i, 0] + R[0, 1] * points[i, 1] + R[0, 2] * points[i, 2]
        y = R[1, 0] * points[i, 0] + R[1, 1] * points[i, 1] + R[1, 2] * points[i, 2]
        z = R[2, 0] * points[i, 0] + R[2, 1] * points[i, 1] + R[2, 2] * points[i, 2]
        depth = z + t[2]
        if not depth > NEAREST_M:
            uv[i, 0] = uv[i, 1] = np.nan
            for k in range(6):
                J[i, 0, k] = J[i, 1, k] = 0.0
            continue
        s = 1.0 / depth
        u, v = (x + t[0]) * s, (y + t[1]) * s
        uv[i, 0], uv[i, 1] = u, v
        J[i, 0, 0], J[i, 0, 1], J[i, 0, 2] = s, 0.0, -u * s
        J[i, 1, 0], J[i, 1, 1], J[i, 1, 2] = 0.0, s, -v * s
        # A turn d moves the point by d x (R p): a row a of the first three columns becomes (R p) x a.
        J[i, 0, 3], J[i, 0, 4], J[i, 0, 5] = -y * u * s, z * s + x * u * s, -y * s
        J[i, 1, 3], J[i, 1, 4], J[i, 1, 5] = -y * v * s - z * s, x * v * s, x * s


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_of(A: Mat, inverse: Mat) -> float:
    """Write the inverse of a symmetric A (k, k) and return log det A; NaN when it is not positive definite."""
    L = np.zeros(A.shape)
    if not factor(A, 0.0, L):
        return np.nan
    log_det = 0.0
    for i in range(A.shape[0]):
        log_det += 2.0 * np.log(L[i, i])
    invert(L, inverse)
    return log_det


@njit(cache=True, nogil=True, error_model="numpy")
def fit(points: Mat, rays: Mat, variance: Vec, map_sigma: float, labels: Ints, R0: Mat, t0: Vec, information: Mat,
        d: Vec, R: Mat, t: Vec, P: Mat, uv: Mat, J: NDArray[np.float64]) -> float:
    """Move the deviation d (6,) to the most probable one (Gauss-Newton) and write what belongs to it.

    R, t the pose, P (6, 6) its covariance, uv and J the projections there. Returns log det of the information, NaN when
    a labelled marker came behind the camera or the numbers broke down.
    """
    A, g, step = np.empty((6, 6)), np.empty(6), np.empty(6)
    log_det, last = np.nan, False
    move(R0, t0, d, R, t)
    for _ in range(STEPS + 1):
        project(points, R, t, uv, J)
        gather(rays, variance, map_sigma, labels, information, d, uv, J, A, g)
        log_det = inverse_of(A, P)
        if last or not np.isfinite(log_det):
            return log_det
        for k in range(6):
            step[k] = 0.0
            for j in range(6):
                step[k] += P[k, j] * g[j]
            d[k] += step[k]
        move(R0, t0, d, R, t)
        moved = 0.0  # squared, in sigmas
        for k in range(6):
            moved += step[k] * g[k]
        if moved < 1e-4:
            last = True
    return log_det


@njit(cache=True, nogil=True, error_model="numpy")
def gather(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, information: Mat, d: Vec, uv: Mat,
           J: NDArray[np.float64], A: Mat, g: Vec) -> None:
    """Write the information A (6, 6) of prior and labels, and the slope g (6,) of the log probability."""
    for k in range(6):
        g[k] = 0.0
        for j in range(6):
            A[k, j] = information[k, j]
            g[k] -= information[k, j] * d[j]
    for i in range(labels.shape[0]):
        if labels[i] < 0:
            continue
        w = 1.0 / (variance[labels[i]] + (map_sigma * J[i, 0, 0]) ** 2)
        du, dv = rays[labels[i], 0] - uv[i, 0], rays[labels[i], 1] - uv[i, 1]
        for k in range(6):
            a, b = w * J[i, 0, k], w * J[i, 1, k]
            g[k] += a * du + b * dv
            for j in range(k + 1):
                A[k, j] += a * J[i, 0, j] + b * J[i, 1, j]
    for k in range(6):
        for j in range(k):
            A[j, k] = A[k, j]


@njit(cache=True, nogil=True, error_model="numpy")
def spread(J: Mat, P: Mat) -> tuple[float, float, float]:
    """Return the elements (uu, uv, vv) of J P J^T for one marker, J (2, 6)."""
    uu, uv, vv = 0.0, 0.0, 0.0
    for k in range(6):
        a, b = 0.0, 0.0
        for j in range(6):
            a += P[k, j] * J[0, j]
            b += P[k, j] * J[1, j]
        uu += J[0, k] * a
        uv += J[0, k] * b
        vv += J[1, k] * b
    return uu, uv, vv


@njit(cache=True, nogil=True, error_model="numpy")
def foretold(ray: Vec, uv: Vec, J: Mat, P: Mat, variance: float) -> tuple[float, float, float, float, float, float]:
    """Return what the other labels and the prior say of one label's place, from the fit that holds them all.

    (squared studentised residual, u, v of the foretold place, uu, uv, vv of its covariance with the label's noise).
    With r the residual, s2 the variance, H = J P J^T and V = s2 I - H: the foretold place is ray - s2 V^-1 r, its
    covariance s2^2 V^-1, the square r^T V^-1 r (Belsley, Kuh, Welsch 1980, ch. 2). Infinite where the others say
    nothing.
    """
    uu, uv_, vv = spread(J, P)
    a, b, c = variance - uu, -uv_, variance - vv
    det = a * c - b * b
    if not (det > 1e-9 * variance * variance and a > 0.0):
        return 0.0, uv[0], uv[1], np.inf, 0.0, np.inf
    du, dv = ray[0] - uv[0], ray[1] - uv[1]
    x, y = (c * du - b * dv) / det, (a * dv - b * du) / det
    k = variance * variance / det
    return du * x + dv * y, ray[0] - variance * x, ray[1] - variance * y, k * c, -k * b, k * a
