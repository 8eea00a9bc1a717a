"""Labels without a prior: with the attitude alone, and with nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from label_frames import CAMERA, CONFIG, MARKERS, NOISE_PX, Tally, Trouble, frame

from companion.geometry import exp_so3
from companion.vision.reacquisition import reacquire

THREE_MISSING = Trouble(dropouts=3, gross=0.0)
SIGMA = NOISE_PX / CAMERA.fx_px


def tally(seed, frames, blind, trouble=THREE_MISSING, least=5):
    """Return the counts, and how many frames had ``least`` whole lights and how many of these were verified."""
    rng, counts, with_enough, verified = np.random.default_rng(seed), Tally(), 0, 0
    for _ in range(frames):
        f = frame(rng, trouble)
        found = reacquire(MARKERS, f.uv, f.sigma, CONFIG, None if blind else f.prior.R)
        counts.add(f, found)
        with_enough += f.whole >= least
        verified += f.whole >= least and found.verified
    print(counts.text(), f"\nwith {least} or more whole lights: {verified} of {with_enough}")
    assert counts.score.swapped == 0
    assert max(counts.surprises, default=0.0) <= CONFIG.gate_sigma
    assert counts.score.wrong <= 0.01 * frames
    return with_enough, verified


def test_with_the_attitude_of_the_inus():
    enough, verified = tally(21, 200, blind=False, least=6)
    assert verified >= 0.99 * enough


def test_with_nothing_known():
    enough, verified = tally(22, 25, blind=True, least=7)
    assert verified >= 0.95 * enough


@pytest.mark.slow
def test_2000_frames_with_the_attitude():
    enough, verified = tally(23, 2000, blind=False, least=6)
    assert verified >= 0.99 * enough


@pytest.mark.slow
def test_500_frames_with_nothing_known():
    enough, verified = tally(24, 500, blind=True, least=7)
    assert verified >= 0.97 * enough


def test_any_attitude_is_found_again():
    rng = np.random.default_rng(25)
    for _ in range(5):
        f = frame(rng, Trouble(dropouts=0, spurious=2, split=0.0, merged=0.0, gross=0.0))
        roll = exp_so3(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        found = reacquire(MARKERS, f.uv @ roll[:2, :2].T, f.sigma, CONFIG)
        used = np.flatnonzero(found.labels >= 0)
        assert found.verified
        np.testing.assert_array_equal(f.truth[found.labels[used]], used)
        np.testing.assert_allclose(found.T_cam_tanker.t, roll @ f.T_cam_tanker.t, atol=0.5)


@pytest.mark.parametrize("blind", [False, True])
def test_a_picture_without_a_tanker_is_not_labelled(blind):
    rng = np.random.default_rng(26)
    for _ in range(20 if blind else 200):
        f = frame(rng, THREE_MISSING)
        m = int(rng.integers(5, 15))
        uv = rng.uniform([-0.7, -0.52], [0.7, 0.52], (m, 2))
        assert not reacquire(MARKERS, uv, np.full(m, SIGMA), CONFIG, None if blind else f.prior.R).verified


def test_a_map_that_fits_itself_when_turned_is_ambiguous_without_an_attitude():
    """Six lights on a ring: five turns of it give the same picture."""
    angle = np.arange(6) * np.pi / 3
    ring = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.zeros(6)])
    q = ring @ exp_so3(np.array([0.3, 0.1, 0.0])).T + np.array([1.0, 2.0, 40.0])
    found = reacquire(ring, q[:, :2] / q[:, 2:], np.full(6, SIGMA), CONFIG)
    assert not found.verified
    known = reacquire(ring, q[:, :2] / q[:, 2:], np.full(6, SIGMA), CONFIG, exp_so3(np.array([0.3, 0.1, 0.0])))
    assert known.verified
    np.testing.assert_array_equal(known.labels, np.arange(6))


def test_too_many_detections_to_try_are_refused():
    rng = np.random.default_rng(27)
    uv = rng.uniform(-0.5, 0.5, (40, 2))
    assert reacquire(MARKERS, uv, np.full(40, SIGMA), CONFIG).reason == "too_many"


NUMBERS = st.one_of(st.floats(-2, 2), st.sampled_from([np.nan, np.inf, 0.0, 1e300, 1e-300]))


@given(st.data())
def test_any_numbers_give_an_answer(data):
    n, m = data.draw(st.integers(0, 8)), data.draw(st.integers(0, 7))
    points = data.draw(arrays(np.float64, (n, 3), elements=NUMBERS))
    uv = data.draw(arrays(np.float64, (m, 2), elements=NUMBERS))
    sigma = data.draw(arrays(np.float64, m, elements=NUMBERS))
    R = data.draw(st.one_of(st.none(), arrays(np.float64, (3, 3), elements=NUMBERS), st.just(np.eye(3))))
    found = reacquire(points, uv, sigma, CONFIG, R)
    assert found.labels.shape == (n,)
    assert found.verified == (found.reason == "")


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match="R_cam_tanker"):
        reacquire(MARKERS, np.zeros((4, 2)), np.ones(4), CONFIG, np.eye(4))
