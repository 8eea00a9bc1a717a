from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from companion.config import AirframeConfig, TankerConfig
from companion.geometry import euler_from_rotation, exp_so3, rotation_from_euler
from sim_bridge.autopilot.inner_kernels import MISS, add_solution, allocate
from sim_bridge.autopilot.inner_loops import InnerGains, InnerLoops, Sensed, design, perfect
from sim_bridge.plant.actuators import ActuatorConfig, default_channels
from sim_bridge.plant.world import World

DT = 0.005
G = 9.80665
EULER_SIGMA_RAD = math.sqrt(1e-9 / 0.05)  # thesis 3.2
RATE_SIGMA_RAD_S = math.sqrt(1e-8 / 0.05)


class Flight:
    """A receiver in the world with its inner loops and the thesis' inertial noise, held for 0.05 s."""

    def __init__(
        self,
        tanker: TankerConfig,
        airframe: AirframeConfig,
        turbulence: str = "light",
        extra_delay_s: float = 0.0,
        seed: int = 3,
    ) -> None:
        channels = tuple(dataclasses.replace(c, delay_s=c.delay_s + extra_delay_s) for c in default_channels())
        rng = np.random.default_rng(seed)
        self.airframe = airframe
        self.noise = np.random.default_rng(seed + 100)
        self.world = World(
            tanker, airframe, (-60.0, 0.0, 20.0), turbulence, True, rng, 0.4, DT, ActuatorConfig(channels)
        )
        self.loops = InnerLoops(airframe, DT)
        self.steps = 0

    def sense(self) -> Sensed:
        if self.steps % 10 == 0:
            self.held = self.noise.normal(0, EULER_SIGMA_RAD, 3), self.noise.normal(0, RATE_SIGMA_RAD_S, 3)
        self.steps += 1
        uav = self.world.truth.uav
        return dataclasses.replace(
            perfect(uav), R_ned_frd=uav.R_ned_body @ exp_so3(self.held[0]),
            omega_frd_rad_s=uav.omega_body_rad_s + self.held[1],
        )

    def step(self, roll: float, pitch_offset: float) -> np.ndarray:
        """Advance once; return roll, pitch from trim, sideslip over the ground and the effectors."""
        trim = self.airframe.trim
        self.world.step(self.loops.step(roll, trim.alpha_rad + pitch_offset, trim.throttle, self.sense()))
        uav = self.world.truth.uav
        _, pitch, bank = euler_from_rotation(uav.R_ned_body)
        v = uav.R_ned_body.T @ uav.v_ned_m_s
        beta = math.asin(v[1] / float(np.linalg.norm(v)))
        return np.array([bank, pitch - trim.alpha_rad, beta, *self.world.truth.uav_effectors])


def test_constant_commands_hold_for_a_minute_in_light_turbulence(
    tanker: TankerConfig, airframe: AirframeConfig
) -> None:
    flight = Flight(tanker, airframe)
    track = np.array([flight.step(0.0, 0.0) for _ in range(round(60 / DT))])
    assert np.abs(track[:, 0]).max() < 0.01
    assert np.abs(track[:, 1]).max() < 0.01
    assert np.abs(track[:, 2]).max() < 0.01


@pytest.mark.parametrize(("turbulence", "extra_delay_s"), [("light", 0.0), ("light", 0.02), ("severe", 0.02)])
def test_steps_are_followed_with_more_delay_than_designed_for(
    tanker: TankerConfig, airframe: AirframeConfig, turbulence: str, extra_delay_s: float
) -> None:
    flight = Flight(tanker, airframe, turbulence, extra_delay_s)
    errors = []
    for k in range(round(20 / DT)):
        t = k * DT
        roll, pitch = 0.3 * (-1) ** int(t / 5), 0.015 * (-1) ** int(t / 4)
        state = flight.step(roll, pitch)
        assert np.abs(state[2]) < 0.03
        if t % 5 > 4:
            errors.append(state[0] - roll)
        if t % 4 > 3:
            errors.append(state[1] - pitch)
    assert np.abs(errors).max() < (0.015 if turbulence == "light" else 0.04)


