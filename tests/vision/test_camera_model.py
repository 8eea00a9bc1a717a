import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import CameraConfig
from companion.geometry import SE3, exp_so3
from companion.vision.camera import (
    T_frd_cam,
    bends,
    distortion_reach_squared,
    normalised_to_pixels,
    pixels_to_normalised,
    project,
)

BARREL = (-0.25, 0.08, 1e-3, -2e-3, 0.01)
RATIONAL = (0.31, -0.12, 1e-3, -8e-4, 0.02, 0.54, -0.03, 0.015)
FISHEYE = (-0.013, 0.0052, -0.0089, 0.0032)
MODELS = {"plumb_bob": BARREL, "rational_polynomial": RATIONAL, "equidistant": FISHEYE}


def with_lens(camera: CameraConfig, model: str, distortion: tuple[float, ...]) -> CameraConfig:
    return msgspec.structs.replace(camera, distortion_model=model, distortion=distortion)


def matrix(camera: CameraConfig):
    return np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("plumb_bob", (0.0,) * 5), ("plumb_bob", BARREL), ("plumb_bob", (0.1, -0.05, 2e-3, 1e-3, 0.0)),
     ("rational_polynomial", (0.0,) * 8), ("rational_polynomial", RATIONAL), ("equidistant", FISHEYE),
     ("equidistant", (0.0,) * 4)],
)
def test_projection_is_that_of_opencv(camera, model, distortion):
    camera = with_lens(camera, model, distortion)
    rng = np.random.default_rng(1)
    T = SE3(exp_so3(rng.normal(0, 0.3, 3)), np.array([1.0, -2.0, 30.0]))
    points = rng.uniform(-9, 9, (60, 3)) * (2.5 if model == "equidistant" else 1.0)
    points = points[T.transform(points)[:, 2] > 1.0]
    rotation = cv2.Rodrigues(T.R)[0]
    if model == "equidistant":
        theirs, _ = cv2.fisheye.projectPoints(points[:, None], rotation, T.t, matrix(camera), np.array(distortion))
    else:
        theirs, _ = cv2.projectPoints(points, rotation, T.t, matrix(camera), np.array(distortion))
    np.testing.assert_allclose(project(camera, T, points), theirs.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_undistorted_pixels_are_those_of_opencv(camera, model):
    camera = with_lens(camera, model, MODELS[model])
    pixels = np.random.default_rng(2).uniform([0, 0], [640, 480], (200, 2))
    D, exactly = np.array(MODELS[model]), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-15)
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    theirs = undistort(pixels[:, None], matrix(camera), D, criteria=exactly)
    np.testing.assert_allclose(pixels_to_normalised(camera, pixels), theirs[:, 0], atol=1e-8)


def test_brown_is_the_rational_model_over_one(camera):
    uv = np.random.default_rng(3).uniform(-1, 1, (50, 2))
    brown = normalised_to_pixels(with_lens(camera, "plumb_bob", BARREL), uv)
    rational = normalised_to_pixels(with_lens(camera, "rational_polynomial", (*BARREL, 0.0, 0.0, 0.0)), uv)
    np.testing.assert_array_equal(brown, rational)


def test_without_coefficients_only_a_fisheye_bends(camera):
    assert not bends(with_lens(camera, "plumb_bob", (0.0,) * 5))
    assert not bends(with_lens(camera, "rational_polynomial", (0.0,) * 8))
    fisheye = with_lens(camera, "equidistant", (0.0,) * 4)
    assert bends(fisheye)
    np.testing.assert_allclose(normalised_to_pixels(fisheye, np.array([[np.tan(0.7), 0.0]])),
                               [[camera.cx_px + 0.7 * camera.fx_px, camera.cy_px]], atol=1e-10)


SMALL = st.floats(-0.3, 0.3)
RADIAL = st.one_of(
    st.tuples(st.just("plumb_bob"), st.tuples(SMALL, SMALL, st.just(0.0), st.just(0.0), SMALL)),
    st.tuples(st.just("rational_polynomial"),
              st.tuples(SMALL, SMALL, st.just(0.0), st.just(0.0), SMALL, SMALL, SMALL, SMALL)),
    st.tuples(st.just("equidistant"), st.tuples(SMALL, SMALL, SMALL, SMALL)),
)


@settings(max_examples=200, deadline=None)
@given(RADIAL, st.lists(st.tuples(st.floats(0.0, 0.999), st.floats(-3.2, 3.2)), min_size=1, max_size=8))
def test_radial_lenses_are_inverted_all_the_way_to_their_reach(camera, lens, polar):
    """Inside the reach every ray has a pixel and every such pixel has its ray; outside there is no pixel."""
    camera = with_lens(camera, *lens)
    reach = distortion_reach_squared(lens[1], lens[0]) ** 0.5
    share, angle = np.array(polar).T
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    xy = share[:, None] * min(reach, 3.0) * direction
    pixels = normalised_to_pixels(camera, xy)
    assert np.isfinite(pixels).all()
    back = pixels_to_normalised(camera, pixels)
    assert np.isfinite(back).all()
    np.testing.assert_allclose(normalised_to_pixels(camera, back), pixels, rtol=1e-9, atol=1e-6)
    steep = np.diff([normalised_to_pixels(camera, xy), normalised_to_pixels(camera, xy * (1 - 1e-6))], axis=0)[0]
    flat = np.linalg.norm(steep, axis=1) < 1e-8 * camera.fx_px * np.linalg.norm(xy, axis=1)  # no pixel tells them apart
    np.testing.assert_allclose(back[~flat], xy[~flat], rtol=1e-5, atol=1e-7)
    if np.isfinite(reach):
        assert np.isnan(normalised_to_pixels(camera, 1.001 * reach * direction)).all()


