"""How a flight begins: near the box only seen and backing off; an engagement that nobody takes back by mistake."""

import math

import numpy as np
import pytest
from test_approach import DT_NS, PRE_CONTACT_M, Loop, S, kinds, manual, state_at, trusted

from companion.messages import AutopilotMode, Command, GuidanceOutput, Phase, Sources

IN_THE_BOX_M = np.array([-0.3, 0.2, 0.4])


@pytest.mark.parametrize("p_m", [IN_THE_BOX_M, np.array([-8.0, -3.0, 6.0]), np.array([-2.0, 0.0, 9.0])])
def test_a_join_that_begins_near_the_box_backs_off_to_the_pre_contact_point_before_anything_is_observed(p_m):
    """As after a clear, or a restart with auto_engage: slowly, straight, never nearer than it goes by there."""
    loop = Loop()
    p, out = loop.ride(Phase.OBSERVATION, p_m)
    assert np.allclose(p, PRE_CONTACT_M, atol=1e-6)
    way = np.array([g.reference_mrf_m for g in kinds(out, GuidanceOutput) if g.phase is Phase.JOIN])
    assert np.allclose(way[0], p_m, atol=1e-3)
    steps = np.diff(way, axis=0) / (DT_NS / S)
    assert np.linalg.norm(steps, axis=1).max() <= 0.5 + 1e-6
    assert np.linalg.norm(np.diff(steps, axis=0), axis=1).max() < 0.01  # no step in speed
    assert np.diff(way[:, 0]).max() <= 1e-12  # never forward
    loop.ride(Phase.HOLD, p)


def test_a_join_that_begins_beyond_the_pre_contact_point_holds_its_place():
    loop = Loop(pre_contact_m=(-2.5, 0.0, 1.0))
    p, _ = loop.ride(Phase.OBSERVATION, np.array([-3.0, -0.5, 1.5]))
    assert np.allclose(p, [-3.0, -0.5, 1.5])


@pytest.mark.parametrize("unseen", [None, "old", "fault"])
def test_nothing_begins_near_the_box_before_the_tanker_is_seen_without_a_fault(unseen):
    loop = Loop()
    for _ in range(100):
        t = loop.t_ns
        sight_ns = {None: None, "old": t - S, "fault": t}[unseen]
        integrity = trusted(t, faults=("gps_vision",) if unseen == "fault" else ())
        assert loop.step(state_at(t, IN_THE_BOX_M), sources=Sources(t, t, t, sight_ns), integrity=integrity) == []
    loop.hold_still(0.1, IN_THE_BOX_M)
    assert loop.phase is Phase.SELF_TEST


def test_far_out_a_flight_begins_unseen():
    loop = Loop()
    loop.hold_still(0.1, sources=Sources(0, 0, 0, None))
    assert loop.phase is Phase.SELF_TEST


@pytest.mark.parametrize("phase", [Phase.SELF_TEST, Phase.JOIN])
def test_an_autopilot_that_falls_silent_near_the_box_is_a_breakaway_and_not_standby(phase):
    loop = Loop(self_test=phase is Phase.SELF_TEST)
    loop.hold_still(0.1, IN_THE_BOX_M)
    assert loop.phase is phase
    while loop.t_ns < 10 * S and loop.phase in (Phase.SELF_TEST, Phase.JOIN):
        loop.step(state_at(loop.t_ns, IN_THE_BOX_M, roll_rad=loop.roll_rad), None)
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.BREAKAWAY, "autopilot lost")


def test_a_pilot_who_takes_over_after_a_silence_ends_the_engagement():
    loop = manual(self_test=False)
    loop.hold_still(1.0)
    loop.hold_still(4.0, mode=None)
    assert loop.phase is Phase.STANDBY
    loop.hold_still(0.1, mode=AutopilotMode.MANUAL)
    assert loop.hold_still(5.0) == []  # guided again is nobody's leave


def test_who_engages_by_itself_waits_for_guided_at_first():
    loop = Loop(self_test=False)
    loop.hold_still(1.0, mode=AutopilotMode.MANUAL)
    loop.hold_still(0.1)
    assert loop.phase is Phase.JOIN


@pytest.mark.parametrize(("mode", "detail"), [
    (AutopilotMode.MANUAL, "the autopilot is not armed and guided"), (None, "the autopilot is silent")])
def test_an_engagement_is_not_kept_for_an_autopilot_that_does_not_follow(mode, detail):
    loop = Loop(auto_engage=False, self_test=False)
    loop.approach.command_event(Command.ENGAGE)
    loop.hold_still(1.0, mode=mode)
    assert [(r.reason, r.detail) for r in loop.rejects] == [("engage_not_now", detail)]
    assert loop.hold_still(5.0) == loop.hold_still(5.0) == []
    loop.approach.command_event(Command.ENGAGE)
    loop.hold_still(0.1)
    assert loop.phase is Phase.JOIN


def test_a_pilot_ends_an_engagement_that_still_waits_for_its_estimate():
    loop = Loop(auto_engage=False, self_test=False)
    loop.step(None)
    loop.approach.command_event(Command.ENGAGE)
    loop.step(None)
    loop.step(None, AutopilotMode.MANUAL)
    assert loop.hold_still(5.0) == []


def test_in_a_direct_approach_there_is_no_way_to_a_pre_contact_point():
    """The reference would jump there, beside the way that it is on."""
    loop = manual(procedure="direct", self_test=False)
    p, _ = loop.ride(Phase.APPROACH)
    for _ in range(500):
        p = kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput)[0].reference_mrf_m
    loop.approach.command_event(Command.PRE_CONTACT)
    [told] = kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput)
    assert loop.phase is Phase.APPROACH
    assert loop.rejects[-1].reason == "pre_contact_not_now"
    assert np.linalg.norm(told.reference_mrf_m - p) < 0.05


def test_a_monitor_that_says_nothing_for_a_step_has_not_taken_back_what_it_said():
    """Every other step without a verdict: a fault still lasts, and may_not_dock is no leave."""
    loop = Loop()
    p, _ = loop.ride(Phase.PRE_CONTACT)
    for k in range(2000):
        verdict = trusted(loop.t_ns, docks=False) if k % 2 else None
        p = kinds(loop.step(state_at(loop.t_ns, p), integrity=verdict), GuidanceOutput)[0].reference_mrf_m
    assert loop.phase is Phase.PRE_CONTACT
    p, _ = loop.ride(Phase.HOLD, p)
    began_ns = loop.t_ns
    for k in range(30):
        loop.step(state_at(loop.t_ns, p), integrity=trusted(loop.t_ns, faults=("residual",)) if k % 2 == 0 else None)
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.BREAKAWAY, "integrity failed: residual")
    assert (loop.changes[-1].t_ns - began_ns) * 1e-9 <= 0.25


def test_an_estimate_of_the_future_is_no_fresh_one():
    loop = Loop(self_test=False)
    for age_s in (-9.0, -0.4, 0.4, math.inf):
        state = state_at(loop.t_ns, age_s=age_s if math.isfinite(age_s) else 9.0)
        loop.step(state)
        assert loop.phase is Phase.STANDBY, age_s
    loop.step(state_at(loop.t_ns, age_s=-0.1))
    assert loop.phase is Phase.JOIN
