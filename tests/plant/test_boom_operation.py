"""The boom at work: automatic and by stick, contact, fuel, disconnects, bad input."""

from __future__ import annotations

import math

import boom_bench as bench
import msgspec
import numpy as np
import pytest

from companion.config import BoomConfig
from companion.geometry import Vec
from sim_bridge.plant.boom import AirAtBoom, Boom, nominal_boom
from sim_bridge.plant.conditions import BoomConditions, StickInput
from sim_bridge.plant.fdm import PlantError

QUICK = BoomConditions(contact_after_s=1.0, fuel_kg=60.0)
ENDLESS = BoomConditions(contact_after_s=1.0, fuel_kg=4000.0)


def ramp(direction: tuple[float, float, float], speed_m_s: float, start_s: float) -> bench.Motion:
    """Still until ``start_s``, then away at ``speed_m_s``, gently at first."""
    unit = np.array(direction) / np.linalg.norm(direction)

    def motion(t_s: float) -> tuple[Vec, Vec]:
        t = max(t_s - start_s, 0.0)
        speed = speed_m_s * min(t, 1.0)
        way = 0.5 * speed_m_s * min(t, 1.0) ** 2 + speed_m_s * max(t - 1.0, 0.0)
        return way * unit, speed * unit

    return motion


def test_automatic_operator_waits_refuels_and_retracts() -> None:
    b = bench.Bench(BoomConditions(contact_after_s=5.0, fuel_kg=60.0))
    contact_s = b.run_until(lambda boom: boom.contact, 20.0)
    assert contact_s >= 5.0
    loads = []
    while b.boom.contact:
        b.step()
        loads.append(b.boom.force_on_receptacle_ned_n)
    assert b.boom.given_kg == 60.0
    assert b.boom.disconnects == {"fuel given": 1}
    assert b.boom.contacts == 1
    settled = np.abs(np.array(loads)[400:])
    assert settled.max() < 2500.0
    assert settled.mean() < 400.0
    assert b.boom.peak_load_n < 5000.0
    b.run(10.0)
    state = b.boom.state
    assert not state.contact
    assert state.length_m == pytest.approx(10.3, abs=0.1)
    assert math.degrees(state.elevation_rad) == pytest.approx(30.0, abs=0.5)
    b.run(15.0)
    assert b.boom.contacts == 1


def test_nozzle_is_in_the_receptacle_while_it_refuels() -> None:
    b = bench.Bench(ENDLESS)
    b.run_until(lambda boom: boom.contact, 20.0)
    b.run(3.0)
    for _ in range(1000):
        b.step()
        assert b.boom.contact
        assert b.boom.seen.gap < 0.03
        way, _ = bench.swaying(b.t_s)
        c, s = math.cos(bench.PITCH_RAD), math.sin(bench.PITCH_RAD)
        R_ned_tanker = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        tip_ned = R_ned_tanker @ b.boom.state.tip_tanker_m()
        np.testing.assert_allclose(tip_ned, R_ned_tanker @ bench.BOX_M + way, atol=0.03)


def test_fuel_flows_at_its_rate_in_contact_only() -> None:
    b = bench.Bench(ENDLESS)
    b.run_until(lambda boom: boom.contact, 20.0)
    assert b.boom.given_kg < 0.1
    b.run(8.0)
    before = b.boom.given_kg
    b.run(4.0)
    assert b.boom.given_kg - before == pytest.approx(4.0 * 15.0, rel=0.01)
    b.boom.disconnect("breakaway")
    after = b.boom.given_kg
    b.run(0.5)
    assert b.boom.given_kg == after
    assert b.boom.disconnects == {"breakaway": 1}


