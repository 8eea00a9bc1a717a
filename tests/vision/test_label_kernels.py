"""The compiled parts of the robust labeling against numpy, scipy, and doing it the long way."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from companion.geometry import SE3, exp_so3, log_so3
from companion.vision.consensus import between, depths
from companion.vision.label_kernel import mutual
from companion.vision.labeling import label_mutual_nearest
from companion.vision.p3p import quartic, vote_blind
from companion.vision.pose_fit import fit, foretold, inverse_of, project
from companion.vision.reacquisition import spread_triples
from companion.vision.small_systems import move

SEEDS = st.integers(0, 999)
NOISE = 0.3 / 457


def scene(markers, approach_pose, seed, labelled=7):
    """Return (rng, true pose, prior, covariance, rays, labels): some markers seen with noise, in mixed order."""
    rng = np.random.default_rng(seed)
    T = approach_pose(rng)
    cov = np.diag(rng.uniform(0.1, 1.0, 6) ** 2 * np.array([1.0] * 3 + [0.02**2] * 3))
    d = np.linalg.cholesky(cov) @ rng.normal(size=6)
    prior = SE3(exp_so3(-d[3:]) @ T.R, T.t - d[:3])
    q = T.transform(markers)
    seen = rng.permutation(len(markers))[:labelled]
    labels = np.full(len(markers), -1)
    labels[seen] = np.arange(labelled)
    rays = q[seen, :2] / q[seen, 2:] + rng.normal(0.0, NOISE, (labelled, 2))
    return rng, T, prior, cov, rays, labels


def fitted(markers, prior, cov, rays, labels):
    n = len(markers)
    d, R, t, P = np.zeros(6), np.empty((3, 3)), np.empty(3), np.empty((6, 6))
    uv, J = np.empty((n, 2)), np.empty((n, 2, 6))
    log_det = fit(markers, rays, np.full(len(rays), NOISE**2), 0.0, labels, prior.R, prior.t, np.linalg.inv(cov), d, R,
                  t, P, uv, J)
    return d, SE3(R, t), P, uv, J, log_det


@given(seed=SEEDS)
def test_inverse_and_log_determinant(seed):
    A = np.random.default_rng(seed).normal(size=(6, 9))
    A = A @ A.T
    inverse = np.empty((6, 6))
    assert inverse_of(A, inverse) == pytest.approx(np.linalg.slogdet(A)[1])
    np.testing.assert_allclose(inverse @ A, np.eye(6), atol=1e-7 * np.linalg.cond(A))


def test_what_is_not_positive_definite_has_no_determinant():
    A = np.diag([1.0, 1.0, -1.0])
    assert np.isnan(inverse_of(A, np.empty((3, 3))))


@given(seed=SEEDS)
def test_slopes_of_the_projection_are_the_numeric_ones(markers, approach_pose, seed):
    T = approach_pose(np.random.default_rng(seed))
    n, h = len(markers), 1e-6
    (uv, low, high), (J, spare) = np.empty((3, n, 2)), np.empty((2, n, 2, 6))
    project(markers, T.R, T.t, uv, J)
    q = T.transform(markers)
    np.testing.assert_allclose(uv, q[:, :2] / q[:, 2:], atol=1e-12)
    R, t = np.empty((3, 3)), np.empty(3)
    for k in range(6):
        for sign, out in ((-h, low), (h, high)):
            d = np.zeros(6)
            d[k] = sign
            move(T.R, T.t, d, R, t)
            np.testing.assert_allclose(R, exp_so3(d[3:]) @ T.R, atol=1e-14)
            project(markers, R, t, out, spare)
        np.testing.assert_allclose(J[:, :, k], (high - low) / (2 * h), atol=1e-7)


@given(seed=SEEDS)
def test_the_fit_is_the_most_probable_pose(markers, approach_pose, seed):
    _, _, prior, cov, rays, labels = scene(markers, approach_pose, seed)
    root = np.linalg.inv(np.linalg.cholesky(cov))
    used = np.flatnonzero(labels >= 0)

    def cost(d):
        q = (markers[used] @ (exp_so3(d[3:]) @ prior.R).T) + prior.t + d[:3]
        return np.concatenate([root @ d, ((q[:, :2] / q[:, 2:] - rays[labels[used]]) / NOISE).ravel()])

    best = least_squares(cost, np.zeros(6), x_scale=[1.0] * 3 + [0.02] * 3, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    d, T, P, _, _, log_det = fitted(markers, prior, cov, rays, labels)
    off = (d - best.x) / np.sqrt(np.diag(P))
    assert np.abs(off).max() < 0.02  # sigmas
    np.testing.assert_allclose(P, np.linalg.inv(best.jac.T @ best.jac), rtol=0.05, atol=0.02 * np.abs(P).max())
    assert log_det == pytest.approx(-np.linalg.slogdet(P)[1])
    np.testing.assert_allclose(log_so3(T.R @ prior.R.T), d[3:], atol=1e-12)


@given(seed=SEEDS)
def test_a_label_is_foretold_as_a_fit_without_it_does(markers, approach_pose, seed):
    _, _, prior, cov, rays, labels = scene(markers, approach_pose, seed)
    i = int(np.flatnonzero(labels >= 0)[0])
    _, _, P, uv, J, _ = fitted(markers, prior, cov, rays, labels)
    d2, u, v, uu, cross, vv = foretold(rays[labels[i]], uv[i], J[i], P, NOISE**2)
    without = labels.copy()
    without[i] = -1
    _, _, P, uv, J, _ = fitted(markers, prior, cov, rays, without)
    S = J[i] @ P @ J[i].T + NOISE**2 * np.eye(2)
    off = rays[labels[i]] - uv[i]
    sigma = np.sqrt(np.trace(S))
    np.testing.assert_allclose([u, v], uv[i], atol=0.1 * sigma)  # equal but for the curvature of the projection
    np.testing.assert_allclose([[uu, cross], [cross, vv]], S, atol=0.1 * sigma**2)
    assert d2 == pytest.approx(off @ np.linalg.solve(S, off), abs=0.3, rel=0.1)


@given(st.integers(0, 6), st.integers(1, 6), SEEDS)
def test_mutual_labels_are_those_of_the_listing(n, m, seed):
    rng = np.random.default_rng(seed)
    places, detected = rng.normal(size=(n, 2)), rng.normal(size=(m, 2))
    squared = np.sum((places[:, None] - detected[None]) ** 2, axis=2)
    squared[squared > 1.0] = np.inf
    labels = np.empty(n, dtype=np.int64)
    mutual(squared, labels)
    np.testing.assert_array_equal(labels, label_mutual_nearest(places, detected, 1.0))


@given(SEEDS)
def test_two_rays_give_back_their_depths(seed):
    rng = np.random.default_rng(seed)
    p = np.column_stack([rng.uniform(-10, 10, (2, 2)), rng.uniform(10, 60, 2)])
    d = np.empty(3)
    assert between(p, 0, 1, d) == pytest.approx(np.linalg.norm(p[1] - p[0]))
    za, zb, left = depths(p[0, :2] / p[0, 2], p[1, :2] / p[1, 2], d)
    np.testing.assert_allclose([za, zb], p[:, 2], rtol=1e-5)
    assert left < 1e-6


def test_equal_rays_have_no_depths():
    assert depths(np.zeros(2), np.zeros(2), np.ones(3))[2] == np.inf


@given(SEEDS)
def test_the_true_ratio_of_distances_is_a_root_of_the_quartic(seed):
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(-10, 10, (3, 2)), rng.uniform(15, 60, 3)])
    s = np.linalg.norm(q, axis=1)
    j = q / s[:, None]
    side = [np.sum((q[a] - q[b]) ** 2) for a, b in ((1, 2), (0, 2), (0, 1))]
    A = np.empty(5)
    quartic(*side, j[1] @ j[2], j[0] @ j[2], j[0] @ j[1], A)
    v = s[2] / s[0]
    assert abs(np.polyval(A[::-1], v)) < 1e-9 * np.polyval(np.abs(A[::-1]), v)


def test_three_markers_put_the_rest_where_it_is(markers, approach_pose):
    T = approach_pose(np.random.default_rng(5))
    q = T.transform(markers)
    votes, pose, labels = np.zeros(4), np.zeros((4, 12)), np.full((4, 9), -1)
    triples = spread_triples(markers.tobytes(), 9)
    vote_blind(markers, q[:, :2] / q[:, 2:], np.full(9, NOISE**2), triples, 150.0, 9, votes, pose, labels)
    best = votes.argmax()
    np.testing.assert_array_equal(labels[best], np.arange(9))
    np.testing.assert_allclose(pose[best, :9].reshape(3, 3), T.R, atol=1e-4)
    np.testing.assert_allclose(pose[best, 9:], T.t, atol=1e-2)


def test_any_five_of_the_nine_markers_hold_a_triple_that_is_tried(markers):
    triples = [set(t) for t in spread_triples(markers.tobytes(), 9).tolist()]
    assert all(any(t <= set(five) for t in triples) for five in combinations(range(9), 5))


def test_markers_on_a_line_have_no_triples():
    line = np.linspace(0, 1, 6)[:, None] * np.array([[10.0, 3.0, 1.0]])
    assert spread_triples(line.tobytes(), 6).shape == (0, 3)
    assert spread_triples(np.zeros((2, 3)).tobytes(), 2).shape == (0, 3)
