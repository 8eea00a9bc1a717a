"""The box observer on a tanker that flies straight or round in circles, with and without wind."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.estimation.box_motion import BoxObserver
from companion.geometry import rotation_from_euler

BOX = np.array([-27.0, 0.0, 8.0])
G = 9.80665
DT_NS = 40_000_000


def circling(t_s, bank_rad, speed_m_s=205.7, wind=(0.0, 0.0), heading_rad=0.4):
    """Return centre velocity, attitude, body rates, box velocity and acceleration of a coordinated level turn."""
    turn = G * math.tan(bank_rad) / speed_m_s
    yaw = heading_rad + turn * t_s
    R = rotation_from_euler(yaw, 0.0, bank_rad)
    omega_ned = np.array([0.0, 0.0, turn])
    v = speed_m_s * np.array([math.cos(yaw), math.sin(yaw), 0.0]) + [*wind, 0.0]
    lever = R @ BOX
    v_box = v + np.cross(omega_ned, lever)
    a_centre = speed_m_s * turn * np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    return v, R, R.T @ omega_ned, v_box, a_centre + np.cross(omega_ned, np.cross(omega_ned, lever)), yaw, turn


def watch(seconds, bank_rad, noise=None, **course):
    observer = BoxObserver(BOX)
    for k in range(round(seconds * 1e9 / DT_NS)):
        v, R, omega, *_ = circling(k * DT_NS * 1e-9, bank_rad, **course)
        observer.update(k * DT_NS, v + (0.0 if noise is None else noise.normal(0, 0.04, 3)), R, omega)
    return observer, k * DT_NS


@settings(max_examples=6, deadline=None)
@given(st.floats(-0.35, 0.35), st.floats(-20, 20), st.floats(-20, 20), st.floats(-3, 3))
def test_a_steady_turn_is_seen_as_it_is_in_any_wind(bank_rad, north, east, heading_rad):
    course = {"wind": (north, east), "heading_rad": heading_rad}
    observer, t_ns = watch(20.0, bank_rad, **course)
    t_ns += 70_000_000  # the link is that late
    got = observer.at(t_ns)
    _, _, _, v_box, a_box, yaw, turn = circling(t_ns * 1e-9, bank_rad, **course)
    np.testing.assert_allclose(got.v_ned_m_s, v_box, atol=0.02)
    np.testing.assert_allclose(got.a_ned_m_s2, a_box, atol=0.02)
    # The course turns at the same mean rate as the nose, faster with the wind on one side and slower on the other.
    assert got.turn_rate_rad_s == pytest.approx(turn, abs=0.003 * math.hypot(north, east) / 20 + 2e-4)
    assert abs(math.remainder(got.heading0_rad - yaw, 2 * math.pi)) < 0.04


def test_noise_of_the_reports_is_halved():
    observer, _ = watch(5.0, 0.0)
    rng = np.random.default_rng(0)
    errors = []
    for k in range(125, 1500):
        v, R, omega, v_box, *_ = circling(k * DT_NS * 1e-9, 0.0)
        observer.update(k * DT_NS, v + rng.normal(0, 0.04, 3), R, omega)
        errors.append(observer.at(k * DT_NS).v_ned_m_s - v_box)
    assert np.std(errors, axis=0).max() < 0.02


def test_yaw_in_a_gust_moves_the_box_and_not_the_frame():
    observer = BoxObserver(BOX)
    late = []
    for k in range(1500):
        t = k * DT_NS * 1e-9
        yaw, rate = 0.005 * math.sin(1.2 * t), 0.006 * math.cos(1.2 * t)
        observer.update(k * DT_NS, np.array([205.7, 0.0, 0.0]), rotation_from_euler(yaw, 0, 0), np.array([0, 0, rate]))
        got = observer.at(k * DT_NS)
        if k > 250:
            late.append((got.v_ned_m_s[1] + 27.0 * rate, got.heading0_rad))
    assert np.abs(late)[:, 0].max() < 0.01
    assert np.abs(late)[:, 1].max() < 0.001


def test_after_a_long_silence_it_starts_afresh():
    observer, t_ns = watch(5.0, 0.2)
    v, R, omega, v_box, *_ = circling(60.0, 0.2)
    observer.update(t_ns + 50_000_000_000, v, R, omega)
    np.testing.assert_allclose(observer.at(t_ns + 50_000_000_000).v_ned_m_s, v_box, atol=1e-9)


def test_the_observer_moves_in_time_with_the_reports():
    (observer, t_ns), (stepped, _) = watch(5.0, 0.2), watch(5.0, 0.2)
    stepped.shift(3_000_000_000)
    a, b = observer.at(t_ns + 50_000_000), stepped.at(t_ns + 3_050_000_000)
    assert (a.v_ned_m_s == b.v_ned_m_s).all()
    assert a.heading0_rad == b.heading0_rad
    assert not stepped.is_new(t_ns + 3_000_000_000)
