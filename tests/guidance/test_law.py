"""The docking law flown on its own design model, built from the shipped airframe."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, rotation_from_euler
from companion.guidance.law import DockingLaw, lateral_model, longitudinal_model, sampled, with_delay
from companion.guidance.path import station
from companion.messages import RelativeState

THERE = station(np.zeros(3))
MISMATCH_S = (-0.04, -0.02, 0.0, 0.02, 0.04)


@cache
def shipped():
    setup = load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")
    return setup.airframe, setup.config.guidance


def new_law(**changed):
    airframe, config = shipped()
    return DockingLaw(airframe, msgspec.structs.replace(config, **changed))


@cache
def mirrored_laws():
    return new_law(), new_law()


def relative_state(e_m, v_m_s, pitch_rad, roll_rad, p_rad_s, q_rad_s, t_ns=0, yaw_rad=0.0):
    return RelativeState(
        t_ns, t_ns, np.asarray(e_m, float), np.asarray(v_m_s, float), np.array([205.7, 0.0, 0.0]),
        np.zeros(3), rotation_from_euler(yaw_rad, pitch_rad, roll_rad), np.array([p_rad_s, q_rad_s, 0.0]), 0.0, 0.0,
        SE3.identity(), 20.0, 1.0, 9, np.zeros((3, 3)),
    )


class Aircraft:
    """The design models of ``companion.guidance.law``, sampled at the guidance rate, with a delay of their own."""

    def __init__(self, e_m, delay_s, disturbance_m_s2=(0.0, 0.0, 0.0)):
        self.airframe, config = shipped()
        dt = 1.0 / config.rate_hz
        self.dt_ns = round(1e9 * dt)
        steps = round(delay_s / dt)
        a, b = longitudinal_model(self.airframe)
        d = np.zeros((9, 1))
        d[2], d[3] = disturbance_m_s2[0], disturbance_m_s2[2]
        self.lon_A, self.lon_B = sampled(a, np.hstack([b, d]), dt)
        a, b = lateral_model(self.airframe)
        d = np.zeros((5, 1))
        d[1] = disturbance_m_s2[1]
        self.lat_A, self.lat_B = sampled(a, np.hstack([b, d]), dt)
        self.lon, self.lat = np.zeros(9), np.zeros(5)
        self.lon[:2], self.lat[0] = (e_m[0], e_m[2]), e_m[1]
        self.queue = [(0.0, 0.0, 0.0)] * steps
        self.t_ns = 0

    @property
    def e_m(self):
        return np.array([self.lon[0], self.lat[0], self.lon[1]])

    def state(self):
        lon, lat, trim = self.lon, self.lat, self.airframe.trim
        return relative_state(
            self.e_m, [lon[2], lat[1], lon[3]], trim.alpha_rad + lon[4], lat[2], lat[3], lon[5], self.t_ns
        )

    def fly(self, setpoint):
        trim = self.airframe.trim
        self.queue.append((setpoint.pitch_rad - trim.alpha_rad, setpoint.thrust - trim.throttle, setpoint.roll_rad))
        pitch, thrust, roll = self.queue.pop(0)
        self.lon = self.lon_A @ self.lon + self.lon_B @ [pitch, thrust, 1.0]
        self.lat = self.lat_A @ self.lat + self.lat_B @ [roll, 1.0]
        self.t_ns += self.dt_ns


def delay_of_the_design():
    airframe, config = shipped()
    return airframe.response.delay_s + config.link_delay_s


def closed_loop(law, aircraft, seconds):
    """Return BR (n, 3) of a flight to the box."""
    track = []
    for _ in range(round(seconds * 1e9 / aircraft.dt_ns)):
        aircraft.fly(law.step(aircraft.state(), THERE))
        track.append(aircraft.e_m)
    return np.array(track)


def test_closed_loop_poles_lie_inside_the_unit_circle():
    law = new_law()
    for regulator in (law._lon, law._lat):
        assert len(regulator.closed_poles) == regulator.K.shape[1]
        assert np.abs(regulator.closed_poles).max() < 1.0


@pytest.mark.parametrize("mismatch_s", MISMATCH_S)
def test_an_autopilot_that_is_40_ms_slower_or_faster_than_designed_for_still_settles(mismatch_s):
    aircraft = Aircraft([-1.5, 1.0, 1.2], max(0.0, delay_of_the_design() + mismatch_s))
    track = closed_loop(new_law(), aircraft, 60.0)
    assert (np.abs(track).max(axis=0) < [1.6, 1.1, 1.3]).all()
    assert np.abs(track[-500:]).max() < 0.01


PUSH_M_S2 = (0.03, -0.2, 0.15)
NO_INTEGRAL = {"int_x": 1e-12, "int_y": 1e-12, "int_z": 1e-12}


def pushed(seconds, weights=None, *, blind=False):
    """Return BR (n, 3) under a constant push, and the law; ``blind``: its observer learns nothing of what pushes."""
    law = new_law(weights=msgspec.structs.replace(shipped()[1].weights, **(weights or {})))
    if blind:
        law._disturbance._d_share = np.zeros(3)
    return closed_loop(law, Aircraft([0.0, 0.0, 0.0], delay_of_the_design(), PUSH_M_S2), seconds), law


def test_the_integral_removes_a_constant_disturbance():
    left, _ = pushed(90.0, NO_INTEGRAL, blind=True)
    assert (np.abs(left[-1]) > 0.01).all()  # with (almost) no integral it stands off
    removed, law = pushed(90.0, blind=True)
    assert (np.abs(removed[-1]) < 0.003).all()
    assert (np.abs(law.integral_m_s) > 0.01).all()


def test_the_observer_removes_it_in_seconds():
    seen, _ = pushed(15.0, NO_INTEGRAL)
    blind, _ = pushed(15.0, NO_INTEGRAL, blind=True)
    assert (np.abs(seen[-1]) < 0.002).all()
    assert (np.abs(seen).max(axis=0) < 0.5 * np.abs(blind).max(axis=0)).all()


def test_a_saturated_command_does_not_wind_up():
    law, aircraft = new_law(), Aircraft([-300.0, 300.0, 300.0], delay_of_the_design())
    for _ in range(100):
        aircraft.fly(law.step(aircraft.state(), THERE))
    assert not law.integral_m_s.any()


def test_far_off_the_commands_stay_inside_their_limits_and_it_arrives_without_swinging_past_far():
    config = shipped()[1]
    law, aircraft = new_law(), Aircraft([-15.0, -60.0, 12.0], delay_of_the_design())
    track, cut = [], 0
    for _ in range(6000):
        s = law.step(aircraft.state(), THERE)
        assert abs(s.roll_rad) <= config.max_roll_rad
        assert abs(s.pitch_rad - shipped()[0].trim.alpha_rad) <= config.max_pitch_offset_rad
        assert 0.0 <= s.thrust <= 1.0
        cut += abs(s.roll_rad) == config.max_roll_rad
        aircraft.fly(s)
        track.append(aircraft.e_m)
    assert cut > 25  # the start is saturated, or this says nothing
    assert np.abs(track[-1]).max() < 0.05
    assert np.array(track)[:, 1].max() < 0.05 * 60.0


def test_reset_forgets_everything():
    law = new_law()
    off = relative_state([-1.0, 2.0, 1.0], [0.1, 0.2, 0.3], 0.1, 0.05, 0.01, 0.02)
    first = [law.step(off, THERE) for _ in range(20)]
    law.reset()
    assert [law.step(off, THERE) for _ in range(20)] == first


numbers = st.floats(-2.0, 2.0)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), st.integers(1, 2), st.integers(0, 5), st.data())
def test_with_delay_equals_a_queue_of_commands(n, m, steps, data):
    A, B = data.draw(arrays(float, (n, n), elements=numbers)), data.draw(arrays(float, (n, m), elements=numbers))
    commands = data.draw(arrays(float, (8, m), elements=numbers))
    Ad, Bd = with_delay(A, B, steps)
    assert Ad.shape == (n + m * steps,) * 2
    x, z, queue = np.zeros(n), np.zeros(n + m * steps), [np.zeros(m)] * steps
    for u in commands:
        queue.append(u)
        x = A @ x + B @ queue.pop(0)
        z = Ad @ z + Bd @ u
        assert np.allclose(z[:n], x, rtol=1e-9, atol=1e-9)
        assert np.allclose(z[n:], np.concatenate([*queue, np.zeros(0)]))


small = st.tuples(*[st.floats(-3.0, 3.0)] * 6, *[st.floats(-0.3, 0.3)] * 4)


@settings(max_examples=40, deadline=None)
@given(st.lists(small, min_size=1, max_size=12))
def test_a_mirrored_state_gives_a_mirrored_roll_and_the_same_pitch_and_thrust(samples):
    law, mirror = mirrored_laws()
    law.reset()
    mirror.reset()
    for ex, ey, ez, vx, vy, vz, pitch, roll, p, q in samples:
        a = law.step(relative_state([ex, ey, ez], [vx, vy, vz], pitch, roll, p, q, yaw_rad=0.2), THERE)
        b = mirror.step(relative_state([ex, -ey, ez], [vx, -vy, vz], pitch, -roll, -p, q, yaw_rad=-0.2), THERE)
        assert np.allclose(
            [a.roll_rad, a.pitch_rad, a.thrust, a.yaw_rad], [-b.roll_rad, b.pitch_rad, b.thrust, -b.yaw_rad], atol=1e-12
        )


def test_it_pushes_towards_the_box():
    """Behind: more thrust. Below (z down is positive): nose up. To the left: roll to the right."""
    trim = shipped()[0].trim
    calm = relative_state(np.zeros(3), np.zeros(3), trim.alpha_rad, 0.0, 0.0, 0.0)
    assert new_law().step(replace(calm, p_mrf_br_m=np.array([-1.0, 0.0, 0.0])), THERE).thrust > trim.throttle
    assert new_law().step(replace(calm, p_mrf_br_m=np.array([0.0, 0.0, 1.0])), THERE).pitch_rad > trim.alpha_rad
    assert new_law().step(replace(calm, p_mrf_br_m=np.array([0.0, -1.0, 0.0])), THERE).roll_rad > 0.0
