"""The shipped scenarios of light, with pictures, from near the box: every frame a pose, the window held."""

import msgspec
import numpy as np
import pytest
from lockstep import TO_HOLD, fly_with, near, with_guidance

from companion.messages import Phase, VisionOutput
from sim_bridge.scenario import load_scenario


@pytest.mark.slow
@pytest.mark.parametrize("name", ["night", "low_sun", "cloud"])
def test_docks_in_any_light(tmp_path, name):
    scenario, setup = near(231, picture=load_scenario(name).picture, hold_s=8.0)
    flight = fly_with(tmp_path, scenario, with_guidance(setup, path_duration_s=8.0))
    assert flight.phases == TO_HOLD
    br = np.array(flight.truth_br)[np.array(flight.t_s) >= flight.entered_s(Phase.HOLD)]
    assert (np.abs(br) < setup.tanker.window.desired_m).all()
    seen = flight.of(VisionOutput)
    assert np.mean([v.pose is not None for v in seen]) > 0.95


def test_the_shipped_lights_differ_from_day():
    day = load_scenario("docking").picture
    lights = [load_scenario(name).picture for name in ("night", "low_sun", "cloud")]
    assert all(msgspec.structs.astuple(light) != msgspec.structs.astuple(day) for light in lights)
