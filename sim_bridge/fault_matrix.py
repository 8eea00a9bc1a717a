"""The fault matrix: one short flight per fault, what has to come of it, and a table of what did.

Rules
-----
* A flight begins near the box, docks by the refuelling's own phases made short, and suffers its fault 1 s into the hold
  (a cell may say otherwise). It goes on for ``WATCH_S`` after the fault has begun, in a breakaway for
  ``BREAKAWAY_WATCH_S``.
* Every cell ends held, in breakaway or, when a pilot seems to have taken over, in standby; never outside the limit box
  below the tanker, never in a collision (``sim_bridge.scoring.Safety``); no setpoint is ever not finite.
* A breakaway begins within ``REACTION_S`` of its cause: the fault itself, or ``because_s`` later, where the fault
  becomes a cause by lasting (``None``: it comes so slowly that no instant can be named).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from companion.app import warm_up
from companion.config import Setup, Vec3
from companion.messages import (
    NS,
    AttitudeSetpoint,
    Output,
    Phase,
    PhaseChange,
    Reject,
    VisionOutput,
)
from companion.runtime import Service, in_phase_s
from sim_bridge.faults import parse_fault
from sim_bridge.flight import LockstepCompanion, Unrecorded, run
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.scoring import Safety
from sim_bridge.simulation import BoxTruth, Simulation, nominal_heading_rad

WATCH_S = 6.0
BREAKAWAY_WATCH_S = 4.0
REACTION_S = 0.5
NEAR_M, FARTHER_M = (-33.0, -0.5, 10.7), (-42.0, -3.0, 18.0)
"""Where flights begin, in tanker axes: 4.4 m and 16 m from the box."""
HELD, BREAKAWAY, STANDBY = "held", "breakaway", "standby"
EITHER = "held or breakaway"
OBSERVATION = "observation"
"""Not cleared any farther."""
UNSEEN = ("sight lost", "integrity failed")
"""Why, when vision gives nothing that could be believed: no pose, or one that guarantees too little."""
BLIND = ("attitude stale", "sight lost")
"""Why, when there is no attitude: without one nothing is looked for in pictures either."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A named flight: ``faults`` as the command line writes them, and how it has to end, with the reason.

    ``causes``: how the reason for a breakaway may begin, any when there are none; ``rejects``: what has to be counted.
    """

    name: str
    faults: tuple[str, ...]
    ends: str
    why: str
    causes: tuple[str, ...] = ()
    because_s: float | None = 0.0
    rejects: tuple[str, ...] = ()
    watch_s: float = WATCH_S
    start_tanker_m: Vec3 = NEAR_M


def _cell(fault: str, ends: str, why: str, *causes: str, name: str = "", because_s: float | None = 0.0,
          rejects: tuple[str, ...] = (), watch_s: float = WATCH_S, start: Vec3 = NEAR_M) -> Cell:
    """Return the cell of one fault, 1 s into the hold unless it says when."""
    when = fault if "@" in fault else f"{fault}@hold+1"
    name = name or fault.partition("@")[0].replace(".", "-")
    return Cell(name, (when,), ends, why, causes, because_s, rejects, watch_s, start)


MATRIX: tuple[Cell, ...] = (
    _cell("camera.off", BREAKAWAY, "nothing is seen any more", "sight lost"),
    _cell("camera.stuck", BREAKAWAY, "a picture that repeats bit for bit is none", "sight lost",
          rejects=("camera.frozen",)),
    _cell("camera.garbage", BREAKAWAY, "no pose explains noise", *UNSEEN),
    _cell("camera.wrong", BREAKAWAY, "a mirrored tanker is none", *UNSEEN),
    _cell("camera.slow", BREAKAWAY, "one picture a second is too few to close in on", "sight lost"),
    _cell("camera.delayed", EITHER, "pictures are put where they belong in time, or what they protect is too old",
          *UNSEEN),
    _cell("camera.intermittent", HELD, "gaps of 0.3 s are bridged by inertial data"),
    _cell("datalink.off", BREAKAWAY, "where the tanker goes is not told any more", "datalink stale"),
    _cell("datalink.stuck", BREAKAWAY, "a tanker that flies does not stand still", "datalink stale"),
    _cell("datalink.garbage", BREAKAWAY, "no checksum holds", "datalink stale"),
    _cell("datalink.wrong", HELD, "vision carries the position"),
    _cell("datalink.slow", BREAKAWAY, "2.5 reports a second are too few", "datalink stale"),
    _cell("datalink.delayed", BREAKAWAY, "a stamp that old when its bytes come is not believed", "datalink stale"),
    _cell("datalink.intermittent", HELD, "gaps of 0.3 s are bridged"),
    _cell("gps.off", HELD, "vision carries the position, the INS the rest"),
    _cell("gps.stuck", HELD, "vision carries the position"),
    _cell("gps.garbage", HELD, "vision carries the position"),
    _cell("gps.wrong", HELD, "vision carries the position"),
    _cell("gps.slow", HELD, "vision carries the position"),
    _cell("gps.delayed", HELD, "vision carries the position"),
    _cell("gps.intermittent", HELD, "vision carries the position"),
    _cell("attitude.off", BREAKAWAY, "without attitude there is no estimate", *BLIND),
    _cell("attitude.stuck", BREAKAWAY, "an attitude that repeats bit for bit is none", *BLIND),
    _cell("attitude.garbage", BREAKAWAY, "no aircraft turns like that", *BLIND),
    _cell("attitude.wrong", BREAKAWAY, "vision and INS disagree about roll", "attitude stale", *UNSEEN),
    _cell("attitude.slow", EITHER, "5 a second, carried on by the body rates, or vision tells that badly", *UNSEEN,
          because_s=None),
    _cell("attitude.delayed", BREAKAWAY, "too old to fly on", "estimate lost", *BLIND),
    _cell("attitude.intermittent", EITHER, "gaps of 0.3 s are bridged by the body rates, or vision tells that badly",
          *UNSEEN, because_s=None),
    _cell("heartbeat.off", BREAKAWAY, "three seconds without one", "autopilot lost", because_s=3.0),
    _cell("heartbeat.stuck", HELD, "it says what is true all the same"),
    _cell("heartbeat.garbage", BREAKAWAY, "no checksum holds", "autopilot lost", because_s=3.0),
    _cell("heartbeat.wrong", STANDBY, "MANUAL is a pilot's: hands off, silence"),
    _cell("heartbeat.slow", BREAKAWAY, "one in ten seconds is too few", "autopilot lost", because_s=3.0),
    _cell("heartbeat.delayed", HELD, "a heartbeat may be late"),
    _cell("heartbeat.intermittent", HELD, "never two seconds without one"),
)
"""{camera, datalink, gps, attitude, heartbeat} x {off, stuck, garbage, wrong, slow, delayed, intermittent}."""

MORE: tuple[Cell, ...] = (
    _cell("camera.late", BREAKAWAY, "pictures stamped 0.3 s too new contradict the INS", *UNSEEN, because_s=0.3),
    _cell("camera.shifted", BREAKAWAY, "all lights 10 px aside contradict the INS", *UNSEEN),
    _cell("camera.boresight", BREAKAWAY, "a mount that has turned by 1 degree contradicts the INS", *UNSEEN),
    _cell("camera.boom", HELD, "the boom hides the middle of the picture"),
    _cell("lights.one", HELD, "eight lights are enough"),
    _cell("lights.half", HELD, "four lights are enough to go on"),
    _cell("lights.all", BREAKAWAY, "nothing is seen any more", *UNSEEN),
    _cell("lights.moved", HELD, "a light out of its place is left out"),
    _cell("datalink.late", EITHER, "vision carries the position, as long as the tanker flies straight", *UNSEEN,
          because_s=None),
    _cell("datalink.height", HELD, "vision carries the position"),
    _cell("datalink.velocity", BREAKAWAY, "velocity, position and vision disagree", "integrity failed",
          "sight lost", "datalink stale"),
    _cell("datalink.turned", BREAKAWAY, "an attitude and a velocity that no tanker could have got so fast",
          "datalink stale"),
    _cell("datalink.nan", BREAKAWAY, "values that are none are refused", "datalink stale",
          rejects=("datalink.not_finite",)),
    _cell("gps.drag", HELD, "vision carries the position"),
    _cell("attitude.late", BREAKAWAY, "attitudes stamped 0.3 s too new contradict vision", *UNSEEN, because_s=0.3),
    _cell("attitude.nan", BREAKAWAY, "values that are none are refused", *BLIND,
          rejects=("mavlink.not_finite",)),
    _cell("position.off", BREAKAWAY, "where the receiver goes is not told any more", "position stale", "sight lost"),
    _cell("position.stuck", BREAKAWAY, "a receiver that flies does not stand still", "position stale", "sight lost"),
    _cell("position.garbage", BREAKAWAY, "no aircraft flies like that", "position stale", "sight lost"),
    _cell("position.wrong", HELD, "vision carries the position"),
    _cell("position.slow", HELD, "5 a second, carried on by the velocity"),
    _cell("position.delayed", BREAKAWAY, "too old to fly on", "estimate lost", "position stale", "sight lost"),
    _cell("position.intermittent", EITHER, "gaps of 0.3 s are bridged, or the swing that they make is seen", *UNSEEN,
          because_s=None),
    _cell("position.late", BREAKAWAY, "velocities of 0.3 s ago swing up until vision contradicts", *UNSEEN,
          "estimate lost", because_s=None),
    _cell("position.nan", BREAKAWAY, "values that are none are refused", "position stale", "sight lost",
          rejects=("mavlink.not_finite",)),
    _cell("link.second_vehicle", HELD, "another system's telemetry and commands are not ours",
          rejects=("mavlink.foreign_source",)),
    _cell("link.forged", HELD, "attitudes that no aircraft could turn to are refused"),
    _cell("clock.backwards", BREAKAWAY, "stamps that go back are refused", *BLIND),
    _cell("clock.step", BREAKAWAY, "what was stamped before cannot be put beside what comes after"),
    _cell("camera.boresight@0", OBSERVATION, "a mount that is 1 degree off is seen before anybody closes in",
          name="mount-off-at-first", watch_s=15.0, start=FARTHER_M),
    _cell("lights.moved@0", EITHER, "a light that is not where the map has it is left out", name="map-wrong-at-first",
          watch_s=22.0, because_s=None),
    _cell("datalink.height@0", OBSERVATION, "another height datum is seen before anybody closes in",
          name="height-datum-at-first", watch_s=15.0, start=FARTHER_M),
    _cell("camera.off@approach+1.5", BREAKAWAY, "nothing is seen any more", "sight lost", name="approach-camera-off"),
    _cell("datalink.off@approach+1.5", BREAKAWAY, "where the tanker goes is not told any more",
          "datalink stale", name="approach-datalink-off"),
    _cell("gps.wrong@approach+1.5", EITHER, "vision carries the position, or is not let to when GPS contradicts so far",
          "integrity failed", because_s=None, name="approach-gps-wrong", watch_s=15.0),
    _cell("attitude.off@approach+1.5", BREAKAWAY, "without attitude there is no estimate", *BLIND,
          name="approach-attitude-off"),
)
"""What else goes wrong."""


def matrix_flight(cell: Cell, seed: int, **scenario_fields: Any) -> tuple[Scenario, Setup]:
    """Return scenario and companion of a cell: the thesis' camera, detections, a refuelling's phases made short."""
    scenario = msgspec.structs.replace(
        load_scenario("thesis"), name=cell.name, seed=seed, start_tanker_m=cell.start_tanker_m, hold_s=60.0,
        timeout_s=90.0, vision_input="detections", faults=tuple(map(parse_fault, cell.faults)), **scenario_fields,
    )
    setup = scenario.setup()
    guidance = msgspec.structs.replace(
        setup.config.guidance, auto_engage=True, auto_gates=True, self_test=False, pre_contact_m=(-3.6, 0.0, 1.2),
        join_settle_s=1.0, observation_s=0.5, stabilise_s=0.5, may_dock_s=0.5, capture_s=0.5, contact_near_m=0.5,
    )
    config = msgspec.structs.replace(setup.config, guidance=guidance)
    return scenario, msgspec.structs.replace(setup, config=config)


@dataclass
class CellFlight:
    """What came of a cell. ``wild``: setpoints that were not finite or outside the envelope."""

    cell: Cell
    phases: list[PhaseChange] = field(default_factory=list)
    rejects: Counter[str] = field(default_factory=Counter)
    wild: int = 0
    fault_ns: int | None = None
    safety: dict[str, Any] = field(default_factory=dict)
    plant_failure: str | None = None

    @property
    def ended(self) -> str:
        """Return held, breakaway, standby, or the phase it is in."""
        last = self.phases[-1].new if self.phases else Phase.STANDBY
        return HELD if last in (Phase.HOLD, Phase.CONTACT) else str(last)

    @property
    def reason(self) -> str:
        """Return why the first breakaway, or a standby, came; empty without."""
        return next((c.reason for c in self.phases if c.new in (Phase.BREAKAWAY, Phase.STANDBY)), "")

    @property
    def safe(self) -> bool:
        """Whether nothing dangerous has happened, whatever the end."""
        s = self.safety
        return not (s["collision"] or s["outside_limit_m"] > 0.0 or self.wild or self.plant_failure)

    @property
    def as_it_has_to(self) -> bool:
        """Whether it ended as it has to, for a reason that it may have, and what was refused was counted."""
        cell = self.cell
        because = self.ended != BREAKAWAY or not cell.causes or self.reason.startswith(cell.causes)
        return self.ended in cell.ends and because and all(name in self.rejects for name in cell.rejects)

    @property
    def in_time(self) -> bool:
        """Whether a breakaway that has an instant to count from began soon enough, and not before its cause."""
        delay_s, because_s = self.safety["breakaway_delay_s"], self.cell.because_s
        if self.ended != BREAKAWAY or because_s is None:
            return True
        return delay_s is not None and delay_s <= because_s + REACTION_S


class Watched:
    """Ends a flight some time after its fault has begun, or after a breakaway has."""

    def __init__(self, simulation: Simulation, watch_s: float, timeout_s: float) -> None:
        self._simulation, self._watch_s, self._timeout_s = simulation, watch_s, timeout_s

    def reached(self, t_ns: int, service: Service) -> bool:
        """Tell whether enough has been seen."""
        begin_ns = self._simulation.fault_began_ns
        seen_enough = begin_ns is not None and (t_ns - begin_ns) * NS >= self._watch_s
        away = in_phase_s(service, Phase.BREAKAWAY, t_ns) >= BREAKAWAY_WATCH_S
        return t_ns * NS >= self._timeout_s or seen_enough or away


def fly_cell(cell: Cell, seed: int, companion_of: Callable[..., LockstepCompanion] = LockstepCompanion) -> CellFlight:
    """Fly a cell in lockstep; ``companion_of`` builds the companion."""
    scenario, setup = matrix_flight(cell, seed)
    warm_up(setup)
    flight, box, safety = CellFlight(cell), BoxTruth(setup, nominal_heading_rad(scenario)), Safety(setup.tanker.window)
    guidance, alpha_rad = setup.config.guidance, setup.airframe.trim.alpha_rad

    def see(output: Output) -> None:
        if isinstance(output, PhaseChange):
            flight.phases.append(output)
        elif isinstance(output, AttitudeSetpoint):
            inside = (
                abs(output.roll_rad) <= guidance.max_roll_rad + 1e-9 and 0.0 <= output.thrust <= 1.0
                and abs(output.pitch_rad - alpha_rad) <= guidance.max_pitch_offset_rad + 1e-9
                and math.isfinite(output.yaw_rad)
            )
            flight.wild += not inside
        reject = output.reject if isinstance(output, VisionOutput) else output
        if isinstance(reject, Reject):
            flight.rejects[f"{reject.source}.{reject.reason}"] += 1

    simulation = Simulation(scenario, setup)
    companion = companion_of(setup, Unrecorded(), see)
    ending = Watched(simulation, cell.watch_s, scenario.timeout_s)
    flight.plant_failure = run(simulation, companion, ending, lambda t: safety.see(t, box.p_mrf_br_m(t)))
    flight.fault_ns = simulation.fault_began_ns
    flight.safety = safety.result(flight.phases, flight.fault_ns)
    return flight


HEAD = "| fault | has to end | ended | because of | breakaway after | |\n|---|---|---|---|---|---|"


def row(flight: CellFlight) -> str:
    """Return a flight as a row of the table."""
    cell, delay_s = flight.cell, flight.safety["breakaway_delay_s"]
    after = "" if delay_s is None or flight.ended != BREAKAWAY else f"{delay_s:.2f} s"
    if after and cell.because_s:
        after += f" (its limit is {cell.because_s:g} s)"
    wrong = not (flight.as_it_has_to and flight.safe and flight.in_time)
    mark = "**wrong**" if wrong else ""
    because = cell.why if flight.ended == HELD else flight.reason
    return f"| `{cell.faults[0]}` | {cell.ends} | {flight.ended} | {because} | {after} | {mark} |"


def table(seed: int, tell: Callable[[str], None], cells: tuple[Cell, ...] = MATRIX + MORE) -> str:
    """Fly all cells with one seed; return a Markdown table, telling each row as it comes."""
    rows = []
    for cell in cells:
        rows.append(row(fly_cell(cell, seed)))
        tell(rows[-1])
    return "\n".join([HEAD, *rows])

