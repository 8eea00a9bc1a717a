import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_scenes import scene

from companion.geometry import SE3, R_cam_crf, euler_from_rotation, exp_so3, rotation_from_euler
from companion.vision.glsdc import solve_glsdc
from companion.vision.glsdc_kernel import attitude, see, solve_spd

SEEDS = st.integers(0, 2**32 - 1)


def seen(points, T, rng, noise_px=0.3):
    q = T.transform(points)
    return q[:, :2] / q[:, 2:] + rng.normal(0.0, noise_px / 457, (len(points), 2))


def near(T, rng, metres=2.0, radians=0.03):
    return SE3(exp_so3(rng.normal(0, radians, 3)) @ T.R, T.t + rng.normal(0, metres, 3))


def image_and_jacobian(points, X):
    """G (n, 2), its Jacobian (2 n, 6) and the smallest depth, marker by marker as the kernel goes."""
    J, rows, seen_at = np.empty((2, 6)), [], []
    for i in range(len(points)):
        seen_at.append(see(points, i, X, *attitude(X), J))
        rows.append(J.copy())
    seen_at = np.array(seen_at)
    return seen_at[:, :2], np.vstack(rows), seen_at[:, 2].min()


@settings(deadline=None)
@given(SEEDS)
def test_the_jacobian_is_the_slope(markers, seed):
    rng = np.random.default_rng(seed)
    X = np.array([rng.uniform(20, 70), *rng.uniform(-5, 5, 2), *rng.uniform(-0.6, 0.6, 3)])
    _, A, _ = image_and_jacobian(markers, X)
    h = 1e-5
    both = [[image_and_jacobian(markers, X + sign * d)[0].ravel() for d in h * np.eye(6)] for sign in (1, -1)]
    np.testing.assert_allclose(A, np.subtract(*both).T / (2 * h), atol=1e-8)


def test_the_picture_is_that_of_thesis_eq_5_41(markers):
    psi, theta, phi = 0.2, 0.467, -0.1
    R_crf_tanker = rotation_from_euler(psi, theta, phi).T  # Rx(phi) Ry(theta) Rz(psi), passive
    T = SE3(R_cam_crf @ R_crf_tanker, R_cam_crf @ [60.5, 20.0, -2.5])  # the thesis' start, 7.5.4
    G, _, nearest = image_and_jacobian(markers, np.array([60.5, 20.0, -2.5, psi, theta, phi]))
    q = T.transform(markers)
    np.testing.assert_allclose(G, q[:, :2] / q[:, 2:], atol=1e-13)
    assert nearest == pytest.approx(q[:, 2].min())


@settings(deadline=None)
@given(SEEDS)
def test_a_clean_pose_is_recovered(markers, approach_pose, seed):
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    found = solve_glsdc(markers, seen(markers, T, rng, 0.0), near(T, rng), iterations=6)
    np.testing.assert_allclose(found.T_cam_tanker.as_matrix(), T.as_matrix(), atol=1e-7)
    assert found.converged
    assert found.iterations == 6


def test_same_minimum_as_opencv(markers, approach_pose):
    rng = np.random.default_rng(20)
    for _ in range(30):
        T = approach_pose(rng)
        uv, T0 = seen(markers, T, rng, 1.0), near(T, rng)
        found = solve_glsdc(markers, uv, T0, iterations=8)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-14)
        start = cv2.Rodrigues(T0.R)[0], T0.t[:, None]
        rotation, t = cv2.solvePnPRefineLM(markers, uv, np.eye(3), None, *start, criteria)
        np.testing.assert_allclose(found.T_cam_tanker.t, t[:, 0], atol=1e-4)
        np.testing.assert_allclose(found.T_cam_tanker.R, cv2.Rodrigues(rotation)[0], atol=1e-5)


def test_a_weight_of_zero_takes_a_marker_out(markers, approach_pose):
    rng = np.random.default_rng(21)
    T = approach_pose(rng)
    uv, T0 = seen(markers, T, rng), near(T, rng)
    without = solve_glsdc(np.delete(markers, 4, axis=0), np.delete(uv, 4, axis=0), T0, iterations=8)
    uv[4] += 0.1
    weights = np.where(np.arange(9) == 4, 0.0, 3.0)
    for W in (weights, np.column_stack([weights, weights])):
        found = solve_glsdc(markers, uv, T0, iterations=8, weights=W)
        np.testing.assert_allclose(found.T_cam_tanker.as_matrix(), without.T_cam_tanker.as_matrix(), atol=1e-9)


