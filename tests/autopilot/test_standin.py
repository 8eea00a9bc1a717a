"""The whole stand-in autopilot flying the simulated receiver, told by real MAVLink frames."""

import math

import numpy as np
import pytest

from companion.config import Setup
from companion.geometry import euler_from_rotation, rotation_from_euler
from companion.io.datalink import FRAME_SIZE, FrameParser, encode_frame
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from companion.messages import TankerState
from sim_bridge.autopilot import StandInAutopilot, TankerReporter
from sim_bridge.autopilot.standin import THESIS_SENSORS
from sim_bridge.plant.world import World
from sim_bridge.scenario import load_scenario
from sim_bridge.sensor_conditions import AircraftSensors, Outage
from sim_bridge.truth import BodyState

NS = 1_000_000_000
LINK_EVERY = 10  # steps: setpoints at 20 Hz


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_scenario("docking").setup()


class Flight:
    """World and autopilot in a loop, as ``sim_bridge.simulation`` closes it."""

    def __init__(
        self, setup: Setup, turbulence: str = "none", seed: int = 1, sensors: AircraftSensors = THESIS_SENSORS
    ) -> None:
        gust, own = np.random.default_rng(seed).spawn(2)
        self.world = World(setup.tanker, setup.airframe, (-50.0, -20.0, 30.0), turbulence, False, gust)
        self.autopilot = StandInAutopilot(setup.airframe, own, sensors=sensors)
        self.codec = MavlinkCodec(1, 191)
        self.said = b""
        self.effectors: list[np.ndarray] = []

    @property
    def uav(self) -> BodyState:
        return self.world.truth.uav

    @property
    def euler(self) -> tuple[float, float, float]:
        return euler_from_rotation(self.uav.R_ned_body)

    def fly(self, seconds: float, setpoint: Message | None = None) -> None:
        for k in range(round(200 * seconds)):
            truth = self.world.truth
            if setpoint is not None and k % LINK_EVERY == 0:
                self.autopilot.feed(self.codec.pack(setpoint), truth.t_ns)
            self.effectors.append(self.autopilot.step(truth.uav))
            self.said += self.autopilot.outgoing(truth.t_ns)
            self.world.step(self.effectors[-1])

    def heard(self) -> list[Message]:
        return [message for message, _ in MavlinkCodec(1, 191).feed(self.said)]


def attitude_target(roll: float, pitch: float, thrust: float) -> Message:
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    q = [cr * cp, sr * cp, cr * sp, -sr * sp]
    return dialect.MAVLink_set_attitude_target_message(0, 1, 1, 0x07, q, 0.0, 0.0, 0.0, thrust)


def position_target(p: np.ndarray, v: np.ndarray) -> Message:
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, dialect.MAV_FRAME_LOCAL_NED, 0x0DC0, *p.tolist(), *v.tolist(), 0.0, 0.0, 0.0, 0.0, 0.0
    )


def test_alone_it_keeps_wings_level_and_speed_in_turbulence(setup: Setup) -> None:
    flight = Flight(setup, "light")
    flight.fly(20.0)
    assert abs(flight.euler[2]) < 0.05
    assert abs(flight.uav.v_ned_m_s[2]) < 2.0
    assert np.linalg.norm(flight.uav.v_ned_m_s) == pytest.approx(setup.airframe.trim.airspeed_m_s, abs=2.0)


def test_attitude_is_flown_and_wings_go_level_when_setpoints_stop(setup: Setup) -> None:
    flight = Flight(setup)
    trim = setup.airframe.trim
    flight.fly(3.0, attitude_target(0.2, trim.alpha_rad + 0.01, trim.throttle))
    assert flight.euler[2] == pytest.approx(0.2, abs=0.01)
    assert flight.euler[1] == pytest.approx(trim.alpha_rad + 0.01, abs=0.01)
    flight.fly(0.4)
    assert flight.euler[2] == pytest.approx(0.2, abs=0.01)  # the last setpoint is still alive
    flight.fly(3.0)
    assert flight.euler[2] == pytest.approx(0.0, abs=0.01)
    texts = [m.text for m in flight.heard() if m.get_type() == "STATUSTEXT"]
    assert texts == ["following setpoints", "setpoints lost: holding wings level and speed"]


def test_moving_point_is_joined_by_position_and_velocity(setup: Setup) -> None:
    flight = Flight(setup, "light")
    v = flight.world.truth.tanker.v_ned_m_s
    start = flight.uav.p_ned_m + np.array([6.0, 10.0, -8.0])
    for k in range(800):
        point = start + v * (flight.world.truth.t_ns / NS)
        flight.fly(0.05, position_target(point, v))
        if k > 600:
            away = flight.uav.p_ned_m - start - v * (flight.world.truth.t_ns / NS)
            assert np.linalg.norm(away) < 2.5  # guidance takes over from there


