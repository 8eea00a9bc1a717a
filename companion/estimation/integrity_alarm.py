"""Means over the last seconds, and alarms that neither flicker nor are forgotten at once."""

from __future__ import annotations

import math

import numpy as np

from companion.geometry import Vec
from companion.messages import NS


class RunningMean:
    """Mean of vectors (k,) with a memory that fades with ``tau_s``; a plain mean until so much time has been seen.

    ``count`` is the number of equal samples whose mean would be as good: noise falls with its root.
    """

    def __init__(self, size: int, tau_s: float) -> None:
        self._size, self._tau_s = size, tau_s
        self.restart()

    def restart(self) -> None:
        """Forget every sample."""
        self.mean: Vec = np.zeros(self._size)
        self.count = 0.0
        self.t_ns: int | None = None

    def add(self, t_ns: int, sample: Vec) -> None:
        """Take one sample; after ``3 tau`` without any the mean begins anew."""
        gap_s = math.inf if self.t_ns is None else max((t_ns - self.t_ns) * NS, 0.0)
        kept, share = faded(gap_s, self._tau_s, self.count)
        self.count = kept
        self.mean = self.mean + share * (sample - self.mean)
        self.t_ns = t_ns

    def fresh(self, t_ns: int, limit_s: float) -> bool:
        """Tell whether there is a mean, and a sample in it at most ``limit_s`` old."""
        return self.t_ns is not None and (t_ns - self.t_ns) * NS <= limit_s


def faded(gap_s: float, tau_s: float, count: float) -> tuple[float, float]:
    """Return what a mean over ``count`` samples counts for with one more after ``gap_s``, and that one's share."""
    if gap_s > 3.0 * tau_s:
        return 1.0, 1.0
    fade = math.exp(-gap_s / tau_s)
    weight = count * fade + 1.0
    return weight, 1.0 / weight


class Alarm:
    """Raised when a test has failed for ``on_s`` without a break, lowered when it has held for ``off_s``."""

    def __init__(self, on_s: float, off_s: float) -> None:
        self._on_ns, self._off_ns = round(on_s / NS), round(off_s / NS)
        self.restart()

    def restart(self) -> None:
        """Begin lowered."""
        self.raised = False
        self._since_ns: int | None = None

    def update(self, t_ns: int, *, fails: bool) -> bool:
        """Take the outcome of the test at an instant and return whether the alarm is raised."""
        if fails == self.raised:
            self._since_ns = None
            return self.raised
        if self._since_ns is None:
            self._since_ns = t_ns
        if t_ns - self._since_ns >= (self._on_ns if fails else self._off_ns):
            self.raised, self._since_ns = fails, None
        return self.raised
