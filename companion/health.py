"""How every stage is: there, used in the present phase, and doing what it should. No input, output or clock.

Rules
-----
* A stage is judged by what has come of it, never by what it says of itself alone: samples by their stamps
  (``Sources``), pictures and poses by what vision made of them, guidance by the setpoints that left.
* In the first ``GRACE_S`` nothing is told before all is well: everything has to begin, and who listens knows nothing.
* A stage that fails is told after ``ILL_AFTER_S``, one that is well again after ``WELL_AFTER_S``, so nothing flickers;
  what fails for good is told within half a second. ``detail`` is what it was when it was told.
* Which stages are used in which phase: ``USED``. What is not there and not used harms nobody.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from companion.config import Setup
from companion.guidance.causes import failing
from companion.guidance.lasting import Lasting
from companion.messages import (
    NS,
    AttitudeSetpoint,
    AutopilotStatus,
    CameraFrame,
    Event,
    GpsStatus,
    Health,
    Integrity,
    MarkerFrame,
    OffsetSetpoint,
    Output,
    Phase,
    Reject,
    RelativeState,
    Sources,
    StageHealth,
    TimeStep,
    VelocitySetpoint,
    VisionOutput,
)

CAMERA, VISION, DATALINK, ATTITUDE, POSITION, AUTOPILOT, FUSION, INTEGRITY, GUIDANCE = STAGES = (
    "camera", "vision", "datalink", "attitude", "position", "autopilot", "fusion", "integrity", "guidance",
)  # fmt: skip

_OWN = {CAMERA, ATTITUDE, POSITION, AUTOPILOT}
_FOLLOWS = {*_OWN, DATALINK, FUSION, GUIDANCE}

USED: dict[Phase, frozenset[str]] = {
    Phase.STANDBY: frozenset(_OWN),
    Phase.SELF_TEST: frozenset(_FOLLOWS),
    Phase.JOIN: frozenset(_FOLLOWS),
    Phase.OBSERVATION: frozenset(STAGES) - {INTEGRITY},
    Phase.PRE_CONTACT: frozenset(STAGES),
    Phase.APPROACH: frozenset(STAGES),
    Phase.CONTACT: frozenset(STAGES),
    Phase.HOLD: frozenset(STAGES),
    Phase.DISCONNECT: frozenset(STAGES),
    Phase.BREAKAWAY: frozenset({ATTITUDE, AUTOPILOT, GUIDANCE}),
}
"""Stages by phase: the tanker is not there yet in standby, and a breakaway needs nothing of it."""

GRACE_S = 2.0
"""From the first step on; what an autopilot, a datalink and a camera that are there take to be heard."""
ILL_AFTER_S, WELL_AFTER_S = 0.2, 0.5
STALE_S = 0.3
"""From this age on samples have stopped; at 25 Hz and more that is eight of them."""
PICTURES = 3.5
"""From so many periods of the camera on pictures have stopped, where that is longer."""
SETPOINT_S = 0.1
WHY_S = 1.0
"""A reject explains a stage for so long."""

EXPLAINS = {
    "camera": CAMERA, "vision": VISION, "datalink": DATALINK, "attitude": ATTITUDE, "position": POSITION,
    "guard": GUIDANCE, "fusion": FUSION,
}
"""The stage that a reject's source explains; ``mavlink`` may be any of the autopilot's."""

Verdict = str | None
"""What is wrong with a stage; None when nothing is."""


class HealthMonitor:
    """``event`` and ``output`` for all that passes; ``step`` once per guidance step."""

    def __init__(self, setup: Setup) -> None:
        links, guard = setup.config.links, setup.config.guidance.guard
        self._present = set(STAGES) - {INTEGRITY}
        if not links.camera:
            self._present -= {CAMERA, VISION}
        if not links.datalink:
            self._present.discard(DATALINK)
        self._picture_s = max(STALE_S, PICTURES / setup.camera.rate_hz)
        self._heartbeat_s = guard.heartbeat_lost_s
        self._estimate_s = setup.config.guidance.estimate_stale_s
        self._told: Health | None = None
        self._first_ns: int | None = None
        self._verdicts = {name: _Steady() for name in STAGES}
        self._takers: dict[type, Callable[[Any], None]] = {
            AutopilotStatus: self._status, GpsStatus: self._gps, TimeStep: self._time_step, Reject: self._reject,
            VisionOutput: self._vision, Integrity: self._integrity_told, RelativeState: self._state,
            AttitudeSetpoint: self._setpoint, VelocitySetpoint: self._setpoint, OffsetSetpoint: self._setpoint,
        }  # fmt: skip
        self._forget()

    def _forget(self) -> None:
        self._newest_ns: dict[str, int] = {}
        self._why: dict[str, tuple[int, str]] = {}
        self._integrity: Integrity | None = None
        self._has_fix: bool | None = None
        self._now_ns: int | None = None

    def event(self, event: Event) -> None:
        """Take note of what comes in. A Reject is told by ``output`` as well, and counts there."""
        if isinstance(event, CameraFrame | MarkerFrame):
            self._present |= {CAMERA, VISION}
        elif not isinstance(event, Reject):
            self._take(event)

    def output(self, output: Output) -> None:
        """Take note of what comes of it."""
        self._take(output)

    def _take(self, message: Event | Output) -> None:
        taker = self._takers.get(type(message))
        if taker is not None:
            taker(message)

    def _status(self, status: AutopilotStatus) -> None:
        self._newest_ns[AUTOPILOT] = status.t_ns

    def _gps(self, status: GpsStatus) -> None:
        self._has_fix = status.has_fix

    def _time_step(self, step: TimeStep) -> None:
        """Begin anew, as estimation does: what was stamped before says nothing of now."""
        if not step.continuous:
            self._forget()

    def _reject(self, reject: Reject) -> None:
        if reject.source == VISION:
            self._newest_ns[CAMERA] = reject.t_ns  # the picture was there; there was nothing to look with
        stages = (ATTITUDE, POSITION, AUTOPILOT) if reject.source == "mavlink" else (EXPLAINS.get(reject.source),)
        for stage in stages:
            if stage is not None:
                self._why[stage] = (self._now_ns or reject.t_ns, reject.reason)

    def _vision(self, seen: VisionOutput) -> None:
        self._newest_ns[CAMERA] = seen.t_ns
        if seen.pose is not None or (seen.labels >= 0).any():
            self._newest_ns[VISION] = seen.t_ns
        if seen.reject is not None:
            self._why[VISION] = (self._now_ns or seen.t_ns, seen.reject.reason)

    def _integrity_told(self, integrity: Integrity) -> None:
        self._present.add(INTEGRITY)
        self._integrity = integrity

    def _state(self, state: RelativeState) -> None:
        self._newest_ns[FUSION] = state.estimate_t_ns

    def _setpoint(self, setpoint: AttitudeSetpoint | VelocitySetpoint | OffsetSetpoint) -> None:
        self._newest_ns[GUIDANCE] = setpoint.t_ns

    def step(self, t_ns: int, phase: Phase, sources: Sources) -> Health | None:
        """Return the health of all stages when it has changed since it was last told, None when it has not."""
        self._now_ns = t_ns
        self._first_ns = t_ns if self._first_ns is None else self._first_ns
        if sources.tanker_ns is not None:
            self._present.add(DATALINK)
        used = USED[phase]
        stages = []
        for name in STAGES:
            steady = self._verdicts[name]
            wrong = steady.step(t_ns, self._wrong(name, t_ns, phase, sources), used=name in used)
            stages.append(StageHealth(name, name in self._present, name in used, wrong is None, wrong or ""))
        health = Health(t_ns, tuple(stages))
        if self._told is None and not health.well and abs(t_ns - self._first_ns) * NS < GRACE_S:
            return None
        if self._told is not None and self._told.stages == health.stages:
            return None
        self._told = health
        return health

    def _wrong(self, name: str, t_ns: int, phase: Phase, sources: Sources) -> Verdict:
        """Return what is wrong with a stage now, None when nothing is."""
        if name not in self._present:
            return "not there"
        if name == INTEGRITY:
            return failing(self._integrity, protects=False) or None
        newest = {DATALINK: sources.tanker_ns, ATTITUDE: sources.attitude_ns, POSITION: sources.position_ns}
        newest_ns = newest[name] if name in newest else self._newest_ns.get(name)
        limits = {CAMERA: self._picture_s, VISION: self._picture_s, AUTOPILOT: self._heartbeat_s,
                  FUSION: self._estimate_s, GUIDANCE: SETPOINT_S}
        limit_s = limits.get(name, STALE_S)
        if newest_ns is None:
            return self._explained(name, t_ns) or "nothing yet"
        if abs(t_ns - newest_ns) * NS > limit_s:
            return self._explained(name, t_ns) or f"nothing for {limit_s:.2g} s"
        if name == POSITION and self._has_fix is False and not self._sees(t_ns, phase):
            return "no GPS fix"
        return None

    def _sees(self, t_ns: int, phase: Phase) -> bool:
        """Tell whether vision carries the position: near the tanker a GPS without a fix is no loss then."""
        seen_ns = self._newest_ns.get(VISION)
        return VISION in USED[phase] and seen_ns is not None and abs(t_ns - seen_ns) * NS <= self._picture_s

    def _explained(self, name: str, t_ns: int) -> str:
        """Return the reason of the last reject about a stage, if it is recent."""
        why_ns, reason = self._why.get(name, (t_ns, ""))
        return reason if abs(t_ns - why_ns) * NS <= WHY_S else ""


class _Steady:
    """A verdict that changes only when the other one has lasted."""

    def __init__(self) -> None:
        self._wrong: Verdict = None
        self._used: bool | None = None
        self._lasting = Lasting()

    def step(self, t_ns: int, wrong: Verdict, *, used: bool) -> Verdict:
        """Take what is wrong now; return what is to be told.

        The first verdict of all counts at once: nothing has been well before. A stage that comes into use gets its
        chance: guidance has not sent anything yet when it begins.
        """
        if self._used is None:
            self._wrong = wrong
        elif used and not self._used:
            self._wrong = None
        self._used = used
        differs = (wrong is None) != (self._wrong is None)
        if self._lasting.lasts("differs", differs, t_ns, WELL_AFTER_S if wrong is None else ILL_AFTER_S):
            self._wrong = wrong
            self._lasting.forget()
        return self._wrong
