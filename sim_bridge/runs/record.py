"""What is written down of one flight: estimate beside truth at every guidance step.

A row is an instant at which truth is seen, 50 times a second; guidance steps at the same instants, so that estimate and
truth are compared without interpolation. Where there was no estimate a row has NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.app import warm_up
from companion.config import Setup
from companion.estimation.fusion import Fusion, Relative
from companion.geometry import Mat, Vec, log_so3
from companion.messages import NS, FilterState, FilterUpdate, Integrity, Output, Phase, PhaseChange, RelativeState
from companion.vision.camera import T_frd_cam
from sim_bridge.flight import Ending, LockstepCompanion, Unrecorded, run
from sim_bridge.runs.many import Job
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import Safety
from sim_bridge.simulation import BoxTruth, Simulation, nominal_heading_rad
from sim_bridge.truth import Truth

COLUMNS = {
    "t_s": 1, "br_true_m": 3, "range_true_m": 1, "br_m": 3, "br_sigma_m": 3, "br_nees": 1, "protection_m": 3,
    "alert_m": 3, "may_dock": 1, "markers": 1, "weight": 1, "p_error_m": 3, "p_sigma_m": 3, "p_nees": 1,
    "v_error_m_s": 3, "v_sigma_m_s": 3, "v_nees": 1, "turn_error_rad": 3, "turn_sigma_rad": 3, "turn_nees": 1,
}
"""What a row holds, and how many numbers each takes. ``protection_m`` NaN: no integrity told."""

WIDTH = sum(COLUMNS.values())
FUSED_EVERY = 5
"""Position, velocity and attitude of the fusion are asked for at every fifth row, since that costs: 10 a second."""

SLICES = {name: slice(end - width, end) for (name, width), end in zip(
    COLUMNS.items(), np.cumsum(list(COLUMNS.values())).tolist(), strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One flight. ``rows`` (n, WIDTH); ``changes`` of phase, the first being where it began.

    ``nis`` for each source: (k, 3) instant in s, normalised innovation squared and its degrees of freedom, of what was
    taken; ``refused`` how many were not, by source and reason. ``states`` (j, 1 + 2 * 16) the filter's instant in s,
    corrections and their sigmas, none without a filter. ``alarms`` instants in s and the tests of integrity that failed
    from there on. ``failure``: what the plant failed of. ``safety`` as ``scoring.Safety`` has it; ``fault_s`` when the
    first of the scenario's faults began.
    """

    label: str
    seed: int
    failure: str | None
    rows: Mat
    changes: tuple[PhaseChange, ...]
    nis: dict[str, Mat]
    refused: dict[str, int]
    states: Mat
    alarms: tuple[tuple[float, tuple[str, ...]], ...]
    safety: dict[str, Any]
    fault_s: float | None

    def of(self, name: str) -> NDArray[np.float64]:
        """Return a column (n,), or columns (n, 3), by name."""
        part = self.rows[:, SLICES[name]]
        return part[:, 0] if COLUMNS[name] == 1 else part

    def entered_s(self, *phases: Phase) -> float | None:
        """Return when one of the phases was first entered."""
        return next((c.t_ns * NS for c in self.changes[1:] if c.new in phases), None)

    def during(self, *phases: Phase) -> NDArray[np.bool_]:
        """Return which rows (n,) lie in one of the phases; the row of a change is in the phase that it enters."""
        t_s, wanted = self.of("t_s"), np.zeros(len(self.rows), dtype=np.bool_)
        ends = [*(c.t_ns * NS for c in self.changes[1:]), np.inf]
        for change, end_s in zip(self.changes, ends, strict=True):
            if change.new in phases:
                wanted |= (t_s >= change.t_ns * NS) & (t_s < end_s)
        return wanted


def record_flight(job: Job) -> Record:
    """Fly in lockstep without a recording on disk; a plant that fails ends the flight and is told."""
    scenario, setup = job.scenario, job.setup
    warm_up(setup)
    simulation = Simulation(scenario, job.world or setup)
    tap = Tap(scenario, setup, lambda: companion.service.pipeline.fusion)
    companion = LockstepCompanion(setup, Unrecorded(), tap.watch, scenario.link.setpoint_delay_s)
    failure = run(simulation, companion, Ending(scenario.hold_s, scenario.timeout_s), tap.see)
    return tap.record(job.label, scenario.seed, failure, simulation.fault_began_ns)


@dataclass(slots=True, eq=False)
class Notes:
    """What is collected while the flight goes on."""

    rows: list[Vec] = field(default_factory=list)
    changes: list[PhaseChange] = field(default_factory=lambda: [PhaseChange(0, Phase.STANDBY, Phase.STANDBY, "")])
    nis: dict[str, list[tuple[float, float, int]]] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    states: list[Vec] = field(default_factory=list)
    alarms: list[tuple[float, tuple[str, ...]]] = field(default_factory=list)


