from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.modes import (
    FAR,
    FLYING,
    GUARDS_CAUSE,
    NOT_GUIDED,
    OBEYED,
    TABLE,
    TAKEN_OVER,
    Limits,
    PhaseMachine,
    Situation,
    diagram,
)
from companion.messages import Command, Phase

LIMITS = Limits(
    estimate_stale_s=0.3, join_settle_s=3.0, observation_s=3.0, stabilise_s=3.0, may_dock_s=2.0, retreat_s=0.1,
    capture_s=2.0, contact_timeout_s=30.0, self_test=True, direct=False,
)
UNTESTED, DIRECT = replace(LIMITS, self_test=False), replace(LIMITS, direct=True)
QUIET = Situation(estimate_age_s=0.05, guided=True, engaged=False)
"""Nothing holds that any row asks for."""

ENGAGED = replace(QUIET, engaged=True)
STABLE = replace(QUIET, path_done=True, settled_s=3.0, may_dock_s=2.0, cleared=True)
P = Phase
WAYS = [
    (P.STANDBY, P.SELF_TEST, ENGAGED, LIMITS),
    (P.STANDBY, P.JOIN, ENGAGED, UNTESTED),
    (P.SELF_TEST, P.JOIN, replace(QUIET, tested=True), LIMITS),
    (P.SELF_TEST, P.STANDBY, replace(QUIET, tested=False), LIMITS),
    (P.JOIN, P.OBSERVATION, replace(QUIET, settled_s=3.0), LIMITS),
    (P.JOIN, P.APPROACH, replace(QUIET, settled_s=3.0), DIRECT),
    (P.OBSERVATION, P.PRE_CONTACT, replace(QUIET, observed_s=3.0, cleared=True), LIMITS),
    (P.PRE_CONTACT, P.APPROACH, STABLE, LIMITS),
    (P.APPROACH, P.PRE_CONTACT, replace(QUIET, command=Command.PRE_CONTACT), LIMITS),
    (P.APPROACH, P.PRE_CONTACT, replace(QUIET, may_not_dock_s=0.12), LIMITS),
    (P.APPROACH, P.CONTACT, replace(QUIET, path_done=True), LIMITS),
    (P.CONTACT, P.PRE_CONTACT, replace(QUIET, command=Command.PRE_CONTACT), LIMITS),
    (P.CONTACT, P.PRE_CONTACT, replace(QUIET, may_not_dock_s=0.12), LIMITS),
    (P.CONTACT, P.DISCONNECT, replace(QUIET, command=Command.DISCONNECT), LIMITS),
    (P.CONTACT, P.HOLD, replace(QUIET, captured_s=2.0), LIMITS),
    (P.CONTACT, P.PRE_CONTACT, replace(QUIET, phase_s=30.0), LIMITS),
    (P.HOLD, P.DISCONNECT, replace(QUIET, command=Command.DISCONNECT), LIMITS),
    (P.DISCONNECT, P.PRE_CONTACT, replace(QUIET, path_done=True), LIMITS),
    (P.BREAKAWAY, P.STANDBY, replace(QUIET, command=Command.CLEAR), LIMITS),
    (P.BREAKAWAY, P.STANDBY, replace(QUIET, guided=False, taken_over=True), LIMITS),
    *((old, P.BREAKAWAY, replace(QUIET, cause="closing too fast"), LIMITS) for old in FLYING),
    *((old, P.STANDBY, replace(QUIET, guided=False, taken_over=True), LIMITS) for old in FLYING),
    *((old, P.STANDBY, replace(QUIET, guided=False), LIMITS) for old in FAR),
]


def machine(phase, limits=LIMITS):
    m = PhaseMachine(limits)
    m.phase = phase
    return m


@pytest.mark.parametrize(("old", "new", "situation", "limits"), WAYS)
def test_every_way_is_gone(old, new, situation, limits):
    change = machine(old, limits).step(7, situation)
    assert (change.t_ns, change.old, change.new) == (7, old, new)


def test_the_ways_are_all_rows_of_the_table():
    gone = {(old, machine(old, limits).step(0, s).reason) for old, _, s, limits in WAYS}
    rows = {(row.old, row.reason) for row in TABLE if row.reason != GUARDS_CAUSE}
    assert gone == rows | {(old, "closing too fast") for old in FLYING}
    assert len(WAYS) == len(TABLE)


@pytest.mark.parametrize("phase", list(Phase))
def test_where_nothing_happens_every_phase_stays(phase):
    for limits in (LIMITS, UNTESTED, DIRECT):
        assert machine(phase, limits).step(0, QUIET) is None


def test_every_phase_is_reached_and_left():
    assert {row.new for row in TABLE} == {row.old for row in TABLE} == set(Phase)


@pytest.mark.parametrize("missing", [
    {"engaged": False}, {"guided": False}, {"estimate_age_s": None}, {"estimate_age_s": 0.31},
    {"estimate_age_s": float("nan")}, {"in_corridor": False},
])
@pytest.mark.parametrize("limits", [LIMITS, UNTESTED, DIRECT])
def test_standby_waits_for_everything(missing, limits):
    assert machine(P.STANDBY, limits).step(0, replace(ENGAGED, **missing)) is None


