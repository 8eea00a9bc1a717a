"""One guidance step after another: whatever the estimate does, no setpoint leaves that should not."""

import math
from copy import deepcopy
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, rotation_from_euler
from companion.guidance.approach import HEARTBEAT_STALE_S, Approach
from companion.messages import (
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Command,
    GuidanceOutput,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
)

DT_NS = 20_000_000
S = 1_000_000_000
STATION_M = np.array([-6.0, -2.0, 3.0])


@cache
def shipped():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")


@cache
def untouched(**changed):
    setup = shipped()
    config = msgspec.structs.replace(setup.config.guidance, path_duration_s=6.0, **changed)
    return Approach(config, setup.airframe, setup.tanker.window)


def new_approach(**changed):
    """Return a fresh one; a copy, because designing the law takes 0.1 s."""
    return deepcopy(untouched(**changed))


def state_at(t_ns, p_m=STATION_M, age_s=0.0, v_m_s=(0.0, 0.0, 0.0)):
    pitch = shipped().airframe.trim.alpha_rad
    return RelativeState(
        t_ns, t_ns - round(age_s * S), np.array(p_m, float), np.array(v_m_s, float), np.array([205.7, 0.0, 0.0]),
        np.zeros(3), rotation_from_euler(0.1, pitch, 0.02), np.zeros(3), 0.0, 0.0, SE3.identity(), 20.0,
        1.0, 9,
    )


class Loop:
    """Steps an approach at the guidance rate, with a heartbeat that says GUIDED unless told otherwise."""

    def __init__(self, **changed):
        self.approach = new_approach(**changed)
        self.t_ns = 0
        self.changes = []

    def step(self, state, mode=AutopilotMode.GUIDED):
        if mode is not None:
            self.approach.status_event(AutopilotStatus(self.t_ns, mode, True))
        outputs = self.approach.step(self.t_ns, state)
        self.changes += [o for o in outputs if isinstance(o, PhaseChange)]
        self.t_ns += DT_NS
        return outputs

    def hold_still(self, seconds, p_m=STATION_M, **more):
        out = []
        for _ in range(round(seconds * S / DT_NS)):
            out += self.step(state_at(self.t_ns, p_m, **more))
        return out

    def ride(self, until):
        """Move as the path asks until a phase is reached."""
        p = STATION_M
        for _ in range(1500):
            if self.approach.phase is until:
                return p
            out = self.step(state_at(self.t_ns, p))
            p = next((o.reference_mrf_m for o in out if isinstance(o, GuidanceOutput)), p)
        raise AssertionError(self.changes)


def kinds(outputs, kind):
    return [o for o in outputs if isinstance(o, kind)]


ages = st.one_of(st.floats(0.0, 0.3), st.floats(0.28, 0.32), st.floats(0.3, 5.0))
offsets = st.tuples(*[st.one_of(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0), st.floats(-2000.0, 2000.0))] * 3)
broken = st.sampled_from([None, None, None, None, math.nan])
steps = st.tuples(
    st.booleans(), ages, offsets, broken, st.sampled_from([AutopilotMode.GUIDED] * 6 + [AutopilotMode.MANUAL, None]),
    st.sampled_from([None] * 20 + list(Command)), st.integers(1, 60),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(steps, min_size=1, max_size=25))
def test_whatever_the_estimate_does(sequence):
    """No state or a stale one: no setpoint. Never two; never one that is not finite or outside the envelope."""
    setup = shipped()
    config, trim = setup.config.guidance, setup.airframe.trim
    loop = Loop(join_settle_s=0.1, capture_s=0.1)
    for present, age_s, p_m, poison, mode, command, repeats in sequence:
        if command is not None:
            loop.approach.command_event(command)
        for _ in range(repeats):
            state = state_at(loop.t_ns, p_m, age_s) if present else None
            if state is not None and poison is not None:
                state.p_mrf_br_m[1] = poison
            before = loop.approach.phase
            outputs = loop.step(state, mode)
            setpoints = kinds(outputs, AttitudeSetpoint)
            assert len(setpoints) <= 1
            told = [g.setpoint for g in kinds(outputs, GuidanceOutput)]
            assert told in ([], [*setpoints, None][:1])  # the record tells what was sent
            if not setpoints:
                continue
            s = setpoints[0]
            assert state is not None
            assert loop.approach.phase is not Phase.STANDBY
            assert (s.t_ns - state.estimate_t_ns) * 1e-9 <= config.estimate_stale_s + 1e-12
            assert abs(s.roll_rad) <= config.max_roll_rad
            assert abs(s.pitch_rad - trim.alpha_rad) <= config.max_pitch_offset_rad + 1e-12
            assert abs(s.yaw_rad) <= math.pi
            assert 0.0 <= s.thrust <= 1.0
            if before is Phase.BREAKAWAY and loop.approach.phase is Phase.BREAKAWAY:
                clear = np.linalg.norm(state.p_mrf_br_m) > config.breakaway_separation_m
                assert (s.roll_rad, s.thrust) == (0.0, trim.throttle if clear else config.breakaway_thrust)


