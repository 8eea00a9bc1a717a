"""Configuration of a tanker's boom: how it is made, what moves it, where it may refuel."""

from __future__ import annotations

import math

from companion.config.base import Rules, Struct, Vec3


class BoomTubes(Struct, frozen=True, kw_only=True):
    """The outer tube of a boom, from its pivot, and the inner one that telescopes out of it.

    ``outer_com_m`` from the pivot, ``inner_com_m`` from the nozzle. ``cross_drag``: drag of a metre of tube across the
    flow over dynamic pressure and diameter; ``skin_friction`` over wetted area, along it.
    """

    outer_length_m: float = 8.5
    outer_diameter_m: float = 0.58
    outer_mass_kg: float = 500.0
    outer_com_m: float = 4.4
    inner_length_m: float = 8.0
    inner_diameter_m: float = 0.23
    inner_mass_kg: float = 250.0
    inner_com_m: float = 3.8
    cross_drag: float = 0.4
    skin_friction: float = 0.004


class Ruddevators(Struct, frozen=True, kw_only=True):
    """The two control surfaces of a boom's V-tail; ``area_m2`` of one, ``at_m`` from the pivot, lift per rad.

    Without deflection they make no lift at the boom's nominal elevation in level flow.
    """

    area_m2: float = 2.2
    at_m: float = 5.7
    dihedral_rad: float = math.radians(42.0)
    lift_slope: float = 3.0
    max_lift: float = 1.0
    drag: float = 0.015
    induced_drag: float = 0.18
    limit_rad: float = math.radians(25.0)
    rate_rad_s: float = math.radians(60.0)
    lag_s: float = 0.05


class BoomDrive(Struct, frozen=True, kw_only=True):
    """The drive of the telescope, and what the joints rub: ``friction_n`` dry, ``hinge_n_m_s`` per rad/s."""

    force_n: float = 10_000.0
    rate_m_s: float = 1.0
    friction_n: float = 300.0
    hinge_n_m_s: float = 500.0


class BoomEnvelope(Struct, frozen=True, kw_only=True):
    """Where a boom may refuel, beyond which it disconnects, and where its stops are; ``extension`` of the telescope."""

    elevation_rad: tuple[float, float] = (math.radians(20.0), math.radians(40.0))
    azimuth_rad: float = math.radians(10.0)
    extension_m: tuple[float, float] = (1.8, 5.5)
    stop_elevation_rad: tuple[float, float] = (math.radians(10.0), math.radians(50.0))
    stop_azimuth_rad: float = math.radians(15.0)
    stop_extension_m: float = 6.1


class NozzleConfig(Struct, frozen=True, kw_only=True):
    """When the nozzle latches, how stiffly it sits in the receptacle, and at what load it is torn out."""

    capture_m: float = 0.15
    capture_speed_m_s: float = 1.0
    stiffness_n_m: float = 150_000.0
    damping_n_s_m: float = 7_500.0
    break_load_n: float = 30_000.0


class BoomConfig(Struct, frozen=True, kw_only=True):
    """Where the boom hangs: pivot in tanker axes, nominal angles and length; how it is made.

    ``ready_length_m``: pivot to nozzle while the operator keeps it clear of a receiver.
    """

    pivot_tanker_m: Vec3
    elevation_rad: float = math.radians(30.0)
    azimuth_rad: float = 0.0
    length_m: float = 11.5
    ready_length_m: float = 10.3
    tubes: BoomTubes = BoomTubes()
    ruddevators: Ruddevators = Ruddevators()
    drive: BoomDrive = BoomDrive()
    envelope: BoomEnvelope = BoomEnvelope()
    nozzle: NozzleConfig = NozzleConfig()


def boom_rules(b: BoomConfig) -> Rules:
    """Return what has to hold of a boom."""
    t, v, e, n = b.tubes, b.ruddevators, b.envelope, b.nozzle
    longest_m = t.outer_length_m + e.stop_extension_m
    low, high = e.elevation_rad
    stop_low, stop_high = e.stop_elevation_rad
    drags = (t.cross_drag, t.skin_friction, v.drag, v.induced_drag, b.drive.friction_n, b.drive.hinge_n_m_s)
    return [
        (min(t.outer_mass_kg, t.inner_mass_kg) >= 10.0,
         "boom.tubes: outer_mass_kg and inner_mass_kg must be at least 10 kilograms"),
        (0 < t.outer_com_m < t.outer_length_m and 0 < t.inner_com_m < t.inner_length_m,
         "boom.tubes: outer_com_m and inner_com_m must lie within outer_length_m and inner_length_m"),
        (0 < t.inner_diameter_m <= t.outer_diameter_m <= 2.0,
         "boom.tubes: inner_diameter_m must be positive and at most outer_diameter_m, that at most 2 metres"),
        (min(drags) >= 0, "boom: drag and friction must not be negative"),
        (0 < v.at_m <= t.outer_length_m, "boom.ruddevators.at_m must be in 0..outer_length_m metres"),
        (min(v.area_m2, v.lift_slope, v.max_lift, v.rate_rad_s, v.lag_s) > 0,
         "boom.ruddevators: area_m2, lift_slope, max_lift, rate_rad_s and lag_s must be positive"),
        (0 < v.dihedral_rad < math.pi / 2 and 0 < v.limit_rad < math.pi / 4,
         "boom.ruddevators: dihedral_rad must be in 0..pi / 2 and limit_rad in 0..pi / 4 (radians, not degrees)"),
        (min(b.drive.force_n, b.drive.rate_m_s) > 0, "boom.drive: force_n and rate_m_s must be positive"),
        (0 < stop_low < low < high < stop_high < math.pi / 2,
         "boom.envelope: elevation_rad must rise and lie inside stop_elevation_rad, that in 0..pi / 2"),
        (0 < e.azimuth_rad < e.stop_azimuth_rad < math.pi / 2,
         "boom.envelope: azimuth_rad must be positive and inside stop_azimuth_rad (radians, not degrees)"),
        (0 <= e.extension_m[0] < e.extension_m[1] <= e.stop_extension_m,
         "boom.envelope: extension_m must rise and lie in 0..stop_extension_m"),
        (e.stop_extension_m < t.inner_length_m,
         "boom.envelope.stop_extension_m must be less than tubes.inner_length_m, or the telescope falls out"),
        (stop_low < b.elevation_rad < stop_high and abs(b.azimuth_rad) < e.stop_azimuth_rad,
         "boom: elevation_rad and azimuth_rad must lie inside the stops of boom.envelope (radians, not degrees)"),
        (t.outer_length_m <= min(b.length_m, b.ready_length_m) and max(b.length_m, b.ready_length_m) <= longest_m,
         f"boom: length_m and ready_length_m must be in {t.outer_length_m:g}..{longest_m:g} metres, as its tubes are"),
        (min(n.capture_m, n.capture_speed_m_s, n.break_load_n) > 0,
         "boom.nozzle: capture_m, capture_speed_m_s and break_load_n must be positive"),
        (0 < n.stiffness_n_m <= 1e6 and 0 <= n.damping_n_s_m <= 2e4,
         "boom.nozzle: stiffness_n_m must be in 0..1e6 and damping_n_s_m in 0..2e4, or 5 ms steps cannot follow"),
    ]
