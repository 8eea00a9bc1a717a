"""What has to hold of a configuration whose types are right, and what to say when it does not."""

from __future__ import annotations

import itertools
import math

import numpy as np

from companion.config.base import Rules
from companion.config.boom import boom_rules
from companion.config.estimation import fusion_rules, integrity_rules
from companion.config.guidance import guidance_rules
from companion.config.structures import (
    AirframeConfig,
    CameraConfig,
    CompanionConfig,
    CornerConfig,
    LabelingConfig,
    TankerConfig,
    landmarks,
)


def enough_markers(c: CompanionConfig, t: TankerConfig) -> tuple[bool, str]:
    """Return that the tanker has as many lights, or corners, as a pose is asked to have."""
    most, there = max(c.vision.min_markers, c.fusion.min_markers), len(landmarks(t, c.vision))
    what = "corners" if c.vision.detector == "corners" else "markers"
    return most <= there, f"min_markers {most}, and the tanker has {there} {what}"


def enough_detections(c: CompanionConfig, t: TankerConfig) -> tuple[bool, str]:
    """Return that every light of the tanker may be detected."""
    most, n = c.vision.detection.max_detections, len(t.markers)
    return n <= most, f"vision.detection.max_detections {most}, and the tanker has {n} markers"


COEFFICIENTS = {
    "plumb_bob": "5 numbers (k1, k2, p1, p2, k3)",
    "rational_polynomial": "8 numbers (k1, k2, p1, p2, k3, k4, k5, k6)",
    "equidistant": "4 numbers (k1, k2, k3, k4)",
}
"""What ``distortion`` holds for each ``distortion_model``."""


def camera_rules(c: CameraConfig) -> Rules:
    """Return what has to hold of a camera."""
    turns = max(abs(c.mount_yaw_rad), abs(c.mount_pitch_rad), abs(c.mount_roll_rad))
    wanted = COEFFICIENTS[c.distortion_model]
    return [
        (c.width_px >= 16 and c.height_px >= 16, "width_px and height_px must be at least 16"),
        (c.fx_px > 0 and c.fy_px > 0, "fx_px and fy_px must be positive"),
        (0 < c.rate_hz <= 1000, "rate_hz must be in 0..1000 hertz"),
        (c.latency_s >= 0 and c.exposure_s >= 0, "latency_s and exposure_s must not be negative"),
        (c.exposure_s * c.rate_hz <= 1.0, "exposure_s must not be longer than from picture to picture, 1 / rate_hz"),
        (all(abs(k) <= 1e3 for k in c.distortion), "distortion must be coefficients within 1000"),
        (len(c.distortion) == int(wanted[0]),
         f"distortion of {c.distortion_model} must be {wanted}, not {len(c.distortion)}"),
        (turns <= math.pi, "mount_yaw_rad, mount_pitch_rad, mount_roll_rad must be within pi (radians, not degrees)"),
    ]


FARTHEST_M = 500.0
"""Farther from the centre of mass no marker can be."""


def nearest_markers(t: TankerConfig) -> tuple[float, str]:
    """Return the least distance in m between two markers, and which two they are."""
    pairs = [
        (math.dist(a.p_tanker_m, b.p_tanker_m), f"{a.id} and {b.id}") for a, b in itertools.combinations(t.markers, 2)
    ]
    return min(pairs, default=(math.inf, ""))


def width_off_a_line_m(t: TankerConfig) -> float:
    """Return how far, root mean square, the markers are from the line that fits them best."""
    p = np.array([m.p_tanker_m for m in t.markers], dtype=np.float64).reshape(-1, 3).clip(-FARTHEST_M, FARTHEST_M)
    if len(p) < 2:
        return 0.0
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    return float(np.sqrt(np.sum(spread[1:] ** 2) / len(p)))


