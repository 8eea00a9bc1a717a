"""Whether a pose may be passed on: what is asked of it, in the order in which it is asked.

=================== ==================================================================================================
verdict             meaning
=================== ==================================================================================================
``few_markers``     fewer markers than ``min_markers``, or than ``min_markers_ins`` with the attitude of the INS
``behind_camera``   a marker is not before the camera
``not_finite``      pose or covariance is no finite number
``weak_geometry``   position known worse than ``max_sigma_m`` or attitude than ``max_sigma_rad``: markers bunched, in a
                    row, or too few for the distance
``not_converged``   the refinement did not settle
``residual``        the markers do not fit the pose: chi2 is beyond what noise does with ``residual_probability``
=================== ==================================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtri

from companion.config import CameraConfig, VisionConfig
from companion.vision.refinement import RefinedPose

Verdict = Literal["few_markers", "behind_camera", "not_finite", "weak_geometry", "not_converged", "residual"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseLimits:
    """Limits of a camera and a configuration; ``max_chi2`` by degrees of freedom, without limit for none.

    ``sigma`` is the assumed noise of a centroid on the plane z = 1, per axis.
    """

    sigma: float
    max_sigma_m: float
    max_sigma_rad: float
    max_chi2: tuple[float, ...]
    min_markers: int
    min_markers_ins: int


def pose_limits(vision: VisionConfig, camera: CameraConfig, markers: int) -> PoseLimits:
    """Return the limits for poses of up to so many ``markers``: quantiles are looked up later, not worked out."""
    quantiles = (float(chdtri(dof, vision.residual_probability)) for dof in range(1, 2 * markers + 1))
    return PoseLimits(
        sigma=vision.sigma_px / math.sqrt(camera.fx_px * camera.fy_px),
        max_sigma_m=vision.max_sigma_m,
        max_sigma_rad=vision.max_sigma_rad,
        max_chi2=(math.inf, *quantiles),
        min_markers=vision.min_markers,
        min_markers_ins=vision.min_markers_ins,
    )


def position_sigma_m(pose: RefinedPose) -> float:
    """Return the standard deviation of the position in space: root of the trace, at least that of any direction."""
    cov = pose.cov
    return math.sqrt(cov[0, 0] + cov[1, 1] + cov[2, 2])


def attitude_sigma_rad(pose: RefinedPose) -> float:
    """Return the standard deviation of the attitude, likewise."""
    cov = pose.cov
    return math.sqrt(cov[3, 3] + cov[4, 4] + cov[5, 5])


def judge_pose(pose: RefinedPose, limits: PoseLimits) -> tuple[Verdict, str] | None:
    """Return why ``pose`` must not be passed on, with a detail for people, or None."""
    unusable = complaint(pose, limits)
    if unusable is not None:
        return unusable
    sigma_m, sigma_rad = position_sigma_m(pose), attitude_sigma_rad(pose)
    if sigma_m > limits.max_sigma_m or sigma_rad > limits.max_sigma_rad:
        return "weak_geometry", f"{sigma_m:.2f} m and {sigma_rad:.3f} rad from {len(pose.squared_residuals)} markers"
    if not pose.converged:
        return "not_converged", f"{pose.iterations} steps of the refinement"
    limit = limits.max_chi2[pose.degrees_of_freedom]
    if pose.chi2 > limit:
        return "residual", f"chi2 {pose.chi2:.1f} above {limit:.1f}"
    return None


def complaint(pose: RefinedPose, limits: PoseLimits) -> tuple[Verdict, str] | None:
    """Return why the numbers of ``pose`` mean nothing, or None."""
    n = len(pose.squared_residuals)
    with_attitude = pose.degrees_of_freedom > 2 * n - 6
    least = limits.min_markers_ins if with_attitude else limits.min_markers
    if n < least:
        return "few_markers", f"{n} of {least}"
    if pose.nearest_m <= 0.0:
        return "behind_camera", f"nearest marker at {pose.nearest_m:.2f} m"
    # A NaN anywhere in the pose is one in chi2, and one in the covariance is one on its diagonal.
    if not math.isfinite(pose.chi2 + float(np.trace(pose.cov))):
        return "not_finite", ""
    return None
