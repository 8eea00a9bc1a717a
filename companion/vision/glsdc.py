"""Pose of the tanker by Gaussian least squares differential correction (thesis 5.2.2, 5.3, listing 10.3.1).

Rules
-----
* Gauss-Newton on X = (x, y, z, psi, theta, phi) in the thesis' camera axes, forward, right, down: R_crf_tanker =
  Rx(phi) Ry(theta) Rz(psi) (thesis eq. 5.41). There the geometry of refuelling keeps theta near the camera's look-up
  angle, far from the singularity at a right angle. Optical axes outside; converted at the edge.
* A fixed number of iterations, as in the thesis. Whether they led anywhere is said in ``converged``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from companion.geometry import SE3, Mat, R_cam_crf, Vec, euler_from_rotation, rotation_from_euler
from companion.vision.lhm import check_points

SETTLED = 1e-3
"""Largest last step of a converged solution: radians, and for the translation its fraction of the distance."""


@dataclass(frozen=True, slots=True, eq=False)
class GlsdcResult:
    """Outcome of ``solve_glsdc``; ``image_error`` RMS distance on the plane z = 1, not weighted.

    ``converged`` says that everything is finite, all markers are before the camera, the last step was small and the
    weighted error is not larger than at the start.
    """

    T_cam_tanker: SE3
    iterations: int
    image_error: float
    converged: bool


def solve_glsdc(
    points_tanker: Mat, uv: Mat, T_init: SE3, iterations: int = 4, weights: Mat | Vec | None = None
) -> GlsdcResult:
    """Return the pose near ``T_init`` with the least squared image error of markers (n, 3), m, tanker axes.

    ``uv`` (n, 2) are the markers seen on the plane z = 1, undistorted; n >= 3, though the thesis asks for 4 (5.3).
    ``weights`` (n,) or (n, 2) is the diagonal of W (thesis eq. 5.52), all alike when None. When the normal equations
    become singular or numbers overflow the last finite pose is returned, not converged.

    Raises ValueError for wrong shapes, numbers that are not finite and weights that are negative.
    """
    points = np.ascontiguousarray(points_tanker, dtype=np.float64)
    rays = np.ascontiguousarray(uv, dtype=np.float64)
    check_points(points, rays)
    W = np.ones(rays.shape) if weights is None else check_weights(weights, len(points))
    R_crf_tanker = R_cam_crf.T @ T_init.R
    X0 = np.empty(6)
    X0[:3] = R_cam_crf.T @ T_init.t
    X0[3:] = euler_from_rotation(R_crf_tanker.T)
    if not (np.isfinite(points).all() and np.isfinite(rays).all() and np.isfinite(X0).all()):
        msg = "points_tanker, uv and T_init must be finite numbers"
        raise ValueError(msg)
    X, done, squared, converged = correct(points, rays, X0, iterations, W)
    R = R_cam_crf @ rotation_from_euler(X[3], X[4], X[5]).T
    return GlsdcResult(SE3(R, R_cam_crf @ X[:3]), done, float(np.sqrt(squared / len(points))), converged)


def check_weights(weights: Mat | Vec, n: int) -> Mat:
    """Return weights (n,) or (n, 2) as (n, 2); ValueError when they are something else."""
    W = np.asarray(weights, dtype=np.float64)
    if W.shape not in {(n,), (n, 2)} or not (np.isfinite(W).all() and (W >= 0).all()):
        msg = f"weights must be ({n},) or ({n}, 2), finite and not negative"
        raise ValueError(msg)
    return np.ascontiguousarray(np.broadcast_to(W.reshape(n, -1), (n, 2)))


@njit(cache=True, nogil=True, error_model="numpy")
def image_and_jacobian(points: Mat, X: Vec) -> tuple[Mat, Mat, float]:
    """Return G (n, 2), its Jacobian A (2 n, 6) by X (thesis eq. 5.50, 5.55) and the smallest depth in m."""
    n = points.shape[0]
    cps, sps, cth, sth, cph, sph = np.cos(X[3]), np.sin(X[3]), np.cos(X[4]), np.sin(X[4]), np.cos(X[5]), np.sin(X[5])
    R = np.array(
        [
            [cth * cps, cth * sps, -sth],
            [-cph * sps + sph * sth * cps, cph * cps + sph * sth * sps, sph * cth],
            [sph * sps + cph * sth * cps, -sph * cps + cph * sth * sps, cph * cth],
        ]
    )
    G, A, nearest = np.empty((n, 2)), np.empty((2 * n, 6)), np.inf
    d = np.empty((3, 3))  # derivatives of R p: rows by psi, theta, phi
    for i in range(n):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        x = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        y = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        for k in range(3):
            d[0, k] = R[k, 0] * b - R[k, 1] * a
        d[1, 0], d[1, 1], d[1, 2] = -sth * (cps * a + sps * b) - cth * c, sph * x, cph * x
        d[2, 0], d[2, 1], d[2, 2] = 0.0, z, -y
        depth = x + X[0]
        u, v = (y + X[1]) / depth, (z + X[2]) / depth
        G[i, 0], G[i, 1] = u, v
        A[2 * i, 0], A[2 * i, 1], A[2 * i, 2] = -u / depth, 1.0 / depth, 0.0
        A[2 * i + 1, 0], A[2 * i + 1, 1], A[2 * i + 1, 2] = -v / depth, 0.0, 1.0 / depth
        for k in range(3):
            A[2 * i, 3 + k] = (d[k, 1] - u * d[k, 0]) / depth
            A[2 * i + 1, 3 + k] = (d[k, 2] - v * d[k, 0]) / depth
        nearest = min(nearest, depth)
    return G, A, nearest


@njit(cache=True, nogil=True)
def normal_equations(uv: Mat, G: Mat, A: Mat, W: Mat, P: Mat, b: Vec) -> tuple[float, float]:
    """Write A^T W A into P (6, 6) and A^T W (uv - G) into b (6,); return the squared error, weighted and plain."""
    P[:], b[:] = 0.0, 0.0
    weighted, plain = 0.0, 0.0
    for i in range(uv.shape[0]):
        for k in range(2):
            w, delta = W[i, k], uv[i, k] - G[i, k]
            weighted += w * delta * delta
            plain += delta * delta
            for r in range(6):
                a = w * A[2 * i + k, r]
                b[r] += a * delta
                for c in range(6):
                    P[r, c] += a * A[2 * i + k, c]
    return weighted, plain


@njit(cache=True, nogil=True, error_model="numpy")
def solve_spd(P: Mat, b: Vec) -> bool:
    """Overwrite b (n,) with P^-1 b by Cholesky, P (n, n) with its factor; False when P is not positive definite."""
    n = len(b)
    for i in range(n):
        scale = P[i, i]
        for j in range(i + 1):
            total = P[i, j]
            for k in range(j):
                total -= P[i, k] * P[j, k]
            if j < i:
                P[i, j] = total / P[j, j]
            elif total > 1e-14 * scale:
                P[i, i] = np.sqrt(total)
            else:
                return False
    for i in range(n):
        for k in range(i):
            b[i] -= P[i, k] * b[k]
        b[i] /= P[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= P[k, i] * b[k]
        b[i] /= P[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def correct(points: Mat, uv: Mat, X0: Vec, iterations: int, W: Mat) -> tuple[Vec, int, float, bool]:
    """Iterate thesis eq. 5.51 to 5.55 from X0: (X, iterations done, squared image error, converged)."""
    X, P, step, done = X0.copy(), np.empty((6, 6)), np.zeros(6), 0
    G, A, nearest = image_and_jacobian(points, X)
    weighted, plain = normal_equations(uv, G, A, W, P, step)
    at_start, move, turn, regular = weighted, 0.0, 0.0, True
    for _ in range(iterations):
        regular = solve_spd(P, step)
        for k in range(6):
            regular = regular and np.isfinite(step[k])
        if not regular:
            break
        for k in range(6):
            X[k] += step[k]
        move = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        turn = np.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
        done += 1
        G, A, nearest = image_and_jacobian(points, X)
        weighted, plain = normal_equations(uv, G, A, W, P, step)
    distance = np.sqrt(X[0] ** 2 + X[1] ** 2 + X[2] ** 2)
    settled = move < SETTLED * distance and turn < SETTLED
    improved = weighted <= at_start + 1e-12
    return X, done, plain, bool(regular and settled and improved and nearest > 0.0)
