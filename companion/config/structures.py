"""Configuration: frozen structures with documented defaults. Every field's unit is in its name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from companion.config.base import Struct, Vec3
from companion.config.boom import BoomConfig
from companion.config.estimation import FusionConfig, IntegrityConfig
from companion.config.guidance import GuidanceConfig

FIRMWARE_CONFIGS = Path(__file__).resolve().parent.parent.parent / "firmware_configs"

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]


class CameraConfig(Struct, frozen=True, kw_only=True):
    """Pinhole camera behind a lens, and its place on the receiver.

    ``distortion`` in the order of ROS and OpenCV: k1, k2, p1, p2, k3 of ``plumb_bob``, with k4, k5, k6 behind them of
    ``rational_polynomial``, or k1, k2, k3, k4 of ``equidistant`` (fisheye). Pictures are as the sensor gives them, not
    rectified. A file may say ``calibration`` (and ``calibration_camera``) in place of everything from ``width_px`` to
    ``cy_px`` and the distortion: see ``companion.config.calibration``.

    ``p_frd_cam_m`` is the centre of projection in receiver body axes; ``mount_*`` turn body axes to the thesis'
    camera axes (forward, right, down), yaw, pitch, roll in that order. ``exposure_s`` and ``latency_s``: how long one
    picture integrates, and from mid-exposure to delivery.
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
    distortion_model: DistortionModel = "plumb_bob"
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    exposure_s: float = 0.0
    latency_s: float = 0.02


class MarkerConfig(Struct, frozen=True, kw_only=True):
    """One light on the tanker. ``p_tanker_m`` in tanker body axes from its centre of mass."""

    id: int
    p_tanker_m: Vec3
    where: str = ""


class CornerPointConfig(Struct, frozen=True, kw_only=True):
    """One corner of the airframe. ``p_tanker_m`` in tanker body axes from its centre of mass."""

    id: int
    p_tanker_m: Vec3
    where: str = ""


class WindowConfig(Struct, frozen=True, kw_only=True):
    """Three-dimensional window of thesis Tab. 1.1: half-widths about box B, per axis of ``mrf``."""

    desired_m: Vec3 = (0.40, 1.87, 0.90)
    limit_m: Vec3 = (2.10, 2.10, 2.56)


class TankerConfig(Struct, frozen=True, kw_only=True):
    """What the companion must know of a tanker: lights, refuelling box, window; corners, to see it without lights."""

    name: str
    markers: tuple[MarkerConfig, ...]
    marker_radius_m: float
    box_tanker_m: Vec3
    boom: BoomConfig
    window: WindowConfig = WindowConfig()
    corners: tuple[CornerPointConfig, ...] = ()
    why: str = ""


class DetectionConfig(Struct, frozen=True, kw_only=True):
    """Marker detection (thesis 4.2.1): a pixel is lit when red exceeds the larger of green and blue by a threshold.

    ``threshold`` in steps of 1/255; with ``adaptive`` it is the least, and noise or a red picture raise it.
    ``reject_clutter`` leaves out what is no light: ``companion.vision.detection`` says what, and ``max_elongation`` is
    the length over width from which on a detection is a stripe. ``hot_pixels`` pairs of column and row that are dead.
    """

    threshold: int = 16
    adaptive: bool = True
    min_area_px: int = 1
    max_area_px: int = 4000
    morphology_px: int = 0
    max_detections: int = 64
    reject_clutter: bool = True
    max_elongation: float = 2.5
    hot_pixels: tuple[tuple[int, int], ...] = ()


class CornerConfig(Struct, frozen=True, kw_only=True):
    """Detection of the airframe's corners, without lights (thesis 1): Shi-Tomasi candidates, Förstner's point estimate.

    ``gate_px``: half-width of the windows about predicted corners that are looked through. ``min_gradient``: change in
    every direction that makes a candidate, in steps of 1/255 per px: just above the sensor's noise, so that dusk and
    haze keep theirs. ``apart_px``: least distance of two candidates. ``radius_px``: how far about one its edges are
    measured. ``max_detections``: the strongest of all windows; the search of the labeling takes longer for more.
    ``sigma_floor_px``: what the airframe's roundness and shading add to the noise, per axis.
    ``min_agree`` labels at least: shapes repeat on an airframe, and five of them agree on a wrong place now and then.
    """

    gate_px: float = 24.0
    min_gradient: float = 2.0
    apart_px: int = 3
    radius_px: int = 4
    max_per_window: int = 6
    max_detections: int = 40
    sigma_floor_px: float = 0.4
    min_agree: int = 6


