import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import CameraConfig
from companion.geometry import SE3, exp_so3
from companion.vision.camera import (
    T_frd_cam,
    distortion_reach_squared,
    normalised_to_pixels,
    pixels_to_normalised,
    project,
)

BARREL = (-0.25, 0.08, 1e-3, -2e-3, 0.01)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BARREL, (0.1, -0.05, 2e-3, 1e-3, 0.0)])
def test_projection_is_that_of_opencv(camera, distortion):
    camera = msgspec.structs.replace(camera, distortion=distortion)
    rng = np.random.default_rng(1)
    T = SE3(exp_so3(rng.normal(0, 0.3, 3)), np.array([1.0, -2.0, 30.0]))
    points = rng.uniform(-9, 9, (60, 3))
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(points, cv2.Rodrigues(T.R)[0], T.t, K, np.array(distortion))
    np.testing.assert_allclose(project(camera, T, points), theirs[:, 0], atol=1e-9)


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
