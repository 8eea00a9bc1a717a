"""Labels of a frame by the configured rule: which search, among which detections, with how many agreeing."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from label_frames import CAMERA, MARKERS, TANKER, pose

from companion.config import FIRMWARE_CONFIGS, VisionConfig, load_setup
from companion.geometry import SE3, exp_so3, rotation_from_euler
from companion.messages import CameraFrame, Detections
from companion.vision.camera import T_frd_cam, project
from companion.vision.chain import VisionChain
from companion.vision.labeler import MOST
from sim_bridge.plant.boom import nominal_boom
from sim_bridge.scene.camera_picture import CameraPicture

SEEDS = st.integers(0, 999)


@pytest.fixture(scope="module")
def chain():
    return VisionChain(CAMERA, TANKER, VisionConfig())


def seen(uv_px, area=None):
    m = len(uv_px)
    return Detections(0, uv_px, np.full(m, 9.0) if area is None else area, np.full(m, 0.1), np.zeros(m, np.uint8))


def scene(seed):
    """Return a generator, a pose with all markers in view, where they are, and a prior as good as a track's."""
    rng = np.random.default_rng(seed)
    while True:
        T = pose(rng)
        px = project(CAMERA, T, MARKERS)
        if ((px > 5) & (px < [CAMERA.width_px - 6, CAMERA.height_px - 6])).all():
            break
    prior = SE3(exp_so3(rng.normal(0.0, 0.002, 3)) @ T.R, T.t + rng.normal(0.0, 0.1, 3))
    return rng, T, px + rng.normal(0.0, 0.1, px.shape), prior


@settings(max_examples=30)
@given(SEEDS)
def test_three_lights_are_enough_while_tracking_and_not_otherwise(chain, seed):
    _, T, px, prior = scene(seed)
    few = px[[1, 2, 7]]
    assert chain.measure(0, seen(few), prior).pose is None
    found = chain.measure(0, seen(few), prior, tracked=True).pose
    assert found is None or np.linalg.norm(found.T_cam_tanker.t - T.t) < 0.4


@settings(max_examples=60)
@given(SEEDS)
def test_few_lights_with_a_stranger_among_the_markers_give_no_pose(chain, seed):
    """One of the few might be a stranger as well: two right labels and one that is 1 m off fit each other."""
    rng, _, px, prior = scene(seed)
    two = rng.choice(9, 2, replace=False)
    strangers = px[rng.choice(9, 4)] + rng.normal(0.0, 20.0, (4, 2))
    assert chain.measure(0, seen(np.concatenate([px[two], strangers])), prior, tracked=True).pose is None


@pytest.mark.parametrize("off_m", [0.0, 3.0, 9.0])
@pytest.mark.parametrize("seed", [301, 302, 303])
def test_lights_among_more_strangers_than_a_search_goes_through(chain, seed, off_m):
    """The nearest to where markers are expected are looked at, then the largest; labels count all detections."""
    rng, T, px, prior = scene(seed)
    strangers = rng.uniform([0, 0], [CAMERA.width_px, CAMERA.height_px], (MOST + 23, 2))
    away = np.sqrt(np.sum((strangers[:, None] - px[None]) ** 2, axis=2)).min(axis=1)
    strangers = strangers[away > 15.0]
    order = rng.permutation(9 + len(strangers))
    uv = np.concatenate([px, strangers])[order]
    area = np.concatenate([np.full(9, 12.0), np.full(len(strangers), 6.0)])[order]
    prior = SE3(prior.R, prior.t + off_m * np.array([0.6, 0.0, 0.8]))
    out = chain.measure(0, seen(uv, area), prior)
    assert out.pose is not None
    labelled = out.pose.labels >= 0
    assert labelled.sum() >= 7
    np.testing.assert_array_equal(order[out.pose.labels[labelled]], np.flatnonzero(labelled))
    np.testing.assert_allclose(out.pose.T_cam_tanker.t, T.t, atol=0.3)


def test_corners_with_a_wrong_prior_give_the_right_pose_or_none():
    """Shapes repeat on an airframe: without a prior that is nearly right they may all be somebody else's."""
    setup = load_setup(FIRMWARE_CONFIGS / "sitl" / "corners.toml")
    chain = VisionChain(setup.camera, setup.tanker, setup.config.vision)
    rng = np.random.default_rng(304)
    picture = CameraPicture(setup.camera, setup.tanker, rng)
    posed = 0
    for k in range(36):
        place = np.array([-29.0, 0.0, 9.0]) + rng.uniform(0.0, 1.0) * np.array([-21.0, -20.0, 21.0])
        T_ned_frd = SE3(rotation_from_euler(*rng.normal(0.0, 0.01, 3)), place)
        T = (T_ned_frd @ T_frd_cam(setup.camera)).inverse()
        image = picture.render(SE3.identity(), T_ned_frd, nominal_boom(setup.tanker.boom))
        off = rng.normal(0.0, 1.0, 3)
        off *= (0.3, 2.0, 3.0)[k % 3] / np.linalg.norm(off)
        prior = SE3(exp_so3(rng.normal(0.0, 0.002, 3)) @ T.R, T.t + off)
        out = chain.process(CameraFrame(k, k, image), prior, tracked=bool(k % 2))
        if out.pose is not None:
            posed += 1
            assert np.linalg.norm(out.pose.T_cam_tanker.t - T.t) < 0.3
    assert posed >= 12


def test_the_thesis_labeling_does_not_search(chain):
    _, _, px, prior = scene(305)
    thesis = VisionChain(CAMERA, TANKER, msgspec.structs.replace(
        chain.config, labeling=msgspec.structs.replace(chain.config.labeling, method="mutual_nearest")))
    away = SE3(prior.R, prior.t + np.array([60.0, 0.0, 0.0]))
    assert thesis.measure(0, seen(px), away).reject.reason == "few_markers"
