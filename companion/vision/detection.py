"""Marker detection: red lights in a colour picture to sub-pixel centroids (thesis 4.2.1).

Rules
-----
* Redness of a pixel is its red value less the larger of green and blue. The thesis thresholds red alone, which a white
  fuselage passes too.
* A pixel is lit when its redness is above a level; touching lit pixels (8 neighbours) are one component.
* The level follows the picture (``adaptive``): ``threshold``, or more where noise or a red background would pass it.
  A component much darker than the brightest ones is no light. So one setting does for short and long exposures.
* A centroid is weighted with the share of each pixel that the marker covers, and includes the rim of pixels that are
  covered too little to be lit. The share is told from the redness of the marker and of what surrounds it.
* What cannot be a light is left out (``reject_clutter``), what may be one that is not whole is flagged and gets a
  larger sigma. What looks just like a light, a port navigation light for one, goes on: only labeling, which knows where
  lights belong, can tell it from one.

============= ========================================================================================================
flag          meaning
============= ========================================================================================================
``BORDER``    lit pixels at the picture's edge: part of the light may be beyond
``SATURATED`` red at the end of its scale somewhere: the light looks larger than it is
``WASHED``    surroundings at the end of the scale of all channels: the light looks smaller than it is
``MISSHAPEN`` not one whole disc: half hidden, two lights run together, a streak (see also ``expected_size``)
``HOT``       (left out) a single pixel, of which the lens has spread nothing
``GLINT``     (left out) white in the middle and red only around it, or a piece of such a rim
``STREAK``    (left out) a stripe or a line of letters
``FAINT``     (left out) pale: not red but orange or pink, or much less red than the brightest ones
============= ========================================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import DetectionConfig
from companion.geometry import Mat, Vec
from companion.vision import blob_kernel as blob
from companion.vision import detection_kernel as kernels

DEFAULT = DetectionConfig()


RED_SHARE, RED_PX = 0.02, 4000.0
"""A picture of which more than this is lit is red itself: nine lights at contact are some 0.1 %."""

REDNESS_NOISE = 2.0**0.5
"""Noise of a difference of two channels, in that of one."""

NOISE_MARGIN = 6.0
"""In deviations: passed by chance about once in a thousand pictures of 640x480."""

SMALL_PX = 8
LEAST_FILL = 0.15
"""Components larger than SMALL_PX fill more of their box than this, also when 9/10 of the light are hidden."""

HOT_AREA = 1.5
"""Covered area in px below which a lens has had no part: one that spreads by 0.5 px makes 2.1 px of a point. Before
surroundings that are white already, more than that is hidden, and a hot pixel does not show.
"""

WHITE_CORE, FEW_WHITE = 0.6, 0.02
"""A light is this red at its centroid at least, in shares of its greatest redness; a small red spot beside white, in a
picture of which less than FEW_WHITE is white, is the rim of something white.
"""

LEAST_HUE = 0.4
"""One for red, also in front of white or grey, nought for yellow or magenta: half way is orange or pink."""

FAINT_SHARE = 0.3
RESOLVED_AREA, RESOLVED_SHARE = 7.0, 0.5
BRIGHT_RANK = 5
"""Less red than FAINT_SHARE of the fifth brightest candidate is no light: all lights are of one kind. One that covers
more than RESOLVED_AREA px loses nothing of its brightness to the lens, so that paint, which does not glow, falls short.
"""


PIXEL_VARIANCE = 1.0 / 12.0
"""Second moment of a pixel about its own middle in px^2."""

WHOLE_ELONGATION = 1.35
SIGMA_PX, SIGMA_RIM_PX, SIGMA_SATURATED_PX = 0.018, 0.012, 0.07
"""What is left of a centroid's error without noise. Where red clips, the rim that still tells the share narrows, the
more so the brighter its surroundings are: SIGMA_SATURATED_PX times their brightness. Fitted to traced pictures.
"""

WASHED_OUT, EVEN_WHITE = 0.9, 0.3
SIGMA_WASHED_PX, SIGMA_UNEVEN_PX = 0.12, 0.2
"""Surroundings brighter than WASHED_OUT hide the rim; worse where less than EVEN_WHITE of them are white, that is, on
one side only.
"""

SIGMA_CUT = 0.4
"""Share of its radius by which a light that the border cuts may be elsewhere: up to half of it is beyond."""


class BlobFlag(IntFlag):
    """What is to be said of one detection; see the module's table."""

    BORDER = 1
    SATURATED = 2
    WASHED = 4
    MISSHAPEN = 8
    HOT = 16
    GLINT = 32
    STREAK = 64
    FAINT = 128


