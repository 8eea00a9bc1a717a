from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_bridge.plant.actuators import ActuatorConfig, Actuators, Channel, default_channels

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


def test_throttle_is_slower_than_every_surface() -> None:
    throttle, *surfaces = default_channels()
    assert all(throttle.lag_s > 5 * c.lag_s for c in surfaces)


def test_not_a_number_moves_nothing() -> None:
    bank = Actuators(NEUTRAL, DT)
    command = NEUTRAL + 0.05
    command[7] = math.nan
    assert not bank.step(command)
    np.testing.assert_array_equal(bank.position, NEUTRAL)
    for _ in range(10):
        assert bank.step(NEUTRAL)
    np.testing.assert_allclose(bank.position, NEUTRAL)
