"""Lockstep: the simulation and the companion in one process on the simulated clock.

The same bytes go through the same encoders and parsers as over the wires; only sockets and the pty are left out. The
same seed gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from companion.app import warm_up
from companion.config import Setup
from companion.geometry import Vec
from companion.io.clock import SimulatedClock
from companion.io.datalink import TankerReceiver
from companion.io.mavlink import AutopilotLink
from companion.io.recorder import RunRecorder, create_run_folder
from companion.messages import NS, Output, Phase, PhaseChange, Setpoint, Tick
from companion.ports import Recorder
from companion.runtime import Service, Ticker, held_for_s
from sim_bridge.plant.fdm import PlantError
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import score
from sim_bridge.simulation import TRUTH_EVERY, Arrivals, BoxTruth, Simulation
from sim_bridge.truth import Truth
from sim_bridge.truth_log import TruthLog

BREAKAWAY_WATCH_S = 10.0


class LockstepCompanion:
    """The companion behind both links, on a clock that the simulation sets."""

    def __init__(self, setup: Setup, recorder: Recorder, watch: Callable[[Output], None] | None = None) -> None:
        config = setup.config
        self.clock = SimulatedClock()
        self.link = AutopilotLink(config.links, recorder.mavlink)
        self.service = Service(setup, self.clock, self, recorder, watch)
        self._datalink = TankerReceiver(config.links.origin_altitude_m)
        self._ticker = Ticker(config.guidance.rate_hz, 0)
        self._out = bytearray()

    def send(self, setpoint: Setpoint) -> None:
        """Encode a setpoint for the autopilot: this class is its own sink."""
        self._out += self.link.encode_setpoint(setpoint, self.clock.now_ns()) or b""

    def arrive(self, arrivals: Arrivals) -> bytes:
        """Take what arrives at one instant; return what leaves at it."""
        t_ns = arrivals.t_ns
        self.clock.set_ns(t_ns)
        dispatch = self.service.dispatch
        for event in self.link.receive(arrivals.mavlink, t_ns):
            dispatch(event)
        for event in self._datalink.receive(arrivals.datalink, t_ns, self.link.offset_ns):
            dispatch(event)
        if self.link.offset_ns is not None:
            for frame in arrivals.frames:
                dispatch(replace(frame, t_ns=self.link.to_companion_ns(frame.t_ns)))
        if self._ticker.due(t_ns):
            dispatch(Tick(t_ns))
        self._out += self.link.outgoing(t_ns)
        out, self._out = bytes(self._out), bytearray()
        return out


@dataclass(slots=True)
class Ending:
    """When a flight is over, and why."""

    hold_s: float
    timeout_s: float
    breakaway_ns: int | None = None
    breakaway_reason: str | None = None

    def watch(self, output: Output) -> None:
        """Look for a breakaway among the outputs."""
        if isinstance(output, PhaseChange) and output.new is Phase.BREAKAWAY and self.breakaway_ns is None:
            self.breakaway_ns, self.breakaway_reason = output.t_ns, output.reason

    def reached(self, t_ns: int, service: Service) -> bool:
        """Tell whether the hold is over, the breakaway has been watched long enough, or time is up."""
        if self.breakaway_ns is not None and (t_ns - self.breakaway_ns) * NS >= BREAKAWAY_WATCH_S:
            return True
        return held_for_s(service, t_ns) >= self.hold_s or t_ns * NS >= self.timeout_s


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A finished flight: its folder and its summary."""

    folder: Path
    summary: dict[str, Any]


class Progress:
    """What a flight tells while it goes on; the default says nothing."""

    def step(self, truth: Truth, p_mrf_br_m: Vec, service: Service) -> None:
        """Take the truth at 50 Hz."""

    def output(self, output: Output) -> None:
        """Take every output of the companion."""


def fly(scenario: Scenario, setup: Setup, progress: Progress | None = None) -> Flown:
    """Fly a scenario in lockstep and record it; raises ConfigError and PlantError before the flight only.

    A plant that fails in flight ends it; the summary says so.
    """
    progress = progress or Progress()
    warm_up(setup)
    simulation = Simulation(scenario, setup)
    folder = create_run_folder(setup.config.recorder.out, scenario.name)
    box = BoxTruth(setup, scenario.heading_rad)
    ending = Ending(scenario.hold_s, scenario.timeout_s)

    def watch(output: Output) -> None:
        ending.watch(output)
        progress.output(output)

    with RunRecorder(folder, setup) as recorder, TruthLog(folder, setup) as truth_log:
        companion = LockstepCompanion(setup, recorder, watch)
        failure = _run(simulation, companion, ending, lambda truth: _see(truth, box, truth_log, progress, companion))
        result = score(truth_log.series(), truth_log.phases(), setup.tanker.window, scenario)
        summary = recorder.write_summary({
            **result, "seed": scenario.seed, "scenario": scenario.name, "breakaway": ending.breakaway_reason,
            "plant_failure": failure,
        })
    return Flown(folder, summary)


def _see(truth: Truth, box: BoxTruth, log: TruthLog, progress: Progress, companion: LockstepCompanion) -> None:
    br = box.p_mrf_br_m(truth)
    log.append(truth, br)
    progress.step(truth, br, companion.service)


def _run(
    simulation: Simulation, companion: LockstepCompanion, ending: Ending, see: Callable[[Truth], None]
) -> str | None:
    """Step until the ending; return what the plant failed of, or None."""
    step = 0
    while not ending.reached(simulation.truth.t_ns, companion.service):
        truth = simulation.truth
        if step % TRUTH_EVERY == 0:
            see(truth)
        try:
            arrivals = simulation.step()
        except PlantError as error:
            return str(error)
        simulation.feed_mavlink(companion.arrive(arrivals))
        step += 1
    return None
