from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tanker_scene import CONTACT, START, Scene, level_scene

from companion.config import CameraConfig, ConfigError
from companion.geometry import SE3, Mat, Vec, rotation_from_euler
from companion.vision.camera import T_frd_cam, normalised_to_pixels, pixels_to_normalised, project
from companion.vision.detection import detect_markers
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.visibility import marker_visibility

BARREL = (-0.12, 0.02, 0.0008, -0.0005, 0.0)
DARK, DIM, BRIGHT = (0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (0.9, 0.1, 0.1)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def bent(camera: CameraConfig) -> CameraConfig:
    return msgspec.structs.replace(camera, distortion=BARREL)


def redness(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    return image[..., 0].astype(np.int64) - image[..., 1:].max(axis=2)


def pictures(camera: CameraConfig, scene: Scene) -> tuple[CameraPicture, CameraPicture]:
    """Two pictures that differ by the red of their lights only."""
    dim, bright = (CameraPicture(camera, scene.tanker, rng(), light=light, noise=0.0) for light in (DIM, BRIGHT))
    return dim, bright


def cover(pair: tuple[CameraPicture, CameraPicture], scene: Scene, T_ned_frd: SE3) -> Mat:
    """Return the share of each pixel that lights cover, whatever is behind them."""
    low, high = (p.render(scene.T_ned_tanker, T_ned_frd, scene.boom)[..., 0].astype(float) for p in pair)
    return (high - low) / (255.0 * (BRIGHT[0] - DIM[0]))


def centroid(share: Mat, uv: Vec, half: int = 7) -> Vec:
    x0, y0 = (round(float(c)) for c in uv)
    window = share[y0 - half : y0 + half + 1, x0 - half : x0 + half + 1]
    y, x = np.mgrid[y0 - half : y0 + half + 1, x0 - half : x0 + half + 1]
    return np.array([np.sum(window * x), np.sum(window * y)]) / np.sum(window)


def centroid_errors(camera: CameraConfig, scene: Scene, poses: list[SE3]) -> Mat:
    """Return centroid less projection (n, 2) in px of every marker that is wholly seen, clear of border and others."""
    errors, pair = [], pictures(camera, scene)
    size = np.array([camera.width_px, camera.height_px])
    for T_ned_frd in poses:
        uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
        whole = marker_visibility(camera, scene.tanker, scene.T_ned_tanker, T_ned_frd, scene.boom) == 1.0
        share = cover(pair, scene, T_ned_frd)
        apart = np.sqrt(np.sum((uv[:, None] - uv[None]) ** 2, axis=2)) + 1e3 * np.eye(len(uv))
        for p, near in zip(uv[whole], apart[whole].min(axis=1), strict=True):
            if near > 16 and np.all((p > 9) & (p < size - 10)):
                errors.append(centroid(share, p) - p)
    return np.array(errors)


def poses_on_the_way(scene: Scene, count: int) -> list[SE3]:
    r = rng(5)
    return [
        scene.T_ned_frd(START + s * (CONTACT - START) + r.normal(0, 0.4, 3), *r.normal(0, 0.02, 3))
        for s in np.linspace(0, 1, count)
    ]


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_picture_has_the_cameras_shape(scene: Scene, name: str) -> None:
    camera = scene.cameras[name]
    image = CameraPicture(camera, scene.tanker, rng()).render(scene.T_ned_tanker, scene.T_ned_frd(START), scene.boom)
    assert image.shape == (camera.height_px, camera.width_px, 3)
    assert image.dtype == np.uint8


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_same_seed_gives_the_same_bits_with_one_thread_or_more(scene: Scene, name: str) -> None:
    one, two, three = (CameraPicture(scene.cameras[name], scene.tanker, rng(7), threads=n) for n in (1, 2, 3))
    for T_ned_frd in poses_on_the_way(scene, 3):
        first = one.render(scene.T_ned_tanker, T_ned_frd, scene.boom)
        for other in (two, three):
            np.testing.assert_array_equal(first, other.render(scene.T_ned_tanker, T_ned_frd, scene.boom))


def test_another_seed_gives_another_picture(scene: Scene) -> None:
    a, b = (
        CameraPicture(scene.cameras["thesis"], scene.tanker, rng(seed)).render(
            scene.T_ned_tanker, scene.T_ned_frd(START), scene.boom
        )
        for seed in (1, 2)
    )
    assert np.any(a != b)


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_centroids_of_lights_lie_on_their_projection(scene: Scene, name: str) -> None:
    """Rounding to 1/255 is the picture's own; the rest is sampling. A light is 0.8 to 7 px wide here."""
    errors = centroid_errors(scene.cameras[name], scene, poses_on_the_way(scene, 10))
    assert len(errors) > 70
    assert np.all(np.abs(errors.mean(axis=0)) < 0.01)
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 0.025)


def test_centroids_follow_the_lens(scene: Scene) -> None:
    """The same for a distorting lens, whose pictures of the lights lie several pixels away."""
    camera = bent(scene.cameras["default"])
    poses = poses_on_the_way(scene, 8)
    errors = centroid_errors(camera, scene, poses)
    straight = project(scene.cameras["default"], scene.T_cam_tanker(camera, poses[0]), scene.markers())
    moved = project(camera, scene.T_cam_tanker(camera, poses[0]), scene.markers()) - straight
    assert np.abs(moved).max() > 4
    assert len(errors) > 50
    assert np.all(np.abs(errors.mean(axis=0)) < 0.01)
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 0.025)


