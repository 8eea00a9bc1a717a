"""Records of flights that were never flown: rows with known errors."""

import numpy as np

from companion.messages import Phase, PhaseChange
from sim_bridge.runs.record import SLICES, WIDTH, Record

S = 1_000_000_000
SAFE = {"collision": False, "closest_m": 3.0, "outside_limit_m": 0.0, "breakaway_delay_s": None}


def rows_of(n, dt_s=0.1, **columns):
    """Return rows (n, WIDTH) with these columns, NaN elsewhere."""
    rows = np.full((n, WIDTH), np.nan)
    rows[:, SLICES["t_s"]] = dt_s * np.arange(n)[:, None]
    for name, values in columns.items():
        part = SLICES[name]
        rows[:, part] = np.broadcast_to(np.asarray(values, dtype=float), (n, part.stop - part.start))
    return rows


def record_of(rows, changes=((0.0, "standby"), (0.0, "hold")), nis=None, safety=None, **fields):
    """Return a record; ``changes`` are instants in s and phases."""
    told, old = [], Phase.STANDBY
    for t_s, phase in changes:
        told.append(PhaseChange(round(t_s * S), old, Phase(phase), "why"))
        old = Phase(phase)
    values = {
        "label": "made", "seed": 1, "failure": None, "rows": rows, "changes": tuple(told), "nis": nis or {},
        "refused": {}, "states": np.zeros((0,)), "alarms": (), "safety": {**SAFE, **(safety or {})}, "fault_s": None,
    }
    return Record(**{**values, **fields})
