from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.aero.planforms import ICE_CG_BEHIND_NOSE_M, TAIL_M
from sim_bridge.plant.bow_wave import BETA, LENGTH_M, NOSE_X_M, SECTION_M2, bow_wave, bow_wave_m_s, lift_vortices

SPEED = 205.7
FINE = lift_vortices(10, 16)
points = st.tuples(st.floats(-5, 40), st.floats(-20, 20), st.floats(-20, 20))


@given(points, st.floats(-0.1, 0.2))
def test_bow_wave_is_symmetric(p: tuple[float, float, float], alpha: float) -> None:
    right = bow_wave_m_s(p, SPEED, alpha)
    left = bow_wave_m_s((p[0], -p[1], p[2]), SPEED, alpha)
    np.testing.assert_allclose(right, (left[0], -left[1], left[2]), atol=1e-9)
    assert np.all(np.isfinite(right))


@given(points)
def test_bow_wave_goes_with_speed(p: tuple[float, float, float]) -> None:
    once, twice = bow_wave_m_s(p, SPEED, 0.06), bow_wave_m_s(p, 2 * SPEED, 0.06)
    np.testing.assert_allclose(twice, 2 * np.array(once), rtol=1e-12)


def flux(x_m: float, radius_m: float = 30.0, n: int = 4000) -> float:
    """Return the linearised mass flux forward through the plane x and out of the cylinder ahead of it, over rho V."""
    r = (np.arange(n) + 0.5) * radius_m / n
    through = sum(BETA**2 * bow_wave_m_s((x_m, ri, 0.0), 1.0, 0.0)[0] * ri for ri in r) * 2 * math.pi * radius_m / n
    x = x_m + radius_m * np.sinh((np.arange(n) + 0.5) * 6.0 / n)
    dx = radius_m * np.cosh((np.arange(n) + 0.5) * 6.0 / n) * 6.0 / n
    out = sum(bow_wave_m_s((xi, radius_m, 0.0), 1.0, 0.0)[1] * di for xi, di in zip(x, dx, strict=True))
    return -through + 2 * math.pi * radius_m * out


def test_air_is_displaced_by_what_the_body_is_thick() -> None:
    # All that the sources ahead of the widest section give off is that section (times V); inside the skin the velocity
    # is held, which is the small rest.
    assert flux(NOSE_X_M - 0.5 * LENGTH_M) == pytest.approx(SECTION_M2, rel=0.02)
    assert flux(NOSE_X_M + 3.0) == pytest.approx(0.0, abs=0.01)


def test_far_ahead_the_body_is_a_doublet_of_its_volume() -> None:
    far = 400.0
    volume = SECTION_M2 * LENGTH_M * 2 / 3
    u = bow_wave_m_s((NOSE_X_M - LENGTH_M / 2 + far, 0.0, 0.0), 1.0, 0.0)[0]
    assert u == pytest.approx(2 * volume / (4 * math.pi * far**3), rel=0.01)


@given(st.tuples(st.floats(-3, 25), st.floats(-6, 6), st.floats(-12, -2.5)))
def test_lift_is_that_of_a_finer_lattice(p: tuple[float, float, float]) -> None:
    clean = np.array(bow_wave_m_s(p, SPEED, 0.0))
    coarse = np.array(bow_wave_m_s(p, SPEED, 0.064)) - clean
    fine = np.array(bow_wave(*p, SPEED, math.sin(0.064), FINE)) - clean
    # of up to 5 m/s
    assert np.abs(coarse - fine).max() < 0.6


def test_body_is_that_of_the_planform() -> None:
    assert NOSE_X_M == ICE_CG_BEHIND_NOSE_M
    assert LENGTH_M == TAIL_M


def test_nose_pushes_air_ahead_and_up_over_it() -> None:
    u, v, w = bow_wave_m_s((NOSE_X_M + 1.0, 0.0, -1.5), SPEED, 0.064)
    assert u > 1.0
    assert w < -1.0
    assert abs(v) < 1e-12


def test_air_above_the_receptacle_is_fast_and_follows_the_skin() -> None:
    u, _, w = bow_wave_m_s((2.0, 0.0, -2.0), SPEED, 0.064)
    assert -20.0 < u < -5.0
    # The stream comes from below at V sin(alpha); near the wing it has to go along it, but for what the body widens.
    assert 0.0 < w < SPEED * math.sin(0.064)
