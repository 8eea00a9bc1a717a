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
from companion.guidance.approach import DIRECT_M_S, SELF_TESTS, TRY_AGAIN_S, Approach
from companion.guidance.self_test import DURATION_S
from companion.messages import (
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Command,
    GuidanceOutput,
    Integrity,
    OffsetSetpoint,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    Sources,
    VelocitySetpoint,
)

DT_NS = 20_000_000
S = 1_000_000_000
STATION_M = np.array([-16.0, -4.0, 6.0])
NEAR_M = np.array([-6.0, -2.0, 3.0])
PRE_CONTACT_M = np.array([-15.0, 0.0, 5.0])
ALERT_M = np.array([0.4, 1.87, 0.9])
DOCKS = [Phase.SELF_TEST, Phase.JOIN, Phase.OBSERVATION, Phase.PRE_CONTACT, Phase.APPROACH, Phase.CONTACT, Phase.HOLD]


@cache
def shipped():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")


@cache
def untouched(**changed):
    setup = shipped()
    config = msgspec.structs.replace(setup.config.guidance, **changed)
    return Approach(config, setup.airframe, setup.tanker.window)


def new_approach(**changed):
    """Return a fresh one; a copy, because designing the law takes 0.1 s."""
    return deepcopy(untouched(**changed))


def state_at(t_ns, p_m=STATION_M, age_s=0.0, v_m_s=(0.0, 0.0, 0.0), roll_rad=0.02):
    pitch = shipped().airframe.trim.alpha_rad
    return RelativeState(
        t_ns, t_ns - round(age_s * S), np.array(p_m, float), np.array(v_m_s, float), np.array([205.7, 0.0, 0.0]),
        np.zeros(3), rotation_from_euler(0.1, pitch, roll_rad), np.zeros(3), 0.0, 0.0, SE3.identity(), 20.0,
        1.0, 9, np.diag([0.01, 0.01, 0.01]),
    )


def trusted(t_ns, *, docks=True, faults=()):
    level_m = ALERT_M * (0.5 if docks else 2.0)
    return Integrity(t_ns, level_m, ALERT_M, docks and not faults, tuple(faults))


class Loop:
    """Steps an approach at the guidance rate, with all well unless told otherwise; the roll follows what was sent."""

    def __init__(self, **changed):
        self.approach = new_approach(**changed)
        self.t_ns = 0
        self.changes = []
        self.rejects = []
        self.roll_rad, self._roll_rate, self.asked_rad = 0.02, 0.0, 0.02
        self.gain = 1.0

    @property
    def phase(self):
        return self.approach.phase

    def _roll(self):
        r = shipped().airframe.response
        for _ in range(10):
            error = 0.02 + self.gain * (self.asked_rad - 0.02) - self.roll_rad
            acceleration = r.roll_rad_s**2 * error - 2 * r.roll_damping * r.roll_rad_s * self._roll_rate
            self._roll_rate += 0.002 * acceleration
            self.roll_rad += 0.002 * self._roll_rate

    def step(self, state, mode=AutopilotMode.GUIDED, sources=None, integrity="well"):
        t = self.t_ns
        if mode is not None:
            self.approach.status_event(AutopilotStatus(t, mode, True))
        sources = Sources(t, t, t, t) if sources is None else sources
        outputs = self.approach.step(t, state, sources, trusted(t) if integrity == "well" else integrity)
        self.changes += kinds(outputs, PhaseChange)
        self.rejects += kinds(outputs, Reject)
        for sent in kinds(outputs, AttitudeSetpoint):
            self.asked_rad = sent.roll_rad
        self._roll()
        self.t_ns += DT_NS
        return outputs

    def hold_still(self, seconds, p_m=STATION_M, mode=AutopilotMode.GUIDED, sources=None, integrity="well", **more):
        out = []
        for _ in range(round(seconds * S / DT_NS)):
            out += self.step(state_at(self.t_ns, p_m, roll_rad=self.roll_rad, **more), mode, sources, integrity)
        return out

    def ride(self, until, p=STATION_M, most_s=150.0, integrity="well"):
        """Move as the path asks until a phase is reached; return where, and the outputs."""
        out = []
        for _ in range(round(most_s * S / DT_NS)):
            if self.phase is until:
                return p, out
            integrity_now = integrity(self, p) if callable(integrity) else integrity
            now = self.step(state_at(self.t_ns, p, roll_rad=self.roll_rad), integrity=integrity_now)
            p = next((o.reference_mrf_m for o in now if isinstance(o, GuidanceOutput)), p)
            out += now
        raise AssertionError(self.changes)

    def news(self):
        return [c.new for c in self.changes]


