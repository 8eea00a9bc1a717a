"""Contact, fuel and disconnect in a flight, with the receiver flown by the companion."""

import msgspec
import pytest
from lockstep import fly_with, near, with_guidance

from companion.messages import Command, Phase
from sim_bridge.plant.conditions import BoomConditions, PlantConditions
from sim_bridge.scenario import TimedCommand

AWAY_S = 25.0


def fly_to_contact(tmp_path, **changed):
    boom = BoomConditions(contact_after_s=2.0)
    scenario, setup = near(221, vision_input="detections", hold_s=30.0, plant=PlantConditions(boom=boom), **changed)
    return fly_with(tmp_path, scenario, with_guidance(setup, path_duration_s=6.0))


def test_a_breakaway_that_is_called_lets_the_boom_go_at_once(tmp_path):
    flight = fly_to_contact(tmp_path, commands=(TimedCommand(at_s=AWAY_S, command=Command.BREAKAWAY),))
    assert flight.phases[-1] is Phase.BREAKAWAY
    boom = flight.simulation.world.boom
    (_, first), (let_go_s, why) = boom.events
    assert first == "contact"
    assert why == "disconnect: breakaway called"
    assert let_go_s == pytest.approx(AWAY_S, abs=0.011)
    assert 0.0 < boom.given_kg < 15.0 * AWAY_S
    assert boom.force_on_receptacle_ned_n == (0.0, 0.0, 0.0)


def test_a_boom_that_is_fixed_never_makes_contact(tmp_path):
    scenario, setup = near(222, vision_input="detections", hold_s=4.0)
    fixed = PlantConditions(boom=BoomConditions(operator="fixed"))
    scenario = msgspec.structs.replace(scenario, plant=fixed)
    flight = fly_with(tmp_path, scenario, with_guidance(setup, path_duration_s=6.0))
    assert flight.phases[-1] is Phase.HOLD
    assert not flight.simulation.world.boom.contacts
    assert flight.simulation.truth.boom.length_m == setup.tanker.boom.length_m