def test_wild_commands_do_not_break_it(tanker: TankerConfig, airframe: AirframeConfig) -> None:
    flight = Flight(tanker, airframe)
    rng = np.random.default_rng(1)
    for _ in range(30):
        roll, pitch = rng.uniform(-0.6, 0.6), rng.uniform(-0.1, 0.1)
        for _ in range(60):
            state = flight.step(roll, pitch)
            assert abs(state[0]) < 0.8
            assert abs(state[2]) < 0.06
    for _ in range(800):
        state = flight.step(0.0, 0.0)
    assert abs(state[0]) < 0.01
    assert abs(state[1]) < 0.01


def test_fallback_levels_and_stops_the_descent(tanker: TankerConfig, airframe: AirframeConfig) -> None:
    flight = Flight(tanker, airframe)
    for _ in range(600):
        flight.step(0.3, -0.02)
    assert flight.world.truth.uav.v_ned_m_s[2] > 1.5
    tail = []
    for _ in range(round(40 / DT)):
        flight.world.step(flight.loops.hold_step(flight.sense()))
        uav = flight.world.truth.uav
        tail.append((euler_from_rotation(uav.R_ned_body)[2], uav.v_ned_m_s[2], float(np.linalg.norm(uav.v_ned_m_s))))
    late = np.array(tail[-2000:])
    assert np.abs(late[:, 0]).max() < 0.01
    assert abs(late[:, 1].mean()) < 0.3
    assert np.abs(late[:, 2] - airframe.trim.airspeed_m_s).max() < 1.5


moments = st.tuples(st.floats(-12, 12), st.floats(-5, 5), st.floats(-1.5, 1.5))


@settings(max_examples=100, deadline=None)
@given(moments)
def test_allocation_is_the_bounded_least_squares(
    airframe: AirframeConfig, wanted: tuple[float, float, float]
) -> None:
    c = design(airframe, DT, InnerGains())
    now = np.zeros(9)
    allocate(*wanted, c, c.low, c.high, now)
    assert (now >= c.low - 1e-12).all()
    assert (now <= c.high + 1e-12).all()
    used = c.squares > 0
    M, size, price = c.moments[:, used], np.sqrt(c.squares[used]), np.sqrt(np.array(MISS))
    free = size * np.linalg.lstsq(M * size, np.array(wanted), rcond=None)[0]
    if ((free >= c.low[used]) & (free <= c.high[used])).all():
        np.testing.assert_allclose(now[used], free, atol=1e-9)  # nothing saturates: exact
        return
    stacked = np.vstack((np.diag(1 / size), M / price[:, None]))
    target = np.concatenate((np.zeros(used.sum()), np.array(wanted) / price))
    best = lsq_linear(stacked, target, (c.low[used], c.high[used]), tol=1e-12)
    cost = 0.5 * float(((stacked @ now[used] - target) ** 2).sum())
    assert best.cost * (1 - 1e-6) <= cost <= best.cost * (1 + 1e-4) + 1e-6


def sensed(R: np.ndarray, omega: np.ndarray, v: np.ndarray, side_force_m_s2: float = 0.0) -> Sensed:
    """Return a sample of an aircraft whose lift carries it, whatever its attitude."""
    force = R.T @ np.array([0.0, 0.0, -G]) + np.array([0.0, side_force_m_s2, 0.0])
    return Sensed(0, R, omega, v, force, float(np.linalg.norm(v)))


def test_one_sided_effectors_are_never_asked_below_zero(airframe: AirframeConfig) -> None:
    loops = InnerLoops(airframe, DT)
    trim = airframe.trim
    v = np.array([trim.airspeed_m_s, 0.0, 0.0])
    for k in range(400):
        R = rotation_from_euler(0.1 * math.sin(k / 9), trim.alpha_rad, 0.6 * math.sin(k / 5))
        command = loops.step(0.0, trim.alpha_rad, 0.5, sensed(R, np.array([math.sin(k / 3), 0.0, 0.3]), v))
        assert (command[[1, 2, 8, 9]] >= 0.0).all()


