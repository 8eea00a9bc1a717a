"""The vision chain: one picture and a prior pose to one measured pose (thesis Fig. 4.2).

Predicted markers (4.2.3) -> detection (4.2.1) -> labeling (4.2.4) -> scale (4.2.2) -> pose (4.2.6). A picture that
gives no pose gives a ``Reject`` that says why; nothing here raises on what comes from outside.

========================= ============================================================================================
reason                    meaning
========================= ============================================================================================
``frame_size``            the picture is not (height, width, 3) of the camera's configuration, or not uint8
``prior_not_finite``      the prior pose has a NaN or an infinity
``few_markers``           fewer markers labelled than ``min_markers`` (thesis: 5 for LHM, 4 for GLSDC)
``degenerate``            the solver refuses: markers or rays that do not fix a pose, a prior that is no rotation
``not_converged``         the solver did not settle on a pose with all markers before the camera
``image_error``           the RMS image error of the pose is above ``max_image_error_px``
========================= ============================================================================================
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, TankerConfig, VisionConfig
from companion.geometry import SE3, Mat
from companion.messages import CameraFrame, Detections, PoseMeasurement, Reject, VisionMode, VisionOutput
from companion.vision.camera import pixels_to_normalised, project
from companion.vision.detection import detect_markers
from companion.vision.glsdc import solve_glsdc
from companion.vision.labeling import label_mutual_nearest
from companion.vision.lhm import rms_object_error, solve_lhm


class VisionChain:
    """Detection, labeling and pose for one camera and one tanker."""

    def __init__(self, camera: CameraConfig, tanker: TankerConfig, config: VisionConfig) -> None:
        self.camera = camera
        self.config = config
        self.mode = VisionMode(config.mode)
        self.markers: Mat = np.array([m.p_tanker_m for m in tanker.markers], dtype=np.float64).reshape(-1, 3)
        self.max_image_error = config.max_image_error_px / float(np.sqrt(camera.fx_px * camera.fy_px))

    def process(self, frame: CameraFrame, prior_T_cam_tanker: SE3) -> VisionOutput:
        """Return what ``frame`` shows, given about where the tanker is: T_cam_tanker from fusion (thesis 3.2)."""
        prior = prior_T_cam_tanker
        predicted = np.full((len(self.markers), 2), np.nan)
        detections = Detections(frame.t_ns, np.empty((0, 2)), np.empty(0))
        labels = np.full(len(self.markers), -1, dtype=np.int64)
        found: PoseMeasurement | tuple[str, str]
        if not (np.isfinite(prior.R).all() and np.isfinite(prior.t).all()):
            found = "prior_not_finite", ""
        else:
            predicted = project(self.camera, prior, self.markers)
            bad = self._complaint(frame)
            if bad and self.mode is VisionMode.REAL:
                found = "frame_size", bad
            else:
                detections, labels = self._see(frame, predicted)
                found = self._pose(detections, labels, prior)
        if isinstance(found, PoseMeasurement):
            return VisionOutput(frame.t_ns, frame.sequence, detections, predicted, found, None)
        reject = Reject(frame.t_ns, "vision", *found)
        return VisionOutput(frame.t_ns, frame.sequence, detections, predicted, None, reject)

    def _complaint(self, frame: CameraFrame) -> str:
        """Say what is wrong with the picture, or nothing."""
        shape, kind = np.shape(frame.image), getattr(frame.image, "dtype", type(frame.image))
        wanted = (self.camera.height_px, self.camera.width_px, 3)
        if shape == wanted and kind == np.uint8:
            return ""
        return f"picture is {shape} {kind}, camera '{self.camera.name}' gives {wanted} uint8"

    def _see(self, frame: CameraFrame, predicted: Mat) -> tuple[Detections, NDArray[np.int64]]:
        """Return detections and labels: of the picture, or of the predicted markers themselves (thesis 4.2.5)."""
        if self.mode is VisionMode.SIMULATED:
            size = np.array([self.camera.width_px, self.camera.height_px])
            inside = ((predicted > -0.5) & (predicted < size - 0.5)).all(axis=1)
            labels = np.where(inside, np.cumsum(inside) - 1, -1)
            return Detections(frame.t_ns, predicted[inside], np.zeros(inside.sum())), labels
        blobs = detect_markers(frame.image, self.config.detection)
        labels = label_mutual_nearest(predicted, blobs.uv_px, self.config.labeling.max_distance_px)
        return Detections(frame.t_ns, blobs.uv_px, blobs.area_px), labels

    def _pose(
        self, detections: Detections, labels: NDArray[np.int64], prior: SE3
    ) -> PoseMeasurement | tuple[str, str]:
        """Return the pose of the labelled markers, or reason and detail of why there is none."""
        used = np.flatnonzero(labels >= 0)
        uv = pixels_to_normalised(self.camera, detections.uv_px[labels[used]])
        reached = np.isfinite(uv).all(axis=1)  # a pixel beyond the reach of the distortion model has no ray
        labels[used[~reached]] = -1
        used, uv = used[reached], uv[reached]
        if len(used) < self.config.min_markers:
            return "few_markers", f"{len(used)} of {self.config.min_markers}"
        try:
            T, iterations, object_error, image_error, converged = self._solve(self.markers[used], uv, prior)
        except ValueError as error:  # what the solvers say of markers that do not fix a pose
            return "degenerate", str(error)
        if not converged:
            return "not_converged", f"{self.config.solver}, {iterations} iterations"
        if not image_error <= self.max_image_error:
            return "image_error", f"{image_error / self.max_image_error * self.config.max_image_error_px:.2f} px"
        return PoseMeasurement(detections.t_ns, T, labels, len(used), iterations, object_error, image_error)

    def _solve(self, points: Mat, uv: Mat, prior: SE3) -> tuple[SE3, int, float, float, bool]:
        """Return pose, iterations, RMS object error in m, RMS image error on z = 1, and whether it converged."""
        c = self.config
        if c.solver == "lhm":
            r = solve_lhm(points, uv, prior.R, c.tol, c.epsilon, c.method)
            return r.T_cam_tanker, r.iterations, r.object_error, r.image_error, r.converged
        g = solve_glsdc(points, uv, prior, c.glsdc_iterations)
        return g.T_cam_tanker, g.iterations, rms_object_error(points, uv, g.T_cam_tanker), g.image_error, g.converged