@pytest.mark.parametrize("model", MODELS)
def test_a_pixel_without_a_ray_is_nan_and_so_is_nan(camera, model):
    bent = {"plumb_bob": (-0.3, 0.0, 0.0, 0.0, 0.0), "equidistant": (-0.2, 0.0, 0.0, 0.0),
            "rational_polynomial": (0.0, 0.0, 0.0, 0.0, 0.0, 0.9, 0.0, 0.0)}[model]
    camera = with_lens(camera, model, bent)
    pixels = np.array([[4000.0, 100.0], [np.nan, 100.0], [320.0, np.inf], [1e300, 0.0], [camera.cx_px, camera.cy_px]])
    seen = np.isfinite(pixels_to_normalised(camera, pixels))
    np.testing.assert_array_equal(seen, [[False] * 2] * 4 + [[True] * 2])
    np.testing.assert_array_equal(np.isfinite(normalised_to_pixels(camera, np.array([[np.nan, 0.0], [1e200, 0.0]]))),
                                  False)


def test_a_fisheye_reaches_to_the_side_and_no_farther(camera):
    camera = with_lens(camera, "equidistant", (0.0,) * 4)
    for theta, seen in ((1.55, True), (1.58, False)):
        pixel = np.array([[camera.cx_px - theta * camera.fx_px, camera.cy_px]])
        ray = pixels_to_normalised(camera, pixel)
        assert np.isfinite(ray).all() == seen
        if seen:
            np.testing.assert_allclose(ray, [[-np.tan(theta), 0.0]], rtol=1e-9, atol=1e-12)


@settings(deadline=None)  # the first call compiles
@given(
    st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3),
    st.lists(st.tuples(st.floats(0, 639), st.floats(0, 479)), min_size=1, max_size=8),
)
def test_undistorting_inverts_distorting(k1, k2, p1, p2, pixels):
    camera = CameraConfig(name="c", width_px=640, height_px=480, rate_hz=20.0, fx_px=457.0, fy_px=450.0, cx_px=319.5,
                          cy_px=239.5, p_frd_cam_m=(0.0, 0.0, 0.0), distortion=(k1, k2, p1, p2, 0.0))
    pixels = np.array(pixels)
    back = normalised_to_pixels(camera, pixels_to_normalised(camera, pixels))
    reached = np.isfinite(back).all(axis=1)
    np.testing.assert_allclose(back[reached], pixels[reached], atol=1e-6)
    assert reached[np.abs(pixels - [319.5, 239.5]).max(axis=1) < 150].all()


def test_what_cannot_be_seen_is_nan(camera):
    points = np.array([[0.0, 0.0, 10.0], [0.0, 0.0, 0.0], [1.0, 1.0, -10.0]])
    seen = np.isfinite(project(camera, SE3.identity(), points))
    np.testing.assert_array_equal(seen, [[True, True], [False, False], [False, False]])


def test_a_folded_ray_does_not_come_back_into_the_picture(camera):
    camera = msgspec.structs.replace(camera, distortion=(-0.25, 0.0, 0.0, 0.0, 0.0))
    turning = distortion_reach_squared(camera.distortion) ** 0.5
    assert turning == pytest.approx((1 / 0.75) ** 0.5)
    uv = normalised_to_pixels(camera, np.array([[0.99 * turning, 0.0], [1.01 * turning, 0.0], [2.0, 0.0]]))
    np.testing.assert_array_equal(np.isfinite(uv[:, 0]), [True, False, False])


def test_the_camera_looks_forward_and_up_from_its_place(camera):
    T = T_frd_cam(camera)
    pitch = camera.mount_pitch_rad
    np.testing.assert_allclose(T.R @ [0, 0, 1], [np.cos(pitch), 0, -np.sin(pitch)], atol=1e-15)
    np.testing.assert_allclose(T.R @ [1, 0, 0], [0, 1, 0], atol=1e-15)  # right in the picture is right
    np.testing.assert_array_equal(T.t, camera.p_frd_cam_m)


def test_mount_angles_turn_yaw_then_pitch_then_roll(camera):
    camera = msgspec.structs.replace(camera, mount_yaw_rad=np.pi / 2, mount_pitch_rad=0.0, mount_roll_rad=np.pi / 2)
    R = T_frd_cam(camera).R
    np.testing.assert_allclose(R @ [0, 0, 1], [0, 1, 0], atol=1e-15)  # looks to the right wing
    np.testing.assert_allclose(R @ [1, 0, 0], [0, 0, 1], atol=1e-15)  # rolled: right in the picture is down
