"""Medians of the camera picture and the centroids' errors: figures, not limits."""

from __future__ import annotations

import time

import numpy as np
import pytest
from tanker_scene import CONTACT, START, Scene

from companion.vision.camera import project
from companion.vision.detection import detect_markers
from sim_bridge.scene.camera_picture import CameraPicture

pytestmark = pytest.mark.bench

PLACES = {"start": START, "half way": 0.5 * (START + CONTACT), "contact": CONTACT}


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_time_of_a_picture(scene: Scene, name: str) -> None:
    for threads in (1, 2):
        picture = CameraPicture(scene.cameras[name], scene.tanker, np.random.default_rng(1), threads)
        row = []
        for place in PLACES.values():
            T_ned_frd, spent = scene.T_ned_frd(place), []
            for _ in range(40):
                start = time.perf_counter_ns()
                picture.render(scene.T_ned_tanker, T_ned_frd, scene.boom)
                spent.append(time.perf_counter_ns() - start)
            row.append(np.median(spent) / 1e6)
        cells = ", ".join(f"{place} {ms:.1f}" for place, ms in zip(PLACES, row, strict=True))
        print(f"\n{name}: {threads} threads: {cells} ms")
        assert min(row) > 0


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_error_of_detected_centroids(scene: Scene, name: str) -> None:
    camera, r = scene.cameras[name], np.random.default_rng(2)
    picture = CameraPicture(camera, scene.tanker, r)
    errors, missed = [], 0
    for s in np.linspace(0, 1, 100):
        T_ned_frd = scene.T_ned_frd(START + s * (CONTACT - START) + r.normal(0, 0.2, 3), *r.normal(0, 0.01, 3))
        found = detect_markers(picture.render(scene.T_ned_tanker, T_ned_frd, scene.boom)).uv_px
        uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
        for p in uv:
            away = np.sum((found - p) ** 2, axis=1)
            if away.min() < 4:
                errors.append(found[np.argmin(away)] - p)
            else:
                missed += 1
    rms, mean = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(errors, axis=0)
    print(f"\n{name}: {len(errors)} detected, {missed} missed; centroid RMS {rms.round(3)}, mean {mean.round(3)} px")
    assert len(errors) > 800
