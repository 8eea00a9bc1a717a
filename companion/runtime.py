"""Drivers of the core: one step that every driver shares, and the live loop.

``Service.dispatch`` passes an event through the pipeline, sends what comes out, records both and measures. Lockstep
calls it with its own clock; ``run_live`` calls it from sources that arrive when they like.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from companion.config import Setup
from companion.latencies import LatencyMonitor
from companion.messages import (
    NS,
    CameraFrame,
    Event,
    FusedPose,
    Health,
    MarkerFrame,
    Output,
    Phase,
    PhaseChange,
    Reject,
    Setpoint,
    Tick,
)
from companion.pipeline import Pipeline
from companion.ports import Clock, EventSource, Recorder, SetpointSink

IDLE_S = 0.0005
SILENCE_NS = 3_000_000_000


class Watched:
    """An event source that says, once, when nothing usable has come from it for 3 s: a ``silent`` Reject.

    ``what`` is the source's name in rejects, ``where`` the address, ``hint`` what to look at.
    """

    def __init__(self, source: EventSource, clock: Clock, what: str, where: str, hint: str) -> None:
        self._source, self._clock = source, clock
        self._what, self._where, self._hint = what, where, hint
        self._heard_ns: int | None = None
        self._told = False
        self._refused: Reject | None = None

    def poll(self) -> list[Event]:
        """Return the source's events, and a Reject when it has been silent."""
        events = list(self._source.poll())
        now_ns = self._clock.now_ns()
        refused = [e for e in events if isinstance(e, Reject)]
        if len(refused) < len(events) or self._heard_ns is None:
            self._heard_ns, self._told, self._refused = now_ns, False, None
        if refused:
            self._refused = refused[-1]
        if not self._told and now_ns - self._heard_ns >= SILENCE_NS:
            self._told = True
            events.append(Reject(now_ns, self._what, "silent", self._complaint()))
        return events

    def _complaint(self) -> str:
        if self._refused is None:
            return f"nothing for 3 s at {self._where}: {self._hint}"
        return f"nothing usable for 3 s at {self._where}: {self._refused.reason}, {self._refused.detail}"

    def close(self) -> None:
        """Close the source."""
        self._source.close()


class Service:
    """The pipeline with its sink, recorder and stop-watch."""

    def __init__(
        self, setup: Setup, clock: Clock, sink: SetpointSink, recorder: Recorder,
        watch: Callable[[Output], None] | None = None,
    ) -> None:
        """``clock`` gives the companion's time; ``watch`` sees every output, for a display."""
        self.pipeline = Pipeline(setup, self._mark)
        self._clock, self._sink, self._recorder, self._watch = clock, sink, recorder, watch
        self._latencies = LatencyMonitor()
        self._stage_start_ns = 0
        self._t_ns = 0
        self._pending_exposure_ns: int | None = None
        self.phase_since_ns = 0

    @property
    def phase(self) -> Phase:
        """Return the present phase."""
        return self.pipeline.phase

    def dispatch(self, event: Event) -> list[Output]:
        """Pass one event through, send, record, measure; return the outputs."""
        self._t_ns = self._clock.now_ns()
        if isinstance(event, CameraFrame | MarkerFrame):
            self._recorder.latency(self._t_ns, "transport", self._t_ns - event.t_ns)
        self._stage_start_ns = time.perf_counter_ns()
        outputs = self.pipeline.handle(event)
        for output in outputs:
            if isinstance(output, Setpoint):
                self._send(output)
            elif isinstance(output, Health):
                self._sink.health(output)
            elif isinstance(output, FusedPose) and output.markers_used:
                self._pending_exposure_ns = output.t_ns
            elif isinstance(output, PhaseChange):
                self.phase_since_ns = output.t_ns
                self._sink.phase(output.new)
        self._latencies.event(event, self._t_ns)
        if isinstance(event, Tick):
            outputs = [*outputs, *self._latencies.due(self._t_ns)]
        self._recorder.event(event)  # after the setpoint has left: recording never delays it
        for output in outputs:
            self._recorder.output(output)
            if self._watch is not None:
                self._watch(output)
        return outputs

    def _send(self, setpoint: Setpoint) -> None:
        self._sink.send(setpoint)
        self._mark("send")
        if self._pending_exposure_ns is not None:
            sent_ns = self._clock.now_ns()
            self._recorder.latency(sent_ns, "exposure_to_setpoint", sent_ns - self._pending_exposure_ns)
            self._pending_exposure_ns = None

    def _mark(self, stage: str) -> None:
        now_ns = time.perf_counter_ns()
        self._recorder.latency(self._t_ns, stage, now_ns - self._stage_start_ns)
        self._stage_start_ns = now_ns


class Ticker:
    """Says when a guidance step is due; a missed deadline is counted, never caught up with a burst."""

    def __init__(self, rate_hz: float, start_ns: int) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._next_ns = start_ns
        self.slips = 0

    def due(self, now_ns: int) -> bool:
        """Return True once per period."""
        if now_ns < self._next_ns:
            return False
        late = (now_ns - self._next_ns) // self._period_ns
        self.slips += int(late)
        self._next_ns += (late + 1) * self._period_ns
        return True


def run_live(
    service: Service, sources: Sequence[EventSource], clock: Clock, rate_hz: float, stop: Callable[[], bool]
) -> int:
    """Run until ``stop``; return how many guidance deadlines were missed."""
    ticker = Ticker(rate_hz, clock.now_ns())
    last_slips = 0
    while not stop():
        busy = False
        for source in sources:
            for event in source.poll():
                service.dispatch(event)
                busy = True
        now_ns = clock.now_ns()
        if ticker.due(now_ns):
            service.dispatch(Tick(now_ns))
            if ticker.slips != last_slips:
                service.dispatch(Reject(now_ns, "runtime", "deadline_slip", f"{ticker.slips - last_slips} missed"))
                last_slips = ticker.slips
        elif not busy:
            time.sleep(IDLE_S)
    return ticker.slips


def in_phase_s(service: Service, phase: Phase, now_ns: int) -> float:
    """Return for how long the service has been in a phase; 0.0 when it is in another."""
    return (now_ns - service.phase_since_ns) * NS if service.phase is phase else 0.0
