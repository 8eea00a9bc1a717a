"""Faults drawn for flights: by the seed alone, all cells, as the command line writes them; endings and the table."""

import msgspec
import numpy as np
import pytest
from made_records import record_of, rows_of

from companion.messages import Phase
from sim_bridge.faults import fault_rules, parse_fault
from sim_bridge.runs.integrity import CELLS, FIXED, NOTHING, counted, draw, draw_fault, ending, outcome, table
from sim_bridge.runs.many import Crashed
from sim_bridge.runs.record import record_flight

DRAWN = 3000


@pytest.fixture(scope="module")
def faults():
    rng = np.random.default_rng(1001)
    return [draw_fault(rng) for _ in range(DRAWN)]


def test_every_fault_that_is_drawn_may_be_flown_and_written_down(faults):
    assert all(holds for holds, _ in fault_rules(tuple(faults)))
    assert [parse_fault(str(f)) for f in faults] == faults


def test_every_cell_is_drawn_and_other_sizes_are(faults):
    assert {(f.target, f.kind) for f in faults} == set(CELLS)
    sized = [f for f in faults if f.size is not None]
    assert 0.15 * DRAWN < len(sized) < 0.5 * DRAWN
    assert not any(f.kind in FIXED for f in sized)
    smaller = sum(abs(f.size) < abs(msgspec.structs.replace(f, size=None).amount) for f in sized)
    assert 0.5 * len(sized) < smaller < 0.85 * len(sized)


def test_a_seed_is_one_flight():
    one, again, other = draw(1001), draw(1001), draw(1002)
    assert (one.label, one.scenario) == (again.label, again.scenario)
    assert one.label != other.label


def test_a_tenth_of_the_flights_suffers_nothing_and_half_are_in_moderate_turbulence():
    jobs = [draw(seed) for seed in range(1000, 1200)]
    assert 8 <= sum(not job.scenario.faults for job in jobs) <= 36
    assert 70 <= sum(job.scenario.turbulence == "moderate" for job in jobs) <= 130
    assert all(8.0 <= job.scenario.hold_s <= 12.0 for job in jobs)


def test_flights_ask_integrity_and_begin_anywhere_on_the_way():
    """The refuelling's own phases by gates that pass by themselves: without leave to dock nobody comes to the hold."""
    jobs = [draw(seed) for seed in range(1100, 1400)]
    for job in jobs:
        guidance = job.setup.config.guidance
        assert (guidance.procedure, guidance.auto_gates, guidance.self_test) == ("refuelling", True, False)
    begun = {job.scenario.faults[0].phase for job in jobs if job.scenario.faults}
    assert begun == {Phase.JOIN, Phase.OBSERVATION, Phase.PRE_CONTACT, Phase.APPROACH, Phase.CONTACT, Phase.HOLD}


def test_a_drawn_flight_without_a_fault_docks_by_all_phases():
    job = next(job for job in map(draw, range(1100, 1200)) if not job.scenario.faults)
    record = record_flight(job)
    assert [c.new for c in record.changes[1:]] == [
        Phase.JOIN, Phase.OBSERVATION, Phase.PRE_CONTACT, Phase.APPROACH, Phase.CONTACT, Phase.HOLD]
    assert outcome(record, job).ended == "held"


HELD = ((0.0, "standby"), (1.0, "approach"), (2.0, "hold"))


@pytest.mark.parametrize(("changes", "failure", "ended"), [
    (HELD, None, "held"), (HELD, "beyond the model", "plant"),
    ((*HELD, (9.0, "breakaway")), None, "breakaway"), ((*HELD, (9.0, "standby")), None, "standby"),
    ((*HELD[:2], (6.0, "hold")), None, "hold"), (HELD[:2], None, "approach"),
])
def test_how_a_flight_ended(changes, failure, ended):
    assert ending(record_of(rows_of(121), changes=changes, failure=failure), hold_s=10.0) == ended


def test_the_table_counts_by_cell_and_names_what_went_wrong():
    by_cell = {}
    for seed in range(1000, 1400):
        job = draw(seed)
        by_cell.setdefault(job.label.split()[2].split("@")[0].split("=")[0], job)
    camera, nothing = by_cell["camera.off"], by_cell[NOTHING]
    rows = rows_of(200, br_true_m=0.0, br_m=0.3, protection_m=0.2, alert_m=(0.4, 1.87, 0.9), may_dock=1.0)
    broke = (*HELD, (5.0, "breakaway"))
    safety = {"breakaway_delay_s": 0.42, "outside_limit_m": 0.25, "collision": True}
    bad = outcome(record_of(rows, changes=broke, label=camera.label, safety=safety, fault_s=4.58), camera)
    good = outcome(record_of(rows_of(200), changes=HELD, label=nothing.label), nothing)
    assert (bad.reason, bad.delay_s, bad.began) == ("why", 0.42, True)
    assert counted(bad) == (600, 0, 0)
    text = table([bad, good, Crashed("1007 light camera.late", "exit code 1")])
    lines = text.splitlines()
    assert "| camera.off | 1 | 0 | 1 | 0 | 0 | 1 | 1, 0.25 | 0.42, 0.42 | 1, 0, 0 |" in lines
    assert "| nothing | 1 | 1 | 0 | 0 | 0 | 0 | 0 |  | 0, 0, 0 |" in lines
    assert any("1 crashed" in line and 'false "may dock" in 1 flights' in line for line in lines)
    named = [line for line in lines if line.startswith("- ")]
    assert len(named) == 2
    assert camera.label in "".join(named)
    assert nothing.label not in "".join(named)
