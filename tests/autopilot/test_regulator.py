"""The regulator of the surfaces: its design beside oracles, its symmetries, the traps of the law as written."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from regulator_bench import DT_S, fly, share_inside
from scipy.linalg import solve_continuous_are

from companion.config import ConfigError, Setup
from companion.geometry import rotation_from_euler
from sim_bridge.autopilot.lasting_wind import LastingWind
from sim_bridge.autopilot.regulator import (
    LEFT,
    RIGHT,
    CarriedError,
    Cures,
    RegulatorWeights,
    SurfaceRegulator,
    augmented,
    keep_differences,
)
from sim_bridge.autopilot.setpoints import OffsetCommand
from sim_bridge.plant.actuators import default_channels
from sim_bridge.scenario import load_scenario
from sim_bridge.sensors import InertialSample, Triple, velocity_ned

LOW = np.array([c.low for c in default_channels()])
HIGH = np.array([c.high for c in default_channels()])
THESIS = RegulatorWeights(roll_rad=math.inf)


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_scenario("docking").setup()


def sample_of(
    x9: tuple[float, ...], setup: Setup, heading_rad: float = 0.0, t_ns: int = 0, wind: Triple = (0.0, 0.0, 0.0)
) -> InertialSample:  # fmt: skip
    """Return what the INS says in a state (9,) that is ``x9`` away from trim, in air that moves with ``wind``."""
    dV, da, beta, p, q, r, psi, dtheta, phi = x9
    trim = setup.airframe.trim
    V, alpha = trim.airspeed_m_s + dV, trim.alpha_rad + da
    euler = (heading_rad + psi, trim.alpha_rad + dtheta, phi)
    v_ned = tuple(a + b for a, b in zip(velocity_ned(V, alpha, beta, *euler), wind, strict=True))
    side_m_s2 = setup.airframe.A[2][2] * trim.airspeed_m_s * beta
    return InertialSample(t_ns, euler, (p, q, r), V, alpha, beta, v_ned, (0.0, side_m_s2, -9.8), V)


def place(setup: Setup, offset: tuple[float, float, float], heading_rad: float = 0.0, t_ns: int = 0) -> OffsetCommand:
    """Return an offset, in axes of the heading, from a place that flies straight at trim speed."""
    turn = rotation_from_euler(heading_rad, 0.0, 0.0)
    V0 = setup.airframe.trim.airspeed_m_s
    p, v = turn @ np.array(offset), turn @ np.array((V0, 0.0, 0.0))
    return OffsetCommand(t_ns, tuple(p.tolist()), tuple(v.tolist()), heading_rad)


def answer(regulator: SurfaceRegulator, command: OffsetCommand, sample: InertialSample) -> np.ndarray:
    regulator.reset()
    regulator.watch(sample, rotation_from_euler(*sample.euler_rad))
    return regulator.step(command, sample)


small = st.floats(-0.01, 0.01)
states = st.tuples(st.floats(-0.5, 0.5), small, small, *(st.floats(-0.03, 0.03),) * 3, small, small, small)
offsets = st.tuples(*(st.floats(-0.3, 0.3),) * 3)


def test_kinematics_of_the_error_are_those_of_the_receptacle(setup: Setup) -> None:
    """Oracle: e' of the nonlinear motion, by differences about trim."""
    A, _ = augmented(setup.airframe)
    arm = np.array(setup.airframe.receptacle_frd_m)

    def velocity(x9: np.ndarray) -> np.ndarray:
        s = sample_of(tuple(x9.tolist()), setup)
        return np.array(s.v_ned_m_s) + rotation_from_euler(*s.euler_rad) @ np.cross(s.omega_rad_s, arm)

    for k in range(9):
        h = 1e-5 * np.eye(9)[k]
        slope = (velocity(h) - velocity(-h)) / 2e-5
        np.testing.assert_allclose(A[9:12, k], slope, atol=1e-6 * setup.airframe.trim.airspeed_m_s)
    np.testing.assert_array_equal(A[12:15], np.eye(15)[9:12])


