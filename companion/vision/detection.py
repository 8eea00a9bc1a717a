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

RIM_PX = 1
"""How far beyond its lit pixels a marker's light reaches."""

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
    red, green, blue = cv2.split(image)
    other = cv2.max(green, blue)
    mask = cv2.threshold(cv2.subtract(red, other), config.threshold, 255, cv2.THRESH_BINARY)[1]
    if config.morphology_px > 1:
        size = (config.morphology_px, config.morphology_px)
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_RECT, size))
    x0, y0, width, height = cv2.boundingRect(mask)
    if width == 0:
        return Blobs(np.empty((0, 2)), np.empty(0))
    # Room for the rim on all sides, so that no window below needs clipping against the labels.
    lit = cv2.copyMakeBorder(
        mask[y0 : y0 + height, x0 : x0 + width], RIM_PX, RIM_PX, RIM_PX, RIM_PX, cv2.BORDER_CONSTANT, value=0
    )
    _, labels, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=8, ltype=cv2.CV_32S)
    kept = choose(stats, config)
    offset = np.array([x0 - RIM_PX, y0 - RIM_PX])
    uv = np.array([centroid(red, other, labels, k, stats[k], offset) for k in kept]).reshape(-1, 2)
    return Blobs(uv, stats[kept, cv2.CC_STAT_AREA].astype(np.float64))


def choose(stats: NDArray[np.int32], config: DetectionConfig) -> NDArray[np.int64]:
    """Return the labels of the components that can be markers, in the order of their labels."""
    area = stats[:, cv2.CC_STAT_AREA]
    fits = (area >= config.min_area_px) & (area <= config.max_area_px)
    fits[0] = False  # the background
    kept = np.flatnonzero(fits)
    if len(kept) > config.max_detections:
        largest = np.argsort(-area[kept], kind="stable")[: config.max_detections]
        kept = np.sort(kept[largest])
    return kept


def centroid(
    red: NDArray[np.uint8],
    other: NDArray[np.uint8],
    labels: NDArray[np.int32],
    k: int,
    stats: NDArray[np.int32],
    offset: NDArray[np.int64],
) -> Vec:
    """Return the centroid (2,) in px of component k, weighted with how much of each pixel it covers.

    The surroundings are the morphological opening of the redness with a square wider than the marker: it follows a
    step from sky to fuselage behind the marker, where one level for all would draw the centroid to one side.
    """
    left, top, width, height = (int(v) for v in stats[:4])
    labels = labels[top - RIM_PX : top + height + RIM_PX, left - RIM_PX : left + width + RIM_PX]
    own = cv2.dilate((labels == k).view(np.uint8), np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8))
    own[(labels != 0) & (labels != k)] = 0
    u0, v0 = left - RIM_PX + int(offset[0]), top - RIM_PX + int(offset[1])
    size = (max(width, height) + 2 * RIM_PX + 1) | 1
    x0, x1 = max(u0 - size, 0), min(u0 + labels.shape[1] + size, red.shape[1])
    y0, y1 = max(v0 - size, 0), min(v0 + labels.shape[0] + size, red.shape[0])
    redness = cv2.subtract(red[y0:y1, x0:x1], other[y0:y1, x0:x1], dtype=cv2.CV_16S)
    around = cv2.morphologyEx(redness, cv2.MORPH_OPEN, np.ones((size, size), np.uint8))
    # Back to the window of the component; what lies beyond the picture's edge carries no weight.
    a, b = max(u0, 0), max(v0, 0)
    c, d = min(u0 + labels.shape[1], red.shape[1]), min(v0 + labels.shape[0], red.shape[0])
    window = np.s_[b - y0 : d - y0, a - x0 : c - x0]
    own = own[b - v0 : d - v0, a - u0 : c - u0]
    level, ground = redness[window], around[window]
    full = (level * own).max()
    weight = own * (level - ground) / np.maximum(full - ground, 1)
    columns, rows = weight.sum(axis=0), weight.sum(axis=1)
    total = columns.sum()
    if not total > 0.0:  # as red all around as itself, which only a picture no larger than the component can be
        columns, rows, total = own.sum(axis=0), own.sum(axis=1), own.sum()
    return np.array([columns @ np.arange(a, c), rows @ np.arange(b, d)]) / float(total)
