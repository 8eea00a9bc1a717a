"""Lockstep: the simulation and the companion in one process on the simulated clock.

The same bytes go through the same encoders and parsers as over the wires; only sockets and the pty are left out. The
same seed gives the same bits.
"""

from __future__ import annotations

import resource
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from companion.app import warm_up
from companion.config import Setup
from companion.io.clock import SimulatedClock
from companion.io.datalink import TankerReceiver
from companion.io.mavlink import AutopilotLink
from companion.io.recorder import RunRecorder, create_run_folder
from companion.messages import NS, CameraFrame, Event, Health, MarkerFrame, Output, Phase, PhaseChange, Setpoint, Tick
from companion.ports import Recorder
from companion.runtime import Service, Ticker, in_phase_s
from sim_bridge.plant.fdm import PlantError
from sim_bridge.scenario import Scenario
from sim_bridge.scene.operator_view import operator_view
from sim_bridge.scoring import Safety, refuelling, score
from sim_bridge.simulation import TRUTH_EVERY, Arrivals, BoxTruth, Simulation, nominal_heading_rad
from sim_bridge.truth import Truth
from sim_bridge.truth_log import TruthLog

BREAKAWAY_WATCH_S = 10.0

SWITCH_S = 2e-4
"""How long Python's lock may be kept from the thread that draws pictures beside the flight."""


class LockstepCompanion:
    """The companion behind both links, on a clock that the simulation sets."""

    def __init__(
        self, setup: Setup, recorder: Recorder, watch: Callable[[Output], None] | None = None,
        setpoint_delay_s: float = 0.0,
    ) -> None:
        """``setpoint_delay_s``: how long setpoints, and they alone, take to the autopilot."""
        config = setup.config
        self._delay_ns = round(setpoint_delay_s / NS)
        self._under_way: deque[tuple[int, Setpoint]] = deque()
        self.clock = SimulatedClock()
        self.link = AutopilotLink(config.links, recorder.mavlink)
        self.service = Service(setup, self.clock, self, recorder, watch)
        self._datalink = TankerReceiver(config.links.origin_altitude_m)
        self._ticker = Ticker(config.guidance.rate_hz, 0)
        self._out = bytearray()

    def send(self, setpoint: Setpoint) -> None:
        """Put a setpoint on its way to the autopilot: this class is its own sink."""
        self._under_way.append((self.clock.now_ns() + self._delay_ns, setpoint))

    def health(self, health: Health) -> None:
        """Tell the link how all stages are."""
        self.link.health(health)

    def phase(self, phase: Phase) -> None:
        """Tell the link which phase has begun."""
        self.link.phase(phase)

    def hear(self, data: bytes) -> None:
        """Take bytes of the autopilot."""
        if data:
            for event in self.link.receive(data, self.clock.now_ns()):
                self.service.dispatch(event)

    def arrive(self, arrivals: Arrivals) -> bytes:
        """Take what arrives at one instant; return what leaves at it."""
        t_ns = arrivals.t_ns
        self.clock.set_ns(t_ns)
        dispatch = self.service.dispatch
        self.hear(arrivals.mavlink)
        if arrivals.datalink:
            link = self.link
            for event in self._datalink.receive(arrivals.datalink, t_ns, link.offset_ns, link.uncertain_ns):
                dispatch(event)
        if self.link.offset_ns is not None:
            for frame in arrivals.frames:
                dispatch(stamped(frame, self.link.to_companion_ns(frame.t_ns)))
        if self._ticker.due(t_ns):
            dispatch(Tick(t_ns))
        while self._under_way and self._under_way[0][0] <= t_ns:
            self._out += self.link.encode_setpoint(self._under_way.popleft()[1], t_ns) or b""
        self._out += self.link.outgoing(t_ns)
        out, self._out = bytes(self._out), bytearray()
        return out


class Unrecorded:
    """A recorder that keeps nothing."""

    def event(self, event: Event) -> None:
        """Forget an input."""

    def output(self, output: Output) -> None:
        """Forget an output."""

    def mavlink(self, t_ns: int, data: bytes) -> None:
        """Forget a frame."""

    def latency(self, t_ns: int, stage: str, duration_ns: int) -> None:
        """Forget how long a stage took."""

    def close(self) -> None:
        """Close nothing."""


