from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.config import AirframeConfig, TankerConfig
from companion.geometry import euler_from_rotation, exp_so3
from sim_bridge.autopilot.inner_loops import InnerLoops, perfect
from sim_bridge.plant.fdm import Fdm, InitialCondition, PlantError
from sim_bridge.plant.gusts import GustField
from sim_bridge.plant.world import UAV_INPUTS, World
from sim_bridge.truth import BodyState, Truth

MakeWorld = Callable[..., World]
DT = 0.005
G = 9.80665


def fly(world: World, airframe: AirframeConfig, seconds: float, roll: float = 0.0) -> list[Truth]:
    """Fly constant attitude commands; return the truth at every step, the start included."""
    loops = InnerLoops(airframe, DT)
    truths = [world.truth]
    for _ in range(round(seconds / DT)):
        world.step(loops.step(roll, airframe.trim.alpha_rad, airframe.trim.throttle, perfect(truths[-1].uav)))
        truths.append(world.truth)
    return truths


def numbers(truth: Truth) -> np.ndarray:
    parts: list[np.ndarray] = []
    for body in (truth.uav, truth.tanker):
        parts.extend((body.p_ned_m, body.v_ned_m_s, body.R_ned_body.ravel(), body.omega_body_rad_s))
        parts.extend((body.specific_force_body_m_s2, body.v_air_body_m_s))
    return np.concatenate((truth.uav_effectors, *parts))