@pytest.mark.parametrize(
    ("direction", "reason"),
    [((0.0, 1.0, 0.0), "azimuth limit"), ((0.0, -1.0, 0.0), "azimuth limit"), ((0.0, 0.0, 1.0), "elevation limit"),
     ((-10.5, 0.0, 6.0), "extension limit"), ((10.5, 0.0, -6.0), "extension limit")],
)  # fmt: skip
def test_it_lets_go_at_the_limits_and_keeps_clear(direction: tuple[float, float, float], reason: str) -> None:
    b = bench.Bench(ENDLESS, ramp(direction, 0.5, 12.0), turbulence="none")
    b.run_until(lambda boom: boom.contact, 12.0)
    b.run_until(lambda boom: not boom.contact, 40.0)
    assert b.boom.disconnects == {reason: 1}
    assert b.boom.peak_load_n < 10_000.0
    contact = b.boom.seen
    e = bench.TANKER.boom.envelope
    assert abs(contact.azimuth) < e.azimuth_rad + 0.01
    assert e.elevation_rad[0] - 0.01 < contact.elevation < e.elevation_rad[1] + 0.01
    assert e.extension_m[0] - 0.05 < contact.length - 8.5 < e.extension_m[1] + 0.05
    b.run(8.0)
    assert b.boom.state.length_m == pytest.approx(10.3, abs=0.2)


def test_it_makes_contact_again_after_a_limit_once_the_receiver_is_back() -> None:
    out = ramp((0.0, 1.0, 0.0), 0.5, 10.0)
    back = ramp((0.0, -1.0, 0.0), 0.5, 20.0)

    def motion(t_s: float) -> tuple[Vec, Vec]:
        (p, v), (q, w) = out(min(t_s, 21.0)), back(t_s)
        way = p + q if t_s < 30.0 else bench.REST
        return way, (v if t_s < 21.0 else bench.REST) + (w if t_s < 30.0 else bench.REST)

    b = bench.Bench(ENDLESS, motion, turbulence="none")
    b.run_until(lambda boom: boom.contacts == 2, 60.0)
    assert b.boom.disconnects == {"azimuth limit": 1}


def test_it_lets_go_when_the_receiver_leaves_fast() -> None:
    b = bench.Bench(ENDLESS, ramp((-10.5, 0.0, 6.0), 3.0, 12.0), turbulence="none")
    b.run_until(lambda boom: boom.contact, 12.0)
    b.run_until(lambda boom: not boom.contact, 20.0)
    assert b.boom.disconnects == {"receiver leaves": 1}


def test_a_jerk_tears_the_nozzle_out_and_counts_as_brute() -> None:
    def jerk(t_s: float) -> tuple[Vec, Vec]:
        return (np.array([0.0, 0.5, 0.0]) if t_s > 12.0 else bench.REST), bench.REST

    b = bench.Bench(ENDLESS, jerk, turbulence="none")
    b.run_until(lambda boom: boom.contact, 12.0)
    b.run_until(lambda boom: not boom.contact, 13.0)
    assert b.boom.disconnects == {"brute: break load": 1}
    assert b.boom.peak_load_n > bench.TANKER.boom.nozzle.break_load_n
    b.run(5.0)


@pytest.mark.parametrize("ahead", [0.35, -0.35])
@pytest.mark.parametrize("right", [1.75, -1.75])
@pytest.mark.parametrize("down", [0.85, -0.85])
def test_it_reaches_every_corner_of_the_desired_window(ahead: float, right: float, down: float) -> None:
    b = bench.Bench(ENDLESS, bench.still, bench.BOX_M + np.array([ahead, right, down]), turbulence="light", seed=3)
    b.run_until(lambda boom: boom.contact, 15.0)
    b.run(10.0)
    assert b.boom.contact


def test_it_stays_clear_of_a_receiver_that_is_not_in_the_window() -> None:
    b = bench.Bench(QUICK, bench.swaying, bench.BOX_M + np.array([0.0, 2.2, 0.0]))
    assert max(s.length_m for s in b.run(15.0)) < 10.6
    assert b.boom.contacts == 0


@pytest.mark.parametrize("speed_m_s", [190.0, 220.0])
@pytest.mark.parametrize("turbulence", ["light", "moderate"])
def test_it_refuels_in_gusts_at_other_speeds(speed_m_s: float, turbulence: str) -> None:
    for seed in (11, 12):
        b = bench.Bench(QUICK, turbulence=turbulence, seed=seed, speed_m_s=speed_m_s)
        b.run_until(lambda boom: bool(boom.disconnects), 40.0)
        assert b.boom.disconnects == {"fuel given": 1}
        assert b.boom.peak_load_n < 10_000.0


