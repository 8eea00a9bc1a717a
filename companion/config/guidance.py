"""Configuration of path, laws, phases and guard, and what has to hold of it."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from companion.config.base import Rules, Struct, Vec3


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
    roll: float = 60.0
    pitch: float = 400.0
    thrust: float = 2.0


class VelocityGains(Struct, frozen=True, kw_only=True):
    """Law ``velocity``: speed for an error of a metre, and for a metre second of its integral, along, right, down."""

    position_per_s: Vec3 = (0.6, 0.8, 0.8)
    integral_per_s2: Vec3 = (0.02, 0.02, 0.02)


class GuidanceConfig(Struct, frozen=True, kw_only=True):
    """Path, law and phases. ``link_delay_s``: from a state's instant to its setpoint's arrival at the autopilot.

    ``disturbance_rad_s``: bandwidth of the observer of gusts, wake and trim errors, forward, right, down
    (``companion.guidance.disturbance``).
    """

    law: Literal["attitude", "velocity", "surfaces"] = "attitude"
    rate_hz: float = 50.0
    weights: LawWeights = LawWeights()
    velocity: VelocityGains = VelocityGains()
    link_delay_s: float = 0.0
    disturbance_rad_s: Vec3 = (2.0, 3.0, 3.0)
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


def guidance_rules(g: GuidanceConfig) -> Rules:
    """Return what has to hold of the guidance."""
    return [
        (10 <= g.rate_hz <= 200, "guidance.rate_hz must be in 10..200 hertz"),
        (g.path_duration_s > 0, "guidance.path_duration_s must be positive seconds"),
        (g.max_closure_m_s > 0, "guidance.max_closure_m_s must be positive metres per second"),
        (min(g.join_range_m, g.off_path_m, g.breakaway_separation_m) > 0,
         "guidance: join_range_m, off_path_m and breakaway_separation_m must be positive metres"),
        (min(msgspec.structs.astuple(g.weights)) >= 0, "guidance.weights must not be negative"),
        (min(g.weights.roll, g.weights.pitch, g.weights.thrust) > 0,
         "guidance.weights: roll, pitch and thrust must be positive"),
        (0 < g.estimate_stale_s <= 1, "guidance.estimate_stale_s must be in 0..1 seconds"),
        (g.estimate_stale_s <= g.breakaway_stale_s <= 10,
         "guidance.breakaway_stale_s must be in estimate_stale_s..10 seconds"),
        (0 < g.max_roll_rad < math.pi / 2, "guidance.max_roll_rad must be in 0..pi / 2 (radians, not degrees)"),
        (0 < g.max_pitch_offset_rad < math.pi / 4,
         "guidance.max_pitch_offset_rad must be in 0..pi / 4 (radians, not degrees)"),
        (0 <= g.breakaway_thrust <= 1, "guidance.breakaway_thrust must be in 0..1"),
        (0 <= g.link_delay_s <= 1, "guidance.link_delay_s must be in 0..1 seconds"),
        (all(0 < w <= 20 for w in g.disturbance_rad_s),
         "guidance.disturbance_rad_s must be in 0..20 radians per second"),
        (min(*g.velocity.position_per_s, *g.velocity.integral_per_s2) >= 0, "guidance.velocity must not be negative"),
    ]
