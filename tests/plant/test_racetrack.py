from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.config import AirframeConfig, TankerConfig
from sim_bridge.plant.conditions import CourseConfig, PlantConditions
from sim_bridge.plant.fdm import Fdm, InitialCondition, PlantError
from sim_bridge.plant.gusts import GustField
from sim_bridge.plant.tanker import INPUTS, Course, TankerAutopilot, trim_tanker
from sim_bridge.plant.world import World

Array = NDArray[np.float64]
DT, SPEED, G = 0.005, 205.69, 9.80665
HEADING = 0.3
RACETRACK = CourseConfig(kind="racetrack")
LAP_S = 2 * (60.0 + 2 * 5.0 + (math.pi + 2 * G / SPEED / math.radians(3) * math.log(math.cos(math.radians(15))))
             / (G / SPEED * math.tan(math.radians(15))))
"""Two legs, and two half turns with 5 s of rolling at each end."""


@dataclass
class Flight:
    """Columns over time: s, m, m/s, rad; ``across`` is velocity to the right of the first leg."""

    t: Array
    p: Array
    v: Array
    roll: Array
    yaw: Array
    speed: Array

    @property
    def across(self) -> Array:
        return self.v[:, 1] * math.cos(HEADING) - self.v[:, 0] * math.sin(HEADING)


def fly(seconds: float, course: CourseConfig, turbulence: str = "none", seed: int = 1, fuel_kg: float = 0.0) -> Flight:
    """Fly the tanker alone; ``fuel_kg`` flows off evenly. Speed is inertial."""
    fdm = Fdm("kc135r", INPUTS, DT, 6000.0)
    origin = (0.0, 0.0, 0.0)
    turning = trim_tanker(fdm, SPEED, origin, HEADING, course.bank_rad) if course.kind == "racetrack" else None
    autopilot = TankerAutopilot(fdm, trim_tanker(fdm, SPEED, origin, HEADING), HEADING, 0.0, DT, course, turning)
    gusts = GustField(turbulence, np.random.default_rng(seed), HEADING)
    rows = []
    for k in range(round(seconds / DT) + 1):
        if k % 20 == 0:
            rows.append((k * DT, fdm.p_n, fdm.p_e, fdm.p_d, fdm.v_n, fdm.v_e, fdm.v_d, fdm.roll, fdm.yaw))
        autopilot.step()
        fdm.set_transferred(-fuel_kg * k * DT / seconds)
        gust = gusts.at(fdm.p_n, fdm.p_e, fdm.p_d, math.cos(fdm.yaw), math.sin(fdm.yaw), fdm.span_m)
        fdm.set_gust(*gust[:3])
        fdm.set_rotary_gust(*gust[3:])
        fdm.step()
    x = np.array(rows)
    return Flight(x[:, 0], x[:, 1:4], x[:, 4:7], x[:, 7], x[:, 8], np.linalg.norm(x[:, 4:7], axis=1))


def in_turn(t: Array) -> Array:
    """Whether the bank has settled: 10 s after the turn's start until 5 s before its end."""
    since = t % (LAP_S / 2)
    inside: Array = (since > 70.0) & (since < LAP_S / 2 - 5.0)
    return inside


@given(
    bank=st.floats(0.02, 0.52), leg=st.floats(0.5, 300.0), right=st.booleans(), heading=st.floats(-3, 3),
    share=st.floats(0.0, 3.0),
)
def test_course_is_a_coordinated_turn(bank: float, leg: float, right: bool, heading: float, share: float) -> None:
    """Heading is the integral of g / V tan(bank), bank changes by 3 degrees a second at most, laps repeat."""
    side = "right" if right else "left"
    course = Course(CourseConfig(kind="racetrack", bank_rad=bank, leg_s=leg, turn=side), heading, SPEED)
    sign = 1.0 if right else -1.0
    lap_s = 2 * (leg + (math.pi + 2 * G / SPEED / math.radians(3) * math.log(math.cos(bank)))
                 / (G / SPEED * math.tan(bank)) + 2 * bank / math.radians(3))
    assert course.at(0.0) == (heading, 0.0)
    t, h = share * lap_s, 1e-3
    (psi0, phi0), (_, phi1), (psi2, phi2) = (course.at(t + k * h) for k in range(3))
    assert max(abs(phi1 - phi0), abs(phi2 - phi1)) <= math.radians(3) * h * 1.001
    assert (psi2 - psi0) / (2 * h) == pytest.approx(G / SPEED * math.tan(phi1), abs=1e-5)
    assert 0.0 <= sign * phi0 <= bank
    later, phi = course.at(t + lap_s)
    assert later - psi0 == pytest.approx(sign * 2 * math.pi, abs=1e-6)
    assert phi == pytest.approx(phi0, abs=1e-6)