@pytest.mark.parametrize("weights", [RegulatorWeights(), THESIS], ids=["in force", "Y as written"])
def test_gain_is_the_optimal_one_and_closes_all_fifteen_states(setup: Setup, weights: RegulatorWeights) -> None:
    """Oracle: the Riccati equation of J (3.11), solved by scipy."""
    A, B = augmented(setup.airframe)
    assert np.linalg.eigvals(A).real.max() > 0.1  # the lateral motion is unstable (3.8)
    K = SurfaceRegulator(setup.airframe, weights=weights).K
    R = np.diag(weights.effort_costs())
    P = solve_continuous_are(A, B, np.diag(weights.state_costs()), R)
    np.testing.assert_allclose(K, np.linalg.solve(R, B.T @ P), rtol=1e-5, atol=1e-6)
    assert np.linalg.eigvals(A - B @ K).real.max() < -0.1


def test_y_as_written_weighs_the_error_and_its_integral_only() -> None:
    assert (np.flatnonzero(THESIS.state_costs()) == np.arange(9, 15)).all()


def test_airframe_without_effectors_is_refused(setup: Setup) -> None:
    dead = msgspec.structs.replace(setup.airframe, B=((0.0,) * 10,) * 9)
    with pytest.raises(ConfigError, match="ice101: no regulator"):
        SurfaceRegulator(dead)


def test_trim_is_added_back(setup: Setup) -> None:
    command = place(setup, (0.0, 0.0, 0.0))
    out = answer(SurfaceRegulator(setup.airframe), command, sample_of((0.0,) * 9, setup))
    np.testing.assert_allclose(out, setup.airframe.trim.effectors, atol=1e-9)


@given(states, offsets)
def test_mirrored_flight_is_flown_mirrored(x9: tuple[float, ...], offset: tuple[float, float, float]) -> None:
    setup = SETUP
    regulator = SurfaceRegulator(setup.airframe)
    mirror9 = np.array([1, 1, -1, -1, 1, -1, -1, 1, -1])
    out = answer(regulator, place(setup, offset), sample_of(x9, setup))
    mirrored = answer(
        regulator, place(setup, (offset[0], -offset[1], offset[2])), sample_of(tuple(mirror9 * x9), setup)
    )
    np.testing.assert_allclose(mirrored[RIGHT + LEFT], out[LEFT + RIGHT], atol=2e-4)
    np.testing.assert_allclose(mirrored[[0, 7]], out[[0, 7]], atol=2e-4)


@given(states, offsets, st.floats(-3.1, 3.1))
def test_heading_does_not_matter(x9: tuple[float, ...], offset: tuple[float, float, float], heading: float) -> None:
    setup = SETUP
    regulator = SurfaceRegulator(setup.airframe)
    out = answer(regulator, place(setup, offset), sample_of(x9, setup))
    turned = answer(regulator, place(setup, offset, heading), sample_of(x9, setup, heading))
    np.testing.assert_allclose(turned, out, atol=1e-8)


@given(states, offsets, st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))
def test_lasting_wind_does_not_matter(
    x9: tuple[float, ...], offset: tuple[float, float, float], north: float, east: float
) -> None:
    """Formation and receiver carried by the same wind: the answer is that of calm air."""
    setup = SETUP
    calm = place(setup, offset)
    out = answer(SurfaceRegulator(setup.airframe), calm, sample_of(x9, setup))
    v_n, v_e, v_d = calm.v_ned_m_s
    windy = replace(calm, v_ned_m_s=(v_n + north, v_e + east, v_d))
    got = answer(SurfaceRegulator(setup.airframe), windy, sample_of(x9, setup, wind=(north, east, 0.0)))
    np.testing.assert_allclose(got, out, atol=1e-8)


