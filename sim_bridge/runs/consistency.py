"""Whether the covariance that the estimate tells is what its error is, over many flights.

Rules
-----
* NEES, e^T P^-1 e, of what a consistent estimate says of three numbers follows chi squared of 3; the sum over N flights
  at one instant that of 3 N, whatever the time between instants does (Bar-Shalom, Li and Kirubarajan, Estimation with
  Applications to Tracking and Navigation, 2001, 5.4.2). Its mean over the flights is put beside the 95 % band.
* What the filter estimates beside position and velocity, the camera's mount and the bias of GPS, is drawn for each
  flight from what its configuration expects (``flights.with_drawn_errors``).
* NIS likewise, by source, over what was taken; all samples within a second make one point.
* Above the band the estimate is too sure of itself, which is unsafe; below it, it claims less than it knows.
* Flights count while they last, instants while at least half of the flights do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from companion.geometry import Vec
from companion.messages import Phase
from sim_bridge.runs.flights import Method, Turbulence, far, fused_by, near, with_drawn_errors
from sim_bridge.runs.many import Job
from sim_bridge.runs.options import FIRST_SEED
from sim_bridge.runs.record import FUSED_EVERY, Record, record_flight

NEAR_S, FAR_S = 60.0, 130.0
FAR_SHARE = 0.1
BAND = 0.95
AXES = 3

QUANTITIES = {
    "p": ("relative position", "p_error_m", "p_sigma_m", "m"),
    "v": ("relative velocity", "v_error_m_s", "v_sigma_m_s", "m/s"),
    "turn": ("relative attitude", "turn_error_rad", "turn_sigma_rad", "rad"),
    "br": ("BR, box to receptacle", "", "br_sigma_m", "m"),
}
"""What is looked at: its name, columns of error and sigma, and unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A mean over the flights: instants (n,), values (n,) and the 95 % band (n,) about them."""

    t_s: Vec
    mean: Vec
    low: Vec
    high: Vec

    def share_inside(self) -> float:
        """Return the share of the instants inside the band."""
        return float(np.mean((self.mean >= self.low) & (self.mean <= self.high))) if len(self.t_s) else float("nan")


def jobs(flights: int, turbulence: Turbulence, method: Method | None, first_seed: int = FIRST_SEED) -> list[Job]:
    """Return the flights from near, 60 s each, a tenth of them from where the thesis begins."""
    name = "docking" if turbulence == "light" else turbulence
    many_far = round(FAR_SHARE * flights)
    made = []
    for k in range(flights):
        seed = first_seed + k
        if k < flights - many_far:
            where, (scenario, setup) = "near", near(name, seed, NEAR_S, timeout_s=NEAR_S)
        else:
            where, (scenario, setup) = "far", far(name, seed, hold_s=FAR_S, timeout_s=FAR_S)
        job = Job(f"{where} {seed}", scenario, setup if method is None else fused_by(setup, method))
        made.append(with_drawn_errors(job))
    return made


def observe(job: Job) -> Record:
    """Fly, and return the record with every fifth row."""
    record = record_flight(job)
    return replace(record, rows=record.rows[::FUSED_EVERY])


def errors(record: Record, quantity: str) -> tuple[Vec, Vec]:
    """Return errors and sigmas (n, 3) of a quantity."""
    _, error, sigma, _ = QUANTITIES[quantity]
    return record.of(error) if error else record.of("br_m") - record.of("br_true_m"), record.of(sigma)


def nees_curve(records: Sequence[Record], quantity: str) -> Curve:
    """Return the mean NEES of a quantity over the flights, instant by instant."""
    rows = max(len(r.rows) for r in records)
    values = np.full((len(records), rows), np.nan)
    t_s = np.zeros(rows)
    for row, record in zip(values, records, strict=True):
        row[: len(record.rows)] = record.of(f"{quantity}_nees")
        t_s[: len(record.rows)] = record.of("t_s")
    count = np.isfinite(values).sum(axis=0, dtype=np.float64)
    enough = count >= max(1.0, 0.5 * len(records))
    kept: Vec = count[enough]
    mean: Vec = np.nansum(values[:, enough], axis=0) / kept
    return Curve(t_s[enough], mean, *band(AXES * kept, kept))


def nis_curve(records: Sequence[Record], source: str) -> Curve:
    """Return the mean NIS per degree of freedom of a source over the flights, second by second."""
    samples = [r.nis[source] for r in records if source in r.nis]
    pooled = np.concatenate(samples) if samples else np.zeros((0, 3))
    second = pooled[:, 0].astype(np.int64)
    sums = np.array([np.bincount(second, weights=pooled[:, k]) for k in (1, 2)], dtype=np.float64)
    there = np.flatnonzero(sums[1] > 0)
    total, dof = sums[:, there]
    t_s: Vec = there.astype(np.float64) + 0.5
    return Curve(t_s, total / dof, *band(dof, dof))


def band(dof: Vec, over: Vec) -> tuple[Vec, Vec]:
    """Return the 95 % band of chi squared of ``dof`` (n,), divided by ``over`` (n,)."""
    low, high = (chi2.ppf(p, dof) / over for p in (0.5 - BAND / 2, 0.5 + BAND / 2))
    return low, high


def sources(records: Sequence[Record]) -> list[str]:
    """Return the names of the sources of which NIS was told."""
    return sorted({source for r in records for source in r.nis})


def tables(records: Sequence[Record]) -> str:
    """Return NEES by quantity and phase, NIS by source, as markdown tables."""
    return "\n\n".join(t for t in (nees_table(records), nis_table(records)) if t)


def nees_table(records: Sequence[Record]) -> str:
    """Return mean NEES and the share inside the band, error² over sigma² and RMS per axis, whole flight and hold."""
    lines = [
        f"| {len(records)} flights | mean NEES, 3 is right | instants inside the 95 % band "
        "| error² / σ² x, y, z, 1 is right | RMS of the error x, y, z | mean σ x, y, z |", "|---" * 6 + "|",
    ]
    for quantity, (name, _, _, unit) in QUANTITIES.items():
        for where, chosen in (("whole flight", records), ("hold", [hold_of(r) for r in records])):
            kept = [r for r in chosen if len(r.rows)]
            if kept:
                lines.append(f"| {name}, {unit}; {where} {_nees_cells(kept, quantity)}")
    return "\n".join(lines)


def hold_of(record: Record) -> Record:
    """Return the record with the rows of the hold, which count from its begin."""
    rows = record.rows[record.during(Phase.HOLD)].copy()
    if len(rows):
        rows[:, 0] -= rows[0, 0]
    return replace(record, rows=rows)


def _nees_cells(records: Sequence[Record], quantity: str) -> str:
    nees = np.concatenate([r.of(f"{quantity}_nees") for r in records])
    inside = nees_curve(records, quantity).share_inside()
    error, sigma = (np.concatenate(part) for part in zip(*(errors(r, quantity) for r in records), strict=True))
    told = np.isfinite(nees)
    error, sigma = error[told], sigma[told]
    ratio, rms = (np.mean(x * x, axis=0) for x in (error / sigma, error))
    return (f"| {nees[told].mean():.2f} | {100 * inside:.0f} % | {three(ratio, '.2f')} "
            f"| {three(np.sqrt(rms), '.2g')} | {three(sigma.mean(axis=0), '.2g')} |")


def nis_table(records: Sequence[Record]) -> str:
    """Return mean NIS and the share inside the band by source, and how many were refused; empty without any."""
    names = sources(records)
    if not names:
        return ""
    lines = ["| source | updates | mean NIS per degree of freedom, 1 is right | seconds inside the 95 % band "
             "| refused, by reason |", "|---" * 5 + "|"]
    for source in names:
        pooled = np.concatenate([r.nis[source] for r in records if source in r.nis])
        inside = nis_curve(records, source).share_inside()
        mean = pooled[:, 1].sum() / pooled[:, 2].sum()
        lines.append(f"| {source} | {len(pooled)} | {mean:.3f} | {100 * inside:.0f} % | {_refused(records, source)} |")
    return "\n".join(lines)


def _refused(records: Sequence[Record], source: str) -> str:
    counts: dict[str, int] = {}
    for record in records:
        for told, count in record.refused.items():
            name, _, reason = told.partition(": ")
            if name == source:
                counts[reason] = counts.get(reason, 0) + count
    return ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items())) or "none"


def three(values: Vec, form: str) -> str:
    """Return numbers as the tables write them."""
    return ", ".join(f"{v:{form}}" for v in values)
