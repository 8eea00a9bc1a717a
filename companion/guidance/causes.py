"""When to break away, and why: everything that the guard watches, in one order of precedence.

Rules
-----
* Nothing is latched here: ``Watch.cause`` says whether there is a cause now. The phase latches.
* Where noise alone could make a cause, it has to last; every limit leaves the breakaway within 0.5 s of what made it
  (``GuardConfig``), but for the autopilot's heartbeat, whose limit is the cause.
* Which cause is looked for in which phase: ``WATCHED``; within ``closure_range_m`` of the box every flying phase
  watches what those near it do (``NEAR``): who begins there, after a clear or a restart, is as near as who came there.
* An estimate that is not finite is none. A stamp from the future is as bad as one from the past.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.config import GuardConfig, WindowConfig
from companion.guidance.lasting import Lasting
from companion.messages import NS, Integrity, Phase, RelativeState, Sources

OPERATOR = "operator's command"
AUTOPILOT_LOST = "autopilot lost"
LEFT_WINDOW = "outside the limit window"
AHEAD = "ahead of or above the limit window"
CLOSURE = "closing too fast"
SIGHT_LOST = "sight lost"
DATALINK_STALE = "datalink stale"
ATTITUDE_STALE = "attitude stale"
POSITION_STALE = "position stale"
INTEGRITY_FAILED = "integrity failed"
ESTIMATE_LOST = "estimate lost"
OFF_PATH = "far off the path"
UPSET = "banked or pitched too far"

CAUSES = (
    OPERATOR, AUTOPILOT_LOST, LEFT_WINDOW, AHEAD, CLOSURE, SIGHT_LOST, DATALINK_STALE, ATTITUDE_STALE,
    POSITION_STALE, INTEGRITY_FAILED, ESTIMATE_LOST, OFF_PATH, UPSET,
)
"""Why to break away, in the order of precedence. Behind ``INTEGRITY_FAILED`` stands what fails, after a colon."""

_FAR = frozenset({OPERATOR, CLOSURE, ESTIMATE_LOST, OFF_PATH, UPSET})
NEAR = frozenset(CAUSES) - {LEFT_WINDOW}
"""What is watched under the tanker; the window itself only when it has been reached."""

WATCHED: dict[Phase, frozenset[str]] = {
    Phase.STANDBY: frozenset(),
    Phase.SELF_TEST: frozenset({OPERATOR}),
    Phase.JOIN: _FAR,
    Phase.OBSERVATION: _FAR,
    Phase.PRE_CONTACT: NEAR,
    Phase.APPROACH: NEAR,
    Phase.CONTACT: frozenset(CAUSES),
    Phase.HOLD: frozenset(CAUSES),
    Phase.DISCONNECT: NEAR,
    Phase.BREAKAWAY: frozenset(),
}
"""Causes by phase. Before pre-contact, and far from the box, a lost source or a silent autopilot is no reason to dive
away: the phases wait for it or let go."""

FAR_PHASES = frozenset({Phase.SELF_TEST, Phase.JOIN, Phase.OBSERVATION})
"""Phases that watch more within ``closure_range_m`` of the box."""

BACKS_OFF = FAR_PHASES | {Phase.PRE_CONTACT, Phase.DISCONNECT}
"""Phases that do not close in: there a protection level that is too large is what they wait for, and no cause."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What the guard looks at in one guidance step.

    ``heartbeat_ns``: the autopilot's last HEARTBEAT; ``asked``: an operator asks for a breakaway; ``error_m``: how far
    the receptacle is from where the path has it now, None without a path.
    """

    t_ns: int
    phase: Phase
    state: RelativeState | None
    sources: Sources
    heartbeat_ns: int | None = None
    integrity: Integrity | None = None
    asked: bool = False
    error_m: float | None = None


@dataclass(frozen=True, slots=True)
class Near:
    """BR in ``mrf`` as plain numbers: place (3,), range, ``way`` the unit vector to close in by, and the rates.

    The way leads to the box, but never backwards: who is ahead of the box closes in on the tanker by going forward.
    ``closing_m_s`` along the way, ``forward_m_s`` along x.
    """

    p_m: tuple[float, float, float]
    way: tuple[float, float, float]
    range_m: float
    closing_m_s: float
    forward_m_s: float


def near_of(state: RelativeState) -> Near | None:
    """Return range and closure of a state; None when it is not finite."""
    x, y, z = state.p_mrf_br_m.tolist()
    vx, vy, vz = state.v_mrf_br_m_s.tolist()
    range_m = math.hypot(x, y, z)
    if not (math.isfinite(range_m) and math.isfinite(math.hypot(vx, vy, vz))):
        return None
    behind = min(x, 0.0)
    length = math.hypot(behind, y, z)
    way = (-behind / length, -y / length, -z / length) if length > 0.0 else (1.0, 0.0, 0.0)
    return Near((x, y, z), way, range_m, vx * way[0] + vy * way[1] + vz * way[2], vx)


def allowed_closure_m_s(config: GuardConfig, range_m: float) -> float:
    """Return how fast the receptacle may close in at a range from the box.

    ``closure_m_s`` within ``closure_range_m``; beyond, what ``braking_m_s2`` takes away until there.
    """
    beyond_m = max(0.0, range_m - config.closure_range_m)
    return math.sqrt(config.closure_m_s**2 + 2.0 * config.braking_m_s2 * beyond_m)


class Watch:
    """``cause`` once per guidance step, in every phase; ``near`` is what ``near_of`` says of the view's state."""

    def __init__(self, config: GuardConfig, window: WindowConfig, pitch_trim_rad: float) -> None:
        self._config, self._limit_m, self._pitch_trim_rad = config, window.limit_m, pitch_trim_rad
        self.reset()

    def reset(self) -> None:
        """Forget since when anything has been wrong, and the last estimate."""
        self._lasting = Lasting()
        self._estimate_ns: int | None = None
        self._is_near = False  # by the last estimate that there was

    def cause(self, view: View, near: Near | None) -> str | None:
        """Return why to break away now, None when there is no reason to."""
        if near is not None and view.state is not None:
            self._estimate_ns = view.state.estimate_t_ns
            self._is_near = near.range_m <= self._config.closure_range_m
        watched = WATCHED[view.phase]
        if not watched:
            self._lasting.forget()
            return None
        if self._is_near:
            watched = watched | NEAR
        found = self._of_sources(view, near) + self._of_flight(view, near)  # all: what lasts has to be kept up
        found = [cause for cause in found if cause in watched]
        if not found:
            return None
        cause = min(found, key=CAUSES.index)
        return cause if cause != INTEGRITY_FAILED else f"{cause}: {failing(view.integrity)}"

    def _of_sources(self, view: View, near: Near | None) -> list[str]:
        """Return what is missing or not to be trusted."""
        c, s, t_ns = self._config, view.sources, view.t_ns
        far = view.phase in FAR_PHASES and not self._is_near
        found = []
        for cause, newest_ns, limit_s in (
            (AUTOPILOT_LOST, view.heartbeat_ns, c.heartbeat_lost_s),
            (SIGHT_LOST, s.sight_ns, c.sight_lost_s),
            (DATALINK_STALE, s.tanker_ns, c.datalink_stale_s),
            (ATTITUDE_STALE, s.attitude_ns, c.attitude_stale_s),
            (POSITION_STALE, s.position_ns, c.position_stale_s),
            (ESTIMATE_LOST, self._estimate_ns, c.estimate_lost_far_s if far else c.estimate_lost_s),
        ):
            # What is not there is as old as that lasts.
            absent = self._lasting.lasts(cause, newest_ns is None, t_ns, limit_s)
            if absent or (newest_ns is not None and abs(t_ns - newest_ns) * NS > limit_s):
                found.append(cause)
        distrusted = failing(view.integrity, self._in_close(view, near)) != ""
        if self._lasting.lasts(INTEGRITY_FAILED, distrusted, t_ns, c.integrity_failed_s):
            found.append(INTEGRITY_FAILED)
        if view.asked:
            found.append(OPERATOR)
        return found

    def _of_flight(self, view: View, near: Near | None) -> list[str]:
        """Return what the receiver does that it must not do."""
        c = self._config
        outside = ahead = fast = lost = upset = False
        if near is not None and view.state is not None:
            (x, y, z), (limit_x, limit_y, limit_z) = near.p_m, self._limit_m
            outside = abs(x) > limit_x or abs(y) > limit_y or abs(z) > limit_z
            ahead = x > limit_x or z < -limit_z
            allowed_m_s = allowed_closure_m_s(c, near.range_m)
            fast = near.forward_m_s > allowed_m_s or near.closing_m_s > allowed_m_s + c.closure_gust_m_s
            upset = self._is_upset(view.state)
            limit_m = c.off_path_near_m if near.range_m <= c.closure_range_m else c.off_path_m
            lost = view.error_m is not None and not view.error_m <= limit_m  # also true for NaN
        flight = ((LEFT_WINDOW, outside), (AHEAD, ahead), (CLOSURE, fast), (OFF_PATH, lost), (UPSET, upset))
        return [cause for cause, holds in flight if self._lasting.lasts(cause, holds, view.t_ns, c.lasting_s)]

    def _in_close(self, view: View, near: Near | None) -> bool:
        return view.phase not in BACKS_OFF and near is not None and near.range_m <= self._config.protection_range_m

    def _is_upset(self, state: RelativeState) -> bool:
        R = state.R_ned_frd
        bank_rad = math.atan2(R[2, 1], R[2, 2])
        pitch_rad = math.asin(max(-1.0, min(1.0, -float(R[2, 0]))))
        c = self._config
        inside = abs(bank_rad) <= c.max_bank_rad and abs(pitch_rad - self._pitch_trim_rad) <= c.max_pitch_off_trim_rad
        return not inside  # also true for NaN


def failing(integrity: Integrity | None, protects: bool = True) -> str:
    """Return what is wrong with the estimate: the faults, or the axes whose protection level is beyond its alert.

    Empty when nothing is. ``protects`` False: protection levels do not count, because the box is still far.
    """
    if integrity is None:
        return ""
    if integrity.faults or not protects:
        return ", ".join(integrity.faults)
    levels = zip("xyz", integrity.protection_mrf_m.tolist(), integrity.alert_mrf_m.tolist(), strict=True)
    beyond = [axis for axis, level_m, alert_m in levels if not level_m <= alert_m]  # also for NaN
    return "protection " + " ".join(beyond) if beyond else ""
