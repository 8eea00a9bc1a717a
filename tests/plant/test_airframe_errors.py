import shutil

import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, AirframeConfig, TankerConfig
from companion.config import load as load_toml
from sim_bridge.plant import fdm
from sim_bridge.plant.conditions import AirframeErrors, PlantConditions
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.world import World

AIRFRAME = load_toml(FIRMWARE_CONFIGS / "airframes" / "ice101.toml", AirframeConfig)
TANKER = load_toml(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig)
ROLL_LEFT_FLAP = 4


def roll_rates(steps=6, **errors):
    """Return the roll rate after each step from trim with the left trailing edge down by 5 degrees."""
    conditions = PlantConditions(airframe=AirframeErrors(**errors))
    rng = np.random.default_rng(0)
    world = World(TANKER, AIRFRAME, (-50.0, -20.0, 30.0), "none", False, rng, conditions=conditions)
    effectors = np.array(AIRFRAME.trim.effectors)
    effectors[ROLL_LEFT_FLAP] += np.radians(5.0)
    rates = []
    for _ in range(steps):
        world.step(effectors)
        rates.append(float(world.truth.uav.omega_body_rad_s[0]))
    return np.array(rates)


def test_effectors_that_work_better_roll_faster_in_proportion():
    plain, better = roll_rates(), roll_rates(effectiveness=1.2)
    assert better[-1] / plain[-1] == pytest.approx(1.2, abs=0.01)


def test_one_coefficient_alone_changes_what_it_should():
    damped = roll_rates(coefficients={"Clp": 3.0})
    assert 0.0 < damped[-1] < roll_rates()[-1]


def test_more_delay_shifts_the_answer_by_whole_steps():
    np.testing.assert_allclose(roll_rates(10, actuator_delay_s=0.02)[4:], roll_rates(6), atol=2e-6)


def test_a_coefficient_that_is_not_there_is_named():
    with pytest.raises(PlantError, match="coef/Cxx"):
        roll_rates(coefficients={"Cxx": 1.1})


@pytest.mark.parametrize("spoil", ["<metrics", "</fdm_config"])
def test_a_broken_aircraft_file_is_one_clear_error(tmp_path, monkeypatch, capfd, spoil):
    shutil.copytree(fdm.ROOT, tmp_path / "aircraft_root")
    broken = tmp_path / "aircraft_root" / "aircraft" / "ice101" / "ice101.xml"
    broken.write_text(broken.read_text(encoding="utf-8").replace(f"{spoil}>", spoil), encoding="utf-8")
    monkeypatch.setattr(fdm, "ROOT", tmp_path / "aircraft_root")
    with pytest.raises(PlantError, match="cannot load aircraft 'ice101'"):
        fdm.Fdm("ice101", (), 0.005, 6000.0)
    said = capfd.readouterr()
    assert "ice101.xml" in said.out + said.err