def kinds(outputs, kind):
    return [o for o in outputs if isinstance(o, kind)]


def manual(**changed):
    """Return a loop whose gates wait for the operator."""
    return Loop(auto_gates=False, **changed)


ages = st.one_of(st.floats(0.0, 0.3), st.floats(0.28, 0.32), st.floats(0.3, 5.0))
offsets = st.tuples(*[st.one_of(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0), st.floats(-2000.0, 2000.0))] * 3)
broken = st.sampled_from([None, None, None, None, math.nan])
flights = st.tuples(
    st.booleans(), ages, offsets, broken, st.sampled_from([AutopilotMode.GUIDED] * 6 + [AutopilotMode.MANUAL, None]),
    st.sampled_from([None] * 20 + list(Command)), st.sampled_from(["well", "well", "well", None, "poor", "fault"]),
    st.booleans(), st.integers(1, 60),
)
QUICK = {
    "self_test": False, "join_settle_s": 0.1, "observation_s": 0.1, "stabilise_s": 0.1, "may_dock_s": 0.1,
    "capture_s": 0.1,
}


@settings(max_examples=100, deadline=None)
@given(st.lists(flights, min_size=1, max_size=25), st.sampled_from(["refuelling", "direct"]))
def test_whatever_the_estimate_does(sequence, procedure):
    """No state or a stale one: no setpoint but a breakaway's. Never two; never one that is not finite or too large.
    Nothing in standby, no hold without contact, and no way out of a breakaway but a clear and a pilot.
    """
    setup = shipped()
    config, trim = setup.config.guidance, setup.airframe.trim
    loop = Loop(procedure=procedure, **QUICK)
    for present, age_s, p_m, poison, mode, command, trust, seen, repeats in sequence:
        if command is not None:
            loop.approach.command_event(command)
        for k in range(repeats):
            state = state_at(loop.t_ns, p_m, age_s) if present else None
            if state is not None and poison is not None:
                state.p_mrf_br_m[1] = poison
            integrity = {
                "well": trusted(loop.t_ns), None: None, "poor": trusted(loop.t_ns, docks=False),
                "fault": trusted(loop.t_ns, faults=("residual",)),
            }[trust]
            sources = Sources(*[loop.t_ns] * 3, loop.t_ns if seen else None)
            before = loop.phase
            outputs = loop.step(state, mode, sources, integrity)
            setpoints = kinds(outputs, AttitudeSetpoint)
            assert len(setpoints) <= 1
            told = [g.setpoint for g in kinds(outputs, GuidanceOutput)]
            assert told in ([], [*setpoints, None][:1])  # the record tells what was sent
            assert kinds(outputs, PhaseChange) == ([] if loop.phase is before else [loop.changes[-1]])
            if before is Phase.BREAKAWAY and loop.phase is not before:
                assert loop.phase is Phase.STANDBY
                assert mode is AutopilotMode.MANUAL or (command is Command.CLEAR and k == 0)
            assert loop.phase is not Phase.HOLD or before in (Phase.CONTACT, Phase.HOLD)
            assert not (setpoints and loop.phase is Phase.STANDBY)
            for s in setpoints:
                assert abs(s.roll_rad) <= config.max_roll_rad
                assert abs(s.pitch_rad - trim.alpha_rad) <= config.max_pitch_offset_rad + 1e-12
                assert abs(s.yaw_rad) <= math.pi
                assert 0.0 <= s.thrust <= 1.0
                assert s.t_ns == loop.t_ns - DT_NS
                if loop.phase is not Phase.BREAKAWAY:
                    assert state is not None
                    assert (s.t_ns - state.estimate_t_ns) * 1e-9 <= config.estimate_stale_s + 1e-12
            if loop.phase is Phase.BREAKAWAY:
                assert len(setpoints) == 1  # whatever is still known


