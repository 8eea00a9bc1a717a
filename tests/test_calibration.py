"""Calibrations of ROS and Kalibr: read as their writers mean them, or refused in one line that names file and key."""

import math
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.__main__ import main
from companion.config import FIRMWARE_CONFIGS, CameraConfig, ConfigError, load, load_setup
from companion.config.calibration import GIVEN, camera_toml, read_calibration
from companion.geometry import SE3, R_cam_crf, rotation_from_euler
from companion.vision.camera import T_frd_cam

CAMERAS = FIRMWARE_CONFIGS / "cameras"
ROS_TEXT = (CAMERAS / "example_ros.yaml").read_text(encoding="utf-8")
KALIBR_TEXT = (CAMERAS / "example_kalibr.yaml").read_text(encoding="utf-8")
MOUNT = 'name = "c"\nrate_hz = 20.0\np_frd_cam_m = [5.0, 0.0, -0.3]\n'
RATIONAL = [0.31, -0.12, 1e-3, -8e-4, 0.02, 0.54, -0.03, 0.015]


def ros(**changed: Any) -> dict[str, Any]:
    return yaml.safe_load(ROS_TEXT) | changed


def kalibr(camera: str = "cam0", **changed: Any) -> dict[str, Any]:
    chain = yaml.safe_load(KALIBR_TEXT)
    return {camera: {k: v for k, v in (chain[camera] | changed).items() if v is not ...}}


def written(folder: Path, content: Any) -> Path:
    path = folder / "left.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
    return path


def refusal(path: Path, camera: str | None = None) -> str:
    with pytest.raises(ConfigError) as caught:
        read_calibration(path, camera)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def camera_of(folder: Path, extra: str = "", name: str = "left.yaml") -> CameraConfig:
    path = folder / "camera.toml"
    path.write_text(f'calibration = "{name}"\n{extra}{MOUNT}', encoding="utf-8")
    return load(path, CameraConfig)


