"""One frozen field of Dryden gusts in three dimensions that every aircraft flies through (MIL-F-8785C 3.7; thesis 3.4).

Rules
-----
* The air does not change while the formation passes: who comes by the same place later meets the same gust, on a
  straight track and in a turn. The field moves with the mean wind: ask it in coordinates that do.
* The field is isotropic and free of divergence. Of the Dryden spectra (one-sided over spatial frequency Omega in rad/m,
  equal scale length L on all axes, as above 2000 ft)

      Phi_u = sigma^2 (2 L / pi) / (1 + (L Omega)^2)
      Phi_v = Phi_w = sigma^2 (L / pi) (1 + 3 (L Omega)^2) / (1 + (L Omega)^2)^2

  the second follows from the first by exactly that, Phi_v = (Phi_u - Omega dPhi_u/dOmega) / 2, and so does the energy
  over wave number, E(k) = k^3/2 d/dk (1/k dPhi_u/dk) = sigma^2 (8 L / pi) (L k)^4 / (1 + (L k)^2)^3.
* It is a sum of plane waves (Kraichnan, Phys. Fluids 13, 1970), u(x) = sum a cos(k.x + phase) with a at right angles to
  k: one wave from each of ``WAVES`` shells in k, carrying the shell's whole energy; directions, turns of a about k and
  phases from a Kronecker sequence (powers of the root of g^5 = g + 1) that starts anywhere and is turned anyhow, which
  covers them more evenly than chance would. Its ends: ``K_RANGE`` rad/m, below which lie 1e-5 of the energy, and above
  which 5 ms steps at 206 m/s carry nothing and 0.1 % of it lies.
* Rotary gusts (MIL-F-8785C 3.7.5) have the spectra

      Phi_q = Omega^2 / (1 + (4 b Omega / pi)^2) Phi_w        Phi_r = Omega^2 / (1 + (3 b Omega / pi)^2) Phi_v
      Phi_p = (sigma^2 / L) 0.8 (pi L / (4 b))^(1/3) / (1 + (4 b Omega / pi)^2)

  for span b. They are how the air turns: about a point where it moves by omega x r, dw/dx = -q, dv/dx = r, dw/dy = p
  (x forward, y right, w down). Each wave is differentiated and lagged along the direction of flight, by
  i Omega / (1 + i 4 b Omega / pi) for q. p is a scalar isotropic field on the same waves with phases of its own, its
  energy -k dPhi_p/dk over wave number, so that p is independent of the velocities, as the specification has it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from companion.geometry import Mat, Vec

SCALE_M = 533.4
"""L_u = L_v = L_w = 1750 ft, MIL-F-8785C 3.7.2."""
SIGMA_M_S = {"none": 0.0, "light": 1.13, "moderate": 2.24, "severe": 6.43}
"""MIL-F-8785C Fig. 7 at 6000 m for exceedance probabilities 1e-2, 1e-3 and 1e-5, between its values at 15,000 and
25,000 ft (as tabulated in JSBSim's FGWinds): 4.6-2.7, 8.0-6.6 and 22.1-20.0 ft/s."""
WAVES = 1024
"""A power of two. The mean over fields is exact; one field has its octaves of 1e-3..0.26 rad/m off by 6 to 17 % (rms; p
of the short span below 8e-3 rad/m by up to 40 %, which no flight of a minute can tell), its variances by below 1 %."""
K_RANGE = (0.1 / SCALE_M, 3.0)
GOLDEN = 1.1673039782614187
"""Root of g^5 = g + 1: fractional parts of n/g, n/g^2, ... fill the unit cube of four dimensions evenly."""

NORTH, EAST, DOWN, PHASE, U_NORTH, U_EAST, U_DOWN, P_COS, P_SIN = range(9)
"""Rows of a table of waves: k in turns per metre, phase in turns, amplitudes of velocity in m/s and of p in rad/s."""
S0, S1, S2, S3, S4, S5, S6, S7 = ((-1.0) ** n / math.factorial(2 * n + 1) for n in range(8))
C0, C1, C2, C3, C4, C5, C6, C7, C8 = ((-1.0) ** n / math.factorial(2 * n) for n in range(9))
ROUND = 1.5 * 2.0**52
"""Added and taken off again this leaves the nearest whole number."""


class GustField:
    """Gusts anywhere; the same for the same generator, in whatever order it is asked."""

    def __init__(self, turbulence: str, rng: np.random.Generator, heading_rad: float = 0.0) -> None:
        """Draw the waves, in axes turned by ``heading_rad``, so that the same flight on another heading is the same.

        Raises ValueError for a turbulence that is not a key of ``SIGMA_M_S``.
        """
        if turbulence not in SIGMA_M_S:
            msg = f"turbulence {turbulence!r} is unknown; use one of {', '.join(SIGMA_M_S)}"
            raise ValueError(msg)
        self.calm = turbulence == "none"
        self._sigma = SIGMA_M_S[turbulence]
        self._edges = shell_edges(WAVES)
        R_ned_drawn = Rotation.from_euler("z", heading_rad) * Rotation.random(rng=rng)
        self._waves, self._p_phase = draw_waves(self._edges, self._sigma, R_ned_drawn.as_matrix(), rng)
        self._for_span: dict[float, Mat] = {}

    def at(
        self, n_m: float, e_m: float, d_m: float, cos_track: float, sin_track: float, span_m: float
    ) -> tuple[float, float, float, float, float, float]:
        """Return the air's velocity (north, east, down) in m/s and its turning (p, q, r) in rad/s at a place.

        The place is in axes that move with the mean wind. p, q, r are about the forward, right and down axes of an
        aircraft of span ``span_m`` with its wings level that flies along (cos_track, sin_track).
        """
        if self.calm:
            return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        waves = self._for_span.get(span_m)
        if waves is None:
            waves = self._for_span[span_m] = self._with_p(span_m)
        return add_waves(waves, n_m, e_m, d_m, cos_track, sin_track, span_m / math.pi)

    def _with_p(self, span_m: float) -> Mat:
        """Return the table (9, n) of the waves with the amplitudes of p for an aircraft of ``span_m``."""
        energy = np.diff(roll_variance_below(self._edges, self._sigma, span_m))
        waves = self._waves.copy()
        waves[P_COS] = np.sqrt(2.0 * energy) * np.cos(self._p_phase)
        waves[P_SIN] = np.sqrt(2.0 * energy) * np.sin(self._p_phase)
        return waves


def energy_share_below(k: Vec) -> Vec:
    """Return the share of the energy at wave numbers below ``k`` (rad/m): the integral of E(k) over 1.5 sigma^2."""
    x = SCALE_M * k
    return (2.0 * np.arctan(x) - (2.0 / 3.0) * x * (5.0 * x**2 + 3.0) / (1.0 + x**2) ** 2) / math.pi


def roll_variance_below(k: Vec, sigma_m_s: float, span_m: float) -> Vec:
    """Return the variance of p (rad^2/s^2) from wave numbers below ``k``: the integral of -k dPhi_p/dk."""
    lag_m = 4.0 * span_m / math.pi
    low = sigma_m_s**2 / SCALE_M * 0.8 * (SCALE_M / lag_m) ** (1.0 / 3.0)
    y = lag_m * k
    return low / lag_m * (np.arctan(y) - y / (1.0 + y**2))


def shell_edges(n: int) -> Vec:
    """Return the edges (n + 1,) of the shells in k, rad/m.

    Half of them evenly over log k, for the rotary gusts; half with the root of the energy there, for the velocities.
    """
    fine = np.linspace(math.log(K_RANGE[0]), math.log(K_RANGE[1]), 8001)
    root = np.sqrt(np.diff(energy_share_below(np.exp(fine))))
    share = np.concatenate(([0.0], np.cumsum(0.5 / root.size + 0.5 * root / root.sum())))
    return np.exp(np.interp(np.linspace(0.0, 1.0, n + 1), share / share[-1], fine))


def draw_waves(edges: Vec, sigma_m_s: float, R_ned_drawn: Mat, rng: np.random.Generator) -> tuple[Mat, Vec]:
    """Return the table (9, n) of waves, rows of p still zero, and the phases (n,) of p in rad."""
    n = edges.size - 1
    z, azimuth, turn, phase = (
        (rng.random(4)[:, None] + np.arange(1, n + 1) / GOLDEN ** np.arange(1, 5)[:, None]) % 1.0
    )
    z, azimuth, turn = 2.0 * z - 1.0, 2.0 * math.pi * azimuth, 2.0 * math.pi * turn
    level = np.sqrt(1.0 - z**2)
    c, s = np.cos(azimuth), np.sin(azimuth)
    direction = np.array([level * c, level * s, z])
    across = np.cos(turn) * np.array([-s, c, 0.0 * z]) + np.sin(turn) * np.array([-z * c, -z * s, level])
    # Velocity along all three axes together has the variance 3 sigma^2; a wave of amplitude a has a^2 / 2.
    amplitude = np.sqrt(6.0 * sigma_m_s**2 * np.diff(energy_share_below(edges)))
    k = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(n)
    waves = np.zeros((9, n))
    waves[NORTH : DOWN + 1] = R_ned_drawn @ (direction * k) / (2.0 * math.pi)
    waves[PHASE] = phase
    waves[U_NORTH : U_DOWN + 1] = R_ned_drawn @ (across * amplitude)
    return waves, 2.0 * math.pi * rng.random(n)


# Division by zero cannot happen (1 + a^2), and without a check for it the compiler works on several waves at once:
# 2.7 us for 1024 waves instead of 13. Sums are in halves, in an order that is written here, so no fastmath is needed.
@njit(cache=True, nogil=True, error_model="numpy")
def add_waves(
    waves: Mat, n_m: float, e_m: float, d_m: float, cos_track: float, sin_track: float, span_over_pi: float
) -> tuple[float, float, float, float, float, float]:
    """Return what ``GustField.at`` returns, from a table (9, n) of waves, n a power of two.

    Sine and cosine of the phase come from Taylor series of half of it (within +-pi/2, error below 1e-11).
    """
    n = waves.shape[1]
    out = np.empty((6, n))
    for i in range(n):
        turns = waves[PHASE, i] + waves[NORTH, i] * n_m + waves[EAST, i] * e_m + waves[DOWN, i] * d_m
        half = math.pi * (turns - ((turns + ROUND) - ROUND))
        y = half * half
        s = half * (S0 + y * (S1 + y * (S2 + y * (S3 + y * (S4 + y * (S5 + y * (S6 + y * S7)))))))
        c = C0 + y * (C1 + y * (C2 + y * (C3 + y * (C4 + y * (C5 + y * (C6 + y * (C7 + y * C8)))))))
        cosine = 1.0 - 2.0 * s * s
        sine = 2.0 * s * c
        omega = 2.0 * math.pi * (waves[NORTH, i] * cos_track + waves[EAST, i] * sin_track)
        out[0, i] = waves[U_NORTH, i] * cosine
        out[1, i] = waves[U_EAST, i] * cosine
        out[2, i] = waves[U_DOWN, i] * cosine
        out[3, i] = waves[P_COS, i] * cosine - waves[P_SIN, i] * sine
        lag = 4.0 * span_over_pi * omega
        out[4, i] = -waves[U_DOWN, i] * omega * (lag * cosine - sine) / (1.0 + lag * lag)
        lag = 3.0 * span_over_pi * omega
        right = waves[U_EAST, i] * cos_track - waves[U_NORTH, i] * sin_track
        out[5, i] = right * omega * (lag * cosine - sine) / (1.0 + lag * lag)
    while n > 1:
        n //= 2
        for j in range(6):
            for i in range(n):
                out[j, i] += out[j, i + n]
    return out[0, 0], out[1, 0], out[2, 0], out[3, 0], out[4, 0], out[5, 0]
