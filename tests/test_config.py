"""Configuration files: right ones load, wrong ones are refused in one line that names file, field and unit."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from companion.config import (
    FIRMWARE_CONFIGS,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    TankerConfig,
    load,
    load_setup,
)
from companion.config.loading import all_field_names, convert, unit_of
from companion.config.rules import tanker_rules
from companion.geometry import rotation_from_euler

CAMERA: dict[str, Any] = {
    "name": "c", "width_px": 640, "height_px": 480, "rate_hz": 20.0, "fx_px": 457.0, "fy_px": 457.0,
    "cx_px": 319.5, "cy_px": 239.5, "p_frd_cam_m": [5.0, 0.0, -0.3],
}
TANKER: dict[str, Any] = {
    "name": "t", "marker_radius_m": 0.1, "box_tanker_m": [-27.0, 0.0, 8.0],
    "boom": {"pivot_tanker_m": [-16.5, 0.0, 2.0]},
    "markers": [{"id": i, "p_tanker_m": [float(i), 0.5 * i * i, 1.0]} for i in range(5)],
}
AIRFRAME: dict[str, Any] = {
    "name": "a", "receptacle_frd_m": [2.0, 0.0, -1.0], "mass_kg": 14855.0,
    "trim": {"airspeed_m_s": 205.7, "altitude_m": 6000.0, "alpha_rad": 0.064, "throttle": 0.3, "effectors": [0.0] * 10},
    "response": {"roll_rad_s": 8.0, "roll_damping": 0.8, "pitch_rad_s": 5.5, "pitch_damping": 0.8, "thrust_lag_s": 0.5,
                 "delay_s": 0.03},
    "A": [[0.0] * 9] * 9, "B": [[0.0] * 10] * 9,
}
COMPANION: dict[str, Any] = {"camera": "camera.toml", "tanker": "tanker.toml", "airframe": "airframe.toml"}


def write(folder: Path, **changed: dict[str, Any]) -> Path:
    """Write a whole configuration; each keyword replaces keys of one of the four files."""
    files = {"camera": CAMERA, "tanker": TANKER, "airframe": AIRFRAME, "companion": COMPANION}
    for name, content in files.items():
        (folder / f"{name}.toml").write_text(tomli_w.dumps(content | changed.get(name, {})), encoding="utf-8")
    return folder / "companion.toml"


def refusal(path: Path, kind: type = CompanionConfig) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path, kind)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def setup_refusal(folder: Path, **changed: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        load_setup(write(folder, **changed))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_files_are_found_beside_the_file_that_names_them(tmp_path: Path) -> None:
    setup = load_setup(write(tmp_path, companion={"guidance": {"auto_engage": True}}))
    assert (setup.camera.name, setup.tanker.name, setup.airframe.name) == ("c", "t", "a")
    assert setup.config.guidance.auto_engage
    assert setup.config.guidance.rate_hz == 50.0  # a default that was not overwritten


@pytest.mark.parametrize("file", sorted(FIRMWARE_CONFIGS.glob("cameras/*.toml")), ids=lambda f: f.stem)
def test_shipped_cameras_load(file: Path) -> None:
    assert load(file, CameraConfig).name == file.stem


@pytest.mark.parametrize("file", sorted(FIRMWARE_CONFIGS.glob("tankers/*.toml")), ids=lambda f: f.stem)
def test_shipped_tankers_have_the_thesis_markers(file: Path) -> None:
    tanker = load(file, TankerConfig)
    assert len(tanker.markers) <= 10  # thesis 2.3
    assert tanker.marker_radius_m == 0.10


@pytest.mark.parametrize("file", sorted(FIRMWARE_CONFIGS.glob("sitl/*.toml")), ids=lambda f: f.stem)
def test_shipped_companions_load_and_stay_on_this_machine(file: Path) -> None:
    config = load(file, CompanionConfig)
    assert "127.0.0.1" in config.links.mavlink
    assert "127.0.0.1" in config.links.camera
    assert config.guidance.auto_engage
    for named in (config.camera, config.tanker):
        assert (file.parent / named).is_file()


def test_misspelt_key_is_answered_with_the_right_one(tmp_path: Path) -> None:
    path = write(tmp_path, companion={"guidance": {"rate_hertz": 50.0}})
    assert "unknown key 'guidance.rate_hertz'; did you mean 'rate_hz'?" in refusal(path)


def test_misspelt_section_is_answered_with_the_right_one(tmp_path: Path) -> None:
    assert "unknown key 'guidence'; did you mean 'guidance'?" in refusal(write(tmp_path, companion={"guidence": {}}))


def test_key_like_no_other_gets_no_wrong_advice(tmp_path: Path) -> None:
    message = refusal(write(tmp_path, companion={"zzzz": 1}))
    assert "unknown key 'zzzz'" in message
    assert "did you mean" not in message


def test_wrong_type_is_told_with_its_unit(tmp_path: Path) -> None:
    write(tmp_path, camera={"fx_px": "457"})
    message = refusal(tmp_path / "camera.toml", CameraConfig)
    assert "fx_px" in message
    assert message.endswith("(pixels)")


def test_wrong_type_inside_a_list_is_told_with_place_and_unit(tmp_path: Path) -> None:
    write(tmp_path, tanker={"markers": [{"id": 1, "p_tanker_m": [0.0, "x", 0.0]}]})
    message = refusal(tmp_path / "tanker.toml", TankerConfig)
    assert "markers" in message
    assert "p_tanker_m" in message
    assert message.endswith("(metres)")


def test_missing_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "companion.toml"
    path.write_text('camera = "c.toml"\nairframe = "a.toml"\n', encoding="utf-8")
    assert "tanker" in refusal(path)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_number_that_is_not_finite_is_refused_by_name(tmp_path: Path, value: str) -> None:
    path = tmp_path / "companion.toml"
    path.write_text(f'camera = "c"\ntanker = "t"\nairframe = "a"\n[fusion]\nd1_m = {value}\n', encoding="utf-8")
    assert "fusion.d1_m is not a finite number" in refusal(path)


def test_not_finite_inside_a_matrix_is_found(tmp_path: Path) -> None:
    A = [[0.0] * 9 for _ in range(9)]
    A[3][4] = float("nan")
    assert "A[3][4] is not a finite number" in setup_refusal(tmp_path, airframe={"A": A})


def test_missing_file_is_named(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "nowhere.toml")


def test_file_that_is_a_folder_or_no_text_is_told(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "cannot be read" in refusal(tmp_path / "binary.toml")


def test_bad_toml_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text('camera = "c.toml"\ntanker = \n', encoding="utf-8")
    message = refusal(path)
    assert "not valid TOML" in message
    assert "line 2" in message


@pytest.mark.parametrize("file", ["camera", "tanker", "airframe"])
def test_named_file_that_is_missing_is_told_by_its_path(tmp_path: Path, file: str) -> None:
    message = setup_refusal(tmp_path, companion={file: "absent.toml"})
    assert "absent.toml: no such file" in message


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("camera", {"width_px": 0}, "width_px"),
        ("camera", {"fx_px": -1.0}, "fx_px"),
        ("camera", {"rate_hz": 0.0}, "rate_hz"),
        ("camera", {"latency_s": -0.1}, "latency_s"),
        ("camera", {"distortion": [0.0] * 4}, "distortion of plumb_bob must be 5 numbers (k1, k2, p1, p2, k3), not 4"),
        ("camera", {"distortion_model": "equidistant"}, "distortion of equidistant must be 4 numbers"),
        ("camera", {"distortion_model": "rational_polynomial"}, "distortion of rational_polynomial must be 8 numbers"),
        ("tanker", {"markers": TANKER["markers"][:3]}, "at least 4 markers"),
        ("tanker", {"markers": TANKER["markers"][:4] + TANKER["markers"][:1]}, "same id"),
        ("tanker", {"markers": [*TANKER["markers"], {"id": 77, "p_tanker_m": [2.0, 2.1, 1.0]}]},
         "markers 2 and 77 are 0.10 m apart and run into one light"),
        ("tanker", {"markers": [{"id": i, "p_tanker_m": [5.0 * i, 1.0 - i, 0.5 * i]} for i in range(6)]},
         "all markers lie on one line"),
        ("tanker", {"markers": [{"id": i, "p_tanker_m": [1e300 * i, 1.0 * i * i, 0.5]} for i in range(6)]},
         "within 500 m (metres, not millimetres)"),
        ("tanker", {"markers": [{"id": i, "p_tanker_m": [1.0 * i, 1.0 * i * i, 0.5]} for i in range(9, 79)]},
         "max_detections 64, and the tanker has 70 markers"),
        ("tanker", {"marker_radius_m": 0.0}, "marker_radius_m"),
        ("tanker", {"window": {"desired_m": [3.0, 1.0, 1.0]}}, "window.desired_m"),
        ("airframe", {"A": [[0.0] * 9] * 8}, "9 rows of 9"),
        ("airframe", {"B": [[0.0] * 9] * 9}, "9 rows of 10"),
        ("companion", {"fusion": {"d1_m": 10.0, "d2_m": 20.0}}, "d1_m must be larger"),
        ("companion", {"fusion": {"min_markers": 1}}, "min_markers"),
        ("companion", {"guidance": {"rate_hz": 1.0}}, "guidance.rate_hz"),
        ("companion", {"vision": {"detection": {"threshold": 300}}}, "threshold"),
    ],
)
def test_value_that_cannot_be_is_refused_by_name(
    tmp_path: Path, file: str, change: dict[str, Any], words: str
) -> None:
    assert words in setup_refusal(tmp_path, **{file: change})


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.integers(2, 14), st.floats(0.5, 40.0))
def test_markers_on_a_line_are_refused_however_it_lies(yaw: float, pitch: float, gaps: int, length: float) -> None:
    """And one marker well off it makes a map of them; so does a plane."""
    ahead = rotation_from_euler(yaw, pitch, 0.0)
    line = [ahead[:, 0] * length * i / gaps - 0.3 for i in range(gaps + 1)]
    for points, fixed in ((line, False), ([*line, line[0] + ahead[:, 2]], True)):
        tanker = convert(TANKER | {"markers": [{"id": 3 * i, "p_tanker_m": p.tolist()} for i, p in enumerate(points)]},
                         TankerConfig, "t.toml")
        told = [text for holds, text in tanker_rules(tanker) if not holds]
        assert any("on one line" in text for text in told) != fixed


@pytest.mark.parametrize(
    ("field", "unit"),
    [
        ("window.limit_m", "metres"), ("airspeed_m_s", "metres per second"), ("markers[3].p_tanker_m[1]", "metres"),
        ("max_roll_rad", "radians"), ("roll_rad_s", "radians per second"), ("hold_s", "seconds"), ("name", ""),
    ],
)
def test_unit_is_read_from_the_name(field: str, unit: str) -> None:
    assert unit_of(field) == unit


@given(st.sampled_from([n for n in all_field_names(CompanionConfig) if len(n) > 2]), st.data())
def test_any_key_with_two_letters_swapped_is_an_unknown_key(key: str, data: st.DataObject) -> None:
    k = data.draw(st.integers(0, len(key) - 2))
    wrong = key[:k] + key[k + 1] + key[k] + key[k + 2 :]
    if wrong in CompanionConfig.__struct_fields__:
        return
    with pytest.raises(ConfigError, match="unknown key"):
        convert(COMPANION | {wrong: 1}, CompanionConfig, "x.toml")