def test_a_ros_calibration_stands_for_image_and_lens(tmp_path: Path) -> None:
    written(tmp_path, ROS_TEXT)
    camera = camera_of(tmp_path)
    assert camera.name == "c"
    assert (camera.width_px, camera.height_px) == (640, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (461.2357, 460.7481, 322.8114, 236.4902)
    assert camera.distortion_model == "plumb_bob"
    assert camera.distortion == (-0.213485, 0.071962, 0.000412, -0.000873, 0.0)
    assert camera.p_frd_cam_m == (5.0, 0.0, -0.3)


def test_every_camera_of_a_chain_can_be_chosen(tmp_path: Path) -> None:
    written(tmp_path, KALIBR_TEXT)
    radtan, fisheye = (camera_of(tmp_path, f'calibration_camera = "{c}"\n') for c in ("cam0", "cam1"))
    assert radtan.distortion_model == "plumb_bob"
    assert radtan.distortion == (-0.20781, 0.06453, 0.00031, -0.00046, 0.0)  # k3 is none of Kalibr's
    assert (radtan.fx_px, radtan.fy_px, radtan.cx_px, radtan.cy_px) == (458.9132, 458.4077, 318.2245, 241.7719)
    assert fisheye.distortion_model == "equidistant"
    assert fisheye.distortion == (-0.01274, 0.00523, -0.00891, 0.00317)


def test_what_the_writers_do_to_numbers_is_undone(tmp_path: Path) -> None:
    """yaml-cpp writes 1e-05 without a point and 461.0 as 461, camera_calibration wrote cols 5 above eight numbers."""
    text = ROS_TEXT.replace("0.000412", "1e-05").replace("461.2357", "461")
    camera = read_calibration(written(tmp_path, text)).image
    assert camera.distortion[2] == 1e-5
    assert camera.fx_px == 461.0
    numbers = {"rows": 1, "cols": 5, "data": RATIONAL}
    eight = ros(distortion_model="rational_polynomial", distortion_coefficients=numbers)
    assert list(read_calibration(written(tmp_path, eight)).image.distortion) == RATIONAL


def test_a_chain_of_one_needs_no_choice_and_none_is_no_distortion(tmp_path: Path) -> None:
    plain = kalibr(distortion_model="none", distortion_coeffs=[], T_cam_imu=..., timeshift_cam_imu=...)
    found = read_calibration(written(tmp_path, plain))
    assert found.image.distortion == (0.0,) * 5
    assert (found.T_cam_imu, found.timeshift_cam_imu_s) == (None, None)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({k: v for k, v in ros().items() if k != "camera_matrix"}, ["camera_matrix: missing"]),
        ({k: v for k, v in ros().items() if k != "image_height"}, ["image_height: missing"]),
        ({k: v for k, v in ros().items() if k != "distortion_model"}, ["distortion_model: missing"]),
        (ros(camera_matrix={"rows": 3, "cols": 3}), ["camera_matrix.data: missing"]),
        (ros(camera_matrix=[1.0, 0.0]), ["camera_matrix: must be a table with 'data'"]),
        (ros(camera_matrix={"data": [1.0] * 8}), ["camera_matrix.data: must be 9 numbers, not 8"]),
        (ros(camera_matrix={"data": [0.0] * 9}), ["camera_matrix.data", "uncalibrated"]),
        (ros(camera_matrix={"data": [9.0, 0.1, 3.0, 0.0, 9.0, 3.0, 0.0, 0.0, 1.0]}), ["camera_matrix.data", "skew"]),
        (ros(camera_matrix={"data": [math.nan] * 9}), ["camera_matrix.data[0]", "finite", "calibrate again"]),
        (ros(image_width=640.5), ["image_width", "whole number of pixels"]),
        (ros(image_width=True), ["image_width", "finite"]),
        (ros(distortion_model="thin_prism"), ["distortion_model", "thin_prism is not supported", "plumb_bob"]),
        (ros(distortion_model="fish\neye"), ["distortion_model", "fish eye is not supported"]),
        (ros(image_width=1e300), ["image_width", "whole number of pixels"]),
        (ros(distortion_model=5), ["distortion_model: must be a word"]),
        (ros(distortion_coefficients={"data": RATIONAL}), ["distortion_coefficients.data", "k3", "not 8"]),
        (ros(distortion_coefficients={"data": "x"}), ["distortion_coefficients.data: must be a list"]),
        (ros(distortion_coefficients={"data": [".inf"] * 5}), ["distortion_coefficients.data[0]", "finite"]),
        ({"height": 480, "width": 640, "distortion_model": "plumb_bob", "K": [1.0] * 9}, ["camera_info message"]),
        (kalibr(camera_model="omni"), ["cam0.camera_model", "pinhole-radtan"]),
        (kalibr(camera_model="ds", distortion_model="none"), ["cam0.camera_model", "pinhole-radtan"]),
        (kalibr(camera_model="eucm"), ["cam0.camera_model", "pinhole-equi"]),
        (kalibr(distortion_model="fov"), ["cam0.distortion_model", "pinhole-equi"]),
        (kalibr(intrinsics=[1.0] * 5), ["cam0.intrinsics: must be 4 numbers, not 5"]),
        (kalibr(intrinsics=[0.0] * 4), ["cam0.intrinsics", "positive"]),
        (kalibr(intrinsics=...), ["cam0.intrinsics: missing"]),
        (kalibr(distortion_coeffs=[0.0] * 3), ["cam0.distortion_coeffs", "not 3"]),
        (kalibr("cam1", distortion_coeffs=[0.0] * 5), ["cam1.distortion_coeffs", "4 numbers", "not 5"]),
        (kalibr(resolution=[640]), ["cam0.resolution: must be 2 numbers"]),
        (kalibr(resolution=[640, -480]), ["cam0.resolution", "whole number of pixels"]),
        (kalibr(timeshift_cam_imu="soon"), ["cam0.timeshift_cam_imu", "finite"]),
        (kalibr(T_cam_imu=[[0.0] * 4] * 4), ["cam0.T_cam_imu", "no rotation"]),
        (kalibr(T_cam_imu=np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), ["cam0.T_cam_imu", "no rotation"]),
        (kalibr(T_cam_imu=np.diag([1e200, 1.0, 1.0, 1.0]).tolist()), ["cam0.T_cam_imu", "no rotation"]),
        (kalibr(T_cam_imu=[[1.0]]), ["cam0.T_cam_imu", "4 rows"]),
        (kalibr(T_cam_imu=np.ones((4, 4)).tolist()), ["cam0.T_cam_imu"]),
        ({"cam0": None}, ["cam0: missing"]),
        (KALIBR_TEXT, ["cam0, cam1", 'calibration_camera = "cam0"', "--cam cam0"]),
        ({"name": "x"}, ["image_width", "camchain"]),
        ("", ["camchain"]),
        ("a: [1, 2", ["not valid YAML", "line"]),
        ("a: 2024-99-99", ["not valid YAML"]),
        ("[" * 5000, ["not valid YAML"]),
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n  rows: 3\n", ["not valid YAML"]),
    ],
)
def test_what_cannot_be_used_is_refused_by_its_key(tmp_path: Path, content: Any, words: list[str]) -> None:
    message = refusal(written(tmp_path, content))
    assert all(w in message for w in words), message


