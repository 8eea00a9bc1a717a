import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.estimation.alignment import AttitudeHistory, MotionHistory
from companion.geometry import exp_so3, log_so3

MS = 1_000_000


def quadratic(t_s):
    """Position and velocity of a body in constant acceleration at 206 m/s."""
    a, v0 = np.array([0.5, -0.3, 0.8]), np.array([206.0, 1.0, -2.0])
    return v0 * t_s + 0.5 * a * t_s**2, v0 + a * t_s


def filled(rate_hz=50, seconds=1.0):
    h = MotionHistory()
    for k in range(int(seconds * rate_hz) + 1):
        t_ns = round(k * 1e9 / rate_hz)
        assert h.append(t_ns, *quadratic(t_ns * 1e-9))
    return h


@given(st.integers(min_value=0, max_value=1_000_000_000))
def test_interpolates_constant_acceleration_to_a_millimetre(t_ns):
    m = filled().at(t_ns)
    p, v = quadratic(t_ns * 1e-9)
    assert np.allclose(m.p_ned_m, p, atol=1e-3)
    assert np.allclose(m.v_ned_m_s, v, atol=1e-9)


@given(st.integers(min_value=1_000_000_000, max_value=1_100_000_000))
def test_extrapolates_with_the_newest_velocity(t_ns):
    m = filled().at(t_ns)
    dt = t_ns * 1e-9 - 1.0
    p, v = quadratic(1.0)
    assert np.allclose(m.p_ned_m, p + v * dt, atol=1e-6)


def test_travel_is_the_integral_of_velocity_and_ignores_jumps_of_position():
    h = MotionHistory()
    for k in range(51):
        p, v = quadratic(k * 0.02)
        h.append(k * 20 * MS, p + (k // 5) * np.array([0.1, -0.1, 0.1]), v)
    start, end = h.at(0), h.at(1000 * MS)
    assert np.allclose(end.travel_m - start.travel_m, quadratic(1.0)[0], atol=1e-3)


def test_one_millisecond_at_206_m_s_is_206_mm():
    h = filled()
    assert h.at(501 * MS).p_ned_m[0] - h.at(500 * MS).p_ned_m[0] == pytest.approx(0.206, abs=0.001)


def test_old_and_equal_stamps_are_refused_and_change_nothing():
    h = filled()
    before = h.at(900 * MS).p_ned_m
    assert not h.append(1000 * MS, np.zeros(3), np.zeros(3))
    assert not h.append(500 * MS, np.zeros(3), np.zeros(3))
    assert np.array_equal(h.at(900 * MS).p_ned_m, before)


def test_nothing_before_the_first_sample():
    h = MotionHistory()
    assert h.at(0) is None
    h.append(10 * MS, np.zeros(3), np.ones(3))
    assert h.at(9 * MS) is None
    assert AttitudeHistory().at(0) is None


def test_history_stays_bounded():
    h = MotionHistory(span_s=1.0)
    for k in range(5000):
        h.append(k * 20 * MS, np.zeros(3), np.zeros(3))
    assert len(h._samples) < 200


@given(st.floats(min_value=0.0, max_value=1.05), st.floats(min_value=-1.0, max_value=1.0))
def test_attitude_of_a_constant_rate_turn(t_s, rate):
    omega = np.array([rate, -0.5 * rate, 0.25])
    h = AttitudeHistory()
    for k in range(51):
        h.append(k * 20 * MS, exp_so3(omega * k * 0.02), omega)
    a = h.at(round(t_s * 1e9))
    assert np.linalg.norm(log_so3(a.R_ned_body.T @ exp_so3(omega * t_s))) < 1e-6
