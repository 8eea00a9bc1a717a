"""A map of twelve markers, from its TOML file to a pose, through every kind of lens: painted and rendered pictures."""

from dataclasses import dataclass

import msgspec
import numpy as np
import pytest
import tomli_w

from companion.config import FIRMWARE_CONFIGS, CameraConfig, Setup, load_setup
from companion.geometry import SE3, R_cam_crf, exp_so3, log_so3, rotation_from_euler
from companion.messages import CameraFrame
from companion.vision.camera import T_frd_cam, project
from companion.vision.chain import VisionChain
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.truth import BoomState

LENSES = {
    "plumb_bob": (-0.21, 0.07, 4e-4, -9e-4, 0.0),
    "rational_polynomial": (0.31, -0.12, 1e-3, -8e-4, 0.02, 0.54, -0.03, 0.015),
    "equidistant": (-0.013, 0.0052, -0.0089, 0.0032),
}
MORE = ((-8.0, -4.0, 3.2), (4.0, 3.2, 3.4), (-11.0, 4.5, 2.4))
IDS = (101, 3, 77, 12, 40, 9, 250, 1, 64, 31, 500, 8)


@pytest.fixture(scope="module")
def setup(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    """Load the shipped companion with three markers more and identities in no order."""
    folder = tmp_path_factory.mktemp("twelve")
    companion = (FIRMWARE_CONFIGS / "sitl" / "docking.toml").read_text(encoding="utf-8")
    (folder / "companion.toml").write_text(companion.replace("../tankers/kc135r.toml", "twelve.toml").replace(
        "../", f"{FIRMWARE_CONFIGS}/"), encoding="utf-8")
    tanker = load_setup(FIRMWARE_CONFIGS / "sitl" / "docking.toml").tanker
    places = [m.p_tanker_m for m in tanker.markers] + list(MORE)
    content = msgspec.to_builtins(tanker) | {
        "markers": [{"id": i, "p_tanker_m": list(p)} for i, p in zip(IDS, places, strict=True)]
    }
    (folder / "twelve.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    return load_setup(folder / "companion.toml")


@dataclass(frozen=True)
class Shot:
    """A picture, the camera that took it, and where the tanker was."""

    camera: CameraConfig
    frame: CameraFrame
    T_cam_tanker: SE3


def look(setup: Setup, shot: Shot):
    """Return what the chain finds from a prior some decimetres and tenths of a degree off."""
    T = shot.T_cam_tanker
    prior = SE3(exp_so3(np.array([0.003, -0.004, 0.002])) @ T.R, T.t + np.array([0.2, -0.1, 0.3]))
    return VisionChain(shot.camera, setup.tanker, setup.config.vision).process(shot.frame, prior)


def lens(setup: Setup, model: str) -> CameraConfig:
    return msgspec.structs.replace(setup.camera, distortion_model=model, distortion=LENSES[model])


def test_identities_are_those_of_the_file(setup: Setup) -> None:
    assert tuple(m.id for m in setup.tanker.markers) == IDS


@pytest.mark.parametrize("model", LENSES)
def test_twelve_markers_are_found_through_every_lens(setup: Setup, paint, model: str) -> None:
    camera = lens(setup, model)
    points = np.array([m.p_tanker_m for m in setup.tanker.markers])
    T = SE3(R_cam_crf @ rotation_from_euler(0.02, -0.45, -0.03), np.array([0.5, -2.5, 30.0]))
    uv = project(camera, T, points)
    picture = paint(np.full((camera.height_px, camera.width_px, 3), 150.0), [(*p, 1.8) for p in uv], samples=8)
    out = look(setup, Shot(camera, CameraFrame(0, 0, np.round(picture).astype(np.uint8)), T))
    assert out.reject is None
    assert out.pose.markers_used == 12
    np.testing.assert_allclose(out.detections.uv_px[out.pose.labels], uv, atol=0.1)
    np.testing.assert_allclose(out.pose.T_cam_tanker.t, T.t, atol=0.1)
    assert np.linalg.norm(log_so3(out.pose.T_cam_tanker.R @ T.R.T)) < 0.004


@pytest.mark.parametrize("model", LENSES)
def test_the_simulator_draws_what_each_lens_shows(setup: Setup, model: str) -> None:
    """Rendered lights are where the model projects them, and the chain finds the tanker by them."""
    camera, boom = lens(setup, model), setup.tanker.boom
    picture = CameraPicture(camera, setup.tanker, np.random.default_rng(3))
    T_ned_tanker = SE3(np.eye(3), np.array([0.0, 0.0, -6000.0]))
    T_ned_frd = SE3(rotation_from_euler(0.01, 0.02, -0.01), np.array([-37.0, -2.0, -5985.0]))
    T = (T_ned_frd @ T_frd_cam(camera)).inverse() @ T_ned_tanker
    hanging = BoomState(np.array(boom.pivot_tanker_m), boom.elevation_rad, 0.0, boom.length_m)
    out = look(setup, Shot(camera, CameraFrame(0, 0, picture.render(T_ned_tanker, T_ned_frd, hanging)), T))
    assert out.reject is None
    assert out.pose.markers_used >= 9
    seen = out.pose.labels >= 0
    off = out.detections.uv_px[out.pose.labels[seen]] - out.predicted_uv_px[seen]
    truth = project(camera, T, np.array([m.p_tanker_m for m in setup.tanker.markers]))[seen]
    assert np.median(np.abs(out.detections.uv_px[out.pose.labels[seen]] - truth)) < 0.15
    assert np.median(np.abs(off)) > 1  # the prior is not the truth
    np.testing.assert_allclose(out.pose.T_cam_tanker.t, T.t, atol=0.15)
