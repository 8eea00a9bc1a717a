"""One guidance step: cause, phase, reference, law, guard, in that order. No setpoint leaves by another way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from companion.config import AirframeConfig, GuidanceConfig, WindowConfig
from companion.geometry import Vec
from companion.guidance.breakaway import Breakaway
from companion.guidance.guard import Guard, View, envelope_of
from companion.guidance.lasting import Lasting
from companion.guidance.laws import make_law
from companion.guidance.modes import OBEYED, Limits, PhaseMachine, Situation
from companion.guidance.path import Closure, Path, Reference, back_off, closure, cubic, retreat, station
from companion.guidance.self_test import SelfTest
from companion.messages import (
    NS,
    AutopilotMode,
    AutopilotStatus,
    Command,
    GuidanceOutput,
    Integrity,
    Output,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    Setpoint,
    Sources,
)

SETTLED_SPEED_M_S = 0.5
STABLE_SPEED_M_S = 0.2
"""Of the mean over ``SETTLED_MEAN_S``, in the join and at the pre-contact point, where closure is zero: gusts alone
move two aircraft against each other faster for moments."""
SETTLED_MEAN_S = 2.0
SELF_TESTS, TRY_AGAIN_S = 3, 3.0
"""So many self-tests, so far apart, before an engagement that no operator gave is over."""
DIRECT_M_S = 0.8
"""Peak of the direct procedure's cubic, which is at half the way, where the guard allows 1 m/s and a little more."""
BOX = np.zeros(3)


