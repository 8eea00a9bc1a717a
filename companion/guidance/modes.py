"""Phases of a refuelling: one table, one step.

Rules
-----
* ``TABLE`` is all there is: from a phase, the first row whose condition holds moves the machine. A phase that has no
  row for what happened stays where it is.
* From every flying phase: the guard's cause leads to breakaway, and a pilot who takes over to standby. An autopilot
  that has fallen silent leads to standby from the phases far from the tanker, and is a cause of the guard near it.
* Breakaway is latched: only an operator leaves it, by CLEAR or by taking the autopilot out of guided, to standby.
* After a breakaway, a failed self-test (with ``auto_engage`` the third in a row), or when a pilot took over, in standby
  too, an operator has to engage again; that takes an autopilot that is armed and guided.
* Who begins near the box, after a clear or a restart, has to see the tanker without a fault, and in its join backs off
  to the pre-contact point; the guard watches there all that it watches in the phases near the tanker.
* Gates: an operator clears the receiver to pre-contact and to contact, in the phase before (``OBEYED``); the clearance
  lasts as long as that phase. ``auto_gates`` pass by themselves, but not after a disconnect.
* No integrity monitor means that integrity is not asked. The direct procedure never asks.
* ``README`` draws its diagram from this table (``diagram``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from companion.messages import Command, Phase, PhaseChange

FLYING = (
    Phase.SELF_TEST, Phase.JOIN, Phase.OBSERVATION, Phase.PRE_CONTACT, Phase.APPROACH, Phase.CONTACT, Phase.HOLD,
    Phase.DISCONNECT,
)
"""Phases in which setpoints of a law are sent; in a breakaway they are the guard's."""

FAR = (Phase.SELF_TEST, Phase.JOIN, Phase.OBSERVATION)

OBEYED: dict[Command, frozenset[Phase]] = {
    Command.ENGAGE: frozenset({Phase.STANDBY}),
    Command.PRE_CONTACT: frozenset({Phase.OBSERVATION, Phase.APPROACH, Phase.CONTACT}),
    Command.CONTACT: frozenset({Phase.PRE_CONTACT}),
    Command.DISCONNECT: frozenset({Phase.CONTACT, Phase.HOLD}),
    Command.BREAKAWAY: frozenset({Phase.STANDBY, Phase.BREAKAWAY, *FLYING}),
    Command.CLEAR: frozenset({Phase.STANDBY, Phase.BREAKAWAY}),
}
"""In which phases a command means something; in standby, BREAKAWAY and CLEAR take an engagement back."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What the table's conditions look at, at one guidance step; ``*_s``: for how long something has been so.

    ``cause``: why the guard wants a breakaway. ``guided``: armed, and following our setpoints, by a recent heartbeat;
    ``taken_over``: a recent heartbeat that says it does not, which a silent link never says. ``cleared``: the gate out
    of this phase is open. ``tested``: None while the self-test goes on. ``observed_s``: seen by vision, no fault.
    ``may_dock_s``, ``may_not_dock_s``: what integrity says, no fault seen.
    """

    estimate_age_s: float | None
    guided: bool
    engaged: bool
    command: Command | None = None
    cause: str | None = None
    taken_over: bool = False
    in_corridor: bool = True
    cleared: bool = False
    tested: bool | None = None
    settled_s: float = 0.0
    observed_s: float = 0.0
    may_dock_s: float = 0.0
    may_not_dock_s: float = 0.0
    path_done: bool = False
    captured_s: float = 0.0
    phase_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Times of the table, in seconds, and its switches (``GuidanceConfig``)."""

    estimate_stale_s: float
    join_settle_s: float
    observation_s: float
    stabilise_s: float
    may_dock_s: float
    retreat_s: float
    capture_s: float
    contact_timeout_s: float
    self_test: bool
    direct: bool


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


def _ready(s: Situation, m: Limits) -> bool:
    return s.engaged and s.guided and s.in_corridor and _fresh(s, m)


def _settled(s: Situation, m: Limits) -> bool:
    return _fresh(s, m) and s.settled_s >= m.join_settle_s


def _stable(s: Situation, m: Limits) -> bool:
    return _fresh(s, m) and s.path_done and s.settled_s >= m.stabilise_s and s.may_dock_s >= m.may_dock_s


def _not_trusted(s: Situation, m: Limits) -> bool:
    return not m.direct and s.may_not_dock_s > m.retreat_s


GUARDS_CAUSE, TAKEN_OVER, NOT_GUIDED = "the guard's cause", "pilot took over", "autopilot left guided"
_ENGAGED = "engaged behind and below, estimate fresh, autopilot armed and guided"

_ALWAYS: tuple[Row, ...] = tuple(
    row
    for phase in FLYING
    for row in (
        Row(phase, Phase.STANDBY, TAKEN_OVER, lambda s, m: s.taken_over),
        Row(phase, Phase.BREAKAWAY, GUARDS_CAUSE, lambda s, m: s.cause is not None),
    )
)
"""Rows of every flying phase, before all others. A pilot goes first: nothing is sent against him."""

_SILENT: tuple[Row, ...] = tuple(Row(phase, Phase.STANDBY, NOT_GUIDED, lambda s, m: not s.guided) for phase in FAR)
"""Far from the tanker a silent link is no reason to dive away; near it, it is the guard's cause."""