def test_start_is_as_asked(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    world = make_world(heading_rad=2.0, turbulence="none", wake=False)
    truth = world.truth
    assert truth.t_ns == 0
    np.testing.assert_array_equal(truth.tanker.p_ned_m, 0.0)
    start = truth.tanker.T_ned_body().inverse().transform(truth.uav.p_ned_m)
    np.testing.assert_allclose(start, [-50.0, -20.0, 30.0], atol=1e-9)
    for body in (truth.uav, truth.tanker):
        np.testing.assert_allclose(
            body.v_ned_m_s, airframe.trim.airspeed_m_s * np.array([math.cos(2.0), math.sin(2.0), 0.0]), atol=1e-9
        )
        np.testing.assert_allclose(body.R_ned_body @ body.specific_force_body_m_s2, [0, 0, -G], atol=0.05)
    world.step(truth.uav_effectors)
    assert world.truth.t_ns == 5_000_000


def test_motion_obeys_newton(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    truths = fly(make_world(), airframe, 8.0, roll=0.2)
    for name in ("uav", "tanker"):
        bodies: list[BodyState] = [getattr(t, name) for t in truths]
        p, v = (np.array([getattr(b, field) for b in bodies]) for field in ("p_ned_m", "v_ned_m_s"))
        # Simpson's rule over the velocities: position is their integral to well under a millimetre.
        travelled = DT / 3 * (v[:-2:2] + 4 * v[1:-1:2] + v[2::2]).sum(axis=0)
        np.testing.assert_allclose(p[-1] - p[0], travelled, atol=2e-5)
        # What the accelerometer feels, plus gravity, is the rate of change of velocity.
        felt = np.array([b.R_ned_body @ b.specific_force_body_m_s2 for b in bodies])
        felt[:, 2] += G
        gained = DT * (0.5 * (felt[1:] + felt[:-1])).sum(axis=0)
        np.testing.assert_allclose(v[-1] - v[0], gained, atol=0.02)
        # Its power is the rate of change of energy.
        energy = 0.5 * (v**2).sum(axis=1) - G * p[:, 2]
        power = np.array([b.specific_force_body_m_s2 @ b.R_ned_body.T @ b.v_ned_m_s for b in bodies])
        np.testing.assert_allclose(energy[-1] - energy[0], DT * (0.5 * (power[1:] + power[:-1])).sum(), atol=2.0)
        # Attitude turns at the body rates.
        for a, b in zip(bodies[::40], bodies[1::40], strict=False):
            turn = exp_so3(DT * 0.5 * (a.omega_body_rad_s + b.omega_body_rad_s))
            np.testing.assert_allclose(a.R_ned_body @ turn, b.R_ned_body, atol=5e-5)


def test_same_seed_is_the_same_flight_also_side_by_side(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    alone = [numbers(t) for t in fly(make_world(seed=4), airframe, 2.0, roll=0.1)]
    first, second = make_world(seed=4), make_world(seed=4)
    loops = InnerLoops(airframe, DT), InnerLoops(airframe, DT)
    for expected in alone[:-1]:
        for world, law in zip((first, second), loops, strict=True):
            np.testing.assert_array_equal(numbers(world.truth), expected)
            world.step(law.step(0.1, airframe.trim.alpha_rad, airframe.trim.throttle, perfect(world.truth.uav)))
    other = numbers(fly(make_world(seed=5), airframe, 2.0, roll=0.1)[-1])
    assert np.abs(other - alone[-1]).max() > 1e-3


def test_both_aircraft_meet_the_same_gusts_one_after_the_other(
    make_world: MakeWorld, airframe: AirframeConfig
) -> None:
    truths = fly(make_world(seed=7, wake=False, heading_rad=0.7), airframe, 20.0)

    def gusts(name: str) -> tuple[np.ndarray, np.ndarray]:
        bodies: list[BodyState] = [getattr(t, name) for t in truths]
        along = [b.p_ned_m[0] * math.cos(0.7) + b.p_ned_m[1] * math.sin(0.7) for b in bodies]
        return np.array(along), np.array([b.v_ned_m_s - b.R_ned_body @ b.v_air_body_m_s for b in bodies])

    along_t, air_t = gusts("tanker")
    along_u, air_u = gusts("uav")
    assert 49.0 < (along_t - along_u)[0] < 53.0
    inside = (along_u > along_t[0] + 5) & (along_u < along_t[-1])
    for axis in range(3):
        seen = np.interp(along_u[inside], along_t, air_t[:, axis])
        # 20 m to the side and 30 m below the tanker's track: Dryden's correlation at 36 m is 0.90 to 0.93.
        assert 0.1 < np.std(seen - air_u[inside, axis]) < 0.65
        assert air_t[:, axis].std() > 0.3
    expected = GustField("light", np.random.default_rng(7), 0.7)
    for name, air, span_m in (("tanker", air_t, 39.88), ("uav", air_u, 11.43)):
        n, e, d = getattr(truths[1999], name).p_ned_m
        R = getattr(truths[1999], name).R_ned_body
        yaw = math.atan2(R[1, 0], R[0, 0])
        north, east, down, *_ = expected.at(n, e, d, math.cos(yaw), math.sin(yaw), span_m)
        # The gust is set one step before it acts; the truth rounds through feet.
        np.testing.assert_allclose(air[2000], (north, east, down), atol=1e-6)


def test_mirrored_flight_is_the_mirror_image(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    right = make_world(turbulence="none", start=(-40.0, 12.0, 15.0))
    left = make_world(turbulence="none", start=(-40.0, -12.0, 15.0))
    swap = [0, 2, 1, 4, 3, 6, 5, 7, 9, 8]
    flip, turn = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    rng = np.random.default_rng(2)
    for _ in range(300):
        command = np.array(airframe.trim.effectors) + rng.normal(0.0, 0.02, 10)
        right.step(command)
        left.step(command[swap])
    r, m = right.truth.uav, left.truth.uav
    np.testing.assert_allclose(r.p_ned_m, flip * m.p_ned_m, atol=1e-7)
    np.testing.assert_allclose(r.v_ned_m_s, flip * m.v_ned_m_s, atol=1e-7)
    np.testing.assert_allclose(r.omega_body_rad_s, turn * m.omega_body_rad_s, atol=1e-8)
    np.testing.assert_allclose(r.R_ned_body, flip[:, None] * m.R_ned_body * flip, atol=1e-8)
    assert abs(r.p_ned_m[1] - 12.0) > 1e-3  # it did go somewhere


def test_heading_changes_nothing(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    north = fly(make_world(heading_rad=0.0), airframe, 5.0, roll=-0.1)[-1]
    other = fly(make_world(heading_rad=-2.5), airframe, 5.0, roll=-0.1)[-1]
    for a, b in ((north.uav, other.uav), (north.tanker, other.tanker)):
        np.testing.assert_allclose(a.specific_force_body_m_s2, b.specific_force_body_m_s2, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(a.p_ned_m), np.linalg.norm(b.p_ned_m), atol=1e-5)


def test_tanker_flies_straight_for_minutes(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    world = make_world(seed=11, turbulence="light", heading_rad=1.0, start=(-300.0, 0.0, 200.0))
    loops = InnerLoops(airframe, DT)
    track = []
    for k in range(round(180.0 / DT)):
        truth = world.truth
        world.step(loops.hold_step(perfect(truth.uav)))
        if k % 20 == 0:
            yaw, pitch, roll = euler_from_rotation(truth.tanker.R_ned_body)
            speed = float(np.linalg.norm(truth.tanker.v_ned_m_s))
            uav_roll = euler_from_rotation(truth.uav.R_ned_body)[2]
            track.append((yaw - 1.0, pitch, roll, truth.tanker.p_ned_m[2], speed, uav_roll))
    yaws, pitches, rolls, down, speeds, uav_rolls = np.array(track).T
    assert np.abs(yaws).max() < 0.05
    assert np.abs(rolls).max() < 0.08
    assert np.abs(down).max() < 15.0
    assert np.abs(speeds - airframe.trim.airspeed_m_s).max() < 1.5
    assert 0.0 < pitches.mean() < 0.06
    assert np.abs(uav_rolls).max() < 0.05  # and the receiver's fallback keeps its wings level all that time


def test_wake_pulls_the_receiver_down(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    near = {"turbulence": "none", "start": (-29.0, 0.0, 9.0)}
    clean, disturbed = (fly(make_world(wake=wake, **near), airframe, 3.0)[-1].uav for wake in (False, True))
    assert disturbed.p_ned_m[2] > clean.p_ned_m[2] + 0.3
    assert disturbed.v_ned_m_s[0] < clean.v_ned_m_s[0]


def test_boom_hangs_ready_clear_of_the_box(
    make_world: MakeWorld, tanker: TankerConfig, airframe: AirframeConfig
) -> None:
    world = make_world()
    for _ in range(400):
        world.step(np.array(airframe.trim.effectors))
    boom = world.truth.boom
    assert boom.elevation_rad == pytest.approx(tanker.boom.elevation_rad, abs=0.02)
    assert boom.azimuth_rad == pytest.approx(0.0, abs=0.02)
    assert boom.length_m == pytest.approx(tanker.boom.ready_length_m, abs=0.05)
    gap = np.array(tanker.box_tanker_m) - boom.tip_tanker_m()
    assert np.linalg.norm(gap) > 1.0


def test_command_that_is_not_a_number_is_refused(make_world: MakeWorld, airframe: AirframeConfig) -> None:
    world = make_world()
    command = np.array(airframe.trim.effectors)
    command[3] = math.nan
    with pytest.raises(PlantError, match="effector command is not a finite number"):
        world.step(command)


def test_state_that_is_not_a_number_is_noticed() -> None:
    fdm = Fdm("ice101", UAV_INPUTS, DT, 6000.0)
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), (205.0, 0.0, 13.0), (0.0, 0.06, 0.0)))
    fdm.set_gust(math.nan, 0.0, 0.0)
    fdm.step()  # the gust acts on the forces of this step, and they on the motion of the next
    with pytest.raises(PlantError, match="'ice101' are no longer finite"):
        fdm.step()


def test_missing_aircraft_and_property_are_named(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PlantError, match="cannot load aircraft 'nimbus'"):
        Fdm("nimbus", (), DT, 6000.0)
    with pytest.raises(PlantError, match="'ice101' has no property 'effector/rudder'"):
        Fdm("ice101", ("effector/rudder",), DT, 6000.0)
    capfd.readouterr()