def test_the_way_to_hold_and_a_setpoint_in_every_step_of_it():
    loop = Loop()
    p = loop.ride(Phase.HOLD)
    assert [c.new for c in loop.changes] == [Phase.JOIN, Phase.APPROACH, Phase.HOLD]
    assert np.allclose(p, 0.0, atol=1e-9)
    assert len(kinds(loop.hold_still(1.0, p), AttitudeSetpoint)) == 50


def test_without_engaging_nothing_is_sent():
    loop = Loop(auto_engage=False)
    assert loop.hold_still(5.0) == []
    loop.approach.command_event(Command.ENGAGE)
    assert loop.hold_still(0.1)[0].new is Phase.JOIN


def test_joining_begins_where_the_receiver_is():
    out = Loop().hold_still(1.0)
    for g in kinds(out, GuidanceOutput):
        assert np.allclose(g.reference_mrf_m, STATION_M)
        assert np.allclose(g.error_mrf_m, 0.0)


def test_a_step_without_a_state_never_begins_the_join():
    """An estimate may be fresh and its state withheld; there would be no station to hold."""
    loop = Loop(auto_engage=False)
    loop.hold_still(0.1)
    loop.approach.command_event(Command.ENGAGE)
    loop.step(None)
    assert loop.approach.phase is Phase.STANDBY
    out = loop.hold_still(0.2)
    assert loop.approach.phase is Phase.JOIN
    assert all(np.allclose(g.reference_mrf_m, STATION_M) for g in kinds(out, GuidanceOutput))


def test_a_stale_estimate_stops_setpoints_at_once_and_breaks_away_after_a_second():
    loop = Loop()
    loop.hold_still(1.0)
    start_ns = loop.t_ns
    sent = []
    while loop.approach.phase is not Phase.BREAKAWAY:
        age_ns = loop.t_ns - start_ns
        sent += [age_ns * 1e-9 for _ in kinds(loop.step(state_at(loop.t_ns, age_s=age_ns * 1e-9)), AttitudeSetpoint)]
    assert 0.28 <= max(sent) <= 0.3
    assert 1.0 < (loop.changes[-1].t_ns - start_ns) * 1e-9 <= 1.04
    assert loop.changes[-1].reason == "estimate lost"


def test_refused_setpoints_tell_why():
    loop = Loop()
    loop.hold_still(1.0)
    rejects = kinds(loop.step(state_at(loop.t_ns, age_s=0.31)), Reject)
    assert [(r.source, r.reason) for r in rejects] == [("guard", "estimate_stale")]


def test_a_state_that_is_not_a_number_breaks_away_at_once_on_numbers():
    loop = Loop()
    loop.hold_still(1.0)
    [s] = kinds(loop.step(state_at(loop.t_ns, [0.0, math.nan, 0.0])), AttitudeSetpoint)
    assert loop.changes[-1].new is Phase.BREAKAWAY
    assert all(map(math.isfinite, (s.roll_rad, s.pitch_rad, s.yaw_rad, s.thrust)))


def test_breakaway_descends_level_with_little_thrust_until_it_is_cleared_and_stays_disengaged():
    loop = Loop()
    loop.ride(Phase.HOLD)
    loop.approach.command_event(Command.BREAKAWAY)
    out = loop.hold_still(3.0, [-1.0, 0.0, 1.0])
    assert loop.changes[-1].reason == "operator's command"
    trim, config = shipped().airframe.trim, shipped().config.guidance
    sent = kinds(out, AttitudeSetpoint)
    assert len(sent) == 150
    wanted = (0.0, trim.alpha_rad - config.breakaway_descent_rad, config.breakaway_thrust)
    assert {(s.roll_rad, s.pitch_rad, s.thrust) for s in sent} == {wanted}
    loop.approach.command_event(Command.ENGAGE)
    loop.hold_still(1.0)
    assert loop.approach.phase is Phase.BREAKAWAY
    loop.approach.command_event(Command.CLEAR)
    assert kinds(loop.hold_still(5.0), AttitudeSetpoint) == []
    assert loop.approach.phase is Phase.STANDBY


