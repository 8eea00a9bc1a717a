"""Configuration: frozen structures with documented defaults, loaded once from TOML and passed down.

Every field's unit is in its name. A wrong file is answered with one ``ConfigError`` that names file, field and unit.
Files named inside a file (``camera``, ``tanker``, ``airframe``) are relative to that file.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

FIRMWARE_CONFIGS = Path(__file__).resolve().parent.parent / "firmware_configs"

UNITS = {
    "_m": "metres",
    "_m_s": "metres per second",
    "_m_s2": "metres per second squared",
    "_rad": "radians",
    "_rad_s": "radians per second",
    "_hz": "hertz",
    "_s": "seconds",
    "_px": "pixels",
    "_ns": "nanoseconds",
    "_kg": "kilograms",
    "_n": "newtons",
    "_baud": "bits per second",
}


class ConfigError(ValueError):
    """A configuration that cannot be used; its text is one line for people."""


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all configuration: frozen, and a misspelt key is an error."""


Vec3 = tuple[float, float, float]


class CameraConfig(Struct, frozen=True, kw_only=True):
    """Pinhole camera with Brown distortion, and its place on the receiver.

    ``distortion`` k1, k2, p1, p2, k3 of OpenCV. ``p_frd_cam_m`` is the centre of projection in receiver body axes;
    ``mount_*`` turn body axes to the thesis' camera axes (forward, right, down), yaw, pitch, roll in that order.
    ``exposure_s`` and ``latency_s``: how long one picture integrates, and from mid-exposure to delivery.
    """

    name: str
    width_px: int
    height_px: int
    rate_hz: float
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    p_frd_cam_m: Vec3
    mount_yaw_rad: float = 0.0
    mount_pitch_rad: float = 0.0
    mount_roll_rad: float = 0.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    exposure_s: float = 0.0
    latency_s: float = 0.02


class MarkerConfig(Struct, frozen=True, kw_only=True):
    """One light on the tanker. ``p_tanker_m`` in tanker body axes from its centre of mass."""

    id: int
    p_tanker_m: Vec3
    where: str = ""


class WindowConfig(Struct, frozen=True, kw_only=True):
    """Three-dimensional window of thesis Tab. 1.1: half-widths about box B, per axis of ``mrf``."""

    desired_m: Vec3 = (0.40, 1.87, 0.90)
    limit_m: Vec3 = (2.10, 2.10, 2.56)


class BoomConfig(Struct, frozen=True, kw_only=True):
    """Where the boom hangs: pivot in tanker axes, nominal angles and length."""

    pivot_tanker_m: Vec3
    elevation_rad: float = math.radians(30.0)
    azimuth_rad: float = 0.0
    length_m: float = 11.5


class TankerConfig(Struct, frozen=True, kw_only=True):
    """What the companion must know of a tanker: lights, refuelling box, window."""

    name: str
    markers: tuple[MarkerConfig, ...]
    marker_radius_m: float
    box_tanker_m: Vec3
    boom: BoomConfig
    window: WindowConfig = WindowConfig()
    why: str = ""


class DetectionConfig(Struct, frozen=True, kw_only=True):
    """Marker detection (thesis 4.2.1): a pixel is lit when red exceeds the larger of green and blue by a threshold."""

    threshold: int = 60
    min_area_px: int = 1
    max_area_px: int = 4000
    morphology_px: int = 0
    max_detections: int = 64


class VisionConfig(Struct, frozen=True, kw_only=True):
    """Labeling and pose. ``mode`` rv uses the picture, sv the projected markers (thesis 4.2.5)."""

    solver: Literal["lhm", "glsdc"] = "lhm"
    mode: Literal["rv", "sv"] = "rv"
    method: Literal["svd", "quaternion"] = "svd"
    tol: float = 1e-5
    epsilon: float = 1e-8
    glsdc_iterations: int = 4
    min_markers: int = 5
    max_label_distance_px: float = 40.0
    max_image_error_px: float = 3.0
    detection: DetectionConfig = DetectionConfig()


class FusionConfig(Struct, frozen=True, kw_only=True):
    """GPS/vision blend of thesis eq. 3.9: all GPS beyond ``d1_m``, all vision within ``d2_m``."""

    method: Literal["blend"] = "blend"
    d1_m: float = 55.0
    d2_m: float = 40.0
    min_markers: int = 5
    vision_stale_s: float = 0.3
    own_stale_s: float = 0.3
    tanker_stale_s: float = 1.0


