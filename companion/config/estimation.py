"""Configuration of fusion and integrity, and what has to hold of it."""

from __future__ import annotations

from typing import Literal

from companion.config.base import Rules, Struct, Vec3


class FilterConfig(Struct, frozen=True, kw_only=True):
    """The filter of relative position, velocity and attitude: noise of what comes in, spread of what it estimates.

    GPS, velocity, attitude and rate sigmas are of one aircraft's noise, per axis; ``velocity_sigma_m_s`` across the
    path, ``speed_sigma_m_s`` along it, drawn anew every ``velocity_hold_s`` (thesis 3.2). ``stamp_sigma_s``: how wrong
    samples are stamped; the datalink's time is a float32. ``pixel_sigma_px`` is added to what the detection says of a
    centroid: calibration and light, as far as they change from frame to frame; ``position_walk``, m per root of a
    second, stands for what all centroids of a picture err together and slowly, which is along the path mostly.

    ``*_acceleration_m_s2`` along the path, to the right, down, and ``*_turn_rad_s2`` about the body's axes: what an
    aircraft does beyond what its last samples say, RMS. Measured in moderate turbulence, up to 0.6 s past the newest
    sample; it is half of that in light.

    ``*_initial_*``: standard deviation of the correction at the start, ``*_walk``: its growth per root of a second.
    The GPS bias is a Gauss-Markov process of ``gps_bias_sigma_m`` and ``gps_bias_s``: it walks as one of 1 m and 60 s
    does (0.18 m per root of a second) and lets another height datum in at the start. ``gate_probability``: how often a
    good measurement is refused. ``horizon_s``: how late a measurement may come. A source that has been refused for
    ``refused_s`` and agrees with itself is believed again; labelled lights so only within ``vision_leads_m`` of the
    tanker. ``sight_lasts_s``: how long after the last sight single detections may be told apart by the filter.
    """

    gps_sigma_m: float = 0.1
    velocity_sigma_m_s: float = 0.041
    speed_sigma_m_s: float = 0.0014
    velocity_hold_s: float = 0.05
    stamp_sigma_s: float = 4.4e-6
    attitude_sigma_rad: float = 1.4e-4
    rate_sigma_rad_s: float = 4.5e-4
    own_acceleration_m_s2: Vec3 = (0.25, 0.4, 1.6)
    tanker_acceleration_m_s2: Vec3 = (0.03, 0.15, 0.6)
    own_turn_rad_s2: Vec3 = (1.3, 0.22, 0.06)
    tanker_turn_rad_s2: Vec3 = (0.025, 0.01, 0.01)
    pixel_sigma_px: float = 0.006
    position_walk: float = 0.0025
    velocity_initial_m_s: float = 0.1
    velocity_walk: float = 0.01
    attitude_initial_rad: float = 0.002
    attitude_walk: float = 5e-5
    gps_bias_sigma_m: float = 3.0
    gps_bias_s: float = 540.0
    boresight_initial_rad: float = 0.005
    boresight_walk: float = 1e-6
    lag_initial_s: float = 0.002
    lag_walk: float = 1e-6
    gate_probability: float = 1e-5
    horizon_s: float = 1.5
    refused_s: float = 0.7
    vision_leads_m: float = 40.0
    sight_lasts_s: float = 2.0


class FusionConfig(Struct, frozen=True, kw_only=True):
    """Fusion of GPS and vision: ``filter``, or the thesis' ``blend`` (eq. 3.9).

    The blend is all GPS beyond ``d1_m``, all vision within ``d2_m``; a pose counts in it from ``min_markers`` markers:
    five in the thesis; here the vision itself says when it has a pose. An estimate rests on vision for
    ``vision_stale_s`` after the last pose; ``own_stale_s`` and ``tanker_stale_s``: how old the newest sample of either
    aircraft may be.
    """

    method: Literal["filter", "blend"] = "filter"
    d1_m: float = 55.0
    d2_m: float = 40.0
    min_markers: int = 2
    vision_stale_s: float = 0.3
    own_stale_s: float = 0.3
    tanker_stale_s: float = 1.0
    filter: FilterConfig = FilterConfig()


