"""Laws of rotations and rigid transforms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from companion.geometry import (
    SE3,
    R_cam_crf,
    euler_from_rotation,
    exp_so3,
    log_so3,
    quaternion_from_rotation,
    rotation_from_euler,
    rotation_from_quaternion,
    skew,
)

CLOSE = {"rtol": 0.0, "atol": 1e-9}


def vectors(limit: float) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, 3, elements=st.floats(-limit, limit, allow_subnormal=False))


rotations = vectors(3.0).map(exp_so3)
transforms = st.builds(SE3, rotations, vectors(100.0))
yaws = st.floats(-math.pi + 1e-6, math.pi - 1e-6)
pitches = st.floats(-math.pi / 2 + 1e-3, math.pi / 2 - 1e-3)


def assert_same(a: SE3, b: SE3) -> None:
    np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), **CLOSE)


@given(transforms, transforms)
def test_composition_stays_a_rigid_transform(a: SE3, b: SE3) -> None:
    R = (a @ b).R
    np.testing.assert_allclose(R @ R.T, np.eye(3), **CLOSE)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(transforms)
def test_identity_changes_nothing(a: SE3) -> None:
    assert_same(a @ SE3.identity(), a)
    assert_same(SE3.identity() @ a, a)


@given(transforms)
def test_inverse_undoes_on_both_sides(a: SE3) -> None:
    assert_same(a @ a.inverse(), SE3.identity())
    assert_same(a.inverse() @ a, SE3.identity())


@given(transforms, transforms, transforms)
def test_composition_is_associative(a: SE3, b: SE3, c: SE3) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))


@given(transforms, transforms, vectors(50.0))
def test_composition_maps_as_one_after_the_other(T_a_b: SE3, T_b_c: SE3, p_c: np.ndarray) -> None:
    np.testing.assert_allclose((T_a_b @ T_b_c).transform(p_c), T_a_b.transform(T_b_c.transform(p_c)), **CLOSE)


@given(transforms, arrays(np.float64, (4, 3), elements=st.floats(-50, 50)))
def test_rows_of_points_map_like_single_points_and_like_the_matrix(T: SE3, points: np.ndarray) -> None:
    mapped = T.transform(points)
    homogeneous = np.column_stack([points, np.ones(4)])
    np.testing.assert_allclose(mapped, (homogeneous @ T.as_matrix().T)[:, :3], **CLOSE)
    np.testing.assert_allclose(mapped[2], T.transform(points[2]), **CLOSE)


@given(vectors(1.8))
def test_log_is_the_inverse_of_exp_below_a_half_turn(v: np.ndarray) -> None:
    np.testing.assert_allclose(log_so3(exp_so3(v)), v, atol=1e-8, rtol=0)


@given(vectors(30.0))
def test_exp_agrees_with_scipy_at_any_angle(v: np.ndarray) -> None:
    np.testing.assert_allclose(exp_so3(v), Rotation.from_rotvec(v).as_matrix(), **CLOSE)


@given(rotations)
def test_exp_of_log_is_the_rotation(R: np.ndarray) -> None:
    v = log_so3(R)
    assert np.linalg.norm(v) <= math.pi + 1e-12
    np.testing.assert_allclose(exp_so3(v), R, atol=1e-8, rtol=0)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), [[0.6, 0.0, -0.8]]]))
def test_log_holds_at_a_half_turn_and_near_nothing(axis: np.ndarray) -> None:
    half = log_so3(exp_so3(math.pi * axis))
    assert abs(half @ axis) == pytest.approx(math.pi)
    for angle in (1e-7, 1e-9, 1e-14):
        np.testing.assert_allclose(log_so3(exp_so3(angle * axis)), angle * axis, rtol=1e-6, atol=1e-22)


@given(rotations)
def test_quaternion_round_trip_is_unit_with_positive_w(R: np.ndarray) -> None:
    q = quaternion_from_rotation(R)
    assert q[0] >= 0
    assert q @ q == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_from_quaternion(q), R, **CLOSE)
    np.testing.assert_allclose(rotation_from_quaternion(-q), R, **CLOSE)


@given(rotations)
def test_quaternion_is_hamiltons_wxyz(R: np.ndarray) -> None:
    theirs = Rotation.from_matrix(R).as_quat(scalar_first=True)
    assert abs(quaternion_from_rotation(R) @ theirs) == pytest.approx(1.0)


@pytest.mark.parametrize("q", [[math.nan, 0, 0, 0], [math.inf, 0, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0], [0.5, 0, 0, 0]])
def test_quaternion_that_is_none_is_refused(q: list[float]) -> None:
    with pytest.raises(ValueError, match="norm"):
        rotation_from_quaternion(np.array(q))


@given(yaws, pitches, yaws)
def test_euler_round_trip(yaw: float, pitch: float, roll: float) -> None:
    back = euler_from_rotation(rotation_from_euler(yaw, pitch, roll))
    np.testing.assert_allclose(back, (yaw, pitch, roll), **CLOSE)


@given(yaws, pitches, yaws)
def test_euler_is_yaw_then_pitch_then_roll(yaw: float, pitch: float, roll: float) -> None:
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(rotation_from_euler(yaw, pitch, roll), theirs, **CLOSE)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_euler_at_the_pole_gives_the_same_rotation_back(pitch: float) -> None:
    R = rotation_from_euler(0.3, pitch, 0.2)
    yaw, pitch_back, roll = euler_from_rotation(R)
    assert roll == 0.0
    np.testing.assert_allclose(rotation_from_euler(yaw, pitch_back, roll), R, atol=1e-7)


@given(vectors(10.0), vectors(10.0))
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), **CLOSE)


def test_signs_of_the_aerospace_angles() -> None:
    nose_ned = rotation_from_euler(math.pi / 2, 0.1, 0.0) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(nose_ned, [0.0, math.cos(0.1), -math.sin(0.1)], atol=1e-12)  # east and up
    right_wing_ned = rotation_from_euler(0.0, 0.0, 0.1) @ np.array([0.0, 1.0, 0.0])
    assert right_wing_ned[2] > 0  # positive roll: right wing down


def test_thesis_camera_axes_to_optical_axes() -> None:
    forward, right, down = np.eye(3)
    np.testing.assert_array_equal(R_cam_crf @ forward, [0, 0, 1])
    np.testing.assert_array_equal(R_cam_crf @ right, [1, 0, 0])
    np.testing.assert_array_equal(R_cam_crf @ down, [0, 1, 0])
    assert np.linalg.det(R_cam_crf) == pytest.approx(1.0)
