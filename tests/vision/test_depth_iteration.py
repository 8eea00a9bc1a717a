from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_scenes import angle_rad, scene
from scipy.spatial.transform import Rotation

from companion.geometry import SE3, exp_so3
from companion.vision.absolute_orientation import absolute_orientation
from companion.vision.depth_iteration import solve_depth_iteration
from companion.vision.lhm import solve_lhm

SEEDS = st.integers(0, 2**32 - 1)
METHODS = pytest.mark.parametrize("method", [1, 2])


def in_sight(markers, T, rng, noise_px=0.0):
    q = T.transform(markers)
    return q[:, :2] / q[:, 2:] + rng.normal(0.0, noise_px / 550, (len(markers), 2))


def by_the_text(points, uv, d, method, iterations, exponent=0.5, size_of_pose=False):
    """Thesis eq. 5.30 to 5.35 in numpy with scipy's rotation; depths after so many iterations."""
    v = np.column_stack([uv, np.ones(len(uv))])
    for _ in range(iterations):
        q = d[:, None] * v
        R = Rotation.align_vectors(q - q.mean(axis=0), points - points.mean(axis=0))[0].as_matrix()
        x = (points - points.mean(axis=0)) @ R.T + q.mean(axis=0)
        if method == 2:
            d = np.einsum("ij,ij->i", x, v) / np.einsum("ij,ij->i", v, v)
        else:
            Dy, Dx = (np.sum((a - a.mean(axis=0)) ** 2) for a in (points, x if size_of_pose else q))
            d = (Dy / Dx) ** exponent * x[:, 2]
    return d


@METHODS
@pytest.mark.parametrize("kernel", ["svd", "quaternion"])
def test_the_iterates_are_those_of_the_text(method, kernel):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        s = scene(rng, thick_m=4.0)
        d = rng.uniform(20.0, 40.0, len(s.points))
        for iterations in (1, 2, 7):
            found = solve_depth_iteration(
                s.points, s.uv, method, d, iterations=iterations, tol=0.0, kernel=kernel
            ).depth_m  # fmt: skip
            np.testing.assert_allclose(found, by_the_text(s.points, s.uv, d, method, iterations), rtol=1e-6)


def test_method_1_as_printed_cannot_find_the_depth(markers, approach_pose):
    """Why ours differs: a size that never changes moves nothing, a ratio of squares goes to and fro."""
    rng = np.random.default_rng(1)
    T = approach_pose(rng)
    uv, z = in_sight(markers, T, rng), T.transform(markers)[:, 2].mean()
    start = np.full(len(markers), 0.5 * z)
    stuck = by_the_text(markers, uv, start, 1, 500, size_of_pose=True)
    assert stuck.mean() == pytest.approx(0.5 * z, rel=1e-6)
    swinging = [by_the_text(markers, uv, start, 1, k, exponent=1.0).mean() / z for k in range(1, 7)]
    assert min(swinging[0::2]) > 1.5
    assert max(swinging[1::2]) < 0.7
    assert swinging[4] > swinging[2] > swinging[0]
    assert by_the_text(markers, uv, start, 1, 500).mean() == pytest.approx(z, rel=1e-4)


@METHODS
@settings(max_examples=50)
@given(seed=SEEDS, far=st.floats(0.7, 1.4))
def test_a_clean_pose_is_recovered_from_a_reasonable_depth(markers, approach_pose, method, seed, far):
    """From the same depth for all it may also end in the mirrored minimum, as weak perspective does."""
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    uv, z = in_sight(markers, T, rng), T.transform(markers)[:, 2]
    found = solve_depth_iteration(markers, uv, method, far * z, iterations=20000, tol=1e-10)
    assert found.converged
    np.testing.assert_allclose(found.T_cam_tanker.t, T.t, atol=1e-3)
    np.testing.assert_allclose(found.T_cam_tanker.R, T.R, atol=1e-4)
    np.testing.assert_allclose(found.depth_m, z, atol=1e-3)
    assert found.image_error < 1e-5


@METHODS
@given(seed=SEEDS)
def test_the_truth_is_a_resting_point(method, seed):
    s = scene(np.random.default_rng(seed), thick_m=3.0)
    q = s.T.transform(s.points)
    found = solve_depth_iteration(s.points, q[:, :2] / q[:, 2:], method, q[:, 2], iterations=3)
    np.testing.assert_allclose(found.T_cam_tanker.R, s.T.R, atol=1e-6)
    np.testing.assert_allclose(found.depth_m, q[:, 2], rtol=1e-7)
    assert found.object_error < 1e-6
    assert found.converged