class IntegrityConfig(Struct, frozen=True, kw_only=True):
    """What is asked of the estimate before the receiver may close in (``companion.estimation.integrity``).

    ``risk``: probability per axis that an error beyond the protection level stays unseen, of which half is that of
    faults, each as likely as ``fault_probability``; ``false_alarm``: that of one test failing without a fault.
    ``alert_growth``: metres by which the alert limit is wider for each metre from the box.
    ``sigma_px`` and ``map_sigma_m``: what calibration, light and survey leave of a marker's place, per axis; that does
    not average out. ``boresight_rad``: camera against INS from which on the mount is wrong; ``gps_own_m``: what two
    good GPS err against each other for minutes, per axis. ``window_s``: over which slow faults are averaged;
    ``stale_s``: how old the last sight may be. ``agreed_s``: after so long an agreement a GPS that leaves the vision is
    the one that is wrong.
    """

    risk: float = 1e-7
    fault_probability: float = 1e-3
    false_alarm: float = 1e-5
    alert_growth: float = 0.04
    sigma_px: float = 0.07
    map_sigma_m: float = 0.005
    boresight_rad: float = 0.008
    gps_own_m: float = 0.9
    window_s: float = 2.0
    stale_s: float = 0.4
    agreed_s: float = 10.0


def fusion_rules(fusion: FusionConfig) -> Rules:
    """Return what has to hold of the fusion."""
    return [
        (fusion.d1_m > fusion.d2_m > 0, "fusion: d1_m must be larger than d2_m, both in metres"),
        (fusion.min_markers >= 2, "fusion.min_markers must be at least 2"),
        (min(fusion.vision_stale_s, fusion.own_stale_s, fusion.tanker_stale_s) > 0,
         "fusion: vision_stale_s, own_stale_s and tanker_stale_s must be positive seconds"),
        *filter_rules(fusion.filter),
    ]


def filter_rules(c: FilterConfig) -> Rules:
    """Return what has to hold of the filter."""
    unforeseen = ("own_acceleration_m_s2", "tanker_acceleration_m_s2", "own_turn_rad_s2", "tanker_turn_rad_s2")
    spreads = ("position_walk", "stamp_sigma_s", "rate_sigma_rad_s", "velocity_initial_m_s", "velocity_walk",
               "attitude_initial_rad", "attitude_walk", "gps_bias_sigma_m", "boresight_initial_rad", "boresight_walk",
               "lag_initial_s", "lag_walk")
    return [
        (min(c.gps_sigma_m, c.velocity_sigma_m_s, c.speed_sigma_m_s, c.attitude_sigma_rad, c.pixel_sigma_px) > 0,
         "fusion.filter: gps_sigma_m, velocity_sigma_m_s, speed_sigma_m_s, attitude_sigma_rad and pixel_sigma_px "
         "must be positive"),
        *((min(getattr(c, name)) >= 0, f"fusion.filter.{name} must not have negative parts") for name in unforeseen),
        *((getattr(c, name) >= 0, f"fusion.filter.{name} must not be negative") for name in spreads),
        (max(c.attitude_initial_rad, c.boresight_initial_rad) < 0.2,
         "fusion.filter: attitude_initial_rad and boresight_initial_rad must be below 0.2 rad: they are corrections"),
        (c.gps_bias_s > 0 and c.velocity_hold_s > 0 and c.refused_s > 0 and c.sight_lasts_s > 0,
         "fusion.filter: gps_bias_s, velocity_hold_s, refused_s and sight_lasts_s must be positive seconds"),
        (0.2 <= c.horizon_s <= 2.5, "fusion.filter.horizon_s must be in 0.2..2.5 seconds: samples are kept for three"),
        (0 < c.gate_probability < 0.1, "fusion.filter.gate_probability must be in 0..0.1"),
        (c.vision_leads_m > 0, "fusion.filter.vision_leads_m must be positive metres"),
    ]


def integrity_rules(c: IntegrityConfig) -> Rules:
    """Return what has to hold of the integrity."""
    return [
        (0 < c.risk < 0.1, "integrity.risk must be in 0..0.1"),
        (c.risk < c.fault_probability <= 1, "integrity.fault_probability must be in risk..1"),
        (0 < c.false_alarm < 0.1, "integrity.false_alarm must be in 0..0.1"),
        (0 <= c.alert_growth <= 1, "integrity.alert_growth must be in 0..1"),
        (0 < c.sigma_px <= 20, "integrity.sigma_px must be in 0..20 pixels"),
        (0 <= c.map_sigma_m <= 1, "integrity.map_sigma_m must be in 0..1 metres"),
        (0 < c.boresight_rad <= 0.2, "integrity.boresight_rad must be in 0..0.2 (radians, not degrees)"),
        (0 < c.gps_own_m <= 100, "integrity.gps_own_m must be in 0..100 metres"),
        (0.1 <= c.window_s <= 60, "integrity.window_s must be in 0.1..60 seconds"),
        (0 < c.stale_s <= 5, "integrity.stale_s must be in 0..5 seconds"),
        (0 < c.agreed_s <= 600, "integrity.agreed_s must be in 0..600 seconds"),
    ]