def test_gusts_stay_out_of_the_wind(setup: Setup) -> None:
    """A probe's airspeed and a side force that swing once in 3 s about a wind of 20 m/s leave it within 0.6 m/s."""
    wind = LastingWind(setup.airframe, DT_S)
    level = sample_of((0.0,) * 9, setup, wind=(-12.0, 16.0, 0.0))
    R_ned_frd = rotation_from_euler(*level.euler_rad)
    off = []
    for k in range(12_000):
        swing = math.sin(2.0 * math.pi / 3.0 * k * DT_S)
        gusty = msgspec.structs.replace(
            level, specific_force_m_s2=(0.0, 0.1 * swing, -9.8), airspeed_m_s=level.airspeed_m_s + 3.0 * swing
        )
        wind.watch(gusty, R_ned_frd)
        off.append((wind.north_m_s + 12.0, wind.east_m_s - 16.0))
    assert np.abs(off[3000:]).max() < 0.6
    assert np.abs(np.mean(off[-3000:], axis=0)).max() < 0.05


@given(st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=10))
def test_differences_of_pairs_fit_the_limits(values: list[float]) -> None:
    wanted = np.array(values)
    got = wanted.copy()
    keep_differences(got, LOW, HIGH)
    pairs = RIGHT + LEFT
    assert (got[pairs] >= LOW[pairs] - 1e-12).all()
    assert (got[pairs] <= HIGH[pairs] + 1e-12).all()
    asked, given_ = wanted[RIGHT] - wanted[LEFT], got[RIGHT] - got[LEFT]
    room = (HIGH - LOW)[RIGHT]
    np.testing.assert_allclose(given_, np.clip(asked, -room, room), atol=1e-12)
    possible = ((wanted >= LOW) & (wanted <= HIGH))[pairs].all()
    assert not possible or np.allclose(got, wanted, atol=1e-12)


def carried(age_s: float, fix_s: float) -> np.ndarray:
    """Return how far the carried error (n, 3) is off when offsets are exact, 50 Hz and ``age_s`` old."""
    arm = np.array((2.0, 0.0, -1.0))
    carry = CarriedError((2.0, 0.0, -1.0), DT_S, fix_s)
    v_place = np.array((200.0, 30.0, 0.0))

    def receptacle(t: float) -> tuple[np.ndarray, np.ndarray, tuple[float, float, float]]:
        euler = (0.3 + 0.02 * math.sin(t), 0.07, 0.2 * math.sin(2.0 * t))
        body = v_place * t + np.array((math.sin(t), 0.5 * math.cos(2.0 * t), 0.3 * t))
        v = v_place + np.array((math.cos(t), -math.sin(2.0 * t), 0.3))
        return body + rotation_from_euler(*euler) @ arm, v, euler

    off, command = [], None
    for k in range(600):
        t = k * DT_S
        here, v, euler = receptacle(t)
        t_ns = round(t * 1e9)
        sample = InertialSample(t_ns, euler, (0, 0, 0), 200.0, 0.0, 0.0, tuple(v.tolist()), (0, 0, 0), 200.0)
        carry.watch(sample, rotation_from_euler(*euler))
        if k % 4 == 0 and t >= age_s:
            then = t - age_s
            offset = v_place * then - receptacle(then)[0]
            command = OffsetCommand(round(then * 1e9), tuple(offset.tolist()), tuple(v_place.tolist()), 0.0)
        if command is not None:
            off.append(np.array(carry.at(command)) - (here - v_place * t))
    return np.array(off)


@pytest.mark.parametrize("age_s", [0.0, 0.023, 0.06, 0.4])
def test_old_offsets_are_carried_to_now_by_the_own_motion(age_s: float) -> None:
    assert np.abs(carried(age_s, 0.1)).max() < 1e-4


