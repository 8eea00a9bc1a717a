"""What the estimate is worth, drawn into ``flight.rrd``: integrity, filter, health and how late inputs come.

Rules
-----
* Lines are thinned to ``STEP_NS`` of a message's own time; states, faults and rejected updates are all drawn.
* For people: metres, milliradians, milliseconds; of a measurement NIS over its degrees of freedom (one on average).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import rerun as rr

from companion.estimation.filter_state import BORESIGHT, GPS_BIAS, LAG
from companion.io.health_text import stage_line, stage_state
from companion.io.rerun_scene import AXES, DESIRED, DETECTED, ESTIMATE, LIMIT, REFERENCE, TRUTH, SceneStream
from companion.messages import FilterState, FilterUpdate, Health, InputLatency, Integrity, StageHealth

STEP_NS = 200_000_000
FAULT_PAUSE_NS = 1_000_000_000
"""The log for people takes the same faults once per second at most."""

WELL, WATCH, ILL, IDLE = (80, 180, 110), (220, 180, 70), (220, 70, 60), (120, 120, 120)
TRUST_STATES = {"may dock": WELL, "beyond alert": WATCH, "test fails": ILL}
STAGE_STATES = {"well": WELL, "ill": ILL, "not used": IDLE, "absent": IDLE}
REJECTED = "rejected"
PALETTE = (ESTIMATE, DETECTED, DESIRED, REFERENCE, LIMIT, TRUTH)

FILTER_PLOTS = (
    ("gps_bias", GPS_BIAS, ("north", "east", "down"), 1.0),
    ("boresight", BORESIGHT, ("pitch", "yaw", "roll"), 1e3),  # about the camera's right, down and forward
    ("lag", slice(LAG, LAG + 1), ("datalink",), 1e3),
)
"""Entity, place in the filter's state, what its lines are called, to the plot's unit (m, mrad, ms)."""

Message = TypeVar("Message", FilterState, Integrity)


class TrustDrawer:
    """Draws batches of messages of one kind."""

    def __init__(self, scene: SceneStream) -> None:
        self._scene = scene
        self._due_ns: dict[str, int] = {}
        self._colours: dict[tuple[str, str], tuple[int, ...]] = {}
        self._state = ""
        self._faults_told_ns: dict[tuple[str, ...], int] = {}
        self._faults: tuple[str, ...] = ()
        self._stages: dict[str, StageHealth] = {}
        self._bands("trust", TRUST_STATES)
        for axis in AXES:
            scene.line(f"plots/trust/{axis}/protection", ["protection"], ESTIMATE, 2.0)
            scene.line(f"plots/trust/{axis}/alert", ["alert"], LIMIT, 1.0)
        for plot, _, names, _ in FILTER_PLOTS:
            for name, colour in zip(names, PALETTE, strict=False):
                scene.line(f"plots/filter/{plot}/{name}", [name], colour, 2.0)
                scene.line(f"plots/filter/{plot}/{name}_sigma", ["±1 σ"] * 2, (*colour, 110), 0.7)

    def _new_colour(self, plot: str, name: str) -> tuple[int, ...] | None:
        """Return the colour of a line that has just turned up in a plot, None for one that is known."""
        if (plot, name) in self._colours:
            return None
        known = sum(p == plot for p, _ in self._colours)
        self._colours[plot, name] = PALETTE[known % len(PALETTE)]
        return self._colours[plot, name]

    def _bands(self, entity: str, states: dict[str, tuple[int, int, int]]) -> None:
        self._scene.static(entity, rr.StateConfiguration(values=list(states), colors=list(states.values())))

    def _thinned(self, what: str, messages: Sequence[Message]) -> list[Message]:
        """Return the messages that are due on a grid of ``STEP_NS``."""
        kept = []
        for m in messages:
            if m.t_ns >= self._due_ns.get(what, m.t_ns):
                self._due_ns[what] = m.t_ns + STEP_NS
                kept.append(m)
        return kept

    def integrity(self, told: list[Integrity]) -> None:
        """Draw protection against what it may be, and whether the receiver may dock."""
        changes, lines = [], []
        for m in told:
            state = "may dock" if m.may_dock else "test fails" if m.faults else "beyond alert"
            if state != self._state:
                self._state = state
                changes.append((m.t_ns, state))
            if m.faults != self._faults:
                self._faults = m.faults
                if m.t_ns - self._faults_told_ns.get(m.faults, m.t_ns - FAULT_PAUSE_NS) >= FAULT_PAUSE_NS:
                    self._faults_told_ns[m.faults] = m.t_ns
                    text = f"integrity: {', '.join(m.faults)}" if m.faults else "integrity: no test fails"
                    lines.append((m.t_ns, "WARN" if m.faults else "INFO", text))
        self._change("trust", changes)
        if lines:
            self._scene.texts("log/trust", lines)
        self._protection([m for m in self._thinned("integrity", told) if np.isfinite(m.protection_mrf_m).all()])

    def _protection(self, bounded: list[Integrity]) -> None:
        if not bounded:
            return
        t_ns = [m.t_ns for m in bounded]
        protection, alert = (np.array([getattr(m, f"{n}_mrf_m") for m in bounded]) for n in ("protection", "alert"))
        for k, axis in enumerate(AXES):
            self._scene.scalars(f"plots/trust/{axis}/protection", t_ns, protection[:, k])
            self._scene.scalars(f"plots/trust/{axis}/alert", t_ns, alert[:, k])

    def _change(self, entity: str, changes: Sequence[tuple[int, str]]) -> None:
        if changes:
            t_ns, states = zip(*changes, strict=True)
            self._scene.columns(entity, self._scene.times(t_ns), rr.StateChange.columns(state=list(states)))

    def states(self, told: list[FilterState]) -> None:
        """Draw what the filter has found, each with one sigma to either side."""
        kept = self._thinned("filter", told)
        if not kept:
            return
        t_ns = [m.t_ns for m in kept]
        x_all, sigma_all = np.array([m.x for m in kept]), np.array([m.sigma for m in kept])
        for plot, place, names, unit in FILTER_PLOTS:
            x, sigma = unit * x_all[:, place], unit * sigma_all[:, place]
            for k, name in enumerate(names):
                entity = f"plots/filter/{plot}/{name}"
                self._scene.scalars(entity, t_ns, x[:, k])
                self._scene.scalars(f"{entity}_sigma", t_ns, np.stack([x - sigma, x + sigma], axis=2)[:, k])

    def updates(self, told: list[FilterUpdate]) -> None:
        """Draw NIS over degrees of freedom as points by source; what was not taken larger and in red."""
        by_name: dict[str, list[FilterUpdate]] = {}
        for m in told:
            by_name.setdefault(REJECTED if m.reason else m.source, []).append(m)
        for name, updates in by_name.items():
            entity = f"plots/nis/{name}"
            colour = self._new_colour("rejected" if name == REJECTED else "nis", name)
            if colour is not None:
                colour, size = (ILL, 4.0) if name == REJECTED else (colour, 1.5)
                self._scene.static(entity, rr.SeriesPoints(names=name, colors=colour, marker_sizes=size))
            self._scene.scalars(entity, [m.t_ns for m in updates], [m.nis / max(m.dof, 1) for m in updates])

    def health(self, told: list[Health]) -> None:
        """Draw each stage as a band; a stage that fails or is well again is in the log."""
        lines = []
        for m in told:
            for stage in m.stages:
                before = self._stages.get(stage.name)
                self._stages[stage.name] = stage
                if before is None:
                    self._bands(f"health/{stage.name}", STAGE_STATES)
                if before is None or stage_state(before) != stage_state(stage):
                    self._change(f"health/{stage.name}", [(m.t_ns, stage_state(stage))])
                line = stage_line(before, stage)
                if line:
                    lines.append((m.t_ns, "INFO" if stage.healthy else "WARN", line))
        if lines:
            self._scene.texts("log/health", lines)

    def inputs(self, told: list[InputLatency]) -> None:
        """Draw how late each input comes on average, in ms."""
        by_source: dict[str, list[InputLatency]] = {}
        for m in told:
            by_source.setdefault(m.source, []).append(m)
        for source, rows in by_source.items():
            entity = f"plots/inputs/{source}"
            colour = self._new_colour("inputs", source)
            if colour is not None:
                self._scene.line(entity, [source], colour)
            self._scene.scalars(entity, [m.t_ns for m in rows], [1e3 * m.mean_s for m in rows])


DRAWERS: dict[type, Any] = {
    Integrity: TrustDrawer.integrity,
    FilterState: TrustDrawer.states,
    FilterUpdate: TrustDrawer.updates,
    Health: TrustDrawer.health,
    InputLatency: TrustDrawer.inputs,
}
"""What draws a message kind."""