def test_the_way_to_hold_and_a_setpoint_in_every_step_of_it():
    loop = Loop()
    p, out = loop.ride(Phase.HOLD)
    assert loop.news() == DOCKS
    assert np.allclose(p, 0.0, atol=1e-9)
    assert len(kinds(out, AttitudeSetpoint)) == round(loop.t_ns / DT_NS)
    assert len(kinds(loop.hold_still(1.0, p), AttitudeSetpoint)) == 50
    assert loop.rejects == []


def test_the_direct_procedure_flies_one_cubic_to_the_box_without_gates_or_integrity():
    loop = manual(procedure="direct", path_duration_s=20.0)
    p, out = loop.ride(Phase.HOLD, NEAR_M, integrity=lambda loop, p: trusted(loop.t_ns, docks=False, faults=("ray",)))
    assert loop.news() == [Phase.SELF_TEST, Phase.JOIN, Phase.APPROACH, Phase.CONTACT, Phase.HOLD]
    began, ended = (next(c.t_ns for c in loop.changes if c.new is phase) for phase in (Phase.APPROACH, Phase.CONTACT))
    assert (ended - began) * 1e-9 == pytest.approx(20.0, abs=0.03)
    half = next(g for g in kinds(out, GuidanceOutput) if g.t_ns >= (began + ended) // 2)
    assert np.allclose(half.reference_mrf_m, 0.5 * NEAR_M, atol=0.02)
    assert np.allclose(p, 0.0, atol=1e-9)


def test_without_engaging_nothing_is_sent():
    loop = Loop(auto_engage=False)
    assert loop.hold_still(5.0) == []
    loop.approach.command_event(Command.ENGAGE)
    assert loop.hold_still(0.1)[0].new is Phase.SELF_TEST


def test_the_pre_contact_point_is_reached_by_a_cubic_that_is_not_too_fast():
    loop = manual()
    loop.ride(Phase.OBSERVATION, np.array([-20.0, -20.0, 21.0]))
    loop.approach.command_event(Command.PRE_CONTACT)
    loop.ride(Phase.PRE_CONTACT, np.array([-20.0, -20.0, 21.0]))
    p, references = np.array([-20.0, -20.0, 21.0]), []
    for _ in range(1500):
        for g in kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput):
            p = g.reference_mrf_m
            references.append(p)
    speeds = np.linalg.norm(np.diff(references, axis=0), axis=1) / (DT_NS / S)
    assert np.allclose(p, PRE_CONTACT_M)
    assert 1.9 < speeds.max() <= shipped().config.guidance.max_closure_m_s + 1e-6
    assert loop.phase is Phase.PRE_CONTACT  # nobody has cleared it further


def test_the_approach_closes_in_slowly_near_the_box():
    loop = Loop()
    _, out = loop.ride(Phase.CONTACT)
    config = shipped().config.guidance
    flown = [g.reference_mrf_m for g in kinds(out, GuidanceOutput) if g.phase is Phase.APPROACH]
    speeds = np.linalg.norm(np.diff(flown, axis=0), axis=1) / (DT_NS / S)
    ranges = np.linalg.norm(flown[1:], axis=1)
    assert speeds.max() == pytest.approx(config.approach_closure_m_s, rel=1e-6)
    assert speeds[ranges <= config.contact_near_m].max() <= 0.3
    assert config.contact_closure_m_s <= 0.3


