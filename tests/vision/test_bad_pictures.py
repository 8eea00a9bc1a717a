"""Degenerate pictures and priors: a typed reject that says why, never an exception and never a pose."""

from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import LabelingConfig, VisionConfig
from companion.geometry import SE3, exp_so3
from companion.messages import CameraFrame, VisionOutput
from companion.vision.camera import project
from companion.vision.chain import VisionChain
from companion.vision.quality import Verdict

NEAREST = LabelingConfig(method="mutual_nearest")
CONFIGS = [
    VisionConfig(labeling=NEAREST),
    VisionConfig(solver="glsdc", labeling=NEAREST),
    VisionConfig(method="quaternion"),
    VisionConfig(),
]
LOST = {"prior_not_finite", "few_markers", "labels", "degenerate", "not_converged", "image_error", *get_args(Verdict)}


@pytest.fixture(scope="module")
def where(camera, markers, approach_pose):
    """Where the tanker is, and where its markers are in the picture."""
    T = approach_pose(np.random.default_rng(1040))
    return T, project(camera, T, markers)


@pytest.fixture(scope="module")
def chains(camera, tanker):
    return [VisionChain(camera, tanker, c) for c in CONFIGS]


def refused(out: VisionOutput) -> str:
    """Return the reason; the output of a picture without a pose is whole all the same."""
    assert out.pose is None
    assert out.reject is not None
    assert out.reject.source == "vision"
    assert out.reject.reason
    assert "\n" not in out.reject.detail
    assert out.reject.t_ns == out.t_ns == 7
    assert out.detections.uv_px.shape[1] == 2
    return out.reject.reason


def plain(camera, colour=(150, 150, 150)):
    return np.full((camera.height_px, camera.width_px, 3), colour, np.uint8)


def with_lamps(camera, places, size=4):
    image = plain(camera)
    for u, v in np.round(places).astype(int):
        image[max(v - size // 2, 0) : v + size // 2, max(u - size // 2, 0) : u + size // 2] = (250, 20, 20)
    return image


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 3), st.lists(st.integers(0, 8), max_size=1, unique=True), st.booleans())
def test_a_light_alone_or_none_gives_no_pose(camera, chains, where, which, shown, blink):
    T, uv = where
    image = with_lamps(camera, uv[shown], 6 if blink else 4)
    assert refused(chains[which].process(CameraFrame(7, 0, image), T)) in LOST


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 3), st.lists(st.integers(0, 8), min_size=2, max_size=3, unique=True), st.floats(-6, 6),
    st.booleans(),
)
def test_two_or_three_lights_lean_on_the_attitude_or_give_no_pose(camera, tanker, where, which, shown, shift, ins):
    """Fewer than four lights fix no pose by themselves. The lights here are nearest to their own predictions."""
    T, uv = where
    config = CONFIGS[which] if ins else msgspec.structs.replace(CONFIGS[which], ins_attitude="never")
    out = VisionChain(camera, tanker, config).process(
        CameraFrame(7, 0, with_lamps(camera, uv[shown] + [shift, 0.0])), T)
    if out.pose is None:
        assert refused(out) in LOST
        return
    assert ins
    sigma = np.sqrt(np.diag(out.pose.cov)[:3])  # half a pixel of painting, and the shift that the prior does not have
    moved = T.t[2] * (abs(shift) + 1.0) / camera.fx_px
    assert (np.abs(out.pose.T_cam_tanker.t - T.t) < 5.0 * sigma + 3.0 * moved).all()


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("colour", [(0, 0, 0), (255, 255, 255), (255, 0, 0), (250, 20, 20), (60, 0, 0), (0, 0, 255)])
def test_pictures_of_one_colour(camera, chains, where, which, colour):
    assert refused(chains[which].process(CameraFrame(7, 0, plain(camera, colour)), where[0])) in LOST


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("pattern", ["columns", "rows", "chequers", "noise", "left half"])
def test_pictures_that_are_red_in_many_places(camera, chains, where, which, pattern):
    image = plain(camera, (0, 0, 0))
    v, u = np.indices(image.shape[:2])
    image[..., 0] = 255 * {
        "columns": u % 2, "rows": v % 2, "chequers": (u + v) % 2, "left half": (u < 320).astype(int),
        "noise": np.random.default_rng(5).integers(0, 2, u.shape),
    }[pattern]
    assert refused(chains[which].process(CameraFrame(7, 0, image), where[0])) in LOST


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize(
    "image",
    [None, "picture", b"", 5, [[1, 2], [3]], np.zeros((480, 640), np.uint8), np.zeros((480, 640, 4), np.uint8),
     np.zeros((480, 640, 3), np.float64), np.zeros((480, 640, 3), np.int8), np.zeros((0, 0, 3), np.uint8),
     np.zeros((640, 480, 3), np.uint8), np.full((480, 640, 3), None)],
    ids=lambda i: f"{type(i).__name__}{getattr(i, 'shape', '')}{getattr(i, 'dtype', '')}",
)
def test_what_is_no_picture(chains, where, which, image):
    assert refused(chains[which].process(CameraFrame(7, 0, image), where[0])) == "frame_size"


