"""What counts as right of a flight of the fault matrix, and how it is told; command lines that end with its verdict."""

from dataclasses import replace

import msgspec
import pytest

from companion.messages import Phase, PhaseChange
from sim_bridge import fault_table
from sim_bridge.__main__ import main
from sim_bridge.fault_cells import BREAKAWAY, EITHER, HELD, MATRIX, MORE, Cell, Since
from sim_bridge.fault_matrix import CellFlight
from sim_bridge.runs import command, integrity
from sim_bridge.runs.many import Crashed

S = 1_000_000_000
SAFE = {"collision": False, "closest_m": 3.0, "outside_limit_m": 0.0, "breakaway_delay_s": None}
CELL = Cell("camera-off", ("camera.off@hold+1",), BREAKAWAY, "nothing is seen", ("sight lost",))


def change(t_s, new, reason=""):
    return PhaseChange(round(t_s * S), Phase.STANDBY, new, reason)


def flown(cell=CELL, broke_s=21.4, fault_s=21.0, **fields):
    """Return a flight that holds from 20 s on, suffers its fault, and breaks away or not."""
    phases = [change(20.0, Phase.HOLD)]
    if broke_s is not None:
        phases = sorted([*phases, change(broke_s, Phase.BREAKAWAY, "sight lost")], key=lambda c: c.t_ns)
    return CellFlight(cell, phases, touched=(3,), fault_ns=round(fault_s * S), safety=dict(SAFE), **fields)


@pytest.mark.parametrize(("broke_s", "right"), [
    (21.0, True), (21.5, True), (21.52, False), (20.9, False), (None, False)])
def test_a_breakaway_comes_after_its_fault_and_soon(broke_s, right):
    assert flown(broke_s=broke_s).right == right


@pytest.mark.parametrize(("broke_s", "right"), [(23.8, True), (24.3, True), (24.32, False), (23.78, False)])
def test_a_heartbeat_is_missed_three_seconds_after_the_last_one_not_after_the_fault(broke_s, right):
    cell = replace(CELL, since=Since.HEARTBEAT)
    beats = [round(t_s * S) for t_s in (19.8, 20.8, 24.5)]
    assert flown(cell, broke_s, heartbeats_ns=beats).right == right


@pytest.mark.parametrize(("broke_s", "reason_s", "off_s", "right"), [
    (22.4, 22.0, None, True), (22.6, 22.0, None, False), (22.4, 22.0, 21.8, False), (22.4, 22.0, 21.95, True),
    (23.2, 23.0, None, False), (22.4, None, None, True), (21.4, 20.5, None, True),
])
def test_a_fault_that_is_borne_for_a_while_is_a_cause_later_but_not_for_ever(broke_s, reason_s, off_s, right):
    """From the last good sample on, from an error beyond what is allowed if that is earlier, within 2 s in any case."""
    cell = replace(CELL, since=Since.REASON, within_s=2.0)
    errors = [(round(21.2 * S), 0.1, 0.4)] + ([] if off_s is None else [(round(off_s * S), 0.5, 1.2)])
    reason_ns = None if reason_s is None else round(reason_s * S)
    assert flown(cell, broke_s, errors=errors, reason_ns=reason_ns).right == right


def test_a_flight_that_may_end_either_way_is_held_to_both():
    cell = replace(CELL, ends=EITHER)
    assert flown(cell).right
    assert flown(cell, None).right
    assert not flown(cell, 21.7).right
    other = flown(cell, None)
    other.phases.append(change(22.0, Phase.PRE_CONTACT))
    assert not other.right


@pytest.mark.parametrize("wrong", [
    {"touched": ()}, {"touched": (0,)}, {"wild": 1}, {"misled": 1}, {"plant_failure": "beyond the model"},
    {"safety": {**SAFE, "collision": True}}, {"safety": {**SAFE, "outside_limit_m": 0.1}},
])
def test_a_flight_is_wrong_when_its_fault_never_came_or_anything_was_dangerous(wrong):
    flight = flown(replace(CELL, ends=HELD), None)
    assert flight.right
    for name, value in wrong.items():
        setattr(flight, name, value)
    assert not flight.right
    assert fault_table.row(flight).endswith("**wrong** |")


def test_rows_say_how_long_after_the_fault_and_after_its_cause():
    late = replace(CELL, since=Since.REASON, within_s=2.0)
    text = fault_table.row(flown(late, 22.4, errors=[(round(22.0 * S), 0.31, 0.34)], reason_ns=22 * S))
    assert "| 1.40 s (over 0.5 s) | 0.40 s (b) |" in text
    assert fault_table.brief(flown(late, 22.4, reason_ns=22 * S)) == "breakaway 1.40 s (0.40 s after its cause)"
    assert "| 0.31 (34 %) |" in text
    assert "| 0.40 s | 0.40 s |  |" in fault_table.row(flown())


def test_the_matrix_in_brief_has_a_row_for_each_source_and_a_list_of_the_rest():
    flights = []
    for cell in (*MATRIX, *MORE):
        flight = flown(replace(cell, causes=(), rejects=()), None if "held" in cell.ends else 21.4)
        flight.phases += [change(21.5, Phase(e)) for e in cell.ends if e in ("standby", "observation")]
        flights.append(flight)
    lines = fault_table.condensed(flights).splitlines()
    assert lines[0] == "| | off | stuck | garbage | wrong | slow | delayed | intermittent |"
    assert lines[2] == "| **camera** |" + " breakaway 0.40 s |" * 5 + " held | held |"
    assert [line.split(" |")[0] for line in lines[2:7]] == [f"| **{t}**" for t in fault_table.TARGETS]
    assert all("| |" not in line for line in lines[2:7])
    assert lines[7] == ""
    assert len(lines[8:]) == len(MORE)
    assert "- `lights.one@hold+1`: held; eight lights are enough" in lines


def fly_wrongly(cell, seed, **watched):
    return flown(cell, None)


@pytest.mark.parametrize(("only", "code"), [("gps-off", 0), ("camera-off", 3)])
def test_a_wrong_row_is_no_success(monkeypatch, capsys, tmp_path, only, code):
    monkeypatch.setattr(fault_table, "fly_cell", fly_wrongly)
    out = tmp_path / "faults.md"
    assert main(["faults", "--only", only, "--out", str(out)]) == code
    told = capsys.readouterr()
    assert out.read_text() == told.out
    assert ("**wrong**" in told.out) == (code == 3)


def crash(job):
    return Crashed(job.label, "exit code 1")


@pytest.mark.parametrize("name", ["integrity", "consistency"])
def test_crashed_flights_are_no_success(monkeypatch, capsys, name):
    monkeypatch.setattr(command, "fly_many", lambda jobs, work, **how: [crash(job) for job in jobs])
    assert main([name, "--flights", "1", "--first-seed", "1100"]) == 3
    assert "crashed" in capsys.readouterr().out


def test_what_is_worth_a_look_is_no_success(monkeypatch, capsys):
    """A flight without a fault that did not hold."""
    healthy = next(seed for seed in range(1100, 1200) if not integrity.draw(seed).scenario.faults)
    job = integrity.draw(healthy)
    cut = msgspec.structs.replace(job.scenario, timeout_s=2.0, hold_s=1.0)
    short = replace(job, scenario=cut)
    monkeypatch.setattr(integrity, "draw", lambda seed: short)
    monkeypatch.setattr(command, "fly_many", lambda jobs, work, **how: [work(job) for job in jobs])
    assert main(["integrity", "--flights", "1"]) == 3
    assert "not held without a fault" in capsys.readouterr().out