@pytest.mark.parametrize(("gate", "before", "after"), [
    (Command.PRE_CONTACT, Phase.OBSERVATION, Phase.PRE_CONTACT),
    (Command.CONTACT, Phase.PRE_CONTACT, Phase.APPROACH),
])
def test_a_gate_waits_for_its_own_command_given_in_its_own_phase(gate, before, after):
    loop = manual()
    for early in (Command.PRE_CONTACT, Command.CONTACT):
        loop.approach.command_event(early)  # in standby: nothing that could be cleared
        loop.hold_still(0.02)
    assert [(r.source, r.reason) for r in loop.rejects] == [
        ("operator", "pre_contact_not_now"), ("operator", "contact_not_now")]
    p, _ = loop.ride(Phase.OBSERVATION)
    if before is Phase.PRE_CONTACT:
        loop.approach.command_event(Command.PRE_CONTACT)
        p, _ = loop.ride(Phase.PRE_CONTACT)
        for _ in range(2000):
            g = kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput)
            p = g[0].reference_mrf_m
    loop.hold_still(5.0, p)
    other = ({Command.PRE_CONTACT, Command.CONTACT} - {gate}).pop()
    loop.approach.command_event(other)
    loop.hold_still(1.0, p)
    assert loop.phase is before
    assert loop.rejects[-1].reason == f"{other}_not_now"
    loop.approach.command_event(gate)
    loop.hold_still(0.04, p)
    assert loop.phase is after


def test_a_clearance_given_before_all_is_well_waits_for_that_and_ends_with_the_phase():
    loop = manual()
    loop.ride(Phase.OBSERVATION)
    loop.approach.command_event(Command.PRE_CONTACT)
    loop.hold_still(1.0)
    assert loop.phase is Phase.OBSERVATION
    loop.ride(Phase.PRE_CONTACT)
    loop.approach.command_event(Command.CONTACT)
    p, _ = loop.ride(Phase.APPROACH)
    loop.approach.command_event(Command.PRE_CONTACT)
    p, _ = loop.ride(Phase.PRE_CONTACT, p)
    for _ in range(2000):
        p = kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput)[0].reference_mrf_m
    assert loop.phase is Phase.PRE_CONTACT  # the clearance of before does not count again
    assert np.allclose(p, PRE_CONTACT_M)


@pytest.mark.parametrize("faults", [("gps_vision",), ("unseen",)])
def test_observation_waits_while_there_is_a_fault_or_nothing_is_seen(faults):
    loop = Loop()
    loop.ride(Phase.OBSERVATION)
    loop.hold_still(5.0, integrity=trusted(0, faults=faults))
    assert loop.phase is Phase.OBSERVATION
    t = loop.t_ns
    loop.hold_still(5.0, sources=Sources(t, t, t, t - S))
    assert loop.phase is Phase.OBSERVATION
    loop.hold_still(3.1)
    assert loop.phase is Phase.PRE_CONTACT


def test_without_a_monitor_integrity_is_not_asked():
    loop = Loop()
    loop.ride(Phase.HOLD, integrity=None)
    assert loop.news() == DOCKS


def test_at_the_pre_contact_point_it_waits_for_may_dock():
    loop = Loop()
    p, _ = loop.ride(Phase.PRE_CONTACT)
    for _ in range(1500):
        now = loop.step(state_at(loop.t_ns, p), integrity=trusted(loop.t_ns, docks=False))
        p = kinds(now, GuidanceOutput)[0].reference_mrf_m
    assert loop.phase is Phase.PRE_CONTACT
    began = loop.t_ns
    p, _ = loop.ride(Phase.APPROACH, p)
    assert (loop.t_ns - began) * 1e-9 == pytest.approx(shipped().config.guidance.may_dock_s, abs=0.06)