def test_boom_holds_nominal_in_gusts_before_it_reaches_out() -> None:
    never = BoomConditions(contact_after_s=1e6)
    for turbulence, most_deg in (("light", 0.8), ("moderate", 1.6)):
        b = bench.Bench(never, turbulence=turbulence, seed=21)
        states = b.run(30.0)
        off = np.degrees([[s.elevation_rad - math.radians(30), s.azimuth_rad] for s in states])
        assert np.abs(off).max() < most_deg


def test_stick_moves_the_boom_at_rates_and_lets_go_of_it() -> None:
    stick = (StickInput(at_s=1.0, up=1.0), StickInput(at_s=3.0), StickInput(at_s=5.0, right=1.0), StickInput(at_s=7.0),
             StickInput(at_s=9.0, extend=1.0), StickInput(at_s=11.0))
    b = bench.Bench(BoomConditions(operator="joystick", stick=stick), at_tanker_m=bench.BOX_M - [30.0, 0.0, 0.0],
                    turbulence="none")
    start = b.run(1.0)[-1]
    up = b.run(4.0)[-1]
    right = b.run(4.0)[-1]
    out = b.run(4.0)[-1]
    assert math.degrees(start.elevation_rad - up.elevation_rad) == pytest.approx(5.7, abs=0.6)
    assert math.degrees(right.azimuth_rad - up.azimuth_rad) == pytest.approx(6.7, abs=0.8)
    assert out.length_m - right.length_m == pytest.approx(2.0, abs=0.15)
    held = b.run(5.0)[-1]
    assert math.degrees(abs(held.elevation_rad - out.elevation_rad)) < 0.3
    assert held.length_m == pytest.approx(out.length_m, abs=0.05)


def test_stick_held_up_stops_at_the_stop_and_comes_back_at_once() -> None:
    b = bench.Bench(BoomConditions(operator="joystick"), at_tanker_m=bench.BOX_M - [30.0, 0.0, 0.0], turbulence="none")
    b.boom.stick(1.0, 0.0, 0.0)
    low = b.run(15.0)[-1].elevation_rad
    assert low == pytest.approx(bench.TANKER.boom.envelope.stop_elevation_rad[0], abs=0.03)
    b.boom.stick(-1.0, 0.0, 0.0)
    assert b.run(1.5)[-1].elevation_rad > low + 0.02


def test_flown_by_stick_the_nozzle_latches_and_is_pulled_out() -> None:
    b = bench.Bench(BoomConditions(operator="joystick", fuel_kg=4000.0), bench.still, turbulence="none")
    while not b.boom.contact:
        assert b.t_s < 20.0
        seen = b.boom.seen
        b.boom.stick(8.0 * (seen.elevation - seen.aim_elevation), 8.0 * (seen.aim_azimuth - seen.azimuth),
                     min(max(seen.aim_length - seen.length, 0.2), 0.6))
        b.step()
    b.boom.stick(0.0, 0.0, 0.0)
    b.run(2.0)
    assert b.boom.contact
    b.boom.stick(0.0, 0.0, -1.0)
    b.run(2.0)
    assert b.boom.disconnects == {"operator": 1}
    assert b.boom.seen.gap > 1.0


def test_fixed_boom_is_the_nominal_one_and_feels_nothing() -> None:
    b = bench.Bench(BoomConditions(operator="fixed"))
    states = b.run(1.0)
    nominal = nominal_boom(bench.TANKER.boom)
    for state in (states[0], states[-1]):
        assert (state.elevation_rad, state.azimuth_rad, state.length_m) == (
            nominal.elevation_rad, nominal.azimuth_rad, nominal.length_m)
        assert not state.contact
    assert b.boom.force_on_receptacle_ned_n == (0.0, 0.0, 0.0)


def test_same_input_same_bits() -> None:
    def flight() -> list[tuple[float, ...]]:
        b = bench.Bench(QUICK, seed=5)
        out = []
        for _ in range(3000):
            b.step()
            out.append((*b.boom.seen, b.boom.given_kg))
        return out

    assert flight() == flight()