@pytest.mark.parametrize(("phase", "ready", "missing"), [
    (P.OBSERVATION, replace(QUIET, observed_s=3.0, cleared=True), [{"observed_s": 2.9}, {"cleared": False}]),
    (P.PRE_CONTACT, STABLE, [{"path_done": False}, {"settled_s": 2.9}, {"may_dock_s": 1.9}, {"cleared": False}]),
    (P.APPROACH, replace(QUIET, path_done=True), [{"path_done": False}]),
    (P.CONTACT, replace(QUIET, captured_s=2.0), [{"captured_s": 1.9}]),
])
def test_nothing_closes_in_before_all_is_there(phase, ready, missing):
    assert machine(phase).step(0, ready) is not None
    for less in [*missing, {"estimate_age_s": None}, {"estimate_age_s": 0.31}]:
        assert machine(phase).step(0, replace(ready, **less)) is None


@pytest.mark.parametrize("phase", FLYING)
def test_a_breakaway_tells_its_cause_and_a_pilot_goes_before_it(phase):
    change = machine(phase).step(0, replace(STABLE, cause="sight lost", tested=True, captured_s=9.0))
    assert (change.new, change.reason) == (P.BREAKAWAY, "sight lost")
    change = machine(phase).step(0, replace(QUIET, guided=False, taken_over=True, cause="sight lost"))
    assert (change.new, change.reason) == (P.STANDBY, TAKEN_OVER)


def test_a_silent_link_lets_go_far_from_the_tanker_and_is_the_guards_cause_near_it():
    silent = replace(QUIET, guided=False)
    for phase in FLYING:
        change = machine(phase).step(0, silent)
        assert (change is not None and change.reason == NOT_GUIDED) == (phase in FAR)
    assert machine(P.BREAKAWAY).step(0, silent) is None


def test_the_direct_procedure_asks_no_integrity_and_knows_no_way_back():
    doubtful = replace(QUIET, may_not_dock_s=99.0, phase_s=99.0)
    for phase in (P.APPROACH, P.CONTACT):
        assert machine(phase, DIRECT).step(0, doubtful) is None
        assert machine(phase).step(0, doubtful).new is P.PRE_CONTACT


def test_a_self_test_that_passes_on_an_estimate_that_died_meanwhile_does_not_join():
    change = machine(P.SELF_TEST).step(0, replace(QUIET, tested=True, estimate_age_s=0.4))
    assert change.new is P.STANDBY


seconds = st.one_of(st.just(0.0), st.floats(0.0, 40.0))
situations = st.builds(
    Situation,
    estimate_age_s=st.one_of(st.none(), st.just(0.05), st.just(float("nan")), st.floats(0.0, 3.0)),
    guided=st.booleans(), engaged=st.booleans(), command=st.one_of(st.none(), st.sampled_from(Command)),
    cause=st.one_of(st.none(), st.none(), st.none(), st.just("sight lost")),
    taken_over=st.sampled_from([False] * 9 + [True]), in_corridor=st.booleans(), cleared=st.booleans(),
    tested=st.sampled_from([None, True, True, False]), settled_s=seconds, observed_s=seconds, may_dock_s=seconds,
    may_not_dock_s=st.sampled_from([0.0, 0.0, 0.0, 1.0]), path_done=st.booleans(), captured_s=seconds, phase_s=seconds,
)


@given(st.lists(situations, max_size=60), st.sampled_from([LIMITS, UNTESTED, DIRECT]), st.sampled_from(Phase))
def test_whatever_happens(sequence, limits, start):
    """A breakaway is left by clear or pilot only, hold comes of contact, and contact of an approach."""
    m = machine(start, limits)
    for s in sequence:
        before = m.phase
        change = m.step(0, s)
        assert (change is None) == (m.phase is before)
        if change is None:
            assert s.cause is None or before in (P.STANDBY, P.BREAKAWAY)
            continue
        assert (change.old, change.new) == (before, m.phase)
        if before is P.BREAKAWAY:
            assert change.new is P.STANDBY
            assert s.command is Command.CLEAR or s.taken_over
        before_it = {P.HOLD: (P.CONTACT,), P.CONTACT: (P.APPROACH,), P.DISCONNECT: (P.CONTACT, P.HOLD)}
        assert before in before_it.get(change.new, tuple(Phase))
        if change.new in (P.APPROACH, P.CONTACT, P.HOLD):
            assert s.estimate_age_s is not None
            assert s.estimate_age_s <= limits.estimate_stale_s
            assert s.cause is None
        if change.new is P.APPROACH and not limits.direct:
            assert s.cleared
            assert s.may_dock_s >= limits.may_dock_s
        if before is P.STANDBY:
            assert s.engaged
            assert s.guided


def test_the_diagram_shows_every_row_and_what_all_flying_phases_share_once():
    shown = diagram()
    for row in TABLE:
        if row.reason in (GUARDS_CAUSE, TAKEN_OVER, NOT_GUIDED) and row.old in FLYING:
            continue
        assert f"{row.old} --> {row.new}: {row.reason}\n" in shown + "\n"
    assert shown.count(GUARDS_CAUSE) == 1
    assert shown.count(NOT_GUIDED) == len(FAR)
    assert shown.count(TAKEN_OVER) == 2
    assert len(shown.splitlines()) < 40


def test_every_command_of_the_phases_means_something_somewhere():
    vision = {Command.REAL_VISION, Command.SIMULATED_VISION}
    assert set(OBEYED) == set(Command) - vision
    assert all(OBEYED.values())
