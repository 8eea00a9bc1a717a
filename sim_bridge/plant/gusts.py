"""One frozen field of Dryden gusts that every aircraft flies through (MIL-F-8785C, 3.7; thesis 3.4).

The air does not change while the formation passes, so two aircraft one behind the other meet the same gusts, later by
their separation. The field varies along the track only: the aircraft are apart by a small share of the 533 m scale
length across it. One-sided spectra over the spatial frequency Omega (rad/m), for altitudes above 2000 ft:

    Phi_u = sigma^2 (2 L / pi) / (1 + (L Omega)^2)
    Phi_v = Phi_w = sigma^2 (L / pi) (1 + 3 (L Omega)^2) / (1 + (L Omega)^2)^2

Each is made by its shaping filter, driven by white noise over distance and discretised exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.linalg import expm, solve_continuous_lyapunov

from companion.geometry import Mat, Vec

SCALE_M = 533.4
"""L_u = L_v = L_w = 1750 ft, MIL-F-8785C 3.7.2."""
SIGMA_M_S = {"none": 0.0, "light": 1.13, "moderate": 2.24, "severe": 6.43}
"""MIL-F-8785C Fig. 7 at 6000 m for exceedance probabilities 1e-2, 1e-3 and 1e-5, between its values at 15,000 and
25,000 ft (as tabulated in JSBSim's FGWinds): 4.6-2.7, 8.0-6.6 and 22.1-20.0 ft/s."""
SPACING_M = 2.0
BLOCK = 32768
BEHIND_M = 2000.0


def shaping_filters(sigma_m_s: float) -> tuple[Mat, Mat, Mat]:
    """Return (F, G, C) of the joint filter dx = F x ds + G dw, (u, v, w) = C x; F (5, 5), G (5, 3), C (3, 5)."""
    F = np.zeros((5, 5))
    G = np.zeros((5, 3))
    C = np.zeros((3, 5))
    F[0, 0] = -1.0 / SCALE_M
    G[0, 0] = 1.0
    C[0, 0] = sigma_m_s * math.sqrt(2.0 / SCALE_M)
    for axis, i in ((1, 1), (2, 3)):
        F[i, i + 1] = 1.0
        F[i + 1, i] = -1.0 / SCALE_M**2
        F[i + 1, i + 1] = -2.0 / SCALE_M
        G[i + 1, axis] = 1.0
        C[axis, i] = sigma_m_s * math.sqrt(SCALE_M) / SCALE_M**2
        C[axis, i + 1] = sigma_m_s * math.sqrt(3.0 * SCALE_M) / SCALE_M
    return F, G, C


class GustField:
    """Gusts along the track; made block by block as the flight goes on, the same for the same generator."""

    def __init__(self, turbulence: str, rng: np.random.Generator) -> None:
        """Start the field; raises ValueError for a turbulence that is not a key of ``SIGMA_M_S``."""
        if turbulence not in SIGMA_M_S:
            msg = f"turbulence {turbulence!r} is unknown; use one of {', '.join(SIGMA_M_S)}"
            raise ValueError(msg)
        self._rng = rng
        self.calm = turbulence == "none"
        F, G, self._C = shaping_filters(SIGMA_M_S[turbulence])
        covariance = solve_continuous_lyapunov(F, -G @ G.T)
        self._Phi = expm(F * SPACING_M)
        self._noise = root_of(covariance - self._Phi @ covariance @ self._Phi.T)
        self._x = root_of(covariance) @ rng.standard_normal(5)
        self._uvw = np.zeros((0, 3))
        self.extend()

    def extend(self) -> None:
        """Make one more block."""
        driven = self._rng.standard_normal((BLOCK, 5)) @ self._noise.T
        states = run_filter(self._Phi, driven, self._x)
        self._x = states[-1].copy()
        self._uvw = np.concatenate((self._uvw, states @ self._C.T))
        self._end_m = (len(self._uvw) - 1) * SPACING_M - BEHIND_M

    def at(self, along_m: float) -> tuple[float, float, float]:
        """Return the velocity of the air (along, right, down) in m/s at ``along_m``; before the start, the first."""
        if self.calm:
            return 0.0, 0.0, 0.0
        while along_m >= self._end_m:
            self.extend()
        return interpolate(self._uvw, max(along_m + BEHIND_M, 0.0) / SPACING_M)

    def samples(self) -> tuple[Vec, Mat]:
        """Return what has been made so far: positions (n,) in m and (n, 3) gusts in m/s."""
        return np.arange(float(len(self._uvw))) * SPACING_M - BEHIND_M, self._uvw


def root_of(covariance: Mat) -> Mat:
    """Return S with S S^T = covariance, for covariances that are nearly singular too."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


@njit(cache=True, nogil=True)
def run_filter(Phi: Mat, driven: Mat, x: Vec) -> Mat:
    """Return the states x[k+1] = Phi x[k] + driven[k], shape of ``driven``."""
    out = np.empty_like(driven)
    n = x.shape[0]
    for k in range(driven.shape[0]):
        for i in range(n):
            total = driven[k, i]
            for j in range(n):
                total += Phi[i, j] * (x[j] if k == 0 else out[k - 1, j])
            out[k, i] = total
    return out


@njit(cache=True, nogil=True)
def interpolate(table: Mat, index: float) -> tuple[float, float, float]:
    """Return the row at a fractional ``index``, linearly between its neighbours."""
    i = int(index)
    f = index - i
    g = 1.0 - f
    return (
        g * table[i, 0] + f * table[i + 1, 0],
        g * table[i, 1] + f * table[i + 1, 1],
        g * table[i, 2] + f * table[i + 1, 2],
    )