def test_background_follows_the_lens(scene: Scene) -> None:
    """Every pixel of the distorted picture shows what the straight picture shows along the same ray."""
    camera = scene.cameras["default"]
    T_ned_frd = scene.T_ned_frd(0.5 * (START + CONTACT))
    straight, curved = (
        CameraPicture(c, scene.tanker, rng(), light=DARK, noise=0.0)
        .render(scene.T_ned_tanker, T_ned_frd, scene.boom)
        .astype(float)
        for c in (camera, bent(camera))
    )
    u, v = (a.ravel() for a in np.meshgrid(np.arange(60, 580, 3), np.arange(60, 420, 3)))
    there = normalised_to_pixels(camera, pixels_to_normalised(bent(camera), np.column_stack([u, v]).astype(float)))
    x, y = np.floor(there).astype(int).T
    around = np.stack([straight[y + j, x + i] for i in (0, 1) for j in (0, 1)])
    flat = np.ptp(around, axis=0).max(axis=1) <= 3
    difference = np.abs(curved[v, u] - around.mean(axis=0)).max(axis=1)
    assert flat.mean() > 0.8
    assert difference[flat].max() <= 3


def test_a_lens_that_folds_the_picture_is_refused(scene: Scene) -> None:
    camera = msgspec.structs.replace(scene.cameras["default"], distortion=(-1.5, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="default: distortion"):
        CameraPicture(camera, scene.tanker, rng())


SCENE = level_scene()
UNLIT = CameraPicture(SCENE.cameras["thesis"], SCENE.tanker, rng(), light=DARK)
STILL = CameraPicture(SCENE.cameras["thesis"], SCENE.tanker, rng(), light=DARK, noise=0.0)
ANGLE = st.floats(-3.1, 3.1)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE, s=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=60)
def test_neither_sky_nor_airframe_is_red(yaw: float, pitch: float, roll: float, s: float) -> None:
    T_ned_frd = SCENE.T_ned_frd(START + s * (CONTACT - START), yaw, pitch, roll)
    assert redness(UNLIT.render(SCENE.T_ned_tanker, T_ned_frd, SCENE.boom)).max() < 30


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE)
@settings(deadline=None, max_examples=30)
def test_sky_hangs_on_the_earth_and_not_on_the_camera(yaw: float, pitch: float, roll: float) -> None:
    """A direction in north-east-down has one colour, however the camera is turned. The tanker is out of sight."""
    camera = SCENE.cameras["thesis"]
    far = SE3(np.eye(3), np.array([0.0, 0.0, 1e7]))
    first = SE3(rotation_from_euler(yaw, pitch, roll), np.zeros(3))
    second = first @ SE3(rotation_from_euler(0.1, -0.1, 0.9), np.zeros(3))
    a, b = (STILL.render(far, T, SCENE.boom).astype(float) for T in (first, second))
    u, v = (c.ravel() for c in np.meshgrid(np.arange(4, 316, 6.0), np.arange(4, 196, 6.0)))
    rays = np.column_stack([pixels_to_normalised(camera, np.column_stack([u, v])), np.ones(len(u))])
    R_second_first = (second @ T_frd_cam(camera)).R.T @ (first @ T_frd_cam(camera)).R
    turned = rays @ R_second_first.T
    uv = normalised_to_pixels(camera, turned[:, :2] / turned[:, 2:])
    inside = (turned[:, 2] > 0.1) & np.all((uv > 1) & (uv < [318, 198]), axis=1)
    x, y = np.round(uv[inside]).astype(int).T
    difference = np.abs(a[v[inside].astype(int), u[inside].astype(int)] - b[y, x]).max(axis=1)
    assert inside.sum() > 100
    assert np.median(difference) <= 4
    assert np.quantile(difference, 0.95) < 25


def test_horizon_is_where_it_belongs(scene: Scene) -> None:
    """Level camera with its axis level: the greatest step of brightness down the middle is at row cy."""
    camera = msgspec.structs.replace(scene.cameras["default"], mount_pitch_rad=0.0)
    picture = CameraPicture(camera, scene.tanker, rng(), light=DARK, noise=0.0)
    far = SE3(np.eye(3), np.array([0.0, 0.0, 1e7]))
    up, down = (
        picture.render(far, SE3(rotation_from_euler(0.0, a, 0.0), np.zeros(3)), scene.boom).astype(float).mean(axis=1)
        for a in (0.5, -0.5)
    )
    assert up[0, 2] - up[0, 0] > 60  # blue overhead
    assert np.abs(up[-1] - down[0]).max() < 30  # both borders look at the horizon's haze
    assert down[-1].mean() < up[-1].mean()


@pytest.mark.parametrize("name", ["thesis", "default"])
def test_the_detector_finds_all_nine_lights_and_nothing_else(scene: Scene, name: str) -> None:
    camera = scene.cameras[name]
    picture = CameraPicture(camera, scene.tanker, rng(3))
    for s in np.linspace(0.0, 1.0, 8):
        T_ned_frd = scene.T_ned_frd(START + s * (CONTACT - START))
        image = picture.render(scene.T_ned_tanker, T_ned_frd, scene.boom)
        found = detect_markers(image).uv_px
        uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
        assert len(found) == 9
        nearest = np.sqrt(np.sum((uv[:, None] - found[None]) ** 2, axis=2)).min(axis=1)
        assert nearest.max() < 0.25
