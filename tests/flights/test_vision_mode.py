"""Simulated and real vision (thesis 4.2.5), switched by an operator in flight."""

import numpy as np
import pytest
from lockstep import TO_HOLD, S, fly_with, near

from companion.messages import Command, VisionMode, VisionModeChange, VisionOutput
from sim_bridge.scenario import TimedCommand


@pytest.mark.parametrize("fusion", ["blend", "filter"])
def test_an_operator_switches_in_flight_and_back(tmp_path, fusion):
    """While simulated, the markers are where GPS says, whatever the picture shows; real ones scatter less.

    In the thesis' blend, which believes them; the filter does not move for what contradicts all that it has seen.
    """
    commands = (TimedCommand(at_s=3.0, command=Command.SIMULATED_VISION),
                TimedCommand(at_s=6.0, command=Command.REAL_VISION))
    scenario, setup = near(207, path_s=12.0, hold_s=3.0, commands=commands, fusion=fusion)
    flight = fly_with(tmp_path, scenario, setup)
    assert [(c.mode, round(c.t_ns / S, 1)) for c in flight.of(VisionModeChange)] == [
        (VisionMode.SIMULATED, 3.0), (VisionMode.REAL, 6.0)]
    assert flight.phases == TO_HOLD
    simulated = [o for o in flight.of(VisionOutput) if 3.05 < o.t_ns / S < 5.95]
    assert len(simulated) >= 28
    assert all(np.isin(o.detections.uv_px, o.predicted_uv_px).all() for o in simulated)
    assert all(o.pose is not None for o in simulated)
    while_simulated, after = flight.estimate_errors(3.2, 6.0), flight.estimate_errors(7.0, 9.8)
    if fusion == "blend":
        # GPS's own 0.1 m of noise comes through (thesis 7.4: the simulated vision is as good as what it is made of).
        assert np.abs(while_simulated).std(axis=0).max() > 3 * np.abs(after).std(axis=0).max()
    else:
        assert np.abs(while_simulated).max() < 0.1
    assert np.abs(flight.estimate_errors(7.0, np.inf)).max() < 0.05
