"""Scenarios: the shipped ones load, wrong ones are refused in one line that says what to mend."""

from pathlib import Path

import pytest

from companion.config import ConfigError
from sim_bridge.scenario import SCENARIOS, Scenario, load_scenario, shipped

COMPANION = (SCENARIOS / "../../firmware_configs/sitl/docking.toml").resolve()


def write(folder: Path, text: str) -> Path:
    file = folder / "flight.toml"
    file.write_text(f'name = "flight"\ncompanion = "{COMPANION}"\n{text}', encoding="utf-8")
    return file


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scenario(write(folder, text))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_docking_is_the_thesis_docking_in_light_turbulence() -> None:
    s = load_scenario("docking")
    assert s.start_tanker_m == (-50.0, -20.0, 30.0)
    assert (s.turbulence, s.hold_s, s.criteria.in_window_fraction) == ("light", 60.0, 0.95)
    assert s.datalink.rate_baud == 19600


@pytest.mark.parametrize(("name", "camera"), [("docking", "default.toml"), ("thesis", "thesis.toml")])
def test_shipped_scenarios_name_a_companion_that_exists(name: str, camera: str) -> None:
    assert name in shipped()
    companion = Path(load_scenario(name).companion)
    assert companion.is_absolute()
    assert camera in companion.read_text(encoding="utf-8")


def test_thesis_differs_from_docking_in_name_and_companion_only() -> None:
    a, b = load_scenario("docking"), load_scenario("thesis")
    assert [f for f in Scenario.__struct_fields__ if getattr(a, f) != getattr(b, f)] == ["name", "companion"]


def test_a_file_is_taken_as_well_as_a_name(tmp_path: Path) -> None:
    s = load_scenario(write(tmp_path, "seed = 7"))
    assert (s.name, s.seed) == ("flight", 7)


def test_unknown_name_is_answered_with_the_shipped_ones() -> None:
    with pytest.raises(ConfigError, match=r"did you mean 'docking'.*docking,.*thesis"):
        load_scenario("dokcing")


def test_missing_companion_is_named(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_text('name = "x"\ncompanion = "none.toml"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"companion: .*none\.toml: no such file"):
        load_scenario(file)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("start_tanker_m = [0.0, 0.0, 0.0]", "inside the tanker"),
        ("start_tanker_m = [-20.0, 15.0, 2.0]", "inside the tanker"),
        ("start_tanker_m = [-5000.0, 0.0, 0.0]", "2000 metres"),
        ("start_tanker_m = [-50.0, nan, 30.0]", "start_tanker_m[1] is not a finite number"),
        ("start_tanker_m = [-50.0, 30.0]", "start_tanker_m"),
        ("heading_rad = 90.0", "radians, not degrees"),
        ('turbulence = "heavy"', "turbulence"),
        ("hold_s = 0.0", "hold_s"),
        ('hold_s = "60"', "(seconds)"),
        ("hold_s = 200.0", "timeout_s"),
        ("seed = -1", "seed"),
        ("sede = 1", "did you mean 'seed'"),
        ("[datalink]\nrate_baud = 9600", "at most 17.5 hertz"),
        ("[datalink]\nreport_rate_hz = 0.0", "report_rate_hz"),
        ("[criteria]\nin_window_fraction = 95.0", "in_window_fraction"),
    ],
)
def test_impossible_values_are_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    message = refusal(tmp_path, text)
    assert words in message
    assert "flight.toml" in message


def test_start_near_contact_is_not_inside_the_tanker(tmp_path: Path) -> None:
    assert load_scenario(write(tmp_path, "start_tanker_m = [-29.0, 0.0, 9.0]")).start_tanker_m[2] == 9.0


@pytest.mark.parametrize(("text", "culprit"), [
    ("[sensors.receiver.gps]\nbias_ned_m = [0.0, nan, 0.0]", "sensors.receiver.gps.bias_ned_m"),
    ("[sensors.common_gps]\nslow_sigma_m = -1.0", "sensors.common_gps.slow_sigma_m"),
    ("[sensors.tanker.gps]\nslow_s = 0.0", "sensors.tanker.gps.slow_s"),
    ("[[sensors.tanker.gps_outages]]\nfrom_s = 5.0\nuntil_s = 5.0", "sensors.tanker.gps_outages"),
    ("[[sensors.receiver.gps_outages]]\nfrom_s = -1.0\nuntil_s = 5.0", "sensors.receiver.gps_outages"),
    ("[[sensors.receiver.gps_outages]]\nfrom_s = 1.0", "until_s"),
    ("[sensors.receiver.ins]\nattitude_drift_rad_s = [1.0, 0.0, 0.0]", "4.85e-6"),
    ("[sensors.receiver.ins]\nattitude_walk = inf", "sensors.receiver.ins.attitude_walk"),
    ("[sensors.receiver.ins]\ngyro_bias_rad_s = [0.0, 0.0]", "gyro_bias_rad_s"),
    ("[sensors.receiver.ins]\nvelocity_drift_m_s2 = [0.0, 9.81, 0.0]", "sensors.receiver.ins.velocity_drift_m_s2"),
    ("[sensors.receiver.ins]\nvelocity_walk = -0.1", "sensors.receiver.ins.velocity_walk"),
    ("[sensors.tanker.ins]\naccelerometer_noise_power = nan", "sensors.tanker.ins.accelerometer_noise_power"),
    ("[sensors.receiver]\ngps_bias = 3", "gps_bias"),
])
def test_sensors_that_cannot_be_are_refused_naming_the_field(tmp_path: Path, text: str, culprit: str) -> None:
    assert culprit in refusal(tmp_path, text)
