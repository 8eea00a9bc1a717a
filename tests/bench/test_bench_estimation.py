"""Accuracy and consistency of a handful of flights: the whole is `make accuracy`, `make consistency`. Prints tables."""

import pytest

from sim_bridge.runs import accuracy, consistency
from sim_bridge.runs.many import fly_many
from sim_bridge.runs.record import Record

pytestmark = pytest.mark.bench

FLIGHTS = 6


@pytest.mark.parametrize("method", ["filter", "blend"])
def test_consistency(method):
    records = fly_many(consistency.jobs(FLIGHTS, "light", method, first_seed=1), consistency.observe)
    assert all(isinstance(r, Record) and r.failure is None for r in records)
    print(f"\n{method}\n{consistency.tables(records)}")


def test_accuracy():
    print("\n" + accuracy.measure(accuracy.cases(quick=True), hold_s=20.0))