def test_it_says_so_when_it_diverges(markers, approach_pose):
    """Thesis Tab. 7.6: the area of convergence ends. Nothing outside of it may be called converged and be wrong."""
    rng = np.random.default_rng(22)
    refused = 0
    for _ in range(60):
        T = approach_pose(rng)
        far = near(T, rng, metres=60.0, radians=1.5)
        found = solve_glsdc(markers, seen(markers, T, rng, 0.0), far)
        refused += not found.converged
        assert np.isfinite(found.T_cam_tanker.as_matrix()).all()
        if found.converged and found.image_error < 1.0 / 457:
            np.testing.assert_allclose(found.T_cam_tanker.t, T.t, atol=0.05 * T.t[2])
    assert refused > 30


def test_points_that_fix_no_pose_are_not_converged(approach_pose):
    rng = np.random.default_rng(23)
    T = approach_pose(rng)
    line = np.outer(np.arange(6.0), [1.0, 2.0, 0.5])
    assert not solve_glsdc(line, seen(line, T, rng, 0.0), T).converged


@given(SEEDS, st.integers(1, 8))
def test_cholesky_solves_what_numpy_solves(seed, n):
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(n, n + 3))
    P, b = B @ B.T, rng.normal(size=n)
    x = b.copy()
    assert solve_spd(P.copy(), x)
    np.testing.assert_allclose(P @ x, b, atol=1e-6)
    assert not solve_spd(-P, b)


def test_wrong_input_is_refused_in_words(markers, approach_pose):
    rng = np.random.default_rng(24)
    T = approach_pose(rng)
    uv = seen(markers, T, rng)
    with pytest.raises(ValueError, match="finite"):
        solve_glsdc(markers, uv * np.nan, T)
    with pytest.raises(ValueError, match="finite"):
        solve_glsdc(markers, uv, SE3(T.R, T.t * np.nan))
    with pytest.raises(ValueError, match=r"weights must be \(9,\)"):
        solve_glsdc(markers, uv, T, weights=-np.ones(9))
    with pytest.raises(ValueError, match=r"weights must be \(9,\)"):
        solve_glsdc(markers, uv, T, weights=np.ones(18))
    with pytest.raises(ValueError, match="at least 4"):
        solve_glsdc(markers[:2], uv[:2], T)

@given(SEEDS, st.floats(0.0, 300.0), st.floats(0.0, np.pi), st.integers(0, 8), st.sampled_from([0.0, 0.5, 5.0]))
def test_from_anywhere_it_rests_at_a_minimum_or_says_that_it_does_not(markers, approach_pose, seed, m, rad, n, px):
    """Far starts, starts behind the camera, starts turned over: nothing raises, and converged means a resting point."""
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    uv, T0 = seen(markers, T, rng, px), near(T, rng, metres=m, radians=rad)
    found = solve_glsdc(markers, uv, T0, iterations=n)
    assert np.isfinite(found.T_cam_tanker.as_matrix()).all()
    assert np.linalg.det(found.T_cam_tanker.R) == pytest.approx(1.0, abs=1e-9)
    if not found.converged:
        return
    assert n > 0
    q = found.T_cam_tanker.transform(markers)
    assert (q[:, 2] > 0.0).all()
    assert found.image_error == pytest.approx(np.sqrt(np.sum((q[:, :2] / q[:, 2:] - uv) ** 2) / 9), abs=1e-12)
    start = T0.transform(markers)
    assert found.image_error <= np.sqrt(np.sum((start[:, :2] / start[:, 2:] - uv) ** 2) / 9) + 1e-9
    on = solve_glsdc(markers, uv, found.T_cam_tanker, iterations=30)  # going on leads nowhere else
    assert on.converged
    np.testing.assert_allclose(on.T_cam_tanker.R, found.T_cam_tanker.R, atol=5e-3)
    moved = np.linalg.norm(on.T_cam_tanker.t - found.T_cam_tanker.t)
    assert moved < 5e-3 * np.linalg.norm(found.T_cam_tanker.t)


@pytest.mark.parametrize("degrees", [45.0, 90.0, 135.0])
def test_a_start_behind_the_camera_or_turned_over_is_no_pose(markers, approach_pose, degrees):
    rng = np.random.default_rng(25)
    for _ in range(20):
        T = approach_pose(rng)
        uv = seen(markers, T, rng, 0.0)
        behind = SE3(T.R, -T.t)
        found = solve_glsdc(markers, uv, behind)
        assert not found.converged or found.image_error < 1e-6
        over = SE3(exp_so3(np.array([0.0, np.deg2rad(degrees), 0.0])) @ T.R, T.t)
        found = solve_glsdc(markers, uv, over)
        assert not found.converged or found.image_error < 1e-6 or found.image_error > 10.0 / 457


