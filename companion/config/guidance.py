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


class GuardConfig(Struct, frozen=True, kw_only=True):
    """What every setpoint is held to, and when the receiver breaks away (``companion.guidance.guard``, ``causes``).

    ``roll_rate_rad_s``, ``pitch_rate_rad_s``, ``thrust_rate_per_s``: how fast setpoints may change; in moderate
    turbulence the law asks for 2.7 and 0.9 at most, and for 2.1 in 99 steps of 100. Closing in:
    ``closure_m_s`` within ``closure_range_m`` of the box, and beyond what ``braking_m_s2`` takes away until there; a
    place to be at is at most ``offset_horizon_s`` of that farther in. The receiver itself is held to it forward;
    up and across gusts may add ``closure_gust_m_s``.

    The age from which a source counts as lost: ``heartbeat_lost_s`` (1 Hz), ``sight_lost_s`` (more than three pictures
    of 10 Hz in a row), ``datalink_stale_s``, ``attitude_stale_s``, ``position_stale_s``; ``estimate_lost_s``, and
    ``estimate_lost_far_s`` before pre-contact. Integrity has to fail for ``integrity_failed_s``; protection levels
    count within ``protection_range_m``. For ``lasting_s``: outside the limit window, closing in too fast, more than
    ``off_path_m`` from the path (``off_path_near_m`` within ``closure_range_m``), banked beyond ``max_bank_rad``,
    pitched off trim beyond ``max_pitch_off_trim_rad``; gusts and noise do that for moments.
    """

    roll_rate_rad_s: float = 3.0
    pitch_rate_rad_s: float = 1.0
    thrust_rate_per_s: float = 4.0
    closure_m_s: float = 1.0
    closure_range_m: float = 15.0
    braking_m_s2: float = 0.3
    closure_gust_m_s: float = 1.0
    offset_horizon_s: float = 4.0
    heartbeat_lost_s: float = 3.0
    sight_lost_s: float = 0.45
    datalink_stale_s: float = 0.4
    attitude_stale_s: float = 0.4
    position_stale_s: float = 0.4
    estimate_lost_s: float = 0.4
    estimate_lost_far_s: float = 1.0
    integrity_failed_s: float = 0.2
    protection_range_m: float = 10.0
    lasting_s: float = 0.2
    off_path_m: float = 10.0
    off_path_near_m: float = 5.0
    max_bank_rad: float = 0.6
    max_pitch_off_trim_rad: float = 0.25


class GuidanceConfig(Struct, frozen=True, kw_only=True):
    """Path, law and phases. ``link_delay_s``: from a state's instant to its setpoint's arrival at the autopilot.

    ``disturbance_rad_s``: bandwidth of the observer of gusts, wake and trim errors, forward, right, down
    (``companion.guidance.disturbance``).

    ``procedure``: a refuelling's phases with the operator's gates, or ``direct``, the thesis' one cubic of
    ``path_duration_s`` from where the join ended to the box (``companion.guidance.modes``). ``auto_gates`` passes the
    gates without an operator, as ``auto_engage`` engages. ``self_test``: see the autopilot follow a doublet first.
    ``pre_contact_m``: BR of the pre-contact point in ``mrf``, held within ``stabilise_tolerance_m`` for
    ``stabilise_s`` and with integrity for ``may_dock_s`` before the approach, which closes in with at most
    ``approach_closure_m_s``, and ``contact_closure_m_s`` over its last ``contact_near_m``; ``closure_m_s2`` between
    them: gusts add up to 0.4 m/s forward, and the guard breaks away at 1 m/s. The way to the pre-contact point peaks at
    ``max_closure_m_s`` and ``transit_m_s2``. ``retreat_s`` without integrity's leave, no fault seen, and an approach
    goes back to the pre-contact point; so it does when it has not held the box for ``capture_s`` within
    ``contact_timeout_s``.
    """

    procedure: Literal["refuelling", "direct"] = "refuelling"
    self_test: bool = True
    auto_gates: bool = False
    pre_contact_m: Vec3 = (-15.0, 0.0, 5.0)
    observation_s: float = 3.0
    stabilise_s: float = 3.0
    stabilise_tolerance_m: float = 1.0
    may_dock_s: float = 2.0
    retreat_s: float = 0.1
    approach_closure_m_s: float = 0.5
    contact_closure_m_s: float = 0.2
    contact_near_m: float = 3.0
    closure_m_s2: float = 0.2
    transit_m_s2: float = 0.4
    contact_timeout_s: float = 30.0
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
    join_range_m: float = 150.0
    max_closure_m_s: float = 2.0
    estimate_stale_s: float = 0.3
    capture_s: float = 2.0
    max_roll_rad: float = 0.35
    max_pitch_offset_rad: float = 0.12
    breakaway_descent_rad: float = 0.05
    breakaway_thrust: float = 0.05
    breakaway_separation_m: float = 60.0
    breakaway_level_s: float = 8.0
    guard: GuardConfig = GuardConfig()


REACTION_S = 0.5
"""A breakaway begins within so long of its cause; the heartbeat's limit is the cause."""