CLUTTER = BlobFlag.HOT | BlobFlag.GLINT | BlobFlag.STREAK | BlobFlag.FAINT
"""Not lights; left out when ``reject_clutter`` is set."""


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """Candidates of one picture.

    ``uv_px`` (m, 2) centroids, x right, y down, pixel centres at integers; ``area_px`` (m,) lit pixels; ``sigma_px``
    (m,) standard deviation of the centroid per axis; ``radius_px`` (m,) of the disc of as much covered area, which
    for a light that clips is larger than its own; ``elongation`` (m,) length over width; ``peak`` (m,) greatest
    redness in steps of 1/255; ``flags`` (m,) uint8 of ``BlobFlag``.
    """

    uv_px: Mat
    area_px: Vec
    sigma_px: Vec
    radius_px: Vec
    elongation: Vec
    peak: Vec
    flags: NDArray[np.uint8]

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Blobs:
        """Return the blobs that ``index`` names, in its order."""
        return Blobs(
            self.uv_px[index], self.area_px[index], self.sigma_px[index], self.radius_px[index],
            self.elongation[index], self.peak[index], self.flags[index],
        )


def detect_markers(image: NDArray[np.uint8], config: DetectionConfig = DEFAULT) -> Blobs:
    """Find the red lights in ``image`` (h, w, 3) uint8 RGB, in raster order of their topmost pixels.

    Keeps components of ``min_area_px`` to ``max_area_px`` lit pixels; the ``max_detections`` largest when there are
    more. ``morphology_px`` > 1 opens the lit mask with a square of that size first, which removes smaller specks and
    markers. Raises ValueError when the picture is not of that shape and type.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        msg = f"image must be (h, w, 3) uint8, not {image.shape} {image.dtype}"
        raise ValueError(msg)
    picture = mend_hot_pixels(image, config.hot_pixels) if config.hot_pixels else np.ascontiguousarray(image)[:]
    picture.flags.writeable = False  # as those off a wire are: the kernels are compiled for one of both only
    noise, white = kernels.noise_of(picture)
    lit, level = kernels.redness_of(picture), level_for(noise, config)
    if config.morphology_px > 1:
        lit, level = open_mask(lit, level, config.morphology_px), 0
    runs = kernels.find_runs(lit, level)
    found = kernels.join_runs(runs)
    if config.adaptive and found[:, kernels.AREA].sum() > too_many(lit.size):
        runs = kernels.find_runs(lit, raised_level(lit, noise))
        found = kernels.join_runs(runs)
    kept = choose(found, config)
    return describe(picture.shape, found[kept], blob.measures(picture, runs, found, kept), noise, white, config)


def mend_hot_pixels(image: NDArray[np.uint8], places: tuple[tuple[int, int], ...]) -> NDArray[np.uint8]:
    """Return a copy in which each of the pixels (u, v) has the mean of its neighbours left, right, above and below."""
    picture = np.array(image, order="C")
    bad = {(u, v) for u, v in places if 0 <= u < image.shape[1] and 0 <= v < image.shape[0]}
    for u, v in sorted(bad):
        around = [(u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)]
        good = [image[y, x] for x, y in around if 0 <= x < image.shape[1] and 0 <= y < image.shape[0]
                and (x, y) not in bad]
        picture[v, u] = np.mean(good, axis=0) if good else 0
    return picture


def open_mask(redness: NDArray[np.uint8], level: int, size: int) -> NDArray[np.uint8]:
    """Return the lit pixels, 255 or 0, opened with a square of ``size``."""
    lit = cv2.threshold(redness, level, 255, cv2.THRESH_BINARY)[1]
    return np.asarray(cv2.morphologyEx(lit, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_RECT, (size, size))))


def level_for(noise: float, config: DetectionConfig) -> int:
    """Return the level of redness for a picture of this ``noise``: ``threshold``, or what noise hardly ever passes."""
    if not config.adaptive:
        return config.threshold
    return max(config.threshold, min(int(np.ceil(NOISE_MARGIN * REDNESS_NOISE * noise)), 254))


def too_many(size: int) -> float:
    """Return the number of lit pixels from which on a picture of ``size`` pixels is red itself."""
    return max(RED_SHARE * size, RED_PX)


def raised_level(redness: NDArray[np.uint8], noise: float) -> int:
    """Return a level that a red background does not pass, for pictures of which too much is lit."""
    above = redness.size - np.cumsum(np.bincount(redness.ravel(), minlength=256))
    level = int(np.argmax(above <= too_many(redness.size)))
    return min(level + int(np.ceil(NOISE_MARGIN * REDNESS_NOISE * noise)), 255)


def choose(found: NDArray[np.int32], config: DetectionConfig) -> NDArray[np.int64]:
    """Return the numbers of the components to be measured, in their order.

    A component of which its box is nearly empty is a stripe or a frame; measuring it would cost most where it counts
    least.
    """
    area = found[:, kernels.AREA]
    side = 1 + np.maximum(found[:, kernels.RIGHT] - found[:, kernels.LEFT],
                          found[:, kernels.BOTTOM] - found[:, kernels.TOP])
    full = (side <= SMALL_PX) | (area > LEAST_FILL * side * side)
    kept = np.flatnonzero(full & (area >= config.min_area_px) & (area <= config.max_area_px))
    if len(kept) > config.max_detections:
        largest = np.argsort(-area[kept], kind="stable")[: config.max_detections]
        kept = np.sort(kept[largest])
    return kept


def describe(
    shape: tuple[int, ...], boxes: NDArray[np.int32], table: Mat, noise: float, white: float, config: DetectionConfig
) -> Blobs:
    """Return what the measures ``table`` (m, blob.COLUMNS) of components ``boxes`` (m, 5) say, without clutter."""
    xx, xy, yy = table[:, blob.XX], table[:, blob.XY], table[:, blob.YY]
    middle, half = 0.5 * (xx + yy) + PIXEL_VARIANCE, np.hypot(0.5 * (xx - yy), xy)
    elongation = np.sqrt((middle + half) / np.maximum(middle - half, PIXEL_VARIANCE))
    radius = np.sqrt(table[:, blob.TOTAL] / np.pi)
    flags = flag(shape, boxes, table, elongation, white, config)
    blobs = Blobs(table[:, [blob.U, blob.V]], boxes[:, kernels.AREA].astype(np.float64),
                  sigma_of(table, flags, radius, noise), radius, elongation, table[:, blob.PEAK], flags)
    return blobs.take((flags & CLUTTER) == 0) if config.reject_clutter else blobs


def flag(
    shape: tuple[int, ...], boxes: NDArray[np.int32], table: Mat, elongation: Vec, white: float,
    config: DetectionConfig,
) -> NDArray[np.uint8]:
    """Return the flags (m,) of components; see the module's table."""
    right, bottom = shape[1] - 1, shape[0] - 1
    border = (
        (boxes[:, kernels.LEFT] == 0) | (boxes[:, kernels.RIGHT] == right)
        | (boxes[:, kernels.TOP] == 0) | (boxes[:, kernels.BOTTOM] == bottom)
    )
    washed, flags = table[:, blob.BRIGHT] > WASHED_OUT, np.zeros(len(boxes), np.uint8)
    for name, holds in (
        (BlobFlag.BORDER, border),
        (BlobFlag.SATURATED, table[:, blob.CLIPPED] > 0),
        (BlobFlag.WASHED, washed),
        (BlobFlag.MISSHAPEN, elongation > WHOLE_ELONGATION),
        (BlobFlag.HOT, (table[:, blob.TOTAL] < HOT_AREA) & ~border & ~washed),
        (BlobFlag.GLINT, table[:, blob.CORE] < WHITE_CORE),
        (BlobFlag.GLINT, washed & (table[:, blob.TOTAL] < RESOLVED_AREA) & (white < FEW_WHITE)),
        (BlobFlag.FAINT, table[:, blob.HUE] < LEAST_HUE),
        (BlobFlag.STREAK, (elongation > config.max_elongation) & ~border),
    ):
        flags[holds] |= np.uint8(name)
    peaks = np.sort(table[(flags & CLUTTER) == 0, blob.PEAK])
    if config.adaptive and len(peaks) >= BRIGHT_RANK:
        share = np.where(table[:, blob.TOTAL] > RESOLVED_AREA, RESOLVED_SHARE, FAINT_SHARE)
        flags[table[:, blob.PEAK] < share * peaks[-BRIGHT_RANK]] |= np.uint8(BlobFlag.FAINT)
    return flags


def sigma_of(table: Mat, flags: NDArray[np.uint8], radius: Vec, noise: float) -> Vec:
    """Return the standard deviation (m,) of the centroids per axis in px: noise, and what clipping does to the rim."""
    variance = (REDNESS_NOISE * noise) ** 2 * 0.5 * (table[:, blob.NOISE_U] + table[:, blob.NOISE_V])
    saturated, washed = (flags & BlobFlag.SATURATED) > 0, (flags & BlobFlag.WASHED) > 0
    white = table[:, blob.WHITE]
    uneven = np.where(white > 0, np.maximum(0.0, 1.0 - white / EVEN_WHITE), 0.0)
    floor = np.where(saturated, np.maximum(SIGMA_SATURATED_PX * table[:, blob.BRIGHT], SIGMA_RIM_PX), SIGMA_PX)
    floor = np.where(washed, SIGMA_WASHED_PX + SIGMA_UNEVEN_PX * uneven, floor)
    cut = np.where((flags & BlobFlag.BORDER) > 0, SIGMA_CUT * radius, 0.0)
    return np.sqrt(variance + floor**2 + cut**2)