def test_few_steps_that_are_not_enough_are_not_called_converged(markers, approach_pose):
    rng = np.random.default_rng(26)
    for _ in range(20):
        T = approach_pose(rng)
        uv, T0 = seen(markers, T, rng, 0.0), near(T, rng, metres=8.0, radians=0.15)
        runs = [solve_glsdc(markers, uv, T0, iterations=n) for n in (0, 1, 10)]
        assert [r.converged for r in runs] == [False, False, True]
        assert [r.iterations for r in runs] == [0, 1, 10]
    np.testing.assert_allclose(runs[0].T_cam_tanker.as_matrix(), T0.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("n", range(4, 13))
def test_any_number_of_markers_from_the_least_on(n):
    s = scene(np.random.default_rng(n), n=n, thick_m=4.0)
    q = s.T.transform(s.points)
    start = SE3(exp_so3(np.full(3, 0.005)) @ s.T.R, s.T.t + 0.1)
    found = solve_glsdc(s.points, q[:, :2] / q[:, 2:], start, iterations=10)
    assert found.converged
    np.testing.assert_allclose(found.T_cam_tanker.as_matrix(), s.T.as_matrix(), atol=1e-6)


def test_the_least_number_of_markers_is_the_callers(markers, approach_pose):
    rng = np.random.default_rng(27)
    T = approach_pose(rng)
    uv = seen(markers, T, rng, 0.0)
    with pytest.raises(ValueError, match="at least 4 markers that have weight; 3 were given"):
        solve_glsdc(markers[:3], uv[:3], T)
    with pytest.raises(ValueError, match="at least 6 markers"):
        solve_glsdc(markers[:5], uv[:5], T, min_markers=6)
    with pytest.raises(ValueError, match="at least 4 markers"):
        solve_glsdc(markers, uv, T, weights=np.r_[np.ones(3), np.zeros(6)])
    assert solve_glsdc(markers[:3], uv[:3], T, min_markers=3).converged


@given(SEEDS)
def test_weights_are_those_of_eq_5_52(markers, approach_pose, seed):
    """One step is X + (A^T W A)^-1 A^T W (uv - G), with the listing's pinv; scaling W changes nothing."""
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    uv, T0, W = seen(markers, T, rng), near(T, rng), rng.uniform(0.01, 10.0, (9, 2))
    R_crf = R_cam_crf.T @ T0.R
    X = np.array([*(R_cam_crf.T @ T0.t), *euler_from_rotation(R_crf.T)])
    G, A, _ = image_and_jacobian(markers, X)
    w = np.diag(W.ravel())
    X = X + np.linalg.pinv(A.T @ w @ A) @ A.T @ w @ (uv - G).ravel()
    found = solve_glsdc(markers, uv, T0, iterations=1, weights=W).T_cam_tanker
    np.testing.assert_allclose(found.t, R_cam_crf @ X[:3], atol=1e-6)
    np.testing.assert_allclose(found.R, R_cam_crf @ rotation_from_euler(*X[3:]).T, atol=1e-8)
    scaled = solve_glsdc(markers, uv, T0, iterations=1, weights=1e5 * W).T_cam_tanker
    np.testing.assert_allclose(scaled.as_matrix(), found.as_matrix(), atol=1e-8)
    alike = solve_glsdc(markers, uv, T0, weights=np.full(9, 7.0)).T_cam_tanker
    np.testing.assert_allclose(alike.as_matrix(), solve_glsdc(markers, uv, T0).T_cam_tanker.as_matrix(), atol=1e-8)


@settings(max_examples=50)
@given(SEEDS)
def test_frames_and_order_do_not_matter(markers, approach_pose, seed):
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    uv, T0, order = seen(markers, T, rng), near(T, rng), rng.permutation(9)
    base = solve_glsdc(markers, uv, T0, iterations=10).T_cam_tanker
    S = SE3(exp_so3(rng.normal(0, 0.3, 3)), rng.normal(0, 3.0, 3))  # other axes on the tanker
    moved = solve_glsdc(S.transform(markers)[order], uv[order], T0 @ S.inverse(), iterations=10).T_cam_tanker
    np.testing.assert_allclose((moved @ S).as_matrix(), base.as_matrix(), atol=1e-6)
    large = solve_glsdc(10.0 * markers, uv, SE3(T0.R, 10.0 * T0.t), iterations=10).T_cam_tanker
    np.testing.assert_allclose(large.t, 10.0 * base.t, atol=1e-5)
