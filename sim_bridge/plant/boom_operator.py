"""Who works the boom: an automatic operator, or a stick. Both move the reference that the boom's loops follow.

Rules
-----
* An operator sees without error or delay where the receptacle is; how fast the boom gets there is limited.
* Automatic, a table of stages: WAIT (nominal angles, telescope in) until the receiver has been steady inside the
  desired window (thesis Tab. 1.1) for ``contact_after_s``; REACH (points at the receptacle, and telescopes out while
  it points well); FOLLOW (in contact); RETRACT, until the nozzle is clear and in. Back to WAIT until the fuel is given.
* REACH is given up when the receptacle leaves the limit window or the envelope.
* With the stick, up and right command rates of elevation and azimuth, and extend that of the telescope. The nozzle
  latches by itself when it gets near; pulling the telescope in lets go.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from companion.config import BoomConfig, WindowConfig
from sim_bridge.plant.boom_records import Seen
from sim_bridge.plant.refuelling import Contact

POINT_RAD_S, POINT_MOST_RAD_S = 2.5, 0.07
"""Bandwidth and largest rate (4 degrees/s) with which the operator points the boom."""
CLOSE_PER_S, CLOSE_LEAST_M_S, CLOSE_MOST_M_S = 0.8, 0.15, 0.6
"""Closing speed: this share of what is left per second, between these limits."""
STANDOFF_M = 1.0
POINTED_M = 0.25
"""The telescope stays ``STANDOFF_M`` away while the nozzle's axis misses the receptacle by more than ``POINTED_M``."""
STEADY_M_S = 1.2
"""Steady is a receptacle inside the window that is slower than this; in moderate gusts a held one reaches 1.0."""
RETRACT_M_S = 0.8
STICK_RAD_S, STICK_LEAD_RAD, STICK_LEAD_M = 0.05, 0.03, 0.2
"""Rate of the boom at full stick, and how far its reference may run ahead of the boom."""
PULL_OUT = -0.5


class Reference(NamedTuple):
    """Joint angles, length and their rates that the boom's loops follow."""

    elevation: float
    azimuth: float
    length: float
    elevation_rate: float = 0.0
    azimuth_rate: float = 0.0
    length_rate: float = 0.0


class Stage(Enum):
    """What the automatic operator is doing."""

    WAIT = "wait"
    REACH = "reach"
    FOLLOW = "follow"
    RETRACT = "retract"


def pointed(value: float, rate: float, goal: float, goal_rate: float, dt_s: float) -> tuple[float, float]:
    """Return value and rate one step on, critically damped towards a moving goal, with limited rate."""
    push = POINT_RAD_S * POINT_RAD_S * (goal - value) + 2.0 * POINT_RAD_S * (goal_rate - rate)
    rate = min(max(rate + push * dt_s, -POINT_MOST_RAD_S), POINT_MOST_RAD_S)
    return value + rate * dt_s, rate


def as_it_is(seen: Seen) -> Reference:
    """Return the reference that asks for what is."""
    return Reference(seen.elevation, seen.azimuth, seen.length)


