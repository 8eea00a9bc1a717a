import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_scenes import Listing, scene

from companion.geometry import SE3, exp_so3, log_so3
from companion.vision.lhm import LhmResult, rms_object_error, solve_lhm, weak_perspective_rotation

SEEDS = st.integers(0, 2**32 - 1)
TIGHT = {"tol": 1e-8, "epsilon": 1e-10}


@pytest.mark.parametrize("method", ["svd", "quaternion"])
def test_same_iterates_as_the_listing(markers, approach_pose, method):
    rng = np.random.default_rng(10)
    for noise in np.repeat([0.0, 0.3 / 457, 3.0 / 457], 12):
        T = approach_pose(rng)
        q = T.transform(markers)
        uv = q[:, :2] / q[:, 2:] + rng.normal(0.0, noise, (len(q), 2))
        R0 = exp_so3(rng.normal(0, 0.03, 3)) @ T.R
        R, t, iterations, error = Listing(markers, uv, quaternion=method == "quaternion").solve(R0)
        ours = solve_lhm(markers, uv, R0, method=method)
        assert abs(ours.iterations - iterations) <= 1
        np.testing.assert_allclose(ours.T_cam_tanker.R, R, atol=1e-6)
        if ours.iterations == iterations:
            np.testing.assert_allclose(ours.T_cam_tanker.R, R, atol=1e-10)
            np.testing.assert_allclose(ours.T_cam_tanker.t, t, atol=1e-8)
            assert ours.object_error == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize("method", ["svd", "quaternion"])
def test_same_iterates_as_the_listing_from_weak_perspective(method):
    for seed in range(40):
        s = scene(np.random.default_rng(seed), thick_m=4.0)
        R, _, iterations, error = Listing(s.points, s.uv, quaternion=method == "quaternion").solve(None)
        if iterations > 900:  # ours ends at a thousand
            continue
        ours = solve_lhm(s.points, s.uv, start="weak_perspective", method=method)
        assert abs(ours.iterations - iterations) <= 1
        np.testing.assert_allclose(ours.T_cam_tanker.R, R, atol=1e-6)
        if ours.iterations == iterations:
            assert ours.object_error == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize(("tol", "epsilon"), [(1e-2, 1e-12), (1e-5, 1e-2), (1e-12, 1e-3), (0, 1e-8), (1e-7, 0)])
def test_both_stopping_rules_stop_where_the_listing_stops(markers, approach_pose, tol, epsilon):
    rng = np.random.default_rng(15)
    for _ in range(10):
        T = approach_pose(rng)
        q = T.transform(markers)
        uv = q[:, :2] / q[:, 2:] + rng.normal(0.0, 0.1 / 550, (9, 2)) * (tol != 0)
        R0 = exp_so3(rng.normal(0, 0.05, 3)) @ T.R
        R, _, iterations, _ = Listing(markers, uv).solve(R0, tol, epsilon)
        ours = solve_lhm(markers, uv, R0, tol, epsilon)
        assert abs(ours.iterations - iterations) <= 1
        np.testing.assert_allclose(ours.T_cam_tanker.R, R, atol=1e-6)


@settings(deadline=None)
@given(SEEDS)
def test_a_pose_is_recovered_from_clean_points_warm_and_cold(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, 0.0)
    warm = solve_lhm(points, uv, exp_so3(rng.normal(0, 0.02, 3)) @ T.R, **TIGHT)
    for found in (warm, solve_lhm(points, uv, **TIGHT)):
        np.testing.assert_allclose(found.T_cam_tanker.R, T.R, atol=1e-4)
        np.testing.assert_allclose(found.T_cam_tanker.t, T.t, atol=1e-3 * T.t[2])
        assert found.converged
        assert found.image_error < 1e-5


def test_a_cold_start_is_never_worse_than_sqpnp(any_scene):
    rng = np.random.default_rng(11)
    for _ in range(300):
        _, points, uv = any_scene(rng, 1.0 / 457)
        ours = solve_lhm(points, uv)
        _, rotation, t = cv2.solvePnP(points, uv, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        theirs = rms_object_error(points, uv, SE3(cv2.Rodrigues(rotation)[0], t[:, 0]))
        assert ours.converged
        assert ours.object_error <= theirs * 1.001


@settings(deadline=None, max_examples=50)
@given(SEEDS)
def test_frames_and_order_do_not_matter(any_scene, seed):
    """Turning the tanker's axes, the camera, or the list of markers turns the answer and nothing else."""
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, 0.5 / 457)
    R0 = exp_so3(rng.normal(0, 0.05, 3)) @ T.R
    base = solve_lhm(points, uv, R0)

    S = SE3(exp_so3(rng.normal(0, 1.0, 3)), rng.normal(0, 10.0, 3))  # other axes on the tanker
    order = rng.permutation(len(points))
    moved = solve_lhm(S.transform(points)[order], uv[order], R0 @ S.R.T)
    np.testing.assert_allclose((moved.T_cam_tanker @ S).as_matrix(), base.T_cam_tanker.as_matrix(), atol=1e-6)

    C = exp_so3(rng.normal(0, 0.05, 3))  # the camera looks elsewhere from the same place
    rays = np.column_stack([uv, np.ones(len(uv))]) @ C.T
    turned = solve_lhm(points, rays[:, :2] / rays[:, 2:], C @ R0)
    np.testing.assert_allclose(turned.T_cam_tanker.R, C @ base.T_cam_tanker.R, atol=1e-6)
    np.testing.assert_allclose(turned.T_cam_tanker.t, C @ base.T_cam_tanker.t, atol=1e-6)
    assert turned.object_error == pytest.approx(base.object_error, rel=1e-6)

    large = solve_lhm(10.0 * points, uv, R0, epsilon=1e-6)  # a tanker of ten times the size, ten times as far
    np.testing.assert_allclose(large.T_cam_tanker.t, 10.0 * base.T_cam_tanker.t, atol=1e-6)


