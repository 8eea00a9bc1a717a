"""Many flights with faults drawn at random: how each ends, and whether docking was ever allowed wrongly.

Rules
-----
* What a flight suffers follows from its seed: nothing (a tenth of them), or one cell of the fault matrix
  (``sim_bridge.faults``), in a phase and at an instant of it, for some seconds or to the end; half of the faults that
  have a size are of another size, a tenth to three times the usual: small ones are harder to see.
* Flights are a refuelling whose phases are made short (``fault_matrix.shortened``), so that integrity is asked: seen
  without a fault, let to dock before and in the approach. They begin near, by detections, half of them in moderate
  turbulence, and hold for 8 to 12 s; a retreat, too, costs time of ``WAY_S``.
* How a flight ended: ``held``; ``breakaway``; the phase that it was in when time was up; ``plant`` when it failed.
* Safety is ``scoring.Safety``'s: a collision, or outside the limits. "May dock" is judged by ``stanford``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.messages import NS, Phase
from sim_bridge.fault_cells import NEAR_M
from sim_bridge.fault_matrix import shortened
from sim_bridge.faults import KINDS, Fault
from sim_bridge.runs.flights import near
from sim_bridge.runs.many import Crashed, Job
from sim_bridge.runs.record import Record, record_flight
from sim_bridge.runs.stanford import Judged, judge

STREAM = 5
"""Keeps the draw apart from the flight's own chance, which has the same seed."""

HEALTHY = 0.1
TO_THE_END = 0.5
PHASES = {
    Phase.JOIN: 0.1, Phase.OBSERVATION: 0.05, Phase.PRE_CONTACT: 0.15, Phase.APPROACH: 0.25, Phase.CONTACT: 0.1,
    Phase.HOLD: 0.35,
}
AFTER_S = 6.0
LENGTH_S = (0.3, 6.0)
HOLD_S = (8.0, 12.0)
WAY_S = 32.0
"""From the start to the hold at the latest: 17 s when nothing goes wrong."""
OTHER_SIZE = 0.5
SIZES = (0.1, 3.0)
FIXED = ("slow", "boom")
"""Kinds whose size is no size of an error: a share."""

CELLS = tuple((target, kind) for target, kinds in KINDS.items() for kind in kinds)
NOTHING = "nothing"
SLACK_S = 0.1
"""A hold may lack this much at its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One flight: its cell of the matrix, its fault as the command line writes it, and what came of it.

    ``began``: the fault did (its phase was entered). ``reason`` of the first breakaway after it. ``delay_s`` from the
    fault to that breakaway.
    """

    label: str
    seed: int
    cell: str
    fault: str
    began: bool
    ended: str
    reason: str
    delay_s: float | None
    collision: bool
    outside_m: float
    judged: Judged


def draw(seed: int) -> Job:
    """Return the flight of a seed."""
    rng = np.random.default_rng([seed, STREAM])
    fault = None if rng.random() < HEALTHY else draw_fault(rng)
    name = "moderate" if rng.random() < 0.5 else "docking"
    hold_s = round(float(rng.uniform(*HOLD_S)), 1)
    scenario, setup = near(name, seed, hold_s, start_tanker_m=NEAR_M, timeout_s=hold_s + WAY_S)
    faults = () if fault is None else (fault,)
    label = f"{seed} {'light' if name == 'docking' else name} {NOTHING if fault is None else fault}"
    return Job(label, msgspec.structs.replace(scenario, faults=faults), shortened(setup))


def draw_fault(rng: np.random.Generator) -> Fault:
    """Return a cell of the matrix with its instant, length and size."""
    target, kind = CELLS[int(rng.integers(len(CELLS)))]
    phase = list(PHASES)[int(rng.choice(len(PHASES), p=list(PHASES.values())))]
    after_s = round(float(rng.uniform(0.0, AFTER_S)), 2)
    for_s = None if rng.random() < TO_THE_END else round(float(rng.uniform(*LENGTH_S)), 2)
    factor = float(np.exp(rng.uniform(*np.log(SIZES)))) if rng.random() < OTHER_SIZE else None
    usual = KINDS[target][kind]
    size = None if factor is None or usual == 0.0 or kind in FIXED else float(f"{usual * factor:.3g}")
    values = {"target": target, "kind": kind, "phase": phase, "after_s": after_s, "for_s": for_s, "size": size}
    return msgspec.convert(values, Fault)


def observe(job: Job) -> Outcome:
    """Fly, and judge."""
    return outcome(record_flight(job), job)


def outcome(record: Record, job: Job) -> Outcome:
    """Return what came of a flight."""
    faults, safety = job.scenario.faults, record.safety
    broke = [c for c in record.changes[1:] if c.new is Phase.BREAKAWAY]
    since = [c for c in broke if record.fault_s is None or c.t_ns * NS >= record.fault_s]
    return Outcome(
        record.label, record.seed, f"{faults[0].target}.{faults[0].kind}" if faults else NOTHING,
        str(faults[0]) if faults else NOTHING, record.fault_s is not None, ending(record, job.scenario.hold_s),
        (since or broke)[0].reason if broke else "", safety["breakaway_delay_s"], bool(safety["collision"]),
        float(safety["outside_limit_m"] or 0.0), judge(record, job.setup.tanker.window),
    )