def test_mirrored_receiver_and_gusts_make_a_mirrored_flight() -> None:
    here, there = bench.Bench(ENDLESS, seed=6), bench.Bench(ENDLESS, seed=6, mirrored=True)
    for _ in range(2400):
        here.step()
        there.step()
    a, b = here.boom.state, there.boom.state
    assert a.contact
    assert b.contact
    np.testing.assert_allclose(
        (b.elevation_rad, -b.azimuth_rad, b.length_m, *b.ruddevators_rad[::-1]),
        (a.elevation_rad, a.azimuth_rad, a.length_m, *a.ruddevators_rad), atol=1e-9,
    )  # fmt: skip
    assert here.boom.force_on_receptacle_ned_n[1] == pytest.approx(-there.boom.force_on_receptacle_ned_n[1], abs=1e-3)


def test_a_bow_wave_pushes_the_telescope_where_it_blows() -> None:
    asked = []

    def blow(p_frd_m: tuple[float, float, float], airspeed: float, alpha: float) -> tuple[float, float, float]:
        asked.append((p_frd_m, airspeed, alpha))
        return 0.0, 0.0, -20.0

    still_air = bench.Bench(ENDLESS, bench.still, turbulence="none")
    blown = bench.Bench(ENDLESS, bench.still, turbulence="none", bow_wave=blow)
    still_air.run(0.3)
    blown.run(0.3)
    assert blown.boom.seen.elevation < still_air.boom.seen.elevation - 1e-4
    p, airspeed, alpha = asked[-1]
    assert airspeed == pytest.approx(bench.SPEED_M_S, rel=1e-6)
    assert alpha == pytest.approx(0.0, abs=1e-6)
    near = np.add(bench.RECEPTACLE_M, (1.5, 0.0, -1.0))
    np.testing.assert_allclose(p, near, atol=1.0)


@pytest.mark.parametrize("what", ["tanker", "receiver", "air"])
def test_numbers_that_are_none_are_a_plant_error_that_names_the_boom(what: str) -> None:
    b = bench.Bench(QUICK)
    b.run(0.1)
    bad = math.nan
    if what == "tanker":
        b.tanker = b.tanker._replace(v_dot_body_m_s2=(bad, 0.0, 0.0))
    elif what == "receiver":
        b.rest_ned = b.rest_ned * bad
    else:
        b.air._gust = b.air._gust * bad
    with pytest.raises(PlantError, match="boom"):
        b.run(0.2)


def test_state_points_where_the_nozzle_is() -> None:
    """Angles of the picture turn azimuth first, those of the joints elevation: both end at the same tip."""
    b = bench.Bench(ENDLESS, bench.still, bench.BOX_M + np.array([0.0, 1.6, 0.3]), turbulence="none")
    b.run_until(lambda boom: boom.contact, 15.0)
    b.run(3.0)
    np.testing.assert_allclose(b.boom.state.tip_tanker_m(), np.add(bench.BOX_M, (0.0, 1.6, 0.3)), atol=0.02)


def test_a_boom_of_another_make_still_flies() -> None:
    config = msgspec.structs.replace(
        bench.TANKER.boom, ready_length_m=10.0,
        tubes=msgspec.structs.replace(bench.TANKER.boom.tubes, outer_mass_kg=800.0, cross_drag=0.6),
    )  # fmt: skip
    b = bench.Bench(QUICK, config=config)
    b.run_until(lambda boom: bool(boom.disconnects), 40.0)
    assert b.boom.disconnects == {"fuel given": 1}


def test_a_boom_with_only_a_pivot_has_its_box_in_the_middle_of_its_reach() -> None:
    boom = Boom(BoomConfig(pivot_tanker_m=(-16.5, 0.0, 2.0)), QUICK, bench.DT_S)
    b = bench.Bench(QUICK, bench.still)
    boom.step(b.tanker, bench.Receptacle(tuple(b.rest_ned.tolist()), (bench.SPEED_M_S, 0.0, 0.0), (0.0,) * 3,
                                         (0.0,) * 3, bench.RECEPTACLE_M), AirAtBoom(bench.DENSITY))
    assert math.hypot(boom.seen.br_x, boom.seen.br_y, boom.seen.br_z) < 0.1