class LawWeights(Struct, frozen=True, kw_only=True):
    """Diagonals of Q and R of the docking law (thesis eq. 3.11): errors, rates, integrals, then inputs."""

    e_x: float = 1.0
    e_y: float = 1.0
    e_z: float = 1.0
    v_x: float = 1.0
    v_y: float = 1.0
    v_z: float = 1.0
    p: float = 0.0
    q: float = 0.0
    int_x: float = 0.05
    int_y: float = 0.05
    int_z: float = 0.05
    roll: float = 150.0
    pitch: float = 400.0
    thrust: float = 2.0


class GuidanceConfig(Struct, frozen=True, kw_only=True):
    """Path, law and phases. ``link_delay_s``: from a state's instant to its setpoint's arrival at the autopilot."""

    law: Literal["attitude"] = "attitude"
    rate_hz: float = 50.0
    weights: LawWeights = LawWeights()
    link_delay_s: float = 0.0
    auto_engage: bool = False
    path_duration_s: float = 50.0
    join_settle_s: float = 3.0
    join_tolerance_m: float = 2.5
    off_path_m: float = 10.0
    join_range_m: float = 150.0
    max_closure_m_s: float = 2.0
    estimate_stale_s: float = 0.3
    breakaway_stale_s: float = 1.0
    capture_s: float = 2.0
    max_roll_rad: float = 0.35
    max_pitch_offset_rad: float = 0.12
    breakaway_descent_rad: float = 0.05
    breakaway_thrust: float = 0.05
    breakaway_separation_m: float = 60.0


class LinksConfig(Struct, frozen=True, kw_only=True):
    """Where the other ends are. An empty ``datalink`` or ``camera`` means there is none.

    ``system_id`` is the vehicle's, ours and the autopilot's; commands are taken from it and from ``gcs_system_id``.
    ``origin_altitude_m`` is the height at which the down axis of ``ned`` is zero for both aircraft.
    """

    mavlink: str = "udpin:127.0.0.1:14540"
    datalink: str = ""
    camera: str = ""
    system_id: int = 1
    component_id: int = 191
    autopilot_component_id: int = 1
    origin_altitude_m: float = 6000.0
    gcs_system_id: int = 255


class RecorderConfig(Struct, frozen=True, kw_only=True):
    """What is written to the run folder."""

    out: str = "runs"
    image_rate_hz: float = 5.0
    jpeg_quality: int = 80


class AttitudeResponse(Struct, frozen=True, kw_only=True):
    """How the autopilot follows attitude and thrust: second-order roll and pitch, first-order thrust, delay."""

    roll_rad_s: float
    roll_damping: float
    pitch_rad_s: float
    pitch_damping: float
    thrust_lag_s: float
    delay_s: float


class TrimConfig(Struct, frozen=True, kw_only=True):
    """Level flight behind the tanker."""

    airspeed_m_s: float
    altitude_m: float
    alpha_rad: float
    throttle: float
    effectors: tuple[float, ...]


class AirframeConfig(Struct, frozen=True, kw_only=True):
    """The receiver: where its receptacle is and how it flies; written by ``sim-bridge linearize``.

    ``A`` (9, 9) over V, alpha, beta, p, q, r, psi, theta, phi (m/s, rad, rad/s) and ``B`` (9, 10) over the thesis'
    input vector (eq. 3.3; throttle 0..1, surfaces in rad), at ``trim``.
    """

    name: str
    receptacle_frd_m: Vec3
    mass_kg: float
    trim: TrimConfig
    response: AttitudeResponse
    A: tuple[tuple[float, ...], ...]
    B: tuple[tuple[float, ...], ...]
    source: str = ""


class CompanionConfig(Struct, frozen=True, kw_only=True):
    """Everything that ``companion run`` needs; the named files are loaded beside it."""

    camera: str
    tanker: str
    airframe: str
    links: LinksConfig = LinksConfig()
    vision: VisionConfig = VisionConfig()
    fusion: FusionConfig = FusionConfig()
    guidance: GuidanceConfig = GuidanceConfig()
    recorder: RecorderConfig = RecorderConfig()


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """A companion configuration with its files loaded."""

    config: CompanionConfig
    camera: CameraConfig
    tanker: TankerConfig
    airframe: AirframeConfig


T = TypeVar("T")


def load(path: Path | str, kind: type[T]) -> T:
    """Load one TOML file as ``kind``; raises ConfigError with one line that says what to mend."""
    path = Path(path)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        msg = f"{path}: no such file"
        raise ConfigError(msg) from None
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{path}: cannot be read ({error})"
        raise ConfigError(msg) from None
    except tomllib.TOMLDecodeError as error:
        msg = f"{path}: not valid TOML: {error}"
        raise ConfigError(msg) from None
    return convert(raw, kind, str(path))


