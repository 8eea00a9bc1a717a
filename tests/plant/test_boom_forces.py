"""What air, stops and nozzle do to the boom, and its loops: signs, mirror, trim, margins."""

from __future__ import annotations

import math

import boom_bench as bench
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sim_bridge.plant.boom_dynamics import direction_of, jacobian_of
from sim_bridge.plant.boom_forces import (
    accelerations,
    crossflow,
    joint_forces,
    nozzle_force,
    ruddevator_forces,
    tube_forces,
)
from sim_bridge.plant.boom_motion import K_ANGLE, K_ANGLE_RATE, K_ANGLE_SUM, advance, carry, integrate, rotation
from sim_bridge.plant.boom_records import PRESCRIBED, SEEN, STATE, Record, parameters, record

PAR = parameters(bench.TANKER.boom, bench.TANKER.box_tanker_m)
RUDDEVATORS = bench.TANKER.boom.ruddevators
SPEEDS = (190.0, 205.7, 220.0)


def in_flow(air: tuple[float, float, float], right: float = 0.0, left: float = 0.0) -> Record:
    s = record(STATE)
    s["density"], s["right"], s["left"] = bench.DENSITY, right, left
    s["air_x"], s["air_y"], s["air_z"] = air
    return s


def aerodynamic(s: Record, elevation: float, azimuth: float, d6: float, rates: tuple[float, ...]) -> np.ndarray:
    """Return the three forces of the air, on theta4, theta5, d6."""
    theta4, theta5 = math.pi - elevation, azimuth - 0.5 * math.pi
    a, e = direction_of(theta4, theta5), jacobian_of(theta4, theta5)
    w = tuple(rates[0] * e[i] + rates[1] * e[3 + i] for i in range(3))
    surfaces = ruddevator_forces(PAR[0], s[0], *a, *e, *w)
    return np.add(tube_forces(PAR[0], s[0], *a, *e, *w, d6, rates[2]), (*surfaces, 0.0))


angles = st.tuples(st.floats(math.radians(15), math.radians(45)), st.floats(-0.2, 0.2))


@settings(max_examples=60)
@given(angles, st.floats(9.0, 14.0), st.tuples(*(st.floats(-1.0, 1.0),) * 3))
def test_still_air_only_takes_energy_from_a_moving_boom(
    at: tuple[float, float], d6: float, rates: tuple[float, float, float]
) -> None:
    """Tubes only: what the air does to them works against their motion."""
    s = in_flow((0.0, 0.0, 0.0))
    theta4, theta5 = math.pi - at[0], at[1] - 0.5 * math.pi
    e = jacobian_of(theta4, theta5)
    w = tuple(rates[0] * e[i] + rates[1] * e[3 + i] for i in range(3))
    forces = tube_forces(PAR[0], s[0], *direction_of(theta4, theta5), *e, *w, d6, rates[2])
    assert float(np.dot(forces, rates)) <= 0.0


