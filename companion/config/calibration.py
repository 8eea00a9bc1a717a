"""Camera calibrations of ROS and Kalibr, into what a camera TOML says of image and lens.

Rules
-----
* A camera TOML names one with ``calibration = "left.yaml"``, relative to itself, and a camera of a chain with
  ``calibration_camera = "cam0"``. It then gives ``GIVEN``; all other keys stay in the TOML, mount and rate too.
* ROS: what camera_calibration saves and camera_info_manager loads (``image_width``, ``camera_matrix``, ...). Camera
  matrix and distortion are read, which belong to unrectified pictures (``image_raw``); rectification and projection
  matrix belong to rectified ones, which the companion does not take. ``cols`` of the distortion is not looked at:
  camera_calibration long wrote 5 above eight numbers.
* Kalibr: a camchain as in its wiki, page "yaml formats" (``cam0``, ``cam1``, ...), camera model ``pinhole``.
  ``T_cam_imu`` is where the IMU is, and the axes of an IMU are rarely those of the aircraft, so no mount is taken from
  it unasked; ``companion camera --imu`` prints one. ``timeshift_cam_imu`` belongs to the stamps of the pictures, which
  have to be mid-exposure when they arrive; it is printed, and used nowhere.
* Both count pixels as we do: u right, v down, centres at integers (they rest on OpenCV).
* PyYAML reads 1e-05, without a point, as a text (YAML 1.1), and yaml-cpp writes it so: texts that are numbers count.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np
import tomli_w
import yaml

from companion.config.errors import ConfigError, read_text
from companion.config.rules import COEFFICIENTS
from companion.config.structures import DistortionModel
from companion.geometry import SE3, Mat, R_cam_crf, euler_from_rotation

SUFFIXES = (".yaml", ".yml")
CALIBRATION_KEYS = ("calibration", "calibration_camera")
GIVEN = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion_model", "distortion")
"""Keys of a camera TOML that a calibration takes the place of."""

MOST_PIXELS = 1e5
"""More than this across is a mistake."""

KALIBR_MODELS: dict[str, DistortionModel] = {
    "radtan": "plumb_bob", "equidistant": "equidistant", "equi": "equidistant", "none": "plumb_bob",
}
R_IMU_FRD: dict[str, Mat] = {"frd": np.eye(3), "flu": np.diag([1.0, -1.0, -1.0])}
"""Body axes to those of an IMU that is mounted along them: forward, right, down, or ROS' forward, left, up."""


@dataclass(frozen=True, slots=True)
class Image:
    """What a calibration says of image and lens, under the names that a camera TOML has for it."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion_model: DistortionModel
    distortion: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """One camera of a calibration file; ``T_cam_imu`` and the time shift are Kalibr's, if it has found any."""

    file: Path
    name: str
    image: Image
    T_cam_imu: SE3 | None = None
    timeshift_cam_imu_s: float | None = None


@dataclass(frozen=True, slots=True)
class Node:
    """A place in a calibration file: its value, and what errors call it."""

    file: Path
    key: str
    value: Any

    def fail(self, text: str) -> NoReturn:
        """Raise ConfigError with file, key and ``text``."""
        msg = f"{self.file}: {self.key}{': ' if self.key else ''}{' '.join(text.split())}"
        raise ConfigError(msg)

    def __getitem__(self, key: str) -> Node:
        """Return what is under ``key``; raises ConfigError when it is missing."""
        name = f"{self.key}.{key}" if self.key else key
        if not isinstance(self.value, dict):
            self.fail(f"must be a table with '{key}' in it")
        if self.value.get(key) is None:
            Node(self.file, name, None).fail("missing; save the calibration again or write it in")
        return Node(self.file, name, self.value[key])

    def find(self, key: str) -> Node | None:
        """Return what is under ``key``, if there is anything."""
        return self[key] if isinstance(self.value, dict) and self.value.get(key) is not None else None

    def text(self) -> str:
        """Return a word."""
        if not isinstance(self.value, str):
            self.fail("must be a word")
        return self.value

    def number(self) -> float:
        """Return a finite number."""
        try:
            value = math.nan if isinstance(self.value, bool) else float(self.value)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            self.fail(f"{str(self.value)[:40]!r} is not a finite number; calibrate again")
        return value

    def numbers(self, count: int | None = None) -> tuple[float, ...]:
        """Return finite numbers, ``count`` of them if it is given."""
        if not isinstance(self.value, list):
            self.fail("must be a list of numbers")
        if count is not None and len(self.value) != count:
            self.fail(f"must be {count} numbers, not {len(self.value)}")
        return tuple(Node(self.file, f"{self.key}[{i}]", v).number() for i, v in enumerate(self.value))

    def pixels(self) -> int:
        """Return a whole positive number of pixels."""
        value = self.number()
        if value != int(value) or not 0 < value <= MOST_PIXELS:
            self.fail(f"must be a whole number of pixels, not {value:g}")
        return int(value)


