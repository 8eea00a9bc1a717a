"""Pose of the tanker from two markers or more when its attitude is known from the two INS.

Five markers are the least for LHM (thesis 6.3). With fewer in view the attitude is taken from the INS, as the thesis'
fusion does anyway (3.2), and the picture gives the translation: linear in closed form first, no prior position needed,
then by maximum likelihood with the attitude as a measurement among the others. So the attitude's uncertainty is in the
covariance, with its cross terms, and what redundancy there is corrects the attitude a little.

There is no cliff at five then (`make bench`, attitude known to 10 mrad, 0.3 px, 20 to 50 m: median sigma of the
position 0.035 m with nine, 0.055 with five, 0.071 with four, 0.115 with three, 0.231 with two). Five markers or more
fix the pose as well without the attitude (0.035 and 0.057 m), and an INS that is wrong cannot spoil it: that is the
default. With the attitude throughout, a marker more never makes the covariance larger, at the price of errors that
stay from one frame to the next, as those of an attitude do.

A translation with R kept as it was told would be a little simpler and, where the attitude is worse than the pixels
(several mrad; the lever arm of the markers is 10 m), much worse: its residuals would be weighed as if the attitude's
error were noise of the pixels, independent from one marker to the next.
"""

from __future__ import annotations

import numpy as np

from companion.geometry import SE3, Mat, Vec
from companion.vision.refinement import RefinedPose, check_attitude, check_markers, refine_pose

LEAST_DETERMINANT = 1e-12
"""Of the equations for t over their trace's cube, to tell rays from parallel ones: a few microradians of two rays."""

LEAST_SPREAD_M = 1e-6


def solve_translation(points_tanker: Mat, uv: Mat, R_cam_tanker: Mat, sigma: Vec, cov_rotation: Mat) -> RefinedPose:
    """Return the most likely pose of n >= 2 markers seen, given a measured attitude; no start is needed.

    Arguments as those of ``refine_pose``; ``R_cam_tanker`` is its ``R_prior``. The answer's rotation is the corrected
    one, its ``cov`` (6, 6) holds attitude and pixels. A start with markers behind the camera is returned not converged.

    Raises ValueError for fewer than two markers, markers at one place, parallel rays, and what ``refine_pose`` refuses.
    """
    points, rays, deviations = check_markers(points_tanker, uv, sigma)
    R, cov = check_attitude(len(points), R_cam_tanker, cov_rotation)
    t = linear_translation(points @ R.T, rays, deviations)
    return refine_pose(points, rays, SE3(R, t), deviations, R, cov)


def linear_translation(turned: Mat, uv: Mat, sigma: Vec) -> Vec:
    """Return t (3,) that brings the turned markers R p (n, 3) nearest to their rays, in m: thesis eq. 6.19, weighted.

    sum w (I - v v^T)(R p + t) = 0 over unit rays v, w = 1 / sigma^2.
    """
    if not (np.isfinite(turned).all() and np.isfinite(uv).all() and (sigma > 0.0).all()):
        msg = "points, uv and R must be finite numbers, sigma positive"
        raise ValueError(msg)
    if np.ptp(turned, axis=0).max() < LEAST_SPREAD_M:
        msg = "points_tanker are all at one place: they do not fix a translation"
        raise ValueError(msg)
    rays = np.column_stack([uv, np.ones(len(uv))])
    rays /= np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
    w = sigma.min() ** 2 / sigma**2
    M = w.sum() * np.eye(3) - (rays.T * w) @ rays
    # The eigenvalues of two rays are 2, 1 + cos, 1 - cos of their angle: the determinant is 2 sin^2.
    if not np.linalg.det(M) > LEAST_DETERMINANT * np.trace(M) ** 3:
        msg = "uv are all the same ray: they do not fix a translation"
        raise ValueError(msg)
    along = np.einsum("ij,ij->i", rays, turned)
    return -np.linalg.solve(M, w @ (turned - along[:, None] * rays))