def stamped(frame: CameraFrame | MarkerFrame, t_ns: int) -> CameraFrame | MarkerFrame:
    """Return the frame with another stamp."""
    if isinstance(frame, CameraFrame):
        return replace(frame, t_ns=t_ns)
    return replace(frame, t_ns=t_ns, detections=replace(frame.detections, t_ns=t_ns))


class Ends(Protocol):
    """Says when a flight is over."""

    def reached(self, t_ns: int, service: Service) -> bool:
        """Tell whether it is."""


@dataclass(frozen=True, slots=True)
class Ending:
    """When a flight is over."""

    hold_s: float
    timeout_s: float

    def reached(self, t_ns: int, service: Service) -> bool:
        """Tell whether the hold is over, the breakaway has been watched long enough, or time is up."""
        return (
            in_phase_s(service, Phase.HOLD, t_ns) >= self.hold_s
            or in_phase_s(service, Phase.BREAKAWAY, t_ns) >= BREAKAWAY_WATCH_S
            or t_ns * NS >= self.timeout_s
        )


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A finished flight: its folder and its summary."""

    folder: Path
    summary: dict[str, Any]


def fly(scenario: Scenario, setup: Setup, watch: Callable[[Output], None] | None = None) -> Flown:
    """Fly a scenario in lockstep and record it; ``watch`` sees every output of the companion.

    Raises ConfigError and PlantError before the flight only: a plant that fails in flight ends it, and so does Ctrl-C;
    the summary says so.
    """
    warm_up(setup)
    sys.setswitchinterval(SWITCH_S)
    simulation = Simulation(scenario, setup)
    folder = create_run_folder(setup.config.recorder.out, scenario.name)
    phases: list[PhaseChange] = []

    def see_output(output: Output) -> None:
        if isinstance(output, PhaseChange):
            phases.append(output)
        if watch is not None:
            watch(output)

    box, safety = BoxTruth(setup, nominal_heading_rad(scenario)), Safety(setup.tanker.window)

    def see_truth(truth: Truth) -> None:
        p_mrf_br_m = box.p_mrf_br_m(truth)
        truth_log.append(truth, p_mrf_br_m)
        safety.see(truth, p_mrf_br_m)

    view = operator_view(scenario.picture, scenario.seed)
    with RunRecorder(folder, setup) as recorder, TruthLog(folder, setup, operator=view) as truth_log:
        companion = LockstepCompanion(setup, recorder, see_output, scenario.link.setpoint_delay_s)
        ending = Ending(scenario.hold_s, scenario.timeout_s)
        start_ns = time.perf_counter_ns()
        failure, interrupted = None, False
        try:
            failure = run(simulation, companion, ending, see_truth)
        except KeyboardInterrupt:
            interrupted = True
        wall_ns = time.perf_counter_ns() - start_ns
        result = score(truth_log.series(), phases, setup.tanker.window, scenario)
        summary = recorder.write_summary(
            {
                **result, **safety.result(phases, simulation.fault_began_ns), **refuelling(simulation.world.boom),
                "faults": [str(fault) for fault in scenario.faults], "seed": scenario.seed, "scenario": scenario.name,
                "vision_input": scenario.vision_input, "plant_failure": failure,
                "interrupted": interrupted, "flown_s": simulation.truth.t_ns * NS,
                "real_time_factor": round(simulation.truth.t_ns / wall_ns, 2),
                "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
            }
        )
    return Flown(folder, summary)


def run(
    simulation: Simulation, companion: LockstepCompanion, ending: Ends, see: Callable[[Truth], None]
) -> str | None:
    """Step until the ending, ``see`` the truth at 50 Hz; return what the plant failed of, or None."""
    step = 0
    while not ending.reached(simulation.truth.t_ns, companion.service):
        if step % TRUTH_EVERY == 0:
            see(simulation.truth)
        try:
            arrivals = simulation.step()
        except PlantError as error:
            return str(error)
        # Answers come at once, as over a wire without delay: the round trip of TIMESYNC is exact.
        companion.hear(simulation.feed_mavlink(companion.arrive(arrivals), arrivals.t_ns))
        simulation.phase_entered(companion.service.phase, arrivals.t_ns)
        step += 1
    return None
