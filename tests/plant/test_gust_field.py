from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.signal import welch

from sim_bridge.plant.gusts import SCALE_M, SIGMA_M_S, SPACING_M, GustField, shaping_filters


@pytest.mark.parametrize("distance_m", [0.0, 10.0, 300.0, 1500.0])
def test_filters_have_the_covariances_of_dryden(distance_m: float) -> None:
    sigma = SIGMA_M_S["light"]
    F, G, C = shaping_filters(sigma)
    covariance = C @ expm(F * distance_m) @ solve_continuous_lyapunov(F, -G @ G.T) @ C.T
    fall = math.exp(-distance_m / SCALE_M)
    across = fall * (1.0 - 0.5 * distance_m / SCALE_M)
    np.testing.assert_allclose(covariance, sigma**2 * np.diag([fall, across, across]), atol=1e-12)


def test_spectra_of_the_field_are_those_of_mil_f_8785c() -> None:
    field = GustField("light", np.random.default_rng(3))
    for _ in range(15):
        field.extend()
    _, uvw = field.samples()
    sigma = SIGMA_M_S["light"]
    frequency, power = welch(uvw, fs=1.0 / SPACING_M, nperseg=8192, axis=0)
    omega = 2 * math.pi * frequency
    lw = (SCALE_M * omega) ** 2
    along = sigma**2 * 2 * SCALE_M / math.pi / (1 + lw)
    across = sigma**2 * SCALE_M / math.pi * (1 + 3 * lw) / (1 + lw) ** 2
    for axis, expected in ((0, along), (1, across), (2, across)):
        # Octave bands from well below to well above the corner; aliasing begins beyond 0.5 rad/m.
        for low in 0.0008 * 2.0 ** np.arange(8):
            band = (omega >= low) & (omega < 2 * low)
            ratio = power[band, axis].mean() / (2 * math.pi) / expected[band].mean()
            assert 0.8 < ratio < 1.25, (axis, low, ratio)


def test_axes_are_independent_and_as_strong_as_they_should_be() -> None:
    field = GustField("moderate", np.random.default_rng(8))
    for _ in range(15):
        field.extend()
    covariance = np.cov(field.samples()[1].T) / SIGMA_M_S["moderate"] ** 2
    np.testing.assert_allclose(covariance, np.eye(3), atol=0.12)


def test_field_does_not_depend_on_when_it_is_asked() -> None:
    one, other = (GustField("severe", np.random.default_rng(5)) for _ in range(2))
    far = one.at(150e3)
    near = one.at(12.3)
    assert other.at(12.3) == near
    assert other.at(150e3) == far


def test_air_is_continuous_across_the_blocks() -> None:
    field = GustField("severe", np.random.default_rng(6))
    track = np.arange(60e3, 68e3, 1.0)
    steps = np.abs(np.diff([field.at(s) for s in track], axis=0))
    assert steps.max() < 6 * SIGMA_M_S["severe"] * math.sqrt(3.0 / SCALE_M)


def test_unknown_turbulence_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="'windy' is unknown; use one of none, light, moderate, severe"):
        GustField("windy", np.random.default_rng(0))
