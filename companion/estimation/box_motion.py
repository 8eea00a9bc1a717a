"""How the refuelling box moves: its velocity and acceleration now, and the turn of the formation.

The box is fixed in tanker axes, so gusts that yaw and pitch the tanker move it, by a lever of 27 m. What the tanker
tells of itself gives the velocity of the box, v_box = v + R (omega x r). Its acceleration is told by the tanker's bank,
g tan(phi) to the right (a coordinated turn), and by what the velocities show beyond that: for each of the two terms a
critically damped observer, that of the lever quicker, since body rates are told with less noise::

    v' = a_bank + d + (share of the innovation),  d' = (share of the innovation)

Reports are old by the link's delay and are carried on to now.

The psi frame (``mrf``) turns with the *nominal* heading: the tanker's own, averaged over ``HEADING_S``, led by the rate
of the turn, which is the acceleration across the course over the speed over ground, averaged over ``TURN_S``. In wind
the nose points off the course; the frame goes with the nose, since boom and box do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.geometry import GRAVITY_M_S2, Mat, Vec, euler_from_rotation, skew
from companion.messages import NS

BOX_RAD_S = 5.0
"""Bandwidth for the centre's velocity: its noise (0.04 m/s, held 50 ms) against the tanker's gusts. With 8 rad/s the
noise alone moves the receiver's spoilers so much that their drag takes its thrust."""
LEVER_RAD_S = 8.0
"""Bandwidth for the lever's part."""
HEADING_S = 10.0
"""Time constant with which the nominal heading follows the tanker's nose."""
TURN_S = 1.5
"""Time constant of the formation's turn rate."""
LONGEST_GAP_S = 1.0
"""After a longer silence of the datalink the observer starts afresh."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxMotion:
    """Velocity and acceleration (3,) of the box in ``ned``; nominal heading and its rate."""

    v_ned_m_s: Vec
    a_ned_m_s2: Vec
    heading0_rad: float
    turn_rate_rad_s: float


class BoxObserver:
    """Turns the tanker's reports into ``BoxMotion`` at any instant after them."""

    def __init__(self, box_tanker_m: Vec, bandwidth_rad_s: float = BOX_RAD_S, lever_rad_s: float = LEVER_RAD_S) -> None:
        self._box_tanker_m = box_tanker_m
        self._w = bandwidth_rad_s
        self._wl = lever_rad_s
        self._t_ns: int | None = None
        self._centre = self._lever = Smoothed(np.zeros(3), np.zeros(3))
        self._bank = np.zeros(3)
        self._heading = self._turn = 0.0

    def is_new(self, t_ns: int) -> bool:
        """Tell whether a report is newer than the last."""
        return self._t_ns is None or t_ns > self._t_ns

    def shift(self, step_ns: int) -> None:
        """Move the last report in time."""
        self._t_ns = None if self._t_ns is None else self._t_ns + step_ns

    def update(self, t_ns: int, v_ned_m_s: Vec, R_ned_tanker: Mat, omega_tanker_rad_s: Vec) -> None:
        """Take a report that is newer than the last."""
        lever = R_ned_tanker @ (skew(omega_tanker_rad_s) @ self._box_tanker_m)
        yaw, _, roll = euler_from_rotation(R_ned_tanker)
        bank = GRAVITY_M_S2 * math.tan(min(max(roll, -1.2), 1.2)) * np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        before, self._bank = self._bank, bank
        dt = math.inf if self._t_ns is None else (t_ns - self._t_ns) * NS
        if dt > LONGEST_GAP_S:
            self._centre, self._lever = Smoothed(v_ned_m_s, np.zeros(3)), Smoothed(lever, np.zeros(3))
            self._heading, self._turn = yaw, 0.0
        else:
            known = 0.5 * (before + bank)
            self._centre = smooth(self._centre, v_ned_m_s, known, self._w, dt)
            self._lever = smooth(self._lever, lever, np.zeros(3), self._wl, dt)
            self._follow(dt, yaw)
        self._t_ns = t_ns

    def _follow(self, dt: float, yaw: float) -> None:
        v, a = self._centre.value, self._bank + self._centre.rate
        rate = float(v[0] * a[1] - v[1] * a[0]) / max(float(v[0] * v[0] + v[1] * v[1]), 1.0)
        self._turn += (1.0 - math.exp(-dt / TURN_S)) * (rate - self._turn)
        ahead = self._heading + dt * self._turn
        off = math.remainder(yaw - ahead, 2.0 * math.pi)
        self._heading = math.remainder(ahead + (1.0 - math.exp(-dt / HEADING_S)) * off, 2.0 * math.pi)

    def at(self, t_ns: int) -> BoxMotion:
        """Return the motion at an instant; ``update`` comes before."""
        ahead_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) * NS
        a = self._bank + self._centre.rate + self._lever.rate
        heading = math.remainder(self._heading + ahead_s * self._turn, 2.0 * math.pi)
        return BoxMotion(self._centre.value + self._lever.value + ahead_s * a, a, heading, self._turn)


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """A measured vector (3,) and its rate beyond what is known of it."""

    value: Vec
    rate: Vec


def smooth(last: Smoothed, measured: Vec, known_rate: Vec, bandwidth_rad_s: float, dt: float) -> Smoothed:
    """Return the critically damped observer's next state, ``dt`` s after the last."""
    fade = math.exp(-bandwidth_rad_s * dt)
    predicted = last.value + dt * (last.rate + known_rate)
    innovation = measured - predicted
    return Smoothed(predicted + (1.0 - fade * fade) * innovation, last.rate + (1.0 - fade) ** 2 / dt * innovation)
