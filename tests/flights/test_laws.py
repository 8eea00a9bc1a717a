"""The laws in the closed loop, by detections: docking, wind, a turning tanker. Seeds of no tuning."""

import msgspec
import numpy as np
import pytest

from sim_bridge.margins import Bench, Ladder, Outcome, base, fly_once, late_setpoints
from sim_bridge.plant.conditions import CourseConfig, PlantConditions, WindConfig

LAWS = ("attitude", "velocity")


def flown(law, seed, hold_s, **changed):
    scenario, setup = base("docking", law, hold_s)
    return fly_once(msgspec.structs.replace(scenario, seed=seed, **changed), setup)


def test_velocity_docks_and_holds():
    result = flown("velocity", 501, 10.0)
    assert result["docked"]
    assert (np.array(result["br_sigma_m"]) < [0.08, 0.08, 0.2]).all()


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_accuracy_in_light_turbulence(law):
    results = [flown(law, seed, 40.0) for seed in (502, 503)]
    assert all(r["docked"] and r["in_window_fraction"] >= 0.99 for r in results)
    assert (np.mean([r["br_sigma_m"] for r in results], axis=0) <= [0.08, 0.06, 0.15]).all()
    assert np.abs([r["br_mean_m"] for r in results]).max() <= 0.10


@pytest.mark.slow
@pytest.mark.parametrize("law", [*LAWS, "surfaces"])
def test_wind_across_and_along_changes_nothing(law):
    """In the same gusts wind moves the mean by less than 5 mm, and makes sigma no larger than 5 % and 2 mm."""
    wind = PlantConditions(wind=WindConfig(north_m_s=-12.0, east_m_s=30.0))
    calm, windy = flown(law, 532, 25.0), flown(law, 532, 25.0, plant=wind)
    assert windy["docked"]
    assert np.abs(windy["br_mean_m"]).max() <= 0.05
    assert np.abs(np.subtract(windy["br_mean_m"], calm["br_mean_m"])).max() <= 0.005
    assert (np.array(windy["br_sigma_m"]) < 1.05 * np.array(calm["br_sigma_m"]) + 0.002).all()


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("turn", ["right", "left"])
def test_the_window_is_held_while_the_tanker_rolls_in_and_turns(law, turn):
    course = PlantConditions(course=CourseConfig(kind="racetrack", leg_s=30.0, turn=turn))
    result = flown(law, 505, 45.0, plant=course)
    assert result["docked"]
    assert result["in_window_fraction"] == 1.0
    assert np.abs(result["br_mean_m"]).max() <= 0.10


@pytest.mark.parametrize("bears", range(6))
def test_a_ladder_is_climbed_to_the_last_step_that_holds(bears):
    values = (1.0, 2.0, 3.0, 4.0, 5.0)

    class Known(Bench):
        def fly(self, change):
            return Outcome(change(None) <= bears, None)

    ladder = Ladder("steps", values, lambda flight, value: value, 1.0, "{:.0f} s")
    told = Known(None, None, 1).climb(ladder)
    assert told == {0: "fails at 1 s", 5: "5 s (all)"}.get(bears, f"{bears} s")


def test_delay_is_put_on_the_link_alone():
    flight = base("docking", "attitude", 10.0)
    scenario, setup = late_setpoints(flight, 0.1)
    assert scenario.link.setpoint_delay_s == 0.1
    assert setup is flight[1]