@settings(max_examples=50)
@given(SEEDS)
def test_the_error_of_method_2_never_grows(seed):
    """Thesis eq. 5.40, with any weights, from any depths."""
    rng = np.random.default_rng(seed)
    s = scene(rng)
    w, d = rng.uniform(0.1, 3.0, len(s.points)), rng.uniform(5.0, 100.0, len(s.points))
    errors = [
        solve_depth_iteration(s.points, s.uv, 2, d, w, iterations=k, tol=0.0).object_error for k in range(1, 30)
    ]  # fmt: skip
    assert all(b <= a * (1 + 1e-9) + 1e-9 for a, b in pairwise(errors))


def test_method_2_rests_where_lhm_does(markers, approach_pose):
    rng = np.random.default_rng(2)
    for _ in range(10):
        T = approach_pose(rng)
        uv = in_sight(markers, T, rng, noise_px=1.0)
        lhm = solve_lhm(markers, uv, tol=1e-10, epsilon=1e-16)
        found = solve_depth_iteration(markers, uv, iterations=20000, tol=1e-11)
        assert found.converged
        assert angle_rad(found.T_cam_tanker.R, lhm.T_cam_tanker.R) < 1e-5
        np.testing.assert_allclose(found.T_cam_tanker.t, lhm.T_cam_tanker.t, atol=1e-3)
        assert found.object_error == pytest.approx(lhm.object_error, rel=1e-6)
        assert found.iterations > 3 * solve_lhm(markers, uv, exp_so3(np.array([0.02, -0.02, 0.02])) @ T.R).iterations


@METHODS
def test_a_weight_of_zero_takes_a_marker_out(markers, approach_pose, method):
    rng = np.random.default_rng(3)
    T = approach_pose(rng)
    uv = in_sight(markers, T, rng, noise_px=0.5)
    without = solve_depth_iteration(np.delete(markers, 4, axis=0), np.delete(uv, 4, axis=0), method)
    uv[4] += 0.1
    found = solve_depth_iteration(markers, uv, method, weights=np.where(np.arange(9) == 4, 0.0, 3.0))
    np.testing.assert_allclose(found.T_cam_tanker.as_matrix(), without.T_cam_tanker.as_matrix(), atol=1e-4)


def test_the_pose_is_the_absolute_orientation_to_the_places(markers, approach_pose):
    rng = np.random.default_rng(4)
    T = approach_pose(rng)
    uv, w, d = in_sight(markers, T, rng, 1.0), rng.uniform(0.5, 2.0, 9), rng.uniform(30, 50, 9)
    found = solve_depth_iteration(markers, uv, depth_init_m=d, weights=w, iterations=1)
    places = d[:, None] * np.column_stack([uv, np.ones(9)])
    direct = absolute_orientation(markers, places, weights=w)
    np.testing.assert_allclose(found.T_cam_tanker.as_matrix(), direct.as_matrix(), atol=1e-9)
    off = direct.transform(markers) - places
    assert found.object_error == pytest.approx(np.sqrt(w @ np.sum(off**2, axis=1) / w.sum()), rel=1e-9)
    assert not found.converged


def test_wrong_input_is_refused_in_words(markers, approach_pose):
    rng = np.random.default_rng(5)
    T = approach_pose(rng)
    uv = in_sight(markers, T, rng)
    refused = [
        ({"method": 3}, "1 or 2"),
        ({"depth_init_m": -1.0}, "above zero"),
        ({"depth_init_m": np.ones(4)}, r"\(9,\)"),
        ({"depth_init_m": np.inf}, "finite"),
        ({"weights": np.ones((9, 2))}, r"weights must be \(9,\)"),
        ({"weights": np.r_[1.0, 1.0, np.zeros(7)]}, "at least 3 points"),
        ({"weights": np.zeros(9)}, "at least 3 points"),
        ({"iterations": 0}, "at least 1"),
        ({"kernel": "QTN"}, "'svd' or 'quaternion'"),
    ]
    for arguments, says in refused:
        with pytest.raises(ValueError, match=says):
            solve_depth_iteration(markers, uv, **arguments)
    assert isinstance(solve_depth_iteration(markers, uv).T_cam_tanker, SE3)
