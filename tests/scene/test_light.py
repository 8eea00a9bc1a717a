"""Night, low sun and cloud: physics of the light, and that lights are found in it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tanker_scene import CONTACT, START, Scene

from companion.config import CameraConfig, TankerConfig
from companion.geometry import SE3, Mat, Vec, rotation_from_euler
from companion.vision.camera import T_frd_cam, project
from companion.vision.detection import detect_markers
from sim_bridge.scenario import load_scenario
from sim_bridge.scene.air import Air
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.light import FROM_ABOVE, FROM_BELOW, SUNLIGHT, illumination, sun_through_air
from sim_bridge.scene.sky import cloud_noise, colour_of, radiance_of
from sim_bridge.scene.visibility import marker_visibility
from sim_bridge.truth import BodyState

SCENARIOS = ("night", "low_sun", "cloud")
NORTH = SE3(rotation_from_euler(0.0, 0.064, 0.0), np.array([1000.0, 500.0, -6000.0]))
LOW = PictureConditions(sun_azimuth_rad=0.0, sun_elevation_rad=0.2)


@lru_cache(maxsize=16)
def painter(camera: CameraConfig, tanker: TankerConfig, conditions: PictureConditions, threads: int = 2,
            noise: float | None = None) -> CameraPicture:
    return CameraPicture(camera, tanker, np.random.default_rng(9), threads, conditions=conditions, noise=noise)


def receiver(share: float, yaw: float = 0.0) -> SE3:
    """Return the receiver on its way, heading north."""
    return NORTH @ SE3(rotation_from_euler(yaw, 0.0, 0.0), START + share * (CONTACT - START))


def taken(scene: Scene, conditions: PictureConditions, T_ned_frd: SE3, name: str = "default",
          noise: float | None = None) -> NDArray[np.uint8]:
    picture = painter(scene.cameras[name], scene.tanker, conditions, noise=noise)
    return picture.render(NORTH, T_ned_frd, scene.boom)


def markers_px(scene: Scene, camera: CameraConfig, T_ned_frd: SE3) -> Mat:
    return project(camera, (T_ned_frd @ T_frd_cam(camera)).inverse() @ NORTH, scene.markers())


def test_the_default_light_is_a_clear_day() -> None:
    light = illumination(PictureConditions())
    np.testing.assert_allclose(light.lit_by[1:], [SUNLIGHT, FROM_ABOVE, FROM_BELOW], rtol=1e-12)
    np.testing.assert_allclose(light.lit_by[0] @ light.lit_by[0], 1.0, rtol=1e-12)
    assert (light.sky, light.below, light.scale, light.rest, light.kept) == (1.0, 1.0, 1.0, 1.0, 1.0)


@given(st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_a_lower_sun_is_weaker_and_warmer(a: float, b: float) -> None:
    low, high = (sun_through_air(e) for e in sorted((a, b)))
    assert np.all(low <= high + 1e-12)
    assert np.all(np.diff(low) <= 0)  # red comes through best
    assert low[2] / low[0] <= high[2] / high[0] + 1e-12
    assert not np.any(sun_through_air(-0.01 - a))


@given(st.floats(0.01, 100.0), st.floats(0.0, 1.0))
def test_both_parts_of_the_gain_make_the_whole_and_clip_nothing_early(gain: float, daylight: float) -> None:
    light = illumination(PictureConditions(gain=gain, daylight=daylight))
    assert light.scale * light.rest == pytest.approx(gain)
    assert light.rest >= 1.0 - 1e-12
    assert light.surroundings <= 1.0 + 1e-12


def test_the_sun_stands_where_it_is_said_to_and_in_cloud_nowhere() -> None:
    r = np.random.default_rng(2)
    high, low = cloud_noise(r), cloud_noise(r)
    light = illumination(LOW)
    away = rotation_from_euler(0.0, 0.05, 0.0) @ light.sun_ned
    sun, beside = radiance_of(np.array([[light.sun_ned, away]]), high, low, light)[0]
    assert np.all(sun > 50)
    assert np.all((beside > 0.2) & (beside < 2.0))
    fog = illumination(PictureConditions(cloud_per_m=0.01, sun_azimuth_rad=0.0, sun_elevation_rad=0.2))
    assert np.ptp(radiance_of(np.array([[light.sun_ned, away]]), high, low, fog), axis=1).max() == 0


def test_a_low_sun_dims_the_sky_and_what_lies_below_more() -> None:
    r = np.random.default_rng(3)
    high, low = cloud_noise(r), cloud_noise(r)
    up, down = np.array([[[0.3, 0.2, -0.93]]]), np.array([[[0.3, 0.2, 0.93]]])
    day, evening = illumination(PictureConditions()), illumination(LOW)
    dimmed = [colour_of(d, high, low, evening) / colour_of(d, high, low, day) for d in (up, down)]
    assert np.all(dimmed[1] < dimmed[0])
    assert np.all(dimmed[0] < 0.6)


def test_glare_falls_off_from_the_sun_and_goes_out_behind_the_airframe(scene: Scene) -> None:
    """With the sun behind the belly the picture is as without glare."""
    glaring = PictureConditions(sun_azimuth_rad=0.0, sun_elevation_rad=0.2, glare=0.1)
    for name in ("default", "thesis"):
        veiled, clear = (taken(scene, c, receiver(0.0), name, 0.0).astype(float) for c in (glaring, LOW))
        camera = scene.cameras[name]
        R_ned_cam = (receiver(0.0) @ T_frd_cam(camera)).R
        d = R_ned_cam.T @ illumination(LOW).sun_ned
        sun_px = np.array([camera.fx_px * d[0] / d[2] + camera.cx_px, camera.fy_px * d[1] / d[2] + camera.cy_px])
        assert np.all(clear[round(sun_px[1]), round(sun_px[0])] > 240)  # two pixels wide in the smaller picture
        veil = (veiled - clear)[..., 2]
        ten_degrees = sun_px - np.array([0.0, camera.fy_px * np.tan(np.radians(10.0))])
        near, far = (veil[round(y), round(x)] for x, y in (ten_degrees, ten_degrees * [1.0, 0.25]))
        assert veil.min() >= 0
        assert 10 < near < 40
        assert far < 0.6 * near
    behind = [PictureConditions(sun_azimuth_rad=a, sun_elevation_rad=e, glare=g)
              for g in (0.1, 0.0) for a, e in (towards_belly(),)]
    with_glare, without = (taken(scene, c, receiver(1.0), "default", 0.0) for c in behind)
    np.testing.assert_array_equal(with_glare, without)


def towards_belly() -> tuple[float, float]:
    """Return azimuth and elevation of the tanker's middle, seen from the receiver's camera at contact."""
    d = NORTH.transform(np.zeros(3)) - receiver(1.0).transform(np.array([5.0, 0.0, -0.3]))
    return float(np.arctan2(d[1], d[0])), float(np.arcsin(-d[2] / np.sqrt(d @ d)))


def test_cloud_keeps_an_exponential_share_and_wisps_stand_still_in_the_air() -> None:
    conditions = PictureConditions(cloud_per_m=0.01)
    air = Air(illumination(conditions), np.random.default_rng(4))
    T_ned_cam = SE3(rotation_from_euler(0.4, 0.3, 0.1), np.array([100.0, 200.0, -6000.0]))
    rays = np.random.default_rng(5).standard_normal((400, 3))
    rays /= np.sqrt(np.sum(rays**2, axis=1))[:, None]
    left = air.left_of(30.0 * rays, T_ned_cam)
    assert 0.05 < np.std(np.log(left)) / 0.3 < 0.8
    places = np.random.default_rng(6).uniform(-5e4, 5e4, (3000, 3))
    density = [-np.log(air.left_of(np.array([[0.0, 0.0, 30.0]]), SE3(np.eye(3), p))[0]) / 0.3 for p in places]
    assert np.mean(density) == pytest.approx(1.0, abs=0.05)
    assert np.std(density) == pytest.approx(0.45, abs=0.05)
    from_there, turned = 20.0 * T_ned_cam.R[:, 2], SE3(T_ned_cam.R @ rotation_from_euler(0.0, 0.0, 0.7), T_ned_cam.t)
    assert air.left_of(np.array([[0.0, 0.0, 20.0]]), T_ned_cam)[0] == pytest.approx(
        air.left_of((turned.R.T @ from_there)[None], turned)[0])


def test_haze_and_cloud_take_contrast_with_distance(scene: Scene) -> None:
    """The dark belly against the sky, from the start and at contact."""
    def contrast(conditions: PictureConditions, share: float) -> float:
        picture = taken(scene, conditions, receiver(share), noise=0.0).astype(float)[..., 2]
        return float(np.percentile(picture, 99) - np.percentile(picture, 2))

    cloud = PictureConditions(cloud_per_m=0.02)
    assert contrast(cloud, 0.0) < 0.7 * contrast(cloud, 1.0)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("camera", ["default", "thesis"])
def test_lights_are_found_in_the_light_of_the_scenarios(scene: Scene, name: str, camera: str) -> None:
    conditions, errors = load_scenario(name).picture, []
    for share in (0.0, 0.3, 0.6, 0.8, 1.0):
        T_ned_frd = receiver(share)
        found = detect_markers(taken(scene, conditions, T_ned_frd, camera)).uv_px
        uv = markers_px(scene, scene.cameras[camera], T_ned_frd)
        seen = marker_visibility(scene.cameras[camera], scene.tanker, NORTH, T_ned_frd, scene.boom) == 1.0
        away = np.sqrt(np.sum((uv[seen][:, None] - found[None]) ** 2, axis=2)).min(axis=1)
        errors.append(away)
        assert len(found) <= 13
    assert np.concatenate(errors).max() < 0.35


def test_a_night_is_nearly_black_but_for_lights(scene: Scene) -> None:
    conditions = load_scenario("night").picture
    picture = taken(scene, conditions, receiver(0.5))
    assert np.percentile(picture, 99) < 25
    assert picture[..., 0].max() == 255


@pytest.mark.parametrize("name", SCENARIOS)
def test_same_seed_gives_the_same_bits_with_any_threads_in_any_light(scene: Scene, name: str) -> None:
    conditions, camera = load_scenario(name).picture, scene.cameras["default"]
    v, spin = np.array([205.0, 0.5, 0.0]), np.array([0.3, -0.5, 0.9])
    pictures = []
    for threads in (1, 2):
        camera_picture = CameraPicture(camera, scene.tanker, np.random.default_rng(9), threads, conditions=conditions)
        pictures.append([camera_picture.expose(moving(NORTH, v, 0.2 * spin, t), moving(receiver(0.7), v, spin, t),
                                               scene.boom) for t in (0, 50_000_000)])
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.any(pictures[0][0] != pictures[0][1])


def moving(T_ned_body: SE3, v: Vec, spin: Vec, t_ns: int) -> BodyState:
    return BodyState(t_ns, T_ned_body.t, v, T_ned_body.R, spin, np.zeros(3), v)
