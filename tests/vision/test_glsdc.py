import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import SE3, R_cam_crf, exp_so3, rotation_from_euler
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
