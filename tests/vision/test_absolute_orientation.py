import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from companion.geometry import SE3, exp_so3
from companion.vision.absolute_orientation import (
    LARGEST_ROOT,
    absolute_orientation,
    rotation_closed_form,
    rotation_quaternion,
    rotation_svd,
)

SEEDS = st.integers(0, 2**32 - 1)


def closed_form(M, guess=LARGEST_ROOT):
    found, r, _ = rotation_closed_form(tuple(M.ravel()), guess)
    return np.reshape(r, (3, 3)) if found else None


SINGULAR_VALUES = [(1.0, 0.7, 0.4), (1.0, 0.9, -0.3), (1.0, 0.5, 0.0), (1.0, 1.0, 1.0)]


@given(SEEDS, st.floats(1e-3, 1e6), st.sampled_from(SINGULAR_VALUES))
def test_the_three_kernels_agree_also_where_a_bare_svd_reflects(seed, scale, singular):
    rng = np.random.default_rng(seed)
    U, V = Rotation.random(rng=rng).as_matrix(), Rotation.random(rng=rng).as_matrix()
    M = scale * U @ np.diag(singular) @ V.T
    best = U @ V.T  # maximises tr(R^T M) for s1 >= s2 >= |s3|
    np.testing.assert_allclose(rotation_svd(M), best, atol=1e-9)
    np.testing.assert_allclose(rotation_quaternion(M), best, atol=1e-9)
    np.testing.assert_allclose(closed_form(M), best, atol=1e-9)


@given(SEEDS)
def test_every_answer_is_a_rotation_and_no_other_is_better(seed):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(3, 3))
    for R in (rotation_svd(M), rotation_quaternion(M), closed_form(M)):
        if R is None:  # too degenerate for the closed form, which says so
            continue
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) > 0
        for nudge in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
            assert np.trace((exp_so3(nudge) @ R).T @ M) <= np.trace(R.T @ M) + 1e-9


@pytest.mark.parametrize("M", [np.zeros((3, 3)), np.outer([1.0, 2.0, 3.0], [0.0, 1.0, 0.0]), np.diag([1.0, 0.5, -0.5])])
def test_the_closed_form_says_when_no_rotation_is_best(M):
    assert closed_form(M) is None


@pytest.mark.parametrize("method", ["svd", "quaternion"])
def test_absolute_orientation_finds_the_transform_and_ignores_symmetric_noise(method):
    rng = np.random.default_rng(4)
    T = SE3(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 20, 3))
    points = rng.normal(0, 5, (9, 3))
    found = absolute_orientation(points, T.transform(points), method)
    np.testing.assert_allclose(found.as_matrix(), T.as_matrix(), atol=1e-12)
    noisy = T.transform(points) + rng.normal(0, 0.3, (9, 3))
    centred = noisy - noisy.mean(axis=0)
    theirs, _ = Rotation.align_vectors(centred, points - points.mean(axis=0))
    np.testing.assert_allclose(absolute_orientation(points, noisy, method).R, theirs.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("method", ["svd", "quaternion"])
@given(seed=SEEDS)
def test_weights_count_as_scipy_counts_them(method, seed):
    """Thesis eq. 5.2, 5.8, 5.9: weighted means, weighted squares; twice the weight is the point twice."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 10))
    points, w = rng.normal(0, 5, (n, 3)), rng.uniform(0.01, 10.0, n)
    T = SE3(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 20, 3))
    seen = T.transform(points) + rng.normal(0, 0.3, (n, 3))
    found = absolute_orientation(points, seen, method, w)
    mean_b, mean_a = w @ points / w.sum(), w @ seen / w.sum()
    theirs, _ = Rotation.align_vectors(seen - mean_a, points - mean_b, weights=w)
    np.testing.assert_allclose(found.R, theirs.as_matrix(), atol=1e-8)
    np.testing.assert_allclose(found.t, mean_a - found.R @ mean_b, atol=1e-9)
    np.testing.assert_allclose(absolute_orientation(points, seen, method, 1e6 * w).as_matrix(), found.as_matrix())
    doubled = absolute_orientation(np.vstack([points, points[:1]]), np.vstack([seen, seen[:1]]), method)
    once = absolute_orientation(points, seen, method, np.r_[2.0, np.ones(n - 1)])
    np.testing.assert_allclose(doubled.as_matrix(), once.as_matrix(), atol=1e-9)
    absent = absolute_orientation(points[1:], seen[1:], method)
    none = absolute_orientation(points, seen, method, np.r_[0.0, np.ones(n - 1)])
    np.testing.assert_allclose(none.as_matrix(), absent.as_matrix(), atol=1e-9)


@given(SEEDS, st.floats(0.6, 4.0))
def test_a_good_guess_of_the_root_changes_nothing(seed, guess):
    M = np.random.default_rng(seed).normal(size=(3, 3))
    plain, guessed = closed_form(M), closed_form(M, guess)
    assert (plain is None) == (guessed is None)
    if plain is not None:
        np.testing.assert_allclose(guessed, plain, atol=1e-9)


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("b", "a", "extra", "says"),
    [
        (TRIANGLE[:2], TRIANGLE[:2], {}, "at least 3 points"),
        (TRIANGLE, TRIANGLE[:2], {}, "same size"),
        (TRIANGLE[:, :2], TRIANGLE[:, :2], {}, "same size"),
        (TRIANGLE * np.nan, TRIANGLE, {}, "finite"),
        (TRIANGLE, TRIANGLE * [1, 0, 0], {}, "one line"),
        (TRIANGLE * 0.0, TRIANGLE, {}, "one line"),
        (TRIANGLE, TRIANGLE, {"weights": np.array([1.0, 1.0, 0.0])}, "at least 3 points"),
        (TRIANGLE, TRIANGLE, {"weights": np.array([1.0, 1.0, -1.0])}, "not negative"),
        (TRIANGLE, TRIANGLE, {"weights": np.ones((3, 3))}, r"must be \(3,\)"),
        (TRIANGLE, TRIANGLE, {"method": "QTN"}, "'svd' or 'quaternion'"),
    ],
)
def test_what_fixes_no_rotation_is_refused_in_words(b, a, extra, says):
    with pytest.raises(ValueError, match=says):
        absolute_orientation(b, a, **extra)
