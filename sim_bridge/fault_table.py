"""What came of the fault matrix, as text: the matrix itself in brief, the other cells, and a row for each flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from companion.messages import NS
from sim_bridge.fault_cells import BREAKAWAY, MATRIX, MORE, REACTION_S, Cell, Since
from sim_bridge.fault_matrix import LEVEL_S, CellFlight, fly_cell
from sim_bridge.faults import COMMON

TARGETS = ("camera", "datalink", "gps", "attitude", "heartbeat")

COLUMNS = ("fault", "has to end", "ended", "because of", "breakaway from the fault", "from its cause",
           "BR told wrong, m (share of the alert limit)", "")
WRONG = "**wrong**"

SINCE = {Since.FAULT: "", Since.HEARTBEAT: " (a)", Since.REASON: " (b)"}
STAMPS = " (c)"
NOTES = (
    "- (a) Counted from 3 s after the last heartbeat: an autopilot is lost after so long.",
    "- (b) The estimate bears the fault for a while. Counted from the last sample or estimate that was taken, or the "
    "last at which integrity had nothing against it, whichever the reason names; or from an error of BR beyond its "
    "alert limit, if that is earlier.",
    "- (c) Counted from when the first false stamp can come, as long after the fault as it holds up samples.",
)


def delays_s(flight: CellFlight) -> tuple[float, float] | None:
    """Return how long after its fault and after its cause a breakaway began; None without one, or without a fault."""
    if flight.broke_ns is None or flight.fault_ns is None or flight.cause_ns is None:
        return None
    return (flight.broke_ns - flight.fault_ns) * NS, (flight.broke_ns - flight.cause_ns) * NS


def row(flight: CellFlight) -> str:
    """Return a flight as a row of the table."""
    cell, delays = flight.cell, delays_s(flight)
    after = cause = ""
    if delays is not None:
        late = f" (over {REACTION_S:g} s)" if delays[0] > REACTION_S else ""
        after, cause = f"{delays[0]:.2f} s{late}", f"{delays[1]:.2f} s{SINCE[cell.since]}"
        cause += STAMPS if cell.at_s else ""
    error_m, share = flight.off()
    off = "" if math.isnan(error_m) else f"{error_m:.2f} ({100.0 * share:.0f} %)"
    because = cell.why if flight.ended == "held" else flight.reason
    fields = (f"`{cell.faults[0]}`", " or ".join(cell.ends), flight.ended, because, after, cause, off,
              "" if flight.right else WRONG)
    return "| " + " | ".join(fields) + " |"


def brief(flight: CellFlight) -> str:
    """Return how a flight ended in a word or two: held, standby, breakaway 0.38 s; a late one with its cause."""
    delays, text = delays_s(flight), flight.ended
    if flight.ended == BREAKAWAY[0] and delays is not None:
        text += f" {delays[0]:.2f} s" + (f" ({delays[1]:.2f} s after its cause)" if delays[0] > REACTION_S else "")
    return text if flight.right else f"{text} {WRONG}"


def condensed(flights: Sequence[CellFlight]) -> str:
    """Return the matrix, sources by kinds, and the other cells in a list below it; empty where none was flown."""
    told = {flight.cell.name: brief(flight) for flight in flights}
    rows = [[told.get(f"{target}-{kind}", "") for kind in COMMON] for target in TARGETS]
    lines = ["| | " + " | ".join(COMMON) + " |", "|---" * (len(COMMON) + 1) + "|"]
    lines += [f"| **{target}** | " + " | ".join(entries) + " |"
              for target, entries in zip(TARGETS, rows, strict=True) if any(entries)]
    inside = {f"{target}-{kind}" for target in TARGETS for kind in COMMON}
    others = [f"- `{f.cell.faults[0]}`: {told[f.cell.name]}; {f.cell.why}"
              for f in flights if f.cell.name not in inside]
    parts = [lines] if len(lines) > 2 else []
    parts += [others] if others else []
    return "\n\n".join("\n".join(part) for part in parts)


def table(flights: Sequence[CellFlight]) -> str:
    """Return a row for each flight, and below them what is counted from what."""
    rows = ["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|", *map(row, flights)]
    return "\n".join([*rows, "", *NOTES])


def summary(flights: Sequence[CellFlight]) -> str:
    """Return the line that counts."""
    delays = [d for flight in flights if (d := delays_s(flight)) is not None]
    wrong = [flight.cell.name for flight in flights if not flight.right]
    text = f"{len(flights)} flights, {len(delays)} breakaways"
    if delays:
        over = sum(after_s > REACTION_S for after_s, _ in delays)
        text += (f", at most {max(d[1] for d in delays):.2f} s after their cause; {over} of them more than "
                 f"{REACTION_S:g} s after the fault itself")
    return f"{text}; wrong: {', '.join(wrong) or 'none'}."


def report(
    seed: int, tell: Callable[[str], None], cells: Sequence[Cell] = (*MATRIX, *MORE), away_s: float = LEVEL_S
) -> tuple[str, bool]:
    """Fly cells with one seed, telling each row as it comes; return the text, and whether all went right."""
    flights = []
    for cell in cells:
        flights.append(fly_cell(cell, seed, away_s=away_s))
        tell(row(flights[-1]))
    parts = (f"Seed {seed}. {summary(flights)}", condensed(flights), table(flights))
    return "\n\n".join(parts), all(flight.right for flight in flights)
