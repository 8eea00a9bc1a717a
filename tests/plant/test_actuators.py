from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import Mat
from sim_bridge.plant.actuators import ActuatorConfig, Actuators, Channel, default_channels
from sim_bridge.truth import EFFECTORS

DT = 0.005
NEUTRAL = np.array([0.5, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1])


@settings(max_examples=40)
@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=10, max_size=10), min_size=1, max_size=40))
def test_limits_and_rates_hold_for_any_commands(commands: list[list[float]]) -> None:
    bank = Actuators(NEUTRAL, DT)
    channels = default_channels()
    before = bank.position.copy()
    for command in commands:
        assert bank.step(np.array(command))
        for channel, old, new in zip(channels, before, bank.position, strict=True):
            assert channel.low <= new <= channel.high
            assert abs(new - old) <= channel.rate_per_s * DT * (1 + 1e-12)
        before = bank.position.copy()


def test_small_step_is_delayed_then_exponential() -> None:
    channel = Channel(low=-1.0, high=1.0, rate_per_s=100.0, lag_s=0.02, delay_s=0.01)
    bank = Actuators(np.zeros(10), DT, ActuatorConfig((channel,) * 10))
    command = np.full(10, 0.01)
    response = []
    for _ in range(20):
        bank.step(command)
        response.append(bank.position[3])
    # The command of the first call shows two steps (10 ms) later, and from then on it is 1 - exp(-t / lag).
    assert response[:2] == [0.0, 0.0]
    t = DT * np.arange(1, 19)
    np.testing.assert_allclose(response[2:], 0.01 * (1 - np.exp(-t / 0.02)), rtol=1e-9)


def test_large_step_moves_at_the_rate() -> None:
    bank = Actuators(NEUTRAL, DT)
    command = NEUTRAL.copy()
    command[3] = math.radians(30)
    for _ in range(2 + 20):
        bank.step(command)
    assert bank.position[3] == pytest.approx(math.radians(150) * 20 * DT)


LIMITS = {
    "throttle": (0.0, 1.0),
    "amt": (0.0, math.radians(60)),
    "tef": (math.radians(-30), math.radians(30)),
    "lef": (math.radians(-40), math.radians(40)),
    "pf": (math.radians(-30), math.radians(30)),
    "ssd": (0.0, math.radians(60)),
}


@pytest.mark.parametrize("index", range(10), ids=EFFECTORS)
def test_each_input_stops_at_its_limits(index: int) -> None:
    low, high = LIMITS[EFFECTORS[index].split("_", maxsplit=1)[0]]
    for command, stop in ((-10.0, low), (10.0, high)):
        bank = Actuators(NEUTRAL, DT)
        commands = NEUTRAL.copy()
        commands[index] = command
        for _ in range(round(8.0 / DT)):
            assert bank.step(commands)
        assert bank.position[index] == pytest.approx(stop, abs=1e-3)
        others = np.arange(10) != index
        np.testing.assert_allclose(bank.position[others], NEUTRAL[others], atol=1e-12)


def test_right_and_left_are_the_same_actuator() -> None:
    by_name = dict(zip(EFFECTORS, default_channels(), strict=True))
    for name, channel in by_name.items():
        if name.endswith("_r"):
            assert by_name[f"{name[:-2]}_l"] == channel


@pytest.mark.parametrize("extra_s", [0.0, 0.02, 0.035])
def test_more_delay_is_the_same_response_later(extra_s: float) -> None:
    def response(config: ActuatorConfig) -> Mat:
        bank = Actuators(NEUTRAL, DT, config)
        track = []
        for _ in range(100):
            bank.step(NEUTRAL + 0.01)
            track.append(bank.position.copy())
        return np.array(track)

    plain = response(ActuatorConfig())
    later = response(ActuatorConfig().with_delay(extra_s))
    n = round(extra_s / DT)
    np.testing.assert_array_equal(later[n:], plain[: 100 - n])
    np.testing.assert_allclose(later[:n], np.tile(NEUTRAL, (n, 1)))


def test_throttle_is_slower_than_every_surface() -> None:
    throttle, *surfaces = default_channels()
    assert all(throttle.lag_s > 5 * c.lag_s for c in surfaces)
    whole = [(c.high - c.low) / c.rate_per_s for c in surfaces]
    # Seconds from stop to stop: the leading edge, made for slow changes of camber, is the only one that comes near.
    assert all((throttle.high - throttle.low) / throttle.rate_per_s >= t for t in whole)


def test_not_a_number_moves_nothing() -> None:
    bank = Actuators(NEUTRAL, DT)
    command = NEUTRAL + 0.05
    command[7] = math.nan
    assert not bank.step(command)
    np.testing.assert_array_equal(bank.position, NEUTRAL)
    for _ in range(10):
        assert bank.step(NEUTRAL)
    np.testing.assert_allclose(bank.position, NEUTRAL)
