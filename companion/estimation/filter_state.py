"""State of the filter: what is estimated, where it lies in the vector, and how sure it is at the start.

The state is a set of corrections to what the two INS say (an error-state filter). The relative position is what the
difference of both integrated velocities says (``Aligned.travel_difference_m``) plus ``p``; everything else is small.

=============== ============ ==========================================================================================
slice           unit, axes   meaning
=============== ============ ==========================================================================================
``P``           m, ned       relative position (tanker's to receiver's centre of mass) less the difference of travels
``V``           m/s, ned     relative velocity less the difference of the velocities told
``THETA``       rad, ned     R_ned_tanker = exp(theta) R_told, against the receiver's INS
``GPS_BIAS``    m, ned       difference of the two positions told less the relative position
``BORESIGHT``   rad, cam     R_frd_cam = R_nominal exp(boresight)
``LAG``         s            by how much the datalink stamps the tanker's states too late
=============== ============ ==========================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from companion.config import FilterConfig
from companion.geometry import Mat, Vec

SIZE = 16
P, V, THETA = slice(0, 3), slice(3, 6), slice(6, 9)
GPS_BIAS, BORESIGHT = slice(9, 12), slice(12, 15)
LAG = 15

NAMES = (
    "p_n_m", "p_e_m", "p_d_m", "v_n_m_s", "v_e_m_s", "v_d_m_s", "theta_n_rad", "theta_e_rad", "theta_d_rad",
    "gps_bias_n_m", "gps_bias_e_m", "gps_bias_d_m", "boresight_x_rad", "boresight_y_rad", "boresight_z_rad", "lag_s",
)


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Where one measurement alone puts something that should stay where it is, ``offset_m`` (3,) in ned."""

    t_ns: int
    offset_m: Vec

    def shifted(self, step_ns: int) -> Offset:
        """Return the same at another instant."""
        return replace(self, t_ns=self.t_ns + step_ns)


def later(t_ns: int | None, step_ns: int) -> int | None:
    """Return an instant moved, if there is one."""
    return None if t_ns is None else t_ns + step_ns


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Everything that the filter knows at one instant; nothing of it is changed in place.

    ``x`` (16,), ``cov`` (16, 16). ``ready``: there is a position at all. ``sight_ns``, ``gps_ns``: the last frame and
    the last difference of positions that were taken. ``pixel_offsets``, ``gps_offsets``: what those of them said that
    were refused since (before the start: all), to tell a source that has something to say from one that errs. ``gaps``:
    what gaps of telemetry have done to the travels so far (``filter_noise``). ``gps_offset``: the newest difference of
    positions less that of travels, taken or not. ``v_ned_tanker_m_s`` (3,) as it was told: the path.
    """

    t_ns: int
    x: Vec
    cov: Mat
    ready: bool = False
    sight_ns: int | None = None
    markers_used: int = 0
    gps_ns: int | None = None
    gps_offset: Offset | None = None
    gps_offsets: tuple[Offset, ...] = ()
    pixel_offsets: tuple[Offset, ...] = ()
    pixels_refused_ns: int | None = None
    gaps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    v_ned_tanker_m_s: Vec = field(default_factory=lambda: np.zeros(3))

    def shifted(self, step_ns: int) -> Estimate:
        """Return the same with all instants moved."""
        return replace(
            self, t_ns=self.t_ns + step_ns, sight_ns=later(self.sight_ns, step_ns), gps_ns=later(self.gps_ns, step_ns),
            pixels_refused_ns=later(self.pixels_refused_ns, step_ns),
            gps_offset=None if self.gps_offset is None else self.gps_offset.shifted(step_ns),
            gps_offsets=tuple(o.shifted(step_ns) for o in self.gps_offsets),
            pixel_offsets=tuple(o.shifted(step_ns) for o in self.pixel_offsets),
        )

    @property
    def position_sigma_m(self) -> float:
        """Return the standard deviation of the relative position in space (root of the trace)."""
        return float(np.sqrt(self.cov[0, 0] + self.cov[1, 1] + self.cov[2, 2]))


Source = Literal["gps", "pixels"]


def initial_sigma(c: FilterConfig) -> Vec:
    """Return the standard deviations (16,) before any measurement; those of the position are replaced at the start."""
    sigma = np.empty(SIZE)
    sigma[P] = np.hypot(np.sqrt(2.0) * c.gps_sigma_m, c.gps_bias_sigma_m)
    sigma[V] = c.velocity_initial_m_s
    sigma[THETA] = c.attitude_initial_rad
    sigma[GPS_BIAS] = c.gps_bias_sigma_m
    sigma[BORESIGHT] = c.boresight_initial_rad
    sigma[LAG] = c.lag_initial_s
    return sigma


def unknown(t_ns: int, c: FilterConfig) -> Estimate:
    """Return what is known before any measurement."""
    return Estimate(t_ns, np.zeros(SIZE), np.diag(initial_sigma(c) ** 2))


def process_noise(c: FilterConfig) -> Vec:
    """Return what ``filter_kernel.predict`` takes (8,): powers per second, and sigma and time constant of the bias.

    Position, across the path (0) and along it (7): the noise of two velocities, drawn anew every ``velocity_hold_s``
    (thesis 3.2), integrated, and ``position_walk``.
    """
    travel, walk = 2.0 * c.velocity_hold_s, c.position_walk**2
    return np.array([
        travel * c.velocity_sigma_m_s**2 + walk, c.velocity_walk**2, c.attitude_walk**2,
        c.gps_bias_sigma_m, c.gps_bias_s, c.boresight_walk**2, c.lag_walk**2,
        travel * c.speed_sigma_m_s**2 + walk,
    ])  # fmt: skip
