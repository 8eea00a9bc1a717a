"""Law velocity: against a velocity loop of its own kind, whatever the box does."""

from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, rotation_from_euler
from companion.guidance.laws import make_law
from companion.guidance.path import station
from companion.guidance.velocity_law import INTEGRAL_MAX_M_S, VelocityLaw
from companion.messages import RelativeState, VelocitySetpoint

THERE = station(np.zeros(3))
DT_S = 0.02
LOOP_PER_S = 2.5


@cache
def config():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml").config.guidance


def state(e_m, v_ned, box_v, box_a, heading_rad=0.0, t_ns=0):
    R = rotation_from_euler(heading_rad, 0.0, 0.0)
    return RelativeState(
        t_ns, t_ns, R.T @ e_m, R.T @ (v_ned - box_v), box_v, box_a, np.eye(3), np.zeros(3), heading_rad, 0.0,
        SE3.identity(), 20.0, 1.0, 9, np.zeros((3, 3)),
    )


def chase(law, seconds, e_m, heading_rad=0.0, upset=(0.0, 0.0, 0.0), swing=0.0):
    """Fly a velocity loop with lag behind a box that swings; return the error (n, 3) in ned."""
    box_p, p = np.zeros(3), np.array(e_m, float)
    v = np.array([200.0, 0.0, 0.0])
    track = []
    for k in range(round(seconds / DT_S)):
        w = 1.5
        box_v = np.array([200.0, swing * np.sin(w * k * DT_S), 0.5 * swing * np.sin(w * k * DT_S)])
        box_a = np.array([0.0, swing * w * np.cos(w * k * DT_S), 0.5 * swing * w * np.cos(w * k * DT_S)])
        s = law.step(state(p - box_p, v, box_v, box_a, heading_rad), THERE)
        a = np.array(s.a_ned_m_s2) + LOOP_PER_S * (np.array(s.v_ned_m_s) - v) + upset
        v, p, box_p = v + DT_S * a, p + DT_S * v, box_p + DT_S * box_v
        track.append(p - box_p)
    return np.array(track)


def test_the_configuration_names_it():
    law = make_law(load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml").airframe,
                   msgspec.structs.replace(config(), law="velocity"))
    assert isinstance(law, VelocityLaw)


@settings(max_examples=5, deadline=None)
@given(st.floats(-3, 3), st.tuples(*[st.floats(-3.5, 3.5)] * 3))
def test_it_arrives_at_any_heading_without_swinging_past(heading, start):
    track = chase(VelocityLaw(config()), 60.0, start, heading)
    assert np.abs(track[-1]).max() < 0.05
    back = rotation_from_euler(heading, 0.0, 0.0)
    mrf, first = track @ back, back.T @ np.array(start)
    assert (mrf * -np.sign(first)).max() < 0.1 + 0.1 * np.abs(first).max()


def test_a_swinging_box_is_followed_by_its_acceleration():
    followed = chase(VelocityLaw(config()), 30.0, np.zeros(3), swing=0.5)
    assert np.abs(followed[-500:]).max() < 0.02  # the box itself goes 0.33 m to either side


def test_what_upsets_the_velocity_loop_for_long_is_taken_out():
    quick = msgspec.structs.replace(config(), velocity=msgspec.structs.replace(
        config().velocity, integral_per_s2=(0.1, 0.1, 0.1)))
    track = chase(VelocityLaw(quick), 60.0, np.zeros(3), upset=np.array([0.1, -0.2, 0.2]))
    assert np.abs(track).max() > 0.05
    assert np.abs(track[-1]).max() < 0.01


def test_from_afar_it_asks_for_a_bounded_speed_and_does_not_wind_up():
    law = VelocityLaw(config())
    for _ in range(2000):
        s = law.step(state(np.array([-500.0, 300.0, 200.0]), np.array([200.0, 0, 0]), np.array([200.0, 0, 0]),
                           np.zeros(3)), THERE)
    closing = np.array(s.v_ned_m_s) - [200.0, 0.0, 0.0]
    assert np.linalg.norm(closing) < 4.0 * 2.0
    assert not law.integral_m_s.any()
    for _ in range(20_000):
        law.step(state(np.ones(3), np.array([200.0, 0, 0]), np.array([200.0, 0, 0]), np.zeros(3)), THERE)
    assert (np.abs(law.integral_m_s) * config().velocity.integral_per_s2 <= INTEGRAL_MAX_M_S + 1e-9).all()


def test_reset_forgets():
    law = VelocityLaw(config())
    off = state(np.ones(3), np.array([200.0, 0, 0]), np.array([200.0, 0, 0]), np.zeros(3))
    first = [law.step(off, THERE) for _ in range(5)]
    assert isinstance(first[0], VelocitySetpoint)
    assert first[-1].v_ned_m_s != pytest.approx(first[0].v_ned_m_s, abs=1e-6)
    law.reset()
    assert [law.step(off, THERE) for _ in range(5)] == first
