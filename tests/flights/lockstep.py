"""Short lockstep flights with something wrong on the way: the real simulation, companion, links and recorder.

A fault is a function of what would arrive at the companion; it returns what does arrive. ``back`` is the same for the
bytes on their way to the autopilot. Both see the flight, so that they can begin with a phase.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from companion.app import warm_up
from companion.io.recorder import RunRecorder
from companion.messages import AttitudeSetpoint, Output, Phase, PhaseChange, RelativeState
from sim_bridge.flight import Ending, LockstepCompanion, run
from sim_bridge.scenario import load_scenario
from sim_bridge.simulation import Arrivals, BoxTruth, Simulation, nominal_heading_rad

S = 1_000_000_000
STEP_S = 0.005
TO_HOLD = [Phase.JOIN, Phase.APPROACH, Phase.CONTACT, Phase.HOLD]
"""Phases of the direct procedure without a self-test."""
REFUELLING = [Phase.SELF_TEST, Phase.JOIN, Phase.OBSERVATION, Phase.PRE_CONTACT, *TO_HOLD[1:]]
"""Phases of a whole refuelling to its hold."""


def near(seed=201, *, camera="thesis", path_s=8.0, hold_s=8.0, fusion=None, **scenario_fields):
    """Return scenario and setup of a docking that begins 3 m from the box: direct, without a self-test, so quick."""
    fields = {"start_tanker_m": (-31.4, -1.2, 10.7), "timeout_s": 60.0, **scenario_fields}
    scenario = msgspec.structs.replace(load_scenario(camera), seed=seed, hold_s=hold_s, **fields)
    setup = with_guidance(scenario.setup(), path_duration_s=path_s, procedure="direct", self_test=False)
    return scenario, setup if fusion is None else with_fusion(setup, method=fusion)


def with_guidance(setup, **changed):
    config = setup.config
    guidance = msgspec.structs.replace(config.guidance, **changed)
    return msgspec.structs.replace(setup, config=msgspec.structs.replace(config, guidance=guidance))


def with_fusion(setup, **changed):
    config = setup.config
    fusion = msgspec.structs.replace(config.fusion, **changed)
    return msgspec.structs.replace(setup, config=msgspec.structs.replace(config, fusion=fusion))


def recording_in(setup, folder):
    config = setup.config
    recorder = msgspec.structs.replace(config.recorder, out=str(folder))
    return msgspec.structs.replace(setup, config=msgspec.structs.replace(config, recorder=recorder))


@dataclass
class Flight:
    """What happened: times in s of simulated time, one row of the lists per 5 ms step."""

    outputs: list[Output] = field(default_factory=list)
    following: list[bool] = field(default_factory=list)
    truth_br: list[np.ndarray] = field(default_factory=list)
    t_s: list[float] = field(default_factory=list)
    companion: LockstepCompanion | None = None
    simulation: Simulation | None = None
    summary: dict = field(default_factory=dict)
    failure: str | None = None

    def of(self, kind):
        return [o for o in self.outputs if isinstance(o, kind)]

    @property
    def phases(self):
        return [c.new for c in self.of(PhaseChange)]

    def reason(self, phase):
        return next(c.reason for c in self.of(PhaseChange) if c.new is phase)

    def entered_s(self, phase):
        return next(c.t_ns for c in self.of(PhaseChange) if c.new is phase) / S

    def setpoints_s(self, start_s=0.0, end_s=np.inf):
        return [o.t_ns / S for o in self.of(AttitudeSetpoint) if start_s <= o.t_ns / S < end_s]

    def following_at(self, t_s):
        return self.following[int(np.searchsorted(self.t_s, t_s))]

    def estimate_errors(self, start_s, end_s):
        """Return estimated less true BR (n, 3) between two instants."""
        states = [o for o in self.of(RelativeState) if start_s <= o.t_ns / S < end_s]
        t = [o.t_ns / S for o in states]
        truth = np.array([np.interp(t, self.t_s, [b[k] for b in self.truth_br]) for k in range(3)]).T
        return np.array([o.p_mrf_br_m for o in states]).reshape(-1, 3) - truth

    def phase_age_s(self):
        service = self.companion.service
        return service.phase, (self.companion.clock.now_ns() - service.phase_since_ns) / S


Fault = Callable[[Arrivals, Flight], Arrivals]


class Faulty(Simulation):
    """A simulation whose wires are tampered with."""

    def __init__(self, scenario, setup, flight, fault, back):
        super().__init__(scenario, setup)
        self._flight, self._fault, self._back = flight, fault, back
        self._box = BoxTruth(setup, nominal_heading_rad(scenario))

    def step(self):
        f = self._flight
        f.t_s.append(self.truth.t_ns / S)
        f.truth_br.append(self._box.p_mrf_br_m(self.truth))
        arrivals = super().step()
        f.following.append(self.autopilot.vehicle.following)
        return self._fault(arrivals, f)

    def feed_mavlink(self, data, t_ns):
        return super().feed_mavlink(self._back(data, self._flight), t_ns)


def fly_with(folder, scenario, setup, fault=lambda a, f: a, back=lambda data, f: data) -> Flight:
    """Fly to the end of the hold, or 10 s past a breakaway; record in ``folder``."""
    warm_up(setup)
    flight = Flight()
    with RunRecorder(folder, setup) as recorder:
        flight.simulation = Faulty(scenario, setup, flight, fault, back)
        flight.companion = LockstepCompanion(setup, recorder, flight.outputs.append)
        ending = Ending(scenario.hold_s, scenario.timeout_s)
        flight.failure = run(flight.simulation, flight.companion, ending, lambda truth: None)
        flight.summary = recorder.write_summary({})
    return flight


def during(phase: Phase, start_s: float, length_s: float, fault: Fault) -> Fault:
    """Return a fault that lasts from ``start_s`` after a phase was first entered for ``length_s``."""
    begin = [np.inf]

    def gated(value, flight):
        now_s = flight.companion.clock.now_ns() / S
        if not np.isfinite(begin[0]) and flight.phase_age_s()[0] is phase:
            begin[0] = now_s + start_s
        return fault(value, flight) if begin[0] <= now_s < begin[0] + length_s else value

    return gated


def without(*names) -> Fault:
    """Return a fault that drops ``mavlink``, ``datalink`` or ``frames``."""
    empty = {"mavlink": b"", "datalink": b"", "frames": []}
    return lambda arrivals, flight: replace(arrivals, **{n: empty[n] for n in names})