class Approach:
    """Flies the table of ``modes`` from standby to hold and back."""

    def __init__(self, config: GuidanceConfig, airframe: AirframeConfig, window: WindowConfig) -> None:
        self._config, self._airframe = config, airframe
        self._desired_m, self._limit_m = np.array(window.desired_m), np.array(window.limit_m)
        self._pre_contact_m = np.array(config.pre_contact_m)
        self._direct = config.procedure == "direct"
        self._machine = PhaseMachine(limits_of(config))
        self._closing = Closure(
            config.approach_closure_m_s, config.contact_closure_m_s, config.contact_near_m, config.closure_m_s2
        )
        self._guard = Guard(config.guard, envelope_of(config, airframe), window)
        self._breakaway = Breakaway(config, airframe)
        self._self_test = SelfTest(airframe.response)
        self._law = make_law(airframe, config)
        self._path: Path | None = None
        self._station = station(BOX)
        self._engaged = self._by_itself = config.auto_engage  # by itself: until it flies, or an operator says something
        self._tests = 0
        self._cleared = False
        self._operator_only = False  # an operator took the receiver back: no gate opens by itself
        self._command: Command | None = None
        self._status: AutopilotStatus | None = None
        self._integrity: Integrity | None = None
        self._lasting = Lasting()
        self._mean_speed = np.zeros(3)
        self._phase_ns = 0

    @property
    def phase(self) -> Phase:
        """Return the present phase."""
        return self._machine.phase

    def status_event(self, status: AutopilotStatus) -> None:
        """Take the autopilot's heartbeat."""
        self._status = status

    def command_event(self, command: Command) -> None:
        """Take an operator's command; it is looked at in the next step. Nothing overtakes a breakaway."""
        if self._command is not Command.BREAKAWAY:
            self._command = command

    def step(
        self, t_ns: int, state: RelativeState | None, sources: Sources, integrity: Integrity | None
    ) -> list[Output]:
        """Run one step; at most one Setpoint is among the outputs.

        No ``integrity`` monitor: it is not asked. Once it has spoken, its verdict holds in steps in which it does not.
        """
        self._integrity = None if self._direct else integrity or self._integrity
        outputs = self._obey(t_ns)
        fresh = state is not None and abs(t_ns - state.estimate_t_ns) * NS <= self._config.estimate_stale_s
        view = self._view(t_ns, state, sources, self._integrity)
        cause = self._guard.cause(view)
        self._breakaway.see(view)
        self._watch(view, state if fresh else None)
        situation = self._situation(view, cause)
        change = self._machine.step(t_ns, situation)
        self._command = None
        if change is not None:
            outputs.append(change)
            outputs += self._enter(change, state, situation)
        return outputs + self._fly(replace(view, phase=self.phase), fresh)

    def _obey(self, t_ns: int) -> list[Output]:
        """Take what the command asks besides moving the table; refuse one that the phase has no use for."""
        command = self._command
        if command is None:
            return []
        refusal = self._refusal(command, t_ns)
        if refusal:
            self._command = None
            return [Reject(t_ns, "operator", f"{command}_not_now", refusal)]
        if command in (Command.ENGAGE, Command.BREAKAWAY, Command.CLEAR):
            self._engaged, self._by_itself, self._tests = command is Command.ENGAGE, False, 0
        gates = {Command.PRE_CONTACT: Phase.OBSERVATION, Command.CONTACT: Phase.PRE_CONTACT}
        self._cleared = self._cleared or gates.get(command) is self.phase
        return []

    def _refusal(self, command: Command, t_ns: int) -> str:
        """Return why there is no use for a command now; empty when there is."""
        if self.phase not in OBEYED.get(command, frozenset()):
            return f"phase {self.phase}"
        if command is Command.PRE_CONTACT and self._direct:
            return "the direct procedure does not come from there"
        if command is Command.ENGAGE and not self._is_guided(t_ns):  # nor later by itself, when nobody expects it
            return "the autopilot is not armed and guided" if self._is_heard(t_ns) else "the autopilot is silent"
        return ""

    def _is_heard(self, t_ns: int) -> bool:
        s = self._status
        return s is not None and abs(t_ns - s.t_ns) * NS <= self._config.guard.heartbeat_lost_s

    def _is_guided(self, t_ns: int) -> bool:
        s = self._status
        return s is not None and self._is_heard(t_ns) and s.armed and s.mode is AutopilotMode.GUIDED

    def _view(
        self, t_ns: int, state: RelativeState | None, sources: Sources, integrity: Integrity | None
    ) -> View:
        error_m = None
        if state is not None and self.phase not in (Phase.STANDBY, Phase.SELF_TEST, Phase.BREAKAWAY):
            error = state.p_mrf_br_m - self._reference(t_ns).p_m
            error_m = float(np.sqrt(error @ error))
        return View(
            t_ns, self.phase, state, sources, None if self._status is None else self._status.t_ns, integrity,
            self._command is Command.BREAKAWAY, error_m,
        )

    def _watch(self, view: View, state: RelativeState | None) -> None:
        """Keep since when what the table asks for has held; ``state`` None: nothing holds on an old estimate."""
        t_ns, keep = view.t_ns, self._lasting.keep
        settled = captured = False
        if state is not None:
            reference = self._reference(t_ns)
            error = state.p_mrf_br_m - reference.p_m
            share = 1.0 - math.exp(-1.0 / (SETTLED_MEAN_S * self._config.rate_hz))
            self._mean_speed = self._mean_speed + share * (state.v_mrf_br_m_s - reference.v_m_s - self._mean_speed)
            arrived = self._path is None or self._path.done(t_ns)
            settled = arrived and self._is_settled(error)
            captured = bool(np.all(np.abs(state.p_mrf_br_m) <= self._desired_m))
        seen_ns, i = view.sources.sight_ns, view.integrity
        seen = seen_ns is not None and abs(t_ns - seen_ns) * NS <= self._config.guard.sight_lost_s
        keep("settled", settled, t_ns)
        keep("captured", captured, t_ns)
        keep("observed", state is not None and seen and (i is None or not i.faults), t_ns)
        keep("may_dock", i is None or i.may_dock, t_ns)
        keep("may_not_dock", i is not None and not i.may_dock and not i.faults, t_ns)

    def _is_settled(self, error: Vec) -> bool:
        stable = self.phase is Phase.PRE_CONTACT
        within_m = self._config.stabilise_tolerance_m if stable else self._config.join_tolerance_m
        speed_m_s = STABLE_SPEED_M_S if stable else SETTLED_SPEED_M_S
        return bool(error @ error < within_m**2 and self._mean_speed @ self._mean_speed < speed_m_s**2)

    def _situation(self, view: View, cause: str | None) -> Situation:
        t_ns, state = view.t_ns, view.state
        guided = self._is_guided(t_ns)
        taken_over = self._is_heard(t_ns) and not guided
        if taken_over and self.phase is Phase.STANDBY and not self._by_itself:
            self._engaged = False
        follows = self._self_test.result(t_ns) if self.phase is Phase.SELF_TEST else None
        automatic = self._config.auto_gates and not self._operator_only
        since = self._lasting.since
        return Situation(
            estimate_age_s=None if state is None else abs(t_ns - state.estimate_t_ns) * NS,
            guided=guided,
            engaged=self._engaged and (not self._tests or (t_ns - self._phase_ns) * NS >= TRY_AGAIN_S),
            command=self._command,
            cause=cause,
            taken_over=taken_over,
            in_corridor=state is not None and self._in_corridor(state.p_mrf_br_m, seen=self._lasting.holds("observed")),
            cleared=self._cleared or automatic,
            tested=None if follows is None else not follows.fault,
            settled_s=since("settled", t_ns),
            observed_s=since("observed", t_ns),
            may_dock_s=since("may_dock", t_ns),
            may_not_dock_s=since("may_not_dock", t_ns),
            path_done=self._path is None or self._path.done(t_ns),
            captured_s=since("captured", t_ns),
            phase_s=(t_ns - self._phase_ns) * NS,
        )

    def _in_corridor(self, p_mrf_br_m: Vec, *, seen: bool) -> bool:
        """Tell whether the straight way to the box is free of the tanker: not ahead of, not above the limit window.

        Within ``closure_range_m`` of the box the tanker has to be ``seen``, without a fault, or nothing begins there.
        """
        x, _, z = p_mrf_br_m.tolist()
        range_m = float(np.sqrt(p_mrf_br_m @ p_mrf_br_m))
        near = range_m <= self._config.join_range_m and (seen or range_m > self._config.guard.closure_range_m)
        return near and x <= self._limit_m[0] and z >= -self._limit_m[2]

    # ---- what begins with a phase -------------------------------------------------------------------------------

    def _enter(self, change: PhaseChange, state: RelativeState | None, situation: Situation) -> list[Output]:
        """Begin a phase; return what there is to tell besides."""
        t_ns, c = change.t_ns, self._config
        now = self._reference(t_ns)
        self._lasting.forget()
        self._cleared = False
        self._phase_ns = t_ns
        if change.old is Phase.STANDBY:
            self._guard.reset()
            self._by_itself = False
        match change.new:
            case Phase.SELF_TEST if state is not None:  # always, by its row: engaged on a fresh estimate
                self._self_test.begin(t_ns, state.R_ned_frd)
            case Phase.JOIN if state is not None:
                self._law.reset()
                self._mean_speed = state.v_mrf_br_m_s
                self._path, self._station = self._backing_off(t_ns, state.p_mrf_br_m), station(state.p_mrf_br_m)
                self._tests = 0
            case Phase.PRE_CONTACT:
                self._to_pre_contact(change, now, called_back=situation.command is Command.PRE_CONTACT)
            case Phase.APPROACH if self._direct:
                self._path = cubic(t_ns, now.p_m, BOX, DIRECT_M_S, c.transit_m_s2, c.path_duration_s)
            case Phase.APPROACH:
                self._path = closure(t_ns, now.p_m, self._closing)
            case Phase.DISCONNECT:
                self._operator_only = True
                self._path = retreat(t_ns, now, self._pre_contact_m, self._closing)
            case Phase.STANDBY | Phase.BREAKAWAY:
                return self._let_go(change, situation)
        return []

    def _backing_off(self, t_ns: int, p_m: Vec) -> Path | None:
        """Return the way out for a join that begins near the box, as after a restart; None where it holds its place.

        The direct procedure has no pre-contact point; it holds, and what it watches there keeps it safe.
        """
        range_m = float(np.sqrt(p_m @ p_m))
        out_m = float(np.sqrt(self._pre_contact_m @ self._pre_contact_m))
        if self._direct or range_m >= min(out_m, self._config.guard.closure_range_m):
            return None
        return back_off(t_ns, p_m, self._pre_contact_m, self._closing)

    def _to_pre_contact(self, change: PhaseChange, now: Reference, *, called_back: bool) -> None:
        t_ns, c = change.t_ns, self._config
        self._station = station(self._pre_contact_m)
        if change.old is Phase.OBSERVATION:
            self._path = cubic(t_ns, now.p_m, self._pre_contact_m, c.max_closure_m_s, c.transit_m_s2)
        elif change.old is Phase.DISCONNECT:
            self._path = None
        else:
            self._operator_only = self._operator_only or called_back
            self._path = retreat(t_ns, now, self._pre_contact_m, self._closing)

    def _let_go(self, change: PhaseChange, situation: Situation) -> list[Output]:
        """End the flight of the law; return why a self-test failed."""
        self._path, self._station = None, station(BOX)
        self._operator_only = False
        if change.new is Phase.BREAKAWAY:
            self._engaged = False
            self._breakaway.begin(change.t_ns, change.reason)
        elif situation.taken_over:
            self._engaged = False
        elif change.old is Phase.SELF_TEST and situation.tested is not None:
            self._tests += 1
            self._engaged = self._config.auto_engage and self._tests < SELF_TESTS
            follows = self._self_test.result(change.t_ns)
            reason = "estimate_stale" if follows is None or situation.tested else follows.fault
            return [Reject(change.t_ns, "self_test", reason, str(follows))]
        return []

    # ---- what is flown ------------------------------------------------------------------------------------------

    def _reference(self, t_ns: int) -> Reference:
        return self._station if self._path is None else self._path.at(t_ns)

    def _fly(self, view: View, fresh: bool) -> list[Output]:
        """Return the setpoint of this step and its record, or why there is none."""
        state, t_ns = view.state, view.t_ns
        if self.phase is Phase.STANDBY:
            return []
        if self.phase is Phase.BREAKAWAY:
            return self._told(view, station(BOX), self._guard.passes(self._breakaway.setpoint(view), view))
        if state is None:
            return []
        if not fresh:
            return [Reject(t_ns, "guard", "estimate_stale")]
        if self.phase is Phase.SELF_TEST:
            wanted = self._self_test.setpoint(t_ns, state.R_ned_frd, self._airframe.trim.throttle)
            sent = self._guard.passes(wanted, view)
            self._self_test.sent(sent)
            return self._told(view, station(state.p_mrf_br_m), sent)
        reference = self._reference(t_ns)
        return self._told(view, reference, self._guard.passes(self._law.step(state, reference), view))

    def _told(self, view: View, reference: Reference, sent: Setpoint | Reject) -> list[Output]:
        """Return what was sent, behind its record."""
        if view.state is None:
            return [sent]
        setpoint = sent if isinstance(sent, Setpoint) else None
        error = view.state.p_mrf_br_m - reference.p_m
        integral = self._law.integral_m_s
        return [GuidanceOutput(view.t_ns, self.phase, reference.p_m, error, integral, setpoint), sent]


def limits_of(config: GuidanceConfig) -> Limits:
    """Return times and switches of the table."""
    return Limits(
        estimate_stale_s=config.estimate_stale_s,
        join_settle_s=config.join_settle_s,
        observation_s=config.observation_s,
        stabilise_s=config.stabilise_s,
        may_dock_s=config.may_dock_s,
        retreat_s=config.retreat_s,
        capture_s=config.capture_s,
        contact_timeout_s=config.contact_timeout_s,
        self_test=config.self_test,
        direct=config.procedure == "direct",
    )
