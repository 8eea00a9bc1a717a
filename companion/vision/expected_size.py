"""Is a labelled light whole? Its size in the picture beside the size that a marker has at its distance.

Rules
-----
* A boom or an engine that hides part of a light moves its centroid, by up to the light's radius, and leaves it a red
  spot like any other: what tells is that it is smaller than the others, for its distance, or longer than wide.
* How much larger than its outline a light looks is the same for all lights of a picture, as lens, exposure and lamps
  are: a constant where they saturate, less for larger lights where they do not. It is told from the picture itself, as
  the median, so that it holds while less than half of the lights are hidden, and needs three.
* A flagged light keeps its place and gets a sigma that covers what is missing.

A sphere's outline is an ellipse about X Z / (Z^2 - r^2), not about X / Z: for a radius of 0.1 m, 320 px off the axis,
0.014 px at 15 m and 0.003 px at 35 m. Nothing is done about it.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import NEAREST_M, bends, normalised_to_pixels
from companion.vision.detection import BlobFlag, Blobs

SLOPE_SATURATED, SLOPE_LINEAR = 1.0, 0.6
"""Growth of a light's radius in the picture with that of its outline, for lights that saturate and for those that do
not, of 0.4 to 4 px."""

SMALLER, SMALLER_LINEAR, LARGER = 0.075, 0.12, 0.16
"""Shares of its radius by which a light is too small or too large; where lights do not saturate, noise tells more."""

LONGER = 1.27
"""Elongation that no whole light has, when its distance says that it is one."""

STEP = 1e-4
"""How far on z = 1 the lens' enlargement is measured."""

FEWEST = 3
SIGMA_PER_LACK, SIGMA_PER_LENGTH = 1.2, 0.5
"""Error of a centroid per axis for the radius that it lacks, and for its length beyond its width."""


def apparent_radius_px(camera: CameraConfig, T_cam_tanker: SE3, markers: Mat, radius_m: float) -> Vec:
    """Return the radii (n,) in px of the discs that spheres at ``markers`` (n, 3) in m, tanker axes, cover.

    The lens' stretching counts. NaN where the camera cannot see.
    """
    p = T_cam_tanker.transform(np.asarray(markers, dtype=np.float64))
    z = np.where(p[:, 2] > NEAREST_M, p[:, 2], np.nan)
    uv = p[:, :2] / z[:, None]
    # Of distance d at angle a off the axis: r / d across the sight is f r / (d cos a) one way, f r / (d cos^2 a) the
    # other, and d cos a is the depth.
    stretch = np.sqrt(np.sqrt(1.0 + np.einsum("ij,ij->i", uv, uv)))
    pinhole = (radius_m * math.sqrt(camera.fx_px * camera.fy_px)) * stretch / z
    return pinhole * np.sqrt(magnification(camera, uv)) if bends(camera) else pinhole


def magnification(camera: CameraConfig, uv: Mat) -> Vec:
    """Return by how much the lens enlarges areas (n,) about places uv (n, 2) on z = 1, beside a pinhole."""
    step = np.array([[0.0, 0.0], [STEP, 0.0], [0.0, STEP]])
    there = normalised_to_pixels(camera, (uv[None] + step[:, None]).reshape(-1, 2)).reshape(3, -1, 2)
    a, b = there[1] - there[0], there[2] - there[0]
    area: Vec = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return area / (STEP * STEP * camera.fx_px * camera.fy_px)


def compare_with_expected(blobs: Blobs, expected_radius_px: Vec) -> Blobs:
    """Return labelled ``blobs`` with those flagged ``MISSHAPEN``, at a larger sigma, that are not one whole light.

    ``expected_radius_px`` (m,) is the radius of each one's outline, from ``apparent_radius_px`` at the predicted or
    solved pose; NaN leaves a blob as it is. With fewer than three to compare only their elongation counts. Lights
    before surroundings that are at the end of their scale (``WASHED``) have no size to compare.
    """
    expected = np.asarray(expected_radius_px, dtype=np.float64)
    saturated = (blobs.flags & BlobFlag.SATURATED) > 0
    clipped = 2 * int(saturated.sum()) > len(saturated)
    slope, smaller = (SLOPE_SATURATED, SMALLER) if clipped else (SLOPE_LINEAR, SMALLER_LINEAR)
    excess = blobs.radius_px - slope * expected
    cut = (blobs.flags & (BlobFlag.WASHED | BlobFlag.BORDER)) > 0
    usable = np.isfinite(excess) & ~cut
    lack = np.zeros(len(excess))
    if usable.sum() >= FEWEST:
        lack[usable] = float(np.median(excess[usable])) - excess[usable]
    size = np.maximum(blobs.radius_px + lack, 1.0)
    longer = np.isfinite(expected) & ~cut & (blobs.elongation > LONGER)
    odd = (lack > smaller * size) | (-lack > LARGER * size) | longer
    flags = blobs.flags | np.where(odd, np.uint8(BlobFlag.MISSHAPEN), np.uint8(0))
    missing = np.maximum(SIGMA_PER_LACK * np.abs(lack), SIGMA_PER_LENGTH * (blobs.elongation - 1.0) * size)
    sigma = np.where(odd, np.hypot(blobs.sigma_px, missing), blobs.sigma_px)
    return Blobs(blobs.uv_px, blobs.area_px, sigma, blobs.radius_px, blobs.elongation, blobs.peak, flags)
