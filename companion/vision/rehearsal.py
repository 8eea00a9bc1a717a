"""Going once through all that the vision may have to do, so that no kernel is compiled while somebody waits.

Compiled kernels are kept on disk; on a new machine the first call of each takes seconds.
"""

from __future__ import annotations

import numpy as np

from companion.config import CameraConfig, TankerConfig, VisionConfig
from companion.geometry import SE3, Mat, R_cam_crf
from companion.messages import CameraFrame, Detections, VisionMode
from companion.vision.camera import pixels_to_normalised, project
from companion.vision.chain import VisionChain
from companion.vision.pose import cold
from companion.vision.robust_labeling import pose_of, priors_of, scene_of

AHEAD = SE3(R_cam_crf, np.array([0.0, 0.0, 60.0]))
"""A tanker straight ahead, level with the camera."""

FAR_OFF_M = np.array([4.0, 0.0, 0.0])
HALF_PX = 40.0
"""How far aside from their markers the detections are that are none."""


def rehearse(camera: CameraConfig, tanker: TankerConfig, config: VisionConfig) -> None:
    """See a tanker straight ahead, with the prior right and wrong, with most lights out, and with nothing but others.

    Raises ValueError for a configuration that the chain cannot be built of.
    """
    chain = VisionChain(camera, tanker, config)
    chain.mode = VisionMode.REAL  # simulated vision may be switched off in flight
    uv_px = project(camera, AHEAD, chain.markers)
    size = np.array([camera.width_px, camera.height_px])
    inside = np.flatnonzero(((uv_px >= 0.0) & (uv_px < size - 2.0)).all(axis=1))
    frame = CameraFrame(0, 0, picture_of(camera, uv_px[inside]))
    for _ in range(2):
        chain.process(frame, AHEAD)
    moved = SE3(AHEAD.R, AHEAD.t + FAR_OFF_M)
    for seen, prior in ((uv_px[inside], moved), (uv_px[inside[:3]], AHEAD), (uv_px[inside] + HALF_PX, AHEAD)):
        chain.measure(0, detections_at(seen), prior, tracked=len(seen) == 3)
    if len(inside) >= 4:
        cold(chain.markers[inside], pixels_to_normalised(camera, uv_px[inside]), AHEAD)
    fit_labels(chain, camera, uv_px, inside)


def fit_labels(chain: VisionChain, camera: CameraConfig, uv_px: Mat, inside: np.ndarray) -> None:
    """Fit a pose to labels of which some were left out, which only a contested frame asks for."""
    uv, config = pixels_to_normalised(camera, uv_px[inside]), chain.config.labeling
    scene = scene_of(chain.markers, uv, np.full(len(uv), 1e-3), config, None)
    priors = priors_of(AHEAD, np.eye(6), config)
    labels = np.full(len(chain.markers), -1, dtype=np.int64)
    labels[inside] = np.arange(len(inside))
    if priors is not None:
        pose_of(scene, labels, AHEAD, priors, np.zeros(6), config)


def picture_of(camera: CameraConfig, uv_px: Mat) -> np.ndarray:
    """Return a black picture with red squares of two pixels at the places (n, 2)."""
    image = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
    for u, v in uv_px.round().astype(int):
        image[v : v + 2, u : u + 2, 0] = 255
    return image


def detections_at(uv_px: Mat) -> Detections:
    """Return detections (m, 2) of which nothing else is known."""
    m = len(uv_px)
    return Detections(0, uv_px, np.full(m, 4.0), np.full(m, 0.1), np.zeros(m, dtype=np.uint8))
