"""The pose solvers beside OpenCV's and PoseLib's, which know nothing of ours."""

import cv2
import numpy as np
import poselib
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pose_scenes import FOCAL_PX, ahead, angle_rad, scene

from companion.geometry import SE3, exp_so3
from companion.vision.depth_iteration import solve_depth_iteration
from companion.vision.glsdc import solve_glsdc
from companion.vision.lhm import rms_object_error, solve_lhm, solve_lhm_minima

SEEDS = st.integers(0, 2**32 - 1)
CAMERA = {"model": "SIMPLE_PINHOLE", "width": 1280, "height": 960, "params": [1.0, 0.0, 0.0]}
CLOUD = {"n": 9, "thick_m": 4.0}


def by_opencv(points, uv, name):
    """Return OpenCV's pose by one of its methods."""
    flag = getattr(cv2, f"SOLVEPNP_{name}")
    found, rotation, t = cv2.solvePnP(points, uv, np.eye(3), None, flags=flag)
    assert found
    return SE3(cv2.Rodrigues(rotation)[0], t[:, 0])


def picture(points, T):
    q = T.transform(points)
    return q[:, :2] / q[:, 2:]


def image_error(points, uv, T):
    return np.sqrt(np.sum((picture(points, T) - uv) ** 2) / len(uv))


@pytest.mark.parametrize("name", ["SQPNP", "EPNP", "ITERATIVE"])
@given(seed=SEEDS)
def test_clean_pictures_give_opencvs_pose(name, seed):
    s = scene(np.random.default_rng(seed), **CLOUD)
    uv = picture(s.points, s.T)
    theirs = by_opencv(s.points, uv, name)
    if image_error(s.points, uv, theirs) > 1e-6:  # EPNP and ITERATIVE have misses of their own
        assert name != "SQPNP"
        return
    near = exp_so3(np.full(3, 0.02)) @ s.T.R
    for ours in (
        solve_lhm(s.points, uv, tol=1e-9, epsilon=1e-15),
        solve_lhm(s.points, uv, near, tol=1e-9, epsilon=1e-15),
        solve_lhm(s.points, uv, near, tol=1e-9, epsilon=1e-15, method="quaternion"),
        solve_glsdc(s.points, uv, SE3(near, s.T.t * 1.02), iterations=10),
        solve_depth_iteration(s.points, uv, 2, s.T.transform(s.points)[:, 2] * 1.02, tol=1e-10, iterations=20000),
    ):
        assert angle_rad(ours.T_cam_tanker.R, theirs.R) < 1e-3
        np.testing.assert_allclose(ours.T_cam_tanker.t, theirs.t, atol=1e-3 * s.T.t[2])


@given(SEEDS)
def test_noisy_pictures_give_sqpnps_minimum_or_a_lower_one(seed):
    """SQPNP minimises the object-space error over rotations too: the cold start is its equal."""
    s = scene(np.random.default_rng(seed))
    theirs = by_opencv(s.points, s.uv, "SQPNP")
    ours = solve_lhm(s.points, s.uv)
    if ahead(theirs, s.points):
        assert ours.converged
        assert ours.object_error <= 1.001 * rms_object_error(s.points, s.uv, theirs) + 1e-6


@given(SEEDS)
def test_glsdc_rests_where_poselibs_bundle_adjustment_does(seed):
    rng = np.random.default_rng(seed)
    s = scene(rng, **CLOUD)
    uv = picture(s.points, s.T) + rng.normal(0.0, 1.0 / FOCAL_PX, (9, 2))
    T0 = SE3(exp_so3(rng.normal(0, 0.01, 3)) @ s.T.R, s.T.t * rng.uniform(0.98, 1.02))
    start = poselib.CameraPose()
    start.R, start.t = T0.R, T0.t
    options = {"loss_type": "TRIVIAL", "max_iterations": 100, "gradient_tol": 1e-14, "step_tol": 1e-14}
    pose, _ = poselib.refine_absolute_pose(uv, s.points, start, CAMERA, options)
    ours = solve_glsdc(s.points, uv, T0, iterations=20)
    assert ours.converged
    assert angle_rad(ours.T_cam_tanker.R, pose.R) < 1e-5
    np.testing.assert_allclose(ours.T_cam_tanker.t, pose.t, atol=1e-4 * s.T.t[2])


@given(SEEDS)
def test_what_fits_three_points_exactly_is_among_the_poses_of_p3p(seed):
    s = scene(np.random.default_rng(seed), n=3, thick_m=4.0)
    uv = picture(s.points, s.T)
    rays = np.column_stack([uv, np.ones(3)])
    theirs = poselib.p3p(rays / np.linalg.norm(rays, axis=1)[:, None], s.points)
    for ours in solve_lhm_minima(s.points, uv, tol=1e-12, epsilon=1e-24):
        if ours.object_error < 1e-9:
            assert min(np.linalg.norm(ours.T_cam_tanker.R - pose.R) for pose in theirs) < 1e-3


def test_poselibs_whole_chain_agrees_on_clean_and_noisy_scenes():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        s = scene(rng, **CLOUD)
        for noise in (0.0, 0.3 / FOCAL_PX):
            uv = picture(s.points, s.T) + rng.normal(0.0, 1.0, (9, 2)) * noise
            pose, info = poselib.estimate_absolute_pose(uv, s.points, CAMERA, {"max_reproj_error": 0.01, "seed": 0})
            assert info["num_inliers"] == 9
            cold = solve_lhm(s.points, uv)
            ours = solve_glsdc(s.points, uv, cold.T_cam_tanker, iterations=10)
            assert ours.converged
            assert angle_rad(ours.T_cam_tanker.R, pose.R) < 1e-3
            np.testing.assert_allclose(ours.T_cam_tanker.t, pose.t, atol=2e-3 * s.T.t[2])