def read_calibration(file: Path, camera: str | None = None) -> Calibration:
    """Read a calibration; ``camera`` says which one of a Kalibr chain. Raises ConfigError with one line."""
    text = read_text(file)
    try:
        root = Node(file, "", yaml.safe_load(text))
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a date or number that is none
        mark = getattr(error, "problem_mark", None)
        what = getattr(error, "problem", None) or type(error).__name__
        msg = f"{file}: not valid YAML: {what}{f', line {mark.line + 1}' if mark else ''}"
        raise ConfigError(" ".join(msg.split())) from None
    keys = [str(k) for k in root.value] if isinstance(root.value, dict) else []
    chain = sorted(k for k in keys if re.fullmatch(r"cam\d+", k))
    if chain:
        return read_kalibr(root, chain, camera)
    if "camera_matrix" not in keys and "image_width" not in keys:
        kind = "is a camera_info message" if "distortion_model" in keys else "no calibration"
        root.fail(f"{kind}; wanted is what ROS' camera_calibration saves (image_width, camera_matrix, ...) or a Kalibr "
                  "camchain (cam0, ...)")
    if camera is not None:
        root.fail(f"holds one camera, so that '{camera}' names none; leave calibration_camera (--cam) out")
    return read_ros(root)


def read_ros(root: Node) -> Calibration:
    """Read what camera_calibration saves."""
    matrix = root["camera_matrix"]["data"]
    fx, skew, cx, zero, fy, cy, *last = matrix.numbers(9)
    if fx <= 0 or fy <= 0:
        matrix.fail("focal lengths must be positive; zero is an uncalibrated camera: calibrate it")
    if (skew, zero, *last) != (0.0, 0.0, 0.0, 0.0, 1.0):
        matrix.fail("must be fx, 0, cx, 0, fy, cy, 0, 0, 1; skew is not supported")
    model = root["distortion_model"]
    if model.text() not in COEFFICIENTS:
        model.fail(f"{model.text()} is not supported; calibrate as {', '.join(COEFFICIENTS)}")
    name = root.find("camera_name")
    image = Image(
        root["image_width"].pixels(), root["image_height"].pixels(), fx, fy, cx, cy,
        cast("DistortionModel", model.text()),
        coefficients(root["distortion_coefficients"]["data"], cast("DistortionModel", model.text())),
    )
    return Calibration(root.file, str(name.value) if name else root.file.stem, image)


def read_kalibr(root: Node, chain: list[str], camera: str | None) -> Calibration:
    """Read one camera of a Kalibr chain."""
    if camera is None and len(chain) > 1:
        root.fail(f"holds {', '.join(chain)}; say which: calibration_camera = \"{chain[0]}\" (--cam {chain[0]})")
    if camera is not None and camera not in chain:
        root.fail(f"has no '{camera}'; it holds {', '.join(chain)}")
    name = camera or chain[0]
    node = root[name]
    models, model = node["camera_model"], node["distortion_model"]
    if models.text() != "pinhole" or model.text() not in KALIBR_MODELS:
        (model if models.text() == "pinhole" else models).fail(
            "not supported; calibrate again with --models pinhole-radtan, or pinhole-equi for a fisheye")
    fx, fy, cx, cy = node["intrinsics"].numbers(4)
    if fx <= 0 or fy <= 0:
        node["intrinsics"].fail("focal lengths must be positive; calibrate again")
    node["resolution"].numbers(2)
    width, height = (Node(root.file, f"{name}.resolution", v).pixels() for v in node["resolution"].value)
    ours = KALIBR_MODELS[model.text()]
    bent = (0.0,) * 5 if model.text() == "none" else coefficients(node["distortion_coeffs"], ours)
    pose, shift = node.find("T_cam_imu"), node.find("timeshift_cam_imu")
    return Calibration(
        root.file, f"{root.file.stem}-{name}", Image(width, height, fx, fy, cx, cy, ours, bent),
        rigid(pose) if pose else None, shift.number() if shift else None,
    )


