"""Median time of taking the lens out of nine pixels, beside OpenCV's: figures, not limits."""

import time
from collections.abc import Callable

import cv2
import msgspec
import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, CameraConfig, load
from companion.vision.camera import normalised_to_pixels, pixels_to_normalised

pytestmark = pytest.mark.bench

LENSES = {
    "plumb_bob": (-0.25, 0.08, 1e-3, -2e-3, 0.01),
    "rational_polynomial": (0.31, -0.12, 1e-3, -8e-4, 0.02, 0.54, -0.03, 0.015),
    "equidistant": (-0.013, 0.0052, -0.0089, 0.0032),
}


def microseconds(function: Callable[[], object]) -> float:
    """Median of one call in microseconds, after a few calls to warm up."""
    spent = []
    for _ in range(2010):
        start = time.perf_counter_ns()
        function()
        spent.append(time.perf_counter_ns() - start)
    return float(np.median(spent[10:])) / 1e3


@pytest.mark.parametrize("model", LENSES)
def test_taking_the_lens_out_of_nine_pixels(model):
    """Ours is solved to 1e-10 on z = 1; OpenCV takes its default number of steps and leaves what is left."""
    straight = load(FIRMWARE_CONFIGS / "cameras/default.toml", CameraConfig)
    camera = msgspec.structs.replace(straight, distortion_model=model, distortion=LENSES[model])
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    pixels = np.random.default_rng(0).uniform(20, 460, (9, 2))
    D, listed = np.array(LENSES[model]), pixels[:, None]
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    ours, theirs, none = (
        microseconds(f) for f in (lambda: pixels_to_normalised(camera, pixels), lambda: undistort(listed, K, D),
                                  lambda: pixels_to_normalised(straight, pixels))
    )
    left, theirs_left = (np.abs(normalised_to_pixels(camera, uv) - pixels).max() for uv in
                         (pixels_to_normalised(camera, pixels), undistort(listed, K, D)[:, 0]))
    print(f"\n{model}: {ours:.1f} us beside OpenCV's {theirs:.1f} us, x {ours / theirs:.2f} (pinhole {none:.1f} us); "
          f"left over {left:.0e} px, OpenCV {theirs_left:.0e} px")
    assert left < 1e-6
