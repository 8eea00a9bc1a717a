"""From labelled markers to one measured pose: solver, refinement, judgement (thesis 4.2.6).

Rules
-----
* ``min_markers`` and more: the thesis' solver (LHM or GLSDC) from the prior, then maximum likelihood where the
  configuration asks for it. Fewer, or a geometry that fixes the place badly: the attitude of the INS, which the prior
  has, and the translation from the picture.
* What cannot be solved from the prior is solved once more from no start at all, by LHM. Where two minima fit about
  equally well the prior decides; without a prior both are told.
* A pose that fails one of ``quality``'s questions is not passed on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.config import CameraConfig, VisionConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.glsdc import solve_glsdc
from companion.vision.lhm import LhmResult, rms_object_error, solve_lhm, solve_lhm_minima
from companion.vision.quality import judge_pose, pose_limits
from companion.vision.refinement import RefinedPose, pose_covariance, refine_pose
from companion.vision.translation import solve_translation

CLOSE = 2.0
"""Minima of the object-space error that differ by less than this factor are told apart by the prior only."""

NEEDS_HELP = ("few_markers", "weak_geometry")
"""What the attitude of the INS may mend. Five markers on one line are a wrong map, not a lack of light: no pose."""

Refusal = tuple[str, str]
"""Reason and detail of a reject."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPose:
    """A pose that may be passed on; fields as in ``companion.messages.PoseMeasurement``."""

    T_cam_tanker: SE3
    cov: Mat
    iterations: int
    object_error_m: float
    image_error: float
    alternative: SE3 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What a solver found."""

    T_cam_tanker: SE3
    iterations: int
    object_error_m: float
    image_error: float
    converged: bool
    alternative: SE3 | None = None


class PoseEstimator:
    """Solves, refines and judges for one camera, one configuration and up to ``markers`` markers."""

    def __init__(self, camera: CameraConfig, config: VisionConfig, markers: int) -> None:
        self._config = config
        self._limits = pose_limits(config, camera, markers)
        self._focal_px = float(np.sqrt(camera.fx_px * camera.fy_px))
        self._cov_ins: Mat = config.ins_sigma_rad**2 * np.eye(3)

    def measure(
        self, points: Mat, uv: Mat, sigma: Vec, prior: SE3 | None, *, verified: bool
    ) -> MeasuredPose | Refusal:
        """Return the pose of markers ``points`` (n, 3) seen at ``uv`` (n, 2) on z = 1, or why there is none.

        ``sigma`` (n,) standard deviation per axis on z = 1. ``prior`` T_cam_tanker, its rotation from the INS.
        ``verified``: the labels are known to be right. Two or three markers fit some pose whatever they are, so
        that with labels that nobody has verified there is none from fewer than ``min_markers``.
        """
        c = self._config
        helped = verified and c.refine and c.ins_attitude != "never" and len(points) >= c.min_markers_ins
        found: MeasuredPose | Refusal = "few_markers", f"{len(points)} of {c.min_markers}"
        if len(points) >= c.min_markers:
            try:
                found = self._free(points, uv, sigma, prior)
            except ValueError as error:  # what the solvers say of markers that do not fix a pose
                found = "degenerate", str(error)
        if isinstance(found, tuple) and found[0] in NEEDS_HELP and helped and prior is not None:
            try:
                found = self._judged(solve_translation(points, uv, prior.R, sigma, self._cov_ins), points, uv)
            except ValueError as error:
                return "degenerate", str(error)
        return found

    def _free(self, points: Mat, uv: Mat, sigma: Vec, prior: SE3 | None) -> MeasuredPose | Refusal:
        """Solve for rotation and translation, from the prior if there is one."""
        solved = cold(points, uv, None) if prior is None else self._from(points, uv, prior)
        found = self._finish(solved, points, uv, sigma, prior)
        if isinstance(found, MeasuredPose) or prior is None or not self._config.refine:
            return found
        again = self._finish(cold(points, uv, prior), points, uv, sigma, prior)
        return again if isinstance(again, MeasuredPose) else found

    def _from(self, points: Mat, uv: Mat, prior: SE3) -> Solved:
        """Run the configured solver from the prior, as the thesis does."""
        c = self._config
        if c.solver == "lhm":
            return of_lhm(solve_lhm(points, uv, prior.R, c.tol, c.epsilon, c.method))
        g = solve_glsdc(points, uv, prior, c.glsdc_iterations, min_markers=c.min_markers)
        error_m = rms_object_error(points, uv, g.T_cam_tanker)
        return Solved(g.T_cam_tanker, g.iterations, error_m, g.image_error, g.converged)

    def _finish(self, s: Solved, points: Mat, uv: Mat, sigma: Vec, prior: SE3 | None) -> MeasuredPose | Refusal:
        """Refine and judge what a solver found, or judge it as it is."""
        c = self._config
        if not s.converged:
            return "not_converged", f"{c.solver}, {s.iterations} iterations"
        if c.refine:
            attitude = (prior.R, self._cov_ins) if prior is not None and c.ins_attitude == "always" else ()
            refined = refine_pose(points, uv, s.T_cam_tanker, sigma, *attitude)
            return self._judged(refined, points, uv, s.iterations, s.alternative)
        if not s.image_error * self._focal_px <= c.max_image_error_px:
            return "image_error", f"{s.image_error * self._focal_px:.2f} px"
        cov = pose_covariance(points, s.T_cam_tanker, sigma)
        return MeasuredPose(s.T_cam_tanker, cov, s.iterations, s.object_error_m, s.image_error, s.alternative)

    def _judged(self, pose: RefinedPose, points: Mat, uv: Mat, iterations: int = 0,
                alternative: SE3 | None = None) -> MeasuredPose | Refusal:
        refusal = judge_pose(pose, self._limits)
        if refusal is not None:
            return refusal
        error_m = rms_object_error(points, uv, pose.T_cam_tanker)
        return MeasuredPose(pose.T_cam_tanker, pose.cov, iterations + pose.iterations, error_m, pose.image_error,
                            alternative)


def of_lhm(r: LhmResult) -> Solved:
    """Return a result of LHM as ``Solved``."""
    return Solved(r.T_cam_tanker, r.iterations, r.object_error, r.image_error, r.converged)


def cold(points: Mat, uv: Mat, prior: SE3 | None) -> Solved:
    """Return the best minimum of LHM from no start, or of those about as good the one nearest to the prior's rotation.

    Without a prior the second of two that are about as good comes along as ``alternative``.
    """
    minima = solve_lhm_minima(points, uv)
    if not minima:
        return Solved(SE3.identity(), 0, np.inf, np.inf, converged=False)
    close = [m for m in minima if m.object_error <= CLOSE * minima[0].object_error]
    if prior is None:
        alternative = close[1].T_cam_tanker if len(close) > 1 else None
        m = close[0]
        return Solved(m.T_cam_tanker, m.iterations, m.object_error, m.image_error, m.converged, alternative)
    return of_lhm(max(close, key=lambda m: float(np.sum(m.T_cam_tanker.R * prior.R))))
