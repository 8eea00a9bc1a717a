"""The breakaway's setpoints: absolute, with or without an estimate, level once clear."""

import math
from dataclasses import replace

import numpy as np
import pytest
from guard_views import DT_NS, S, integrity_at, new_guard, shipped, state_at, view_at
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.breakaway import DISTRUSTED, LEVEL_THRUST, Breakaway
from companion.guidance.causes import CAUSES, OPERATOR, SIGHT_LOST
from companion.messages import AttitudeSetpoint, Phase

GUIDANCE, TRIM = shipped().config.guidance, shipped().airframe.trim
DOWN_RAD = TRIM.alpha_rad - GUIDANCE.breakaway_descent_rad
LEVEL_NS = S + round(GUIDANCE.breakaway_level_s * S)


def begun(yaw_rad=0.4, cause=OPERATOR):
    """Return a breakaway that begins at 1 s, when the receiver had such a heading."""
    breakaway = Breakaway(GUIDANCE, shipped().airframe)
    breakaway.see(view_at(S, state=state_at(S, euler=(yaw_rad, 0.06, 0.1))))
    breakaway.begin(S, cause)
    return breakaway


def lost_at(t_ns):
    return view_at(t_ns, Phase.BREAKAWAY, state=None)


@given(st.floats(-3.1, 3.1))
def test_it_needs_no_estimate_and_keeps_the_last_known_heading(yaw_rad):
    out = begun(yaw_rad).setpoint(lost_at(S + DT_NS))
    assert out == AttitudeSetpoint(S + DT_NS, 0.0, DOWN_RAD, out.yaw_rad, GUIDANCE.breakaway_thrust)
    assert out.yaw_rad == pytest.approx(yaw_rad)


def test_a_heading_that_is_no_number_is_not_taken():
    breakaway = begun(0.4)
    breakaway.see(view_at(S, state=replace(state_at(S), R_ned_frd=np.full((3, 3), math.nan))))
    breakaway.see(lost_at(S))
    assert breakaway.setpoint(lost_at(S)).yaw_rad == pytest.approx(0.4)


def test_before_anything_is_known_it_still_goes_down():
    out = Breakaway(GUIDANCE, shipped().airframe).setpoint(lost_at(S))
    assert (out.pitch_rad, out.thrust) == (DOWN_RAD, GUIDANCE.breakaway_thrust)


def test_clear_of_the_tanker_it_flies_level_and_stays_so():
    breakaway = begun()
    near_m, far_m = GUIDANCE.breakaway_separation_m - 0.1, GUIDANCE.breakaway_separation_m + 0.1
    pitches = [
        breakaway.setpoint(view_at(t_ns, Phase.BREAKAWAY, state=state_at(t_ns, (-d, 0.0, 0.0)))).pitch_rad
        for t_ns, d in ((LEVEL_NS, near_m), (LEVEL_NS + S, far_m), (LEVEL_NS + 2 * S, near_m))
    ]
    assert pitches == [DOWN_RAD, TRIM.alpha_rad, TRIM.alpha_rad]
    assert breakaway.setpoint(lost_at(LEVEL_NS + 3 * S)).thrust == LEVEL_THRUST * TRIM.throttle
    breakaway.begin(LEVEL_NS + 4 * S, OPERATOR)
    assert breakaway.setpoint(lost_at(LEVEL_NS + 4 * S)).pitch_rad == DOWN_RAD


def away_at(t_ns, forward_m_s, x_m=-115.0, **more):
    return view_at(t_ns, Phase.BREAKAWAY, state=state_at(t_ns, (x_m, 0.0, 20.0), (forward_m_s, 0.0, 0.0)), **more)


