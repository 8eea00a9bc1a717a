"""How protection and error lie to each other and to the alert limit: the regions of a Stanford plot, counted.

Regions of one axis at one instant, e the error, p the protection level, a the alert limit:

============ ==================== ======================================================================
region       is                   means
============ ==================== ======================================================================
nominal      may dock, e <= p     what it should be
misleading   may dock, p < e <= a the error is larger than was told, but the window bears it
hazardous    may dock, e > a      the error is more than the window bears, and nobody was told
held back    may not dock         whatever the error: nobody docks on it
============ ==================== ======================================================================

A false "may dock" is misleading, hazardous, or, in contact and hold, where the receptacle has to be in the limit
window, an estimate inside it whose truth is outside. On the way in estimate and truth cross its edge some millimetres,
and so an instant, one after the other, which says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config import WindowConfig
from companion.geometry import Mat, Vec
from companion.messages import Phase
from sim_bridge.runs.record import Record
from sim_bridge.scoring import inside

EDGES = np.logspace(-4.0, 2.0, 91)
"""Bins of error and protection in alert limits, 15 a decade; what lies beyond is put into the last."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Counts of instants: ``told`` with integrity; ``nominal``, ``misleading``, ``hazardous``, ``held_back`` (3,).

    ``outside`` instants of contact and hold at which docking was allowed, the estimate inside the limit window and the
    truth outside. ``allowed`` and ``refused`` (3, 90, 90) histograms of error and protection over ``EDGES``.
    ``first_s`` instant of the first false "may dock", None when there was none.
    """

    told: int
    allowed_count: int
    nominal: NDArray[np.int64]
    misleading: NDArray[np.int64]
    hazardous: NDArray[np.int64]
    held_back: int
    outside: int
    allowed: NDArray[np.int64]
    refused: NDArray[np.int64]
    first_s: float | None

    @property
    def false(self) -> bool:
        """Say whether there was a false "may dock"."""
        return self.first_s is not None


def judge(record: Record, window: WindowConfig) -> Judged:
    """Return the regions of one flight."""
    told = np.isfinite(record.of("alert_m")).all(axis=1) & np.isfinite(record.of("br_m")).all(axis=1)
    br, true = record.of("br_m")[told], record.of("br_true_m")[told]
    p, a = record.of("protection_m")[told], record.of("alert_m")[told]
    may = record.of("may_dock")[told] == 1.0
    e = np.abs(br - true)
    yes = may[:, None]
    hazardous, misleading = yes & (e > a), yes & (e <= a) & ~(e <= p)
    boxed = record.during(Phase.CONTACT, Phase.HOLD)[told]
    outside = may & boxed & inside(br, window.limit_m) & ~inside(true, window.limit_m)
    false = outside | (hazardous | misleading).any(axis=1)
    return Judged(
        int(told.sum()), int(may.sum()), (yes & (e <= a) & (e <= p)).sum(axis=0), misleading.sum(axis=0),
        hazardous.sum(axis=0), int((~may).sum()), int(outside.sum()), histogram(e / a, p / a, may),
        histogram(e / a, p / a, ~may), float(record.of("t_s")[told][false][0]) if false.any() else None,
    )


def histogram(e: Mat, p: Mat, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return counts (3, 90, 90) per axis over error and protection (n, 3), both in alert limits."""
    return np.array([np.histogram2d(clipped(e[chosen, k]), clipped(p[chosen, k]), (EDGES, EDGES))[0]
                     for k in range(3)]).astype(np.int64)


def clipped(x: Vec) -> Vec:
    """Return values within the edges; what is no number or endless is put into the last bin."""
    return np.clip(np.nan_to_num(x, nan=np.inf), EDGES[0], 0.999 * EDGES[-1])
