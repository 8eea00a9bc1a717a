import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.path import CubicPath

PATH = CubicPath(5_000_000_000, np.array([-23.0, -20.0, 21.0]), np.zeros(3), 50.0)
inside = st.floats(5.001, 54.999)


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