def test_a_camera_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path) -> None:
    assert "no 'cam7'; it holds cam0, cam1" in refusal(written(tmp_path, KALIBR_TEXT), "cam7")
    assert "leave calibration_camera (--cam) out" in refusal(written(tmp_path, ROS_TEXT), "cam0")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.yaml") == "no such file"
    assert "cannot be read" in refusal(tmp_path)
    (tmp_path / "left.yaml").write_bytes(b"\xff\xfe\x00")
    assert "cannot be read" in refusal(tmp_path / "left.yaml")


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("fx_px = 457.0\n", "camera.toml: fx_px: comes from left.yaml; remove it here"),
        ("distortion = []\nwidth_px = 4\n", "camera.toml: width_px, distortion: comes from left.yaml"),
        ("calibration_camera = 0\n", "camera.toml: calibration_camera: must be a text"),
        ('calibration_camera = "cam0"\n', "left.yaml: holds one camera"),
        ("rate_hertz = 1\n", "unknown key 'rate_hertz'; did you mean 'rate_hz'?"),
    ],
)
def test_a_camera_toml_that_does_not_fit_its_calibration(tmp_path: Path, extra: str, words: str) -> None:
    written(tmp_path, ROS_TEXT)
    with pytest.raises(ConfigError) as caught:
        camera_of(tmp_path, extra)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('calibraton = "left.yaml"\n', "did you mean 'calibration'?"),
        ("calibration = 5\n", "calibration: must be a text"),
        ('calibration = "nowhere.yaml"\n', "nowhere.yaml: no such file"),
        ('calibration_camera = "cam0"\n', "calibration_camera: is of no use without calibration"),
    ],
)
def test_a_calibration_that_is_named_wrong(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(text + MOUNT, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load(path, CameraConfig)
    assert words in str(caught.value)


def companion_toml(folder: Path, camera: Path) -> Path:
    path = folder / "companion.toml"
    path.write_text(f'camera = "{camera}"\ntanker = "{FIRMWARE_CONFIGS}/tankers/kc135r.toml"\n'
                    f'airframe = "{FIRMWARE_CONFIGS}/airframes/ice101.toml"\n', encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["example_ros", "example_kalibr"])
def test_shipped_examples_pass_all_rules(tmp_path: Path, name: str) -> None:
    camera = load_setup(companion_toml(tmp_path, CAMERAS / f"{name}.toml")).camera
    assert camera.name == name
    assert camera.mount_pitch_rad == 0.467


def test_a_calibration_in_place_of_a_camera_is_answered_with_the_way_to_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, ROS_TEXT)
    assert main(["run", str(companion_toml(tmp_path, path))]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f'calibration = "left.yaml" stands (`companion camera {path}` prints one)' in said


def test_the_printed_camera_is_the_calibrated_one_once_filled_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both ways to a camera end in the same: printing and filling in, and naming the calibration."""
    path = written(tmp_path, KALIBR_TEXT)
    assert main(["camera", str(path), "--cam", "cam1"]) == 0
    printed = capsys.readouterr().out
    (tmp_path / "printed.toml").write_text(printed, encoding="utf-8")
    with pytest.raises(ConfigError, match="missing required field"):  # mount and rate are not made up
        load(tmp_path / "printed.toml", CameraConfig)
    filled = printed.replace("# rate_hz", "rate_hz").replace("# p_frd_cam_m", "p_frd_cam_m").replace("# mount", "mount")
    (tmp_path / "printed.toml").write_text(filled, encoding="utf-8")
    there, here = load(tmp_path / "printed.toml", CameraConfig), camera_of(tmp_path, 'calibration_camera = "cam1"\n')
    assert there.name == "left-cam1"
    assert all(getattr(there, k) == getattr(here, k) for k in GIVEN)
    assert "-0.00409 s" in printed


def test_a_name_that_toml_has_to_escape_survives(tmp_path: Path) -> None:
    text = camera_toml(read_calibration(written(tmp_path, ros(camera_name='my "left"\ncamera'))))
    assert tomllib.loads(text)["name"] == 'my "left"\ncamera'


@pytest.mark.parametrize(("imu", "R_imu_frd"), [("frd", np.eye(3)), ("flu", np.diag([1.0, -1.0, -1.0]))])
def test_the_mount_comes_back_from_the_imu(tmp_path: Path, imu: str, R_imu_frd: np.ndarray) -> None:
    """A camera is mounted, Kalibr would say where the IMU is from it, and the printed mount is that of the camera."""
    T = SE3(rotation_from_euler(0.2, 0.467, -0.1) @ R_cam_crf.T, np.array([5.0, 0.3, -0.3]))
    T_cam_imu = T.inverse() @ SE3(R_imu_frd.T, np.zeros(3))
    path = written(tmp_path, kalibr(T_cam_imu=T_cam_imu.as_matrix().tolist()))
    (tmp_path / "printed.toml").write_text(camera_toml(read_calibration(path), imu).replace("# rate", "rate"), "utf-8")
    camera = load(tmp_path / "printed.toml", CameraConfig)
    np.testing.assert_allclose(T_frd_cam(camera).as_matrix(), T.as_matrix(), atol=1e-12)
    assert (camera.mount_yaw_rad, camera.mount_roll_rad) == (pytest.approx(0.2), pytest.approx(-0.1))


def test_a_mount_without_an_imu_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, ROS_TEXT)
    assert main(["camera", str(path), "--imu", "flu"]) == 2
    assert capsys.readouterr().err.startswith(f"companion: {path}: T_cam_imu: missing, so that --imu has nothing")


DAMAGE = st.tuples(st.floats(0, 1), st.integers(0, 30), st.text("0e-.:[]{} \n#%&*!|>'\"abnK\x00\t", max_size=3))


@settings(max_examples=120, deadline=None)
@given(st.sampled_from([ROS_TEXT, KALIBR_TEXT]), st.lists(DAMAGE, min_size=1, max_size=4), st.data())
def test_a_damaged_file_is_a_calibration_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, text: str, damage: list[tuple[float, int, str]], data: st.DataObject
) -> None:
    for where, lost, put in damage:
        at = int(where * len(text))
        text = text[:at] + put + text[at + lost :]
    path = tmp_path_factory.getbasetemp() / "damaged.yaml"
    path.write_text(text, encoding="utf-8")
    try:
        found = read_calibration(path, data.draw(st.sampled_from([None, "cam0", "cam1"])))
    except ConfigError as error:
        found, message = None, str(error)
    if found is None:
        assert "\n" not in message
        return
    assert np.isfinite([found.image.fx_px, found.image.cy_px, *found.image.distortion]).all()
    fields = tomllib.loads(camera_toml(found)) | {"rate_hz": 20.0, "p_frd_cam_m": [0.0, 0.0, 0.0]}
    assert msgspec.convert(fields, CameraConfig).fx_px > 0