def coefficients(node: Node, model: DistortionModel) -> tuple[float, ...]:
    """Return distortion coefficients; four of ``plumb_bob``, as Kalibr has them, get k3 = 0."""
    values = node.numbers()
    if model == "plumb_bob" and len(values) == 4:
        return (*values, 0.0)
    if len(values) != int(COEFFICIENTS[model][0]):
        node.fail(f"{model} takes {COEFFICIENTS[model]}, not {len(values)}")
    return values


def rigid(node: Node) -> SE3:
    """Return the transform in four rows of four; raises ConfigError when they turn and shift nothing rigidly."""
    if not isinstance(node.value, list) or len(node.value) != 4:
        node.fail("must be 4 rows of 4 numbers")
    T = np.array([Node(node.file, f"{node.key}[{i}]", row).numbers(4) for i, row in enumerate(node.value)])
    R, last = T[:3, :3], T[3]
    if not (np.abs(R) < 1.01).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        node.fail("its first three columns are no rotation; calibrate again")
    if np.abs(last - [0.0, 0.0, 0.0, 1.0]).max() > 1e-9:
        node.fail("its last row must be 0, 0, 0, 1")
    return SE3(R, T[:3, 3])


def with_calibration(raw: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the content of the camera TOML ``path`` with the calibration that it names in place of its name."""
    if not any(k in raw for k in CALIBRATION_KEYS):
        return raw
    for key in CALIBRATION_KEYS:
        if not isinstance(raw.get(key, ""), str):
            Node(path, key, None).fail("must be a text")
    if "calibration" not in raw:
        Node(path, "calibration_camera", None).fail("is of no use without calibration = \"FILE.yaml\"")
    twice = [k for k in GIVEN if k in raw]
    if twice:
        where = Node(path, ", ".join(twice), None)
        where.fail(f"comes from {raw['calibration']}; remove it here, or remove calibration")
    found = read_calibration(path.parent / raw["calibration"], raw.get("calibration_camera"))
    return {k: v for k, v in raw.items() if k not in CALIBRATION_KEYS} | toml_fields(found)


def toml_fields(found: Calibration) -> dict[str, Any]:
    """Return ``GIVEN`` of a calibration as TOML has it."""
    return asdict(found.image) | {"distortion": list(found.image.distortion)}


def camera_toml(found: Calibration, imu: str | None = None) -> str:
    """Return a camera TOML made of a calibration; what it does not know is left to fill in.

    ``imu`` frd or flu says that the IMU of ``T_cam_imu`` lies along the body axes, and which way they are counted.
    """
    shift = found.timeshift_cam_imu_s
    notes = [f"# From {found.file.name}. Pictures have to come as the sensor gives them, not rectified."]
    if shift is not None:
        notes.append(f"# Kalibr found the camera's stamps {-shift:g} s ahead of the IMU's: add {shift:g} s to them.")
    if imu is not None:
        mount = mount_from_imu(found, imu)
        rest = [
            "# The place is counted from the IMU: add where it is from the centre of mass (forward, right, down, m).",
            tomli_w.dumps(mount).rstrip(),
        ]
    else:
        rest = [
            "# Fill in the place of the centre of projection from the centre of mass (forward, right, down, metres),",
            "# and the angles that turn body axes to the camera's, in this order." + (
                " With --imu they come from T_cam_imu." if found.T_cam_imu else ""),
            "# p_frd_cam_m = [5.0, 0.0, -0.3]",
            "# mount_yaw_rad = 0.0", "# mount_pitch_rad = 0.467", "# mount_roll_rad = 0.0",
        ]
    body = tomli_w.dumps({"name": found.name} | toml_fields(found)).rstrip()
    return "\n".join([*notes, body, "# Fill in how many pictures come per second.", "# rate_hz = 20.0", *rest]) + "\n"


def mount_from_imu(found: Calibration, imu: str) -> dict[str, Any]:
    """Return place (from the IMU) and angles of the camera for an IMU whose axes are the body's."""
    if found.T_cam_imu is None:
        Node(found.file, "T_cam_imu", None).fail("missing, so that --imu has nothing to go by; leave it out")
    T_frd_cam = (found.T_cam_imu @ SE3(R_IMU_FRD[imu], np.zeros(3))).inverse()
    yaw, pitch, roll = euler_from_rotation(T_frd_cam.R @ R_cam_crf)
    return {
        "p_frd_cam_m": [float(v) for v in T_frd_cam.t],
        "mount_yaw_rad": yaw, "mount_pitch_rad": pitch, "mount_roll_rad": roll,
    }
