"""Medians of the vision kernels beside what OpenCV offers for the same work: figures, not limits."""

import time
from collections.abc import Callable

import cv2
import msgspec
import numpy as np
import pytest

from companion.config import (
    FIRMWARE_CONFIGS,
    CameraConfig,
    DetectionConfig,
    LabelingConfig,
    TankerConfig,
    VisionConfig,
    load,
)
from companion.geometry import SE3
from companion.messages import CameraFrame
from companion.vision.camera import T_frd_cam, project
from companion.vision.chain import VisionChain
from companion.vision.detection import detect_markers
from sim_bridge.plant.boom import nominal_boom
from sim_bridge.scene.camera_picture import CameraPicture

pytestmark = pytest.mark.bench

BARE_LEVEL, RED_LEVEL = 60, 230
"""Thresholds with which the bare chains see the lights of this picture, of redness and of red."""


def medians(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median of one call of each in microseconds, taken in turns so that the noise of the machine hits all alike."""
    spent: dict[str, list[int]] = {name: [] for name in calls}
    for round_ in range(rounds + 5):
        for name, function in calls.items():
            start = time.perf_counter_ns()
            function()
            if round_ >= 5:
                spent[name].append(time.perf_counter_ns() - start)
    return {name: float(np.median(times)) / 1e3 for name, times in spent.items()}


def table(title: str, rows: dict[str, float]) -> None:
    """Print rows beside the first one."""
    first = next(iter(rows.values()))
    print(f"\n{title}")
    for name, value in rows.items():
        print(f"  {name:<52} {value:10.1f} us   x {value / first:6.2f}")


@pytest.fixture(scope="module")
def tanker() -> TankerConfig:
    return load(FIRMWARE_CONFIGS / "tankers/kc135r.toml", TankerConfig)


def bare_detection(image: np.ndarray, redness: bool) -> np.ndarray:
    """The usual way: threshold, components, centroids that are not weighted; on redness, or on red as in the thesis."""
    if redness:
        red, green, blue = cv2.split(image)
        values, level = cv2.subtract(red, cv2.max(green, blue)), BARE_LEVEL
    else:
        values, level = cv2.extractChannel(image, 0), RED_LEVEL
    lit = cv2.threshold(values, level, 255, cv2.THRESH_BINARY)[1]
    _, _, _, centroids = cv2.connectedComponentsWithStats(lit)
    return centroids[1:]


class BareChain:
    """Threshold, components, nearest predicted marker, SQPNP: what a few lines of OpenCV make of a picture."""

    def __init__(self, camera: CameraConfig, markers: np.ndarray, predicted: np.ndarray, redness: bool) -> None:
        self.K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
        self.markers, self.predicted, self.redness = markers, predicted, redness

    def __call__(self, image: np.ndarray) -> np.ndarray:
        places = bare_detection(image, self.redness)
        away = np.sum((places[:, None] - self.predicted[None]) ** 2, axis=2)
        uv = np.ascontiguousarray(places[away.argmin(axis=0)])
        return cv2.solvePnP(self.markers, uv, self.K, None, flags=cv2.SOLVEPNP_SQPNP)[2]


@pytest.mark.parametrize("name", ["default", "thesis", "1280x960"])
def test_picture_to_pose(tanker, name):
    camera = load(FIRMWARE_CONFIGS / f"cameras/{'thesis' if name == 'thesis' else 'default'}.toml", CameraConfig)
    if name == "1280x960":
        camera = msgspec.structs.replace(camera, width_px=1280, height_px=960, fx_px=914.0, fy_px=914.0, cx_px=639.5,
                                         cy_px=479.5)
    painter = CameraPicture(camera, tanker, np.random.default_rng(0))
    T_ned_tanker, T_ned_frd = SE3(np.eye(3), np.zeros(3)), SE3(np.eye(3), np.array([-34.0, -0.5, 10.0]))
    image = painter.render(T_ned_tanker, T_ned_frd, nominal_boom(tanker.boom))
    T = (T_ned_frd @ T_frd_cam(camera)).inverse() @ T_ned_tanker
    config, chain, frame = DetectionConfig(), VisionChain(camera, tanker, VisionConfig()), CameraFrame(0, 0, image)
    thesis = VisionChain(camera, tanker, VisionConfig(refine=False, labeling=LabelingConfig(method="mutual_nearest")))
    truth = project(camera, T, chain.markers)
    bare, red = (BareChain(camera, chain.markers, truth, redness) for redness in (True, False))
    rows = medians(
        {
            "bare OpenCV chain on redness, picture to pose": lambda: bare(image),
            "bare OpenCV chain on red, picture to pose": lambda: red(image),
            "our chain, picture to pose with covariance": lambda: chain.process(frame, T),
            "our chain as the thesis has it": lambda: thesis.process(frame, T),
            "our detection alone": lambda: detect_markers(image, config),
        },
        200,
    )
    found = detect_markers(image, config).uv_px
    table(f"{camera.width_px}x{camera.height_px}, {len(found)} lights", rows)
    for method, places in (("weighted", found), ("bare", bare_detection(image, redness=True))):
        distance = np.sqrt(np.sum((places[:, None] - truth[None]) ** 2, axis=2)).min(axis=1)
        print(f"  {method} centroids: median distance from the projection {np.median(distance):.3f} px")
    assert chain.process(frame, T).pose is not None
