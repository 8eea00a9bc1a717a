"""Phases of the approach: one table, one step.

Rules
-----
* ``TABLE`` is all there is: from a phase, the first row whose condition holds moves the machine. A phase that has no
  row for what happened stays where it is.
* Breakaway is latched: only an operator leaves it, by CLEAR or by taking the autopilot out of guided, to standby.
* After a breakaway, or when a pilot took over, an operator has to engage again; after a silent link it goes on.
* ``README`` draws its diagram from this table (``diagram``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from companion.messages import Command, Phase, PhaseChange


@dataclass(frozen=True, slots=True)
class Situation:
    """What the table's conditions look at, at one guidance step.

    ``guided``: armed, and following our setpoints, by a recent heartbeat; ``taken_over``: a recent heartbeat that says
    it does not, which a silent link never says.
    """

    estimate_age_s: float | None
    guided: bool
    engaged: bool
    command: Command | None = None
    settled_s: float = 0.0
    path_done: bool = False
    captured_s: float = 0.0
    inside_limit: bool = True
    tracking_ok: bool = True
    in_corridor: bool = True
    taken_over: bool = False


@dataclass(frozen=True, slots=True)
class Limits:
    """Times of the table, in seconds (``GuidanceConfig``)."""

    estimate_stale_s: float
    breakaway_stale_s: float
    join_settle_s: float
    capture_s: float


Condition = Callable[[Situation, Limits], bool]


@dataclass(frozen=True, slots=True)
class Row:
    """From ``old`` to ``new`` when ``condition`` holds; ``reason`` is what people read."""

    old: Phase
    new: Phase
    reason: str
    condition: Condition


def _fresh(s: Situation, m: Limits) -> bool:
    return s.estimate_age_s is not None and s.estimate_age_s <= m.estimate_stale_s


def _lost(s: Situation, m: Limits) -> bool:
    return s.estimate_age_s is None or s.estimate_age_s > m.breakaway_stale_s


def _asked(s: Situation, m: Limits) -> bool:
    return s.command is Command.BREAKAWAY


def _left_limit(s: Situation, m: Limits) -> bool:
    return not s.inside_limit


def _off_path(s: Situation, m: Limits) -> bool:
    return not s.tracking_ok


def _not_guided(s: Situation, m: Limits) -> bool:
    return not s.guided


_ANY_BREAKAWAY: tuple[tuple[str, Condition], ...] = (
    ("operator's command", _asked),
    ("estimate lost", _lost),
)


def _breakaway_rows(old: Phase, *more: tuple[str, Condition]) -> tuple[Row, ...]:
    return tuple(Row(old, Phase.BREAKAWAY, reason, c) for reason, c in (*_ANY_BREAKAWAY, *more))


TABLE: tuple[Row, ...] = (
    Row(Phase.STANDBY, Phase.JOIN, "engaged behind and below, estimate fresh, autopilot armed and guided",
        lambda s, m: s.engaged and s.guided and s.in_corridor and _fresh(s, m)),
    *_breakaway_rows(Phase.JOIN, ("far off the station", _off_path)),
    Row(Phase.JOIN, Phase.STANDBY, "autopilot left guided", _not_guided),
    Row(Phase.JOIN, Phase.APPROACH, "station held", lambda s, m: _fresh(s, m) and s.settled_s >= m.join_settle_s),
    *_breakaway_rows(Phase.APPROACH, ("far off the path", _off_path)),
    Row(Phase.APPROACH, Phase.STANDBY, "autopilot left guided", _not_guided),
    Row(Phase.APPROACH, Phase.HOLD, "inside the desired window",
        lambda s, m: _fresh(s, m) and s.path_done and s.captured_s >= m.capture_s),
    *_breakaway_rows(Phase.HOLD, ("outside the limit window", _left_limit)),
    Row(Phase.HOLD, Phase.STANDBY, "autopilot left guided", _not_guided),
    Row(Phase.BREAKAWAY, Phase.STANDBY, "operator's clear", lambda s, m: s.command is Command.CLEAR),
    Row(Phase.BREAKAWAY, Phase.STANDBY, "pilot took over", lambda s, m: s.taken_over),
)


class PhaseMachine:
    """Holds the phase; ``step`` moves it by at most one row."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.phase = Phase.STANDBY

    def step(self, t_ns: int, situation: Situation) -> PhaseChange | None:
        """Apply the first row of the table that holds; None when the phase stays."""
        for row in TABLE:
            if row.old is self.phase and row.condition(situation, self._limits):
                self.phase = row.new
                return PhaseChange(t_ns, row.old, row.new, row.reason)
        return None


def diagram() -> str:
    """Return the table as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", "    [*] --> standby"]
    lines += [f"    {row.old} --> {row.new}: {row.reason}" for row in TABLE]
    return "\n".join(lines)