class LabelingConfig(Struct, frozen=True, kw_only=True):
    """Which detection is which marker: the thesis' mutual nearest neighbour (4.2.4), or labels that are verified.

    ``max_distance_px`` bounds a pair of mutual nearest neighbours. The rest is for ``robust``:

    ``prior_sigma_m`` and ``prior_sigma_rad``: standard deviation per axis of the prior's translation and rotation;
    ``tracked_sigma_m``, ``tracked_sigma_rad`` and ``min_agree_tracked`` labels at least while the prior rests on a
    vision just passed: where attitude and camera's place are worse than that, few lights are not enough.
    ``gross_probability``: how often the prior's translation is not that good; it is then within ``gross_sigma_m``.
    ``map_sigma_m``: how well the markers' places on the tanker are known, per axis (beside ``vision.sigma_px``).
    ``detection_probability``: that of a marker being detected; ``false_density``: false detections to reckon with per
    unit of area on the plane z = 1, where a picture 70 degrees wide has 1.5.
    ``gate_sigma``: a label fits within so many sigmas of where the others put it; ``min_label_odds``: log of how much
    likelier than a false detection in its place; ``min_rival_odds``: log of how much likelier than any other detection.
    ``min_agree`` labels at least; ``min_score``: log of how much likelier than chance they are; ``min_margin``: log of
    how much likelier than any that contradict them. ``max_range_m``: no marker is looked for farther away.
    ``min_agree_blind``: labels at least when neither position nor attitude is known. ``sure_agree``: so many labels at
    the prior need no search for others, zero for never; for detectors that give many candidates near the prior only.
    """

    method: Literal["mutual_nearest", "robust"] = "robust"
    max_distance_px: float = 40.0
    prior_sigma_m: float = 1.0
    prior_sigma_rad: float = 0.02
    tracked_sigma_m: float = 0.3
    tracked_sigma_rad: float = 0.005
    min_agree_tracked: int = 2
    gross_probability: float = 0.01
    gross_sigma_m: float = 3.0
    map_sigma_m: float = 0.01
    detection_probability: float = 0.7
    false_density: float = 20.0
    gate_sigma: float = 5.0
    min_label_odds: float = 5.0
    min_rival_odds: float = 8.0
    min_agree: int = 4
    min_score: float = 10.0
    min_margin: float = 8.0
    max_range_m: float = 150.0
    min_agree_blind: int = 6
    sure_agree: int = 0


class VisionConfig(Struct, frozen=True, kw_only=True):
    """Detection, labeling and pose. ``mode`` rv uses the picture, sv the projected markers (thesis 4.2.5).

    ``detector``: whether the tanker's lights are looked for, or the corners of its airframe (thesis 1).

    ``refine`` follows the solver by maximum likelihood (``companion.vision.refinement``) and gives a covariance, for
    centroids of ``sigma_px`` standard deviation per axis: a floor that has calibration and marker map in it too (a
    marker 1 cm off its place is 0.2 px at 23 m). ``ins_attitude``: whether the relative attitude of the two INS, known
    to ``ins_sigma_rad`` per axis, is a measurement in it never, with fewer than ``min_markers`` or always; it takes
    ``min_markers_ins`` markers then. A pose is rejected when its position is known worse than ``max_sigma_m`` or its
    attitude than ``max_sigma_rad``, or when markers fit it worse than noise makes them with ``residual_probability``.
    """

    detector: Literal["lights", "corners"] = "lights"
    solver: Literal["lhm", "glsdc"] = "lhm"
    mode: Literal["rv", "sv"] = "rv"
    method: Literal["svd", "quaternion"] = "svd"
    tol: float = 1e-5
    epsilon: float = 1e-8
    glsdc_iterations: int = 4
    min_markers: int = 5
    max_image_error_px: float = 3.0
    refine: bool = True
    sigma_px: float = 0.3
    ins_attitude: Literal["never", "few", "always"] = "few"
    ins_sigma_rad: float = 0.01
    min_markers_ins: int = 2
    max_sigma_m: float = 1.0
    max_sigma_rad: float = 0.1
    residual_probability: float = 1e-6
    detection: DetectionConfig = DetectionConfig()
    labeling: LabelingConfig = LabelingConfig()
    corners: CornerConfig = CornerConfig()


def landmarks(tanker: TankerConfig, vision: VisionConfig) -> tuple[MarkerConfig | CornerPointConfig, ...]:
    """Return the places on the tanker that the vision looks for: its lights, or the corners of its airframe."""
    return tanker.corners if vision.detector == "corners" else tanker.markers


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
    """How the autopilot follows attitude and thrust: second-order roll and pitch, first-order thrust, delay.

    ``pitch_sink_m``: downward acceleration (m/s2) for a pitch acceleration of 1 rad/s2: flaps that lift the nose push
    a tailless aircraft down.
    """

    roll_rad_s: float
    roll_damping: float
    pitch_rad_s: float
    pitch_damping: float
    thrust_lag_s: float
    delay_s: float
    pitch_sink_m: float = 0.0


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
    integrity: IntegrityConfig = IntegrityConfig()
    guidance: GuidanceConfig = GuidanceConfig()
    recorder: RecorderConfig = RecorderConfig()


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """A companion configuration with its files loaded."""

    config: CompanionConfig
    camera: CameraConfig
    tanker: TankerConfig
    airframe: AirframeConfig