def tanker_rules(t: TankerConfig) -> Rules:
    """Return what has to hold of a tanker.

    Markers that all lie in one plane are let through: they fix a pose, though a second one fits nearly as well from
    far away, and choosing between the two is the vision chain's task.
    """
    nearest_m, which = nearest_markers(t)
    far = max((abs(v) for m in t.markers for v in m.p_tanker_m), default=0.0)
    window = all(0 < d <= m for d, m in zip(t.window.desired_m, t.window.limit_m, strict=True))
    return [
        (len(t.markers) >= 4, "at least 4 markers are needed for a pose"),
        (len({m.id for m in t.markers}) == len(t.markers), "two markers have the same id"),
        (t.marker_radius_m > 0, "marker_radius_m must be positive"),
        (far <= FARTHEST_M, f"p_tanker_m must be within {FARTHEST_M:.0f} m (metres, not millimetres)"),
        (nearest_m > 2 * t.marker_radius_m,
         f"markers {which} are {nearest_m:.2f} m apart and run into one light; keep two radii between p_tanker_m"),
        (width_off_a_line_m(t) > t.marker_radius_m,
         "all markers lie on one line, about which no pose is fixed; move one away from it"),
        (window, "window.desired_m must be positive and lie inside window.limit_m"),
        (len(t.corners) == 0 or len(t.corners) >= 5, "corners: at least 5 are needed for a pose, or none"),
        (len({c.id for c in t.corners}) == len(t.corners), "two corners have the same id"),
        (all(abs(v) <= FARTHEST_M for c in t.corners for v in c.p_tanker_m),
         f"corners: p_tanker_m must be within {FARTHEST_M:.0f} m (metres, not millimetres)"),
        *boom_rules(t.boom),
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


def corner_rules(c: CornerConfig) -> Rules:
    """Return what has to hold of the detection of corners."""
    return [
        (c.gate_px > 0, "vision.corners.gate_px must be positive pixels"),
        (0 < c.min_gradient < 256, "vision.corners.min_gradient must be in 0..255 steps per pixel"),
        (1 <= c.apart_px <= 50, "vision.corners.apart_px must be in 1..50 pixels"),
        (2 <= c.radius_px <= 20, "vision.corners.radius_px must be in 2..20 pixels"),
        (c.max_per_window >= 1, "vision.corners.max_per_window must be at least 1"),
        (c.max_detections >= 5, "vision.corners.max_detections must be at least 5"),
        (c.sigma_floor_px >= 0, "vision.corners.sigma_floor_px must not be negative"),
    ]


def labeling_rules(c: LabelingConfig) -> Rules:
    """Return what has to hold of the labeling."""
    shares = (c.gross_probability, c.detection_probability)
    return [
        (c.max_distance_px > 0, "vision.labeling.max_distance_px must be positive pixels"),
        (min(c.prior_sigma_m, c.prior_sigma_rad, c.tracked_sigma_m, c.tracked_sigma_rad) > 0,
         "vision.labeling: prior_sigma_m and _rad, tracked_sigma_m and _rad must be positive metres and radians"),
        (c.sure_agree >= 0, "vision.labeling.sure_agree must not be negative"),
        (c.min_agree_tracked >= 2, "vision.labeling.min_agree_tracked must be at least 2"),
        (c.gross_sigma_m > 0 and c.map_sigma_m >= 0,
         "vision.labeling: gross_sigma_m must be positive and map_sigma_m not negative, in metres"),
        (all(0 < share < 1 for share in shares),
         "vision.labeling: gross_probability and detection_probability must lie between 0 and 1"),
        (c.false_density > 0, "vision.labeling.false_density must be positive"),
        (2 <= c.gate_sigma <= 10, "vision.labeling.gate_sigma must be in 2..10"),
        (min(c.min_label_odds, c.min_rival_odds, c.min_score, c.min_margin) > 0,
         "vision.labeling: min_label_odds, min_rival_odds, min_score and min_margin must be positive"),
        (c.min_agree >= 3, "vision.labeling.min_agree must be at least 3"),
        (c.min_agree_blind >= 5, "vision.labeling.min_agree_blind must be at least 5"),
        (c.max_range_m > 0, "vision.labeling.max_range_m must be positive metres"),
    ]


def companion_rules(c: CompanionConfig) -> Rules:
    """Return what has to hold of the companion's own values."""
    links = c.links
    ids = (links.system_id, links.component_id, links.autopilot_component_id, links.gcs_system_id)
    return [
        *fusion_rules(c.fusion),
        *integrity_rules(c.integrity),
        *guidance_rules(c.guidance),
        *corner_rules(c.vision.corners),
        (c.vision.min_markers >= 4, "vision.min_markers must be at least 4"),
        (c.vision.tol > 0 and c.vision.epsilon > 0, "vision: tol and epsilon must be positive"),
        (c.vision.max_image_error_px > 0, "vision.max_image_error_px must be positive pixels"),
        (min(c.vision.sigma_px, c.vision.ins_sigma_rad, c.vision.max_sigma_m, c.vision.max_sigma_rad) > 0,
         "vision: sigma_px, ins_sigma_rad, max_sigma_m, max_sigma_rad must be positive pixels, radians and metres"),
        (2 <= c.vision.min_markers_ins <= c.vision.min_markers,
         "vision.min_markers_ins must be at least 2 and no more than vision.min_markers"),
        (0 < c.vision.residual_probability < 0.5, "vision.residual_probability must be in 0..0.5"),
        *labeling_rules(c.vision.labeling),
        (c.vision.glsdc_iterations >= 1, "vision.glsdc_iterations must be at least 1"),
        (c.vision.detection.morphology_px >= 0, "vision.detection.morphology_px must not be negative"),
        (c.vision.detection.max_detections >= 4, "vision.detection.max_detections must be at least 4"),
        (0 < c.vision.detection.threshold < 256, "vision.detection.threshold must be in 1..255"),
        (1 <= c.vision.detection.min_area_px <= c.vision.detection.max_area_px,
         "vision.detection.min_area_px must be in 1..max_area_px pixels"),
        (c.vision.detection.max_elongation > 1.5, "vision.detection.max_elongation must be more than 1.5"),
        (all(min(place) >= 0 for place in c.vision.detection.hot_pixels),
         "vision.detection.hot_pixels: columns and rows must not be negative"),
        (all(1 <= i <= 255 for i in ids), "links: system and component ids must be in 1..255"),
        (c.recorder.image_rate_hz >= 0, "recorder.image_rate_hz must not be negative"),
        (1 <= c.recorder.jpeg_quality <= 100, "recorder.jpeg_quality must be in 1..100"),
    ]
