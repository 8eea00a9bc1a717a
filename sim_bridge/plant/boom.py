"""The refuelling boom: one step at a time, for the world that carries it (thesis 2.2).

Equations of motion: ``boom_derivation`` and ``boom_dynamics``; forces: ``boom_forces``; loops and integration:
``boom_motion``; who works it: ``boom_operator``; contact and fuel: ``refuelling``. Masses and areas are estimates, see
``firmware_configs/tankers/kc135r.toml``.

What the boom does to the tanker is left out: 30 kN, the most before it tears off, accelerate 110 t by 0.03 g.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.config import BoomConfig, Vec3, WindowConfig
from sim_bridge.plant.boom_dynamics import direction_of
from sim_bridge.plant.boom_motion import advance
from sim_bridge.plant.boom_operator import AutomaticOperator, Reference, StickOperator
from sim_bridge.plant.boom_records import PRESCRIBED, SEEN, STATE, Seen, flat, parameters, record
from sim_bridge.plant.conditions import BoomConditions
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.refuelling import Contact, Fuel
from sim_bridge.truth import BoomState

BowWave = Callable[[Vec3, float, float], Vec3]
"""(place in receiver body axes m, airspeed m/s, alpha rad) -> velocity of the air there, body axes, m/s."""
SETTLE_STEPS = 4000
"""20 s in which loops and boom come to rest before the first step, with tanker and air as they are then."""
BOW_REACH_M = 15.0
"""Beyond this gap no bow wave is asked for."""
STILL = (0.0, 0.0, 0.0)


class Carrier(NamedTuple):
    """The tanker: its centre of mass, and, as ``Fdm.accelerations`` gives them, the rates of u v w and p q r."""

    p_ned_m: Vec3
    v_ned_m_s: Vec3
    yaw_pitch_roll_rad: Vec3
    omega_body_rad_s: Vec3
    v_dot_body_m_s2: Vec3
    omega_dot_body_rad_s2: Vec3


class Receptacle(NamedTuple):
    """The receiver: its centre of mass, and where on it the receptacle is."""

    p_ned_m: Vec3
    v_ned_m_s: Vec3
    yaw_pitch_roll_rad: Vec3
    omega_body_rad_s: Vec3
    at_frd_m: Vec3


class AirAtBoom(NamedTuple):
    """Density, velocity of the air (wind, gusts, downwash of the tanker's wing), the receiver's bow wave."""

    density_kg_m3: float
    v_ned_m_s: Vec3 = STILL
    bow_wave_m_s: BowWave | None = None


def nominal_boom(config: BoomConfig) -> BoomState:
    """Return the boom at the elevation, azimuth and length of its configuration."""
    return BoomState(
        pivot_tanker_m=np.array(config.pivot_tanker_m),
        elevation_rad=config.elevation_rad,
        azimuth_rad=config.azimuth_rad,
        length_m=config.length_m,
    )


def mid_reach(config: BoomConfig) -> Vec3:
    """Return where the nozzle is at nominal elevation and the middle of the extension, tanker axes."""
    length_m = config.tubes.outer_length_m + 0.5 * sum(config.envelope.extension_m)
    x, y, z = config.pivot_tanker_m
    return x - length_m * math.cos(config.elevation_rad), y, z + length_m * math.sin(config.elevation_rad)


class Boom:
    """The boom, its operator, contact and fuel."""

    def __init__(
        self,
        config: BoomConfig,
        conditions: BoomConditions,
        dt_s: float,
        box_tanker_m: Vec3 | None = None,
        window: WindowConfig | None = None,
    ) -> None:
        """Start still, at nominal angles with the telescope in; without a box, it is where the boom's reach has its
        middle."""
        self._config, self._dt_s, self._t_s = config, dt_s, 0.0
        self._fixed = nominal_boom(config) if conditions.operator == "fixed" else None
        self._par = parameters(config, box_tanker_m or mid_reach(config))
        self._given, self._s, self._seen = record(PRESCRIBED), record(STATE), record(SEEN)
        self._given_flat, self._seen_flat = flat(self._given), flat(self._seen)
        self._s["theta4"] = math.pi - config.elevation_rad
        self._s["theta5"] = config.azimuth_rad - 0.5 * math.pi
        self._s["d6"] = config.ready_length_m
        self._ref = Reference(config.elevation_rad, config.azimuth_rad, config.ready_length_m)
        self._contact = Contact(config)
        self._fuel = Fuel(conditions.fuel_kg, conditions.flow_kg_s)
        self._automatic = AutomaticOperator(config, window or WindowConfig(), conditions.contact_after_s, dt_s)
        self._stick = StickOperator(config, dt_s) if conditions.operator == "joystick" else None
        self._schedule = sorted(conditions.stick, key=lambda s: s.at_s)
        if self._fixed is None:
            # Compiles now, so that no flight against the clock waits for it in its first step.
            advance(self._par, self._given.copy(), self._s.copy(), self._seen.copy(), dt_s)
        self.seen = Seen._make(self._seen_flat.tolist())

    def step(self, tanker: Carrier, receiver: Receptacle, air: AirAtBoom) -> None:
        """Advance one step, to the instant that the arguments tell of; raises PlantError when it is not finite."""
        if self._fixed is not None:
            return
        self._given_flat[:] = (
            *tanker.p_ned_m, *tanker.v_ned_m_s, *tanker.yaw_pitch_roll_rad, *tanker.omega_body_rad_s,
            *tanker.v_dot_body_m_s2, *tanker.omega_dot_body_rad_s2,
            *receiver.p_ned_m, *receiver.v_ned_m_s, *receiver.yaw_pitch_roll_rad, *receiver.omega_body_rad_s,
            *receiver.at_frd_m, air.density_kg_m3, *air.v_ned_m_s, *self._bow(air.bow_wave_m_s),
            *self._ref, self._contact.latched, *self._contact.rest,
        )  # fmt: skip
        if self._t_s == 0.0:
            for _ in range(SETTLE_STEPS):
                advance(self._par, self._given, self._s, self._seen, self._dt_s)
        finite = advance(self._par, self._given, self._s, self._seen, self._dt_s)
        if not finite:
            msg = "the boom's motion is no longer finite (not a number in its state or in what moves it)"
            raise PlantError(msg)
        self._t_s += self._dt_s
        self.seen = Seen._make(self._seen_flat.tolist())
        self._work()

    def _bow(self, bow_wave: BowWave | None) -> tuple[float, ...]:
        seen = self.seen
        if bow_wave is None or seen.airspeed <= 0.0 or seen.gap > BOW_REACH_M:
            return (*STILL, *STILL)
        first = bow_wave((seen.at_x0, seen.at_y0, seen.at_z0), seen.airspeed, seen.alpha)
        return (*first, *bow_wave((seen.at_x1, seen.at_y1, seen.at_z1), seen.airspeed, seen.alpha))

    def _work(self) -> None:
        seen, contact = self.seen, self._contact
        contact.step(self._t_s, seen, self._dt_s)
        self._fuel.step(contact.latched, self._dt_s)
        if self._fuel.done:
            contact.let_go(self._t_s, "fuel given")
        if self._stick is None:
            self._ref = self._automatic.step(seen, self._ref, contact, self._fuel.done)
            return
        while self._schedule and self._schedule[0].at_s <= self._t_s:
            due = self._schedule.pop(0)
            self.stick(due.up, due.right, due.extend)
        self._ref = self._stick.step(self._t_s, seen, self._ref, contact)

    def stick(self, up: float, right: float, extend: float) -> None:
        """Put the operator's stick there (-1..1 each); without a joystick nothing happens."""
        if self._stick is not None:
            self._stick.up, self._stick.right, self._stick.extend = up, right, extend

    def disconnect(self, reason: str) -> None:
        """Let go at once, for a breakaway that was called."""
        self._contact.let_go(self._t_s, reason)

    @property
    def state(self) -> BoomState:
        """The boom as scene and truth take it: azimuth about the tanker's z axis first, then elevation."""
        if self._fixed is not None:
            return self._fixed
        s = self._s[0]
        x, y, z = direction_of(float(s["theta4"]), float(s["theta5"]))
        return BoomState(
            pivot_tanker_m=np.array(self._config.pivot_tanker_m),
            elevation_rad=math.asin(z),
            azimuth_rad=math.atan2(y, -x),
            length_m=float(s["d6"]),
            contact=self.contact,
            given_kg=self.given_kg,
            ruddevators_rad=(float(s["right"]), float(s["left"])),
        )

    @property
    def force_on_receptacle_ned_n(self) -> Vec3:
        """What the nozzle does to the receptacle now."""
        return (self.seen.force_n, self.seen.force_e, self.seen.force_d) if self._contact.latched else STILL

    @property
    def given_kg(self) -> float:
        """Fuel that has gone to the receiver."""
        return self._fuel.given_kg

    @property
    def contact(self) -> bool:
        """Whether the nozzle is latched."""
        return self._contact.latched

    @property
    def events(self) -> list[tuple[float, str]]:
        """Contacts and disconnects: seconds since the start, and what."""
        return self._contact.events

    @property
    def contacts(self) -> int:
        """How often the nozzle latched."""
        return self._contact.contacts

    @property
    def disconnects(self) -> dict[str, int]:
        """How often it let go, by reason."""
        return dict(self._contact.disconnects)

    @property
    def peak_load_n(self) -> float:
        """Largest load at the nozzle in any contact so far."""
        return self._contact.peak_load_n