def test_straight_course_never_turns() -> None:
    course = Course(CourseConfig(), 0.7, SPEED)
    assert {course.at(t) for t in (0.0, 59.0, 61.0, 1e5)} == {(0.7, 0.0)}


def test_racetrack_in_calm_air() -> None:
    flight = fly(LAP_S, RACETRACK)
    turning = in_turn(flight.t)
    assert np.abs(np.degrees(flight.roll[turning]) - 15.0).max() < 1.0
    assert np.abs(flight.p[:, 2]).max() < 1.0
    assert np.abs(flight.speed - SPEED).max() < 0.1
    # Legs are level, half a turn apart; the second lies two radii to the right of the first.
    for t, way in ((55.0, 0.0), (LAP_S / 2 + 55.0, math.pi), (LAP_S, 2 * math.pi)):
        k = int(np.argmin(np.abs(flight.t - t)))
        assert math.remainder(flight.yaw[k] - HEADING - way, 2 * math.pi) == pytest.approx(0.0, abs=0.01)
        assert t == LAP_S or abs(math.degrees(flight.roll[k])) < 0.3
    right = flight.p[:, 1] * math.cos(HEADING) - flight.p[:, 0] * math.sin(HEADING)
    radius_m = SPEED**2 / (G * math.tan(math.radians(15)))
    assert right.max() == pytest.approx(2 * radius_m, rel=0.05)
    # It closes on itself, after 128 km.
    assert np.linalg.norm(flight.p[-1]) < 25.0


def test_left_racetrack_mirrors_the_right_one() -> None:
    """A quicker one: 30 degrees of bank, 5 s legs."""
    left, right = (fly(80.0, CourseConfig(kind="racetrack", bank_rad=math.radians(30), leg_s=5.0, turn=side))
                   for side in ("left", "right"))
    np.testing.assert_allclose(left.roll, -right.roll, atol=1e-6)
    np.testing.assert_allclose(left.speed, right.speed, atol=1e-6)
    assert np.degrees(right.roll).max() == pytest.approx(30.0, abs=1.5)
    assert np.abs(right.p[:, 2]).max() < 5.0


def test_turn_in_light_turbulence() -> None:
    flight = fly(160.0, RACETRACK, "light", seed=2)
    turning = in_turn(flight.t)
    rolls = np.degrees(flight.roll[turning])
    assert np.abs(rolls - 15.0).max() < 2.0
    assert rolls.mean() == pytest.approx(15.0, abs=0.5)
    assert rolls.std() < 0.7
    assert np.abs(flight.p[:, 2]).max() < 10.0
    assert np.abs(flight.speed - SPEED).max() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("turbulence", ["light", "moderate", "severe"])
def test_racetrack_in_turbulence(turbulence: str) -> None:
    scale = {"light": 1.0, "moderate": 2.0, "severe": 5.7}[turbulence]
    flight = fly(LAP_S, RACETRACK, turbulence, seed=3)
    rolls = np.degrees(flight.roll[in_turn(flight.t)])
    assert np.abs(rolls - 15.0).max() < 2.0 * scale
    assert rolls.mean() == pytest.approx(15.0, abs=0.5)
    assert np.abs(flight.p[:, 2]).max() < 12.0 * scale
    assert np.abs(flight.speed - SPEED).max() < 1.0 * scale
    assert np.linalg.norm(flight.p[-1]) < 120.0 * scale


