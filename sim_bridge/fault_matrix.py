"""The fault matrix flown: one short flight per cell (``sim_bridge.fault_cells``), and what came of it.

Rules
-----
* A flight begins near the box, docks by the refuelling's own phases made short, and suffers its fault 1 s into the hold
  (a cell may say otherwise). It goes on for ``watch_s`` after the fault has begun, in a breakaway for ``AWAY_S``, or
  for ``LEVEL_S``, by which the receiver is level again.
* It has to end as its cell says, and never, whatever the end: outside the limit box below the tanker, in a collision
  (``sim_bridge.scoring.Safety``), with a setpoint that is not finite or outside the envelope, or let to dock while
  the estimate of BR is truly off by more than its alert limit.
* The fault has to have arrived: it has changed samples, or what the sensors see.
* What the delay of a breakaway counts from, is measured (``CellFlight.cause_ns``).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from companion.app import warm_up
from companion.config import Setup
from companion.geometry import Vec
from companion.guidance.causes import (
    ATTITUDE_STALE,
    DATALINK_STALE,
    ESTIMATE_LOST,
    INTEGRITY_FAILED,
    POSITION_STALE,
    SIGHT_LOST,
    failing,
)
from companion.messages import (
    NS,
    AttitudeSetpoint,
    AutopilotStatus,
    Event,
    Integrity,
    Output,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    VisionOutput,
)
from companion.runtime import Service, in_phase_s
from sim_bridge.fault_cells import BREAKAWAY, HEARTBEAT_LOST_S, REACTION_S, Cell, Since
from sim_bridge.faults import parse_fault
from sim_bridge.flight import LockstepCompanion, Unrecorded, run
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.scoring import Safety
from sim_bridge.simulation import BoxTruth, Simulation, nominal_heading_rad
from sim_bridge.truth import Truth

AWAY_S, LEVEL_S = 4.0, 12.0
SOURCE_OF = {
    SIGHT_LOST: "sight_ns", DATALINK_STALE: "tanker_ns", ATTITUDE_STALE: "attitude_ns", POSITION_STALE: "position_ns",
}
"""Whose newest sample it is that has got too old."""


def shortened(setup: Setup) -> Setup:
    """Return a companion that flies all phases of a refuelling but the self-test, from near and without operators."""
    guidance = msgspec.structs.replace(
        setup.config.guidance, procedure="refuelling", auto_engage=True, auto_gates=True, self_test=False,
        pre_contact_m=(-3.6, 0.0, 1.2), join_settle_s=1.0, observation_s=0.5, stabilise_s=0.5, may_dock_s=0.5,
        capture_s=0.5, contact_near_m=0.3, contact_closure_m_s=0.3, closure_m_s2=0.3,
    )
    return msgspec.structs.replace(setup, config=msgspec.structs.replace(setup.config, guidance=guidance))


def matrix_flight(cell: Cell, seed: int, **scenario_fields: Any) -> tuple[Scenario, Setup]:
    """Return scenario and companion of a cell: the thesis' camera, detections, a refuelling's phases made short."""
    scenario = msgspec.structs.replace(
        load_scenario("thesis"), name=cell.name, seed=seed, start_tanker_m=cell.start_tanker_m, hold_s=60.0,
        timeout_s=90.0, vision_input="detections", faults=tuple(map(parse_fault, cell.faults)), **scenario_fields,
    )
    return scenario, shortened(scenario.setup())


@dataclass
class CellFlight:
    """What came of a cell.

    ``touched``: how many samples, or instants, each fault has changed. ``wild``: setpoints that were not finite or
    outside the envelope. ``errors``: instant in ns, true error of BR (3,) in m, and as a share of the alert limit, the
    worst axis (NaN without integrity). ``misled``: instants at which integrity let dock with an error beyond the alert
    limit. ``heartbeats_ns`` of the autopilot, as they came. ``reason_ns``: since when the first breakaway's reason had
    held, as far as it is one that comes by lasting.
    """

    cell: Cell
    phases: list[PhaseChange] = field(default_factory=list)
    rejects: Counter[str] = field(default_factory=Counter)
    touched: tuple[int, ...] = ()
    wild: int = 0
    misled: int = 0
    errors: list[tuple[int, float, float]] = field(default_factory=list)
    heartbeats_ns: list[int] = field(default_factory=list)
    reason_ns: int | None = None
    fault_ns: int | None = None
    safety: dict[str, Any] = field(default_factory=dict)
    plant_failure: str | None = None

    @property
    def ended(self) -> str:
        """Return held, breakaway, standby, or the phase it is in."""
        last = self.phases[-1].new if self.phases else Phase.STANDBY
        return "held" if last in (Phase.HOLD, Phase.CONTACT) else str(last)

    @property
    def reason(self) -> str:
        """Return why the first breakaway, or a standby, came; empty without."""
        return next((c.reason for c in self.phases if c.new in (Phase.BREAKAWAY, Phase.STANDBY)), "")

    @property
    def broke_ns(self) -> int | None:
        """Return when the first breakaway began, before the fault or after it; None without one."""
        return next((c.t_ns for c in self.phases if c.new is Phase.BREAKAWAY), None)

    @property
    def cause_ns(self) -> int | None:
        """Return when what the breakaway came of began (``fault_cells.Since``); None without either."""
        if self.fault_ns is None or self.broke_ns is None:
            return None
        broke_ns = self.broke_ns
        if self.cell.since is Since.HEARTBEAT:
            last_ns = max((t_ns for t_ns in self.heartbeats_ns if t_ns < broke_ns), default=0)
            return last_ns + round(HEARTBEAT_LOST_S / NS)
        if self.cell.since is Since.REASON:
            off = (t_ns for t_ns, _, share in self.errors if t_ns >= self.fault_ns and share > 1.0)
            return min(broke_ns if self.reason_ns is None else max(self.reason_ns, self.fault_ns), next(off, broke_ns))
        return self.fault_ns + round(self.cell.at_s / NS)

    def off(self) -> tuple[float, float]:
        """Return how far BR was told wrong after the fault, to the breakaway or the end: m, share of what may be."""
        end_ns = math.inf if self.broke_ns is None else self.broke_ns
        since = [e for e in self.errors if self.fault_ns is not None and self.fault_ns <= e[0] <= end_ns]
        shares = [share for _, _, share in since if math.isfinite(share)]
        return max((error_m for _, error_m, _ in since), default=math.nan), max(shares, default=math.nan)

    @property
    def safe(self) -> bool:
        """Whether nothing dangerous has happened, whatever the end."""
        s = self.safety
        return not (s["collision"] or s["outside_limit_m"] > 0.0 or self.wild or self.misled or self.plant_failure)

    @property
    def suffered(self) -> bool:
        """Whether its faults have begun and have changed something."""
        return self.fault_ns is not None and len(self.touched) > 0 and all(self.touched)

    @property
    def as_it_has_to(self) -> bool:
        """Whether it ended as it has to, for a reason that it may have, and what was refused was counted."""
        cell = self.cell
        because = self.ended != BREAKAWAY[0] or not cell.causes or self.reason.startswith(cell.causes)
        return self.ended in cell.ends and because and all(name in self.rejects for name in cell.rejects)

    @property
    def in_time(self) -> bool:
        """Whether a breakaway began soon enough after its cause, and not before it, nor too long after its fault."""
        if self.broke_ns is None:
            return True
        if self.fault_ns is None or self.cause_ns is None:
            return False
        reaction_s, delay_s = (self.broke_ns - self.cause_ns) * NS, (self.broke_ns - self.fault_ns) * NS
        return 0.0 <= reaction_s <= REACTION_S and delay_s <= self.cell.bound_s

    @property
    def right(self) -> bool:
        """Whether all of that holds."""
        return self.suffered and self.safe and self.as_it_has_to and self.in_time


class Watched:
    """Ends a flight some time after its fault has begun, or after a breakaway has."""

    def __init__(self, simulation: Simulation, watch_s: float, away_s: float, timeout_s: float) -> None:
        self._simulation, self._watch_s, self._away_s, self._timeout_s = simulation, watch_s, away_s, timeout_s

    def reached(self, t_ns: int, service: Service) -> bool:
        """Tell whether enough has been seen."""
        if service.phase is Phase.BREAKAWAY:
            return in_phase_s(service, Phase.BREAKAWAY, t_ns) >= self._away_s or t_ns * NS >= self._timeout_s
        begin_ns = self._simulation.fault_began_ns
        seen_enough = begin_ns is not None and (t_ns - begin_ns) * NS >= self._watch_s
        return t_ns * NS >= self._timeout_s or seen_enough


class Witness(Unrecorded):
    """Notes of one flight what ``CellFlight`` tells: of its truth, of what comes to the companion and what it makes."""

    def __init__(self, flight: CellFlight, scenario: Scenario, setup: Setup) -> None:
        self._flight, self._guidance = flight, setup.config.guidance
        self.companion: LockstepCompanion | None = None
        self._alpha_rad = setup.airframe.trim.alpha_rad
        self._box = BoxTruth(setup, nominal_heading_rad(scenario))
        self.safety = Safety(setup.tanker.window)
        self._truth: tuple[int, Vec] = (-1, np.zeros(3))
        self._error_m: tuple[int, Vec] = (-1, np.zeros(3))
        self._estimate_ns = self._protected_ns = 0

    def see(self, truth: Truth) -> None:
        """Take the truth."""
        self._truth = truth.t_ns, self._box.p_mrf_br_m(truth)
        self.safety.see(truth, self._truth[1])

    def event(self, event: Event) -> None:
        """Note heartbeats."""
        if isinstance(event, AutopilotStatus):
            self._flight.heartbeats_ns.append(event.t_ns)

    def watch(self, output: Output) -> None:
        """Note what the companion puts out."""
        flight = self._flight
        reject = output.reject if isinstance(output, VisionOutput) else output
        match output:
            case PhaseChange():
                if output.new is Phase.BREAKAWAY and flight.broke_ns is None:
                    flight.reason_ns = self._since_ns(output.reason)
                flight.phases.append(output)
            case AttitudeSetpoint():
                flight.wild += not self._inside(output)
            case RelativeState() if output.t_ns == self._truth[0]:
                self._estimate_ns = output.estimate_t_ns
                error_m = np.abs(output.p_mrf_br_m - self._truth[1])
                self._error_m = output.t_ns, error_m
                flight.errors.append((output.t_ns, float(np.linalg.norm(error_m)), math.nan))
            case Integrity() if output.t_ns == self._error_m[0]:
                self._judge(output)
        if isinstance(reject, Reject):
            flight.rejects[f"{reject.source}.{reject.reason}"] += 1

    def _inside(self, setpoint: AttitudeSetpoint) -> bool:
        """Tell whether a setpoint is finite and inside the envelope."""
        g = self._guidance
        return (
            abs(setpoint.roll_rad) <= g.max_roll_rad + 1e-9 and 0.0 <= setpoint.thrust <= 1.0
            and abs(setpoint.pitch_rad - self._alpha_rad) <= g.max_pitch_offset_rad + 1e-9
            and math.isfinite(setpoint.yaw_rad)
        )

    def _judge(self, integrity: Integrity) -> None:
        """Put the error beside what integrity says of it."""
        flight, share = self._flight, float((self._error_m[1] / integrity.alert_mrf_m).max())
        flight.errors[-1] = (*flight.errors[-1][:2], share)
        flight.misled += integrity.may_dock and share > 1.0
        if not failing(integrity):
            self._protected_ns = integrity.t_ns

    def _since_ns(self, reason: str) -> int | None:
        """Return when the last good sample, estimate or judgement was that a reason misses; None of other reasons."""
        if reason in SOURCE_OF:
            assert self.companion is not None  # nobody else has put out anything
            newest_ns: int | None = getattr(self.companion.service.pipeline.relative.sources(), SOURCE_OF[reason])
            return newest_ns
        if reason == ESTIMATE_LOST:
            return self._estimate_ns
        return self._protected_ns if reason.startswith(INTEGRITY_FAILED) else None


def fly_cell(
    cell: Cell, seed: int, companion_of: Callable[..., LockstepCompanion] = LockstepCompanion, away_s: float = AWAY_S
) -> CellFlight:
    """Fly a cell in lockstep; ``companion_of`` builds the companion. A breakaway is watched for ``away_s``."""
    scenario, setup = matrix_flight(cell, seed)
    warm_up(setup)
    flight = CellFlight(cell)
    witness = Witness(flight, scenario, setup)
    simulation = Simulation(scenario, setup)
    companion = witness.companion = companion_of(setup, witness, witness.watch)
    ending = Watched(simulation, cell.watch_s, away_s, scenario.timeout_s)
    flight.plant_failure = run(simulation, companion, ending, witness.see)
    flight.fault_ns, flight.touched = simulation.fault_began_ns, simulation.faults_touched
    flight.safety = witness.safety.result(flight.phases, flight.fault_ns)
    return flight
