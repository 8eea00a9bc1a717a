"""The filter against its own assumptions (Monte Carlo), and against least squares over all measurements at once."""

import filter_scene as fs
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from companion.config import FilterConfig
from companion.estimation.filter_history import FilterHistory
from companion.estimation.filter_measurements import GpsDifference
from companion.estimation.filter_state import SIZE, initial_sigma
from companion.estimation.filter_steps import Steps

RUNS = 100


def flown(seed, c, **kwargs):
    drawn = fs.draw(seed, c, **kwargs)
    history = FilterHistory(Steps(c, fs.MARKERS), c.horizon_s)
    errors, updates = [], []
    for m, truth in zip(drawn.measurements, drawn.truth, strict=True):
        outcome = history.take(m)
        updates += outcome.updates
        e = history.newest
        if e.ready:
            error = e.x - truth
            errors.append(error @ np.linalg.solve(e.cov, error))
    return np.array(errors), updates


@pytest.mark.parametrize("markers", [9, 2])
def test_errors_and_innovations_are_as_large_as_the_filter_says(markers):
    """NEES over the runs at the end of each, NIS over all: 99.9 % bounds of chi2."""
    c = FilterConfig()
    final, nis = [], {"gps": [], "pixels": []}
    for seed in range(3000, 3000 + RUNS):
        nees, updates = flown(seed, c, length_s=5.0, frames_from_s=1.0, markers=markers)
        final.append(nees[-1])
        for u in updates:
            if not u.reason:
                nis[u.source].append((u.nis, u.dof))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], RUNS * SIZE) / (RUNS * SIZE)
    assert low < np.mean(final) / SIZE < high
    for source, told in nis.items():
        total, dof = np.sum(told, axis=0)
        low, high = chi2.ppf([5e-4, 1 - 5e-4], dof)
        assert low < total < high, source


def test_nothing_good_is_refused_but_for_the_gate_s_share():
    c = FilterConfig(gate_probability=1e-3)
    updates = [u for seed in range(3200, 3220) for u in flown(seed, c, length_s=5.0)[1] if u.dof]
    refused = sum(bool(u.reason) for u in updates)
    assert refused < 0.02 * len(updates)


def test_the_end_is_that_of_least_squares_over_all_measurements():
    """Without process noise but for what cannot be left out: one set of 16 unknowns, all measurements at once."""
    c = FilterConfig(velocity_sigma_m_s=1e-6, speed_sigma_m_s=1e-6, position_walk=0.0, velocity_walk=0.0,
                     attitude_walk=0.0, gps_bias_s=1e9, boresight_walk=0.0, lag_walk=0.0, attitude_sigma_rad=1e-9)
    drawn = fs.draw(5, c, length_s=4.0, frames_from_s=1.0)
    history = FilterHistory(Steps(c, fs.MARKERS), c.horizon_s)
    for m in drawn.measurements:
        history.take(m)
    end_ns = drawn.measurements[-1].t_ns
    sigma = initial_sigma(c)
    from_start = 2  # the first three differences are the start: their median, known as well as their mean

    def misfit(x):
        rows = [(x / sigma)[3:]]
        for k, m in enumerate(drawn.measurements):
            p = x[:3] - x[3:6] * (end_ns - m.t_ns) / fs.S
            if isinstance(m, GpsDifference):
                if k > from_start:
                    told = p + x[9:12] + fs.V_TANKER * x[15]
                    rows.append((m.offset_m - told) / (np.sqrt(2) * c.gps_sigma_m))
                elif k == from_start:
                    start = np.median([n.offset_m for n in drawn.measurements[:3]], axis=0)
                    told = p + x[9:12] + fs.V_TANKER * x[15]
                    rows.append((start - told) / (np.sqrt(2 / 3) * c.gps_sigma_m))
                continue
            r = m.geometry.travel_m + p
            uv = fs.on_plane(r, x[6:9], x[12:15], x[15])
            # What the extrapolation of travels leaves (1.6 mm) is part of a frame's noise: whitened with it below.
            rows.append(whitened(uv - m.labelled.uv, r, m))
        return np.concatenate([np.ravel(r) for r in rows])

    fit = least_squares(misfit, history.newest.x, x_scale=sigma, method="lm")
    cov = np.linalg.inv(fit.jac.T @ fit.jac)
    spread = np.sqrt(np.diag(cov))
    assert np.abs((history.newest.x - fit.x) / spread).max() < 0.1
    assert np.allclose(np.sqrt(np.diag(history.newest.cov)), spread, rtol=0.03)


def whitened(residual, r, m):
    """Return residuals (9, 2) as 18 numbers of variance one: centroids, and a shift of travels common to all."""
    step = 1e-5
    zero = np.zeros(3)
    J = np.array([(fs.on_plane(r + d, zero, zero) - fs.on_plane(r - d, zero, zero)).ravel() / (2 * step)
                  for d in step * np.eye(3)]).T
    R = np.diag(np.repeat(m.labelled.sigma**2, 2)) + J @ J.T * m.geometry.noise[6, 0]
    return np.linalg.solve(np.linalg.cholesky(R), residual.ravel())
