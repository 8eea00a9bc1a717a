"""Actuators of thesis 3.5: saturation, pure delay, first-order lag and rate limit for every input."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from sim_bridge.truth import EFFECTORS

DEG = math.pi / 180.0
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Channel:
    """One actuator. Limits and rate in the unit of its command (throttle 0..1, surfaces rad)."""

    low: float
    high: float
    rate_per_s: float
    lag_s: float
    delay_s: float = 0.01


FLAP = Channel(-30 * DEG, 30 * DEG, 150 * DEG, 0.02)
ONE_SIDED = Channel(0.0, 60 * DEG, 150 * DEG, 0.02)
LEADING_EDGE = Channel(-40 * DEG, 40 * DEG, 40 * DEG, 0.05)
THROTTLE = Channel(0.0, 1.0, 0.5, 0.4)
"""Where the numbers come from. Limits and rates of the surfaces: the ICE reports, recalled (no text of theirs was at
hand to check them). Lags of the surfaces: servos of 50 rad/s, of the leading edge 20 rad/s, estimated. Throttle: thrust
of a turbofan at mid power follows a small step in about 0.4 s and goes from idle to full in 2 s, estimated. Delays: two
frames of a 200 Hz bus, estimated; the thesis (3.5) names saturation, rate limit, delay and filter but no figures."""


def default_channels() -> tuple[Channel, ...]:
    """Return the channels in the order of ``sim_bridge.truth.EFFECTORS``."""
    kinds = {"throttle": THROTTLE, "amt": ONE_SIDED, "ssd": ONE_SIDED, "tef": FLAP, "pf": FLAP, "lef": LEADING_EDGE}
    return tuple(kinds[name.split("_", maxsplit=1)[0]] for name in EFFECTORS)


@dataclass(frozen=True, slots=True)
class ActuatorConfig:
    """All ten channels, in the order of ``sim_bridge.truth.EFFECTORS``."""

    channels: tuple[Channel, ...] = field(default_factory=default_channels)

    def with_delay(self, extra_s: float) -> ActuatorConfig:
        """Return the same actuators, each later by ``extra_s``."""
        return ActuatorConfig(tuple(replace(c, delay_s=c.delay_s + extra_s) for c in self.channels))


class Actuators:
    """Bank of actuators; ``position`` (10,) is where they are now."""

    def __init__(self, start: Vec, dt_s: float, config: ActuatorConfig | None = None) -> None:
        """Start at rest at ``start`` (10,), with the same command already in the delay lines."""
        channels = (config or ActuatorConfig()).channels
        self.low = np.array([c.low for c in channels])
        self.high = np.array([c.high for c in channels])
        self._step_max = np.array([c.rate_per_s * dt_s for c in channels])
        self._share = np.array([1.0 - math.exp(-dt_s / c.lag_s) if c.lag_s > 0 else 1.0 for c in channels])
        self._delay = np.array([round(c.delay_s / dt_s) for c in channels])
        self.position = np.clip(np.asarray(start, dtype=np.float64), self.low, self.high)
        self._line = np.tile(self.position, (int(self._delay.max()) + 1, 1))
        self._at = 0

    def step(self, command: Vec) -> bool:
        """Advance one step towards ``command`` (10,); return False, and stay, when a value is not finite."""
        self._at = (self._at + 1) % self._line.shape[0]
        return advance(
            command, self._line, self._at, self._delay, self.low, self.high, self._share, self._step_max, self.position
        )


@njit(cache=True, nogil=True)
def advance(
    command: Vec, line: Mat, at: int, delay: Counts, low: Vec, high: Vec, share: Vec, step_max: Vec, position: Vec
) -> bool:
    """Put ``command`` into row ``at`` of the delay ``line`` and move ``position`` by one step; all (n,) per channel."""
    n = position.shape[0]
    for i in range(n):
        if not np.isfinite(command[i]):
            return False
    for i in range(n):
        line[at, i] = min(max(command[i], low[i]), high[i])
        wanted = line[(at - delay[i]) % line.shape[0], i]
        move = (wanted - position[i]) * share[i]
        position[i] += min(max(move, -step_max[i]), step_max[i])
    return True