def test_integral_waits_while_the_place_is_far_or_effectors_are_at_their_limits(setup: Setup) -> None:
    regulator = SurfaceRegulator(setup.airframe)
    sample = sample_of((0.0,) * 9, setup)
    far = place(setup, (50.0, -50.0, 50.0))
    for k in range(400):
        sample = sample_of((0.0,) * 9, setup, t_ns=k * 5_000_000)
        regulator.watch(sample, rotation_from_euler(*sample.euler_rad))
        regulator.step(far, sample)
    np.testing.assert_array_equal(regulator.integral_m_s, np.zeros(3))


def test_light_turbulence_is_flown_as_well_as_in_the_thesis(setup: Setup) -> None:
    """Sigma of thesis Tab. 1.2 (LHM), on a fix of 1 cm at 20 Hz, 60 ms old when it is flown on."""
    br = fly(setup, 501, 30.0)
    assert len(br) == 6000
    assert (br[2000:].std(axis=0) < (0.217, 0.090, 0.088)).all()
    assert (np.abs(br[2000:].mean(axis=0)) < 0.10).all()
    assert share_inside(br, setup.tanker.window.desired_m, 30.0) == 1.0


def test_y_as_written_holds_too(setup: Setup) -> None:
    br = fly(setup, 502, 20.0, THESIS)
    assert share_inside(br, setup.tanker.window.desired_m, 20.0) == 1.0


def test_far_place_is_flown_to_without_losing_control(setup: Setup) -> None:
    br = fly(setup, 503, 30.0, start_br_m=(-6.0, 5.0, 5.0))
    assert np.abs(br[-1000:]).max() < 0.5


def lost(br: np.ndarray, setup: Setup, seconds: float) -> bool:
    """Tell whether the flight left the limit window of thesis Tab. 1.1."""
    return share_inside(br, setup.tanker.window.limit_m, seconds) < 1.0


def test_flow_angles_of_the_air_are_not_flown_on(setup: Setup) -> None:
    """Trap (a): a probe's alpha and beta look like the aircraft's own motion; the law chases the gusts."""
    as_written = Cures(inertial_flow=False, one_sided=True, true_relative_velocity=False)
    inertial = Cures(inertial_flow=True, one_sided=True, true_relative_velocity=False)
    assert lost(fly(setup, 504, 20.0, cures=as_written, air_data=True), setup, 20.0)
    assert not lost(fly(setup, 504, 20.0, cures=inertial, air_data=True), setup, 20.0)


def test_tips_and_spoilers_only_open(setup: Setup) -> None:
    """Trap (b): without trim bias and pairs that share, what asks for closed spoilers takes roll and yaw away.

    Slowing down and turning at once, with weights that work tips and spoilers hard; and severe gusts with those in use.
    """
    flat = Cures(one_sided=False)
    hard = RegulatorWeights(amt=0.3, ssd=0.3)
    ahead = {"start_br_m": (6.0, -5.0, -5.0)}
    assert np.abs(fly(setup, 505, 15.0, hard, flat, **ahead)[-1]).max() > 10.0
    assert np.abs(fly(setup, 505, 15.0, hard, **ahead)[-1]).max() < 1.0
    assert lost(fly(setup, 514, 15.0, cures=flat, turbulence="severe"), setup, 15.0)
    assert not lost(fly(setup, 514, 15.0, turbulence="severe"), setup, 15.0)


def test_tanker_that_yaws_does_not_look_like_lateral_speed(setup: Setup) -> None:
    """Trap (c): 0.01 rad of the tanker's heading are 2 m/s in the psi frame, if psi is taken for velocity."""
    by_heading = Cures(true_relative_velocity=False)
    swing = {"heading_of_tanker": True, "yaw_swing_rad": 0.01}
    desired = setup.tanker.window.desired_m
    uncured, cured = (fly(setup, 506, 20.0, cures=c, **swing) for c in (by_heading, None))
    assert lost(uncured, setup, 20.0)
    assert share_inside(cured, desired, 20.0) == 1.0


SETUP = load_scenario("docking").setup()