def ending(record: Record, hold_s: float) -> str:
    """Return how a flight ended."""
    if record.failure is not None:
        return "plant"
    last = record.changes[-1]
    held_s = float(record.of("t_s")[-1]) - last.t_ns * NS
    return "held" if last.new is Phase.HOLD and held_s >= hold_s - SLACK_S else str(last.new)


ENDINGS = ("held", "breakaway", "standby")
COLUMNS = ("cell", "flights", *ENDINGS, "else", "collision", "outside limits, m at most",
           "breakaway after the fault, median, max, s", "false may dock: misleading, hazardous, outside")


def table(found: Sequence[Outcome | Crashed]) -> str:
    """Return a markdown table with a row for each cell, and what is to be looked into below it."""
    flown = [o for o in found if isinstance(o, Outcome)]
    cells = sorted({o.cell for o in flown}, key=lambda cell: (cell != NOTHING, cell))
    rows = [("| " + " | ".join(COLUMNS) + " |"), "|---" * len(COLUMNS) + "|"]
    rows += [row(cell, [o for o in flown if o.cell == cell]) for cell in cells]
    rows.append(row("**all**", flown))
    return "\n".join([*rows, "", *summary(found), *worth_a_look(found)])


def row(cell: str, outcomes: Sequence[Outcome]) -> str:
    """Return one row of the table."""
    ends = [sum(o.ended == end for o in outcomes) for end in ENDINGS]
    outside = [o.outside_m for o in outcomes if o.outside_m > 0.0]
    delays = [o.delay_s for o in outcomes if o.delay_s is not None]
    false = [sum(bool(counted(o)[k]) for o in outcomes) for k in range(3)]
    numbers = [len(outcomes), *ends, len(outcomes) - sum(ends), sum(o.collision for o in outcomes)]
    return "| " + " | ".join([
        cell, *map(str, numbers), f"{len(outside)}, {max(outside):.2f}" if outside else "0",
        f"{np.median(delays):.2f}, {max(delays):.2f}" if delays else "", ", ".join(map(str, false)),
    ]) + " |"


def counted(o: Outcome) -> tuple[int, int, int]:
    """Return how many instants of a flight were misleading, hazardous, and outside the limit window."""
    j = o.judged
    return int(j.misleading.sum()), int(j.hazardous.sum()), j.outside


def summary(found: Sequence[Outcome | Crashed]) -> list[str]:
    """Return the lines that count."""
    flown = [o for o in found if isinstance(o, Outcome)]
    instants, allowed = sum(o.judged.told for o in flown), sum(o.judged.allowed_count for o in flown)
    per_axis = [np.reshape([getattr(o.judged, name) for o in flown], (-1, 3)).sum(axis=0)
                for name in ("misleading", "hazardous")]
    false = sum(o.judged.false for o in flown)
    idle = sum(not o.began for o in flown if o.cell != NOTHING)
    return [
        f"{len(flown)} flights, {len(found) - len(flown)} crashed; {instants} instants judged, docking allowed in "
        f"{allowed}; false \"may dock\" in {false} flights "
        f"(instants x, y, z: misleading {list(map(int, per_axis[0]))}, hazardous {list(map(int, per_axis[1]))}; "
        f"outside the limit window {sum(o.judged.outside for o in flown)}).",
        f"Collisions {sum(o.collision for o in flown)}, outside the limits {sum(o.outside_m > 0 for o in flown)}, "
        f"plant failed {sum(o.ended == 'plant' for o in flown)}; {idle} faults never began, since their phase was not "
        "entered or left too early.",
    ]


def worth_a_look(found: Sequence[Outcome | Crashed]) -> list[str]:
    """Return a line for each flight that went wrong, named so that it can be flown again."""
    lines = [f"- {c.label}: crashed, {c.why}" for c in found if isinstance(c, Crashed)]
    for o in (o for o in found if isinstance(o, Outcome)):
        wrong = [text for bad, text in (
            (o.collision, "collision"), (o.outside_m > 0.0, f"outside limits by {o.outside_m:.2f} m"),
            (o.ended == "plant", "plant failed"),
            (o.judged.false, f"false may dock from {o.judged.first_s or 0.0:.2f} s on, {counted(o)} instants"),
            (o.cell == NOTHING and o.ended != "held", f"not held without a fault: {o.ended} {o.reason}"),
        ) if bad]
        if wrong:
            lines.append(f"- {o.label}: {'; '.join(wrong)}; ended {o.ended} {o.reason}".rstrip())
    return ["", *lines] if lines else []
