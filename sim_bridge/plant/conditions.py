"""What the air, the tanker, the boom and the airframe of a flight are like: parts of a scenario, used by the plant.

Every default is what the plant does without being asked: straight flight, no wind, a boom worked by its automatic
operator, an aircraft as its data say.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Literal

import msgspec

from companion.config import Struct
from sim_bridge.plant.aircraft_data import read_aircraft


class WindConfig(Struct, frozen=True, kw_only=True):
    """Steady wind at the tanker's altitude (where the air goes, ``ned``), and its change per metre of height above."""

    north_m_s: float = 0.0
    east_m_s: float = 0.0
    north_shear_per_s: float = 0.0
    east_shear_per_s: float = 0.0


class CourseConfig(Struct, frozen=True, kw_only=True):
    """How the tanker flies: straight on, or a racetrack of two legs and two half turns at ``bank_rad``.

    ``leg_s`` before each turn; ``turn`` to the right or the left.
    """

    kind: Literal["straight", "racetrack"] = "straight"
    bank_rad: float = math.radians(15.0)
    leg_s: float = 60.0
    turn: Literal["right", "left"] = "right"


class StickInput(Struct, frozen=True, kw_only=True):
    """From ``at_s`` on the boom operator's stick is here: -1..1 up, right; telescope out."""

    at_s: float
    up: float = 0.0
    right: float = 0.0
    extend: float = 0.0


class BoomConditions(Struct, frozen=True, kw_only=True):
    """Who works the boom, and what flows through it.

    ``fixed``: it hangs still at its nominal angles, as a rigid body. ``automatic``: an operator who holds it clear,
    goes for the receptacle when the receiver is steady in the window (``contact_after_s``), follows, and disconnects at
    the envelope's limits or when ``fuel_kg`` is given. ``joystick``: by ``stick`` here, or by MANUAL_CONTROL messages.
    """

    operator: Literal["automatic", "joystick", "fixed"] = "automatic"
    contact_after_s: float = 10.0
    fuel_kg: float = 600.0
    flow_kg_s: float = 15.0
    stick: tuple[StickInput, ...] = ()


class AirframeErrors(Struct, frozen=True, kw_only=True):
    """By what the simulated receiver differs from its data: factors on coefficients, and more delay of its actuators.

    ``coefficients``: factor by name, as ``aircraft/ice101/ice101.xml`` spells them (``coef/NAME``); ``effectiveness``:
    the one on all effectors; ``actuator_delay_s``: beyond the actuators' own.
    """

    coefficients: dict[str, float] = msgspec.field(default_factory=dict)
    effectiveness: float = 1.0
    actuator_delay_s: float = 0.0


class PlantConditions(Struct, frozen=True, kw_only=True):
    """All of them."""

    wind: WindConfig = WindConfig()
    course: CourseConfig = CourseConfig()
    boom: BoomConditions = BoomConditions()
    airframe: AirframeErrors = AirframeErrors()


def plant_rules(c: PlantConditions) -> list[tuple[bool, str]]:
    """Return what must hold of the conditions, each with the text for when it does not."""
    w, b, a = c.wind, c.boom, c.airframe
    sticks = [(s.up, s.right, s.extend) for s in b.stick]
    return [
        (math.hypot(w.north_m_s, w.east_m_s) <= 80.0, "plant.wind: more than 80 m/s"),
        (max(abs(w.north_shear_per_s), abs(w.east_shear_per_s)) <= 0.2,
         "plant.wind: shear of more than 0.2 m/s per metre"),
        (0.02 <= c.course.bank_rad <= math.radians(30.0),
         "plant.course.bank_rad: must be in 0.02..0.52 (radians, not degrees: 15 degrees are 0.26)"),
        (c.course.leg_s > 0.0, "plant.course.leg_s: must be positive seconds"),
        (b.contact_after_s >= 0.0, "plant.boom.contact_after_s: must not be negative"),
        (0.0 <= b.fuel_kg <= 4000.0, "plant.boom.fuel_kg: must be in 0..4000 kilograms"),
        (0.0 < b.flow_kg_s <= 60.0, "plant.boom.flow_kg_s: must be in 0..60 kilograms per second"),
        (all(abs(v) <= 1.0 for s in sticks for v in s), "plant.boom.stick: up, right and extend must be in -1..1"),
        (all(s.at_s >= 0.0 for s in b.stick), "plant.boom.stick: at_s must not be negative"),
        (all(math.isfinite(v) and -3.0 <= v <= 3.0 for v in a.coefficients.values()),
         "plant.airframe.coefficients: factors must be in -3..3"),
        (0.0 < a.effectiveness <= 3.0, "plant.airframe.effectiveness: must be in 0..3"),
        (0.0 <= a.actuator_delay_s <= 1.0, "plant.airframe.actuator_delay_s: must be in 0..1 seconds"),
        *((False, text) for text in coefficient_faults(a.coefficients)),
    ]


def coefficient_faults(names: Mapping[str, float]) -> list[str]:
    """Return what is wrong with the names of the receiver's coefficients; raises PlantError when its file is bad."""
    if not names:
        return []
    known = [name for name in read_aircraft("ice101").coefficients if name != "effectiveness"]
    faults = []
    for name in names:
        if name == "effectiveness":
            faults.append("plant.airframe.coefficients: effectiveness goes into plant.airframe.effectiveness")
        elif name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"
            faults.append(f"plant.airframe.coefficients: ice101 has no coefficient {name!r}; {hint}")
    return faults
