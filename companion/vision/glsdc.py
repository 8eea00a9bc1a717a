"""Pose of the tanker by Gaussian least squares differential correction (thesis 5.2.2, 5.3, listing 10.3.1).

Rules
-----
* Gauss-Newton on X = (x, y, z, psi, theta, phi) in the thesis' camera axes, forward, right, down: R_crf_tanker =
  Rx(phi) Ry(theta) Rz(psi) (thesis eq. 5.41). There the geometry of refuelling keeps theta near the camera's look-up
  angle, far from the singularity at a right angle. Optical axes outside; converted at the edge.
* A fixed number of iterations, as in the thesis (3 nominal in 5.3, 4 in 7.1). Whether they led anywhere is said in
  ``converged``: Gauss-Newton without a search along its step may go up, go round, or go away.
* Where the thesis contradicts itself: the listing's angles are those of the transposed matrix of eq. 5.41; its start of
  7.5.4 (theta = 0.467, looking up) fits eq. 5.41, which is what is done here. The covariance below eq. 5.55 has
  1 / sigma for 1 / sigma^2: ``weights`` are the factors of the squared errors, however they came about.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.geometry import SE3, Mat, Vec
from companion.vision.absolute_orientation import check_weights
from companion.vision.frozen import blank, rigid, slots_of
from companion.vision.glsdc_kernel import FEW_MARKERS, correct
from companion.vision.lhm import as_floats
from companion.vision.lhm_kernel import NOT_A_ROTATION, NOT_FINITE, OK

ALL_ALIKE: Mat = np.empty((0, 2))

COMPLAINTS = {
    NOT_FINITE: "points_tanker, uv and T_init must be finite numbers",
    NOT_A_ROTATION: "T_init must hold a rotation matrix (3, 3) and a translation (3,)",
}


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


put_pose, put_iterations, put_image_error, put_converged = slots_of(GlsdcResult)


def result(T: SE3, iterations: int, image_error: float, converged: bool) -> GlsdcResult:
    """Return ``GlsdcResult`` of these fields."""
    made = blank(GlsdcResult)
    put_pose(made, T)
    put_iterations(made, iterations)
    put_image_error(made, image_error)
    put_converged(made, converged)
    return made


def solve_glsdc(
    points_tanker: Mat,
    uv: Mat,
    T_init: SE3,
    iterations: int = 4,
    weights: Mat | Vec | None = None,
    min_markers: int = 4,
) -> GlsdcResult:
    """Return the pose near ``T_init`` with the least squared image error of markers (n, 3), m, tanker axes.

    ``uv`` (n, 2) are the markers seen on the plane z = 1, undistorted; any number of them from ``min_markers`` on, 4 in
    the thesis (5.3), counting those that have weight. ``weights`` (n,) or (n, 2) is the diagonal of W (eq. 5.52), all
    alike when None. When the normal equations become singular or numbers overflow the last finite pose is
    returned, not converged.

    Raises ValueError for wrong shapes, numbers that are not finite, weights that are negative, too few markers and a
    start that is no rotation.
    """
    points, rays = as_floats(points_tanker, 2), as_floats(uv, 2)
    W = ALL_ALIKE if weights is None else check_weights(weights, len(points), 2)
    R0, t0 = as_floats(T_init.R, 2), as_floats(T_init.t, 1)
    R, t = np.empty((3, 3)), np.empty(3)
    status, done, image_error, converged = correct(points, rays, R0, t0, int(iterations), W, int(min_markers), R, t)
    if status != OK:
        raise ValueError(complaint(status, points, rays, min_markers))
    return result(rigid(R, t), done, image_error, converged)


def complaint(status: int, points: Mat, uv: Mat, min_markers: int) -> str:
    """Say in words what the kernel found wrong."""
    if status == FEW_MARKERS:
        return f"GLSDC needs at least {min_markers} markers that have weight; {len(points)} were given"
    if status in COMPLAINTS:
        return COMPLAINTS[status]
    return f"points_tanker must be (n, 3) and uv (n, 2), not {points.shape} and {uv.shape}"
