from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.signal import welch

from sim_bridge.plant.gust_spectra import draw_spectra, dryden_spectra
from sim_bridge.plant.gusts import (
    K_RANGE,
    SIGMA_M_S,
    WAVES,
    GustField,
    energy_share_below,
    roll_variance_below,
    shell_edges,
)

Array = NDArray[np.float64]
L, SIGMA = 533.4, 1.13
SPAN = {"ice101": 11.43, "kc135r": 39.88}


def phi_u(omega: Array) -> Array:
    return SIGMA**2 * 2 * L / math.pi / (1 + (L * omega) ** 2)


def phi_w(omega: Array) -> Array:
    x = (L * omega) ** 2
    return SIGMA**2 * L / math.pi * (1 + 3 * x) / (1 + x) ** 2


def phi_p(omega: Array, b: float) -> Array:
    return SIGMA**2 / L * 0.8 * (math.pi * L / 4 / b) ** (1 / 3) / (1 + (4 * b * omega / math.pi) ** 2)


def expected(omega: Array, b: float) -> Array:
    """MIL-F-8785C: one-sided spectra of u, v, w, p, q, r as rows."""
    q = omega**2 / (1 + (4 * b * omega / math.pi) ** 2) * phi_w(omega)
    r = omega**2 / (1 + (3 * b * omega / math.pi) ** 2) * phi_w(omega)
    return np.array([phi_u(omega), phi_w(omega), phi_w(omega), phi_p(omega, b), q, r])


def track(field: GustField, heading: float, n: int, step_m: float, b: float, slope: float = 0.0) -> Array:
    """Gusts (n, 6) along a straight line: velocity along, right and down, then p, q, r."""
    c, s = math.cos(heading), math.sin(heading)
    rows = np.array([field.at(300 + c * x, -700 + s * x, slope * x, c, s, b) for x in step_m * np.arange(n)])
    north, east = rows[:, 0].copy(), rows[:, 1].copy()
    rows[:, 0], rows[:, 1] = north * c + east * s, east * c - north * s
    return rows


def fields(n: int, first: int = 0, turbulence: str = "light") -> list[GustField]:
    return [GustField(turbulence, np.random.default_rng(first + s)) for s in range(n)]


def band_ratios(rows: Array, step_m: float, b: float, edges: Array) -> Array:
    """Power of each axis over the formula's in each band: (6, bands), from Welch's periodogram."""
    frequency, power = welch(rows, fs=1.0 / step_m, nperseg=8192, axis=0)
    omega = 2 * math.pi * frequency
    reference = expected(omega, b)
    bands = [(omega >= low) & (omega < high) for low, high in itertools.pairwise(edges)]
    return np.array(
        [[power[k, axis].sum() / (2 * math.pi) / reference[axis, k].sum() for k in bands] for axis in range(6)]
    )


@pytest.mark.parametrize(("aircraft", "heading"), [("ice101", 0.0), ("kc135r", 2.2)])
def test_spectra_are_those_of_mil_f_8785c_on_any_heading(aircraft: str, heading: float) -> None:
    """Welch's periodograms over 66 km of 20 fields, octaves of 1e-3..0.26 rad/m.

    The mean over the fields lies within four of its own standard errors and 3 % (leakage of the window, the field's end
    at 3 rad/m, aliasing from 1.5 rad/m) of the formula; that standard error is 2 to 5 %, up to 11 % in the three lowest
    octaves, where 66 km are few wavelengths and p has few waves.
    """
    edges = 1e-3 * 2.0 ** np.arange(9)
    step_m, b = 2.0, SPAN[aircraft]
    ratios = np.array([band_ratios(track(f, heading, 32768, step_m, b), step_m, b, edges) for f in fields(20)])
    error = ratios.std(axis=0, ddof=1) / math.sqrt(len(ratios))
    assert error.max() < 0.12
    assert error[:, 3:].max() < 0.06
    off = np.abs(ratios.mean(axis=0) - 1.0)
    assert (off < 4.0 * error + 0.03).all(), np.round(ratios.mean(axis=0), 3)
    # One field alone is a fair sample of the formula already, where aircraft and pilots feel it.
    assert ratios[:, :, 3:].std(axis=0).max() < 0.3


@pytest.mark.parametrize("b", SPAN.values())
def test_picture_has_the_same_formulas_as_these_tests(b: float) -> None:
    omega = np.geomspace(1e-4, 1.0, 30)
    np.testing.assert_allclose(dryden_spectra(omega, SIGMA, b), expected(omega, b), rtol=1e-12)


@pytest.mark.slow
def test_picture_is_drawn() -> None:
    figure = draw_spectra("severe", range(1))
    for ax in figure.axes[:3]:
        field, formula = (np.log(line.get_xydata()) for line in ax.lines[:2])
        assert np.abs(field[:, 1] - np.interp(field[:, 0], formula[:, 0], formula[:, 1])).max() < 1.5