def test_who_begins_far_out_goes_down_for_its_time_and_until_it_closes_in_no_more():
    """115 m out and coming: being far is not enough."""
    breakaway = begun()
    for t_ns, forward_m_s, pitch_rad in (
        (S, 3.0, DOWN_RAD), (LEVEL_NS - DT_NS, -1.0, DOWN_RAD), (LEVEL_NS + DT_NS, 0.1, DOWN_RAD),
        (LEVEL_NS + 9 * S, 0.1, DOWN_RAD), (LEVEL_NS + 10 * S, -0.1, TRIM.alpha_rad),
    ):
        assert breakaway.setpoint(away_at(t_ns, forward_m_s)).pitch_rad == pitch_rad


def test_level_it_is_slower_than_the_tanker_and_with_little_thrust_while_it_closes_in():
    breakaway = begun()
    thrusts = [breakaway.setpoint(away_at(LEVEL_NS + k * S, v)).thrust for k, v in enumerate((-0.5, 0.5, -0.1))]
    assert thrusts == [LEVEL_THRUST * TRIM.throttle, GUIDANCE.breakaway_thrust, LEVEL_THRUST * TRIM.throttle]
    assert LEVEL_THRUST < 1.0


@pytest.mark.parametrize("cause", DISTRUSTED)
def test_an_estimate_that_is_the_cause_or_rests_on_it_is_not_asked(cause):
    """It may say that all is clear or that nothing ever is: time decides."""
    assert cause in CAUSES
    for x_m, forward_m_s in ((-115.0, -1.0), (-5.0, 1.0)):
        breakaway = begun(cause=f"{cause}: what fails")
        pitches = [breakaway.setpoint(away_at(t_ns, forward_m_s, x_m)).pitch_rad
                   for t_ns in (LEVEL_NS - DT_NS, LEVEL_NS + DT_NS)]
        assert pitches == [DOWN_RAD, TRIM.alpha_rad]


def test_an_estimate_in_which_a_fault_is_seen_is_not_asked_either():
    t_ns = LEVEL_NS + DT_NS
    assert begun().setpoint(away_at(t_ns, 1.0, integrity=integrity_at(t_ns, "residual"))).pitch_rad == TRIM.alpha_rad
    assert SIGHT_LOST in DISTRUSTED
    assert OPERATOR not in DISTRUSTED


@pytest.mark.parametrize(
    "state_of",
    [
        pytest.param(lambda t_ns: None, id="none"),
        pytest.param(lambda t_ns: state_at(t_ns, (-99.0, 0.0, 0.0), age_ns=t_ns), id="dead"),
        pytest.param(lambda t_ns: state_at(t_ns, (math.inf, 0.0, 0.0)), id="broken"),
    ],
)
def test_without_an_estimate_it_flies_level_after_its_time(state_of):
    breakaway, level_s = begun(), GUIDANCE.breakaway_level_s
    for after_s, pitch_rad in ((level_s - 0.1, DOWN_RAD), (level_s + 0.1, TRIM.alpha_rad)):
        t_ns = round((1.0 + after_s) * S)
        assert breakaway.setpoint(view_at(t_ns, Phase.BREAKAWAY, state=state_of(t_ns))).pitch_rad == pitch_rad


def test_the_guard_lets_it_pass_whole_once_the_rates_have():
    """From full thrust and nose up: on its way at the limits of the rates, there within a third of a second."""
    guard, breakaway = new_guard(), begun()
    guard.passes(AttitudeSetpoint(S, 0.3, TRIM.alpha_rad + 0.12, 0.4, 1.0), view_at(S))
    outs = [guard.passes(breakaway.setpoint(lost_at(S + k * DT_NS)), lost_at(S + k * DT_NS)) for k in range(1, 21)]
    assert all(isinstance(o, AttitudeSetpoint) for o in outs)
    there = [(o.roll_rad, o.pitch_rad, o.thrust) == (0.0, DOWN_RAD, GUIDANCE.breakaway_thrust) for o in outs]
    assert there.index(True) * 0.02 <= 0.35
    assert all(there[there.index(True):])
    falls = [o.pitch_rad for o in outs]
    assert falls == sorted(falls, reverse=True)
