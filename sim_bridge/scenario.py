"""A scenario: everything that a flight depends on besides the aircraft and the companion's configuration.

Rules
-----
* SCENARIO on the command line is a file, or the name of a shipped one (``sim_bridge/scenarios/NAME.toml``).
* A scenario names one companion TOML, relative to itself; camera, tanker and airframe come from there, so that both
  ends of a flight read the same files.
* Values that have the right type and still cannot be flown are a ``ConfigError`` before anything starts.
"""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import Literal

import msgspec

from companion.config import ConfigError, Setup, Struct, Vec3, load, load_setup
from companion.messages import Command
from sim_bridge.faults import Fault, fault_rules
from sim_bridge.plant.conditions import PlantConditions, plant_rules
from sim_bridge.scene.conditions import PictureConditions, condition_rules
from sim_bridge.sensor_conditions import SensorConditions, sensor_rules

SCENARIOS = Path(__file__).resolve().parent / "scenarios"

DATALINK_FRAME_BITS = 55 * 10
"""55 bytes (thesis 3.2) with a start and a stop bit each."""

TANKER_SPACE_M = ((-31.0, 29.0), (-26.0, 26.0), (-14.0, 6.0))
"""Where the receiver's centre of mass would touch the tanker, per tanker axis.

A KC-135R of 41.5 m length and 39.9 m span (estimated extent about the centre of mass: 24 m aft, 22 m forward, 20 m to
each side, 12 m up to the fin, 4 m down to the nacelles), grown by half a receiver (7 m, 6 m, 2 m).
"""


class DatalinkScenario(Struct, frozen=True, kw_only=True):
    """The serial line from the tanker: bits per second on the wire (8N1), and how often it tells its state."""

    rate_baud: int = 19600
    report_rate_hz: float = 25.0


class LinkScenario(Struct, frozen=True, kw_only=True):
    """The link to the autopilot: how long setpoints take on it, beyond nothing at all (in lockstep only)."""

    setpoint_delay_s: float = 0.0


class PassCriteria(Struct, frozen=True, kw_only=True):
    """When a flight counts as docked: this share of the hold inside the desired window of thesis Tab. 1.1."""

    in_window_fraction: float = 0.95


class TimedCommand(Struct, frozen=True, kw_only=True):
    """What the operator sends ``at_s`` seconds into the flight."""

    at_s: float
    command: Command


class Scenario(Struct, frozen=True, kw_only=True):
    """One flight. ``start_tanker_m`` is the receiver's centre of mass in tanker axes (thesis x0, 1.2).

    ``companion`` is the companion TOML; ``load_scenario`` makes it a path from anywhere. ``hold_s`` is how long the
    receiver stays in the window, ``timeout_s`` when the flight ends whatever happens. ``picture``: light and clutter;
    ``plant``: wind, the tanker's course, the boom, errors of the airframe's data. ``sensors``: outages and biases
    of GPS, drift of the INS. ``vision_input``: what the camera hands over, pictures or, quicker by far, detections of
    ``sensors.markers`` (``sim_bridge.marker_sensor``; lockstep only). ``faults``: what fails, and when.
    """

    name: str
    companion: str
    start_tanker_m: Vec3 = (-50.0, -20.0, 30.0)
    heading_rad: float = 0.0
    turbulence: Literal["none", "light", "moderate", "severe"] = "light"
    wake: bool = True
    seed: int = 1
    hold_s: float = 60.0
    timeout_s: float = 180.0
    datalink: DatalinkScenario = DatalinkScenario()
    link: LinkScenario = LinkScenario()
    criteria: PassCriteria = PassCriteria()
    commands: tuple[TimedCommand, ...] = ()
    picture: PictureConditions = PictureConditions()
    plant: PlantConditions = PlantConditions()
    vision_input: Literal["pictures", "detections"] = "pictures"
    sensors: SensorConditions = SensorConditions()
    faults: tuple[Fault, ...] = ()

    def setup(self) -> Setup:
        """Load the companion configuration and what it names."""
        return load_setup(self.companion)


def shipped() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    return sorted(file.stem for file in SCENARIOS.glob("*.toml"))


def find_scenario(name_or_path: str) -> Path:
    """Return the file of a shipped scenario or the given file; raises ConfigError naming the shipped ones."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    if name_or_path in shipped():
        return SCENARIOS / f"{name_or_path}.toml"
    near = difflib.get_close_matches(name_or_path, shipped(), n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    msg = f"{name_or_path}: no such scenario; {hint}shipped are {', '.join(shipped())}, or give a .toml file"
    raise ConfigError(msg)


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Load and check a scenario; its ``companion`` comes back as a path that holds from any working directory."""
    path = find_scenario(str(name_or_path))
    scenario = load(path, Scenario)
    check(scenario, path)
    companion = (path.parent / scenario.companion).resolve()
    if not companion.is_file():
        msg = f"{path}: companion: {companion}: no such file"
        raise ConfigError(msg)
    return msgspec.structs.replace(scenario, companion=str(companion))


def check(s: Scenario, path: Path) -> None:
    """Raise ConfigError on values that are of the right type and still cannot be flown."""
    inside = all(low <= x <= high for x, (low, high) in zip(s.start_tanker_m, TANKER_SPACE_M, strict=True))
    fastest_hz = s.datalink.rate_baud / DATALINK_FRAME_BITS
    rules = [
        (not inside, f"start_tanker_m: {list(s.start_tanker_m)} metres is inside the tanker; start behind and below"),
        (math.hypot(*s.start_tanker_m) <= 2000.0, "start_tanker_m: more than 2000 metres from the tanker"),
        (abs(s.heading_rad) <= 2 * math.pi, "heading_rad: not within one turn (radians, not degrees)"),
        (s.seed >= 0, "seed: must not be negative"),
        (s.hold_s > 0, "hold_s: must be positive seconds"),
        (s.timeout_s > s.hold_s, "timeout_s: must be longer than hold_s, both in seconds"),
        (s.timeout_s <= 3600, "timeout_s: at most 3600 seconds"),
        (300 <= s.datalink.rate_baud <= 4_000_000, "datalink.rate_baud: must be in 300..4000000 bits per second"),
        (0 < s.datalink.report_rate_hz <= 200, "datalink.report_rate_hz: must be in 0..200 hertz"),
        (s.datalink.report_rate_hz <= fastest_hz,
         f"datalink.report_rate_hz: 55-byte frames at {s.datalink.rate_baud} bits per second go at most "
         f"{fastest_hz:.1f} hertz"),
        (0 <= s.link.setpoint_delay_s <= 1, "link.setpoint_delay_s: must be in 0..1 seconds"),
        (all(0 <= c.at_s <= s.timeout_s for c in s.commands), "commands: at_s must be in 0..timeout_s seconds"),
        (0 < s.criteria.in_window_fraction <= 1, "criteria.in_window_fraction: must be in 0..1"),
        *condition_rules(s.picture),
        *plant_rules(s.plant),
        *sensor_rules(s.sensors),
        *fault_rules(s.faults),
    ]
    for holds, text in rules:
        if not holds:
            msg = f"{path}: {text}"
            raise ConfigError(msg)
