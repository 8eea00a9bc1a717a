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
        assert h.add(t_ns, *quadratic(t_ns * 1e-9)) == ""
    return h


@given(st.integers(min_value=0, max_value=1_000_000_000))
def test_interpolates_constant_acceleration_to_a_millimetre(t_ns):
    m = filled().at(t_ns)
    p, v = quadratic(t_ns * 1e-9)
    assert np.allclose(m.p_ned_m, p, atol=1e-3)
    assert np.allclose(m.v_ned_m_s, v, atol=1e-9)


@given(st.integers(min_value=1_000_000_000, max_value=1_300_000_000))
def test_extrapolates_by_velocity_and_the_acceleration_that_velocities_show(t_ns):
    m = filled().at(t_ns)
    p, v = quadratic(t_ns * 1e-9)
    assert np.allclose(m.p_ned_m, p, atol=1e-6)
    assert np.allclose(m.v_ned_m_s, v, atol=1e-6)


def test_far_beyond_the_newest_sample_the_velocity_changes_no_more():
    h = filled()
    edge, far = h.at(1_300 * MS), h.at(2_000 * MS)
    assert np.allclose(far.v_ned_m_s, edge.v_ned_m_s)
    assert np.allclose(far.p_ned_m, edge.p_ned_m + 0.7 * edge.v_ned_m_s)


def test_too_few_velocities_tell_no_acceleration():
    h = MotionHistory()
    h.add(0, np.zeros(3), np.array([200.0, 0.0, 0.0]))
    h.add(10 * MS, np.zeros(3), np.array([201.0, 0.0, 0.0]))
    h.add(20 * MS, np.zeros(3), np.array([202.0, 0.0, 0.0]))
    assert h.at(120 * MS).v_ned_m_s.tolist() == [202.0, 0.0, 0.0]


def test_travel_is_the_integral_of_velocity_and_ignores_jumps_of_position():
    h = MotionHistory()
    for k in range(51):
        p, v = quadratic(k * 0.02)
        h.add(k * 20 * MS, p + (k // 5) * np.array([0.1, -0.1, 0.1]), v)
    start, end = h.at(0), h.at(1000 * MS)
    assert np.allclose(end.travel_m - start.travel_m, quadratic(1.0)[0], atol=1e-3)


def test_one_millisecond_at_206_m_s_is_206_mm():
    h = filled()
    assert h.at(501 * MS).p_ned_m[0] - h.at(500 * MS).p_ned_m[0] == pytest.approx(0.206, abs=0.001)


def test_equal_stamps_and_those_beyond_the_span_are_refused_and_change_nothing():
    h = filled(seconds=4.0)
    before = h.at(3900 * MS).p_ned_m
    assert h.add(4000 * MS, np.zeros(3), np.zeros(3)) == "duplicate"
    assert h.add(3500 * MS, np.zeros(3), np.zeros(3)) == "duplicate"
    assert h.add(999 * MS, np.zeros(3), np.zeros(3)) == "time_not_forward"
    assert np.array_equal(h.at(3900 * MS).p_ned_m, before)
    turns = AttitudeHistory()
    assert [turns.add(t, np.eye(3), np.zeros(3)) for t in (0, 0, 5000 * MS, 0)] == [
        "", "duplicate", "", "time_not_forward"]


orders = st.permutations(range(12))


@given(orders)
def test_the_order_of_arrival_makes_no_difference(order):
    rng = np.random.default_rng(5)
    samples = [(20 * MS * k, rng.normal(size=3), rng.normal(size=3) * 200) for k in range(12)]
    early, late = MotionHistory(), MotionHistory()
    turns, late_turns = AttitudeHistory(), AttitudeHistory()
    for k in range(12):
        for motion, turn, (t_ns, p, v) in ((early, turns, samples[k]), (late, late_turns, samples[order[k]])):
            assert motion.add(t_ns, p, v) == turn.add(t_ns, exp_so3(p), v) == ""
    for t_ns in range(0, 260 * MS, 7 * MS):
        a, b, start_a, start_b = early.at(t_ns), late.at(t_ns), early.at(0), late.at(0)
        assert np.allclose(a.p_ned_m, b.p_ned_m)
        assert np.allclose(a.v_ned_m_s, b.v_ned_m_s)
        assert np.allclose(a.travel_m - start_a.travel_m, b.travel_m - start_b.travel_m)
        assert np.allclose(turns.at(t_ns).R_ned_body, late_turns.at(t_ns).R_ned_body)


@given(st.integers(0, 48), st.integers(1, 19), st.integers(0, 50))
def test_a_late_sample_does_not_move_what_anchors_were_measured_against(k, ms, anchor):
    h = filled()
    anchor_ns = (anchor * 20) * MS
    before = {t_ns: h.at(t_ns).travel_m for t_ns in (anchor_ns, 1000 * MS)}
    late_ns = (k * 20 + ms) * MS
    v = np.array([150.0, 30.0, -20.0])
    assert h.add(late_ns, np.zeros(3), v) == ""
    for t_ns, travel_m in before.items():
        if t_ns > late_ns:
            assert np.allclose(h.at(t_ns).travel_m, travel_m, rtol=0.0, atol=1e-11)
    # From an instant before the late sample the distance has the late velocity in it.
    start, end = h.at((k * 20) * MS), h.at(((k + 1) * 20) * MS)
    way = 0.5e-3 * (ms * (start.v_ned_m_s + v) + (20 - ms) * (v + end.v_ned_m_s))
    assert np.allclose(end.travel_m - start.travel_m, way)


def test_nothing_before_the_first_sample():
    h = MotionHistory()
    assert h.at(0) is None
    h.add(10 * MS, np.zeros(3), np.ones(3))
    assert h.at(9 * MS) is None
    assert AttitudeHistory().at(0) is None


def test_history_stays_bounded():
    h = MotionHistory(span_s=1.0)
    for k in range(5000):
        h.add(k * 20 * MS, np.zeros(3), np.zeros(3))
    assert len(h._samples) < 200


@given(st.floats(min_value=0.0, max_value=1.05), st.floats(min_value=-1.0, max_value=1.0))
def test_attitude_of_a_constant_rate_turn(t_s, rate):
    omega = np.array([rate, -0.5 * rate, 0.25])
    h = AttitudeHistory()
    for k in range(51):
        h.add(k * 20 * MS, exp_so3(omega * k * 0.02), omega)
    a = h.at(round(t_s * 1e9))
    assert np.linalg.norm(log_so3(a.R_ned_body.T @ exp_so3(omega * t_s))) < 1e-6