def test_a_protection_that_grows_in_the_approach_leads_back_without_a_step_and_forward_again():
    loop = Loop()
    p, _ = loop.ride(Phase.APPROACH)
    out = loop.hold_still(0.0)
    while np.linalg.norm(p) > 12.0:
        now = loop.step(state_at(loop.t_ns, p))
        p = kinds(now, GuidanceOutput)[0].reference_mrf_m
        out += now
    for _ in range(12):
        now = loop.step(state_at(loop.t_ns, p), integrity=trusted(loop.t_ns, docks=False))
        p = kinds(now, GuidanceOutput)[0].reference_mrf_m
        out += now
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.PRE_CONTACT, "may not dock")
    p, more = loop.ride(Phase.APPROACH, p)
    references = np.array([g.reference_mrf_m for g in kinds([*out, *more], GuidanceOutput)])
    speeds = np.diff(references, axis=0) / (DT_NS / S)
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.02  # no step in speed on the way back
    assert np.linalg.norm(speeds, axis=1).max() <= shipped().config.guidance.approach_closure_m_s + 1e-6
    assert np.allclose(p, PRE_CONTACT_M, atol=1e-6)
    loop.ride(Phase.HOLD, p)


def test_disconnect_backs_off_slowly_and_another_contact_takes_an_operator():
    loop = Loop()
    p, _ = loop.ride(Phase.HOLD)
    loop.approach.command_event(Command.DISCONNECT)
    p, out = loop.ride(Phase.PRE_CONTACT, p)
    back = np.array([g.reference_mrf_m for g in kinds(out, GuidanceOutput) if g.phase is Phase.DISCONNECT])
    speeds, ranges = np.linalg.norm(np.diff(back, axis=0), axis=1) / (DT_NS / S), np.linalg.norm(back[1:], axis=1)
    assert speeds[ranges < 3.0].max() <= 0.3
    assert np.all(np.diff(ranges) >= -1e-12)
    assert np.allclose(p, PRE_CONTACT_M, atol=1e-6)
    loop.hold_still(20.0, p)
    assert loop.phase is Phase.PRE_CONTACT  # though the gates are automatic
    loop.approach.command_event(Command.CONTACT)
    loop.ride(Phase.HOLD, p)


def test_an_operator_who_calls_back_is_not_overruled_by_automatic_gates():
    loop = Loop()
    p, _ = loop.ride(Phase.CONTACT)
    loop.approach.command_event(Command.PRE_CONTACT)
    p, _ = loop.ride(Phase.PRE_CONTACT, p)
    for _ in range(3000):
        p = kinds(loop.step(state_at(loop.t_ns, p)), GuidanceOutput)[0].reference_mrf_m
    assert loop.phase is Phase.PRE_CONTACT


def test_a_box_that_is_not_held_in_time_is_left_and_tried_again():
    loop = Loop(contact_timeout_s=4.0)
    loop.ride(Phase.CONTACT)
    beside = np.array([0.6, 0.0, 0.0])
    loop.hold_still(3.9, beside)
    assert loop.phase is Phase.CONTACT
    loop.hold_still(0.2, beside)
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.PRE_CONTACT, "not captured in time")
    loop.ride(Phase.HOLD, np.zeros(3))


def test_joining_begins_where_the_receiver_is():
    loop = Loop(self_test=False)
    for g in kinds(loop.hold_still(1.0), GuidanceOutput):
        assert np.allclose(g.reference_mrf_m, STATION_M)
        assert np.allclose(g.error_mrf_m, 0.0)


