"""Offsets (law ``surfaces``) through the vehicle: what is obeyed, what is refused, and how the laws take over."""

import math
from collections import Counter

import msgspec
import numpy as np
import pytest
from level_flight import STEP_NS, Quiet, airframe, state_at

from companion.config import Setup
from companion.geometry import euler_from_rotation
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from companion.io.telemetry import setpoint_message
from companion.messages import AttitudeSetpoint, OffsetSetpoint
from sim_bridge.autopilot import StandInAutopilot
from sim_bridge.autopilot.setpoints import OffsetCommand
from sim_bridge.autopilot.standin import HandOver
from sim_bridge.autopilot.vehicle import SETPOINT_LIFE_NS, Vehicle
from sim_bridge.plant.world import World
from sim_bridge.scenario import load_scenario
from sim_bridge.sensors import InertialSensor

NOW_MS = 10_000
OFFSET, PLACE_V, YAW = (3.0, -2.0, 0.5), (200.0, 30.0, -1.0), 0.25


def message(time_boot_ms: int = NOW_MS - 20) -> Message:
    """Return the message that the companion sends."""
    built = setpoint_message(OffsetSetpoint(0, OFFSET, PLACE_V, YAW), time_boot_ms, (1, 1))
    assert isinstance(built, dialect.MAVLink_set_position_target_local_ned_message)
    return built


def told(built: Message, t_ns: int = NOW_MS * 1_000_000) -> tuple[object, Counter[str]]:
    """Return what the vehicle flies after a message, and what it refused."""
    vehicle = Vehicle(airframe())
    vehicle.feed(MavlinkCodec(1, 191).pack(built), t_ns)
    truth = state_at(t_ns)
    return vehicle.step(InertialSensor(Quiet()).sample(truth), None), vehicle.rejects


def test_companions_offset_is_obeyed_at_its_own_instant() -> None:
    command, rejects = told(message())
    assert isinstance(command, OffsetCommand)
    assert not rejects
    assert command.t_ns == (NOW_MS - 20) * 1_000_000
    np.testing.assert_allclose(command.offset_ned_m, OFFSET, rtol=1e-6)
    np.testing.assert_allclose(command.v_ned_m_s, PLACE_V, rtol=1e-6)
    assert command.heading_rad == pytest.approx(YAW)


@pytest.mark.parametrize("field", ["x", "y", "z", "vx", "vy", "vz", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_offset_that_is_not_finite_is_refused(field: str, value: float) -> None:
    built = message()
    setattr(built, field, value)
    assert told(built) == (None, Counter({"not_finite": 1}))


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("x", 300.0, "out_of_range"),
        ("vz", 400.0, "out_of_range"),
        ("type_mask", 0x0DC0, "unsupported_mask"),
        ("coordinate_frame", dialect.MAV_FRAME_BODY_OFFSET_NED, "unsupported_frame"),
        ("time_boot_ms", NOW_MS - 501, "bad_time"),
        ("time_boot_ms", NOW_MS + 51, "bad_time"),
        ("time_boot_ms", 0, "bad_time"),
    ],
)
def test_offset_that_cannot_be_flown_is_refused(field: str, value: float, reason: str) -> None:
    built = message()
    setattr(built, field, value)
    assert told(built) == (None, Counter({reason: 1}))


def test_instant_is_right_when_milliseconds_wrap() -> None:
    t_ns = (2**32 + 5) * 1_000_000
    command, _ = told(message(2**32 - 15), t_ns)
    assert isinstance(command, OffsetCommand)
    assert t_ns - command.t_ns == 20_000_000


def test_offset_dies_after_its_life() -> None:
    vehicle, sensor = Vehicle(airframe()), InertialSensor(Quiet())
    vehicle.feed(MavlinkCodec(1, 191).pack(message(0)), 0)
    for k in range(SETPOINT_LIFE_NS // STEP_NS + 2):
        command = vehicle.step(sensor.sample(state_at(k * STEP_NS)), None)
        assert (command is not None) == (k * STEP_NS <= SETPOINT_LIFE_NS)


def test_difference_of_two_laws_fades_from_the_first_step_on() -> None:
    hand_over = HandOver(0.5)
    first, second = np.full(10, 1.0), np.full(10, 3.0)
    assert not hand_over.begins(False)
    np.testing.assert_array_equal(hand_over.smooth(first), first)
    assert hand_over.begins(True)
    said = []
    for k in range(4):
        assert k == 0 or not hand_over.begins(True)
        said.append(hand_over.smooth(second)[0])
    assert said == [1.0, 2.0, 2.5, 2.75]


class Flight:
    """World and autopilot, told offsets to where the receptacle began, or attitude."""

    def __init__(self, setup: Setup, seed: int) -> None:
        gust, own = np.random.default_rng(seed).spawn(2)
        self.world = World(setup.tanker, setup.airframe, (-50.0, -20.0, 30.0), "light", False, gust)
        self.autopilot = StandInAutopilot(setup.airframe, own)
        self.codec = MavlinkCodec(1, 191)
        self.arm = np.array(setup.airframe.receptacle_frd_m)
        self.trim = setup.airframe.trim
        self.start = self.receptacle()
        self.commands: list[np.ndarray] = []
        self.rolls: list[float] = []

    def receptacle(self) -> np.ndarray:
        uav = self.world.truth.uav
        return uav.p_ned_m + uav.R_ned_body @ self.arm

    def away(self) -> np.ndarray:
        """Return the way from the receptacle to its place."""
        V0 = self.trim.airspeed_m_s
        return self.start + np.array((V0, 0.0, 0.0)) * (self.world.truth.t_ns * 1e-9) - self.receptacle()

    def fly(self, seconds: float, law: str | None) -> None:
        for k in range(round(200 * seconds)):
            truth = self.world.truth
            if law is not None and k % 4 == 0:
                self.autopilot.feed(self.codec.pack(self.setpoint(law)), truth.t_ns)
            self.commands.append(self.autopilot.step(truth.uav))
            self.rolls.append(euler_from_rotation(truth.uav.R_ned_body)[2])
            self.world.step(self.commands[-1])

    def setpoint(self, law: str) -> Message:
        t_ns = self.world.truth.t_ns
        x, y, z = self.away().tolist()
        offset = OffsetSetpoint(t_ns, (x, y, z), (self.trim.airspeed_m_s, 0.0, 0.0), 0.0)
        level = AttitudeSetpoint(t_ns, 0.0, self.trim.alpha_rad, 0.0, self.trim.throttle)
        built = setpoint_message(offset if law == "surfaces" else level, t_ns // 1_000_000, (1, 1))
        assert not isinstance(built, msgspec.Struct)
        return built


def test_laws_take_over_from_each_other_without_a_jump() -> None:
    flight = Flight(load_scenario("docking").setup(), 3)
    switches = []
    for law, seconds in ((None, 2.0), ("surfaces", 5.0), ("attitude", 3.0), ("surfaces", 6.0), (None, 3.0)):
        switches.append(len(flight.commands))
        flight.fly(seconds, law)
        if law == "surfaces":
            assert np.abs(flight.away()).max() < 1.0
    switches[-1] += SETPOINT_LIFE_NS // STEP_NS  # the last offset lives on
    steps = np.abs(np.diff(np.array(flight.commands), axis=0)).max(axis=1)
    for k in switches[1:]:
        assert steps[k - 1 : k + 2].max() < 2.0 * np.sort(steps)[-200] + 0.005
    assert max(map(abs, flight.rolls)) < 0.15
