"""How good the fused relative position is in the hold, with GPS and without it from 30 m in, filter beside blend.

Rules
-----
* The error is that of BR, which guidance flies on, at every guidance step of the hold, in three dimensions. The
  relative position of the centres of mass stands beside it.
* GPS goes out, for both aircraft and to the end, when the camera is first truly within 30 m of the tanker's origin.
  A flight is flown with GPS first, and again without: up to that instant it is the same flight.
* Limits: 0.037 m in light turbulence, a tenth of the thesis' vision error of 0.376 m, and 0.08 m in moderate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.geometry import Mat, Vec
from companion.messages import NS, Phase
from sim_bridge.runs.flights import Method, Turbulence, far, fused_by, without_gps
from sim_bridge.runs.many import Crashed, Job, Tell, fly_many
from sim_bridge.runs.options import PROCESSES
from sim_bridge.runs.record import Record, record_flight
from sim_bridge.scoring import score

LIMITS_M: dict[Turbulence, float] = {"light": 0.037, "moderate": 0.08}
SCENARIOS: dict[Turbulence, str] = {"light": "docking", "moderate": "moderate"}
METHODS: tuple[Method, ...] = ("filter", "blend")
GPS_OFF_M = 30.0
PICTURES = (1, 2)
SEEDS = tuple(range(1, 11))


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table, with GPS and without."""

    turbulence: Turbulence
    method: Method
    seen: str
    seeds: tuple[int, ...]

    def jobs(self, **scenario_fields: float) -> list[Job]:
        """Return the flights with GPS."""
        made = []
        for seed in self.seeds:
            scenario, setup = far(SCENARIOS[self.turbulence], seed, vision_input=self.seen, **scenario_fields)
            label = f"{self.turbulence}, {self.method}, {self.seen}, {seed}"
            made.append(Job(label, scenario, fused_by(setup, self.method)))
        return made


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """One flight: sums of squares of the errors of BR and of the relative position, per axis, over the hold's steps."""

    label: str
    docked: bool
    steps: int
    br_squares_m2: Vec
    p_steps: int
    p_squares_m2: Vec
    near_s: float | None
    breakaway: str

    @property
    def rms_m(self) -> float:
        """Return the 3D RMS of BR's error, NaN without a hold."""
        return root(self.br_squares_m2.sum(), self.steps)


def observe(job: Job) -> Held:
    """Fly, and return what the table needs."""
    return held_of(record_flight(job), job)


def held_of(record: Record, job: Job) -> Held:
    """Return what the table needs of a record."""
    hold = record.during(Phase.HOLD) & np.isfinite(record.of("br_nees"))
    truth = (np.round(record.of("t_s") / NS).astype(np.int64), record.of("br_true_m"))
    found = score(truth, record.changes[1:], job.setup.tanker.window, job.scenario)
    fused = hold & np.isfinite(record.of("p_nees"))
    near = np.flatnonzero(record.of("range_true_m") < GPS_OFF_M)
    return Held(
        record.label, found["docked"] and record.failure is None, int(hold.sum()),
        squares(record.of("br_m")[hold] - record.of("br_true_m")[hold]),
        int(fused.sum()), squares(record.of("p_error_m")[fused]),
        float(record.of("t_s")[near[0]]) if len(near) else None, found["breakaway"] or "",
    )


def squares(errors: Mat) -> Vec:
    """Return the sums of squares (3,) of errors (n, 3)."""
    return np.einsum("ij,ij->j", errors, errors)


def root(total: float, steps: int) -> float:
    """Return the root of a mean, NaN of nothing."""
    return float(np.sqrt(total / steps)) if steps else float("nan")


def cases(quick: bool, first_seed: int = SEEDS[0]) -> list[Case]:
    """Return the rows; ``quick``: two seeds each and no pictures."""
    count = 2 if quick else len(SEEDS)
    seeds = tuple(range(first_seed, first_seed + count))
    made = [Case(t, m, "detections", seeds) for t in SCENARIOS for m in METHODS]
    pictures = tuple(range(first_seed, first_seed + len(PICTURES)))
    return made if quick else made + [Case(t, "filter", "pictures", pictures) for t in SCENARIOS]


def measure(
    rows: Sequence[Case], *, processes: int = PROCESSES, tell: Tell = lambda line: None, **scenario_fields: float
) -> str:
    """Fly everything twice and return a markdown table; ``scenario_fields`` change the flights."""
    with_gps = [case.jobs(**scenario_fields) for case in rows]
    flat = [job for jobs in with_gps for job in jobs]
    first = fly_many(flat, observe, processes=processes, tell=tell)
    again, at = [], []
    for k, (job, held) in enumerate(zip(flat, first, strict=True)):
        if isinstance(held, Held) and held.near_s is not None:
            again.append(without_gps(job, held.near_s))
            at.append(k)
    second: list[Held | Crashed | None] = [None] * len(flat)
    for k, found in zip(at, fly_many(again, observe, processes=processes, tell=tell), strict=True):
        second[k] = found
    lines = [HEAD, "|---" * HEAD.count(" |") + "|"]
    start = 0
    for case, jobs in zip(rows, with_gps, strict=True):
        part = slice(start, start + len(jobs))
        lines += [line(case, "on", first[part]), line(case, "off from 30 m in", second[part])]
        start += len(jobs)
    return "\n".join(lines)


HEAD = ("| turbulence | fusion | sees by | GPS | held | 3D RMS of BR, all flights | worst flight | limit "
        "| RMS of BR x, y, z | 3D RMS of relative position |")


def line(case: Case, gps: str, flown: Sequence[Held | Crashed | None]) -> str:
    """Return a row of the table; metres."""
    held = [h for h in flown if isinstance(h, Held)]
    steps = sum(h.steps for h in held)
    limit = LIMITS_M[case.turbulence]
    docked = f"{sum(h.docked for h in held)} of {len(flown)}"
    start = f"| {case.turbulence} | `{case.method}` | {case.seen} | {gps} | {docked} "
    if not steps:
        return start + f"| no hold | | {limit} | | |"
    br, p = (np.sum([getattr(h, name) for h in held], axis=0) for name in ("br_squares_m2", "p_squares_m2"))
    p_rms = root(p.sum(), sum(h.p_steps for h in held))
    worst = max(h.rms_m for h in held if h.steps)
    mark = "" if worst <= limit else " **over**"
    axes = ", ".join(f"{root(v, steps):.4f}" for v in br)
    return start + (
        f"| {root(br.sum(), steps):.4f} | {worst:.4f}{mark} | {limit} | {axes} | {p_rms:.4f} |"
    )
