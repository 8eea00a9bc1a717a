"""Clutter, daylight, haze and exposure of the simulated pictures, and what detection makes of them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from tanker_scene import CONTACT, START, Scene

from companion.config import CameraConfig, ConfigError, DetectionConfig, TankerConfig
from companion.geometry import SE3, Mat
from companion.vision.camera import project
from companion.vision.detection import BlobFlag, detect_markers
from sim_bridge.scenario import load_scenario
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.clutter import RED_PAINT, glows, navigation_lights
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.visibility import sphere_visibility

EVERYTHING = PictureConditions(clutter=("navigation", "glint", "stripe"), hot_pixels=30)
LARGE = {"width_px": 1280, "height_px": 960, "fx_px": 914.0, "fy_px": 914.0, "cx_px": 639.5, "cy_px": 479.5}


def cameras(scene: Scene) -> dict[str, CameraConfig]:
    return {**scene.cameras, "large": msgspec.structs.replace(scene.cameras["default"], **LARGE)}


@lru_cache(maxsize=16)
def painter(camera: CameraConfig, tanker: TankerConfig, conditions: PictureConditions) -> CameraPicture:
    return CameraPicture(camera, tanker, np.random.default_rng(9), conditions=conditions)


def taken(scene: Scene, camera: CameraConfig, conditions: PictureConditions, T_ned_frd: SE3) -> NDArray[np.uint8]:
    return painter(camera, scene.tanker, conditions).render(scene.T_ned_tanker, T_ned_frd, scene.boom)


def on_the_way(scene: Scene, share: float) -> SE3:
    return scene.T_ned_frd(START + share * (CONTACT - START))


def nearest(places: Mat, truth: Mat) -> Mat:
    """Return the distance (n,) in px from each of ``truth`` to the nearest of ``places``; inf when there is none."""
    away = np.sqrt(np.sum((truth[:, None] - places[None]) ** 2, axis=2))
    return away.min(axis=1, initial=np.inf)


def port_light(scene: Scene, camera: CameraConfig, T_ned_frd: SE3) -> tuple[Mat, bool]:
    """Return where the red navigation light is in the picture (1, 2), and whether it shows."""
    place = navigation_lights()[0].places_tanker_m
    share = sphere_visibility(camera, place, 0.05, scene.T_ned_tanker, T_ned_frd, scene.boom)
    return project(camera, scene.T_cam_tanker(camera, T_ned_frd), place), bool(share[0] > 0.5)


@pytest.mark.parametrize("name", ["thesis", "default", "large"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_lights_are_found_among_clutter_and_only_what_looks_like_one_beside_them(
    scene: Scene, name: str, share: float
) -> None:
    """What may be left: the red navigation light, and letters that are no larger than the picture of a point."""
    camera, T_ned_frd = cameras(scene)[name], on_the_way(scene, share)
    found = detect_markers(taken(scene, camera, EVERYTHING, T_ned_frd))
    uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
    assert nearest(found.uv_px, uv).max() < 0.4  # a hot pixel may touch a light
    extra = found.take(nearest(uv, found.uv_px) > 0.25)
    place, shows = port_light(scene, camera, T_ned_frd)
    if shows and name != "thesis":  # where it is a quarter of a pixel wide before a bright sky
        assert nearest(extra.uv_px, place)[0] < 0.4
    others = extra.take(nearest(place, extra.uv_px) > 0.4) if len(extra.uv_px) else extra
    allowed = {"thesis": 11, "default": 3, "large": 0}[name]
    assert len(others.uv_px) <= allowed


def test_hot_pixels_and_glints_never_come_through(scene: Scene) -> None:
    conditions = PictureConditions(clutter=("glint",), hot_pixels=60)
    for name, camera in cameras(scene).items():
        for share in (0.0, 0.5, 1.0):
            found = detect_markers(taken(scene, camera, conditions, on_the_way(scene, share)))
            uv = project(camera, scene.T_cam_tanker(camera, on_the_way(scene, share)), scene.markers())
            spurious = found.uv_px[nearest(uv, found.uv_px) > 1.0]
            assert len(spurious) <= (2 if name == "thesis" else 1), name


@pytest.mark.parametrize("name", ["thesis", "default", "large"])
@pytest.mark.parametrize(
    ("conditions", "within_px"),
    [
        (PictureConditions(gain=0.3), 0.25),
        (PictureConditions(haze=0.6), 0.25),
        (PictureConditions(daylight=0.05, gain=2.0), 0.25),
        (PictureConditions(daylight=0.0, gain=0.3), 0.25),
        (PictureConditions(gain=0.5, haze=0.5), 0.25),
    ],
)
def test_all_lights_are_found_in_dim_hazy_and_dark_pictures(
    scene: Scene, name: str, conditions: PictureConditions, within_px: float
) -> None:
    camera = cameras(scene)[name]
    for share in (0.0, 0.5, 1.0):
        T_ned_frd = on_the_way(scene, share)
        found = detect_markers(taken(scene, camera, conditions, T_ned_frd))
        uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
        assert len(found.uv_px) == 9
        assert nearest(found.uv_px, uv).max() < within_px


@pytest.mark.parametrize("name", ["default", "large"])
def test_a_threefold_exposure_leaves_the_lights_with_a_large_sigma(scene: Scene, name: str) -> None:
    camera = cameras(scene)[name]
    for share in (0.0, 0.5, 1.0):
        T_ned_frd = on_the_way(scene, share)
        found = detect_markers(taken(scene, camera, PictureConditions(gain=3.0), T_ned_frd))
        uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
        assert len(found.uv_px) >= 8
        assert nearest(uv, found.uv_px).max() < 1.2
        washed = (found.flags & BlobFlag.WASHED) > 0
        assert washed.mean() > 0.5
        assert found.sigma_px[washed].min() > 0.1


def test_a_gain_is_a_gain(scene: Scene) -> None:
    """Away from lights and from either end of the scale, half the exposure is half the value."""
    T_ned_frd = on_the_way(scene, 0.5)
    full, half = (
        CameraPicture(scene.cameras["thesis"], scene.tanker, np.random.default_rng(9), noise=0.0,
                      conditions=PictureConditions(gain=g)).render(scene.T_ned_tanker, T_ned_frd, scene.boom)
        for g in (1.0, 0.5)
    )
    unlit = full[..., 0] < 250
    assert np.abs(half[unlit].astype(float) - 0.5 * full[unlit]).max() <= 1.0


def test_clutter_leaves_the_rest_of_the_picture_as_it_was(scene: Scene) -> None:
    """Bit for bit outside of what glows, is painted or is hot, from the same generator."""
    camera, T_ned_frd = scene.cameras["default"], on_the_way(scene, 0.5)
    plain, hot, everything, again = (
        CameraPicture(camera, scene.tanker, np.random.default_rng(9), conditions=c).render(
            scene.T_ned_tanker, T_ned_frd, scene.boom
        )
        for c in (PictureConditions(), PictureConditions(hot_pixels=30), EVERYTHING, EVERYTHING)
    )
    changed = np.any(plain != hot, axis=2)
    assert 25 <= changed.sum() <= 30
    assert np.all(hot[changed][:, 0] == 255)
    assert 30 < np.any(plain != everything, axis=2).sum() < 2500
    np.testing.assert_array_equal(again, everything)


def test_navigation_lights_have_their_sides_and_nothing_glows_unasked() -> None:
    red, green, white = navigation_lights()
    assert red.places_tanker_m[0, 1] < -19
    assert green.places_tanker_m[0, 1] > 19
    assert [int(light.radiance.argmax()) for light in (red, green)] == [0, 1]
    assert np.ptp(white.radiance) == 0
    assert glows(()) == []
    assert RED_PAINT[0] > 5 * RED_PAINT[1]


def test_without_rejection_clutter_is_named(scene: Scene) -> None:
    picture = taken(scene, scene.cameras["default"], EVERYTHING, on_the_way(scene, 0.7))
    flags = np.bitwise_or.reduce(detect_markers(picture, DetectionConfig(reject_clutter=False)).flags)
    for name in (BlobFlag.HOT, BlobFlag.GLINT, BlobFlag.FAINT):
        assert flags & name


def test_the_shipped_scenario_has_clutter_and_the_default_has_none() -> None:
    assert load_scenario("clutter").picture == EVERYTHING
    assert load_scenario("docking").picture == PictureConditions()


@pytest.mark.parametrize(
    ("line", "words"),
    [("gain = 0.0", "picture.gain"), ("daylight = 2.0", "picture.daylight"), ("haze = 1.0", "picture.haze"),
     ("hot_pixels = -1", "picture.hot_pixels"), ('clutter = ["glint", "glint"]', "names something twice"),
     ("sun_azimuth_rad = 90.0", "radians, not degrees"), ("sun_elevation_rad = 8.0", "radians, not degrees"),
     ("glare = 2.0", "picture.glare"), ("cloud_per_m = 1.0", "picture.cloud_per_m"), ("noise = -1.0", "picture.noise"),
     ("vibration_rad = 0.5", "radians, not degrees"), ("vibration_hz = 0.0", "picture.vibration_hz"),
     ('clutter = ["flare"]', "picture.clutter"), ("gian = 1.0", "did you mean 'gain'")],
)
def test_conditions_that_cannot_be_are_refused(tmp_path: Path, line: str, words: str) -> None:
    companion = Path(load_scenario("docking").companion)
    file = tmp_path / "odd.toml"
    file.write_text(f'name = "odd"\ncompanion = "{companion}"\n[picture]\n{line}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        load_scenario(file)