@pytest.mark.parametrize("view", [lambda i: i[::-1], lambda i: i[:, :, ::-1], np.asfortranarray],
                         ids=["upside down", "BGR", "by columns"])
@pytest.mark.parametrize("which", range(4))
def test_a_picture_in_another_memory_order_is_no_error(camera, chains, where, which, view):
    """Arrays that are views are of the right type; upside down and with red for blue nothing is where it should be."""
    T, uv = where
    out = chains[which].process(CameraFrame(7, 0, view(with_lamps(camera, uv))), T)
    assert (out.pose is None) != (out.reject is None)


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 3),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e308]),
    st.sampled_from([(0, 0), (0, 3), (1, 1), (2, 2), (2, 3)]),
)
def test_priors_with_a_number_that_is_none(camera, chains, where, which, value, place):
    T, uv = where
    matrix = T.as_matrix()
    matrix[place] = value
    prior = SE3(matrix[:3, :3], matrix[:3, 3])
    assert refused(chains[which].process(CameraFrame(7, 0, with_lamps(camera, uv)), prior)) in LOST


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 3), st.floats(-80, -1), st.floats(-20, 20), st.floats(-20, 20))
def test_a_prior_behind_the_camera(camera, chains, where, which, z, x, y):
    """The thesis' labeling predicts no marker then; one that searches finds the tanker where it is."""
    T, uv = where
    out = chains[which].process(CameraFrame(7, 0, with_lamps(camera, uv)), SE3(T.R, np.array([x, y, z - 40.0])))
    if CONFIGS[which].labeling.method == "mutual_nearest":
        assert refused(out) in LOST
    else:
        np.testing.assert_allclose(out.pose.T_cam_tanker.t, T.t, atol=0.01 * T.t[2])


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("R", [np.zeros((3, 3)), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3))],
                         ids=["zero", "scaled", "mirrored", "flat"])
def test_a_prior_whose_rotation_is_none(camera, chains, where, which, R):
    T, uv = where
    assert refused(chains[which].process(CameraFrame(7, 0, with_lamps(camera, uv)), SE3(R @ T.R, T.t))) in LOST


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 3), st.integers(0, 2**32 - 1), st.sampled_from(["line", "point", "border", "scattered"]))
def test_lights_that_are_arranged_badly(camera, chains, where, which, seed, kind):
    """Nine lights all on one line, in one heap, along the border, or anywhere: a reason, or a pose with its markers
    where the lights are."""
    rng = np.random.default_rng(seed)
    T, _ = where
    along = rng.uniform(0, 1, (9, 1))
    places = {
        "line": [40, 40] + along * [560, 400], "point": [320, 240] + 3 * along, "border": along * [639, 0],
        "scattered": rng.uniform([0, 0], [640, 480], (9, 2)),
    }[kind]
    prior = SE3(exp_so3(rng.normal(0, 0.01, 3)) @ T.R, T.t + rng.normal(0, 0.5, 3))
    out = chains[which].process(CameraFrame(7, 0, with_lamps(camera, places)), prior)
    if out.pose is None:
        refused(out)
        return
    used = out.pose.labels >= 0
    again = project(camera, out.pose.T_cam_tanker, chains[which].markers)[used]
    miss = again - out.detections.uv_px[out.pose.labels[used]]
    assert np.sqrt(np.mean(miss**2)) < 4.0
