r"""Laws of the guard: whatever goes in, what leaves is inside envelope and rates, and rests on a live estimate.

Every branch of guard, causes and breakaway is taken by these tests and their two neighbours::

    coverage run --branch --include='companion/guidance/*' -m pytest tests/guidance/test_guard*.py \
        tests/guidance/test_breakaway.py && coverage report -m --include='*/guard.py,*/causes.py,*/breakaway.py'
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from guard_views import DT_NS, MS, S, config, envelope, new_guard, shipped, state_at, view_at
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.guidance.causes import allowed_closure_m_s, near_of
from companion.guidance.guard import Guard, clip
from companion.messages import NS, AttitudeSetpoint, OffsetSetpoint, Phase, Reject, VelocitySetpoint

E = envelope()
anything = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(-0.5, 0.5), st.sampled_from([0.0, 1.0, 1e308, -1e308])
)
triples = st.tuples(anything, anything, anything)
near_triples = st.tuples(*[st.floats(-60.0, 60.0)] * 3)
flown = st.sampled_from([p for p in Phase if p is not Phase.STANDBY])
stamps = st.one_of(st.integers(0, 100), st.integers(-(2**62), 2**62))
attitudes = st.builds(AttitudeSetpoint, stamps, anything, anything, anything, anything)
velocities = st.builds(VelocitySetpoint, stamps, triples, anything, triples)
offsets = st.builds(OffsetSetpoint, stamps, triples, triples, anything)
setpoints = st.one_of(attitudes, velocities, offsets)
states = st.builds(
    lambda p, v, box, heading, turn, age_ns: lambda t_ns: state_at(
        t_ns, p, v, age_ns=age_ns, heading=heading, turn=turn, v_box=box),
    st.one_of(near_triples, triples), st.one_of(near_triples, triples), st.one_of(near_triples, triples),
    anything, anything, st.one_of(st.integers(0, 300 * MS), st.integers(-(2**62), 2**62)),
)


def numbers(s):
    if isinstance(s, AttitudeSetpoint):
        return (s.roll_rad, s.pitch_rad, s.yaw_rad, s.thrust)
    return (*s.v_ned_m_s, *(s.a_ned_m_s2 if isinstance(s, VelocitySetpoint) else s.offset_ned_m), s.yaw_rad)


def inside(s):
    """Tell whether a setpoint is finite and inside the envelope."""
    if not all(map(math.isfinite, numbers(s))):
        return False
    if isinstance(s, AttitudeSetpoint):
        return (
            abs(s.roll_rad) <= E.max_roll_rad and abs(s.pitch_rad - E.pitch_trim_rad) <= E.max_pitch_offset_rad + 1e-12
            and abs(s.yaw_rad) <= math.pi and 0.0 <= s.thrust <= 1.0
        )
    size = math.hypot(*(s.a_ned_m_s2 if isinstance(s, VelocitySetpoint) else s.offset_ned_m))
    largest = E.max_acceleration_m_s2 if isinstance(s, VelocitySetpoint) else E.max_offset_m
    return size <= largest and math.hypot(*s.v_ned_m_s) <= E.max_speed_m_s


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(setpoints, st.one_of(st.none(), states), flown, st.booleans(), stamps), max_size=12))
def test_whatever_goes_in_nothing_that_leaves_is_outside_the_envelope_or_on_a_dead_estimate(steps):
    guard, last_ns = new_guard(), None
    for setpoint, make, phase, same, t_ns in steps:
        wanted = replace(setpoint, t_ns=t_ns) if same else setpoint
        state = None if make is None else make(t_ns)
        out = guard.passes(wanted, view_at(t_ns, phase, state=state))
        if isinstance(out, Reject):
            assert out.source == "guard"
            continue
        assert inside(out)
        assert all(map(math.isfinite, numbers(wanted)))
        assert out.t_ns == t_ns
        assert last_ns is None or t_ns > last_ns
        last_ns = t_ns
        if phase is Phase.BREAKAWAY:
            assert isinstance(out, AttitudeSetpoint)
        else:
            assert state is not None
            assert abs(t_ns - state.estimate_t_ns) * NS <= E.estimate_stale_s
            assert near_of(state) is not None


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(attitudes, flown, st.integers(1, 400 * MS), st.floats(-3.0, 3.0)), min_size=2, max_size=12))
def test_no_attitude_is_farther_from_the_last_than_the_rates_allow(steps):
    guard, c, t_ns, last = new_guard(), config(), 0, None
    for setpoint, phase, dt_ns, closing_m_s in steps:
        t_ns += dt_ns
        state = state_at(t_ns, (-5.0, 0.0, 0.0), (closing_m_s, 0.0, 0.0))
        out = guard.passes(replace(setpoint, t_ns=t_ns), view_at(t_ns, phase, state=state))
        if isinstance(out, Reject):
            continue
        if last is not None:
            dt_s = (t_ns - last.t_ns) * NS
            assert abs(out.roll_rad - last.roll_rad) <= c.roll_rate_rad_s * dt_s + 1e-12
            assert abs(out.pitch_rad - last.pitch_rad) <= c.pitch_rate_rad_s * dt_s + 1e-12
            assert abs(out.thrust - last.thrust) <= c.thrust_rate_per_s * dt_s + 1e-12
        last = out


def closures(state, v_ned_m_s):
    """Return how fast a velocity makes the way to the box shorter, and how fast it goes forward: by finite differences.

    The oracle of the guard's algebra: R moves with the velocity, box and frame as the state says, for a millisecond.
    """
    dt_s, (c, s) = 1e-6, (math.cos(state.heading0_rad), math.sin(state.heading0_rad))
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turn = state.turn_rate_rad_s * dt_s
    turned = np.array([[math.cos(turn), math.sin(turn), 0.0], [-math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    p = state.p_mrf_br_m
    later = turned @ (p + R @ (np.array(v_ned_m_s) - state.v_ned_box_m_s) * dt_s)
    rate = (later - p) / dt_s
    flat = np.array([min(p[0], 0.0), p[1], p[2]])
    length = math.hypot(*flat)
    return (rate[0] if length == 0.0 else -rate @ (flat / length)), rate[0]


@given(near_triples, near_triples, st.floats(-3.1, 3.1), st.floats(-0.05, 0.05), st.floats(-5.0, 5.0))
def test_no_velocity_closes_in_faster_than_the_range_allows(p, relative, heading, turn, down):
    assume(math.hypot(*p) > 0.01)
    v_box = (200.0 * math.cos(heading), 200.0 * math.sin(heading), down)
    state = state_at(DT_NS, p, heading=heading, turn=turn, v_box=v_box)
    v = tuple((state.v_ned_box_m_s + np.array(relative)).tolist())
    wanted = VelocitySetpoint(DT_NS, v, 0.0, (1.0, 0.0, 0.0))
    out = new_guard().passes(wanted, view_at(DT_NS, state=state))
    allowed_m_s = allowed_closure_m_s(config(), math.hypot(*p))
    assert max(closures(state, out.v_ned_m_s)) <= allowed_m_s + 1e-3
    was = max(closures(state, v))
    if was < allowed_m_s - 1e-3:
        assert out == wanted
    elif was > allowed_m_s + 1e-3:
        assert out.a_ned_m_s2 == (0.0, 0.0, 0.0)


@given(near_triples, near_triples, near_triples, st.floats(-3.1, 3.1))
def test_no_place_to_be_at_comes_faster_or_is_farther_in_than_closure_allows(p, offset, relative, heading):
    assume(math.hypot(*p) > 0.01)
    state = state_at(DT_NS, p, heading=heading)
    v = tuple((state.v_ned_box_m_s + np.array(relative)).tolist())
    out = new_guard().passes(OffsetSetpoint(DT_NS, offset, v, 0.0), view_at(DT_NS, state=state))
    allowed_m_s = allowed_closure_m_s(config(), math.hypot(*p))
    assert max(closures(state, out.v_ned_m_s)) <= allowed_m_s + 1e-3
    moved = tuple((state.v_ned_box_m_s + np.array(out.offset_ned_m)).tolist())  # an offset taken for a velocity
    assert max(closures(state, moved)) <= allowed_m_s * config().offset_horizon_s + 1e-3
    assert math.hypot(*out.offset_ned_m) <= math.hypot(*offset) + 1e-9


def test_a_velocity_that_jumps_is_brought_there_at_the_largest_acceleration():
    guard = new_guard()
    v0, v1 = (205.0, 0.0, 0.0), (205.0, 3.0, -4.0)
    guard.passes(VelocitySetpoint(0, v0, 0.0), view_at(0))
    out = guard.passes(VelocitySetpoint(DT_NS, v1, 0.0), view_at(DT_NS))
    step = np.subtract(out.v_ned_m_s, v0)
    assert np.linalg.norm(step) == pytest.approx(E.max_acceleration_m_s2 * 0.02)
    assert np.allclose(step / np.linalg.norm(step), [0.0, 0.6, -0.8])
    later = guard.passes(VelocitySetpoint(2 * DT_NS, (205.0, 0.5, -0.4), 0.0), view_at(2 * DT_NS))
    assert later.v_ned_m_s == (205.0, 0.5, -0.4)


@given(st.floats(-0.35, 0.35), st.floats(-0.119, 0.119), st.floats(-3.1, 3.1), st.floats(0, 1), st.integers(0, 299))
def test_what_is_inside_passes_unchanged(roll, pitch, yaw, thrust, age_ms):
    wanted = AttitudeSetpoint(7 * S, roll, E.pitch_trim_rad + pitch, yaw, thrust)
    state = state_at(7 * S, age_ns=age_ms * MS)
    assert new_guard().passes(wanted, view_at(7 * S, state=state)) == wanted


@pytest.mark.parametrize(("v_x_m_s", "thrust"), [(0.99, 0.9), (1.01, E.trim_thrust)])
def test_who_closes_in_too_fast_gets_no_more_thrust_than_level_flight_takes(v_x_m_s, thrust):
    state = state_at(0, (-10.0, 0.0, 3.0), (v_x_m_s, 0.0, 0.0))
    out = new_guard().passes(AttitudeSetpoint(0, 0.0, 0.06, 0.0, 0.9), view_at(0, state=state))
    assert out == AttitudeSetpoint(0, 0.0, 0.06, 0.0, thrust)


LEVEL = AttitudeSetpoint(S, 0.0, 0.06, 0.0, 0.3)


@pytest.mark.parametrize(
    ("setpoint", "changed", "reason"),
    [
        pytest.param(LEVEL, {"phase": Phase.STANDBY}, "standby", id="standby"),
        pytest.param(replace(LEVEL, t_ns=S - 1), {}, "setpoint_of_another_step", id="another-step"),
        pytest.param(replace(LEVEL, roll_rad=math.nan), {}, "setpoint_not_finite", id="nan"),
        pytest.param(VelocitySetpoint(S, (math.inf, 0.0, 0.0), 0.0), {}, "setpoint_not_finite", id="inf"),
        pytest.param(VelocitySetpoint(S, (400.0, 0.0, 0.0), 0.0), {}, "setpoint_outside_envelope", id="fast"),
        pytest.param(VelocitySetpoint(S, (200.0, 0.0, 0.0), 0.0, (0.0, 0.0, 25.0)), {}, "setpoint_outside_envelope",
                     id="sudden"),
        pytest.param(OffsetSetpoint(S, (0.0, 151.0, 0.0), (205.0, 0.0, 0.0), 0.0), {}, "setpoint_outside_envelope",
                     id="far"),
        pytest.param(VelocitySetpoint(S, (200.0, 0.0, 0.0), 0.0), {"phase": Phase.BREAKAWAY}, "no_breakaway_setpoint",
                     id="velocity-in-breakaway"),
        pytest.param(LEVEL, {"state": None}, "estimate_stale", id="no-estimate"),
        pytest.param(LEVEL, {"state": state_at(S, age_ns=301 * MS)}, "estimate_stale", id="old-estimate"),
        pytest.param(LEVEL, {"state": state_at(S, age_ns=-301 * MS)}, "estimate_stale", id="estimate-of-the-future"),
        pytest.param(LEVEL, {"state": state_at(S, (math.nan, 0.0, 0.0))}, "estimate_not_finite", id="estimate-nan"),
        pytest.param(LEVEL, {"state": state_at(S, v_m_s=(0.0, math.inf, 0.0))}, "estimate_not_finite",
                     id="estimate-inf"),
        pytest.param(VelocitySetpoint(S, (205.0, 0.0, 0.0), 0.0), {"state": state_at(S, v_box=(math.nan, 0.0, 0.0))},
                     "estimate_not_finite", id="box-nan"),
    ],
)
def test_what_may_not_leave_is_refused_by_name(setpoint, changed, reason):
    guard = new_guard()
    assert guard.passes(setpoint, view_at(S, **changed)) == Reject(S, "guard", reason)
    assert guard.passes(replace(LEVEL, t_ns=2), view_at(2)) == replace(LEVEL, t_ns=2)  # and is no last setpoint


def test_time_that_stands_still_or_runs_backwards_is_refused_until_reset():
    guard = new_guard()
    assert guard.passes(LEVEL, view_at(S)) == LEVEL
    for t_ns in (S, S - 1):
        assert guard.passes(replace(LEVEL, t_ns=t_ns), view_at(t_ns)).reason == "time_not_forward"
    guard.reset()
    assert guard.passes(replace(LEVEL, t_ns=S - 1), view_at(S - 1)).t_ns == S - 1


def test_a_breakaway_needs_no_estimate_and_never_climbs_or_speeds_up():
    guard = new_guard()
    lost = view_at(S, Phase.BREAKAWAY, state=None)
    out = guard.passes(AttitudeSetpoint(S, 0.1, 0.2, 0.5, 1.0), lost)
    assert out == AttitudeSetpoint(S, 0.1, E.pitch_trim_rad, 0.5, E.trim_thrust)
    down = AttitudeSetpoint(2 * S, 0.0, E.pitch_trim_rad - 0.05, 0.5, 0.05)
    assert guard.passes(down, replace(lost, t_ns=2 * S)) == down


def test_a_setpoint_of_another_kind_has_no_last_one_to_be_near_to():
    guard = new_guard()
    guard.passes(VelocitySetpoint(0, (205.0, 0.0, 0.0), 0.0), view_at(0))
    banked = AttitudeSetpoint(DT_NS, 0.3, 0.06, 0.0, 0.9)
    assert guard.passes(banked, view_at(DT_NS)) == banked
    turned = VelocitySetpoint(2 * DT_NS, (200.0, 9.0, 0.0), 0.0)
    assert guard.passes(turned, view_at(2 * DT_NS)) == turned


@given(st.floats(0.0, 200.0), st.floats(0.0, 200.0))
def test_more_closure_is_allowed_farther_out_and_braking_is_enough_for_it(a, b):
    near, far = sorted((a, b))
    c = config()
    v_near, v_far = allowed_closure_m_s(c, near), allowed_closure_m_s(c, far)
    assert c.closure_m_s <= v_near <= v_far
    assert v_far**2 - v_near**2 <= 2.0 * c.braking_m_s2 * (far - near) + 1e-9


def test_clip():
    assert [clip(v, -1.0, 2.0) for v in (-3.0, 0.5, 7.0)] == [-1.0, 0.5, 2.0]


def test_the_shipped_envelope_is_that_of_airframe_and_guidance():
    trim, guidance = shipped().airframe.trim, shipped().config.guidance
    assert (E.pitch_trim_rad, E.trim_thrust, E.max_roll_rad) == (trim.alpha_rad, trim.throttle, guidance.max_roll_rad)
    assert isinstance(new_guard(), Guard)