def test_a_second_approach_knows_nothing_of_the_first():
    loop = Loop()
    loop.ride(Phase.HOLD)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.hold_still(1.0)
    loop.approach.command_event(Command.CLEAR)
    loop.hold_still(0.1)
    loop.approach.command_event(Command.ENGAGE)
    again = [replace(s, t_ns=0) for s in kinds(loop.hold_still(1.0), AttitudeSetpoint)]
    first = [replace(s, t_ns=0) for s in kinds(Loop().hold_still(1.0), AttitudeSetpoint)]
    assert again == first


def test_leaving_the_limit_window_in_hold_breaks_away():
    loop = Loop()
    loop.ride(Phase.HOLD)
    loop.step(state_at(loop.t_ns, [-2.2, 0.0, 0.0]))
    assert loop.changes[-1].new is Phase.BREAKAWAY
    assert loop.changes[-1].reason == "outside the limit window"


def test_a_silent_heartbeat_or_another_mode_ends_the_setpoints():
    loop = Loop()
    loop.hold_still(1.0)
    assert kinds(loop.step(state_at(loop.t_ns), AutopilotMode.MANUAL), AttitudeSetpoint) == []
    assert loop.approach.phase is Phase.STANDBY
    loop = Loop()
    loop.hold_still(1.0)
    begin_ns, sent_ns = loop.t_ns, []
    for _ in range(250):
        sent_ns += [s.t_ns for s in kinds(loop.step(state_at(loop.t_ns), None), AttitudeSetpoint)]
    assert loop.approach.phase is Phase.STANDBY
    assert HEARTBEAT_STALE_S - 0.1 < (max(sent_ns) - begin_ns) * 1e-9 < HEARTBEAT_STALE_S


@pytest.mark.parametrize("overtaking", [Command.ENGAGE, Command.CLEAR])
def test_nothing_overtakes_a_breakaway(overtaking):
    loop = Loop()
    loop.hold_still(1.0)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.approach.command_event(overtaking)
    loop.hold_still(0.02)
    assert loop.approach.phase is Phase.BREAKAWAY


@pytest.mark.parametrize("p_m", [[30.0, 0.0, 20.0], [-20.0, 0.0, -10.0], [-1900.0, 0.0, 30.0]])
def test_no_join_from_ahead_above_or_far_away(p_m):
    loop = Loop()
    assert loop.hold_still(1.0, np.array(p_m)) == []
    assert loop.approach.phase is Phase.STANDBY


def test_no_join_while_the_autopilot_is_disarmed():
    loop = Loop()
    for _ in range(50):
        loop.approach.status_event(AutopilotStatus(loop.t_ns, AutopilotMode.GUIDED, armed=False))
        assert loop.step(state_at(loop.t_ns), None) == []


def test_time_without_an_estimate_does_not_count_as_time_on_station():
    loop = Loop(join_settle_s=1.0)
    loop.hold_still(0.6)
    for _ in range(40):
        loop.step(None)
    loop.hold_still(0.6)
    assert loop.approach.phase is Phase.JOIN
    loop.hold_still(0.6)
    assert loop.approach.phase is Phase.APPROACH


def test_a_long_way_takes_longer_than_the_path_time():
    loop = Loop(max_closure_m_s=1.0)
    p, references = np.array([-60.0, 0.0, 20.0]), []
    for _ in range(round(110.0 * S / DT_NS)):
        for g in kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput):
            p = g.reference_mrf_m
            references.append(p)
    speeds = np.linalg.norm(np.diff(references, axis=0), axis=1) / (DT_NS / S)
    assert loop.approach.phase is Phase.HOLD
    assert 0.99 < speeds.max() <= 1.0 + 1e-6


def test_a_pilot_who_takes_over_ends_a_breakaway_and_the_engagement():
    loop = Loop()
    loop.hold_still(1.0)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.hold_still(0.1)
    loop.step(state_at(loop.t_ns), AutopilotMode.MANUAL)
    assert loop.approach.phase is Phase.STANDBY
    assert loop.hold_still(1.0) == []
