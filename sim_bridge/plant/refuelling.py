"""Contact of nozzle and receptacle, and the fuel that flows while it lasts.

Rules
-----
* The nozzle latches when it comes slowly within reach of the receptacle, inside the envelope; it has to have been
  ``CLEAR_M`` away since the last contact. What is then left of the gap closes in ``SEAT_S``, as the receptacle's
  slipway leads the nozzle in.
* It lets go beyond the envelope, when the receptacle runs away, when it is told to, or torn out, at the break load.
* Every contact and every disconnect is an event with its time and reason, and counted.
* Between tanker and receiver the fuel's mass moves at once: what stands in the boom is part of the inner tube's mass.
"""

from __future__ import annotations

import math
from collections import Counter

from companion.config import BoomConfig
from sim_bridge.plant.boom_records import Seen

CLEAR_M = 0.5
SEAT_S = 0.3
RUN_M_S = 2.0
"""A receptacle that moves against the tanker faster than this is leaving; held in moderate gusts it reaches 1.0."""
FLOW_LAG_S = 1.0
"""Estimated: valves and pumps take a few seconds to full flow."""


class Contact:
    """The latch; ``rest`` is how far the seated nozzle still is from the receptacle's seat (tanker axes, m)."""

    def __init__(self, config: BoomConfig) -> None:
        """Start without contact."""
        self._nozzle, self._envelope = config.nozzle, config.envelope
        self._fixed_m = config.tubes.outer_length_m
        self._clear = True
        self.latched = False
        self.rest = (0.0, 0.0, 0.0)
        self.events: list[tuple[float, str]] = []
        self.contacts = 0
        self.disconnects: Counter[str] = Counter()
        self.peak_load_n = 0.0

    def beyond(self, elevation_rad: float, azimuth_rad: float, length_m: float) -> str:
        """Return what of joint angles and length is outside the envelope, or nothing."""
        e = self._envelope
        if not e.elevation_rad[0] <= elevation_rad <= e.elevation_rad[1]:
            return "elevation limit"
        if abs(azimuth_rad) > e.azimuth_rad:
            return "azimuth limit"
        if not e.extension_m[0] <= length_m - self._fixed_m <= e.extension_m[1]:
            return "extension limit"
        return ""

    def step(self, t_s: float, seen: Seen, dt_s: float) -> None:
        """Latch, hold or let go."""
        if self.latched:
            self._hold(t_s, seen, dt_s)
        elif not self._clear:
            self._clear = seen.gap > CLEAR_M
        elif (
            seen.gap <= self._nozzle.capture_m
            and abs(seen.closing) <= self._nozzle.capture_speed_m_s
            and not self.beyond(seen.elevation, seen.azimuth, seen.length)
        ):
            self.latched = True
            self.rest = (seen.gap_x, seen.gap_y, seen.gap_z)
            self.contacts += 1
            self.events.append((t_s, "contact"))

    def _hold(self, t_s: float, seen: Seen, dt_s: float) -> None:
        left = math.exp(-dt_s / SEAT_S)
        self.rest = (self.rest[0] * left, self.rest[1] * left, self.rest[2] * left)
        load_n = math.hypot(seen.pull_along, seen.pull_up, seen.pull_right)
        self.peak_load_n = max(self.peak_load_n, load_n)
        if load_n > self._nozzle.break_load_n:
            self.let_go(t_s, "brute: break load")
        elif reason := self.beyond(seen.elevation, seen.azimuth, seen.length):
            self.let_go(t_s, reason)
        elif seen.relative_speed > RUN_M_S:
            self.let_go(t_s, "receiver leaves")

    def let_go(self, t_s: float, reason: str) -> None:
        """Disconnect, if there is contact."""
        if self.latched:
            self.latched = self._clear = False
            self.rest = (0.0, 0.0, 0.0)
            self.disconnects[reason] += 1
            self.events.append((t_s, f"disconnect: {reason}"))


class Fuel:
    """What flows: up to ``flow_kg_s`` in contact, until ``fuel_kg`` are given; ``given_kg`` so far."""

    def __init__(self, fuel_kg: float, flow_kg_s: float) -> None:
        """Start with closed valves."""
        self._fuel_kg, self._flow_kg_s = fuel_kg, flow_kg_s
        self.given_kg = 0.0
        self.flow_kg_s = 0.0

    @property
    def done(self) -> bool:
        """Whether all has been given."""
        return self.given_kg >= self._fuel_kg

    def step(self, contact: bool, dt_s: float) -> None:
        """Let fuel flow for one step; without contact valves are shut at once."""
        if not contact or self.done:
            self.flow_kg_s = 0.0
            return
        self.flow_kg_s += (self._flow_kg_s - self.flow_kg_s) * (1.0 - math.exp(-dt_s / FLOW_LAG_S))
        self.given_kg = min(self.given_kg + self.flow_kg_s * dt_s, self._fuel_kg)
