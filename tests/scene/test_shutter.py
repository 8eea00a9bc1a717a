"""Exposures that last: smear, its middle, shaking mounts."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tanker_scene import CONTACT, START, Scene

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, Vec, log_so3
from companion.vision.camera import T_frd_cam, project
from companion.vision.detection import detect_markers
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.shutter import MOST, STEP_PX, Shutter, Vibration, carried_on
from sim_bridge.truth import BodyState, BoomState

DIM, BRIGHT = (0.1, 0.1, 0.1), (0.9, 0.1, 0.1)
SPEED = np.array([205.0, 0.0, 0.0])


def body(T_ned_body: SE3, v: Vec = SPEED, omega: Vec | None = None, t_ns: int = 0) -> BodyState:
    turn = np.zeros(3) if omega is None else omega
    return BodyState(t_ns, T_ned_body.t, v, T_ned_body.R, turn, np.zeros(3), v)


def exposed(camera: CameraConfig, exposure_s: float) -> CameraConfig:
    return msgspec.structs.replace(camera, exposure_s=exposure_s)


def shutter(scene: Scene, camera: CameraConfig, conditions: PictureConditions | None = None) -> Shutter:
    return Shutter(camera, scene.markers(), conditions or PictureConditions(), np.random.default_rng(5))


def cover(scene: Scene, camera: CameraConfig, tanker: BodyState, uav: BodyState, boom: BoomState) -> Mat:
    """Return the share of each pixel that lights cover."""
    low, high = (
        CameraPicture(camera, scene.tanker, np.random.default_rng(1), light=light, noise=0.0).expose(tanker, uav, boom)
        for light in (DIM, BRIGHT)
    )
    return (high[..., 0].astype(float) - low[..., 0]) / (255.0 * (BRIGHT[0] - DIM[0]))


def moments(share: Mat, uv: Vec, half: int = 10) -> tuple[Vec, Vec]:
    """Return centroid and variance per axis (2,) of what is within ``half`` px of ``uv``."""
    x0, y0 = (round(float(c)) for c in uv)
    window = np.clip(share[y0 - half : y0 + half + 1, x0 - half : x0 + half + 1], 0.0, 1.0)
    y, x = np.mgrid[y0 - half : y0 + half + 1, x0 - half : x0 + half + 1]
    middle = np.array([np.sum(window * x), np.sum(window * y)]) / window.sum()
    spread = np.array([np.sum(window * (x - middle[0]) ** 2), np.sum(window * (y - middle[1]) ** 2)]) / window.sum()
    return middle, spread


def lonely(scene: Scene, camera: CameraConfig, T_ned_frd: SE3) -> Mat:
    """Return where lights are that are 22 px from the border and the next one."""
    uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
    apart = np.sqrt(np.sum((uv[:, None] - uv[None]) ** 2, axis=2)) + 1e3 * np.eye(len(uv))
    inside = np.all((uv > 12) & (uv < np.array([camera.width_px, camera.height_px]) - 13), axis=1)
    return uv[inside & (apart.min(axis=1) > 22)]


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_a_smear_lies_about_mid_exposure_and_is_as_wide_as_the_motion(scene: Scene, share: float) -> None:
    """Yaw moves all lights by some 3 px. A uniform smear of w adds w^2 / 12; rounding to 1/255 moves single ones."""
    camera = exposed(scene.cameras["default"], 0.02)
    T_ned_frd = scene.T_ned_frd(START + share * (CONTACT - START))
    tanker, uav = body(scene.T_ned_tanker), body(T_ned_frd, omega=np.array([0.0, 0.0, 0.33]))
    smeared = cover(scene, camera, tanker, uav, scene.boom)
    sharp = cover(scene, exposed(camera, 0.0), tanker, uav, scene.boom)
    ends = [project(camera, ((carried_on(uav, s * 0.02) @ T_frd_cam(camera)).inverse() @ carried_on(tanker, s * 0.02)),
                    scene.markers()) for s in (-0.5, 0.5)]
    width = np.abs(ends[1] - ends[0]).mean(axis=0)
    assert width[0] > 2.5
    moved, widened = [], []
    for uv in lonely(scene, camera, T_ned_frd):
        (a, va), (b, vb) = moments(smeared, uv), moments(sharp, uv)
        moved.append(a - b)
        widened.append(va - vb)
    assert len(moved) >= 4
    assert np.abs(np.mean(moved, axis=0)).max() < 0.012
    assert np.sqrt(np.mean(np.square(moved))) < 0.02
    np.testing.assert_allclose(np.mean(widened, axis=0), width**2 / 12.0, atol=0.12)


def test_detection_finds_mid_exposure_through_smear(scene: Scene) -> None:
    camera, errors = exposed(scene.cameras["default"], 0.01), []
    picture = CameraPicture(camera, scene.tanker, np.random.default_rng(2))
    r = np.random.default_rng(3)
    for share in np.linspace(0.0, 1.0, 12):
        T_ned_frd = scene.T_ned_frd(START + share * (CONTACT - START))
        uav = body(T_ned_frd, omega=r.choice([-1, 1], 3) * [0.1, 0.3, 0.3])  # 1.5 to 2 px
        found = detect_markers(picture.expose(body(scene.T_ned_tanker), uav, scene.boom)).uv_px
        for uv in lonely(scene, camera, T_ned_frd):
            away = found - uv
            errors.append(away[np.argmin(np.sum(away**2, axis=1))])
    assert len(errors) > 50
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.08


def test_still_aircraft_are_drawn_once_and_as_without_an_exposure(scene: Scene) -> None:
    """Formation speed is no motion: only what is relative moves in the picture."""
    camera = scene.cameras["default"]
    assert camera.exposure_s > 0
    tanker, uav = body(scene.T_ned_tanker), body(scene.T_ned_frd(CONTACT))
    assert len(shutter(scene, camera).poses(tanker, uav)) == 1
    a, b = (CameraPicture(camera, scene.tanker, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(
        a.expose(tanker, uav, scene.boom), b.render(scene.T_ned_tanker, scene.T_ned_frd(CONTACT), scene.boom)
    )


rates = st.tuples(*[st.floats(-1.5, 1.5)] * 3)


@given(turn=rates, drift=st.tuples(*[st.floats(-4.0, 4.0)] * 3), exposure=st.floats(1e-4, 0.03))
@settings(max_examples=60)
def test_poses_are_close_and_lie_evenly_about_the_middle(
    scene: Scene, turn: tuple[float, float, float], drift: tuple[float, float, float], exposure: float
) -> None:
    camera = exposed(scene.cameras["default"], exposure)
    T_ned_frd = scene.T_ned_frd(0.3 * START + 0.7 * CONTACT)
    tanker, uav = body(scene.T_ned_tanker), body(T_ned_frd, SPEED + np.array(drift), np.array(turn))
    poses = shutter(scene, camera).poses(tanker, uav)
    uv = np.array([project(camera, T_cam.inverse() @ T_tanker, scene.markers()) for T_tanker, T_cam in poses])
    if 1 < len(poses) < MOST:
        assert np.sqrt(np.sum(np.diff(uv, axis=0) ** 2, axis=2)).max() < 1.2 * STEP_PX
    if len(poses) == 1:
        ends = [project(camera, (carried_on(uav, s) @ T_frd_cam(camera)).inverse() @ carried_on(tanker, s),
                        scene.markers()) for s in (-0.5 * exposure, 0.5 * exposure)]
        assert np.sqrt(np.sum((ends[1] - ends[0]) ** 2, axis=1)).max() < 1.1 * STEP_PX
    turns = [log_so3(T_ned_frd.R.T @ T_cam.R @ T_frd_cam(camera).R.T) for _, T_cam in poses]
    np.testing.assert_allclose(np.mean(turns, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.mean([T_tanker.t for T_tanker, _ in poses], axis=0), tanker.p_ned_m, atol=1e-9)


def test_a_mount_shakes_by_what_it_is_told_within_its_band() -> None:
    shaking = Vibration(1e-3, 40.0, np.random.default_rng(6))
    t_s = np.arange(0, 40.0, 1e-3)
    angles = np.array([log_so3(shaking.turn(t)) for t in t_s])
    np.testing.assert_allclose(np.sqrt(np.mean(angles**2, axis=0)), 1e-3, rtol=0.05)
    power, hz = np.abs(np.fft.rfft(angles, axis=0)) ** 2, np.fft.rfftfreq(len(t_s), 1e-3)
    outside = (hz < 0.45 * 40) | (hz > 1.55 * 40)
    assert power[outside].sum() < 0.01 * power.sum()


def test_shaking_is_the_same_for_the_same_seed_and_moves_the_picture(scene: Scene) -> None:
    conditions = PictureConditions(vibration_rad=2e-3, vibration_hz=60.0)
    camera = scene.cameras["default"]
    T_ned_frd = scene.T_ned_frd(0.5 * (START + CONTACT))
    uv = project(camera, scene.T_cam_tanker(camera, T_ned_frd), scene.markers())
    a, b = (CameraPicture(camera, scene.tanker, np.random.default_rng(7), conditions=conditions) for _ in range(2))
    shifts = []
    for k in range(12):
        states = (body(scene.T_ned_tanker, t_ns=50_000_000 * k), body(T_ned_frd, t_ns=50_000_000 * k), scene.boom)
        picture = a.expose(*states)
        np.testing.assert_array_equal(picture, b.expose(*states))
        found = detect_markers(picture).uv_px
        shifts.append(np.mean([found[np.argmin(np.sum((found - p) ** 2, axis=1))] - p for p in uv], axis=0))
    assert 0.4 < np.std(shifts) / (2e-3 * camera.fx_px) < 1.8
