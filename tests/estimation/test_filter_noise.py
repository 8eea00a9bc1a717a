"""What is told at an instant, how far off it may be, and what of it cancels in BR."""

import filter_scene as fs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import FilterConfig
from companion.estimation.aircraft import Aligned
from companion.estimation.alignment import Attitude, Motion, MotionHistory
from companion.estimation.filter_noise import OWN, TANKER, TRAVEL, Ages, InsNoise, path_axes
from companion.geometry import exp_so3

C = FilterConfig()
NOISE = InsNoise(C)
FRESH = Ages(0.0, 0.0, 0.0)
SILENT = Ages(0.01, 0.01, 0.45)


def aligned(v=fs.V_TANKER):
    zero, rates = np.zeros(3), fs.OMEGA
    motion = Motion(zero, np.asarray(v), zero)
    return Aligned(0, motion, Attitude(fs.R_OWN, rates), motion, Attitude(fs.R_TANKER, rates))


def sigma(cov, axes):
    return np.sqrt(np.diag(axes.T @ cov @ axes))


@given(st.tuples(*[st.floats(-300.0, 300.0)] * 3))
def test_axes_of_the_path_are_a_frame_that_goes_along_it(v):
    v = np.array(v)
    R = path_axes(v)
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    if np.hypot(v[0], v[1]) >= 1.0:
        assert np.allclose(R[:, 0] * np.linalg.norm(v), v)
        assert R[2, 1] == 0.0
        assert R[2, 2] > 0.0


def test_velocity_is_told_well_along_the_path_only():
    told = sigma(NOISE.velocity(aligned(), FRESH), path_axes(fs.V_TANKER))
    assert told == pytest.approx(np.sqrt(2) * np.array([0.0014, 0.041, 0.041]))


def test_what_is_extrapolated_errs_by_what_nobody_has_told():
    """0.45 s of silence: a^2 age^4 / 4 of place, and the noise of the last velocity for as long."""
    axes, a = path_axes(fs.V_TANKER), np.array(C.tanker_acceleration_m_s2)
    travel = sigma(NOISE.table(aligned(), SILENT)[TRAVEL], axes)
    age = SILENT.tanker_s
    noise = age * (age - C.velocity_hold_s) * np.array([C.speed_sigma_m_s, *[C.velocity_sigma_m_s] * 2]) ** 2
    own = 0.25 * SILENT.position_s**4 * np.array(C.own_acceleration_m_s2) ** 2
    stamp = np.array([C.stamp_sigma_s * np.linalg.norm(fs.V_TANKER), 0.0, 0.0]) ** 2
    assert travel == pytest.approx(np.sqrt(0.25 * a**2 * age**4 + noise + own + stamp))
    assert travel[2] > 0.06, "gusts of 0.6 m/s^2 for 0.45 s"
    assert sigma(NOISE.velocity(aligned(), SILENT), axes)[2] > 0.25
    turned = sigma(NOISE.table(aligned(), SILENT)[TANKER], fs.R_TANKER)
    assert turned[0] > 0.0025, "0.025 rad/s^2 of roll"
    assert turned[0] > 2 * turned[1]


@given(st.floats(0.0, 0.9), st.floats(0.0, 0.9))
def test_nothing_gets_surer_with_age(a, b):
    young, old = sorted((a, b))
    for later, before in zip(
        (NOISE.table(aligned(), Ages(old, old, old)).reshape(3, 3, 3)),
        (NOISE.table(aligned(), Ages(young, young, young)).reshape(3, 3, 3)), strict=True,
    ):
        assert np.linalg.eigvalsh(later - before).min() >= -1e-15


def test_fresh_attitudes_have_their_noise_alone():
    table = NOISE.table(aligned(), FRESH)
    assert table[OWN] == pytest.approx(C.attitude_sigma_rad**2 * np.eye(3))
    assert table[TANKER] == pytest.approx(C.attitude_sigma_rad**2 * np.eye(3))


def test_one_noise_turns_velocity_and_attitude():
    """By drawing: a velocity told is that of the attitude told; a travel of 0.06 s and half a hold errs with it."""
    rng = np.random.default_rng(4)
    v, age_s = fs.V_TANKER, 0.06
    turns = C.attitude_sigma_rad * rng.standard_normal((20000, 3))
    told = np.array([exp_so3(n) @ v for n in turns]) - v
    travel = -(age_s + 0.5 * C.velocity_hold_s) * told  # the receiver's less the tanker's
    drawn = travel.T @ turns / len(turns)
    expected = NOISE.with_travel(aligned(), age_s, np.inf)
    assert np.allclose(drawn, expected, atol=0.03 * np.abs(expected).max())
    assert NOISE.with_travel(aligned(), age_s, 0.0) == pytest.approx(np.zeros((3, 3)))


@given(st.floats(0.0, 0.9), st.floats(0.0, 1.5), st.floats(0.01, 0.2))
def test_correlation_of_travel_and_attitude_fits_what_both_have(age_s, since_sight_s, hold_s):
    """A travel has walked since the last sight: with that, and what is extrapolated, the covariance stays one."""
    c = FilterConfig(velocity_hold_s=hold_s, position_walk=0.0)
    noise, a, axes = InsNoise(c), aligned(), path_axes(fs.V_TANKER)
    table = noise.table(a, Ages(0.0, 0.0, age_s))
    walked = hold_s * since_sight_s * np.array([c.speed_sigma_m_s, *[c.velocity_sigma_m_s] * 2]) ** 2
    cov = np.zeros((6, 6))
    cov[:3, :3] = table[TRAVEL] + (axes * walked) @ axes.T
    cov[3:, 3:] = table[TANKER]
    cov[:3, 3:] = noise.with_travel(a, age_s, since_sight_s)
    cov[3:, :3] = cov[:3, 3:].T
    scale = np.sqrt(np.diag(cov))
    assert np.linalg.eigvalsh(cov / np.outer(scale, scale)).min() > -1e-6


@pytest.mark.parametrize("gap_s", [0.2, 0.5, 0.9])
def test_a_travel_across_a_gap_errs_as_it_says(gap_s):
    """The tanker's velocities, with their noise, between which it went as straight as it could."""
    rng, sigma_m_s, errors = np.random.default_rng(4), np.array([C.speed_sigma_m_s, *[C.velocity_sigma_m_s] * 2]), []
    straight = InsNoise(FilterConfig(tanker_acceleration_m_s2=(0.0, 0.0, 0.0)))
    v = np.array([206.0, 0.0, 0.0])
    for _ in range(400):
        own, tanker = MotionHistory(), MotionHistory()
        for t_s in (0.0, 0.04, 0.04 + gap_s):
            tanker.add(round(t_s * fs.S), v * t_s, v + sigma_m_s * rng.standard_normal(3))
        for k in range(60):
            own.add(k * 20 * fs.MS, v * 0.02 * k, v)
        at = [Aligned(t, own.at(t), None, tanker.at(t), None) for t in (40 * fs.MS, round((0.04 + gap_s) * fs.S))]
        errors.append(at[1].travel_difference_m - at[0].travel_difference_m)
        assert straight.gaps(at[0]) == (0.0, 0.0, 0.0)
    told = np.sqrt(straight.gaps(at[1]))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(told, rel=0.1)
    assert (np.array(NOISE.gaps(at[1]))[1:] > told[1:] ** 2).all(), "and what it may have done meanwhile"
