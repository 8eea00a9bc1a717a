"""Whatever is put into a pose solver: a ValueError in words, or a finite pose that says whether it converged."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_scenes import ahead, scene

from companion.geometry import SE3, exp_so3
from companion.vision.depth_iteration import solve_depth_iteration
from companion.vision.glsdc import solve_glsdc
from companion.vision.lhm import solve_lhm, solve_lhm_minima

SEEDS = st.integers(0, 2**32 - 1)
NEAR = SE3(np.eye(3), np.array([0.0, 0.0, 40.0]))

SOLVERS: dict[str, Callable[..., object]] = {
    "lhm_warm": lambda points, uv: solve_lhm(points, uv, np.eye(3)),
    "lhm_quaternion": lambda points, uv: solve_lhm(points, uv, np.eye(3), method="quaternion"),
    "lhm_cold": solve_lhm,
    "lhm_weak_perspective": lambda points, uv: solve_lhm(points, uv, start="weak_perspective"),
    "lhm_minima": solve_lhm_minima,
    "glsdc": lambda points, uv: solve_glsdc(points, uv, NEAR),
    "depths_1": lambda points, uv: solve_depth_iteration(points, uv, 1, iterations=50),
    "depths_2": lambda points, uv: solve_depth_iteration(points, uv, 2, iterations=50),
}
ALL = pytest.mark.parametrize("name", SOLVERS)


def solved(name, points, uv):
    """Return the poses that a solver gives, after a look at each, or an empty list when it refuses in words."""
    try:
        found = SOLVERS[name](points, uv)
    except ValueError as error:
        text = str(error)
        return [] if len(text) > 10 and "\n" not in text else pytest.fail(f"refused with {text!r}")
    poses = list(found) if isinstance(found, tuple) else [found]
    for pose in poses:
        T = pose.T_cam_tanker
        if pose.converged:
            assert np.isfinite(T.as_matrix()).all()
            np.testing.assert_allclose(T.R @ T.R.T, np.eye(3), atol=1e-6)
            assert np.linalg.det(T.R) > 0
            assert ahead(T, np.asarray(points, dtype=float))
    return [pose for pose in poses if pose.converged]


@ALL
@settings(max_examples=40)
@given(n=st.integers(0, 6), data=st.data())
def test_any_numbers_at_all(name, n, data):
    numbers = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, 1.0, 1e300, 1e-300])
    points, uv = (
        np.array(data.draw(st.lists(numbers, min_size=n * k, max_size=n * k)), dtype=float).reshape(n, k)
        for k in (3, 2)
    )  # fmt: skip
    solved(name, points, uv)


@ALL
@settings(max_examples=40)
@given(seed=SEEDS, n=st.integers(0, 3))
def test_too_few_points(name, seed, n):
    rng = np.random.default_rng(seed)
    found = solved(name, rng.normal(0, 5, (n, 3)), rng.normal(0, 0.2, (n, 2)))
    assert not found or (n == 3 and name != "glsdc")


@ALL
@settings(max_examples=40)
@given(seed=SEEDS, n=st.integers(3, 9))
def test_points_on_a_line_or_all_in_one(name, seed, n):
    rng = np.random.default_rng(seed)
    line = np.outer(rng.uniform(-10, 10, n), rng.normal(size=3)) + rng.normal(size=3)
    q = NEAR.transform(line)
    assert not solved(name, line, q[:, :2] / q[:, 2:])
    one = np.tile(rng.normal(0, 5, 3), (n, 1))
    q = NEAR.transform(one)
    assert not solved(name, one, q[:, :2] / q[:, 2:])
    cloud = rng.normal(0, 5, (n, 3))  # a cloud that is seen in one point only: it is infinitely far
    assert not solved(name, cloud, np.tile(rng.normal(0, 0.2, 2), (n, 1)))


@ALL
@settings(max_examples=40)
@given(seed=SEEDS, where=st.sampled_from(["points", "uv"]), what=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_numbers_that_are_none(name, seed, where, what):
    rng = np.random.default_rng(seed)
    s = scene(rng)
    spoilt = {"points": s.points.copy(), "uv": s.uv.copy()}
    spoilt[where].flat[rng.integers(spoilt[where].size)] = what
    assert not solved(name, **spoilt)


@ALL
@settings(max_examples=40)
@given(seed=SEEDS, copies=st.integers(1, 3))
def test_markers_that_are_given_twice(name, seed, copies):
    """The same point seen at the same place twice only weighs more; three points and copies of them stay three."""
    rng = np.random.default_rng(seed)
    s = scene(rng, n=6, thick_m=4.0)
    more = np.r_[np.arange(6), np.zeros(copies, dtype=int)]
    solved(name, s.points[more], s.uv[more])
    two = np.r_[0, 1, np.zeros(copies, dtype=int), np.ones(copies, dtype=int)]
    assert not solved(name, s.points[two], s.uv[two])
    places = rng.normal(0, 0.2, (4, 2))  # one marker seen in four places
    assert not solved(name, np.tile(s.points[0], (4, 1)), places)


@ALL
@settings(max_examples=40)
@given(seed=SEEDS)
def test_what_lies_behind_the_camera_is_never_called_converged(name, seed):
    """The picture of points behind the camera, which no camera takes: their mirror image in front fits it badly."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 5, (8, 3)) * [1.0, 1.2, 0.8]
    T = SE3(exp_so3(rng.normal(0, 0.2, 3)), np.array([*rng.normal(0, 3, 2), -40.0]))
    q = T.transform(points)
    uv = q[:, :2] / q[:, 2:]
    for pose in solved(name, points, uv):
        assert pose.image_error > 1e-3


@ALL
@pytest.mark.parametrize(
    ("points", "uv"),
    [
        (np.zeros((0, 3)), np.zeros((0, 2))),
        (np.zeros((5, 2)), np.zeros((5, 2))),
        (np.zeros((5, 3)), np.zeros((4, 2))),
        (np.zeros((5, 3)), np.zeros((5, 3))),
        (np.zeros(15), np.zeros((5, 2))),
        (np.zeros((5, 3)), np.zeros(10)),
        (np.zeros((5, 3, 1)), np.zeros((5, 2, 1))),
        ([], []),
    ],
)
def test_wrong_shapes(name, points, uv):
    with pytest.raises(ValueError, match=r"\(n, 3\)|at least|least"):
        SOLVERS[name](points, uv)


@ALL
def test_arrays_are_read_only_to_the_solvers(name):
    s = scene(np.random.default_rng(1), n=8, thick_m=4.0)
    points, uv = s.points.copy(), s.uv.copy()
    points.flags.writeable = uv.flags.writeable = False
    SOLVERS[name](points, uv)
    a, b = s.points.copy(), s.uv.copy()
    SOLVERS[name](a, b)
    np.testing.assert_array_equal(a, points)
    np.testing.assert_array_equal(b, uv)