def test_one_field_has_the_variances() -> None:
    """Sums over the waves themselves: the mean square of an endless flight on a heading."""
    for seed in range(10):
        field = GustField("severe", np.random.default_rng(100 + seed))
        waves = field._with_p(SPAN["ice101"])
        sigma = SIGMA_M_S["severe"]
        for heading in (0.0, 1.0, 2.5):
            c, s = math.cos(heading), math.sin(heading)
            for amplitude in (waves[4] * c + waves[5] * s, waves[5] * c - waves[4] * s, waves[6]):
                assert (0.5 * amplitude**2).sum() / sigma**2 == pytest.approx(1.0, abs=0.02)
        p_variance = (0.5 * (waves[7] ** 2 + waves[8] ** 2)).sum() * (SIGMA / sigma) ** 2
        whole = quad(lambda o: float(phi_p(np.float64(o), SPAN["ice101"])), 0.0, np.inf)[0]
        # The end at 3 rad/m takes 2.9 % of a span of 11 m.
        assert p_variance / whole == pytest.approx(0.971, abs=0.002)


def test_velocities_at_two_places_are_correlated_as_in_isotropic_turbulence() -> None:
    """R_ij(r) = sigma^2 ((f - g) r_i r_j / r^2 + g delta_ij), f = exp(-r/L), g = f (1 - r / 2L), in every direction."""
    rng = np.random.default_rng(5)
    for r in (np.array([400.0, 0, 0]), np.array([0, 0, 250.0]), np.array([-200.0, 300, 100]), np.array([0, 36.0, 0])):
        products = []
        for field in fields(12, first=200):
            places = rng.uniform(-50e3, 50e3, (800, 3))
            here = np.array([field.at(*x, 1.0, 0.0, 11.43)[:3] for x in places])
            there = np.array([field.at(*(x + r), 1.0, 0.0, 11.43)[:3] for x in places])
            products.append(here.T @ there / len(places))
        d = float(np.linalg.norm(r))
        f = math.exp(-d / L)
        g = f * (1 - d / (2 * L))
        tensor = SIGMA**2 * ((f - g) * np.outer(r, r) / d**2 + g * np.eye(3))
        error = np.std(products, axis=0, ddof=1) / math.sqrt(len(products))
        assert error.max() < 0.03 * SIGMA**2
        assert (np.abs(np.mean(products, axis=0) - tensor) < 4.5 * error + 0.005 * SIGMA**2).all()


def test_velocities_and_p_are_independent_of_each_other() -> None:
    """On one track; q and w too. r hangs together with v by its lag, as the specification has it, q with w."""
    correlations = [np.corrcoef(track(f, 0.7, 4096, 8.0, SPAN["ice101"]).T) for f in fields(16, first=300)]
    mean = np.mean(correlations, axis=0)
    error = np.std(correlations, axis=0, ddof=1) / 4.0
    for i, j in itertools.combinations(range(6), 2):
        if (i, j) in {(2, 4), (1, 5)}:
            continue
        assert abs(mean[i, j]) < 4.5 * error[i, j]
        assert error[i, j] < 0.05


def test_energy_of_the_shells_follows_from_the_spectra() -> None:
    """E(k) = k^3/2 d/dk (1/k dPhi_u/dk), worked out by hand here, and -k dPhi_p/dk; both integrated numerically."""

    def energy(k: float) -> float:
        x = L * k
        return SIGMA**2 * 8 * L / math.pi * x**4 / (1 + x**2) ** 3

    def roll_energy(k: float, b: float = 39.88, h: float = 1e-6) -> float:
        return -k * float(phi_p(np.float64(k + h), b) - phi_p(np.float64(k - h), b)) / (2 * h)

    for low, high in ((2e-4, 1e-3), (1e-3, 1e-2), (1e-2, 0.3)):
        ends = np.array([low, high])
        share = np.diff(energy_share_below(ends))[0]
        assert share == pytest.approx(quad(energy, low, high)[0] / (1.5 * SIGMA**2), rel=1e-6)
        variance = np.diff(roll_variance_below(ends, SIGMA, 39.88))[0]
        assert variance == pytest.approx(quad(roll_energy, low, high)[0], rel=1e-4)
    assert energy_share_below(np.array([1e6]))[0] == pytest.approx(1.0, abs=1e-6)
    outside = 1.0 - np.diff(energy_share_below(np.array(K_RANGE)))[0]
    assert outside < 2e-3
    edges = shell_edges(WAVES)
    assert (np.diff(edges) > 0).all()
    np.testing.assert_allclose(edges[[0, -1]], K_RANGE)


def test_air_is_free_of_divergence_and_turns_as_q_r_say() -> None:
    """Slopes of the velocity by differences; q and r of an aircraft of no span are the slopes themselves."""
    h, field = 0.01, GustField("moderate", np.random.default_rng(4))
    heading = 0.4
    c, s = math.cos(heading), math.sin(heading)
    for place in np.random.default_rng(1).uniform(-5e3, 5e3, (20, 3)):
        J = np.empty((3, 3))
        for j, e in enumerate(np.eye(3) * h):
            ahead, behind = (np.array(field.at(*(place + k * e), c, s, 0.001)[:3]) for k in (1, -1))
            J[:, j] = (ahead - behind) / (2 * h)
        assert abs(np.trace(J)) < 1e-3 * np.abs(J).max()
        R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
        slopes = R @ J @ R.T  # forward, right, down
        _, _, _, _, q, r = field.at(*place, c, s, 0.001)
        assert q == pytest.approx(-slopes[2, 0], abs=3e-3 * np.abs(J).max())
        assert r == pytest.approx(slopes[1, 0], abs=3e-3 * np.abs(J).max())


