from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, AirframeConfig, TankerConfig, load
from sim_bridge.plant.world import World


@pytest.fixture(scope="session")
def tanker() -> TankerConfig:
    return load(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig)


@pytest.fixture(scope="session")
def airframe() -> AirframeConfig:
    return load(FIRMWARE_CONFIGS / "airframes" / "ice101.toml", AirframeConfig)


@pytest.fixture
def make_world(tanker: TankerConfig, airframe: AirframeConfig) -> Callable[..., World]:
    def make(
        seed: int = 1,
        turbulence: str = "light",
        wake: bool = True,
        start: tuple[float, float, float] = (-50.0, -20.0, 30.0),
        heading_rad: float = 0.0,
    ) -> World:
        return World(tanker, airframe, start, turbulence, wake, np.random.default_rng(seed), heading_rad)

    return make
