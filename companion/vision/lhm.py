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
from companion.vision.frozen import blank, rigid, slots_of
from companion.vision.lhm_kernel import (
    FEW_POINTS,
    NOT_A_ROTATION,
    NOT_FINITE,
    OK,
    ON_A_LINE,
    ONE_RAY,
    WRONG_SHAPE,
    fold,
    solve_from,
)
from companion.vision.lhm_search import MAX_MINIMA, ROW, search

METHODS = {"svd": 0, "quaternion": 1}

FLOAT = np.dtype(np.float64)

COMPLAINTS = {
    WRONG_SHAPE: "points_tanker must be (n, 3) and uv (n, 2)",
    FEW_POINTS: "a pose needs at least 3 points",
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
    ``iterations`` counts absolute orientations, as the listing does, and, without a start, the steps before them.
    """

    T_cam_tanker: SE3
    iterations: int
    object_error: float
    image_error: float
    converged: bool


put_pose, put_iterations, put_object_error, put_image_error, put_converged = slots_of(LhmResult)


def result(T: SE3, iterations: int, object_error: float, image_error: float, converged: bool) -> LhmResult:
    """Return ``LhmResult`` of these fields."""
    made = blank(LhmResult)
    put_pose(made, T)
    put_iterations(made, iterations)
    put_object_error(made, object_error)
    put_image_error(made, image_error)
    put_converged(made, converged)
    return made


def solve_lhm(
    points_tanker: Mat,
    uv: Mat,
    R_init: Mat | None = None,
    tol: float = 1e-5,
    epsilon: float = 1e-8,
    method: Literal["svd", "quaternion"] = "svd",
    start: Literal["global", "weak_perspective"] = "global",
) -> LhmResult:
    """Return the pose that brings markers (n, 3), m, tanker axes, nearest to their lines of sight (thesis eq. 6.18).

    ``uv`` (n, 2) are the markers seen on the plane z = 1, undistorted; n >= 3, though the thesis asks for 5 (6.3).
    ``R_init`` is where R_cam_tanker starts, usually the last frame's. Without it ``start`` says how to begin:
    ``global`` searches for the best minimum (``lhm_search``; reliable from 5 markers on), ``weak_perspective`` is the
    thesis' start (6.2.5), good for far and shallow scenes only. Iterates until the sum of squared errors is at most
    ``epsilon`` m^2 or changes by a fraction of at most ``tol`` (thesis 6.3). ``method`` svd takes the rotation of the
    guarded SVD, by its closed form; quaternion takes Horn's.

    Raises ValueError for wrong shapes, numbers that are not finite, points on one line, rays that coincide.
    """
    points, rays = as_floats(points_tanker, 2), as_floats(uv, 2)
    kernel = kernel_of(method)
    began = 0
    if R_init is None:
        if start == "global":
            table = np.empty((1, ROW))
            minima(points, rays, tol, epsilon, kernel, table)
            return unpack(table[0])
        if start != "weak_perspective":
            msg = f"start must be 'global' or 'weak_perspective', not {start!r}"
            raise ValueError(msg)
        R_init, began = weak_perspective_rotation(points, rays), 1
    R0, R, t = as_floats(R_init, 2), np.empty((3, 3)), np.empty(3)
    status, iterations, object_error, image_error, converged = solve_from(
        points, rays, R0, float(tol), float(epsilon), kernel, R, t
    )
    if status != OK:
        raise ValueError(complaint(status, points, rays))
    return result(rigid(R, t), began + iterations, object_error, image_error, converged)


def solve_lhm_minima(
    points_tanker: Mat,
    uv: Mat,
    tol: float = 1e-5,
    epsilon: float = 1e-8,
    method: Literal["svd", "quaternion"] = "svd",
) -> tuple[LhmResult, ...]:
    """Return the distinct minima of the object-space error with all markers before the camera, the best one first.

    More than one is the usual thing for few markers, and for flat sets of markers far away two can be about equally
    good: then only something else, a prior, can tell which is true. Minima less than 0.02 rad apart are one. Empty
    when there is none before the camera. Arguments and ValueError as for ``solve_lhm``.
    """
    points, rays = as_floats(points_tanker, 2), as_floats(uv, 2)
    table = np.empty((MAX_MINIMA, ROW))
    count = minima(points, rays, tol, epsilon, kernel_of(method), table)
    found = (unpack(row) for row in table[:count] if row[16] and row[17])
    return tuple(sorted(found, key=lambda result: result.object_error))


def minima(points: Mat, uv: Mat, tol: float, epsilon: float, kernel: int, table: Mat) -> int:
    """Write minima into table (k, ROW), return how many; ValueError when the points do not fix a pose."""
    status, count = search(points, uv, float(tol), float(epsilon), kernel, table)
    if status != OK:
        raise ValueError(complaint(status, points, uv))
    return count


def unpack(row: Mat) -> LhmResult:
    """Turn a row of the search into a result."""
    iterations, object_error, image_error, settled, ahead, _ = row[12:].tolist()
    T = rigid(row[:9].reshape(3, 3).copy(), row[9:12].copy())
    return result(T, int(iterations), object_error, image_error, bool(settled and ahead))


def as_floats(a: Mat, dimensions: int) -> Mat:
    """Return a as a contiguous float64 array; ValueError unless it has so many dimensions.

    Anything else, also an array that must not be written, would have the kernels compiled anew.
    """
    if type(a) is np.ndarray and a.dtype is FLOAT and a.ndim == dimensions and a.flags.carray:
        return a
    floats = np.ascontiguousarray(a, FLOAT)
    if floats.ndim != dimensions:
        msg = f"points_tanker must be (n, 3), uv (n, 2), a rotation (3, 3), a translation (3,); one is {floats.shape}"
        raise ValueError(msg)
    return floats if floats.flags.writeable else floats.copy()


def kernel_of(method: str) -> int:
    """Return the number of a kernel; ValueError when there is none of that name."""
    if method not in METHODS:
        msg = f"method must be 'svd' or 'quaternion', not {method!r}"
        raise ValueError(msg)
    return METHODS[method]


def complaint(status: int, points: Mat, uv: Mat) -> str:
    """Say in words what a kernel found wrong."""
    if status in {WRONG_SHAPE, FEW_POINTS}:
        return f"{COMPLAINTS[status]}, not {points.shape} and {uv.shape}"
    return COMPLAINTS[status]


def weak_perspective_rotation(points_tanker: Mat, uv: Mat) -> Mat:
    """Return the thesis' cold start R (3, 3): image points as if they were the scene (thesis 6.2.5), never reflected.

    The image points lie on a plane, so that the third row of the listing's rotation has either sign by chance: a cold
    start without the guard begins, and in many near scenes ends, with a reflection. Good for far and shallow scenes
    only. Raises ValueError as ``solve_lhm`` does.
    """
    points, rays = as_floats(points_tanker, 2), as_floats(uv, 2)
    check_geometry(points, rays)
    q = np.column_stack([rays, np.ones(len(rays))])
    return rotation_svd(np.ascontiguousarray((q - q.mean(axis=0)).T @ (points - points.mean(axis=0))))


def check_geometry(points: Mat, uv: Mat) -> None:
    """Raise ValueError unless points (n, 3) and uv (n, 2) can fix a pose."""
    status, *_ = fold(points, uv)
    if status != OK:
        raise ValueError(complaint(status, points, uv))


def rms_object_error(points: Mat, uv: Mat, T_cam_tanker: SE3) -> float:
    """Return the RMS distance in m of points (n, 3) from their lines of sight uv (n, 2) (thesis eq. 6.18)."""
    q = T_cam_tanker.transform(points)
    rays = np.column_stack([uv, np.ones(len(uv))])
    off = np.cross(rays, q) / np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
    return float(np.sqrt(np.einsum("ij,ij->", off, off) / len(points)))
