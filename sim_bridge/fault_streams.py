"""What a fault does to a stream of samples, whatever they are: pictures, frames on a wire, fixes."""

from __future__ import annotations

from collections import deque
from typing import Generic, Protocol, TypeVar

import numpy as np

from companion.messages import NS, Phase
from sim_bridge.faults import Fault

T = TypeVar("T")
Contra = TypeVar("Contra")

THERE_S, PERIOD_S = 0.2, 0.5
"""An intermittent source: how long it is there, of what."""
HEARTBEAT_THERE_S, HEARTBEAT_PERIOD_S = 1.2, 2.1
"""Heartbeats come once a second: one at a time is left out, never two, whenever the fault begins."""


class Window:
    """When one fault is on: from its beginning, once that is known."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self.begin_ns: int | None = None if fault.phase is not None else round(fault.from_s / NS)

    def phase_entered(self, phase: Phase, t_ns: int) -> None:
        """Take note of a phase; its first time counts."""
        if phase is self._fault.phase and self.begin_ns is None:
            self.begin_ns = t_ns + round(self._fault.after_s / NS)

    def elapsed_s(self, t_ns: int) -> float | None:
        """Return for how long the fault has been on; None when it is not."""
        if self.begin_ns is None or t_ns < self.begin_ns:
            return None
        elapsed_s = (t_ns - self.begin_ns) * NS
        return None if self._fault.for_s is not None and elapsed_s >= self._fault.for_s else elapsed_s


class Craft(Protocol[T]):
    """How samples of one sort are stamped anew and made wrong."""

    def with_stamp_of(self, kept: T, like: T) -> T:
        """Return ``kept`` with the stamp of ``like``."""

    def stamped_later(self, sample: T, by_ns: int) -> T:
        """Return the sample with a stamp that is ``by_ns`` later."""

    def wrong(self, sample: T, fault: Fault, elapsed_s: float, rng: np.random.Generator) -> list[T]:
        """Return what comes in place of a sample, for all kinds that are of this sort's own."""


class Tamper(Generic[T]):
    """One fault on one stream: ``pass_on`` what comes, and get what arrives.

    ``touched`` counts what did not arrive as it came.
    """

    def __init__(self, fault: Fault, window: Window, craft: Craft[T], rng: np.random.Generator) -> None:
        """``rng`` is for this fault alone."""
        self._fault, self._window, self._craft, self._rng = fault, window, craft, rng
        self._kept: T | None = None
        self.touched = 0
        self._count = 0
        self._waiting: deque[tuple[int, T]] = deque()
        self._stamps_anew = fault.kind == "late" or (fault.target, fault.kind) == ("gps", "delayed")
        slow = fault.target == "heartbeat"
        self._there_s, self._period_s = (HEARTBEAT_THERE_S, HEARTBEAT_PERIOD_S) if slow else (THERE_S, PERIOD_S)

    def pass_on(self, samples: list[T], t_ns: int) -> list[T]:
        """Return what arrives at ``t_ns`` when ``samples`` would."""
        elapsed_s = self._window.elapsed_s(t_ns)
        if elapsed_s is None:
            self._kept = samples[-1] if samples else self._kept
            return [*self._due(t_ns), *samples]
        arriving = []
        for sample in samples:
            tampered = self._tampered(sample, t_ns, elapsed_s)
            self.touched += not (len(tampered) == 1 and tampered[0] is sample)
            arriving += tampered
        return [*self._due(t_ns), *arriving]

    def _due(self, t_ns: int) -> list[T]:
        due = []
        while self._waiting and self._waiting[0][0] <= t_ns:
            due.append(self._waiting.popleft()[1])
        return due

    def _tampered(self, sample: T, t_ns: int, elapsed_s: float) -> list[T]:
        kind = self._fault.kind
        if kind == "off":
            return []
        if kind == "stuck":
            self._kept = sample if self._kept is None else self._kept
            return [self._craft.with_stamp_of(self._kept, sample)]
        if kind == "slow":
            self._count += 1
            return [sample] if self._count % round(self._fault.amount) == 0 else []
        if kind == "intermittent":
            return [sample] if elapsed_s % self._period_s < self._there_s else []
        if kind in ("delayed", "late"):
            by_ns = round(self._fault.amount / NS)
            later = self._craft.stamped_later(sample, by_ns) if self._stamps_anew else sample
            self._waiting.append((t_ns + by_ns, later))
            return []
        return self._craft.wrong(sample, self._fault, elapsed_s, self._rng)
