"""The two clocks: the machine's own, and one that a simulation sets."""

from __future__ import annotations

import time


class MonotonicClock:
    """The machine's monotonic clock; no step of the wall clock moves it."""

    def now_ns(self) -> int:
        """Return the present instant in ns."""
        return time.monotonic_ns()


class SimulatedClock:
    """A clock that stands still until it is set."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the instant that was set last, in ns."""
        return self._now_ns

    def set_ns(self, now_ns: int) -> None:
        """Move to ``now_ns``; raises ValueError when that is in the past."""
        if now_ns < self._now_ns:
            msg = f"the clock cannot go back from {self._now_ns} ns to {now_ns} ns"
            raise ValueError(msg)
        self._now_ns = now_ns