def convert(raw: dict[str, Any], kind: type[T], name: str) -> T:
    """Check a dictionary against ``kind``; ``name`` is what errors call it."""
    try:
        value = msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(explain(str(error), kind, name)) from None
    bad = first_not_finite(raw, "")
    if bad:
        msg = f"{name}: {bad} is not a finite number"
        raise ConfigError(msg)
    return value


def explain(error: str, kind: type, name: str) -> str:
    """Turn msgspec's message into one line with file, field, unit and the nearest right key."""
    where = re.search(r"at `\$(.*?)`", error)
    field = where.group(1).lstrip(".") if where else ""
    unknown = re.search(r"unknown field `(.*?)`", error)
    if unknown:
        key = unknown.group(1)
        near = difflib.get_close_matches(key, all_field_names(kind), n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        return f"{name}: unknown key '{f'{field}.' if field else ''}{key}'{hint}"
    what = error.split(" - at ", maxsplit=1)[0]
    unit = unit_of(field)
    return f"{name}: {field or 'file'}: {what}{f' ({unit})' if unit else ''}"


def unit_of(field: str) -> str:
    """Return the unit that a field's name ends in, or an empty string."""
    leaf = re.sub(r"\[.*?\]", "", field).rsplit(".", maxsplit=1)[-1]
    for suffix in sorted(UNITS, key=len, reverse=True):
        if leaf.endswith(suffix):
            return UNITS[suffix]
    return ""


def all_field_names(kind: Any) -> list[str]:
    """Collect the field names of a structure and of the structures inside it."""
    names: list[str] = []
    for f in msgspec.structs.fields(kind):
        names.append(f.encode_name)
        if isinstance(f.type, type) and issubclass(f.type, msgspec.Struct):
            names.extend(all_field_names(f.type))
    return names


def first_not_finite(value: Any, where: str) -> str:
    """Return the path of the first number that is NaN or infinite, or an empty string."""
    if isinstance(value, float) and not math.isfinite(value):
        return where
    children: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        children = [(f"{where}.{k}" if where else k, v) for k, v in value.items()]
    elif isinstance(value, list):
        children = [(f"{where}[{i}]", v) for i, v in enumerate(value)]
    return next((bad for w, v in children if (bad := first_not_finite(v, w))), "")


def load_setup(path: Path | str) -> Setup:
    """Load a companion configuration and the camera, tanker and airframe files that it names."""
    path = Path(path)
    config = load(path, CompanionConfig)
    return assemble(config, path)


def assemble(config: CompanionConfig, path: Path) -> Setup:
    """Load the files that ``config``, from the file ``path``, names relative to itself; check what types do not."""
    folder = path.parent
    setup = Setup(
        config=config,
        camera=load(folder / config.camera, CameraConfig),
        tanker=load(folder / config.tanker, TankerConfig),
        airframe=load(folder / config.airframe, AirframeConfig),
    )
    for file, rules in (
        (path, companion_rules(config)),
        (folder / config.camera, camera_rules(setup.camera)),
        (folder / config.tanker, [*tanker_rules(setup.tanker), enough_markers(config, setup.tanker)]),
        (folder / config.airframe, airframe_rules(setup.airframe)),
    ):
        for holds, text in rules:
            if not holds:
                msg = f"{file}: {text}"
                raise ConfigError(msg)
    return setup


Rules = list[tuple[bool, str]]
"""What has to hold of values that are of the right type, and what to say when it does not."""


def enough_markers(c: CompanionConfig, t: TankerConfig) -> tuple[bool, str]:
    """Return that the tanker has as many lights as a pose is asked to have."""
    most = max(c.vision.min_markers, c.fusion.min_markers)
    return most <= len(t.markers), f"min_markers {most}, and the tanker has {len(t.markers)} markers"


def camera_rules(c: CameraConfig) -> Rules:
    """Return what has to hold of a camera."""
    turns = max(abs(c.mount_yaw_rad), abs(c.mount_pitch_rad), abs(c.mount_roll_rad))
    return [
        (c.width_px >= 16 and c.height_px >= 16, "width_px and height_px must be at least 16"),
        (c.fx_px > 0 and c.fy_px > 0, "fx_px and fy_px must be positive"),
        (0 < c.rate_hz <= 1000, "rate_hz must be in 0..1000 hertz"),
        (c.latency_s >= 0 and c.exposure_s >= 0, "latency_s and exposure_s must not be negative"),
        (turns <= math.pi, "mount_yaw_rad, mount_pitch_rad, mount_roll_rad must be within pi (radians, not degrees)"),
    ]


def tanker_rules(t: TankerConfig) -> Rules:
    """Return what has to hold of a tanker."""
    window = all(0 < d <= m for d, m in zip(t.window.desired_m, t.window.limit_m, strict=True))
    return [
        (len(t.markers) >= 4, "at least 4 markers are needed for a pose"),
        (len({m.id for m in t.markers}) == len(t.markers), "two markers have the same id"),
        (t.marker_radius_m > 0, "marker_radius_m must be positive"),
        (window, "window.desired_m must be positive and lie inside window.limit_m"),
    ]


def airframe_rules(a: AirframeConfig) -> Rules:
    """Return what has to hold of an airframe."""
    return [
        (len(a.A) == 9 and all(len(r) == 9 for r in a.A), "A must be 9 rows of 9"),
        (len(a.B) == 9 and all(len(r) == 10 for r in a.B), "B must be 9 rows of 10"),
        (a.mass_kg > 0, "mass_kg must be positive kilograms"),
        (a.trim.airspeed_m_s > 0, "trim.airspeed_m_s must be positive"),
        (0 <= a.trim.throttle <= 1, "trim.throttle must be in 0..1"),
        (abs(a.trim.alpha_rad) < math.pi / 2, "trim.alpha_rad must be within pi / 2 (radians, not degrees)"),
        (len(a.trim.effectors) == 10, "trim.effectors must be 10 values"),
        (min(a.response.roll_rad_s, a.response.pitch_rad_s, a.response.thrust_lag_s) > 0,
         "response.roll_rad_s, pitch_rad_s and thrust_lag_s must be positive"),
        (0 <= a.response.delay_s <= 1, "response.delay_s must be in 0..1 seconds"),
    ]


def companion_rules(c: CompanionConfig) -> Rules:
    """Return what has to hold of the companion's own values."""
    g, links, fusion = c.guidance, c.links, c.fusion
    ids = (links.system_id, links.component_id, links.autopilot_component_id, links.gcs_system_id)
    return [
        (fusion.d1_m > fusion.d2_m > 0, "fusion: d1_m must be larger than d2_m, both in metres"),
        (fusion.min_markers >= 4, "fusion.min_markers must be at least 4"),
        (c.vision.min_markers >= 4, "vision.min_markers must be at least 4"),
        (min(fusion.vision_stale_s, fusion.own_stale_s, fusion.tanker_stale_s) > 0,
         "fusion: vision_stale_s, own_stale_s and tanker_stale_s must be positive seconds"),
        (10 <= g.rate_hz <= 200, "guidance.rate_hz must be in 10..200 hertz"),
        (g.path_duration_s > 0, "guidance.path_duration_s must be positive seconds"),
        (g.max_closure_m_s > 0, "guidance.max_closure_m_s must be positive metres per second"),
        (min(g.join_range_m, g.off_path_m, g.breakaway_separation_m) > 0,
         "guidance: join_range_m, off_path_m and breakaway_separation_m must be positive metres"),
        (min(msgspec.structs.astuple(g.weights)) >= 0, "guidance.weights must not be negative"),
        (min(g.weights.roll, g.weights.pitch, g.weights.thrust) > 0,
         "guidance.weights: roll, pitch and thrust must be positive"),
        (c.vision.tol > 0 and c.vision.epsilon > 0, "vision: tol and epsilon must be positive"),
        (min(c.vision.max_label_distance_px, c.vision.max_image_error_px) > 0,
         "vision: max_label_distance_px and max_image_error_px must be positive pixels"),
        (c.vision.glsdc_iterations >= 1, "vision.glsdc_iterations must be at least 1"),
        (c.vision.detection.morphology_px >= 0, "vision.detection.morphology_px must not be negative"),
        (c.vision.detection.max_detections >= 4, "vision.detection.max_detections must be at least 4"),
        (0 < g.estimate_stale_s <= 1, "guidance.estimate_stale_s must be in 0..1 seconds"),
        (g.estimate_stale_s <= g.breakaway_stale_s <= 10,
         "guidance.breakaway_stale_s must be in estimate_stale_s..10 seconds"),
        (0 < g.max_roll_rad < math.pi / 2, "guidance.max_roll_rad must be in 0..pi / 2 (radians, not degrees)"),
        (0 < g.max_pitch_offset_rad < math.pi / 4,
         "guidance.max_pitch_offset_rad must be in 0..pi / 4 (radians, not degrees)"),
        (0 <= g.breakaway_thrust <= 1, "guidance.breakaway_thrust must be in 0..1"),
        (0 <= g.link_delay_s <= 1, "guidance.link_delay_s must be in 0..1 seconds"),
        (0 < c.vision.detection.threshold < 256, "vision.detection.threshold must be in 1..255"),
        (all(1 <= i <= 255 for i in ids), "links: system and component ids must be in 1..255"),
        (c.recorder.image_rate_hz >= 0, "recorder.image_rate_hz must not be negative"),
        (1 <= c.recorder.jpeg_quality <= 100, "recorder.jpeg_quality must be in 1..100"),
    ]
