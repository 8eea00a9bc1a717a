"""What the place to be at asks of an aircraft that is there already: its motion turned to roll, pitch and thrust.

The place moves with the box (gusts on the tanker, climbs, turns) and along the reference path::

    v = v_box + R (v_ref + Omega x p_ref),   a = a_box + R (a_ref + 2 Omega x v_ref)

with R = R_ned_mrf and Omega the nominal turn rate; Omega x (Omega x p_ref) is left out (0.01 m/s2 at 60 m). An aircraft
that flies this, coordinated and near trim, banks by atan(a_right / (g + a_up)), pitches by its climb and by the
incidence that the lift needs, and has the thrust that speeds it up, lifts its weight along the climb and overcomes the
drag of the incidence. Airspeed is that of trim: wind is not in it, since both aircraft fly in the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.config import AirframeConfig
from companion.geometry import GRAVITY_M_S2, Vec, rotation_from_euler
from companion.guidance.path import Reference
from companion.guidance.slopes import slopes_of
from companion.messages import RelativeState

MAX_BANK_RAD = 0.5
RATE_S = 0.2
"""Time constant of the rates of the references."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Inertial velocity and acceleration (3,) of where the receptacle should be, in ``ned``."""

    v_ned_m_s: Vec
    a_ned_m_s2: Vec


def place(state: RelativeState, reference: Reference) -> Place:
    """Return how the place to be at moves; see the head of the file."""
    R_ned_mrf = rotation_from_euler(state.heading0_rad, 0.0, 0.0)
    turn = state.turn_rate_rad_s
    v = state.v_ned_box_m_s + R_ned_mrf @ (reference.v_m_s + turn * across(reference.p_m))
    a = state.a_ned_box_m_s2 + R_ned_mrf @ (reference.a_m_s2 + 2.0 * turn * across(reference.v_m_s))
    return Place(v, a)


def across(v: Vec) -> Vec:
    """Return the unit vector down crossed with v (3,)."""
    return np.array([-v[1], v[0], 0.0])


class FeedForward:
    """Roll, and pitch and thrust from trim, that fly a place's motion; with their rates."""

    def __init__(self, airframe: AirframeConfig, dt_s: float) -> None:
        self._alpha0 = airframe.trim.alpha_rad
        self._speed_m_s = airframe.trim.airspeed_m_s
        self._slopes = slopes_of(airframe)
        self._share = 1.0 - math.exp(-dt_s / RATE_S)
        self.reset()

    def reset(self) -> None:
        """Forget the last references."""
        self._slow: Vec | None = None

    def step(self, a_mrf_m_s2: Vec, climb_rad: float) -> tuple[Vec, Vec]:
        """Return (roll, pitch from trim, thrust from trim) and their rates, (3,) each, for an acceleration now."""
        a_x, a_y, a_z = a_mrf_m_s2.tolist()
        weight = GRAVITY_M_S2 - a_z
        roll = min(max(math.atan2(a_y, weight), -MAX_BANK_RAD), MAX_BANK_RAD)
        alpha = (weight / math.cos(roll) - GRAVITY_M_S2) / self._slopes.lift_m_s2_rad
        pitch = (self._alpha0 + alpha) * math.cos(roll) - self._alpha0 + climb_rad
        thrust = (a_x + GRAVITY_M_S2 * climb_rad - self._slopes.drag_m_s2_rad * alpha) / self._slopes.thrust_m_s2
        now = np.array([roll, pitch, thrust])
        if self._slow is None:
            self._slow = now
        self._slow = self._slow + self._share * (now - self._slow)
        return now, (now - self._slow) / RATE_S