def test_a_step_without_a_state_never_begins_anything():
    """An estimate may be fresh and its state withheld; there would be no station to hold."""
    loop = Loop(auto_engage=False, self_test=False)
    loop.hold_still(0.1)
    loop.approach.command_event(Command.ENGAGE)
    loop.step(None)
    assert loop.phase is Phase.STANDBY
    out = loop.hold_still(0.2)
    assert loop.phase is Phase.JOIN
    assert all(np.allclose(g.reference_mrf_m, STATION_M) for g in kinds(out, GuidanceOutput))


@pytest.mark.parametrize(("gain", "reason"), [(0.0, "too_little"), (-1.0, "reversed"), (0.45, "too_little")])
def test_an_autopilot_that_does_not_follow_is_not_joined_with(gain, reason):
    loop = Loop(auto_engage=False)
    loop.hold_still(0.1)
    loop.approach.command_event(Command.ENGAGE)
    loop.gain = gain
    loop.hold_still(DURATION_S + 0.1)
    assert loop.news() == [Phase.SELF_TEST, Phase.STANDBY]
    [reject] = loop.rejects
    assert (reject.source, reject.reason) == ("self_test", reason)
    assert reject.detail.startswith("gain ")
    assert loop.hold_still(2.0 * TRY_AGAIN_S) == []  # engaged no more
    loop.gain = 1.0
    loop.approach.command_event(Command.ENGAGE)
    loop.hold_still(DURATION_S + 0.1)
    assert loop.phase is Phase.JOIN


def test_who_engages_by_itself_tries_the_self_test_again_but_not_for_ever():
    loop = Loop()
    loop.gain = 0.0
    loop.hold_still(SELF_TESTS * (DURATION_S + TRY_AGAIN_S) + 20.0)
    assert loop.news() == [Phase.SELF_TEST, Phase.STANDBY] * SELF_TESTS
    begins = [c.t_ns * 1e-9 for c in loop.changes if c.new is Phase.SELF_TEST]
    assert np.allclose(np.diff(begins), DURATION_S + TRY_AGAIN_S, atol=0.1)
    loop = Loop()
    loop.gain = 0.0
    loop.hold_still(DURATION_S + 0.1)
    loop.gain = 1.0
    loop.hold_still(TRY_AGAIN_S + DURATION_S + 0.2)
    assert loop.news() == [Phase.SELF_TEST, Phase.STANDBY, Phase.SELF_TEST, Phase.JOIN]


@pytest.mark.parametrize("ends", [Command.CLEAR, Command.BREAKAWAY, AutopilotMode.MANUAL])
def test_between_two_self_tests_operator_and_pilot_end_the_engagement(ends):
    loop = Loop()
    loop.gain = 0.0
    loop.hold_still(DURATION_S + 0.1)
    if isinstance(ends, Command):
        loop.approach.command_event(ends)
    loop.hold_still(0.1, mode=ends if isinstance(ends, AutopilotMode) else AutopilotMode.GUIDED)
    assert loop.hold_still(10.0) == []


@pytest.mark.parametrize("law", ["attitude", "velocity", "surfaces"])
def test_the_self_test_is_flown_by_attitude_whatever_the_law(law):
    loop = Loop(law=law)
    out = loop.hold_still(DURATION_S)
    assert loop.phase is Phase.SELF_TEST
    sent = kinds(out, AttitudeSetpoint)
    assert len(sent) == round(DURATION_S * S / DT_NS)
    assert max(s.roll_rad for s in sent) == pytest.approx(0.02 + math.radians(3.0))
    assert min(s.roll_rad for s in sent) == pytest.approx(0.02 - math.radians(3.0))
    later = loop.hold_still(0.1)
    assert loop.phase is Phase.JOIN
    wanted = {"attitude": AttitudeSetpoint, "velocity": VelocitySetpoint, "surfaces": OffsetSetpoint}[law]
    assert len(kinds(later, wanted)) == 5