TABLE: tuple[Row, ...] = (
    *_ALWAYS,
    *_SILENT,
    Row(Phase.STANDBY, Phase.SELF_TEST, _ENGAGED, lambda s, m: m.self_test and _ready(s, m)),
    Row(Phase.STANDBY, Phase.JOIN, f"{_ENGAGED}, no self-test", lambda s, m: not m.self_test and _ready(s, m)),
    Row(Phase.SELF_TEST, Phase.JOIN, "self-test passed", lambda s, m: s.tested is True and _fresh(s, m)),
    Row(Phase.SELF_TEST, Phase.STANDBY, "self-test failed", lambda s, m: s.tested is not None),
    Row(Phase.JOIN, Phase.OBSERVATION, "station held", lambda s, m: not m.direct and _settled(s, m)),
    Row(Phase.JOIN, Phase.APPROACH, "station held, direct procedure", lambda s, m: m.direct and _settled(s, m)),
    Row(Phase.OBSERVATION, Phase.PRE_CONTACT, "seen without fault, cleared to pre-contact",
        lambda s, m: _fresh(s, m) and s.observed_s >= m.observation_s and s.cleared),
    Row(Phase.PRE_CONTACT, Phase.APPROACH, "stable, may dock, cleared to contact",
        lambda s, m: _stable(s, m) and s.cleared),
    Row(Phase.APPROACH, Phase.PRE_CONTACT, "called back", lambda s, m: s.command is Command.PRE_CONTACT),
    Row(Phase.APPROACH, Phase.PRE_CONTACT, "may not dock", _not_trusted),
    Row(Phase.APPROACH, Phase.CONTACT, "at the box", lambda s, m: _fresh(s, m) and s.path_done),
    Row(Phase.CONTACT, Phase.PRE_CONTACT, "called back", lambda s, m: s.command is Command.PRE_CONTACT),
    Row(Phase.CONTACT, Phase.PRE_CONTACT, "may not dock", _not_trusted),
    Row(Phase.CONTACT, Phase.DISCONNECT, "operator's disconnect", lambda s, m: s.command is Command.DISCONNECT),
    Row(Phase.CONTACT, Phase.HOLD, "inside the desired window",
        lambda s, m: _fresh(s, m) and s.captured_s >= m.capture_s),
    Row(Phase.CONTACT, Phase.PRE_CONTACT, "not captured in time",
        lambda s, m: not m.direct and s.phase_s >= m.contact_timeout_s),
    Row(Phase.HOLD, Phase.DISCONNECT, "operator's disconnect", lambda s, m: s.command is Command.DISCONNECT),
    Row(Phase.DISCONNECT, Phase.PRE_CONTACT, "backed off", lambda s, m: s.path_done),
    Row(Phase.BREAKAWAY, Phase.STANDBY, "operator's clear", lambda s, m: s.command is Command.CLEAR),
    Row(Phase.BREAKAWAY, Phase.STANDBY, TAKEN_OVER, lambda s, m: s.taken_over),
)


class PhaseMachine:
    """Holds the phase; ``step`` moves it by at most one row."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.phase = Phase.STANDBY

    def step(self, t_ns: int, situation: Situation) -> PhaseChange | None:
        """Apply the first row of the table that holds; None when the phase stays. A breakaway's reason is its cause."""
        for row in TABLE:
            if row.old is self.phase and row.condition(situation, self._limits):
                self.phase = row.new
                broke = situation.cause is not None and row.new is Phase.BREAKAWAY
                return PhaseChange(t_ns, row.old, row.new, str(situation.cause) if broke else row.reason)
        return None


def diagram() -> str:
    """Return the table as a Mermaid state diagram; the rows that every flying phase has are drawn once."""
    lines = ["stateDiagram-v2", "    [*] --> standby", "    state flying {"]
    rows = [row for row in TABLE if row not in _ALWAYS]
    inner = [row for row in rows if row.old in FLYING and row.new in FLYING]
    lines += [f"        {row.old} --> {row.new}: {row.reason}" for row in inner]
    lines += ["    }", f"    flying --> breakaway: {GUARDS_CAUSE}", f"    flying --> standby: {TAKEN_OVER}"]
    lines += [f"    {row.old} --> {row.new}: {row.reason}" for row in rows if row not in inner]
    return "\n".join(lines)