@given(SEEDS)
def test_the_result_is_a_proper_rotation_and_the_errors_are_its_own(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, 20.0 / 457)
    found = solve_lhm(points, uv, exp_so3(rng.normal(0, 0.5, 3)) @ T.R)
    R = found.T_cam_tanker.R
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) > 0
    q = found.T_cam_tanker.transform(points)
    image = np.sqrt(np.sum((q[:, :2] / q[:, 2:] - uv) ** 2) / len(uv))
    assert found.image_error == pytest.approx(image, rel=1e-6)
    assert found.object_error == pytest.approx(rms_object_error(points, uv, found.T_cam_tanker), rel=1e-6)
    assert found.converged <= bool((q[:, 2] > 0).all())


def test_the_methods_agree_and_a_far_start_still_arrives(markers, approach_pose):
    """Thesis 7.5.4: the translation's area of convergence is unbounded; here the rotation is off by 0.4 rad too."""
    rng = np.random.default_rng(12)
    for _ in range(20):
        T = approach_pose(rng)
        q = T.transform(markers)
        uv = q[:, :2] / q[:, 2:]
        R0 = exp_so3(0.4 * (a := rng.normal(size=3)) / np.linalg.norm(a)) @ T.R
        for method in ("svd", "quaternion"):
            found = solve_lhm(markers, uv, R0, method=method)
            assert np.linalg.norm(log_so3(found.T_cam_tanker.R @ T.R.T)) < 1e-3


def test_coplanar_and_few_points(markers, approach_pose):
    rng = np.random.default_rng(13)
    T = approach_pose(rng)
    for points in (markers * [1, 1, 0], markers[:4], markers[:3]):
        q = T.transform(points)
        found = solve_lhm(points, q[:, :2] / q[:, 2:], exp_so3(rng.normal(0, 0.01, 3)) @ T.R, **TIGHT)
        np.testing.assert_allclose(found.T_cam_tanker.t, T.t, atol=1e-2)


def test_the_weak_perspective_start_of_the_thesis_is_near_for_a_far_tanker(markers, approach_pose):
    rng = np.random.default_rng(14)
    T = SE3(approach_pose(rng).R, np.array([3.0, -2.0, 300.0]))
    q = T.transform(markers)
    R = weak_perspective_rotation(markers, q[:, :2] / q[:, 2:])
    assert np.linalg.det(R) == pytest.approx(1.0)
    found = solve_lhm(markers, q[:, :2] / q[:, 2:], R, **TIGHT)
    np.testing.assert_allclose(found.T_cam_tanker.R, T.R, atol=1e-3)


LINE = np.outer(np.arange(5.0), [1.0, 2.0, 0.5])
CLOUD = np.array([[0.0, 0, 0], [5, 0, 0], [0, 5, 0], [0, 0, 5], [3, 3, 1]])
SEEN = CLOUD[:, :2] / 40.0


@pytest.mark.parametrize(
    ("points", "uv", "R0", "says"),
    [
        (CLOUD[:2], SEEN[:2], None, "at least 3 points"),
        (CLOUD, SEEN[:4], None, r"must be \(n, 3\)"),
        (CLOUD[:, :2], SEEN, None, r"must be \(n, 3\)"),
        (CLOUD, np.full((5, 2), np.nan), None, "finite"),
        (CLOUD, np.full((5, 2), np.nan), np.eye(3), "finite"),
        (CLOUD + np.inf, SEEN, np.eye(3), "finite"),
        (CLOUD, SEEN, np.full((3, 3), np.nan), "finite"),
        (CLOUD, SEEN, np.diag([1.0, 1.0, -1.0]), "rotation"),
        (CLOUD, SEEN, np.eye(4), "rotation"),
        (LINE, SEEN, np.eye(3), "on one line"),
        (CLOUD, np.full((5, 2), 0.1), np.eye(3), "same point"),
    ],
)
def test_what_cannot_be_solved_is_refused_in_words(points, uv, R0, says):
    with pytest.raises(ValueError, match=says):
        solve_lhm(points, uv, R0)


def test_an_unknown_method_is_refused():
    with pytest.raises(ValueError, match="'svd' or 'quaternion'"):
        solve_lhm(CLOUD, SEEN, np.eye(3), method="SVD")


def test_an_unknown_start_is_refused():
    with pytest.raises(ValueError, match="'global' or 'weak_perspective'"):
        solve_lhm(CLOUD, SEEN, start="anywhere")


def test_lists_integers_and_other_layouts_are_taken():
    points, seen, R = CLOUD.tolist(), np.asfortranarray(SEEN), np.eye(3, dtype=np.float32).T
    assert solve_lhm(points, seen, R).iterations == solve_lhm(CLOUD, SEEN, np.eye(3)).iterations
    assert solve_lhm(CLOUD.astype(int), SEEN, np.eye(3, dtype=int)).iterations > 0


def test_results_are_frozen_and_whole():
    found = solve_lhm(CLOUD, SEEN, np.eye(3))
    assert list(dataclasses.asdict(found)) == [field.name for field in dataclasses.fields(LhmResult)]
    assert isinstance(found.T_cam_tanker, SE3)
    assert (type(found.iterations), type(found.object_error), type(found.converged)) == (int, float, bool)
    for thing, field in ((found, "converged"), (found.T_cam_tanker, "R")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(thing, field, None)
    again = solve_lhm(CLOUD, SEEN, np.eye(3))
    assert not np.shares_memory(found.T_cam_tanker.R, again.T_cam_tanker.R)
