"""Pose of the tanker by maximum likelihood: refinement of a solver's answer, its covariance and its residuals.

Rules
-----
* Marker i is seen on the plane z = 1 with an error of standard deviation ``sigma[i]`` per axis, independent of the
  others: the pose minimises chi2 = sum |uv - h(T)|^2 / sigma^2, where LHM weighs far markers more (thesis eq. 6.18).
* An attitude measured otherwise, the relative one of the two INS, may join with its covariance. It then takes two
  markers, and one estimator covers two to all of them: a marker more never makes the covariance larger.
* Covariances are of (translation in m, rotation in rad), both in camera axes, of a move from the left:
  t_true = t + d[:3], R_true = exp(d[3:]) R.
* The covariance is the inverse of the information, the Cramer-Rao bound of an unbiased estimator, at the
  pose; it says what the noise does, not what a wrong label does. That is for the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.geometry import SE3, Mat, Vec
from companion.vision.refinement_kernel import (
    BAD_ATTITUDE,
    BAD_SIGMA,
    BAD_START,
    COVARIANCE,
    HEAD,
    NOT_A_ROTATION,
    NOT_FINITE,
    OK,
    ROTATION,
    STATUS,
    TRANSLATION,
    WEAK,
    bound,
    refine,
)

COMPLAINTS = {
    NOT_FINITE: "points, uv, sigma, the pose and the attitude must be finite numbers",
    BAD_SIGMA: "sigma must be positive: standard deviations on the plane z = 1",
    NOT_A_ROTATION: "R of the pose must be a rotation matrix (3, 3)",
    BAD_ATTITUDE: "R_prior must be a rotation and cov_rotation symmetric and positive definite, both (3, 3)",
    WEAK: "the markers do not fix a pose: too few of them, or on one line",
    BAD_START: "a marker is not before the camera, or the attitude is half a turn off",
}

NO_ATTITUDE: Mat = np.empty((0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RefinedPose:
    """Outcome of ``refine_pose``.

    ``cov`` (6, 6) of (translation in m, rotation in rad), camera axes, move from the left. ``chi2`` is the sum of
    ``squared_residuals`` (n,), |uv - h|^2 / sigma^2, and of the attitude's share; with the right labels it is
    chi-square distributed with ``degrees_of_freedom``. ``studentised`` (n,) weighs each residual by its own covariance
    instead, sigma^2 I - J cov J^T: chi-square with two degrees of freedom, and to first order what chi2 falls by when
    the marker is left out. It is NaN where the pose follows the marker whatever it says.
    ``image_error`` RMS distance on z = 1, ``nearest_m`` smallest depth. ``converged`` says that the next step would be
    about a ten-thousandth of a standard deviation. When the start has a marker behind the camera it is
    returned as it is, not converged, with a covariance of NaN.
    """

    T_cam_tanker: SE3
    cov: Mat
    squared_residuals: Vec
    studentised: Vec
    chi2: float
    degrees_of_freedom: int
    image_error: float
    nearest_m: float
    iterations: int
    converged: bool


def refine_pose(
    points_tanker: Mat,
    uv: Mat,
    T_init: SE3,
    sigma: Vec,
    R_prior: Mat | None = None,
    cov_rotation: Mat | None = None,
) -> RefinedPose:
    """Return the most likely pose near ``T_init`` (Gauss-Newton, damped as by Marquardt 1963 where it must be).

    ``points_tanker`` (n, 3) m, tanker axes; ``uv`` (n, 2) seen on the plane z = 1, undistorted; ``sigma`` (n,) standard
    deviation per axis on that plane. ``R_prior`` is R_cam_tanker as measured otherwise, R_true = exp(e) R_prior
    with ``cov_rotation`` (3, 3) the covariance of e, rad^2, camera axes. n >= 3 without it, n >= 2 with it.

    Raises ValueError for wrong shapes, numbers that are not finite or not positive, and markers that fix no pose.
    """
    points, rays, deviations = check_markers(points_tanker, uv, sigma)
    R_attitude, cov_attitude = check_attitude(len(points), R_prior, cov_rotation)
    R0, t0 = check_pose(T_init)
    out = refine(points, rays, deviations, R0, t0, R_attitude, cov_attitude)
    n = len(points)
    status, chi2, squared_image, nearest_m, iterations, settled = out[STATUS:HEAD].tolist()
    if status not in {OK, BAD_START}:
        raise ValueError(COMPLAINTS[int(status)])
    return RefinedPose(
        SE3(out[ROTATION:TRANSLATION].reshape(3, 3), out[TRANSLATION:COVARIANCE]),
        out[COVARIANCE:STATUS].reshape(6, 6),
        out[HEAD : HEAD + n],
        out[HEAD + n :],
        chi2,
        2 * n - 6 if R_prior is None else 2 * n - 3,
        (squared_image / n) ** 0.5,
        nearest_m,
        int(iterations),
        settled == 1.0,
    )


def pose_covariance(
    points_tanker: Mat,
    T_cam_tanker: SE3,
    sigma: Vec,
    R_prior: Mat | None = None,
    cov_rotation: Mat | None = None,
) -> Mat:
    """Return the covariance (6, 6) of the pose that n markers at ``T_cam_tanker`` fix: the Cramer-Rao bound there.

    Arguments as those of ``refine_pose``. Raises ValueError also when a marker is not before the camera.
    """
    points, rays, deviations = check_markers(points_tanker, np.zeros((len(points_tanker), 2)), sigma)
    R_attitude, cov_attitude = check_attitude(len(points), R_prior, cov_rotation)
    R, t = check_pose(T_cam_tanker)
    cov = np.empty((6, 6))
    status = bound(points, rays, deviations, R, t, R_attitude, cov_attitude, cov)
    if status != OK:
        raise ValueError(COMPLAINTS[status])
    return cov


def check_markers(points_tanker: Mat, uv: Mat, sigma: Vec) -> tuple[Mat, Mat, Vec]:
    """Return the three as contiguous float64; ValueError unless they are (n, 3), (n, 2) and (n,)."""
    points = np.ascontiguousarray(points_tanker, dtype=np.float64)
    rays = np.ascontiguousarray(uv, dtype=np.float64)
    deviations = np.ascontiguousarray(sigma, dtype=np.float64)
    n = len(points)
    if points.shape != (n, 3) or rays.shape != (n, 2) or deviations.shape != (n,):
        msg = (
            f"points_tanker must be (n, 3), uv (n, 2) and sigma (n,), "
            f"not {points.shape}, {rays.shape} and {deviations.shape}"
        )
        raise ValueError(msg)
    return points, rays, deviations


def check_attitude(n: int, R_prior: Mat | None, cov_rotation: Mat | None) -> tuple[Mat, Mat]:
    """Return attitude and covariance as the kernel takes them; ValueError for one alone or for too few markers n."""
    if (R_prior is None) != (cov_rotation is None):
        msg = "R_prior and cov_rotation go together: an attitude and its covariance"
        raise ValueError(msg)
    least = 3 if R_prior is None else 2
    if n < least:
        msg = f"a pose needs at least {least} markers {'without' if R_prior is None else 'with'} an attitude, not {n}"
        raise ValueError(msg)
    if R_prior is None or cov_rotation is None:
        return NO_ATTITUDE, NO_ATTITUDE
    R = np.ascontiguousarray(R_prior, dtype=np.float64)
    cov = np.ascontiguousarray(cov_rotation, dtype=np.float64)
    if R.shape != (3, 3) or cov.shape != (3, 3):
        raise ValueError(COMPLAINTS[BAD_ATTITUDE])
    return R, cov


def check_pose(T: SE3) -> tuple[Mat, Vec]:
    """Return R and t as contiguous float64; ValueError unless they are (3, 3) and (3,)."""
    R, t = np.ascontiguousarray(T.R, dtype=np.float64), np.ascontiguousarray(T.t, dtype=np.float64)
    if R.shape != (3, 3) or t.shape != (3,):
        msg = f"a pose has R (3, 3) and t (3,), not {R.shape} and {t.shape}"
        raise ValueError(msg)
    return R, t
