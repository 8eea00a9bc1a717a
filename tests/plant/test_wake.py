from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import AirframeConfig
from sim_bridge.plant.wake import CORE_M, SPAN_M, Receiver, Wake, circulation_m2_s, increments, velocity

WEIGHT, DENSITY, SPEED = 110e3 * 9.80665, 0.66, 205.7
places = st.tuples(st.floats(-120, -5), st.floats(-60, 60), st.floats(-30, 60))


@given(places)
def test_wake_is_symmetric(place: tuple[float, float, float]) -> None:
    x, y, z = place
    wake = Wake(WEIGHT, DENSITY, SPEED)
    right, left = wake.increments(x, y, z), wake.increments(x, -y, z)
    np.testing.assert_allclose(right[:3], left[:3], atol=1e-12)
    np.testing.assert_allclose(right[3:], [-v for v in left[3:]], atol=1e-12)


@settings(max_examples=30)
@given(places)
def test_velocity_is_biot_savart_of_the_horseshoe(place: tuple[float, float, float]) -> None:
    p = np.array(place)
    half = math.pi / 8 * SPAN_M
    gamma = circulation_m2_s(WEIGHT, DENSITY, SPEED)
    # Independent: short segments summed with the kernel of Rosenhead and Moore, whose integral along a straight line is
    # the smoothed core. Far aft on the left, forward, across to the right, far aft again.
    aft = -np.concatenate(([0.0], np.geomspace(0.05, 2e5, 6000)))
    zero = np.zeros_like(aft)
    right = np.column_stack((aft, zero + half, zero))
    left = np.column_stack((aft, zero - half, zero))[::-1]
    across = np.linspace(-half, half, 2001)
    bound = np.column_stack((0 * across, across, 0 * across))
    points = np.concatenate((left, bound[1:-1], right))
    dl = np.diff(points, axis=0)
    r = p - 0.5 * (points[1:] + points[:-1])
    kernel = ((r**2).sum(axis=1) + CORE_M**2) ** -1.5
    v = gamma / (4 * math.pi) * (np.cross(dl, r) * kernel[:, None]).sum(axis=0)
    np.testing.assert_allclose(velocity(*place, gamma), v[1:], atol=0.005)


def test_downwash_between_the_vortices_and_upwash_outside() -> None:
    gamma = circulation_m2_s(WEIGHT, DENSITY, SPEED)
    assert velocity(-30.0, 0.0, 0.0, gamma)[1] > 3.0
    assert velocity(-30.0, 30.0, 0.0, gamma)[1] < -1.0


def test_increments_are_small_and_smooth_round_the_box() -> None:
    wake = Wake(WEIGHT, DENSITY, SPEED)
    here = np.array(wake.increments(-29.0, 0.0, 9.0))
    assert here[0] > 0 > here[1]  # more drag, less lift
    assert np.abs(here).max() < 0.08
    for step in np.eye(3):
        there = np.array(wake.increments(*(np.array([-29.0, 0.0, 9.0]) + step)))
        assert np.abs(there - here).max() < 0.004


def test_wake_ends_far_away() -> None:
    assert max(abs(v) for v in Wake(WEIGHT, DENSITY, SPEED).increments(-100.0, 900.0, 900.0)) < 1e-4


def test_strips_roll_as_the_receiver_does() -> None:
    # A wake that turned like a rolling receiver would have to give its Clp: the strips' second moment says so.
    r = Receiver()
    assert -r.CL_alpha * 2 * (0.10**2 + 0.25**2) / 2 == pytest.approx(-0.158, abs=0.005)


def test_derivatives_of_the_receiver_are_those_of_the_airframe(airframe: AirframeConfig) -> None:
    r, trim = Receiver(), airframe.trim
    dynamic_pressure = 0.5 * 0.6601 * trim.airspeed_m_s**2
    z_alpha = -airframe.A[1][1] * airframe.mass_kg * trim.airspeed_m_s / (dynamic_pressure * 75.1)
    assert z_alpha == pytest.approx(r.CL_alpha, rel=0.02)
    assert r.CL * dynamic_pressure * 75.1 == pytest.approx(airframe.mass_kg * 9.80665, rel=0.03)
    assert airframe.A[5][2] / airframe.A[3][2] == pytest.approx(
        (r.Cn_beta / 110627) / (r.Cl_beta / 35479), rel=0.05
    )


def test_no_wake_without_lift() -> None:
    r = Receiver()
    fixed = (r.span_m, r.chord_m, r.CL, r.CL_alpha, r.Cm_alpha, r.Cm_q, r.Cl_beta, r.Cn_beta, r.CY_beta)
    assert all(v == 0 for v in increments(-30.0, 3.0, 8.0, 0.0, SPEED, fixed))