@settings(max_examples=60)
@given(angles, st.floats(9.0, 14.0), st.floats(-20.0, 20.0), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_mirrored_air_and_surfaces_make_mirrored_forces(
    at: tuple[float, float], d6: float, side: float, right: float, left: float
) -> None:
    here = aerodynamic(in_flow((205.0, side, 9.0), right, left), at[0], at[1], d6, (0.1, 0.2, 0.3))
    there = aerodynamic(in_flow((205.0, -side, 9.0), left, right), at[0], -at[1], d6, (0.1, -0.2, 0.3))
    np.testing.assert_allclose(there, here * [1.0, -1.0, 1.0], rtol=1e-9, atol=1e-6)


def test_tube_in_even_flow_has_the_moment_of_its_drag_at_its_middle() -> None:
    """A still boom, no sideslip: across-flow drag of each tube times the arm of its middle."""
    e, d6, speed = math.radians(30), 12.1, bench.SPEED_M_S
    theta4, theta5 = math.pi - e, -0.5 * math.pi
    t = bench.TANKER.boom.tubes
    s = in_flow((speed, 0.0, 0.0))
    a, by = direction_of(theta4, theta5), jacobian_of(theta4, theta5)
    f4, f5, f6 = tube_forces(PAR[0], s[0], *a, *by, 0.0, 0.0, 0.0, d6, 0.0)
    pressure = 0.5 * bench.DENSITY * (speed * math.sin(e)) ** 2
    shown = d6 - t.outer_length_m
    outer = pressure * t.cross_drag * t.outer_diameter_m * t.outer_length_m * 0.5 * t.outer_length_m
    inner = pressure * t.cross_drag * t.inner_diameter_m * shown * (t.outer_length_m + 0.5 * shown)
    assert f4 == pytest.approx(outer + inner, rel=1e-9)
    assert f5 == pytest.approx(0.0, abs=1e-6)
    skin = 0.5 * bench.DENSITY * t.skin_friction * math.pi * t.inner_diameter_m * speed**2 * math.cos(e)
    assert f6 == pytest.approx(skin * shown, rel=1e-9)


def test_drag_of_a_tube_across_the_flow_is_that_of_a_cylinder() -> None:
    x, y, z, along = crossflow(0.66, 0.2, 0.01, 0.0, 0.0, 100.0, -1.0, 0.0, 0.0)
    assert (x, y, z) == pytest.approx((0.0, 0.0, 0.5 * 0.66 * 100.0**2 * 0.2))
    assert along == 0.0


def test_surfaces_alike_lift_the_boom_and_their_difference_moves_it_to_the_side() -> None:
    e = math.radians(30)
    none = aerodynamic(in_flow((205.7, 0.0, 0.0)), e, 0.0, 12.0, (0.0, 0.0, 0.0))
    up = aerodynamic(in_flow((205.7, 0.0, 0.0), 0.01, 0.01), e, 0.0, 12.0, (0.0, 0.0, 0.0)) - none
    right = aerodynamic(in_flow((205.7, 0.0, 0.0), -0.01, 0.01), e, 0.0, 12.0, (0.0, 0.0, 0.0)) - none
    pressure = 0.5 * bench.DENSITY * 205.7**2
    v = RUDDEVATORS
    most = 2 * pressure * v.area_m2 * v.lift_slope * v.at_m * 0.01
    assert 0.75 * most * math.cos(v.dihedral_rad) < up[0] < most * math.cos(v.dihedral_rad)
    assert 0.75 * most * math.sin(v.dihedral_rad) < right[1] < most * math.sin(v.dihedral_rad)
    assert abs(up[1]) < 1e-6
    assert abs(right[0]) < 0.1 * up[0]


@pytest.mark.parametrize("speed_m_s", SPEEDS)
def test_boom_hangs_near_30_degrees_with_little_deflection_and_settles_by_itself(speed_m_s: float) -> None:
    par, s = bench.settled(math.radians(30), 12.1, speed_m_s)
    assert abs(math.degrees(float(s["right"][0]))) < 6.0
    A, _ = bench.linearised(par, s)
    swing = A[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    values = np.linalg.eigvals(swing)
    assert values.real.max() < -0.1
    assert 2.0 < np.abs(values).min() <= np.abs(values).max() < 8.0


def loop(par: Record, s: Record, axis: int, w: np.ndarray) -> np.ndarray:
    """Return the loop's transfer over ``w`` (rad/s), broken at the actuator; a step of delay, half a step of hold."""
    A, B = bench.linearised(par, s)
    jw = 1j * w
    boom = B[3 + axis, axis] / (jw**2 - A[3 + axis, 3 + axis] * jw - A[3 + axis, axis])
    gain = bench.inertias(par, s)[axis] / bench.moments_per_rad(par, s)[axis]
    law = gain * (K_ANGLE + K_ANGLE_RATE * jw + K_ANGLE_SUM / jw) / (1.0 + RUDDEVATORS.lag_s * jw)
    return boom * law * np.exp(-1.5 * bench.DT_S * jw)


def margins(L: np.ndarray, w: np.ndarray) -> tuple[float, float, float]:
    """Return gain margin in dB, phase margin in degrees and the largest |S|."""
    crossing = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    phase = min(180.0 - abs(math.degrees(np.angle(L[i]))) for i in crossing)
    half_turn = np.flatnonzero((np.diff(np.sign(L.imag)) != 0) & (L.real[:-1] < 0))
    gain = min((-20 * math.log10(abs(L[i])) for i in half_turn), default=math.inf)
    return gain, phase, float(np.abs(1.0 / (1.0 + L)).max())


def test_loops_have_margins_at_every_speed_elevation_and_length() -> None:
    w = np.logspace(-2, 2, 3000)
    worst = np.array([math.inf, math.inf, 0.0])
    for speed in SPEEDS:
        for elevation in (20, 30, 40):
            for length in (8.6, 10.3, 12.1, 14.0):
                par, s = bench.settled(math.radians(elevation), length, speed)
                for axis in (0, 1):
                    gain, phase, peak = margins(loop(par, s, axis, w), w)
                    worst = np.array([min(worst[0], gain), min(worst[1], phase), max(worst[2], peak)])
    print(f"worst of 72: gain {worst[0]:.1f} dB, phase {worst[1]:.0f} degrees, |S| {worst[2]:.2f}")
    assert worst[0] > 12.0
    assert worst[1] > 45.0
    assert worst[2] < 1.6


@pytest.mark.parametrize("goal", [(12.0, 0.0, 12.0), (55.0, 0.0, 12.0), (30.0, 18.0, 12.0), (30.0, 0.0, 15.0)])
def test_stops_hold_against_loops_that_push(goal: tuple[float, float, float]) -> None:
    par, s, seen = PAR, record(STATE), record(SEEN)
    s["theta4"], s["theta5"], s["d6"] = math.pi - 0.5, -0.5 * math.pi, 12.0
    given_ = bench.given_for(math.radians(goal[0]), goal[2], bench.SPEED_M_S)
    given_["azimuth"] = math.radians(goal[1])
    for _ in range(4000):
        assert advance(par, given_, s, seen, bench.DT_S)
        e = bench.TANKER.boom.envelope
        assert e.stop_elevation_rad[0] - 0.02 < seen["elevation"][0] < e.stop_elevation_rad[1] + 0.02
        assert abs(seen["azimuth"][0]) < e.stop_azimuth_rad + 0.02
        assert 8.4 < seen["length"][0] < 8.5 + e.stop_extension_m + 0.1


def test_stops_push_and_never_pull() -> None:
    low, high = bench.TANKER.boom.envelope.stop_elevation_rad
    assert joint_forces(PAR[0], low - 0.01, 0.0, 10.0, 0.0, 0.0, 0.0)[0] < 0.0
    assert joint_forces(PAR[0], high + 0.01, 0.0, 10.0, 0.0, 0.0, 0.0)[0] > 0.0
    hinge = PAR["hinge"][0]
    leaving = joint_forces(PAR[0], low - 0.001, 0.0, 10.0, -5.0, 0.0, 0.0)[0]
    assert leaving == pytest.approx(5.0 * hinge)


def test_nozzle_force_is_a_spring_and_its_work_is_the_coordinates_work() -> None:
    s = in_flow((0.0, 0.0, 0.0))
    theta4, theta5, d6 = math.pi - 0.5, 0.1 - 0.5 * math.pi, 12.0
    tip = d6 * np.array(direction_of(theta4, theta5))
    off = np.array([0.01, -0.02, 0.03])
    s["goal_x"], s["goal_y"], s["goal_z"] = tip + off
    pull = np.array(nozzle_force(PAR[0], s[0], *tip, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(pull, PAR["stiffness"][0] * off, rtol=1e-9)
    state = (theta4, theta5, d6, 0.0, 0.0, 0.0)
    free = np.array(accelerations(PAR[0], s[0], *state, 0.0, 0.0, 0.0, 0.0, 0.0))
    held = np.array(accelerations(PAR[0], s[0], *state, 1.0, 0.0, 0.0, 0.0, 0.0))
    by = jacobian_of(theta4, theta5)
    wanted = [d6 * pull @ by[:3], d6 * pull @ by[3:], pull @ tip / d6]
    m4 = bench.inertias(PAR, _at(state))
    np.testing.assert_allclose((held - free) * [*m4, PAR["m_inner"][0]], wanted, rtol=1e-9)


def _at(state: tuple[float, ...]) -> Record:
    s = record(STATE)
    for name, value in zip(bench.STATE_NAMES, state, strict=True):
        s[name] = value
    return s


def test_latched_boom_stays_stable_at_200_hz_for_twice_the_stiffness_and_damping() -> None:
    for factor in (1.0, 2.0):
        par, s, given_ = PAR.copy(), in_flow((205.7, 0.0, 0.0)), record(PRESCRIBED)
        par["stiffness"], par["damping"] = factor * PAR["stiffness"], factor * PAR["damping"]
        s["theta4"], s["theta5"], s["d6"] = math.pi - 0.52, -0.5 * math.pi, 12.0
        s["goal_x"], s["goal_z"], s["goal_y"] = -10.4, 6.05, 0.05
        given_["latched"] = 1.0
        for _ in range(600):
            integrate(par[0], given_[0], s[0], bench.DT_S)
        assert abs(s["rate4"][0]) + abs(s["rate5"][0]) + abs(s["rate6"][0]) < 1e-3


def test_pivot_moves_as_equation_2_2_says() -> None:
    """Velocity and acceleration of P by differences of its place in ERF, on a tanker that turns and accelerates."""
    rng = np.random.default_rng(5)
    P = np.array(bench.TANKER.boom.pivot_tanker_m)
    v0, a0, w0, w1 = rng.normal(0, 80, 3), rng.normal(0, 4, 3), rng.normal(0, 0.3, 3), rng.normal(0, 0.3, 3)
    R0 = Rotation.random(rng=rng)

    def pivot(t: float) -> np.ndarray:
        R = R0 * Rotation.from_rotvec(w0 * t + 0.5 * w1 * t * t)
        return v0 * t + 0.5 * a0 * t * t + R.apply(P)

    h = 1e-3
    speed = (pivot(h) - pivot(-h)) / (2 * h)
    pull = (pivot(h) - 2 * pivot(0.0) + pivot(-h)) / h**2
    R, wind = R0.as_matrix(), np.array([5.0, -3.0, 1.0])
    given_, s = record(PRESCRIBED), record(STATE)
    yaw, pitch, roll = R0.as_euler("ZYX")
    told = {
        ("t_vn", "t_ve", "t_vd"): v0, ("t_yaw", "t_pitch", "t_roll"): (yaw, pitch, roll), ("t_p", "t_q", "t_r"): w0,
        ("t_udot", "t_vdot", "t_wdot"): R.T @ a0 - np.cross(w0, R.T @ v0), ("t_pdot", "t_qdot", "t_rdot"): w1,
        ("wind_n", "wind_e", "wind_d"): wind,
    }  # fmt: skip
    for names, values in told.items():
        for name, value in zip(names, values, strict=True):
            given_[name] = value
    carry(PAR[0], given_[0], s[0], rotation(yaw, pitch, roll))
    f = [float(s[n][0]) for n in ("f_x", "f_y", "f_z")]
    np.testing.assert_allclose(f, R.T @ (pull - [0.0, 0.0, bench.GRAVITY]), atol=1e-3)
    air = [float(s[n][0]) for n in ("air_x", "air_y", "air_z")]
    np.testing.assert_allclose(air, R.T @ (speed - wind), atol=1e-3)


def test_boom_hangs_the_same_in_a_coordinated_turn_but_for_the_load() -> None:
    """15 degrees of bank: the specific force stays along the tanker's down axis, and so does the boom."""
    bank = math.radians(15.0)
    rate = bench.GRAVITY * math.tan(bank) / bench.SPEED_M_S
    given_, s, seen = bench.given_for(math.radians(30), 10.3, bench.SPEED_M_S), record(STATE), record(SEEN)
    s["theta4"], s["theta5"], s["d6"] = math.pi - math.radians(30), -0.5 * math.pi, 10.3
    given_["t_pitch"], given_["t_roll"] = 0.0, bank
    given_["t_q"], given_["t_r"] = rate * math.sin(bank), rate * math.cos(bank)
    for _ in range(6000):
        assert advance(PAR, given_, s, seen, bench.DT_S)
    assert abs(math.degrees(seen["elevation"][0]) - 30.0) < 0.05
    assert abs(math.degrees(seen["azimuth"][0])) < 0.05
    assert float(s["f_z"][0]) == pytest.approx(-bench.GRAVITY / math.cos(bank), rel=0.01)
    assert abs(float(s["f_y"][0])) < 0.05
    assert abs(math.degrees(s["left"][0] - s["right"][0])) < 2.0


@pytest.mark.parametrize("latched", [0.0, 1.0])
def test_a_step_of_5_ms_is_short_enough(latched: float) -> None:
    ends = []
    for parts in (1, 10):
        s, given_ = in_flow((205.7, 3.0, 9.0), 0.02, -0.02), record(PRESCRIBED)
        s["theta4"], s["theta5"], s["d6"], s["drive"] = math.pi - 0.5, -1.5, 12.0, -1400.0
        s["rate4"], s["rate5"], s["rate6"] = 0.05, -0.05, 0.3
        s["goal_x"], s["goal_y"], s["goal_z"] = 12.0 * np.array(direction_of(math.pi - 0.5, -1.5)) + [0.02, 0.03, -0.01]
        given_["latched"] = latched
        for _ in range(200 * parts):
            integrate(PAR[0], given_[0], s[0], bench.DT_S / parts)
        ends.append([float(s[name][0]) for name in bench.STATE_NAMES])
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-4)
