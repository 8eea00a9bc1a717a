"""What ``summary.json`` says of a flight that the companion itself knows: counted while messages pass.

========================= ==========================================================================================
``phases``                [[s since the recording's zero, phase, reason], ...]
``rejects``               {source.reason: n}
``filter``                {source: {accepted, rejected {reason: n}, accepted_fraction}}; null without a filter
``integrity``             over the time in ``hold``: ``may_dock_fraction``, ``protection_max_m`` and ``alert_m`` per
                          axis (null where nothing bounds it), ``faults`` {name: share of the time}; over the flight
                          ``may_dock_s``: s since the zero of the first "may dock"; null when none was told
``health``                the last word: {stage: {present, enabled, healthy, detail}}; null when none was told
``input_latency``         the last word: {source: {mean_s, jitter_s, worst_s, cost_m}}
========================= ==========================================================================================
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from companion.messages import (
    NS,
    CameraFrame,
    Event,
    FilterUpdate,
    Health,
    InputLatency,
    Integrity,
    MarkerFrame,
    Output,
    Phase,
    PhaseChange,
    Reject,
    Setpoint,
    VisionOutput,
)


class Tally:
    """Counts messages. Rejects are counted as outputs: whatever rejects come in, the pipeline passes on."""

    def __init__(self, t0_ns: int) -> None:
        self._t0_ns = t0_ns
        self._rejects: Counter[str] = Counter()
        self._frames = self._poses = self._setpoints = 0
        self._phase = Phase.STANDBY
        self._phases: list[list[Any]] = []
        self._updates: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._trust = _Trust()
        self._may_dock_ns: int | None = None
        self._health: Health | None = None
        self._latencies: dict[str, InputLatency] = {}
        self._takers: dict[type, Callable[[Any], None]] = {
            VisionOutput: self._vision,
            Reject: self._reject,
            PhaseChange: self._phase_change,
            FilterUpdate: self._filter_update,
            Integrity: self._integrity,
            Health: self._health_told,
            InputLatency: self._input_latency,
        }

    def event(self, event: Event) -> None:
        """Take an input."""
        self._frames += isinstance(event, CameraFrame | MarkerFrame)

    def output(self, output: Output) -> None:
        """Take an output."""
        taker = self._takers.get(type(output))
        if taker is not None:
            taker(output)
        else:
            self._setpoints += isinstance(output, Setpoint)

    def _vision(self, output: VisionOutput) -> None:
        self._poses += output.pose is not None
        if output.reject is not None:
            self._reject(output.reject)

    def _reject(self, reject: Reject) -> None:
        self._rejects[f"{reject.source}.{reject.reason}"] += 1

    def _phase_change(self, change: PhaseChange) -> None:
        self._phase = change.new
        self._phases.append([self._seconds(change.t_ns), str(change.new), change.reason])

    def _filter_update(self, update: FilterUpdate) -> None:
        self._updates[update.source][update.reason] += 1

    def _integrity(self, integrity: Integrity) -> None:
        if self._may_dock_ns is None and integrity.may_dock:
            self._may_dock_ns = integrity.t_ns
        if self._phase is Phase.HOLD:
            self._trust.add(integrity)

    def _health_told(self, health: Health) -> None:
        self._health = health

    def _input_latency(self, latency: InputLatency) -> None:
        self._latencies[latency.source] = latency

    def _seconds(self, t_ns: int) -> float:
        return round((t_ns - self._t0_ns) * NS, 3)

    def figures(self) -> dict[str, Any]:
        """Return this part of ``summary.json``."""
        stages = None if self._health is None else {
            s.name: {"present": s.present, "enabled": s.enabled, "healthy": s.healthy, "detail": s.detail}
            for s in self._health.stages
        }  # fmt: skip
        first = None if self._may_dock_ns is None else self._seconds(self._may_dock_ns)
        return {
            "frames": self._frames,
            "frames_with_pose": self._poses,
            "setpoints": self._setpoints,
            "rejects": dict(sorted(self._rejects.items())),
            "phases": self._phases,
            "filter": {s: _accepted(n) for s, n in sorted(self._updates.items())} or None,
            "integrity": self._trust.figures(first),
            "health": stages,
            "input_latency": {s: _latency(told) for s, told in sorted(self._latencies.items())},
        }


class _Trust:
    """Integrity over the hold."""

    def __init__(self) -> None:
        self._told = self._may_dock = 0
        self._protection_m = [0.0] * 3
        self._alert_m = [0.0] * 3
        self._faults: Counter[str] = Counter()

    def add(self, integrity: Integrity) -> None:
        """Take one instant of the hold."""
        self._told += 1
        self._may_dock += integrity.may_dock
        new = integrity.protection_mrf_m.tolist()
        self._protection_m = [b if math.isnan(b) or b > a else a for a, b in zip(self._protection_m, new, strict=True)]
        self._alert_m = integrity.alert_mrf_m.tolist()
        self._faults.update(integrity.faults)

    def figures(self, may_dock_s: float | None) -> dict[str, Any] | None:
        """Return what the summary says of it."""
        if self._told == 0:
            return None if may_dock_s is None else {"may_dock_s": may_dock_s}
        return {
            "may_dock_s": may_dock_s,
            "may_dock_fraction": self._may_dock / self._told,
            "protection_max_m": _bounded(self._protection_m),
            "alert_m": _bounded(self._alert_m),
            "faults": {name: n / self._told for name, n in sorted(self._faults.items())},
        }


def _bounded(values: Sequence[float]) -> list[float | None]:
    return [v if math.isfinite(v) else None for v in values]


def _accepted(reasons: Counter[str]) -> dict[str, Any]:
    total = reasons.total()
    rejected = {reason: n for reason, n in sorted(reasons.items()) if reason}
    return {"accepted": reasons[""], "rejected": rejected, "accepted_fraction": reasons[""] / total}


def _latency(told: InputLatency) -> dict[str, float]:
    return {"mean_s": told.mean_s, "jitter_s": told.jitter_s, "worst_s": told.worst_s, "cost_m": told.cost_m}
