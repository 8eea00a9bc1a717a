"""What the simulator knows exactly: passed between plant, scene, sensors and scoring, never to the companion.

What is made at every step is a msgspec Struct, which takes an eighth of the time of a frozen dataclass.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from companion.geometry import SE3, Mat, Vec

EFFECTORS = ("throttle", "amt_r", "amt_l", "tef_r", "tef_l", "lef_r", "lef_l", "pf", "ssd_r", "ssd_l")
"""Order of the UAV's input vector (thesis eq. 3.3); throttle 0..1, surfaces in rad."""


class BodyState(msgspec.Struct, frozen=True, eq=False):
    """State of one aircraft's centre of mass.

    ``p_ned_m``, ``v_ned_m_s`` (3,) inertial; ``R_ned_body`` (3, 3); ``omega_body_rad_s`` (3,) p q r;
    ``specific_force_body_m_s2`` (3,) what an accelerometer at the centre of mass feels;
    ``v_air_body_m_s`` (3,) velocity relative to the air including gusts.
    """

    t_ns: int
    p_ned_m: Vec
    v_ned_m_s: Vec
    R_ned_body: Mat
    omega_body_rad_s: Vec
    specific_force_body_m_s2: Vec
    v_air_body_m_s: Vec

    def T_ned_body(self) -> SE3:
        """Return the pose as a transform."""
        return SE3(self.R_ned_body, self.p_ned_m)


@dataclass(frozen=True, slots=True, eq=False)
class BoomState:
    """Boom: pivot (3,) in tanker axes, elevation below the tanker's x axis, azimuth (right positive), length.

    ``contact``: the nozzle sits in the receptacle; ``given_kg`` the fuel that has gone through it. ``ruddevators_rad``:
    deflection of the right and the left one, trailing edge down (which lifts the boom) positive.
    """

    pivot_tanker_m: Vec
    elevation_rad: float
    azimuth_rad: float
    length_m: float
    contact: bool = False
    given_kg: float = 0.0
    ruddevators_rad: tuple[float, float] = (0.0, 0.0)

    def tip_tanker_m(self) -> Vec:
        """Return the boom's tip (3,) in tanker axes; the boom points aft and down."""
        ce = np.cos(self.elevation_rad)
        direction = np.array(
            [-ce * np.cos(self.azimuth_rad), ce * np.sin(self.azimuth_rad), np.sin(self.elevation_rad)]
        )
        return self.pivot_tanker_m + self.length_m * direction


class Truth(msgspec.Struct, frozen=True, eq=False):
    """One instant of the simulated world."""

    t_ns: int
    uav: BodyState
    tanker: BodyState
    boom: BoomState
    uav_effectors: Vec
