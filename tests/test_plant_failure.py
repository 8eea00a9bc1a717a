"""A plant that comes to grief in flight ends it: recorded, one line, exit code 1."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sim_bridge.__main__ import main
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.world import World
from sim_bridge.scenario import load_scenario
from sim_bridge.simulation import STEP_NS, Simulation

UNDAMPED = """
vision_input = "detections"
hold_s = 5.0
timeout_s = 30.0
[plant.airframe]
effectiveness = 0.01
[plant.airframe.coefficients]
Clp = -3.0
Cmq = -3.0
Cnr = -3.0
"""


def test_dynamics_that_run_away_end_the_flight_recorded_with_exit_code_one(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "undamped.toml"
    file.write_text(f'name = "undamped"\ncompanion = "{load_scenario("thesis").companion}"\n{UNDAMPED}')
    assert main(["fly", str(file), "--out", str(tmp_path / "runs")]) == 1
    [line] = [s for s in capfd.readouterr().err.splitlines() if s.startswith("sim-bridge:")]
    assert "plant failed: flight dynamics of 'ice101' have run away" in line
    [folder] = (tmp_path / "runs").iterdir()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["plant_failure"] in line
    assert not summary["docked"]
    assert 0.0 < summary["flown_s"] < 30.0
    assert (folder / "events.jsonl").stat().st_size > 0
    assert (folder / "truth.npz").stat().st_size > 0


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("CL_tev = 2.0", "ice101 has no coefficient 'CL_tev'; did you mean 'CL_tef'?"),
        ('"../velocities/u-fps" = 2.0', "ice101 has no coefficient '../velocities/u-fps'; there are CLa, CLq, "),
        ("effectiveness = 0.5", "effectiveness goes into plant.airframe.effectiveness"),
    ],
)
def test_a_coefficient_that_the_aircraft_lacks_is_named_before_the_flight(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], line: str, told: str
) -> None:
    file = tmp_path / "typo.toml"
    file.write_text(f'name = "typo"\ncompanion = "{load_scenario("thesis").companion}"\n'
                    f"[plant.airframe.coefficients]\nCnb = 1.5\n{line}\n")
    assert main(["fly", str(file), "--out", str(tmp_path / "runs")]) == 2
    [said] = capfd.readouterr().err.splitlines()
    assert f"{file}: plant.airframe.coefficients: {told}" in said
    assert not (tmp_path / "runs").exists()


def test_a_tanker_that_no_report_can_tell_of_is_a_failed_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario("thesis")
    simulation = Simulation(scenario, scenario.setup())
    truth = simulation.truth
    wild = msgspec.structs.replace(truth.tanker, omega_body_rad_s=np.array([50.0, 0.0, 0.0]))

    def fly_on() -> None:
        for k in range(100):
            body = msgspec.structs.replace(wild, t_ns=k * STEP_NS)
            monkeypatch.setattr(World, "truth", msgspec.structs.replace(truth, t_ns=k * STEP_NS, tanker=body))
            simulation.step()

    with pytest.raises(PlantError, match="tanker state cannot be sent: out_of_range"):
        fly_on()
