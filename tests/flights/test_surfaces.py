"""Dockings with law ``surfaces``: the thesis' regulator in the autopilot, told offsets by the companion."""

import msgspec
import numpy as np
import pytest
from lockstep import REFUELLING, TO_HOLD, S, fly_with, near, with_guidance

from companion.messages import Command, GuidanceOutput, OffsetSetpoint, Phase
from sim_bridge.scenario import TimedCommand, load_scenario

HOLD_S = 8.0


def hold_of(flight):
    return np.array(flight.truth_br)[np.array(flight.t_s) >= flight.entered_s(Phase.HOLD)]


def test_docks_on_offsets(tmp_path):
    scenario, setup = near(211, hold_s=HOLD_S, vision_input="detections")
    flight = fly_with(tmp_path, scenario, with_guidance(setup, law="surfaces", path_duration_s=8.0))
    assert flight.failure is None
    assert flight.phases == TO_HOLD
    assert (np.abs(hold_of(flight)) < setup.tanker.window.desired_m).all()
    sent = flight.of(OffsetSetpoint)
    assert all(isinstance(o.setpoint, OffsetSetpoint) for o in flight.of(GuidanceOutput))
    assert np.allclose(np.diff([o.t_ns / S for o in sent]), 0.02, atol=1e-6)
    assert not flight.simulation.autopilot.rejects


def test_breakaway_in_attitude_takes_over_from_the_regulator(tmp_path):
    away = (TimedCommand(at_s=9.0, command=Command.BREAKAWAY),)
    scenario, setup = near(214, vision_input="detections", commands=away)
    flight = fly_with(tmp_path, scenario, with_guidance(setup, law="surfaces", path_duration_s=8.0))
    assert flight.failure is None
    assert flight.phases == [Phase.JOIN, Phase.APPROACH, Phase.BREAKAWAY]
    t, br = np.array(flight.t_s), np.array(flight.truth_br)
    left = br[t >= flight.entered_s(Phase.BREAKAWAY)]
    assert left[-1, 0] < left[0, 0] - 5.0  # falls back
    assert left[-1, 2] > left[0, 2] + 5.0  # and down
    assert np.abs(left[:, 1] - left[0, 1]).max() < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [212, 213])
def test_docks_from_the_thesis_start(tmp_path, seed):
    """From [-50, -20, 30] m, GPS first and vision later, the thesis camera; sigma and mean of Tab. 1.2."""
    scenario = msgspec.structs.replace(load_scenario("thesis"), seed=seed, hold_s=30.0)
    flight = fly_with(tmp_path, scenario, with_guidance(scenario.setup(), law="surfaces"))
    assert flight.phases == REFUELLING
    br = hold_of(flight)
    assert (np.abs(br) < scenario.setup().tanker.window.desired_m).all()
    assert (br.std(axis=0) < (0.217, 0.090, 0.088)).all()
    assert (np.abs(br.mean(axis=0)) < 0.10).all()
