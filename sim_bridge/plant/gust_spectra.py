"""The spectra of MIL-F-8785C, and a picture of the field's own beside them."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.signal import welch

from companion.geometry import Mat, Vec
from sim_bridge.plant.gusts import SCALE_M, SIGMA_M_S, GustField

AXES = ("u (along the track)", "v (right)", "w (down)", "p", "q", "r")
SPANS_M = {"receiver": 11.43, "tanker": 39.88}
COLORS = {"receiver": "#3d7ebf", "tanker": "#d1495b"}
STEP_M = 2.0
SAMPLES = 32768
BANDS_RAD_M = np.geomspace(8e-4, 0.4, 37)
"""Quarters of an octave that the picture averages over."""
TRACKS = ((0.0, 0.0), (1.9, 0.0), (3.5, 0.05))
"""Headings (rad) and slopes down of the tracks that are averaged: the field is the same on all of them."""


def dryden_spectra(omega: Vec, sigma_m_s: float, span_m: float) -> Mat:
    """Return the one-sided spectra (6, n) of u, v, w, p, q, r at spatial frequencies ``omega`` (n,) in rad/m.

    MIL-F-8785C 3.7.1.2 and 3.7.5, per rad/m, for L_u = L_v = L_w = ``SCALE_M`` and one sigma for all axes.
    """
    x2 = (SCALE_M * omega) ** 2
    lag_m = 4.0 * span_m / math.pi
    u = sigma_m_s**2 * (2.0 * SCALE_M / math.pi) / (1.0 + x2)
    w = sigma_m_s**2 * (SCALE_M / math.pi) * (1.0 + 3.0 * x2) / (1.0 + x2) ** 2
    p = sigma_m_s**2 / SCALE_M * 0.8 * (SCALE_M / lag_m) ** (1.0 / 3.0) / (1.0 + (lag_m * omega) ** 2)
    q = omega**2 / (1.0 + (lag_m * omega) ** 2) * w
    r = omega**2 / (1.0 + (0.75 * lag_m * omega) ** 2) * w
    return np.array([u, w, w, p, q, r])


def sample_track(field: GustField, heading_rad: float, slope: float, span_m: float, samples: int = SAMPLES) -> Mat:
    """Return gusts (samples, 6) every ``STEP_M`` along a line: velocity along, right and down, then p, q, r."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    rows = np.array([field.at(c * x, s * x, slope * x, c, s, span_m) for x in STEP_M * np.arange(samples)])
    rows[:, :2] = rows[:, :2] @ [[c, -s], [s, c]]
    return rows


def measured_spectra(turbulence: str, span_m: float, seeds: range) -> tuple[Vec, Mat]:
    """Return frequencies (n,) in rad/m and spectra (6, n), Welch's periodograms averaged over fields and tracks."""
    powers = []
    for seed in seeds:
        field = GustField(turbulence, np.random.default_rng(seed))
        for heading_rad, slope in TRACKS:
            rows = sample_track(field, heading_rad, slope, span_m)
            frequency, power = welch(rows, fs=1.0 / STEP_M, nperseg=8192, axis=0)
            powers.append(power.T / (2.0 * math.pi))
    return 2.0 * math.pi * frequency, np.mean(powers, axis=0)


def banded(omega: Vec, power: Mat) -> tuple[Vec, Mat]:
    """Return frequencies (m,) and spectra (6, m), averaged over each of ``BANDS_RAD_M`` that has any."""
    band = np.digitize(omega, BANDS_RAD_M)
    inside = [band == k for k in range(1, BANDS_RAD_M.size) if (band == k).any()]
    return np.array([omega[k].mean() for k in inside]), np.array([power[:, k].mean(axis=1) for k in inside]).T


def draw_spectra(turbulence: str = "light", seeds: range = range(10)) -> Figure:
    """Return a figure of the field's spectra of u, v, w, p, q, r beside the formulas; takes some seconds."""
    smooth = np.geomspace(BANDS_RAD_M[0], BANDS_RAD_M[-1], 200)
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(2, 3, figsize=(10, 6), sharex=True, constrained_layout=True)
        for name, span_m in SPANS_M.items():
            omega, power = banded(*measured_spectra(turbulence, span_m, seeds))
            formula = dryden_spectra(smooth, SIGMA_M_S[turbulence], span_m)
            # The velocities do not depend on the span: once is enough.
            for k in range(6) if name == "receiver" else range(3, 6):
                label = "field" if k < 3 else f"field, {name} (span {span_m:.1f} m)"
                axes.flat[k].loglog(omega, power[k], "o", ms=3, color=COLORS[name], label=label)
                axes.flat[k].loglog(smooth, formula[k], color="#222222", lw=1.0)
        for k, ax in enumerate(axes.flat):
            ax.plot([], [], color="#222222", lw=1.0, label="MIL-F-8785C")
            ax.set_title(AXES[k])
            ax.legend(frameon=False, loc="lower left", fontsize=8)
            ax.set_ylabel("spectrum, (m/s)² per rad/m" if k < 3 else "spectrum, (rad/s)² per rad/m")
        for ax in axes[1]:
            ax.set_xlabel("spatial frequency, rad/m")
    return figure
