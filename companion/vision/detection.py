"""Marker detection: red lights in a colour picture to sub-pixel centroids (thesis 4.2.1).

Rules
-----
* Redness of a pixel is its red value less the larger of green and blue. The thesis thresholds red alone, which a white
  fuselage passes too.
* A pixel is lit when its redness is above the threshold; touching lit pixels (8 neighbours) are one marker.
* A centroid is weighted with the share of each pixel that the marker covers, and includes the rim of pixels that are
  covered too little to be lit. The share is told from the redness of the marker and of what surrounds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import DetectionConfig
from companion.geometry import Mat, Vec
from companion.vision import detection_kernel as kernels

DEFAULT = DetectionConfig()


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Candidates of one picture: ``uv_px`` (m, 2), x right, y down, pixel centres at integers; ``area_px`` (m,) lit."""

    uv_px: Mat
    area_px: Vec


def detect_markers(image: NDArray[np.uint8], config: DetectionConfig = DEFAULT) -> Blobs:
    """Find the red lights in ``image`` (h, w, 3) uint8 RGB, in raster order of their topmost pixels.

    Keeps components of ``min_area_px`` to ``max_area_px`` lit pixels; the ``max_detections`` largest when there are
    more. ``morphology_px`` > 1 opens the lit mask with a square of that size first, which removes smaller specks and
    markers. Raises ValueError when the picture is not of that shape and type.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        msg = f"image must be (h, w, 3) uint8, not {image.shape} {image.dtype}"
        raise ValueError(msg)
    picture = np.ascontiguousarray(image)[:]
    picture.flags.writeable = False  # as those off a wire are: the kernels are compiled for one of both only
    lit, level = kernels.redness_of(picture), config.threshold
    if config.morphology_px > 1:
        size = (config.morphology_px, config.morphology_px)
        lit = cv2.threshold(lit, level, 255, cv2.THRESH_BINARY)[1]
        lit, level = cv2.morphologyEx(lit, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_RECT, size)), 0
    runs = kernels.find_runs(lit, level)
    found = kernels.join_runs(runs)
    kept = choose(found[:, kernels.AREA], config)
    return Blobs(kernels.centroids(picture, runs, found, kept), found[kept, kernels.AREA].astype(np.float64))


def choose(area: NDArray[np.int32], config: DetectionConfig) -> NDArray[np.int64]:
    """Return the numbers of the components that can be markers, in their order."""
    kept = np.flatnonzero((area >= config.min_area_px) & (area <= config.max_area_px))
    if len(kept) > config.max_detections:
        largest = np.argsort(-area[kept], kind="stable")[: config.max_detections]
        kept = np.sort(kept[largest])
    return kept
