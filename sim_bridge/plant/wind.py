"""Steady wind with shear over height: what the air does on average."""

from __future__ import annotations

from dataclasses import replace

from companion.geometry import rotation_from_euler
from sim_bridge.plant.conditions import WindConfig
from sim_bridge.plant.fdm import Fdm, InitialCondition


class Wind:
    """Horizontal wind that changes linearly with height. The gust field drifts with the wind at the start's height."""

    def __init__(self, config: WindConfig) -> None:
        """Take the wind at the tanker's start and its shear."""
        self._config = config

    def at(self, height_above_start_m: float) -> tuple[float, float]:
        """Return where the air goes (north, east) in m/s, ``height_above_start_m`` above the tanker's start."""
        c = self._config
        return (
            c.north_m_s + c.north_shear_per_s * height_above_start_m,
            c.east_m_s + c.east_shear_per_s * height_above_start_m,
        )


def start_in_wind(fdm: Fdm, calm: InitialCondition, wind: Wind) -> None:
    """Put ``fdm`` at ``calm`` (velocity through the air) into the wind: as fast through the air, carried by it."""
    north, east = wind.at(-calm.p_ned_m[2])
    fdm.set_gust(north, east, 0.0)
    carried = rotation_from_euler(*calm.yaw_pitch_roll_rad).T @ (north, east, 0.0)
    u, v, w = (float(a + b) for a, b in zip(calm.v_body_m_s, carried, strict=True))
    fdm.reset(replace(calm, v_body_m_s=(u, v, w)))
