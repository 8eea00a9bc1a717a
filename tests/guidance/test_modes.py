from dataclasses import replace

import pytest

from companion.guidance.modes import TABLE, Limits, PhaseMachine, Situation, diagram
from companion.messages import Command, Phase

LIMITS = Limits(estimate_stale_s=0.3, breakaway_stale_s=1.0, join_settle_s=3.0, capture_s=2.0)
GOOD = Situation(estimate_age_s=0.05, guided=True, engaged=True)


def machine(phase):
    m = PhaseMachine(LIMITS)
    m.phase = phase
    return m


def test_the_way_to_hold():
    m = PhaseMachine(LIMITS)
    seen = []
    for s in (GOOD, replace(GOOD, settled_s=3.0), GOOD, replace(GOOD, path_done=True, captured_s=2.0)):
        change = m.step(0, s)
        seen.append(change.new if change else None)
    assert seen == [Phase.JOIN, Phase.APPROACH, None, Phase.HOLD]


@pytest.mark.parametrize("missing", [
    {"engaged": False}, {"guided": False}, {"estimate_age_s": None}, {"estimate_age_s": 0.31},
    {"estimate_age_s": float("nan")},
])
def test_standby_waits_for_everything(missing):
    assert machine(Phase.STANDBY).step(0, replace(GOOD, **missing)) is None


@pytest.mark.parametrize("phase", [Phase.JOIN, Phase.APPROACH, Phase.HOLD])
@pytest.mark.parametrize("bad", [
    {"estimate_age_s": 1.01}, {"estimate_age_s": None}, {"command": Command.BREAKAWAY},
])
def test_every_flying_phase_breaks_away(phase, bad):
    assert machine(phase).step(0, replace(GOOD, **bad)).new is Phase.BREAKAWAY


def test_limits_of_hold_and_approach():
    assert machine(Phase.HOLD).step(0, replace(GOOD, inside_limit=False)).new is Phase.BREAKAWAY
    assert machine(Phase.APPROACH).step(0, replace(GOOD, tracking_ok=False)).new is Phase.BREAKAWAY
    assert machine(Phase.APPROACH).step(0, replace(GOOD, inside_limit=False)) is None


def test_breakaway_is_latched_until_an_operator_clears_it():
    m = machine(Phase.BREAKAWAY)
    assert m.step(0, GOOD) is None
    assert m.step(0, replace(GOOD, command=Command.ENGAGE)) is None
    assert m.step(0, replace(GOOD, command=Command.CLEAR)).new is Phase.STANDBY


def test_table_reaches_every_phase_and_the_diagram_shows_every_row():
    assert {row.new for row in TABLE} == set(Phase)
    assert all(f"{row.old} --> {row.new}: {row.reason}" in diagram() for row in TABLE)


def test_a_silent_link_keeps_a_breakaway_and_a_pilot_ends_it():
    assert machine(Phase.BREAKAWAY).step(0, replace(GOOD, guided=False)) is None
    change = machine(Phase.BREAKAWAY).step(0, replace(GOOD, guided=False, taken_over=True))
    assert change.new is Phase.STANDBY


@pytest.mark.parametrize("missing", [{"in_corridor": False}, {"estimate_age_s": 0.4}])
def test_no_phase_moves_forward_from_a_bad_place_or_on_an_old_estimate(missing):
    ready = replace(GOOD, settled_s=9.0, path_done=True, captured_s=9.0)
    assert machine(Phase.STANDBY).step(0, replace(ready, **missing)) is None
    if "estimate_age_s" in missing:
        assert machine(Phase.JOIN).step(0, replace(ready, **missing)) is None
        assert machine(Phase.APPROACH).step(0, replace(ready, **missing)) is None