def test_sum_is_that_of_the_waves() -> None:
    """The compiled sum beside the definition, written with numpy and complex numbers."""
    field, b = GustField("severe", np.random.default_rng(9)), 39.88
    w = field._with_p(b)
    for x, heading in ((np.zeros(3), 0.0), (np.array([37e3, -21e3, 140.0]), 2.9), (np.array([-1.0, 2.0, 3.0]), -1.1)):
        c, s = math.cos(heading), math.sin(heading)
        wave = np.exp(2j * math.pi * (w[3] + x @ w[:3]))
        omega = 2 * math.pi * (c * w[0] + s * w[1])
        u = (w[4:7] @ wave).real
        right = c * w[5] - s * w[4]
        p = ((w[7] + 1j * w[8]) @ wave).real
        q = -(w[6] * 1j * omega / (1 + 4j * b * omega / math.pi) @ wave).real
        r = (right * 1j * omega / (1 + 3j * b * omega / math.pi) @ wave).real
        np.testing.assert_allclose(field.at(*x, c, s, b), [*u, p, q, r], atol=1e-8)


def test_gusts_are_gaussian() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(-1e5, 1e5, (500, 3))
    rows = np.array([f.at(*x, 1.0, 0.0, 11.43) for f in fields(60, first=500) for x in places])
    rows = (rows - rows.mean(axis=0)) / rows.std(axis=0)
    np.testing.assert_allclose((rows**4).mean(axis=0), 3.0, atol=0.12)  # 3 sqrt(24/30000) is 0.085
    np.testing.assert_allclose((rows**3).mean(axis=0), 0.0, atol=0.06)
    # One field at many places, too: no few waves stand out.
    field = fields(1)[0]
    alone = np.array([field.at(*x, 1.0, 0.0, 11.43) for x in rng.uniform(-1e5, 1e5, (2000, 3))])
    alone = (alone - alone.mean(axis=0)) / alone.std(axis=0)
    np.testing.assert_allclose((alone**4).mean(axis=0), 3.0, atol=0.45)


def test_follower_meets_nearly_what_the_leader_met() -> None:
    """On the same line the same later; 36 m beside it what two points 36 m apart have in common."""
    leader = GustField("light", np.random.default_rng(3))
    ahead = track(leader, 0.0, 3000, 1.0, 39.88)
    same = track(leader, 0.0, 3000, 1.0, 39.88)
    np.testing.assert_array_equal(ahead, same)
    beside = np.array([leader.at(300 + x, -680, 30, 1.0, 0.0, 11.43) for x in np.arange(3000.0)])
    assert 0.05 < np.std(ahead[:, 2] - beside[:, 2]) < 0.6 * SIGMA


def test_same_seed_same_bits_and_order_does_not_matter() -> None:
    one, other = (GustField("severe", np.random.default_rng(5)) for _ in range(2))
    far, near = one.at(150e3, 10.0, -4.0, 1.0, 0.0, 39.88), one.at(12.3, 0.0, 0.0, 0.6, 0.8, 11.43)
    assert other.at(12.3, 0.0, 0.0, 0.6, 0.8, 11.43) == near
    assert other.at(150e3, 10.0, -4.0, 1.0, 0.0, 39.88) == far
    assert GustField("severe", np.random.default_rng(6)).at(150e3, 10.0, -4.0, 1.0, 0.0, 39.88) != far


def test_field_turns_with_its_heading() -> None:
    heading, place = 1.3, np.array([500.0, -60.0, 20.0])
    c, s = math.cos(heading), math.sin(heading)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    straight = GustField("light", np.random.default_rng(8)).at(*place, 1.0, 0.0, 11.43)
    turned = GustField("light", np.random.default_rng(8), heading).at(*(R @ place), c, s, 11.43)
    np.testing.assert_allclose(turned[:3], R @ straight[:3], atol=1e-9)
    np.testing.assert_allclose(turned[3:], straight[3:], atol=1e-12)


def test_calm_air_does_not_move() -> None:
    field = GustField("none", np.random.default_rng(0))
    assert field.calm
    assert field.at(1.0, 2.0, 3.0, 1.0, 0.0, 11.43) == (0.0,) * 6


def test_unknown_turbulence_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="'windy' is unknown; use one of none, light, moderate, severe"):
        GustField("windy", np.random.default_rng(0))


@pytest.mark.bench
def test_cost_of_a_sample(benchmark: Callable[..., object]) -> None:
    field = GustField("light", np.random.default_rng(1))
    benchmark(field.at, 1.0, 2.0, 3.0, 0.6, 0.8, 11.43)