def guard_rules(g: GuardConfig, rate_hz: float) -> Rules:
    """Return what has to hold of the guard at a guidance rate, which is not 0."""
    ages = ("sight_lost_s", "datalink_stale_s", "attitude_stale_s", "position_stale_s", "estimate_lost_s")
    most = {"heartbeat_lost_s": 10.0, "estimate_lost_far_s": 10.0, "roll_rate_rad_s": 20.0, "pitch_rate_rad_s": 20.0,
            "thrust_rate_per_s": 50.0, "closure_m_s": 5.0, "closure_range_m": 100.0, "braking_m_s2": 5.0,
            "closure_gust_m_s": 5.0, "offset_horizon_s": 30.0, "protection_range_m": 100.0}
    longest_s = REACTION_S - 1.0 / rate_hz
    return [
        *((0 < getattr(g, name) <= longest_s,
           f"guidance.guard.{name} must be in 0..{longest_s:.3g} seconds: with a guidance step at most {REACTION_S} s")
          for name in ages),
        *((0 < getattr(g, name) <= largest, f"guidance.guard.{name} must be in 0..{largest:g}")
          for name, largest in most.items()),
        (min(g.integrity_failed_s, g.lasting_s) >= 0 and max(g.integrity_failed_s, g.lasting_s) <= longest_s,
         f"guidance.guard: integrity_failed_s and lasting_s must be in 0..{longest_s:.3g} seconds: with a guidance "
         f"step at most {REACTION_S} s"),
        (0 < g.off_path_near_m <= g.off_path_m <= 100,
         "guidance.guard.off_path_near_m must be positive metres, at most off_path_m, and that at most 100"),
        (0 < g.max_bank_rad < math.pi / 2 and 0 < g.max_pitch_off_trim_rad < math.pi / 2,
         "guidance.guard: max_bank_rad and max_pitch_off_trim_rad must be in 0..pi / 2 (radians, not degrees)"),
    ]


def breakaway_rules(g: GuidanceConfig) -> Rules:
    """Return what has to hold of the breakaway; ``thrust_rule`` knows the airframe too."""
    return [
        (0 < g.breakaway_level_s <= 60, "guidance.breakaway_level_s must be in 0..60 seconds"),
        (0 <= g.breakaway_thrust <= 1, "guidance.breakaway_thrust must be in 0..1"),
        (0 < g.breakaway_descent_rad <= min(0.2, g.max_pitch_offset_rad),
         "guidance.breakaway_descent_rad must be in 0..0.2 radians, and at most max_pitch_offset_rad"),
        (g.guard.closure_range_m <= g.breakaway_separation_m <= 1000,
         "guidance.breakaway_separation_m must be at least guard.closure_range_m, at most 1000 metres"),
    ]


def thrust_rule(g: GuidanceConfig, trim_throttle: float) -> tuple[bool, str]:
    """Return that a breakaway slows the receiver down: its thrust is clearly below that of level flight."""
    return (g.breakaway_thrust <= 0.8 * trim_throttle,
            f"guidance.breakaway_thrust must be at most 0.8 of the airframe's trim.throttle, {0.8 * trim_throttle:.3g}")


def guidance_rules(g: GuidanceConfig) -> Rules:
    """Return what has to hold of the guidance."""
    return [
        (10 <= g.rate_hz <= 200, "guidance.rate_hz must be in 10..200 hertz"),
        (0 < g.path_duration_s <= 3600, "guidance.path_duration_s must be in 0..3600 seconds"),
        (0 < g.max_closure_m_s <= 20, "guidance.max_closure_m_s must be in 0..20 metres per second"),
        (math.hypot(*g.pre_contact_m) > g.contact_near_m and g.pre_contact_m[0] < 0 <= g.pre_contact_m[2],
         "guidance.pre_contact_m must be aft of the box and not above it, more than contact_near_m away (metres)"),
        (all(s >= 0 for s in (g.join_settle_s, g.observation_s, g.stabilise_s, g.may_dock_s, g.retreat_s, g.capture_s)),
         "guidance: join_settle_s, observation_s, stabilise_s, may_dock_s, retreat_s and capture_s must not be "
         "negative seconds"),
        (g.contact_timeout_s > g.capture_s, "guidance.contact_timeout_s must be more than capture_s, both in seconds"),
        (all(0 < x <= 10 for x in (g.stabilise_tolerance_m, g.join_tolerance_m, g.contact_near_m, g.closure_m_s2,
                                   g.transit_m_s2)),
         "guidance: stabilise_tolerance_m, join_tolerance_m, contact_near_m, closure_m_s2 and transit_m_s2 must be in "
         "0..10"),
        (0 < g.contact_closure_m_s <= g.approach_closure_m_s <= g.max_closure_m_s,
         "guidance: contact_closure_m_s, approach_closure_m_s and max_closure_m_s must be positive, in rising order"),
        (g.approach_closure_m_s < g.guard.closure_m_s,
         "guidance.approach_closure_m_s must be below guard.closure_m_s, from which the receiver breaks away"),
        (0 < g.join_range_m <= 5000, "guidance.join_range_m must be in 0..5000 metres"),
        (min(msgspec.structs.astuple(g.weights)) >= 0, "guidance.weights must not be negative"),
        (min(g.weights.roll, g.weights.pitch, g.weights.thrust) > 0,
         "guidance.weights: roll, pitch and thrust must be positive"),
        (0 < g.estimate_stale_s <= 1, "guidance.estimate_stale_s must be in 0..1 seconds"),
        (0 < g.max_roll_rad < math.pi / 2, "guidance.max_roll_rad must be in 0..pi / 2 (radians, not degrees)"),
        (0 < g.max_pitch_offset_rad < math.pi / 4,
         "guidance.max_pitch_offset_rad must be in 0..pi / 4 (radians, not degrees)"),
        *guard_rules(g.guard, max(g.rate_hz, 10.0)),
        *breakaway_rules(g),
        (0 <= g.link_delay_s <= 1, "guidance.link_delay_s must be in 0..1 seconds"),
        (all(0 < w <= 20 for w in g.disturbance_rad_s),
         "guidance.disturbance_rad_s must be in 0..20 radians per second"),
        (min(*g.velocity.position_per_s, *g.velocity.integral_per_s2) >= 0, "guidance.velocity must not be negative"),
    ]
