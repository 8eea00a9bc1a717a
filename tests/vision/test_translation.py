"""Pose of few markers with the attitude of the INS: right, consistent, and no cliff from nine markers down to two."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2 as chi_square

from companion.geometry import SE3, exp_so3, log_so3, skew
from companion.vision.refinement import pose_covariance, refine_pose
from companion.vision.translation import solve_translation

SEEDS = st.integers(0, 2**32 - 1)
SIGMA = 0.3 / 457


def see(T, points, rng=None, sigma=0.0):
    q = T.transform(points)
    uv = q[:, :2] / q[:, 2:]
    return uv if rng is None else uv + rng.normal(0.0, 1.0, uv.shape) * np.reshape(sigma, (-1, 1))


def some(rng, markers, n):
    return markers[rng.choice(len(markers), n, replace=False)]


def cov_of(sigma_rad):
    return sigma_rad**2 * np.eye(3)


@given(SEEDS, st.integers(2, 9))
def test_the_truth_is_found_from_clean_points_without_a_start(markers, approach_pose, seed, n):
    rng = np.random.default_rng(seed)
    T, points = approach_pose(rng), some(rng, markers, n)
    r = solve_translation(points, see(T, points), T.R, np.full(n, SIGMA), cov_of(0.005))
    assert r.converged
    np.testing.assert_allclose(r.T_cam_tanker.t, T.t, atol=1e-6)
    np.testing.assert_allclose(r.T_cam_tanker.R, T.R, atol=1e-8)
    assert r.chi2 < 1e-6
    assert r.degrees_of_freedom == 2 * n - 3


@settings(max_examples=50)
@given(SEEDS, st.integers(2, 4))
def test_a_sure_attitude_stays_and_its_error_reaches_the_translation_by_the_lever_arm(markers, approach_pose, seed, n):
    """As the covariance of the attitude vanishes t solves the weighted least squares with R given."""
    rng = np.random.default_rng(seed)
    T, points = approach_pose(rng), some(rng, markers, n)
    sigma = SIGMA * rng.uniform(0.5, 2.0, n)
    uv = see(T, points, rng, sigma)
    cov_rotation = 1e-18 * np.diag(rng.uniform(1, 4, 3))
    r = solve_translation(points, uv, T.R, sigma, cov_rotation)
    np.testing.assert_allclose(r.T_cam_tanker.R, T.R, atol=1e-12)
    q = r.T_cam_tanker.transform(points)
    A, B, residual = [], [], []
    for i in range(n):
        J = np.array([[1.0, 0.0, -q[i, 0] / q[i, 2]], [0.0, 1.0, -q[i, 1] / q[i, 2]]]) / q[i, 2]
        A.append(J / sigma[i])
        B.append(-J @ skew(points[i] @ T.R.T) / sigma[i])
        residual.append((uv[i] - q[i, :2] / q[i, 2]) / sigma[i])
    A, B, residual = np.vstack(A), np.vstack(B), np.concatenate(residual)
    step = np.linalg.lstsq(A, residual, rcond=None)[0]
    only_pixels = np.linalg.inv(A.T @ A)
    assert np.all(abs(step) < 1e-3 * np.sqrt(np.diag(only_pixels)))
    lever = -only_pixels @ A.T @ B
    np.testing.assert_allclose(r.cov[3:, 3:], cov_rotation, rtol=1e-6, atol=1e-6 * cov_rotation.max())
    np.testing.assert_allclose(r.cov[:3, :3], only_pixels, rtol=1e-4, atol=1e-6 * only_pixels.max())
    np.testing.assert_allclose(r.cov[:3, 3:], lever @ cov_rotation, rtol=1e-4, atol=1e-6 * abs(lever).max() * 4e-18)


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("sigma_rad", [0.0002, 0.005, 0.02])
def test_few_markers_err_as_the_covariance_says(markers, approach_pose, n, sigma_rad):
    """2000 scenes, any n of the nine markers, an attitude as noisy as told: 6 and 2 n - 3 degrees of freedom."""
    rng = np.random.default_rng(30 + n)
    scenes, errors, fits = 2000, [], []
    for _ in range(scenes):
        T, points = approach_pose(rng), some(rng, markers, n)
        R_ins = exp_so3(rng.normal(0, sigma_rad, 3)).T @ T.R
        r = solve_translation(points, see(T, points, rng, SIGMA), R_ins, np.full(n, SIGMA), cov_of(sigma_rad))
        assert r.converged
        d = np.concatenate([T.t - r.T_cam_tanker.t, log_so3(T.R @ r.T_cam_tanker.R.T)])
        errors.append(d @ np.linalg.solve(r.cov, d))
        fits.append(r.chi2)
    low, high = chi_square.ppf([0.0005, 0.9995], 6 * scenes)
    assert low < np.sum(errors) < high
    low, high = chi_square.ppf([0.0005, 0.9995], (2 * n - 3) * scenes)
    assert low < np.sum(fits) < high


@settings(max_examples=60)
@given(SEEDS, st.floats(1e-4, 0.05))
def test_a_marker_more_never_makes_the_covariance_larger(markers, approach_pose, seed, sigma_rad):
    rng = np.random.default_rng(seed)
    T, points = approach_pose(rng), some(rng, markers, 9)
    sigma = SIGMA * rng.uniform(0.5, 2.0, 9)
    covs = [pose_covariance(points[:n], T, sigma[:n], T.R, cov_of(sigma_rad)) for n in range(2, 10)]
    covs.append(pose_covariance(points, T, sigma, T.R, 0.5 * cov_of(sigma_rad)))
    scale = np.diag(1 / np.sqrt(np.diag(covs[0])))
    for worse, better in pairwise(covs):
        assert np.linalg.eigvalsh(scale @ (worse - better) @ scale).min() > -1e-9
    # The attitude cannot get worse than it was told, and with no attitude to speak of the pose is the free one.
    assert np.linalg.eigvalsh(cov_of(sigma_rad) - covs[0][3:, 3:]).min() > -1e-9 * sigma_rad**2
    free = pose_covariance(points, T, sigma)
    with_any = pose_covariance(points, T, sigma, T.R, cov_of(100.0))
    np.testing.assert_allclose(with_any, free, rtol=1e-4, atol=1e-6 * abs(free).max())


def test_from_five_markers_to_four_the_position_gets_a_little_worse_and_does_not_fall_off(markers, approach_pose):
    """RMS error over 1000 scenes, with the attitude as a measurement throughout: each step by less than the next."""
    rng = np.random.default_rng(40)
    sigma_rad, squared, bound = 0.005, np.zeros(10), np.zeros(10)
    for _ in range(1000):
        T, points = approach_pose(rng), some(rng, markers, 9)
        uv, sigma = see(T, points, rng, SIGMA), np.full(9, SIGMA)
        R_ins = exp_so3(rng.normal(0, sigma_rad, 3)).T @ T.R
        for n in range(2, 10):
            r = solve_translation(points[:n], uv[:n], R_ins, sigma[:n], cov_of(sigma_rad))
            squared[n] += np.sum((r.T_cam_tanker.t - T.t) ** 2)
            bound[n] += np.trace(r.cov[:3, :3])
    rms = np.sqrt(squared[2:] / 1000)
    assert np.all(np.diff(rms) < 0)
    np.testing.assert_allclose(rms, np.sqrt(bound[2:] / 1000), rtol=0.1)
    assert rms[2] < 1.3 * rms[3]  # four against five markers


def test_with_all_markers_it_is_the_refinement_with_that_attitude(markers, approach_pose):
    rng = np.random.default_rng(41)
    T, sigma = approach_pose(rng), np.full(9, SIGMA)
    uv = see(T, markers, rng, sigma)
    R_ins = exp_so3(rng.normal(0, 0.01, 3)) @ T.R
    a = solve_translation(markers, uv, R_ins, sigma, cov_of(0.01))
    b = refine_pose(markers, uv, T, sigma, R_ins, cov_of(0.01))
    np.testing.assert_allclose(a.T_cam_tanker.t, b.T_cam_tanker.t, atol=1e-4 * np.sqrt(b.cov[2, 2]))
    np.testing.assert_allclose(a.cov, b.cov, rtol=1e-4, atol=1e-4 * b.cov.max())


@pytest.mark.parametrize("n", [0, 1])
def test_one_marker_or_none_is_refused(markers, n):
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    with pytest.raises(ValueError, match="at least 2 markers with an attitude"):
        solve_translation(markers[:n], see(T, markers[:n]), T.R, np.full(n, SIGMA), cov_of(0.01))


@pytest.mark.parametrize("n", [2, 3, 4, 9])
def test_degenerate_markers_are_named(markers, n):
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    sigma, uv = np.full(n, SIGMA), see(T, markers[:n])
    with pytest.raises(ValueError, match="same ray"):
        solve_translation(markers[:n], np.full((n, 2), 0.1), T.R, sigma, cov_of(0.01))
    with pytest.raises(ValueError, match="at one place"):
        solve_translation(np.ones((n, 3)), uv, T.R, sigma, cov_of(0.01))
    with pytest.raises(ValueError, match="finite"):
        solve_translation(markers[:n], uv * np.nan, T.R, sigma, cov_of(0.01))
    with pytest.raises(ValueError, match="sigma"):
        solve_translation(markers[:n], uv, T.R, 0 * sigma, cov_of(0.01))
    with pytest.raises(ValueError, match="positive definite"):
        solve_translation(markers[:n], uv, T.R, sigma, cov_of(0.0))


def test_markers_seen_mirrored_give_no_pose(markers):
    """A picture that only markers behind the camera could make."""
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    r = solve_translation(markers[:4], -see(T, markers[:4]), T.R, np.full(4, SIGMA), cov_of(0.01))
    assert not r.converged
    assert r.nearest_m < 0
