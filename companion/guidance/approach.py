"""One guidance step: phase, reference, law, guard, in that order. No setpoint leaves by another way."""

from __future__ import annotations

import math

import numpy as np

from companion.config import AirframeConfig, GuidanceConfig, WindowConfig
from companion.geometry import Vec, euler_from_rotation
from companion.guidance.guard import Envelope, guard
from companion.guidance.laws import make_law
from companion.guidance.modes import Limits, PhaseMachine, Situation
from companion.guidance.path import CubicPath, Reference, station
from companion.messages import (
    NS,
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Command,
    GuidanceOutput,
    Output,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    Setpoint,
)

SETTLED_SPEED_M_S = 0.5
"""Of the mean over ``SETTLED_MEAN_S``: gusts alone move two aircraft against each other faster for moments."""
SETTLED_MEAN_S = 2.0
HEARTBEAT_STALE_S = 3.0


class Approach:
    """Flies the table of ``modes`` from standby to hold."""

    def __init__(self, config: GuidanceConfig, airframe: AirframeConfig, window: WindowConfig) -> None:
        self._config, self._airframe = config, airframe
        self._desired_m, self._limit_m = np.array(window.desired_m), np.array(window.limit_m)
        self._machine = PhaseMachine(
            Limits(config.estimate_stale_s, config.breakaway_stale_s, config.join_settle_s, config.capture_s)
        )
        trim = airframe.trim
        self._envelope = Envelope(
            config.max_roll_rad, trim.alpha_rad, config.max_pitch_offset_rad, config.estimate_stale_s
        )
        self._law = make_law(airframe, config)
        self._path: CubicPath | None = None
        self._station = station(np.zeros(3))
        self._engaged = config.auto_engage
        self._command: Command | None = None
        self._status: AutopilotStatus | None = None
        self._estimate_ns: int | None = None
        self._settled_since: int | None = None
        self._mean_speed = np.zeros(3)
        self._captured_since: int | None = None

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
            self._engaged = command is Command.ENGAGE

    def step(self, t_ns: int, state: RelativeState | None) -> list[Output]:
        """Run one step; at most one Setpoint is among the outputs."""
        outputs: list[Output] = []
        if state is not None:
            self._estimate_ns = state.estimate_t_ns
        situation = self._situation(t_ns, state)
        change = self._machine.step(t_ns, situation)
        if situation.taken_over and self.phase is Phase.STANDBY and change is not None:
            self._engaged = False
        self._command = None
        if change is not None:
            outputs.append(change)
            self._enter(change, state)
        age_s = math.inf if state is None else (t_ns - state.estimate_t_ns) * NS
        fresh = age_s <= self._config.estimate_stale_s
        if not fresh:
            self._settled_since = self._captured_since = None
        if self.phase is Phase.STANDBY or state is None:
            return outputs
        if not fresh:
            return [*outputs, Reject(t_ns, "guard", "estimate_stale")]
        reference = self._reference(t_ns)
        sent = guard(self._wanted(t_ns, state, reference), age_s, self._envelope)
        self._watch(t_ns, state, reference)
        setpoint = sent if isinstance(sent, Setpoint) else None
        error = state.p_mrf_br_m - reference.p_m
        outputs.append(GuidanceOutput(t_ns, self.phase, reference.p_m, error, self._law.integral_m_s, setpoint))
        outputs.append(sent)
        return outputs

    def _situation(self, t_ns: int, state: RelativeState | None) -> Situation:
        s = self._status
        heard = s is not None and (t_ns - s.t_ns) * NS < HEARTBEAT_STALE_S
        guided = heard and s is not None and s.armed and s.mode is AutopilotMode.GUIDED
        age_s = None if self._estimate_ns is None else (t_ns - self._estimate_ns) * NS
        taken_over = heard and not guided
        if state is None:  # nothing to engage on: a join begins at a known place
            return Situation(age_s, guided, engaged=False, command=self._command, taken_over=taken_over)
        error = state.p_mrf_br_m - self._reference(t_ns).p_m
        return Situation(
            estimate_age_s=age_s,
            guided=guided,
            engaged=self._engaged,
            command=self._command,
            settled_s=_since(t_ns, self._settled_since),
            path_done=self._path is not None and self._path.done(t_ns),
            captured_s=_since(t_ns, self._captured_since),
            inside_limit=bool(np.all(np.abs(state.p_mrf_br_m) <= self._limit_m)),
            tracking_ok=bool(np.sqrt(error @ error) <= self._config.off_path_m),
            in_corridor=self._in_corridor(state.p_mrf_br_m),
            taken_over=taken_over,
        )

    def _in_corridor(self, p_mrf_br_m: Vec) -> bool:
        """Tell whether the straight way to the box is free of the tanker: not ahead of, not above the limit window."""
        x, _, z = p_mrf_br_m.tolist()
        near = float(np.sqrt(p_mrf_br_m @ p_mrf_br_m)) <= self._config.join_range_m
        return near and x <= self._limit_m[0] and z >= -self._limit_m[2]

    def _enter(self, change: PhaseChange, state: RelativeState | None) -> None:
        self._settled_since = self._captured_since = None
        if change.new is Phase.JOIN and state is not None:  # always, see _situation
            self._law.reset()
            self._mean_speed = state.v_mrf_br_m_s
            self._station = station(state.p_mrf_br_m)
        elif change.new is Phase.APPROACH:
            start = self._station.p_m
            fastest_s = 1.5 * float(np.sqrt(start @ start)) / self._config.max_closure_m_s  # a cubic peaks at 1.5 means
            duration_s = max(self._config.path_duration_s, fastest_s)
            self._path = CubicPath(change.t_ns, start, np.zeros(3), duration_s)
        elif change.new in (Phase.STANDBY, Phase.BREAKAWAY):
            self._path = None
            self._station = station(np.zeros(3))
            if change.new is Phase.BREAKAWAY:
                self._engaged = False

    def _reference(self, t_ns: int) -> Reference:
        return self._station if self._path is None else self._path.at(t_ns)

    def _wanted(self, t_ns: int, state: RelativeState, reference: Reference) -> Setpoint:
        if self.phase is not Phase.BREAKAWAY:
            return self._law.step(state, reference)
        yaw, _, _ = euler_from_rotation(state.R_ned_frd)
        trim, c = self._airframe.trim, self._config
        if float(np.sqrt(state.p_mrf_br_m @ state.p_mrf_br_m)) > c.breakaway_separation_m:
            return AttitudeSetpoint(t_ns, 0.0, trim.alpha_rad, yaw, trim.throttle)  # clear of the tanker: level off
        return AttitudeSetpoint(t_ns, 0.0, trim.alpha_rad - c.breakaway_descent_rad, yaw, c.breakaway_thrust)

    def _watch(self, t_ns: int, state: RelativeState, reference: Reference) -> None:
        """Keep since when the receiver has held its station, and since when it has been inside the desired window."""
        error = state.p_mrf_br_m - reference.p_m
        share = 1.0 - math.exp(-1.0 / (SETTLED_MEAN_S * self._config.rate_hz))
        self._mean_speed = self._mean_speed + share * (state.v_mrf_br_m_s - reference.v_m_s - self._mean_speed)
        slow = self._mean_speed @ self._mean_speed < SETTLED_SPEED_M_S**2
        settled = error @ error < self._config.join_tolerance_m**2 and slow
        captured = bool(np.all(np.abs(state.p_mrf_br_m) <= self._desired_m))
        self._settled_since = _mark(self._settled_since, bool(settled), t_ns)
        self._captured_since = _mark(self._captured_since, captured, t_ns)


def _since(t_ns: int, start_ns: int | None) -> float:
    return 0.0 if start_ns is None else (t_ns - start_ns) * NS


def _mark(start_ns: int | None, holds: bool, t_ns: int) -> int | None:
    if not holds:
        return None
    return t_ns if start_ns is None else start_ns


