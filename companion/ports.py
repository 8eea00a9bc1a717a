"""The edges of the core: one small Protocol for each thing that an adapter has to be."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from companion.messages import Event, Health, Output, Phase, Setpoint


class Clock(Protocol):
    """Time on the companion's base."""

    def now_ns(self) -> int:
        """Return the present instant in ns."""


class EventSource(Protocol):
    """Something that delivers events: a link, a camera, a recording."""

    def poll(self) -> Iterable[Event]:
        """Return the events that have arrived since the last call, without waiting."""

    def close(self) -> None:
        """Let go of the device; safe to call twice."""


class SetpointSink(Protocol):
    """Where setpoints leave, and word of how the companion is."""

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint."""

    def health(self, health: Health) -> None:
        """Take how all stages are: told when one changes."""

    def phase(self, phase: Phase) -> None:
        """Take the phase that has begun: what it has no use for is refused."""


class Recorder(Protocol):
    """Where everything is written down."""

    def event(self, event: Event) -> None:
        """Record an input."""

    def output(self, output: Output) -> None:
        """Record an output."""

    def mavlink(self, t_ns: int, data: bytes) -> None:
        """Record one raw MAVLink frame, in or out."""

    def latency(self, t_ns: int, stage: str, duration_ns: int) -> None:
        """Record how long a stage took."""

    def close(self) -> None:
        """Flush and close; safe to call twice."""
