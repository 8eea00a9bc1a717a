"""Refinement by maximum likelihood: its Jacobians, its minimum, its covariance, its residuals, and bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi_square

from companion.geometry import SE3, exp_so3, log_so3
from companion.vision.refinement import pose_covariance, refine_pose
from companion.vision.refinement_kernel import project_marker
from companion.vision.small_systems import attitude_error

SEEDS = st.integers(0, 2**32 - 1)
SIGMA = 0.3 / 457


def see(T, points, rng=None, sigma=0.0):
    q = T.transform(points)
    uv = q[:, :2] / q[:, 2:]
    return uv if rng is None else uv + rng.normal(0.0, 1.0, uv.shape) * np.reshape(sigma, (-1, 1))


def moved(T, d):
    return SE3(exp_so3(d[3:]) @ T.R, T.t + d[:3])


def difference(T_true, T):
    """Return the move d (6,) that brings T to T_true."""
    return np.concatenate([T_true.t - T.t, log_so3(T_true.R @ T.R.T)])


def whitened(points, uv, T, sigma, R_prior=None, cov_rotation=None):
    """Return the residuals of unit variance whose squares sum up to chi2: the oracle, in plain numpy."""
    r = ((uv - see(T, points)) / sigma[:, None]).ravel()
    if R_prior is None:
        return r
    return np.concatenate([r, np.linalg.solve(np.linalg.cholesky(cov_rotation), log_so3(T.R @ R_prior.T))])


def numeric_jacobian(f, h=1e-6):
    return np.column_stack([(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(6)])


def attitude(rng, T, sigma_rad):
    """Draw a covariance about that wide and a measured attitude with such an error."""
    root = sigma_rad * (np.eye(3) + 0.3 * rng.normal(size=(3, 3)))
    return exp_so3(root @ rng.normal(size=3)).T @ T.R, root @ root.T


@given(SEEDS)
def test_jacobians_are_those_by_differences(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, _ = any_scene(rng, 0.0)
    J = np.empty((2, 6))
    u, v, depth = project_marker(points[0], T.R, T.t, J)
    np.testing.assert_allclose([u, v, depth], [*see(T, points[:1])[0], T.transform(points)[0, 2]], rtol=1e-12)
    numeric = numeric_jacobian(lambda d: see(moved(T, d), points[:1])[0])
    np.testing.assert_allclose(J, numeric, atol=1e-7 * abs(numeric).max())

    R_prior = exp_so3(rng.normal(0, rng.choice([1e-9, 1e-5, 0.01, 1.0]), 3)) @ T.R
    if np.linalg.norm(log_so3(T.R @ R_prior.T)) < 2.8:
        e, A = np.empty(3), np.empty((3, 3))
        assert attitude_error(T.R, R_prior, e, A)
        np.testing.assert_allclose(e, log_so3(T.R @ R_prior.T), atol=1e-12)
        numeric = numeric_jacobian(lambda d: log_so3(exp_so3(d[3:]) @ T.R @ R_prior.T))[:, 3:]
        np.testing.assert_allclose(A, numeric, atol=1e-7 * abs(numeric).max())


@settings(max_examples=40)
@given(SEEDS, st.booleans())
def test_it_finds_the_minimum_and_covariance_that_scipy_finds(any_scene, seed, with_attitude):
    rng = np.random.default_rng(seed)
    T, points, clean = any_scene(rng, 0.0)
    sigma = SIGMA * rng.uniform(0.5, 4.0, len(points))
    uv = clean + rng.normal(size=clean.shape) * sigma[:, None]
    prior = attitude(rng, T, 0.005) if with_attitude else (None, None)
    T0 = moved(T, np.concatenate([rng.normal(0, 0.5, 3), rng.normal(0, 0.01, 3)]))
    ours = refine_pose(points, uv, T0, sigma, *prior)

    def residuals(d, about=ours.T_cam_tanker):
        return whitened(points, uv, moved(about, d), sigma, *prior)

    theirs = least_squares(residuals, np.zeros(6), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert ours.converged
    assert ours.chi2 == pytest.approx(2 * theirs.cost, rel=1e-6)
    J = numeric_jacobian(residuals)
    deviations = np.sqrt(np.diag(ours.cov))
    assert np.all(abs(theirs.x) < 1e-3 * deviations)
    np.testing.assert_allclose(ours.cov, np.linalg.inv(J.T @ J), atol=1e-5 * np.outer(deviations, deviations).max())
    correlation = ours.cov @ (J.T @ J)
    np.testing.assert_allclose(correlation, np.eye(6), atol=1e-3)
    assert ours.degrees_of_freedom == len(residuals(np.zeros(6))) - 6


@settings(max_examples=50)
@given(SEEDS)
def test_residuals_image_error_and_depth_are_those_of_the_pose(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, SIGMA)
    sigma = SIGMA * rng.uniform(0.5, 2.0, len(points))
    r = refine_pose(points, uv, T, sigma)
    squared = np.sum((uv - see(r.T_cam_tanker, points)) ** 2, axis=1)
    np.testing.assert_allclose(r.squared_residuals, squared / sigma**2, rtol=1e-9)
    assert r.chi2 == pytest.approx(r.squared_residuals.sum(), rel=1e-12)
    assert r.image_error == pytest.approx(np.sqrt(squared.mean()), rel=1e-9)
    assert r.nearest_m == pytest.approx(r.T_cam_tanker.transform(points)[:, 2].min(), rel=1e-12)
    np.testing.assert_allclose(r.T_cam_tanker.R @ r.T_cam_tanker.R.T, np.eye(3), atol=1e-13)


@settings(max_examples=50)
@given(SEEDS)
def test_a_far_start_descends_and_never_ends_higher(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, SIGMA)
    sigma = np.full(len(points), SIGMA)
    T0 = moved(T, np.concatenate([rng.normal(0, 0.15 * T.t[2], 3), rng.normal(0, 0.4, 3)]))
    r = refine_pose(points, uv, T0, sigma)
    if (T0.transform(points)[:, 2] > 0).all():
        assert r.chi2 <= np.sum(whitened(points, uv, T0, sigma) ** 2) * (1 + 1e-9)
        assert r.nearest_m > 0
    else:
        assert not r.converged
        assert r.nearest_m <= 0
        assert np.isnan(r.cov).all()


def test_it_is_reached_from_everywhere_that_an_approach_can_be_off(markers, approach_pose):
    """Up to five metres and ten degrees off per axis, far more than GPS and INS are: 500 of 500."""
    rng = np.random.default_rng(20)
    sigma = np.full(len(markers), SIGMA)
    for _ in range(500):
        T = approach_pose(rng)
        uv = see(T, markers, rng, sigma)
        best = refine_pose(markers, uv, T, sigma)
        off = refine_pose(markers, uv, moved(T, rng.uniform(-1, 1, 6) * [5, 5, 5, 0.17, 0.17, 0.17]), sigma)
        assert off.converged
        assert off.chi2 == pytest.approx(best.chi2, rel=1e-6)


@settings(max_examples=50)
@given(SEEDS)
def test_it_turns_with_the_camera_scales_with_the_scene_and_does_not_mind_the_order(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, SIGMA)
    sigma = SIGMA * rng.uniform(0.5, 2.0, len(points))
    r = refine_pose(points, uv, T, sigma)
    deviations = np.sqrt(np.diag(r.cov))

    def same(other, M, T_expected):
        assert np.all(abs(difference(T_expected, other.T_cam_tanker)) < 1e-3 * np.sqrt(np.diag(other.cov)))
        expected = M @ r.cov @ M.T
        np.testing.assert_allclose(other.cov, expected, atol=1e-5 * abs(expected).max())
        assert other.chi2 == pytest.approx(r.chi2, rel=1e-6)

    Z = exp_so3(np.array([0.0, 0.0, rng.uniform(-3, 3)]))
    rolled = refine_pose(points, uv @ Z[:2, :2].T, SE3(Z @ T.R, Z @ T.t), sigma)
    same(rolled, np.kron(np.eye(2), Z), SE3(Z @ r.T_cam_tanker.R, Z @ r.T_cam_tanker.t))

    larger = refine_pose(10 * points, uv, SE3(T.R, 10 * T.t), sigma)
    same(larger, np.diag([10.0] * 3 + [1.0] * 3), SE3(r.T_cam_tanker.R, 10 * r.T_cam_tanker.t))

    order = rng.permutation(len(points))
    shuffled = refine_pose(points[order], uv[order], T, sigma[order])
    same(shuffled, np.eye(6), r.T_cam_tanker)
    np.testing.assert_allclose(shuffled.studentised, r.studentised[order], rtol=1e-3, atol=1e-3)

    louder = refine_pose(points, uv, T, 7 * sigma)
    np.testing.assert_allclose(louder.cov, 49 * r.cov, atol=1e-3 * 49 * np.outer(deviations, deviations).max())


@settings(max_examples=50)
@given(SEEDS)
def test_other_axes_of_the_tanker_give_the_same_pose_with_the_covariance_carried_over(any_scene, seed):
    rng = np.random.default_rng(seed)
    T, points, uv = any_scene(rng, SIGMA)
    sigma = np.full(len(points), SIGMA)
    r = refine_pose(points, uv, T, sigma)
    T_tanker_new = SE3(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, 5, 3))
    new = refine_pose(T_tanker_new.inverse().transform(points), uv, T @ T_tanker_new, sigma)
    expected = r.T_cam_tanker @ T_tanker_new
    assert np.all(abs(difference(expected, new.T_cam_tanker)) < 1e-3 * np.sqrt(np.diag(new.cov)))
    carry = numeric_jacobian(lambda d: difference(moved(r.T_cam_tanker, d) @ T_tanker_new, expected), h=1e-5)
    wanted = carry @ r.cov @ carry.T
    np.testing.assert_allclose(new.cov, wanted, atol=1e-4 * abs(wanted).max())


def test_a_marker_that_says_nothing_is_as_good_as_none(markers, approach_pose):
    rng = np.random.default_rng(21)
    T = approach_pose(rng)
    sigma = np.full(len(markers), SIGMA)
    uv = see(T, markers, rng, sigma)
    uv[4] += 0.5
    sigma[4] = 1e6
    keep = np.arange(len(markers)) != 4
    a, b = refine_pose(markers, uv, T, sigma), refine_pose(markers[keep], uv[keep], T, sigma[keep])
    np.testing.assert_allclose(a.cov, b.cov, rtol=1e-5)
    assert np.all(abs(difference(a.T_cam_tanker, b.T_cam_tanker)) < 1e-3 * np.sqrt(np.diag(b.cov)))


def test_the_covariance_alone_is_that_of_a_pose_seen_without_noise(markers, approach_pose):
    rng = np.random.default_rng(22)
    T, sigma = approach_pose(rng), SIGMA * rng.uniform(0.5, 2.0, len(markers))
    for prior in ((None, None), (T.R, np.diag([1e-5, 2e-5, 4e-5]))):
        r = refine_pose(markers, see(T, markers), moved(T, np.full(6, 1e-3)), sigma, *prior)
        np.testing.assert_allclose(pose_covariance(markers, T, sigma, *prior), r.cov, rtol=1e-6, atol=1e-12)
        assert r.chi2 < 1e-6


@pytest.mark.parametrize("sigma_rad", [None, 0.003])
def test_nine_markers_err_as_the_covariance_says(markers, approach_pose, sigma_rad):
    """2000 scenes: the normalised squared errors of the pose, chi2 and the residuals are chi-square distributed."""
    rng = np.random.default_rng(23)
    scenes, n = 2000, len(markers)
    errors, fits, studentised = [], [], []
    for _ in range(scenes):
        T = approach_pose(rng)
        sigma = SIGMA * rng.uniform(0.5, 2.0, n)
        prior = (None, None) if sigma_rad is None else attitude(rng, T, sigma_rad)
        r = refine_pose(markers, see(T, markers, rng, sigma), T, sigma, *prior)
        d = difference(T, r.T_cam_tanker)
        errors.append(d @ np.linalg.solve(r.cov, d))
        fits.append(r.chi2)
        studentised.append(r.studentised)
    low, high = chi_square.ppf([0.0005, 0.9995], 6 * scenes)
    assert low < np.sum(errors) < high
    low, high = chi_square.ppf([0.0005, 0.9995], r.degrees_of_freedom * scenes)
    assert low < np.sum(fits) < high
    assert r.degrees_of_freedom == 2 * n - (6 if sigma_rad is None else 3)
    # Each marker by itself; the tail counts for the test of a single marker: 1 % beyond the 99 % quantile.
    low, high = chi_square.ppf([0.0001, 0.9999], 2 * scenes)
    totals = np.sum(studentised, axis=0)
    assert np.all((low < totals) & (totals < high))
    beyond = np.mean(np.array(studentised) > chi_square.ppf(0.99, 2))
    assert beyond == pytest.approx(0.01, abs=0.003)


def test_studentised_is_what_chi2_falls_by_when_the_marker_is_left_out(markers, approach_pose):
    rng = np.random.default_rng(24)
    sigma = np.full(len(markers), SIGMA / 100)  # so little noise that second order does not count
    for _ in range(20):
        T = approach_pose(rng)
        uv = see(T, markers, rng, sigma)
        r = refine_pose(markers, uv, T, sigma)
        for i in range(len(markers)):
            k = np.arange(len(markers)) != i
            without = refine_pose(markers[k], uv[k], T, sigma[k])
            assert r.chi2 - without.chi2 == pytest.approx(r.studentised[i], rel=1e-2, abs=1e-2)


def test_a_wrong_marker_is_the_one_with_the_largest_studentised_residual(markers, approach_pose):
    rng = np.random.default_rng(25)
    sigma = np.full(len(markers), SIGMA)
    found = plain = 0
    for _ in range(500):
        T = approach_pose(rng)
        uv = see(T, markers, rng, sigma)
        wrong, direction = rng.integers(len(markers)), rng.uniform(0, 2 * np.pi)
        uv[wrong] += 12 * SIGMA * np.array([np.cos(direction), np.sin(direction)])
        r = refine_pose(markers, uv, T, sigma)
        found += int(np.argmax(r.studentised)) == wrong
        plain += int(np.argmax(r.squared_residuals)) == wrong
    assert found >= 495
    assert found > plain


def test_three_markers_have_no_redundancy_and_four_cannot_tell_which_is_wrong(markers, approach_pose):
    rng = np.random.default_rng(26)
    T = approach_pose(rng)
    few = markers[[0, 3, 4, 7]]
    uv = see(T, few, rng, SIGMA / 10)
    three = refine_pose(few[:3], uv[:3], T, np.full(3, SIGMA))
    assert np.isnan(three.studentised).all()
    assert three.chi2 < 1e-6
    assert three.degrees_of_freedom == 0
    four = refine_pose(few, uv, T, np.full(4, SIGMA))
    np.testing.assert_allclose(four.studentised, four.chi2, rtol=1e-2)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"points_tanker": np.zeros((9, 2))}, r"points_tanker must be \(n, 3\)"),
        ({"uv": np.zeros((8, 2))}, r"uv \(n, 2\)"),
        ({"sigma": np.ones(8)}, r"sigma \(n,\)"),
        ({"sigma": np.zeros(9)}, "sigma must be positive"),
        ({"sigma": np.full(9, -1.0)}, "sigma must be positive"),
        ({"sigma": np.full(9, np.nan)}, "finite"),
        ({"uv": np.full((9, 2), np.inf)}, "finite"),
        ({"points_tanker": np.full((9, 3), np.nan)}, "finite"),
        ({"T_init": SE3(np.eye(3), np.array([0.0, np.nan, 30.0]))}, "finite"),
        ({"T_init": SE3(np.diag([1.0, 1.0, -1.0]), np.array([0.0, 0.0, 30.0]))}, "rotation"),
        ({"T_init": SE3(1.01 * np.eye(3), np.array([0.0, 0.0, 30.0]))}, "rotation"),
        ({"T_init": SE3(np.eye(2), np.zeros(3))}, r"R \(3, 3\)"),
        ({"R_prior": np.eye(3)}, "go together"),
        ({"R_prior": np.eye(3), "cov_rotation": np.zeros((3, 3))}, "positive definite"),
        ({"R_prior": np.eye(3), "cov_rotation": -np.eye(3)}, "positive definite"),
        ({"R_prior": np.eye(3), "cov_rotation": np.eye(3) + np.eye(3, k=1)}, "symmetric"),
        ({"R_prior": np.eye(3), "cov_rotation": np.eye(2)}, r"\(3, 3\)"),
        ({"R_prior": -np.eye(3), "cov_rotation": np.eye(3)}, "R_prior must be a rotation"),
        ({"points_tanker": np.outer(np.arange(9.0), [1.0, 2.0, 3.0])}, "do not fix a pose"),
        ({"points_tanker": np.ones((9, 3))}, "do not fix a pose"),
    ],
)
def test_bad_input_is_named(markers, change, complaint):
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    good = {"points_tanker": markers, "uv": see(T, markers), "T_init": T, "sigma": np.full(9, SIGMA)}
    with pytest.raises(ValueError, match=complaint):
        refine_pose(**(good | change))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_markers_are_refused(markers, n):
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    with pytest.raises(ValueError, match="at least 3 markers without an attitude"):
        refine_pose(markers[:n], see(T, markers[:n]), T, np.full(n, SIGMA))
    with pytest.raises(ValueError, match="at least 3 markers"):
        pose_covariance(markers[:n], T, np.full(n, SIGMA))
    if n < 2:
        with pytest.raises(ValueError, match="at least 2 markers with an attitude"):
            refine_pose(markers[:n], see(T, markers[:n]), T, np.full(n, SIGMA), T.R, np.eye(3))


def test_markers_behind_the_camera_give_no_pose(markers):
    T = SE3(np.eye(3), np.array([0.0, 0.0, -60.0]))
    r = refine_pose(markers, see(T, markers), T, np.full(9, SIGMA))
    assert not r.converged
    assert r.nearest_m < 0
    with pytest.raises(ValueError, match="not before the camera"):
        pose_covariance(markers, T, np.full(9, SIGMA))


def test_an_attitude_half_a_turn_off_gives_no_pose(markers):
    T = SE3(np.eye(3), np.array([0.0, 0.0, 60.0]))
    half = exp_so3(np.array([0.0, 0.0, np.pi]))
    r = refine_pose(markers, see(T, markers), T, np.full(9, SIGMA), half, 1e-4 * np.eye(3))
    assert not r.converged


@given(SEEDS)
def test_whatever_comes_in_comes_out_as_a_pose_or_a_value_error(seed):
    """Points, pictures and poses of all magnitudes, rows repeated or zero: converged means finite and descended."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 10))
    points = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-12, 12, (1, 3))
    uv = rng.normal(size=(n, 2)) * 10.0 ** rng.uniform(-12, 12)
    points[rng.integers(n)] = points[rng.integers(n)]
    uv[rng.integers(n)] = 0.0
    T0 = SE3(exp_so3(rng.uniform(-3, 3, 3)), rng.normal(size=3) * 10.0 ** rng.uniform(-3, 12))
    sigma = np.full(n, 10.0 ** rng.uniform(-12, 6))
    try:
        r = refine_pose(points, uv, T0, sigma)
    except ValueError:
        return
    if r.converged:
        assert np.isfinite(r.cov).all()
        assert np.isfinite(r.T_cam_tanker.as_matrix()).all()
        assert np.all(np.diag(r.cov) > 0)
        assert r.nearest_m > 0
