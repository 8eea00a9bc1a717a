"""One real flight's record: the same in a worker and out of it, estimate and truth of one instant in a row."""

import numpy as np
import pytest

from companion.messages import Phase
from sim_bridge.runs.flights import near
from sim_bridge.runs.many import Job, fly_many
from sim_bridge.runs.record import COLUMNS, record_flight
from sim_bridge.scoring import score


def whole(job):
    return record_flight(job)


@pytest.fixture(scope="module")
def flown():
    scenario, setup = near("docking", 1001, 2.0)
    return scenario, setup, record_flight(Job("1001", scenario, setup))


def test_a_flight_in_a_worker_is_the_same_flight(flown):
    scenario, setup, record = flown
    [again] = fly_many([Job("1001", scenario, setup)], whole)
    np.testing.assert_array_equal(again.rows, record.rows)
    assert again.changes == record.changes
    assert {k: v.tolist() for k, v in again.nis.items()} == {k: v.tolist() for k, v in record.nis.items()}


def test_rows_put_estimate_and_truth_of_one_instant_beside_each_other(flown):
    """A row off by one step would be off by centimetres in the approach: BR's error is millimetres."""
    scenario, setup, record = flown
    assert record.entered_s(Phase.HOLD) is not None
    approach = record.during(Phase.APPROACH, Phase.CONTACT, Phase.HOLD)
    error = (record.of("br_m") - record.of("br_true_m"))[approach]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.03
    np.testing.assert_allclose(np.diff(record.of("t_s")), 0.02, atol=1e-9)
    found = score((np.round(record.of("t_s") * 1e9).astype(np.int64), record.of("br_true_m")), record.changes,
                  setup.tanker.window, scenario)
    assert found["docked"]
    assert record.safety["outside_limit_m"] == 0.0


def test_every_column_is_filled_in_the_hold(flown):
    record = flown[2]
    hold = record.during(Phase.HOLD)
    empty = [name for name in COLUMNS if not np.isfinite(record.of(name)[hold]).any()]
    assert empty == []
    assert {"gps", "pixels"} <= record.nis.keys()
    assert record.states.shape[1] == 33