def test_a_stale_estimate_stops_setpoints_at_once_and_then_breaks_away():
    loop = Loop()
    loop.ride(Phase.JOIN)
    loop.hold_still(1.0)
    start_ns = loop.t_ns
    sent = []
    while loop.phase is Phase.JOIN:
        age_ns = loop.t_ns - start_ns
        sent += [age_ns * 1e-9 for _ in kinds(loop.step(state_at(loop.t_ns, age_s=age_ns * 1e-9)), AttitudeSetpoint)]
    assert 0.28 <= max(sent[:-1]) <= 0.3
    assert 1.0 < (loop.changes[-1].t_ns - start_ns) * 1e-9 <= 1.04
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.BREAKAWAY, "estimate lost")
    assert {(r.source, r.reason) for r in loop.rejects} == {("guard", "estimate_stale")}


@pytest.mark.parametrize("phase", [Phase.PRE_CONTACT, Phase.APPROACH, Phase.CONTACT, Phase.HOLD, Phase.DISCONNECT])
def test_a_breakaway_begins_with_its_cause_and_its_reason_is_the_guards(phase):
    loop = Loop()
    p, _ = loop.ride(Phase.HOLD if phase is Phase.DISCONNECT else phase)
    if phase is Phase.DISCONNECT:
        loop.approach.command_event(Command.DISCONNECT)
        p, _ = loop.ride(Phase.DISCONNECT, p)
    seen_ns = loop.t_ns
    while loop.phase is phase:
        t = loop.t_ns
        loop.step(state_at(t, p), sources=Sources(t, t, t, seen_ns))
    assert (loop.changes[-1].new, loop.changes[-1].reason) == (Phase.BREAKAWAY, "sight lost")
    assert 0.3 < (loop.changes[-1].t_ns - seen_ns) * 1e-9 <= 0.5


def test_a_breakaway_goes_on_without_any_estimate():
    loop = Loop()
    loop.ride(Phase.HOLD)
    sent = []
    for _ in range(300):
        sent += kinds(loop.step(None, sources=Sources()), AttitudeSetpoint)
    assert loop.phase is Phase.BREAKAWAY
    assert len(sent) > 270
    trim, config = shipped().airframe.trim, shipped().config.guidance
    wanted = (0.0, trim.alpha_rad - config.breakaway_descent_rad, config.breakaway_thrust)
    last = sent[-1]
    assert (last.roll_rad, last.pitch_rad, last.thrust) == pytest.approx(wanted, abs=1e-12)


def test_breakaway_is_called_stays_until_it_is_cleared_and_stays_disengaged():
    loop = Loop()
    loop.ride(Phase.HOLD)
    loop.approach.command_event(Command.BREAKAWAY)
    out = loop.hold_still(3.0, [-1.0, 0.0, 1.0])
    assert loop.changes[-1].reason == "operator's command"
    assert len(kinds(out, AttitudeSetpoint)) == 150
    loop.approach.command_event(Command.ENGAGE)
    loop.hold_still(1.0)
    assert loop.phase is Phase.BREAKAWAY
    loop.approach.command_event(Command.CLEAR)
    assert kinds(loop.hold_still(5.0), AttitudeSetpoint) == []
    assert loop.phase is Phase.STANDBY


def test_a_second_approach_knows_nothing_of_the_first():
    loop = Loop(self_test=False)
    loop.ride(Phase.HOLD)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.hold_still(1.0)
    loop.approach.command_event(Command.CLEAR)
    loop.hold_still(0.1)
    loop.approach.command_event(Command.ENGAGE)
    loop.roll_rad = loop.asked_rad = 0.02
    loop._roll_rate = 0.0
    again = [replace(s, t_ns=0) for s in kinds(loop.hold_still(1.0), AttitudeSetpoint)]
    first = [replace(s, t_ns=0) for s in kinds(Loop(self_test=False).hold_still(1.0), AttitudeSetpoint)]
    assert len(again) == 50
    assert again == first


