import shutil
import subprocess
import sys

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


@pytest.mark.parametrize("name", ["Cxx", "../velocities/u-fps", ""])
def test_only_coefficients_are_scaled(name):
    with pytest.raises(PlantError, match=r"aircraft 'ice101' has no "):
        fdm.Fdm("ice101", (), 0.005, 6000.0).scale_coefficient(name, 2.0)


FLY = """
import sys
from pathlib import Path
from sim_bridge.plant import fdm
fdm.ROOT = Path(sys.argv[1])
try:
    if sys.argv[2] == "linearize":
        from sim_bridge.linearize import Condition, linearize
        linearize(Condition())
    else:
        aircraft = fdm.Fdm("ice101", ("effector/pf", "wake/dCY"), 0.005, 6000.0)
        aircraft.set_receptacle((2.0, 0.0, -1.0))
        aircraft.reset(fdm.InitialCondition((0.0, 0.0, 0.0), (200.0, 0.0, 15.0), (0.0, 0.08, 0.0)))
        aircraft.step()
except fdm.PlantError as error:
    print("refused:", error, file=sys.stderr)
    sys.exit(7)
"""
SYSTEM = b'<channel name="c"><pure_gain name="s"> <input>no/such</input> <gain>2</gain> </pure_gain></channel>'
"""A part of JSBSim's that our files do not use: what it reads is only missed when it runs."""
NONE_HAS = "is used, but neither this file nor JSBSim has it"


def spoilt(folder, was, becomes):
    """Copy the aircraft and put ``becomes`` for the first ``was`` in the receiver's file."""
    root = folder / "aircraft_root"
    shutil.copytree(fdm.ROOT, root)
    file = root / "aircraft" / "ice101" / "ice101.xml"
    text = file.read_bytes()
    assert was in text
    file.write_bytes(text.replace(was, becomes, 1))
    return root


def flown_alone(root, what):
    """Return exit code and stderr of a process of its own: where JSBSim aborts it is -6."""
    command = [sys.executable, "-c", FLY, root, what]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("was", "becomes", "told"),
    [
        (b"<p> aero/alpha-rad </p>", b"<p> aero/alfa-rad </p>", f"ice101.xml: property 'aero/alfa-rad' {NONE_HAS}"),
        (b"<p> aero/alpha-rad </p>", b"<p> -aero/alfa-rad </p>", f"ice101.xml: property 'aero/alfa-rad' {NONE_HAS}"),
        (b"<p> aero/alpha-rad </p>", b"<p/>", f"ice101.xml: property '' {NONE_HAS}"),
        (b"<property> velocities/mach <", b"<property> velocities/mac <", f"property 'velocities/mac' {NONE_HAS}"),
        (b'<property value="0"> effector/pf </property>', b"", f"ice101.xml: property 'effector/pf' {NONE_HAS}"),
        (b'<property value="0"> gust/p-rad_sec </property>', b"", f"property 'gust/p-rad_sec' {NONE_HAS}"),
        (b'<property value="0"> wake/dCY </property>', b"", f"ice101.xml: property 'wake/dCY' {NONE_HAS}"),
        (b'<force name="boom"', b'<force name="bum"', "has no property 'external_reactions/boom/location-x-in'"),
        (b"<metrics>", b"<metrics", "ice101.xml: not an XML file ("),
        (b"ICE reports", b"ICE r\xe9ports", "ice101.xml: not UTF-8 ("),
        (b'<axis name="LIFT">', b'<axis name="UP">', "JSBSim cannot load aircraft 'ice101' from "),
        (b"</flight_control>", SYSTEM + b"</flight_control>", "JSBSim stopped aircraft 'ice101': FGPropertyValue::"),
    ],
)
def test_an_impossible_aircraft_file_is_refused_and_nothing_aborts(tmp_path, was, becomes, told):
    code, said = flown_alone(spoilt(tmp_path, was, becomes), "fdm")
    assert code == 7, said
    assert "Traceback" not in said
    [line] = [s for s in said.splitlines() if s.startswith("refused:")]
    assert told in line


@pytest.mark.parametrize(
    ("was", "becomes", "told"),
    [
        (b"ICE reports", b"ICE r\xe9ports", "ice101.xml: not UTF-8 (byte 202 is 0xe9)"),
        (b"<p> aero/alpha-rad </p>", b"<p> aero/alfa-rad </p>", f"ice101.xml: property 'aero/alfa-rad' {NONE_HAS}"),
    ],
)
def test_linearize_refuses_it_too(tmp_path, was, becomes, told):
    code, said = flown_alone(spoilt(tmp_path, was, becomes), "linearize")
    assert code == 7, said
    [line] = said.splitlines()
    assert told in line


def test_the_aircraft_as_they_are_fly(tmp_path):
    assert flown_alone(spoilt(tmp_path, b"", b""), "fdm") == (0, "")


def test_the_tanker_has_no_receptacle():
    tanker = fdm.Fdm("kc135r", (), 0.005, 6000.0)
    with pytest.raises(PlantError, match="'kc135r' has no property 'external_reactions/boom/location-x-in'"):
        tanker.set_receptacle((2.0, 0.0, -1.0))
    with pytest.raises(PlantError, match="'kc135r' has no property 'external_reactions/boom/magnitude'"):
        tanker.set_boom_force((1.0, 0.0, 0.0))