def test_height_and_speed_hold_while_fuel_flows_off() -> None:
    """4 t in 160 s, more than is ever given, and a turn besides."""
    flight = fly(160.0, RACETRACK, fuel_kg=4000.0)
    assert np.abs(flight.p[:, 2]).max() < 3.0
    assert np.abs(flight.speed - SPEED).max() < 0.3


def test_tanker_stays_calm_in_light_turbulence() -> None:
    """What the receiver has to follow: a third of a degree of roll and half a metre a second."""
    for seed in (4, 5):
        flight = fly(90.0, CourseConfig(), "light", seed=seed)
        assert np.degrees(flight.roll).std() < 0.6
        assert flight.v[:, 2].std() < 0.8
        assert flight.across.std() < 0.6
        assert np.abs(flight.p[:, 2]).max() < 10.0


def test_longitudinal_motion_is_stable_on_its_own() -> None:
    """Thesis 2.1: no internal stability control is needed; the autopilot only keeps the track straight."""
    fdm = Fdm("kc135r", INPUTS, DT, 6000.0)
    trim = trim_tanker(fdm, SPEED, (0.0, 0.0, 0.0), 0.0)
    x0 = np.array([SPEED * math.cos(trim.alpha_rad), SPEED * math.sin(trim.alpha_rad), 0.0, trim.alpha_rad])

    def rates(x: Array) -> Array:
        fdm.reset(InitialCondition((0.0, 0.0, 0.0), (x[0], 0.0, x[1]), (0.0, x[3], 0.0), (0.0, x[2], 0.0)))
        (u, _, w), (_, q, _) = fdm.accelerations()
        return np.array([u, w, q, x[2]])

    steps = np.diag([0.1, 0.1, 1e-3, 1e-3])
    A = np.array([(rates(x0 + h) - rates(x0 - h)) / (2 * h.max()) for h in steps]).T
    modes = sorted((complex(v) for v in np.linalg.eigvals(A) if v.imag > 0), key=abs)
    assert len(modes) == 2
    phugoid, short_period = modes
    assert phugoid.real < 0.0
    assert abs(phugoid) == pytest.approx(math.sqrt(2) * G / SPEED, rel=0.2)  # Lanchester
    assert -short_period.real / abs(short_period) > 0.3


def test_turn_that_cannot_be_flown_is_refused() -> None:
    fdm = Fdm("kc135r", INPUTS, DT, 6000.0)
    with pytest.raises(PlantError, match=r"no level flight at 205\.7 m/s turning at 90 degrees of bank"):
        trim_tanker(fdm, SPEED, (0.0, 0.0, 0.0), 0.0, math.pi / 2)


@pytest.mark.bench
@pytest.mark.parametrize("turbulence", ["light", "moderate", "severe"])
def test_print_how_the_tanker_moves(turbulence: str) -> None:
    flights = [fly(120.0, CourseConfig(), turbulence, seed) for seed in range(20, 26)]
    figures = np.mean([(f.across.std(), f.v[:, 2].std(), np.degrees(f.roll.std()), f.p[:, 2].std()) for f in flights],
                      axis=0)
    print("\n{}: sigma across {:.2f} m/s, vertical {:.2f} m/s, roll {:.2f} degrees, height {:.1f} m".format(
        turbulence, *figures))


def test_world_flies_the_course_of_its_conditions(tanker: TankerConfig, airframe: AirframeConfig) -> None:
    course = CourseConfig(kind="racetrack", bank_rad=math.radians(9.0), leg_s=1.0, turn="left")
    world = World(tanker, airframe, (-300.0, 0.0, 200.0), "none", False, np.random.default_rng(1),
                  conditions=PlantConditions(course=course))
    for _ in range(1200):
        world.step(np.array(airframe.trim.effectors))
    R = world.truth.tanker.R_ned_body
    assert math.degrees(math.atan2(R[2, 1], R[2, 2])) == pytest.approx(-9.0, abs=0.5)
    assert abs(world.truth.tanker.p_ned_m[2]) < 1.0