def test_another_mode_ends_the_setpoints_at_once_and_a_silent_link_after_its_time():
    loop = Loop(self_test=False)
    loop.hold_still(1.0)
    assert kinds(loop.step(state_at(loop.t_ns), AutopilotMode.MANUAL), AttitudeSetpoint) == []
    assert loop.phase is Phase.STANDBY
    assert loop.hold_still(1.0) == []  # who took over has to engage again
    loop = manual(self_test=False)
    loop.hold_still(1.0)
    begin_ns, sent_ns = loop.t_ns, []
    for _ in range(250):
        sent_ns += [s.t_ns for s in kinds(loop.step(state_at(loop.t_ns), None), AttitudeSetpoint)]
    assert loop.phase is Phase.STANDBY
    assert loop.changes[-1].reason == "autopilot left guided"
    lost_s = shipped().config.guidance.guard.heartbeat_lost_s
    assert lost_s - 0.1 < (max(sent_ns) - begin_ns) * 1e-9 < lost_s
    loop.hold_still(0.1)
    assert loop.phase is Phase.JOIN  # a link that was silent goes on


@pytest.mark.parametrize("overtaking", [Command.ENGAGE, Command.CLEAR, Command.CONTACT])
def test_nothing_overtakes_a_breakaway(overtaking):
    loop = Loop()
    loop.hold_still(1.0)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.approach.command_event(overtaking)
    loop.hold_still(0.02)
    assert loop.phase is Phase.BREAKAWAY


@pytest.mark.parametrize("p_m", [[30.0, 0.0, 20.0], [-20.0, 0.0, -10.0], [-1900.0, 0.0, 30.0]])
def test_no_engagement_from_ahead_above_or_far_away(p_m):
    loop = Loop()
    assert loop.hold_still(1.0, np.array(p_m)) == []
    assert loop.phase is Phase.STANDBY


def test_no_engagement_while_the_autopilot_is_disarmed():
    loop = Loop()
    for _ in range(50):
        loop.approach.status_event(AutopilotStatus(loop.t_ns, AutopilotMode.GUIDED, armed=False))
        assert loop.step(state_at(loop.t_ns), None) == []


@pytest.mark.parametrize("withdrawing", [Command.CLEAR, Command.BREAKAWAY])
def test_an_engagement_is_taken_back_in_standby(withdrawing):
    loop = Loop()
    loop.hold_still(1.0, np.array([30.0, 0.0, 20.0]))
    loop.approach.command_event(withdrawing)
    loop.hold_still(0.1, np.array([30.0, 0.0, 20.0]))
    assert loop.hold_still(1.0) == []
    assert loop.rejects == []


def test_time_without_an_estimate_does_not_count_as_time_on_station():
    loop = Loop(join_settle_s=1.0, self_test=False)
    loop.hold_still(0.6)
    for _ in range(40):
        loop.step(None)
    loop.hold_still(0.6)
    assert loop.phase is Phase.JOIN
    loop.hold_still(0.6)
    assert loop.phase is Phase.OBSERVATION


def test_a_long_way_takes_longer_than_the_path_time():
    loop = Loop(procedure="direct", path_duration_s=6.0, self_test=False)
    _, out = loop.ride(Phase.CONTACT, np.array([-60.0, 0.0, 20.0]))
    references = [g.reference_mrf_m for g in kinds(out, GuidanceOutput)]
    speeds = np.linalg.norm(np.diff(references, axis=0), axis=1) / (DT_NS / S)
    assert 0.99 * DIRECT_M_S < speeds.max() <= DIRECT_M_S + 1e-6


def test_a_pilot_who_takes_over_ends_a_breakaway_and_the_engagement():
    loop = Loop()
    loop.hold_still(1.0)
    loop.approach.command_event(Command.BREAKAWAY)
    loop.hold_still(0.1)
    loop.step(state_at(loop.t_ns), AutopilotMode.MANUAL)
    assert loop.phase is Phase.STANDBY
    assert loop.hold_still(1.0) == []
