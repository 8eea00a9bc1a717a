"""Measurements in the order of their instants, whatever the order in which they come.

After each measurement of the last ``horizon_s`` the estimate is kept. One that comes late is put in its place and all
after it are taken again: the result is that of the measurements in order, to the last bit.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from companion.estimation.filter_measurements import Measurement
from companion.estimation.filter_state import Estimate
from companion.estimation.filter_steps import Outcome, Steps
from companion.messages import NS

Order = tuple[int, int]


class FilterHistory:
    """Estimates after each measurement of the last seconds."""

    def __init__(self, steps: Steps, horizon_s: float) -> None:
        self._steps = steps
        self._horizon_ns = round(horizon_s / NS)
        self._base: Estimate | None = None
        self._base_order: Order = (0, 0)
        self._orders: list[Order] = []
        self._measurements: list[Measurement] = []
        self._estimates: list[Estimate] = []

    @property
    def newest(self) -> Estimate | None:
        """Return the estimate after the newest measurement."""
        return self._estimates[-1] if self._estimates else self._base

    def shift(self, step_ns: int) -> None:
        """Move all instants, those of what may come late as well."""
        if self._base is not None:
            self._base = self._base.shifted(step_ns)
        self._base_order = self._base_order[0] + step_ns, self._base_order[1]
        self._orders = [(t_ns + step_ns, kind) for t_ns, kind in self._orders]
        self._measurements = [m.shifted(step_ns) for m in self._measurements]
        self._estimates = [e.shifted(step_ns) for e in self._estimates]

    def before(self, t_ns: int) -> Estimate | None:
        """Return the newest estimate at or before an instant, the oldest there is when all are after it."""
        k = bisect_right(self._orders, (t_ns, 2))
        return self._estimates[k - 1] if k else self._base

    def take(self, m: Measurement) -> Outcome | str:
        """Take a measurement in its place; return what came of it, or why it could not be: too old, or there twice."""
        k = bisect_left(self._orders, m.order)
        if k < len(self._orders) and self._orders[k] == m.order:
            return "twice"
        if self._base is None:
            self._base = self._steps.unknown(m.t_ns - self._horizon_ns)
            self._base_order = (m.t_ns - self._horizon_ns, 0)
        if m.order <= self._base_order:
            return "too_old"
        self._orders.insert(k, m.order)
        self._measurements.insert(k, m)
        outcome = self._again_from(k)
        self._forget()
        return outcome

    def _again_from(self, k: int) -> Outcome:
        """Take all measurements from number ``k`` on; return what came of the first of them."""
        assert self._base is not None
        estimate = self._estimates[k - 1] if k else self._base
        del self._estimates[k:]
        first: Outcome | None = None
        for m in self._measurements[k:]:
            estimate, outcome = self._steps.take(estimate, m)
            self._estimates.append(estimate)
            first = first or outcome
        assert first is not None
        return first

    def _forget(self) -> None:
        oldest_ns = self._orders[-1][0] - self._horizon_ns
        n = bisect_left(self._orders, (oldest_ns, 0))
        if n:
            self._base, self._base_order = self._estimates[n - 1], self._orders[n - 1]
            del self._orders[:n], self._measurements[:n], self._estimates[:n]
