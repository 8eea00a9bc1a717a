"""Accuracy in the hold: what is counted, what the table marks; and GPS that goes out."""

import numpy as np
import pytest
from made_records import record_of, rows_of

from sim_bridge.runs.accuracy import LIMITS_M, Case, cases, held_of, line
from sim_bridge.runs.flights import near, without_gps
from sim_bridge.runs.many import Crashed, Job

CASE = Case("light", "filter", "detections", (1, 2))
PHASES = ((0.0, "standby"), (1.0, "approach"), (4.0, "hold"))


def held(error_m, seed=1):
    """Return what is counted of a flight with this error in the hold, and a much larger one before."""
    n = 700
    error = np.tile(np.asarray(error_m), (n, 1))
    error[:40] = 5.0
    range_m = np.linspace(40.0, 20.0, n)
    rows = rows_of(n, br_true_m=0.1, br_m=0.1 + error, br_nees=1.0, range_true_m=range_m[:, None], p_error_m=error,
                   p_nees=1.0)
    scenario, setup = near("docking", seed, 60.0)
    return held_of(record_of(rows, changes=PHASES), Job("made", scenario, setup))


def test_only_the_hold_counts_and_in_three_dimensions():
    found = held((0.01, 0.02, 0.02))
    assert found.rms_m == pytest.approx(0.03)
    assert found.docked
    assert found.near_s == pytest.approx(35.0, abs=0.2)


def test_the_table_says_over_when_the_worst_flight_is():
    good, bad = held((0.01, 0.02, 0.02)), held((0.03, 0.03, 0.03))
    text = line(CASE, "on", [good, good])
    assert "| 2 of 2 | 0.0300 | 0.0300 | 0.037 | 0.0100, 0.0200, 0.0200 | 0.0300 |" in text
    text = line(CASE, "on", [good, bad])
    assert "**over**" in text
    assert "0.0424" in text  # root of the mean of 0.03 squared and 0.052 squared
    assert "1 of 3" in line(CASE, "off", [good, Crashed("x", "exit code 1"), None])
    assert "no hold" in line(CASE, "off", [None])


def test_gps_goes_out_for_both_aircraft_to_the_end():
    scenario, setup = near("docking", 1, 10.0)
    sensors = without_gps(Job("x", scenario, setup), 12.5).scenario.sensors
    for aircraft in (sensors.receiver, sensors.tanker):
        [outage] = aircraft.gps_outages
        assert outage.from_s == 12.5
        assert outage.until_s > scenario.timeout_s


def test_the_rows_are_both_turbulences_by_both_fusions_and_two_by_pictures():
    rows = cases(quick=False)
    assert {(c.turbulence, c.method) for c in rows if c.seen == "detections"} == {
        (t, m) for t in LIMITS_M for m in ("filter", "blend")}
    assert {(c.turbulence, len(c.seeds)) for c in rows if c.seen == "pictures"} == {("light", 2), ("moderate", 2)}
    assert LIMITS_M == {"light": 0.037, "moderate": 0.08}
    [job, _] = CASE.jobs(hold_s=5.0)
    assert (job.scenario.vision_input, job.scenario.hold_s, job.scenario.seed) == ("detections", 5.0, 1)
