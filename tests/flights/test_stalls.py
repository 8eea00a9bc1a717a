"""A process that is held up in flight: events in the order and at the times that a stall makes, without a wall clock.

Both processes have a clock of their own here, as they have on the wall clock: a simulator that is held up goes on where
it was, so that its clock, which stamps everything, stands behind the companion's by so much from then on.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from lockstep import S, near

from companion.app import warm_up
from companion.messages import Reject, RelativeState
from sim_bridge.flight import LockstepCompanion, Unrecorded
from sim_bridge.simulation import STEP_NS, Arrivals, BoxTruth, Simulation, nominal_heading_rad

AT_S = 2.5


@dataclass
class Stalled:
    """What the companion made of it: states, each with its clock's lead over the simulator's in ns, and rejects."""

    states: list = field(default_factory=list)
    rejects: list = field(default_factory=list)
    truth_s: list = field(default_factory=list)
    truth_br: list = field(default_factory=list)
    resumed_s: float = 0.0

    def errors(self):
        """Return instants on the companion's clock and the estimate's errors (n, 3)."""
        t = np.array([o.t_ns / S for o, _ in self.states])
        at = np.array([(o.t_ns - shift_ns) / S for o, shift_ns in self.states])
        truth = np.array([np.interp(at, self.truth_s, [b[k] for b in self.truth_br]) for k in range(3)]).T
        return t, np.array([o.p_mrf_br_m for o, _ in self.states]) - truth


class TwoClocks:
    """A simulator and a companion, each of which can be held up."""

    def __init__(self, seed, **fields):
        scenario, setup = near(seed, vision_input="detections", **fields)
        warm_up(setup)
        self.told, self._out = Stalled(), []
        self.simulation = Simulation(scenario, setup)
        self._companion = LockstepCompanion(setup, Unrecorded(), self._out.append)
        self._box = BoxTruth(setup, nominal_heading_rad(scenario))
        self._shift_ns = 0  # companion's clock less the simulator's
        self._held_until_ns = 0
        self._sent = b""
        self._queued = None

    def hold_simulator(self, seconds):
        """The simulator stands still; the companion goes on and hears nothing."""
        for _ in range(round(seconds * S) // STEP_NS):
            self._sent += self._arrive(Arrivals(self._now_ns, b"", b"", []))
            self._shift_ns += STEP_NS
        self.told.resumed_s = self._now_ns / S

    def hold_companion(self, seconds):
        """What comes queues from now on."""
        self._held_until_ns = self._now_ns + round(seconds * S)
        self.told.resumed_s = self._held_until_ns / S

    @property
    def _now_ns(self):
        return self.simulation.truth.t_ns + self._shift_ns

    def step(self):
        truth = self.simulation.truth
        self.told.truth_s.append(truth.t_ns / S)
        self.told.truth_br.append(self._box.p_mrf_br_m(truth))
        now_ns = self._now_ns
        reply = self.simulation.feed_mavlink(self._sent, truth.t_ns)  # sent while the simulator stood still
        self._sent = b""
        stepped = self.simulation.step()
        arrivals = replace(stepped, t_ns=now_ns, mavlink=reply + stepped.mavlink)
        if self._queued is not None:  # of pictures only the newest stays
            last = self._queued
            arrivals = replace(arrivals, mavlink=last.mavlink + arrivals.mavlink,
                               datalink=last.datalink + arrivals.datalink, frames=(last.frames + arrivals.frames)[-1:])
        self._queued = arrivals if now_ns < self._held_until_ns else None
        if self._queued is None:
            self._companion.hear(self.simulation.feed_mavlink(self._arrive(arrivals), truth.t_ns))

    def _arrive(self, arrivals):
        back = self._companion.arrive(arrivals)
        self.told.states += [(o, self._shift_ns) for o in self._out if isinstance(o, RelativeState)]
        self.told.rejects += [o for o in self._out if isinstance(o, Reject)]
        self._out.clear()
        return back


def fly(simulator_s=0.0, companion_s=0.0, until_s=4.0, seed=231, again_s=(), **fields):
    """Fly ``until_s`` of simulated time with one process held up at ``AT_S`` (and at ``again_s``) for so long."""
    flight, stalls = TwoClocks(seed, **fields), sorted((AT_S, *again_s))
    while flight.simulation.truth.t_ns < until_s * S:
        if stalls and flight.simulation.truth.t_ns >= stalls[0] * S:
            stalls.pop(0)
            flight.hold_simulator(simulator_s)
            flight.hold_companion(companion_s)
        flight.step()
    return flight.told


FAR = (-80.0, -20.0, 30.0)
"""Where positions of GPS alone are differenced: what stands on two bases shows."""


@pytest.mark.parametrize("held_up_s", [0.2, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.1, 0.3, 1.0))])
def test_a_simulator_that_is_held_up_throws_no_estimate(held_up_s):
    """Before and after, the estimate's error is that of GPS (0.14 m an axis); nothing is 206 m/s times the stall.

    From the stall to the first estimate that follows on it: what the stall takes, and half a second.
    """
    told = fly(simulator_s=held_up_s, until_s=4.0, start_tanker_m=FAR)
    t, errors = told.errors()
    assert np.abs(errors[t > 1.0]).max() < 0.8
    assert t[-1] - t[t < AT_S][-1] > held_up_s + 1.0
    assert np.diff(t[t > 1.0]).max() <= held_up_s + 0.5
    assert t[t > told.resumed_s + 0.5][0] < told.resumed_s + 0.55
    steps = {r.reason for r in told.rejects if r.t_ns > AT_S * S} - {"no_prior", "estimate_stale", "stale_stamp"}
    assert steps <= {"timesync_slow", "timesync_outlier"}


@pytest.mark.parametrize("held_up_s", [0.2, pytest.param(0.09, marks=pytest.mark.slow)])
def test_near_the_box_a_stall_leaves_vision_its_anchor(held_up_s):
    """What was stamped before moves with the step: the estimate goes on without a gap, by vision."""
    told = fly(simulator_s=held_up_s)
    t, errors = told.errors()
    assert np.linalg.norm(errors[t > 1.0], axis=1).max() < 0.2
    assert np.diff(t[t > 1.0]).max() < 0.03


@pytest.mark.parametrize("held_up_s", [0.3, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_companion_that_is_held_up_goes_on_where_the_world_is(held_up_s):
    """What has queued is read at once; the first estimate after it is as good as the last one before."""
    told = fly(companion_s=held_up_s, until_s=3.0 + held_up_s)
    t, errors = told.errors()
    assert np.linalg.norm(errors[t > 1.0], axis=1).max() < 0.15
    assert np.diff(t[t > 1.0]).max() <= held_up_s + 0.03
    assert not [r for r in told.rejects if r.t_ns > AT_S * S]


@pytest.mark.slow
def test_stalls_again_and_again_on_a_loaded_machine():
    """Four stalls of 60 ms within a second: a quarter of a second goes by gliding and at most one step."""
    told = fly(simulator_s=0.06, again_s=(2.7, 2.9, 3.1), until_s=5.0, start_tanker_m=FAR)
    t, errors = told.errors()
    assert np.abs(errors[t > 1.0]).max() < 1.0
    assert np.diff(t[t > 1.0]).max() < 0.3
