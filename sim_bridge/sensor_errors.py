"""Errors of GPS and INS beyond the thesis' white noise: what grows, wanders and settles with time.

Rules
-----
* A generator is passed in and used by one process alone; a flight without these errors draws nothing from it.
* Processes are advanced to instants that do not go back; asked twice for one instant they answer the same.
"""

from __future__ import annotations

import math

import numpy as np

from companion.messages import NS
from sim_bridge.sensor_conditions import GpsErrors, InsErrors

Triple = tuple[float, float, float]

ZERO: Triple = (0.0, 0.0, 0.0)
SETTLE_S = 5.0
"""Time constant with which GPS takes a velocity error away once it is back: that of a loosely coupled filter."""


class GpsBias:
    """A constant bias and a Gauss-Markov process (dx = -x / tau dt + sigma sqrt(2 / tau) dW) about it."""

    def __init__(self, errors: GpsErrors, rng: np.random.Generator) -> None:
        """Start in the process' steady state."""
        self._errors, self._rng = errors, rng
        self._t_ns = 0
        self._slow = rng.standard_normal(3) * errors.slow_sigma_m if errors.slow_sigma_m > 0.0 else None

    def at(self, t_ns: int) -> Triple:
        """Return the bias (m, ``ned``) at an instant."""
        x, y, z = self._errors.bias_ned_m
        if self._slow is None:
            return x, y, z
        if t_ns > self._t_ns:
            kept = math.exp(-(t_ns - self._t_ns) * NS / self._errors.slow_s)
            fresh = self._errors.slow_sigma_m * math.sqrt(1.0 - kept * kept)
            self._slow = kept * self._slow + fresh * self._rng.standard_normal(3)
            self._t_ns = t_ns
        n, e, d = self._slow.tolist()
        return x + n, y + e, z + d


class InsDrift:
    """How far an INS is off: attitude from the start of the flight, velocity while GPS is out.

    ``euler_rad`` yaw, pitch, roll; ``v_ned_m_s``; ``force_m_s2`` the noise of the accelerometers.
    """

    def __init__(self, errors: InsErrors, rng: np.random.Generator, period_s: float) -> None:
        """``period_s``: how long the accelerometers' noise is held, which is how often ``advance`` is called."""
        self._errors, self._rng = errors, rng
        self._sigma_m_s2 = math.sqrt(errors.accelerometer_noise_power / period_s)
        self._t_ns: int | None = None
        self.euler_rad: Triple = ZERO
        self.v_ned_m_s: Triple = ZERO
        self.force_m_s2: Triple = ZERO

    @property
    def gyro_bias_rad_s(self) -> Triple:
        """Return what p, q and r are off by."""
        return self._errors.gyro_bias_rad_s

    def advance(self, t_ns: int, gps_out: bool) -> None:
        """Go on to an instant; ``gps_out`` says how it was since the last one."""
        dt_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) * NS
        self._t_ns = t_ns
        e = self._errors
        draws = self._rng.standard_normal((3, 3)).tolist()
        self.euler_rad = grown(self.euler_rad, e.attitude_drift_rad_s, e.attitude_walk, draws[0], dt_s)
        if gps_out:
            self.v_ned_m_s = grown(self.v_ned_m_s, e.velocity_drift_m_s2, e.velocity_walk, draws[1], dt_s)
        else:
            kept = math.exp(-dt_s / SETTLE_S)
            x, y, z = self.v_ned_m_s
            self.v_ned_m_s = (kept * x, kept * y, kept * z)
        x, y, z = draws[2]
        self.force_m_s2 = (self._sigma_m_s2 * x, self._sigma_m_s2 * y, self._sigma_m_s2 * z)


def grown(error: Triple, drift_per_s: Triple, walk: float, draws: list[float], dt_s: float) -> Triple:
    """Return an error after ``dt_s`` more of a steady drift and a random walk."""
    spread = walk * math.sqrt(dt_s)
    a, b, c = (x + rate * dt_s + spread * w for x, rate, w in zip(error, drift_per_s, draws, strict=True))
    return a, b, c