def test_commands_never_outrun_the_actuators(airframe: AirframeConfig) -> None:
    loops = InnerLoops(airframe, DT)
    trim = airframe.trim
    rates = np.array([c.rate_per_s for c in default_channels()])[1:]
    rng = np.random.default_rng(0)
    before = np.array(trim.effectors)
    for _ in range(200):
        R = rotation_from_euler(0.0, trim.alpha_rad + rng.normal(0, 0.05), rng.normal(0, 0.3))
        v = np.array([trim.airspeed_m_s, rng.normal(0, 3), rng.normal(0, 3)])
        command = loops.step(rng.normal(0, 0.3), rng.normal(0, 0.1), 0.5, sensed(R, rng.normal(0, 0.3, 3), v))
        assert (np.abs(command - before)[1:] <= rates * DT * (1 + 1e-9)).all()
        before = command


def test_mirrored_motion_gives_mirrored_commands(airframe: AirframeConfig) -> None:
    swap = [0, 2, 1, 4, 3, 6, 5, 7, 9, 8]
    right, left = InnerLoops(airframe, DT), InnerLoops(airframe, DT)
    trim = airframe.trim
    for k in range(400):
        yaw, roll, roll_cmd = (0.01 * math.sin(k * f) for f in (0.01, 0.013, 0.007))
        pitch, pitch_cmd = (trim.alpha_rad + 0.005 * math.sin(k * f) for f in (0.012, 0.006))
        p, q, r = (0.01 * math.sin(k * f) for f in (0.011, 0.014, 0.009))
        speed = trim.airspeed_m_s
        side = 2.0 * math.sin(k * 0.012)
        one = sensed(
            rotation_from_euler(yaw, pitch, roll), np.array([p, q, r]), np.array([speed, side, 1.0]), 0.1 * side
        )
        two = sensed(
            rotation_from_euler(-yaw, pitch, -roll), np.array([-p, q, -r]), np.array([speed, -side, 1.0]), -0.1 * side
        )
        a = right.step(roll_cmd, pitch_cmd, 0.6, one)
        b = left.step(-roll_cmd, pitch_cmd, 0.6, two)
        np.testing.assert_allclose(a[swap], b, atol=1e-9)


def test_reset_forgets(airframe: AirframeConfig) -> None:
    trim = airframe.trim
    level = sensed(
        rotation_from_euler(0.0, trim.alpha_rad, 0.0), np.zeros(3), np.array([trim.airspeed_m_s, 0.0, 0.0])
    )
    loops = InnerLoops(airframe, DT)
    fresh = loops.step(0.1, trim.alpha_rad, 0.5, level)
    for _ in range(50):
        loops.step(0.3, 0.2, 0.9, level)
    loops.reset()
    np.testing.assert_array_equal(loops.step(0.1, trim.alpha_rad, 0.5, level), fresh)


def test_trim_asks_for_the_trim_effectors(airframe: AirframeConfig) -> None:
    trim = airframe.trim
    level = sensed(
        rotation_from_euler(1.0, trim.alpha_rad, 0.0), np.zeros(3),
        trim.airspeed_m_s * np.array([math.cos(1.0), math.sin(1.0), 0.0]),
    )
    loops = InnerLoops(airframe, DT)
    for _ in range(20):
        np.testing.assert_allclose(loops.step(0.0, trim.alpha_rad, trim.throttle, level), trim.effectors, atol=1e-9)


@given(st.lists(st.floats(-5, 5), min_size=12, max_size=12))
def test_three_unknowns_are_solved(values: list[float]) -> None:
    S = np.array(values[:9]).reshape(3, 3)
    M = S @ S.T + 0.5 * np.eye(3)
    x = np.array([1.0, -2.0, 3.0])
    add_solution(M, np.array(values[9:]), x)
    np.testing.assert_allclose(M @ (x - [1.0, -2.0, 3.0]), values[9:], atol=1e-7)
