import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.path import RAMP, Closure, CubicPath, Reference, closure, cubic, retreat, station

PATH = CubicPath(5_000_000_000, np.array([-23.0, -20.0, 21.0]), np.zeros(3), 50.0)
inside = st.floats(5.001, 54.999)
T0_NS = 3_000_000_000


def at(t_s):
    return PATH.at(round(t_s * 1e9))


@given(inside)
def test_velocity_and_acceleration_are_the_derivatives_of_position(t_s):
    h = 1e-4
    assert np.allclose((at(t_s + h).p_m - at(t_s - h).p_m) / (2 * h), at(t_s).v_m_s, atol=1e-5)
    assert np.allclose((at(t_s + h).v_m_s - at(t_s - h).v_m_s) / (2 * h), at(t_s).a_m_s2, atol=1e-3)


@given(inside)
def test_it_stays_on_the_straight_line_and_never_turns_back(t_s):
    way = PATH.end_m - PATH.start_m
    s = (at(t_s).p_m - PATH.start_m) @ way / (way @ way)
    assert 0.0 <= s <= 1.0
    assert np.allclose(at(t_s).p_m, PATH.start_m + s * way, atol=1e-9)
    assert at(t_s).v_m_s @ way >= 0.0


def test_at_rest_at_both_ends_and_done():
    for t_s, p in ((0.0, PATH.start_m), (5.0, PATH.start_m), (55.0, PATH.end_m), (80.0, PATH.end_m)):
        r = at(t_s)
        assert np.allclose(r.p_m, p)
        assert np.allclose(r.v_m_s, 0.0)
    assert not PATH.done(54_999_999_999)
    assert PATH.done(55_000_000_000)


points = st.tuples(st.floats(-60.0, -0.5), st.floats(-30.0, 30.0), st.floats(0.0, 40.0)).map(np.array)
closings = st.builds(
    Closure, far_m_s=st.floats(0.3, 2.0), near_m_s=st.floats(0.05, 0.3), near_m=st.floats(0.2, 10.0),
    peak_m_s2=st.floats(0.05, 0.5),
)


@given(points, points, st.floats(0.3, 3.0), st.floats(0.1, 1.0), st.floats(0.5, 60.0))
def test_a_cubic_takes_as_long_as_its_limits_ask_for_and_no_longer(start, end, peak_m_s, peak_m_s2, least_s):
    path = cubic(T0_NS, start, end, peak_m_s, peak_m_s2, least_s)
    way_m = np.linalg.norm(end - start)
    fastest, hardest = 1.5 * way_m / path.duration_s, 6.0 * way_m / path.duration_s**2
    assert fastest <= peak_m_s * (1 + 1e-9)
    assert hardest <= peak_m_s2 * (1 + 1e-9)
    assert path.duration_s == least_s or max(fastest / peak_m_s, hardest / peak_m_s2) > 1 - 1e-9


def sampled(path, t0_ns=T0_NS, n=300):
    """Return times, positions, velocities and accelerations over a path and a little beyond."""
    t_ns = np.linspace(t0_ns, t0_ns + (path.duration_s + 0.5) * 1e9, n).astype(np.int64)
    refs = [path.at(int(t)) for t in t_ns]
    return (t_ns - t0_ns) * 1e-9, *(np.array([getattr(r, k) for r in refs]) for k in ("p_m", "v_m_s", "a_m_s2"))


def check_motion(path, peak_m_s2):
    """Check that position, velocity and acceleration belong together, without steps, within the peak acceleration."""
    t, p, v, a = sampled(path)
    dt = t[1] - t[0]
    assert np.linalg.norm(a, axis=1).max() <= peak_m_s2 * (1 + 1e-9)
    assert np.linalg.norm(p[1:] - p[:-1] - 0.5 * (v[1:] + v[:-1]) * dt, axis=1).max() <= 0.25 * peak_m_s2 * dt**2 + 1e-9
    assert np.linalg.norm(v[1:] - v[:-1], axis=1).max() <= peak_m_s2 * dt * (1 + 1e-6)
    shortest = min((s.duration_s for s in path.spells if s.v0_m_s != s.v1_m_s), default=math.inf)
    # A ramp's acceleration rises as 6 s (1 - s) of its mean: the jerk is at most 6 means in its length.
    assert np.abs(a[1:] - a[:-1]).max() <= 6.0 * peak_m_s2 / RAMP / shortest * dt * (1 + 1e-6) + 1e-9
    return t, p, v, a


