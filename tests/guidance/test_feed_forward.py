"""What is fed forward, flown open loop on the airframe's own slopes; and the observer of what pushes."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, rotation_from_euler
from companion.guidance.disturbance import Disturbance
from companion.guidance.feed_forward import FeedForward, place
from companion.guidance.path import Reference, station
from companion.messages import RelativeState

DT_S = 0.02
G = 9.80665
small = st.floats(-2.0, 2.0)


@cache
def airframe():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml").airframe


def explained(pitch, roll, thrust, v_down):
    """Return forward, right and down acceleration of the airframe near trim."""
    return Disturbance(airframe(), (1.0, 1.0, 1.0), DT_S)._explained(v_down, (0.0, pitch, roll), thrust)


@given(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0), small, st.floats(-3.0, 3.0))
def test_what_is_asked_for_is_what_the_airframe_then_does(a_x, a_y, a_z, v_down):
    climb = -v_down / airframe().trim.airspeed_m_s
    (roll, pitch, thrust), _ = FeedForward(airframe(), DT_S).step(np.array([a_x, a_y, a_z]), climb)
    got = explained(airframe().trim.alpha_rad + pitch, roll, thrust, v_down)
    np.testing.assert_allclose(got[1:], [a_y, a_z], atol=0.05)
    assert got[0] == pytest.approx(a_x, abs=0.03 + 0.02 * abs(a_y))


@given(st.floats(0.05, 1.0))
def test_rates_are_those_of_a_ramp(slope):
    ahead = FeedForward(airframe(), DT_S)
    for k in range(150):
        now, rate = ahead.step(np.array([0.0, slope * k * DT_S, 0.0]), 0.0)
    assert rate[0] == pytest.approx(slope / G * math.cos(now[0]) ** 2, rel=0.1)


def state(p_m, turn_rad_s, v_box, a_box, heading_rad):
    return RelativeState(
        0, 0, np.asarray(p_m, float), np.zeros(3), np.asarray(v_box, float), np.asarray(a_box, float), np.eye(3),
        np.zeros(3), heading_rad, turn_rad_s, SE3.identity(), 20.0, 1.0, 9, np.zeros((3, 3)),
    )


@given(st.floats(-3, 3), st.floats(-0.02, 0.02), st.tuples(small, small, small))
def test_a_place_that_stands_in_a_turning_frame_goes_round_with_it(heading, turn, offset):
    """Velocity and acceleration of box + R(psi) p by differences, but for the centripetal term that is left out."""
    p, v_box = 10.0 * np.array(offset), np.array([200.0, 10.0, 0.0])
    reference = Reference(p, np.array([0.5, -0.3, 0.2]), np.array([0.1, 0.0, -0.1]))

    def where(t):
        R = rotation_from_euler(heading + turn * t, 0.0, 0.0)
        return v_box * t + R @ (p + reference.v_m_s * t + 0.5 * reference.a_m_s2 * t * t)

    h = 1e-3
    at = place(state(p, turn, v_box, np.zeros(3), heading), reference)
    np.testing.assert_allclose(at.v_ned_m_s, (where(h) - where(-h)) / (2 * h), atol=1e-4)
    acceleration = (where(h) - 2 * where(0.0) + where(-h)) / h**2
    np.testing.assert_allclose(at.a_ned_m_s2, acceleration, atol=turn**2 * 40.0 + 1e-3)


def test_a_place_that_moves_as_the_box_does_asks_for_nothing():
    at = place(state(np.zeros(3), 0.0, [205.7, 0.0, 0.0], np.zeros(3), 0.0), station(np.zeros(3)))
    now, rate = FeedForward(airframe(), DT_S).step(at.a_ned_m_s2, 0.0)
    np.testing.assert_allclose(now, 0.0, atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(st.tuples(small, small, small), st.floats(-3, 3), st.floats(-0.3, 0.3))
def test_a_push_is_learned_at_any_heading_and_bank(push, yaw, roll):
    """An aircraft with constant attitude and thrust: what it does beyond the model is the push."""
    observer = Disturbance(airframe(), (2.0, 3.0, 3.0), DT_S)
    trim = airframe().trim
    v = 205.7 * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    for _ in range(250):
        observer.step(v, (yaw, trim.alpha_rad, roll), 0.0, 0.1)
        own = rotation_from_euler(yaw, 0.0, 0.0) @ explained(trim.alpha_rad, roll, 0.1, float(v[2]))
        v = v + DT_S * (own + np.array(push))
    np.testing.assert_allclose(observer.d_ned_m_s2, push, atol=0.02)
    np.testing.assert_allclose(observer.v_ned_m_s, v - DT_S * (own + np.array(push)), atol=0.02)
