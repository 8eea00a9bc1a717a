"""Feature points without lights: corners of the airframe at known places (thesis 1, "tanker corners").

The thesis names such points and gives no algorithm; this is the classic one.

Rules
-----
* A candidate is a local maximum of the least eigenvalue of the structure tensor, averaged over 5 by 5 pixels: where
  the picture changes in every direction (Shi and Tomasi 1994). The tensor is summed over the three colours (Di Zenzo
  1986), so that an edge counts whatever colours it parts.
* Its place is the point nearest to the lines along all edges about it (Förstner and Gülch 1987): the crossing of two
  silhouette edges, though the blurred corner itself is rounded.
* Nothing here knows which corner is which, and many are of no map (lights, shading): labeling decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config import CornerConfig
from companion.geometry import Mat, Vec
from companion.vision import corners_kernel as kernels

DEFAULT = CornerConfig()


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Candidates of one picture, strongest first.

    ``uv_px`` (m, 2), x right, y down, pixel centres at integers; ``sigma_px`` (m,) standard deviation per axis;
    ``area_px`` (m,) how many pixels each was measured on; ``strength`` (m,) least eigenvalue of the averaged tensor, in
    squared steps of 1/255 per px.
    """

    uv_px: Mat
    sigma_px: Vec
    area_px: Vec
    strength: Vec


def detect_corners(
    image: NDArray[np.uint8], predicted_uv_px: Mat | None = None, config: CornerConfig = DEFAULT
) -> Corners:
    """Find corners in ``image`` (h, w, 3) uint8 RGB, strongest first, within ``gate_px`` of each predicted place.

    ``predicted_uv_px`` (n, 2) in px: rows that are NaN or too far outside the picture are left out; None looks in the
    whole picture. Keeps ``max_per_window`` of each window and ``max_detections`` of all. Raises ValueError when the
    picture or the places are not of that shape and type.
    """
    shape, kind = np.shape(image), getattr(image, "dtype", type(image).__name__)
    if len(shape) != 3 or shape[2] != 3 or kind != np.uint8 or 0 in shape:
        msg = f"image must be (h, w, 3) uint8, not {shape} {kind}"
        raise ValueError(msg)
    windows = np.array([[0, image.shape[1] - 1, 0, image.shape[0] - 1]])
    most = config.max_detections
    if predicted_uv_px is not None:
        windows, most = windows_about(predicted_uv_px, image.shape[:2], config.gate_px), config.max_per_window
    picture = np.ascontiguousarray(image)[:]
    picture.flags.writeable = False  # as those off a wire are: the kernels are compiled for one of both only
    found = np.empty((len(windows) * most, 4))
    count = kernels.corners_in(
        picture, windows, most, config.radius_px, config.apart_px, config.min_gradient**2, found
    )
    found = found[:count]
    found = found[np.argsort(-found[:, kernels.STRENGTH], kind="stable")[: config.max_detections]]
    sigma = np.hypot(found[:, kernels.SIGMA], config.sigma_floor_px)
    area = np.full(len(found), float((2 * config.radius_px + 1) ** 2))
    return Corners(found[:, :2].copy(), sigma, area, found[:, kernels.STRENGTH].copy())


def windows_about(predicted_uv_px: Mat, shape: tuple[int, ...], gate_px: float) -> NDArray[np.int64]:
    """Return first and last column and row (n, 4) of the windows about the places that are near a picture (h, w)."""
    uv = np.asarray(predicted_uv_px, dtype=np.float64)
    if uv.ndim != 2 or uv.shape[1] != 2:
        msg = f"predicted_uv_px must be (n, 2), not {uv.shape}"
        raise ValueError(msg)
    size = np.array([shape[1], shape[0]])
    near = ((uv > -gate_px) & (uv < size - 1 + gate_px)).all(axis=1)  # false for NaN
    first = np.clip(np.ceil(uv[near] - gate_px), 0, size - 1).astype(np.int64)
    last = np.clip(np.floor(uv[near] + gate_px), 0, size - 1).astype(np.int64)
    return np.stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]], axis=1)
