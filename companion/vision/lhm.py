"""Pose of the tanker by orthogonal iteration: Lu, Hager and Mjolsness 2000 (thesis ch. 6, listing 10.3.2).

Rules
-----
* The error is the distance in metres of each marker from its line of sight, in object space (thesis eq. 6.16-6.18).
* Frames: tanker axes in, optical camera axes (right, down, forward) out, where the thesis' listing takes a left-handed
  frame with y up; the iteration is the same.
* The points are summed once, into matrices of fixed size (``lhm_kernel``), so that an iteration costs the same for any
  number of markers. The iterates and the stopping rule are those of the listing.
* The rotation step cannot answer with a reflection, as the listing's can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.geometry import SE3, Mat
from companion.vision.absolute_orientation import rotation_svd
from companion.vision.lhm_kernel import NOT_A_ROTATION, NOT_FINITE, OK, ON_A_LINE, ONE_RAY, Iterated, fold, iterate

METHODS = {"svd": 0, "quaternion": 1}

COMPLAINTS = {
    NOT_FINITE: "points_tanker, uv and R_init must be finite numbers",
    ON_A_LINE: "points_tanker lie on one line: they do not fix a pose",
    ONE_RAY: "uv are all the same point: they do not fix a pose",
    NOT_A_ROTATION: "R_init must be a rotation matrix (3, 3)",
}


@dataclass(frozen=True, slots=True, eq=False)
class LhmResult:
    """Outcome of ``solve_lhm``.

    ``object_error`` RMS distance of the markers from their lines of sight in m; ``image_error`` RMS distance on the
    plane z = 1; ``converged`` says that the stopping rule was met and that all markers are before the camera.
    """

    T_cam_tanker: SE3
    iterations: int
    object_error: float
    image_error: float
    converged: bool


def solve_lhm(
    points_tanker: Mat,
    uv: Mat,
    R_init: Mat | None = None,
    tol: float = 1e-5,
    epsilon: float = 1e-8,
    method: Literal["svd", "quaternion"] = "svd",
) -> LhmResult:
    """Return the pose that brings markers (n, 3), m, tanker axes, nearest to their lines of sight (thesis eq. 6.18).

    ``uv`` (n, 2) are the markers seen on the plane z = 1, undistorted; n >= 3, though the thesis asks for 5 (6.3).
    ``R_init`` is where R_cam_tanker starts, usually the last frame's; None starts from several rotations and keeps the
    best (``cold``). Iterates until the sum of squared errors is at most ``epsilon`` m^2
    or changes by a fraction of at most ``tol`` (thesis 6.3). ``method`` svd takes the rotation of the guarded SVD, by
    its closed form; quaternion takes Horn's.

    Raises ValueError for wrong shapes, numbers that are not finite, points on one line, rays that coincide.
    """
    points = np.ascontiguousarray(points_tanker, dtype=np.float64)
    rays = np.ascontiguousarray(uv, dtype=np.float64)
    check_points(points, rays)
    if method not in METHODS:
        msg = f"method must be 'svd' or 'quaternion', not {method!r}"
        raise ValueError(msg)
    if R_init is None:
        return cold(points, rays, tol, epsilon, METHODS[method])
    R0 = np.ascontiguousarray(R_init, dtype=np.float64)
    if R0.shape != (3, 3):
        raise ValueError(COMPLAINTS[NOT_A_ROTATION])
    return unpack(len(points), iterate(points, rays, R0, tol, epsilon, METHODS[method]))


def check_points(points: Mat, uv: Mat) -> None:
    """Raise ValueError unless points are (n, 3) and uv (n, 2) with n >= 3."""
    if points.ndim != 2 or points.shape[1] != 3 or uv.shape != (points.shape[0], 2):
        msg = f"points_tanker must be (n, 3) and uv (n, 2), not {points.shape} and {uv.shape}"
        raise ValueError(msg)
    if points.shape[0] < 3:
        msg = f"a pose needs at least 3 points, not {points.shape[0]}"
        raise ValueError(msg)


def unpack(n: int, iterated: Iterated) -> LhmResult:
    """Turn what ``iterate`` returns into a result or into a ValueError."""
    status, R, t, iterations, squared_object, squared_image, settled, ahead = iterated
    if status != OK:
        raise ValueError(COMPLAINTS[status])
    errors = (squared_object / n) ** 0.5, (squared_image / n) ** 0.5
    return LhmResult(SE3(R, t), iterations, *errors, settled and ahead)


def cold(points: Mat, uv: Mat, tol: float, epsilon: float, method: int) -> LhmResult:
    """Iterate from several starts and return the lowest error, poses with all markers before the camera first.

    E = r^T Omega r for any r, with Omega = diag(S, S, S) - H and S the scatter matrix of the points. Starts are the
    proper rotations nearest to plus and minus an eigenvector of Omega, smallest eigenvalue first: the idea of SQPnP
    (Terzakis, Lourakis 2020). Three eigenvectors are always tried, further ones while the best error is above what
    theirs could be, 3 times the eigenvalue.
    """
    status, H, _, _, _, p, _ = fold(points, uv)
    if status != OK:
        raise ValueError(COMPLAINTS[status])
    values, vectors = np.linalg.eigh(np.kron(np.eye(3), p.T @ p) - 0.5 * (H + H.T))
    best: Iterated | None = None
    for k in range(9):
        if k >= 3 and best is not None and best[7] and best[4] <= 3.0 * values[k]:
            break
        axis = np.ascontiguousarray(vectors[:, k]).reshape(3, 3)
        tries = [iterate(points, uv, rotation_svd(sign * axis), tol, epsilon, method) for sign in (1.0, -1.0)]
        best = min(tries if best is None else [best, *tries], key=lambda it: (not it[7], it[4]))
    assert best is not None
    return unpack(len(points), best)


def weak_perspective_rotation(points_tanker: Mat, uv: Mat) -> Mat:
    """Return the thesis' cold start R (3, 3): image points as if they were the scene (thesis 6.2.5), never reflected.

    Good for far and shallow scenes only; ``solve_lhm`` without ``R_init`` has a better one.
    """
    q = np.column_stack([uv, np.ones(len(uv))])
    return rotation_svd(np.ascontiguousarray((q - q.mean(axis=0)).T @ (points_tanker - points_tanker.mean(axis=0))))


def rms_object_error(points: Mat, uv: Mat, T_cam_tanker: SE3) -> float:
    """Return the RMS distance in m of points (n, 3) from their lines of sight uv (n, 2) (thesis eq. 6.18)."""
    q = T_cam_tanker.transform(points)
    rays = np.column_stack([uv, np.ones(len(uv))])
    off = np.cross(rays, q) / np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
    return float(np.sqrt(np.einsum("ij,ij->", off, off) / len(points)))
