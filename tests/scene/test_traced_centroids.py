"""Centroids against Embree: pictures of lights that the rasterizer has no part in, at every exposure and lens."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from tanker_scene import Scene, Tracer
from traced_light import LightTracer, expose, poses_on_the_way, windows

from companion.config import CameraConfig
from companion.geometry import Mat, Vec
from companion.vision.camera import pixels_to_normalised
from companion.vision.detection import detect_markers

BARREL = (-0.3, 0.1, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def lights(scene: Scene, tracer: Tracer) -> LightTracer:
    return LightTracer(scene, tracer)


def detected(pictures: list[Mat], centres: Mat, gain: float, seed: int) -> tuple[Mat, Vec, Vec]:
    """Return centroids in px of the whole picture (n, 2), their sigma, and which of ``centres`` were found."""
    rng = np.random.default_rng(seed)
    uv, sigma, found = [], [], []
    for k, (radiance, (left, top, u, v)) in enumerate(zip(pictures, centres, strict=True)):
        blobs = detect_markers(expose(radiance, rng, gain))
        places = blobs.uv_px + np.array([left, top])
        away = np.sqrt(np.sum((places - np.array([u, v])) ** 2, axis=1))
        if len(away) > 0 and away.min() < 1.5:
            uv.append(places[np.argmin(away)])
            sigma.append(blobs.sigma_px[np.argmin(away)])
            found.append(k)
    return np.array(uv), np.array(sigma), np.array(found)


def report(name: str, gain: float, errors: Mat, sigma: Vec, missed: int) -> None:
    z = errors / sigma[:, None]
    print(f"  {name:<10} gain {gain:<4} {len(errors):4d} lights, {missed:3d} missed: bias "
          f"{np.round(errors.mean(axis=0), 4)}, RMS {np.sqrt(np.mean(errors**2)):.4f} px, "
          f"error over sigma {np.sqrt(np.mean(z**2)):.2f}")


@pytest.mark.parametrize("name", ["default", "thesis"])
def test_centroids_have_no_bias_and_the_sigma_they_say(lights: LightTracer, name: str) -> None:
    camera = lights.scene.cameras[name]
    pictures, centres, _ = windows(lights, camera, poses_on_the_way(lights.scene, np.random.default_rng(21), 3))
    for gain in (0.3, 1.0):
        uv, sigma, found = detected(pictures, centres, gain, 22)
        errors = uv - centres[found, 2:]
        assert len(found) == len(pictures)
        assert np.abs(errors.mean(axis=0)).max() < 0.02
        assert np.sqrt(np.mean(errors**2)) < 0.05
        assert 0.6 < np.sqrt(np.mean((errors / sigma[:, None]) ** 2)) < 1.4


def test_centroids_hold_through_a_strong_lens(lights: LightTracer) -> None:
    """k1 = -0.3: detected in the bent picture, undistorted, and put beside the straight projection, in its pixels."""
    camera: CameraConfig = msgspec.structs.replace(lights.scene.cameras["default"], distortion=BARREL)
    poses = poses_on_the_way(lights.scene, np.random.default_rng(23), 2)
    pictures, centres, _ = windows(lights, camera, poses)
    uv, _, found = detected(pictures, centres, 1.0, 24)
    straight, truth = (pixels_to_normalised(camera, p) * camera.fx_px for p in (uv, centres[found, 2:]))
    bent_by = np.sqrt(np.sum((truth - (centres[found, 2:] - [camera.cx_px, camera.cy_px])) ** 2, axis=1))
    assert len(found) == len(pictures)
    assert bent_by.max() > 8
    assert np.abs((straight - truth).mean(axis=0)).max() < 0.02
    assert np.sqrt(np.mean((straight - truth) ** 2)) < 0.06


@pytest.mark.bench
def test_bias_and_sigma_of_traced_lights(lights: LightTracer) -> None:
    print("\ncentroids against Embree, mean error and RMS per axis")
    for name in ("default", "thesis"):
        camera = lights.scene.cameras[name]
        poses = poses_on_the_way(lights.scene, np.random.default_rng(31), 30)
        pictures, centres, z = windows(lights, camera, poses)
        diameter = 2 * camera.fx_px * lights.scene.tanker.marker_radius_m / z
        for gain in (0.3, 1.0, 2.0, 3.0):
            uv, sigma, found = detected(pictures, centres, gain, 32)
            report(name, gain, uv - centres[found, 2:], sigma, len(pictures) - len(found))
        uv, sigma, found = detected(pictures, centres, 1.0, 33)
        for low, high in ((0.0, 1.0), (1.0, 1.5), (1.5, 2.5), (2.5, 9.0)):
            some = (diameter[found] >= low) & (diameter[found] < high)
            if some.sum() > 10:
                report(f"{low}-{high} px", 1.0, (uv - centres[found, 2:])[some], sigma[some], 0)
        assert len(found) > 0.9 * len(pictures)