def test_told_state_is_the_true_one_within_its_noise(setup: Setup) -> None:
    flight, truth = Flight(setup, "light"), {}
    for _ in range(200):
        truth[flight.uav.t_ns] = flight.uav
        flight.fly(0.005)
    told = [m for m in flight.heard() if m.get_type() == "LOCAL_POSITION_NED"]
    assert len(told) == 45  # none in the 0.1 s before the first fix arrives
    for m in told:
        true = truth[m.time_boot_ms * 1_000_000]
        assert np.abs(np.array([m.x, m.y, m.z]) - true.p_ned_m).max() < 0.5
        assert np.abs(np.array([m.vx, m.vy, m.vz]) - true.v_ned_m_s).max() < 0.25


def test_without_gps_it_dead_reckons_and_says_so(setup: Setup) -> None:
    sensors = AircraftSensors(gps_outages=(Outage(from_s=2.0, until_s=5.0),))
    flight = Flight(setup, "light", sensors=sensors)
    ask = dialect.MAVLink_command_long_message(
        1, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS, 1e5, 0, 0, 0, 0, 0
    )
    flight.autopilot.feed(flight.codec.pack(ask), 0)
    truth = {}
    for _ in range(1400):
        truth[flight.uav.t_ns] = flight.uav
        flight.fly(0.005)
    heard = flight.heard()
    assert [m.text for m in heard if m.get_type() == "STATUSTEXT"] == ["GPS lost: dead reckoning", "GPS is back"]
    fixes = [m for m in heard if m.get_type() == "GPS_RAW_INT" and m.time_usec > 0.5e6]
    without = [m.time_usec * 1e-6 for m in fixes if m.fix_type == dialect.GPS_FIX_TYPE_NO_FIX]
    assert min(without) == pytest.approx(2.5, abs=0.15)
    assert max(without) == pytest.approx(5.0, abs=0.15)
    assert len(without) == pytest.approx(26, abs=2)
    status = [m for m in heard if m.get_type() == "ESTIMATOR_STATUS"]
    absolute = {bool(m.flags & dialect.ESTIMATOR_POS_HORIZ_ABS) for m in status if 3.0 < m.time_usec * 1e-6 < 5.0}
    assert absolute == {False}
    assert status[-1].flags & dialect.ESTIMATOR_POS_HORIZ_ABS
    healthy = [m.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_SENSOR_GPS for m in heard
               if m.get_type() == "SYS_STATUS"]
    assert {bool(h) for h in healthy} == {False, True}
    told = [m for m in heard if m.get_type() == "LOCAL_POSITION_NED"]
    assert np.diff([m.time_boot_ms for m in told]).max() == 20  # positions go on coming
    for m in told:
        away = np.array([m.x, m.y, m.z]) - truth[m.time_boot_ms * 1_000_000].p_ned_m
        assert np.abs(away).max() < 0.6


def test_same_seed_gives_the_same_bits_and_another_does_not(setup: Setup) -> None:
    def run(seed: int) -> tuple[bytes, bytes]:
        flight = Flight(setup, "light", seed)
        flight.fly(2.0, attitude_target(0.05, 0.08, 0.6))
        return flight.said, np.array(flight.effectors).tobytes()

    assert run(1) == run(1)
    assert run(1) != run(2)


def tanker_at(t_ns: int) -> BodyState:
    v = np.array([205.7, 0.0, 0.0])
    return BodyState(
        t_ns, v * (t_ns / NS), v, rotation_from_euler(0.0, 0.05, 0.0), np.zeros(3), np.array([0.0, 0.0, -9.8]), v
    )


def reports(rate_hz: float, seconds: float, seed: int = 1) -> list[TankerState]:
    reporter = TankerReporter(np.random.default_rng(seed), rate_hz)
    states = [reporter.step(tanker_at(k * 5_000_000)) for k in range(round(200 * seconds))]
    return [state for state in states if state is not None]


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 35.0])
def test_tanker_reports_at_its_rate_and_true_at_the_stamp(rate_hz: float) -> None:
    states = reports(rate_hz, 10.1)
    assert len(states) == pytest.approx(10 * rate_hz, abs=1)
    for state in states:
        truth = tanker_at(state.t_ns)
        assert np.abs(state.p_ned_m - truth.p_ned_m).max() < 0.5
        assert np.abs(state.v_ned_m_s - truth.v_ned_m_s).max() < 0.25
        assert np.abs(state.R_ned_tanker - truth.R_ned_body).max() < 1e-3


def test_tanker_reports_fit_the_datalink_and_come_through_its_frames() -> None:
    states = reports(25.0, 4.0)
    frames = [encode_frame(state) for state in states]
    assert load_scenario("docking").datalink.rate_baud > 25.0 * FRAME_SIZE * 10
    received = FrameParser().feed(b"".join(frames))
    assert len(received) == len(states)
    back = received[-1].to_state(states[-1].t_ns, 0.0)
    np.testing.assert_allclose(back.p_ned_m, states[-1].p_ned_m, atol=1e-3)
    np.testing.assert_allclose(back.v_ned_m_s, states[-1].v_ned_m_s, atol=1e-3)


def test_tankers_noise_is_its_own() -> None:
    assert not np.array_equal(reports(25.0, 0.3, 1)[0].p_ned_m, reports(25.0, 0.3, 2)[0].p_ned_m)