class AutomaticOperator:
    """Holds nominal, reaches for a steady receiver, follows it, retracts."""

    def __init__(self, config: BoomConfig, window: WindowConfig, contact_after_s: float, dt_s: float) -> None:
        """Start in WAIT."""
        self._config, self._window = config, window
        self._after_s, self._dt_s = contact_after_s, dt_s
        self._length_most_m = config.tubes.outer_length_m + config.envelope.extension_m[1]
        self._steady_s = 0.0
        self.stage = Stage.WAIT

    def step(self, seen: Seen, ref: Reference, contact: Contact, done: bool) -> Reference:
        """Return the next reference."""
        self._steady(seen)
        if contact.latched:
            self.stage = Stage.FOLLOW
            return as_it_is(seen)
        if self.stage is Stage.FOLLOW:
            self.stage = Stage.RETRACT
        if self.stage is Stage.WAIT and not done and self._steady_s >= self._after_s:
            self.stage = Stage.REACH
        if self.stage is Stage.REACH:
            if not done and self._in_reach(seen, contact):
                return self._reach(seen, ref)
            self.stage = Stage.RETRACT
        if self.stage is Stage.RETRACT:
            if seen.length > self._config.ready_length_m + 0.1:
                return self._retract(ref)
            self.stage, self._steady_s = Stage.WAIT, 0.0
        return self._hang(ref)

    def _steady(self, seen: Seen) -> None:
        x, y, z = self._window.desired_m
        inside = abs(seen.br_x) <= x and abs(seen.br_y) <= y and abs(seen.br_z) <= z
        self._steady_s = self._steady_s + self._dt_s if inside and seen.relative_speed <= STEADY_M_S else 0.0

    def _in_reach(self, seen: Seen, contact: Contact) -> bool:
        x, y, z = self._window.limit_m
        inside = abs(seen.br_x) <= x and abs(seen.br_y) <= y and abs(seen.br_z) <= z
        return inside and not contact.beyond(seen.aim_elevation, seen.aim_azimuth, seen.aim_length)

    def _reach(self, seen: Seen, ref: Reference) -> Reference:
        dt_s = self._dt_s
        elevation, e_rate = pointed(
            ref.elevation, ref.elevation_rate, seen.aim_elevation, seen.aim_elevation_rate, dt_s
        )
        azimuth, a_rate = pointed(ref.azimuth, ref.azimuth_rate, seen.aim_azimuth, seen.aim_azimuth_rate, dt_s)
        off = max(abs(seen.elevation - seen.aim_elevation), abs(seen.azimuth - seen.aim_azimuth)) * seen.length
        to_go = seen.aim_length - ref.length - (STANDOFF_M if off > POINTED_M else 0.0)
        least = CLOSE_LEAST_M_S if off <= POINTED_M else -RETRACT_M_S
        rate = seen.aim_length_rate + min(max(CLOSE_PER_S * to_go, least), CLOSE_MOST_M_S)
        length = min(max(ref.length + rate * dt_s, self._config.ready_length_m), self._length_most_m)
        return Reference(elevation, azimuth, length, e_rate, a_rate, (length - ref.length) / dt_s)

    def _retract(self, ref: Reference) -> Reference:
        return Reference(ref.elevation, ref.azimuth, ref.length - RETRACT_M_S * self._dt_s, 0.0, 0.0, -RETRACT_M_S)

    def _hang(self, ref: Reference) -> Reference:
        c, dt_s = self._config, self._dt_s
        elevation, e_rate = pointed(ref.elevation, ref.elevation_rate, c.elevation_rad, 0.0, dt_s)
        azimuth, a_rate = pointed(ref.azimuth, ref.azimuth_rate, c.azimuth_rad, 0.0, dt_s)
        most = RETRACT_M_S * dt_s
        move = min(max(c.ready_length_m - ref.length, -most), most)
        return Reference(elevation, azimuth, ref.length + move, e_rate, a_rate, move / dt_s)


class StickOperator:
    """A stick: up, right, extend, each -1..1."""

    def __init__(self, config: BoomConfig, dt_s: float) -> None:
        """Start with the stick at rest."""
        self._extend_m_s, self._dt_s = config.drive.rate_m_s, dt_s
        stops = config.envelope
        self._elevation, self._azimuth = stops.stop_elevation_rad, stops.stop_azimuth_rad
        fixed = config.tubes.outer_length_m
        self._length = (fixed, fixed + stops.stop_extension_m)
        self.up = self.right = self.extend = 0.0

    def step(self, t_s: float, seen: Seen, ref: Reference, contact: Contact) -> Reference:
        """Return the next reference."""
        if contact.latched and self.extend <= PULL_OUT:
            contact.let_go(t_s, "operator")
        if contact.latched:
            return as_it_is(seen)
        dt_s = self._dt_s
        e = led(ref.elevation - self.up * STICK_RAD_S * dt_s, seen.elevation, STICK_LEAD_RAD, *self._elevation)
        a = led(ref.azimuth + self.right * STICK_RAD_S * dt_s, seen.azimuth, STICK_LEAD_RAD,
                -self._azimuth, self._azimuth)
        x = led(ref.length + self.extend * self._extend_m_s * dt_s, seen.length, STICK_LEAD_M, *self._length)
        rates = ((e - ref.elevation) / dt_s, (a - ref.azimuth) / dt_s, (x - ref.length) / dt_s)
        return Reference(e, a, x, *rates)


def led(wanted: float, there: float, lead: float, low: float, high: float) -> float:
    """Return ``wanted``, at most ``lead`` from where the boom is and between ``low`` and ``high``."""
    return min(max(wanted, there - lead, low), there + lead, high)
