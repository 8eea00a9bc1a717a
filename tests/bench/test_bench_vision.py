"""Medians of the vision kernels beside what OpenCV offers for the same work: figures, not limits."""

import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, CameraConfig, DetectionConfig, TankerConfig, VisionConfig, load
from companion.geometry import SE3, R_cam_crf, rotation_from_euler
from companion.messages import CameraFrame
from companion.vision.camera import project
from companion.vision.chain import VisionChain
from companion.vision.detection import detect_markers
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.truth import BoomState

pytestmark = pytest.mark.bench


def microseconds(function: Callable[[], object], rounds: int) -> float:
    """Median of one call in microseconds, after a few calls to warm up."""
    for _ in range(5):
        function()
    spent = []
    for _ in range(rounds):
        start = time.perf_counter_ns()
        function()
        spent.append(time.perf_counter_ns() - start)
    return float(np.median(spent)) / 1e3


def table(title: str, rows: dict[str, float]) -> None:
    """Print rows beside the first one."""
    first = next(iter(rows.values()))
    print(f"\n{title}")
    for name, value in rows.items():
        print(f"  {name:<42} {value:10.1f} us   x {value / first:6.2f}")


@pytest.fixture(scope="module")
def tanker() -> TankerConfig:
    return load(FIRMWARE_CONFIGS / "tankers/kc135r.toml", TankerConfig)


def bare_opencv(image: np.ndarray, config: DetectionConfig) -> np.ndarray:
    """The usual chain on the whole picture: split, subtract, threshold, components; centroids are not weighted."""
    red, green, blue = cv2.split(image)
    lit = cv2.threshold(cv2.subtract(red, cv2.max(green, blue)), config.threshold, 255, cv2.THRESH_BINARY)[1]
    _, _, _, centroids = cv2.connectedComponentsWithStats(lit)
    return centroids[1:]


@pytest.mark.parametrize("name", ["default", "thesis"])
def test_detection_and_chain(tanker, name):
    camera = load(FIRMWARE_CONFIGS / f"cameras/{name}.toml", CameraConfig)
    painter = CameraPicture(camera, tanker, np.random.default_rng(0))
    boom = BoomState(np.array(tanker.boom.pivot_tanker_m), tanker.boom.elevation_rad, 0.0, tanker.boom.length_m)
    T_ned_tanker = SE3(np.eye(3), np.array([0.0, 0.0, -6000.0]))
    T_ned_frd = SE3(np.eye(3), np.array([-34.0, -0.5, -5990.0]))
    image = painter.render(T_ned_tanker, T_ned_frd, boom)
    T_cam_frd = SE3(R_cam_crf @ rotation_from_euler(0.0, camera.mount_pitch_rad, 0.0).T, np.zeros(3))
    T = T_cam_frd @ SE3(np.eye(3), -np.array(camera.p_frd_cam_m)) @ T_ned_frd.inverse() @ T_ned_tanker
    config, chain, frame = DetectionConfig(), VisionChain(camera, tanker, VisionConfig()), CameraFrame(0, 0, image)
    found = detect_markers(image, config).uv_px
    rows = {
        "detection": microseconds(lambda: detect_markers(image, config), 300),
        "bare OpenCV on the whole picture": microseconds(lambda: bare_opencv(image, config), 300),
        "whole chain, picture to pose": microseconds(lambda: chain.process(frame, T), 300),
    }
    table(f"{camera.width_px}x{camera.height_px}, {len(found)} lights", rows)
    truth = project(camera, T, chain.markers)
    for method, places in (("weighted", found), ("bare", bare_opencv(image, config))):
        distance = np.sqrt(np.sum((places[:, None] - truth[None]) ** 2, axis=2)).min(axis=1)
        print(f"  {method} centroids: median distance from the projection {np.median(distance):.3f} px")
    assert chain.process(frame, T).pose is not None
