"""The vision chain: one picture and a prior pose to one measured pose (thesis Fig. 4.2).

Predicted markers (4.2.3) -> detection (4.2.1) -> labeling (4.2.4) -> scale (4.2.2) -> pose (4.2.6). Between labeling
and pose, lights that are not whole are told from their size (``expected_size``) and weigh less. A picture that gives no
pose gives a ``Reject`` that says why; nothing here raises on what comes from outside.

========================= ============================================================================================
reason                    meaning
========================= ============================================================================================
``frame_size``            the picture is not (height, width, 3) of the camera's configuration, or not uint8
``prior_not_finite``      the prior pose has a NaN or an infinity, or is too far away to be one
``few_markers``           fewer markers labelled than ``min_markers`` (thesis: 5 for LHM, 4 for GLSDC), and than
                          ``min_markers_ins`` where the attitude of the INS helps
``labels``                the robust labeling did not verify its labels; the detail is its own reason
``degenerate``            the solver refuses: markers or rays that do not fix a pose, a prior that is no rotation
``not_converged``         the solver did not settle on a pose with all markers before the camera
``image_error``           the RMS image error of a pose without refinement is above ``max_image_error_px``
``residual``, ...         a refined pose does not stand the questions of ``companion.vision.quality``
========================= ============================================================================================
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, TankerConfig, VisionConfig, landmarks
from companion.geometry import SE3, Mat, Vec
from companion.messages import CameraFrame, Detections, MarkerFrame, PoseMeasurement, Reject, VisionMode, VisionOutput
from companion.vision.camera import pixels_to_normalised, project
from companion.vision.corners import detect_corners
from companion.vision.detection import Blobs, detect_markers
from companion.vision.expected_size import apparent_radius_px, compare_with_expected
from companion.vision.labeler import Labeler
from companion.vision.pose import PoseEstimator, Refusal

Ints = NDArray[np.int64]

FARTHEST_M = 1e6
"""A prior farther away than this is no prior: its square still has digits to spare."""


def detections_of(t_ns: int, blobs: Blobs) -> Detections:
    """Return the detections of a picture as a message."""
    return Detections(t_ns, blobs.uv_px, blobs.area_px, blobs.sigma_px, blobs.flags)


class VisionChain:
    """Detection, labeling and pose for one camera and one tanker. ``mode`` may be switched between two frames."""

    def __init__(self, camera: CameraConfig, tanker: TankerConfig, config: VisionConfig) -> None:
        self.camera = camera
        self.config = config
        self.mode = VisionMode(config.mode)
        self._radius_m = tanker.marker_radius_m
        self.markers: Mat = np.array([m.p_tanker_m for m in landmarks(tanker, config)], dtype=np.float64).reshape(-1, 3)
        self._pose = PoseEstimator(camera, config, len(self.markers))
        self._focal_px = float(np.sqrt(camera.fx_px * camera.fy_px))
        self._labeler = Labeler(self.markers, config)

    def process(
        self, frame: CameraFrame | MarkerFrame, prior_T_cam_tanker: SE3 | None, *, tracked: bool = False
    ) -> VisionOutput:
        """Return what ``frame`` shows, given about where the tanker is: T_cam_tanker from fusion (thesis 3.2).

        None when nothing is known of where the tanker is: its lights are then searched for (``reacquire``).
        ``tracked``: the prior rests on a vision just passed, so that fewer labels than otherwise are sure.
        """
        prior = prior_T_cam_tanker
        if prior is not None and not (np.abs(prior.R).max() <= 2.0 and np.abs(prior.t).max() <= FARTHEST_M):
            return self._refused(frame, "prior_not_finite")
        if self.mode is VisionMode.SIMULATED:
            return self._simulated(frame, prior)
        if isinstance(frame, MarkerFrame):
            return self.measure(frame.sequence, frame.detections, prior, tracked=tracked)
        bad = self._complaint(frame)
        if bad:
            return self._refused(frame, "frame_size", bad, self._predicted(prior))
        if self.config.detector == "corners":
            places = None if prior is None else self._predicted(prior)
            corners = detect_corners(frame.image, places, self.config.corners)
            flags = np.zeros(len(corners.uv_px), dtype=np.uint8)
            detections = Detections(frame.t_ns, corners.uv_px, corners.area_px, corners.sigma_px, flags)
            return self.measure(frame.sequence, detections, prior, tracked=tracked)
        blobs = detect_markers(frame.image, self.config.detection)
        return self.measure(frame.sequence, detections_of(frame.t_ns, blobs), prior, blobs, tracked=tracked)

    def measure(
        self, sequence: int, detections: Detections, prior: SE3 | None, blobs: Blobs | None = None, *,
        tracked: bool = False,
    ) -> VisionOutput:
        """Label detections and solve for the pose: ``process`` without the picture.

        ``blobs``, when the detections are lights of a picture, tell which of them are whole.
        """
        predicted = self._predicted(prior)
        uv = pixels_to_normalised(self.camera, detections.uv_px)
        sigma = self._sigma(detections)
        found = self._labeler.label(
            predicted, detections.uv_px, uv, sigma, detections.area_px, prior, tracked=tracked
        )
        if isinstance(found, tuple):
            return self._output(sequence, detections, predicted, found)
        if blobs is not None and found.T_cam_tanker is not None:
            detections = self._weighed(detections.t_ns, blobs, found.labels, found.T_cam_tanker)
        return self._solved(sequence, detections, predicted, found.labels, uv, self._sigma(detections), prior)

    def _sigma(self, detections: Detections) -> Vec:
        """Return the standard deviations (m,) on z = 1: of the centroids, and of what calibration and map leave."""
        return np.hypot(detections.sigma_px, self.config.sigma_px) / self._focal_px

    def _weighed(self, t_ns: int, blobs: Blobs, labels: Ints, T_cam_tanker: SE3) -> Detections:
        """Return the detections with a larger sigma and a flag for labelled lights that are not whole."""
        expected = np.full(len(blobs.uv_px), np.nan)
        used = np.flatnonzero(labels >= 0)
        expected[labels[used]] = apparent_radius_px(self.camera, T_cam_tanker, self.markers[used], self._radius_m)
        return detections_of(t_ns, compare_with_expected(blobs, expected))

    def _simulated(self, frame: CameraFrame | MarkerFrame, prior: SE3 | None) -> VisionOutput:
        """Take the predicted markers themselves, those inside the picture, for what was seen (thesis 4.2.5)."""
        predicted = self._predicted(prior)
        size = np.array([self.camera.width_px, self.camera.height_px])
        inside = ((predicted > -0.5) & (predicted < size - 0.5)).all(axis=1)
        n = int(inside.sum())
        labels = np.where(inside, np.cumsum(inside) - 1, -1)
        detections = Detections(frame.t_ns, predicted[inside], np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.uint8))
        uv = pixels_to_normalised(self.camera, detections.uv_px)
        return self._solved(frame.sequence, detections, predicted, labels, uv, self._sigma(detections), prior)

    def _complaint(self, frame: CameraFrame) -> str:
        """Say what is wrong with the picture, or nothing."""
        image: object = frame.image
        wanted = (self.camera.height_px, self.camera.width_px, 3)
        if not isinstance(image, np.ndarray):
            return f"picture is a {type(image).__name__}, camera '{self.camera.name}' gives {wanted} uint8"
        if image.shape == wanted and image.dtype == np.uint8:
            return ""
        return f"picture is {image.shape} {image.dtype}, camera '{self.camera.name}' gives {wanted} uint8"

    def _predicted(self, prior: SE3 | None) -> Mat:
        """Return where the markers are expected (n, 2) in px; NaN where they cannot be or nothing is known."""
        if prior is None:
            return np.full((len(self.markers), 2), np.nan)
        return project(self.camera, prior, self.markers)

    def _solved(self, sequence: int, detections: Detections, predicted: Mat, labels: Ints, uv: Mat, sigma: Vec,
                prior: SE3 | None) -> VisionOutput:
        used = np.flatnonzero(labels >= 0)
        seen = labels[used]
        verified = self.config.labeling.method == "robust" or self.mode is VisionMode.SIMULATED
        found = self._pose.measure(self.markers[used], uv[seen], sigma[seen], prior, verified=verified)
        if isinstance(found, tuple):
            return self._output(sequence, detections, predicted, found, labels)
        pose = PoseMeasurement(
            detections.t_ns, found.T_cam_tanker, labels, len(used), found.iterations, found.object_error_m,
            found.image_error, found.cov, found.alternative,
        )
        return VisionOutput(detections.t_ns, sequence, detections, predicted, labels, pose, None)

    def _output(
        self, sequence: int, detections: Detections, predicted: Mat, refusal: Refusal, labels: Ints | None = None
    ) -> VisionOutput:
        reject = Reject(detections.t_ns, "vision", *refusal)
        labels = np.full(len(self.markers), -1) if labels is None else labels
        return VisionOutput(detections.t_ns, sequence, detections, predicted, labels, None, reject)

    def _refused(
        self, frame: CameraFrame | MarkerFrame, reason: str, detail: str = "", predicted: Mat | None = None
    ) -> VisionOutput:
        """Return that the frame was not looked at."""
        nothing = Detections(frame.t_ns, np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, dtype=np.uint8))
        return self._output(frame.sequence, nothing, self._predicted(None) if predicted is None else predicted,
                            (reason, detail))
