"""The two solvers as plainly as the thesis' listings 10.3.1 and 10.3.2 have them: what its operations are counted on.

Rules
-----
* The same sums and products in the same order of steps: every marker for itself, full matrices, nothing folded. What
  flies is ``companion.vision``; this is the yardstick, and its tests hold the two together.
* Arrays of floats or of numbers that count (``counting``); decompositions come from the ``Lapack`` that is passed in.
* Optical axes for LHM (the listing's are left-handed, the steps are the same), the thesis' for GLSDC.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.geometry import SE3, Mat
from sim_bridge.study.counting import Lapack

Array = NDArray[Any]
"""Of floats or of numbers that count."""

MAX_ITERATIONS = 1000


class ListedLhm:
    """The listing's LHM as a solver with a memory: from its own last R, reflections and all."""

    def __init__(self, T_start: SE3) -> None:
        self._R = T_start.R
        self._lapack = Lapack()

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3:
        """Return the pose of one frame's markers; see ``solvers.Tracker``."""
        self._R, t, _ = lhm(points, uv, self._R, self._lapack)
        return SE3(self._R, t)


def glsdc(X: Array, G_seen: Array, markers: Array, steps: int, lapack: Lapack) -> Array:
    """Return X = [x y z psi theta phi] after ``steps`` of Gauss-Newton (eq. 5.51 to 5.55), R_crf_tanker = Rz Ry Rx.

    ``G_seen`` (2 n,) are u and v on the plane x = 1 of n markers (n, 3).
    """
    for _ in range(steps):
        A = np.concatenate([marker_gradient(p, X) for p in markers])
        G = np.concatenate([marker_image(p, X) for p in markers])
        W, visible = np.eye(len(G)), np.eye(len(G))
        delta = visible @ (G_seen - G)
        P = A.T @ W @ A
        X = X + lapack.pinv(P) @ A.T @ W @ delta
    return X


def marker_image(p: Array, X: Array) -> Array:
    """Return u and v (2,) of one marker (3,) (eq. 5.49)."""
    spsi, cth, cpsi = np.sin(X[3]), np.cos(X[4]), np.cos(X[3])
    cphi, sth, sphi = np.cos(X[5]), np.sin(X[4]), np.sin(X[5])
    a, b = spsi * sth, cpsi * sth
    inverse = 1.0 / (
        X[0] + cpsi * cth * p[0] + (-spsi * cphi + b * sphi) * p[1] + (spsi * sphi + b * cphi) * p[2]
    )
    u = (X[1] + spsi * cth * p[0] + (cpsi * cphi + a * sphi) * p[1] + (-cpsi * sphi + a * cphi) * p[2]) * inverse
    v = (X[2] - sth * p[0] + cth * sphi * p[1] + cth * cphi * p[2]) * inverse
    return np.array([u, v])


def marker_gradient(p: Array, X: Array) -> Array:
    """Return the two rows (2, 6) of the Jacobian (eq. 5.55) of one marker."""
    spsi, cth, cpsi = np.sin(X[3]), np.cos(X[4]), np.cos(X[3])
    cphi, sth, sphi = np.cos(X[5]), np.sin(X[4]), np.sin(X[5])
    r21, r22, r23 = spsi * cth, cpsi * cphi + spsi * sth * sphi, spsi * sth * cphi - cpsi * sphi
    r11, r12, r13 = cpsi * cth, cpsi * sth * sphi - spsi * cphi, spsi * sphi + cpsi * sth * cphi
    r32, r33 = cth * sphi, cth * cphi
    ahead, right = r11 * p[0] + r12 * p[1] + r13 * p[2], r21 * p[0] + r22 * p[1] + r23 * p[2]
    depth = X[0] + ahead
    inverse = 1.0 / depth
    squared = 1.0 / (depth * depth)
    u, v = (X[1] + right) * squared, (X[2] - sth * p[0] + r32 * p[1] + r33 * p[2]) * squared
    by_psi = -right
    by_theta = -cpsi * sth * p[0] + r11 * (sphi * p[1]) + r11 * (cphi * p[2])
    by_phi = r13 * p[1] - r12 * p[2]
    level = -spsi * sth * p[0] + r21 * (sphi * p[1]) + r21 * (cphi * p[2])
    down = -cth * p[0] - sth * sphi * p[1] - sth * cphi * p[2]
    zero = 0.0
    return np.array(
        [
            [-u, inverse, zero, ahead * inverse - u * by_psi, level * inverse - u * by_theta,
             (r23 * p[1] - r22 * p[2]) * inverse - u * by_phi],
            [-v, zero, inverse, -v * by_psi, down * inverse - v * by_theta,
             (r33 * p[1] - r32 * p[2]) * inverse - v * by_phi],
        ]
    )


def lhm(
    points: Array, uv: Array, R: Array, lapack: Lapack, tol: float = 1e-5, epsilon: float = 1e-8
) -> tuple[Array, Array, int]:
    """Return R, t and the iterations of the orthogonal iteration from R for markers (n, 3) seen at uv (n, 2).

    R may be a reflection, which nothing prevents. Markers behind the camera are turned round by the signs of R and t;
    the mean is then taken back by the R before, as the listing has it, so that t is only right in the next frame.
    """
    n = len(points)
    mean = sum(points[1:], points[0]) / n
    P = points - mean
    F = []
    for u, v in uv:
        V = np.array([u, v, 1.0])
        F.append(np.outer(V, V) / (V @ V))
    factor = lapack.inv(np.eye(3) - sum(F[1:], F[0]) / n) / n
    total = np.zeros(3)
    for f, p in zip(F, P, strict=True):
        total = total + (f - np.eye(3)) @ R @ p
    Q, old = placed(P, F, R, factor @ total)
    R, t, Q, new = kernel(P, Q, F, factor, lapack)
    iterations = 1
    while abs((old - new) / old) > tol and new > epsilon and iterations < MAX_ITERATIONS:
        old = new
        R, t, Q, new = kernel(P, Q, F, factor, lapack)
        iterations += 1
    before = R
    if t[2] < 0.0:
        R, t = -R, -t
    return R, t - before @ mean, iterations


def kernel(P: Array, Q: Array, F: list[Array], factor: Array, lapack: Lapack) -> tuple[Array, Array, Array, Any]:
    """Return R, t, the points placed by them and the squared error: one absolute orientation (eq. 6.15, 6.19, 6.23)."""
    n = len(P)
    Q = np.array([f @ q for f, q in zip(F, Q, strict=True)])
    P_centred, Q_centred = P - sum(P[1:], P[0]) / n, Q - sum(Q[1:], Q[0]) / n
    M = np.zeros((3, 3))
    for p, q in zip(P_centred, Q_centred, strict=True):
        M = M + np.outer(p, q)
    U, V = lapack.svd(M)
    R = V @ U.T
    total = np.zeros(3)
    for f, p in zip(F, P_centred, strict=True):
        total = total + f @ R @ p
    t = factor @ total
    placed_points, error = placed(P_centred, F, R, t)
    return R, t, placed_points, error


def placed(P: Array, F: list[Array], R: Array, t: Array) -> tuple[Array, Any]:
    """Return R p + t (n, 3) and the squared object-space error (eq. 6.18)."""
    Q = np.array([R @ p + t for p in P])
    error: Any = 0.0
    for f, q in zip(F, Q, strict=True):
        off = (np.eye(3) - f) @ q
        error = error + off @ off
    return Q, error
