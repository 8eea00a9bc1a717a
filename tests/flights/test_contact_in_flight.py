"""Contact in a whole flight: what the boom does to the receiver, and the fuel that changes aircraft."""

import numpy as np
import pytest
from lockstep import near

from companion.app import warm_up
from companion.messages import NS
from sim_bridge.flight import Ending, LockstepCompanion, Unrecorded, run
from sim_bridge.plant.conditions import BoomConditions, PlantConditions
from sim_bridge.plant.fdm import FT, LBF
from sim_bridge.scoring import refuelling
from sim_bridge.simulation import Simulation

FUEL_KG = 30.0


class Watched(Simulation):
    """Both ends of the boom after every step: JSBSim's own numbers beside the boom's."""

    def __init__(self, scenario, setup):
        super().__init__(scenario, setup)
        self.t_s, self.contact, self.given_kg, self.load_n = [], [], [], []
        self.on_receiver_n, self.on_receptacle_n, self.masses_kg = [], [], []

    def step(self):
        arrivals = super().step()
        world, truth = self.world, self.truth
        uav, boom = world._uav._exec, world.boom
        self.t_s.append(truth.t_ns * NS)
        self.contact.append(boom.contact)
        self.given_kg.append(boom.given_kg)
        size, *direction = [uav[f"external_reactions/boom/{name}"] for name in ("magnitude", "x", "y", "z")]
        self.on_receiver_n.append(size * LBF * (truth.uav.R_ned_body @ direction))
        self.on_receptacle_n.append(boom.force_on_receptacle_ned_n)
        self.masses_kg.append([f._exec["inertia/mass-slugs"] * LBF / FT for f in (world._uav, world._tanker)])
        return arrivals


@pytest.fixture(scope="module")
def refuelled():
    plant = PlantConditions(boom=BoomConditions(contact_after_s=0.5, fuel_kg=FUEL_KG))
    scenario, setup = near(221, camera="docking", path_s=5.0, hold_s=12.0, vision_input="detections", plant=plant,
                           start_tanker_m=(-30.0, -1.0, 10.0))
    warm_up(setup)
    simulation = Watched(scenario, setup)
    companion = LockstepCompanion(setup, Unrecorded(), lambda output: None)
    assert run(simulation, companion, Ending(scenario.hold_s, scenario.timeout_s), lambda truth: None) is None
    return simulation


def test_the_receiver_feels_what_the_nozzle_does_to_the_receptacle(refuelled):
    contact = np.array(refuelled.contact)
    felt, done = np.array(refuelled.on_receiver_n), np.array(refuelled.on_receptacle_n)
    np.testing.assert_allclose(felt, done, atol=1e-6)
    loads = np.linalg.norm(felt, axis=1)
    assert loads[contact].max() > 50.0
    assert (loads[~contact] == 0.0).all()
    assert loads[contact].max() <= refuelled.world.boom.peak_load_n * (1.0 + 1e-9)


def test_what_the_receiver_gets_the_tanker_gives(refuelled):
    masses, given = np.array(refuelled.masses_kg), np.array(refuelled.given_kg)
    gained = masses - masses[0]
    # JSBSim takes the weight that is set in its next step.
    np.testing.assert_allclose(gained[1:, 0], given[:-1], atol=1e-6)
    np.testing.assert_allclose(gained[1:, 1], -given[:-1], atol=1e-6)
    assert (np.diff(given) >= 0.0).all()
    contact = np.array(refuelled.contact)
    assert (np.diff(given)[~contact[1:] & ~contact[:-1]] == 0.0).all()


def test_after_release_the_fuel_stays_and_nothing_pulls(refuelled):
    assert refuelled.contact.count(True) > 200
    released = len(refuelled.contact) - refuelled.contact[::-1].index(True)
    assert len(refuelled.contact) - released > 200
    assert (np.array(refuelled.on_receiver_n)[released:] == 0.0).all()
    assert refuelled.given_kg[-1] == FUEL_KG
    masses = np.array(refuelled.masses_kg)
    np.testing.assert_allclose(masses[released + 1 :] - masses[0], [[FUEL_KG, -FUEL_KG]] * (len(masses) - released - 1),
                               atol=1e-6)
    assert refuelled.world._uav.mass_kg == pytest.approx(masses[-1, 0], abs=1e-6)


def test_the_summary_tells_of_it(refuelled):
    told = refuelling(refuelled.world.boom)
    assert told["contacts"] == 1
    assert told["disconnects"] == {"fuel given": 1}
    assert told["fuel_given_kg"] == FUEL_KG
    assert told["boom_peak_load_n"] > 50.0
    (made_s, made), (let_go_s, let_go) = told["boom_events"]
    assert (made, let_go) == ("contact", "disconnect: fuel given")
    times = np.array(refuelled.t_s)[np.array(refuelled.contact)]
    assert made_s == pytest.approx(times[0], abs=1e-6)
    assert let_go_s == pytest.approx(times[-1] + 0.005, abs=1e-6)