@given(points, closings)
def test_a_closure_ends_at_rest_in_the_box_without_a_step_on_the_straight_line(start, closing):
    path = closure(T0_NS, start, closing)
    _, p, v, _ = check_motion(path, closing.peak_m_s2)
    assert np.array_equal(p[0], start)
    assert np.linalg.norm(v[0]) == 0.0
    assert np.abs(p[-1]).max() < 1e-9
    assert np.linalg.norm(v[-1]) == 0.0
    assert path.done(T0_NS + math.ceil(path.duration_s * 1e9))
    assert not path.done(T0_NS + math.floor(path.duration_s * 1e9) - 1)
    off = np.linalg.norm(np.cross(p, start), axis=1) / np.linalg.norm(start)
    assert off.max() < 1e-9
    assert np.diff(np.linalg.norm(p, axis=1)).max() < 1e-12  # never away again


@given(points, closings)
def test_a_closure_keeps_its_speeds_far_and_near(start, closing):
    _, p, v, _ = sampled(closure(T0_NS, start, closing))
    speed, range_m = np.linalg.norm(v, axis=1), np.linalg.norm(p, axis=1)
    assert speed.max() <= closing.far_m_s * (1 + 1e-9) or speed.max() <= closing.near_m_s * (1 + 1e-9)
    assert speed[range_m <= closing.near_m - 1e-9].max(initial=0.0) <= closing.near_m_s * (1 + 1e-9)


def test_a_long_closure_is_as_fast_as_it_may():
    closing = Closure(0.5, 0.2, 3.0, 0.2)
    path = closure(T0_NS, np.array([-15.0, 0.0, 5.0]), closing)
    _, p, v, _ = sampled(path)
    speed, range_m = np.linalg.norm(v, axis=1), np.linalg.norm(p, axis=1)
    assert speed.max() == pytest.approx(0.5)
    assert speed[(range_m < 2.9) & (range_m > 0.3)] == pytest.approx(0.2)
    ramps_s = 0.5 * RAMP / 0.2 * (0.5 + 0.3 * 0.3 / 0.5 + 0.2)
    assert path.duration_s == pytest.approx(12.81 / 0.5 + 3.0 / 0.2 + ramps_s, abs=0.1)


@given(closings, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_retreat_goes_on_from_where_the_reference_is_and_comes_to_rest_at_its_end(closing, part, share):
    to = np.array([-15.0, 0.0, 5.0])
    along = -to / np.linalg.norm(to)
    # At rest at the end, and no faster anywhere than what can be braked before the box.
    left_m = (1.0 - part) * np.linalg.norm(to)
    speed = share * min(closing.far_m_s, math.sqrt(2.0 * closing.peak_m_s2 / RAMP * left_m))
    now = Reference(part * -to + to, along * speed, np.zeros(3))
    path = retreat(T0_NS, now, to, closing)
    _, p, v, _ = check_motion(path, closing.peak_m_s2)
    assert np.allclose(p[0], now.p_m, atol=1e-9)
    assert np.allclose(v[0], now.v_m_s, atol=1e-9)
    assert np.allclose(p[-1], to, atol=1e-6)
    assert np.linalg.norm(v[-1]) == 0.0
    assert (p @ along).max() <= 1e-6  # never past the box
    back = v @ along
    assert np.all(np.diff(np.sign(back[np.abs(back) > 1e-9])) <= 0.0)  # brakes, then backs off, and never forward again
    near = (np.linalg.norm(p, axis=1) <= closing.near_m - 1e-6) & (back < 0.0)
    assert np.abs(back[near]).max(initial=0.0) <= closing.near_m_s + 1e-6
    assert np.abs(back).max(initial=0.0) <= max(speed, closing.far_m_s, closing.near_m_s) + 1e-9


def test_a_retreat_from_the_box_is_slow_at_first():
    path = retreat(T0_NS, station(np.zeros(3)), np.array([-15.0, 0.0, 5.0]), Closure(0.5, 0.2, 3.0, 0.2))
    _, p, v, _ = sampled(path)
    speed, range_m = np.linalg.norm(v, axis=1), np.linalg.norm(p, axis=1)
    assert speed[range_m < 3.0].max() == pytest.approx(0.2)
    assert speed.max() == pytest.approx(0.5)


def test_before_its_start_a_path_stands_still():
    start = np.array([-15.0, 0.0, 5.0])
    r = closure(T0_NS, start, Closure(0.5, 0.2, 3.0, 0.2)).at(T0_NS - 1)
    assert np.array_equal(r.p_m, start)
    assert not r.v_m_s.any()