class Tap:
    """Sees the truth, then what the companion makes of it at the same instant."""

    def __init__(self, scenario: Scenario, setup: Setup, fusion: Callable[[], Fusion]) -> None:
        """``fusion`` gives the companion's fusion of now: a companion that is started anew has another."""
        self._box = BoxTruth(setup, nominal_heading_rad(scenario))
        self._T_frd_cam = T_frd_cam(setup.camera)
        self._fusion = fusion
        self._safety = Safety(setup.tanker.window)
        self._truth: Truth | None = None
        self._notes = Notes()

    def see(self, truth: Truth) -> None:
        """Begin a row with the truth."""
        self._truth = truth
        row = np.full(WIDTH, np.nan)
        row[SLICES["t_s"]] = truth.t_ns * NS
        row[SLICES["br_true_m"]] = br = self._box.p_mrf_br_m(truth)
        self._safety.see(truth, br)
        camera = truth.uav.T_ned_body().transform(self._T_frd_cam.t)
        row[SLICES["range_true_m"]] = np.linalg.norm(camera - truth.tanker.p_ned_m)
        self._notes.rows.append(row)

    def watch(self, output: Output) -> None:
        """Note an output of the companion."""
        notes = self._notes
        match output:
            case RelativeState() if self._truth is not None and output.t_ns == self._truth.t_ns:
                self._estimate(output, notes.rows[-1], self._truth)
            case Integrity():
                self._integrity(output)
            case PhaseChange():
                notes.changes.append(output)
            case FilterUpdate() if output.reason:
                told = f"{output.source}: {output.reason}"
                notes.refused[told] = notes.refused.get(told, 0) + 1
            case FilterUpdate():
                notes.nis.setdefault(output.source, []).append((output.t_ns * NS, output.nis, output.dof))
            case FilterState():
                notes.states.append(np.concatenate([[output.t_ns * NS], output.x, output.sigma]))

    def _estimate(self, state: RelativeState, row: Vec, truth: Truth) -> None:
        error = state.p_mrf_br_m - row[SLICES["br_true_m"]]
        row[SLICES["br_m"]] = state.p_mrf_br_m
        row[SLICES["br_sigma_m"]] = np.sqrt(np.diag(state.cov_mrf_br_m2))
        row[SLICES["br_nees"]] = nees(error, state.cov_mrf_br_m2)
        row[SLICES["markers"]] = state.markers_used
        row[SLICES["weight"]] = state.vision_weight
        if (len(self._notes.rows) - 1) % FUSED_EVERY == 0:
            fused = self._fusion().at(state.t_ns)
            if fused is not None:
                self._fused(fused, row, truth)

    def _fused(self, fused: Relative, row: Vec, truth: Truth) -> None:
        """Note position, velocity and relative attitude of the two centres of mass, in ``ned``."""
        own, tanker, a = truth.uav, truth.tanker, fused.aligned
        dv = a.own.v_ned_m_s - a.tanker.v_ned_m_s + fused.dv_ned_m_s
        # Attitudes are relative to the receiver's INS: its own error turns the truth first.
        R_told = fused.R_correction @ a.tanker_attitude.R_ned_body
        R_true = a.own_attitude.R_ned_body @ own.R_ned_body.T @ tanker.R_ned_body
        errors = (
            ("p", "m", fused.p_ned_m - (own.p_ned_m - tanker.p_ned_m)),
            ("v", "m_s", dv - (own.v_ned_m_s - tanker.v_ned_m_s)),
            ("turn", "rad", log_so3(R_told @ R_true.T)),
        )
        for k, (name, unit, error) in enumerate(errors):
            cov = fused.cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            row[SLICES[f"{name}_error_{unit}"]] = error
            row[SLICES[f"{name}_sigma_{unit}"]] = np.sqrt(np.diag(cov))
            row[SLICES[f"{name}_nees"]] = nees(error, cov)

    def _integrity(self, integrity: Integrity) -> None:
        notes = self._notes
        if self._truth is not None and integrity.t_ns == self._truth.t_ns:
            row = notes.rows[-1]
            row[SLICES["protection_m"]] = integrity.protection_mrf_m
            row[SLICES["alert_m"]] = integrity.alert_mrf_m
            row[SLICES["may_dock"]] = integrity.may_dock
        if not notes.alarms or notes.alarms[-1][1] != integrity.faults:
            notes.alarms.append((integrity.t_ns * NS, integrity.faults))

    def record(self, label: str, seed: int, failure: str | None, fault_ns: int | None) -> Record:
        """Return what was noted."""
        n = self._notes
        return Record(
            label, seed, failure, np.array(n.rows).reshape(-1, WIDTH), tuple(n.changes),
            {source: np.array(values) for source, values in n.nis.items()}, n.refused,
            np.array(n.states), tuple(n.alarms),
            self._safety.result(n.changes, fault_ns), None if fault_ns is None else fault_ns * NS,
        )


def nees(error: Vec, cov: Mat) -> float:
    """Return the normalised estimation error squared of an error (3,); NaN where the covariance is none."""
    try:
        return float(error @ np.linalg.solve(cov, error))
    except np.linalg.LinAlgError:
        return float("nan")
