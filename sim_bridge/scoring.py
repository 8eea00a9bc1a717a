"""How well a flight went: BR against the window of thesis Tab. 1.1, over the hold, from the truth.

Rules
-----
* The hold begins when the companion enters HOLD, and lasts ``hold_s`` of the scenario. When HOLD is entered more than
  once the last time counts, because a flight ends with it. It is cut short by leaving HOLD and by the end of the truth.
* Docked: the whole hold was flown, at least the asked share of it inside the desired window, never outside the limit.
* What was not measured is None: without a hold there is no mean of BR. The share inside the window is 0.0 then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.config import WindowConfig
from companion.geometry import Mat
from companion.messages import NS, Phase, PhaseChange
from sim_bridge.plant.boom import Boom
from sim_bridge.scenario import Scenario

Series = tuple[NDArray[np.int64], Mat]
"""t_ns (n,) and BR (n, 3) in m, from box B to receptacle R in ``mrf``."""

EDGE_S = 0.05
"""A hold may lack this much at its end, where companion and simulator stop one after the other."""


def score(series: Series, phases: Sequence[PhaseChange], window: WindowConfig, scenario: Scenario) -> dict[str, Any]:
    """Return what ``summary.json`` says of a flight.

    ``br_mean_m`` signed mean, ``br_abs_mean_m`` mean of the absolute value, ``br_sigma_m`` standard deviation,
    ``br_max_m`` largest absolute value, each [x, y, z] of the hold in metres; ``br_rms_3d_m`` root of the mean squared
    distance; ``time_to_window_s`` from the first truth to the first inside the desired window, over the whole flight.
    """
    t_ns, br = series
    start_ns, end_ns = hold_of(t_ns, phases, scenario.hold_s)
    held = (t_ns >= start_ns) & (t_ns < end_ns)
    desired = inside(br, window.desired_m)
    hold = br[held]
    hold_s = (end_ns - start_ns) * NS if held.any() else 0.0
    share = float(desired[held].mean()) if held.any() else 0.0
    complete = hold_s >= scenario.hold_s - EDGE_S
    within_limit = bool(inside(hold, window.limit_m).all())
    broke = [c.reason for c in phases if c.new is Phase.BREAKAWAY]
    return {
        "docked": complete and within_limit and share >= scenario.criteria.in_window_fraction,
        "hold_s": round(hold_s, 3),
        "in_window_fraction": share,
        "time_to_window_s": float(t_ns[desired.argmax()] - t_ns[0]) * NS if desired.any() else None,
        **statistics(hold),
        "breakaway": broke[0] if broke else None,
    }


def refuelling(boom: Boom) -> dict[str, Any]:
    """Return what ``summary.json`` says of contact and fuel; ``boom_events`` seconds since the start, and what."""
    return {
        "contacts": boom.contacts,
        "disconnects": boom.disconnects,
        "fuel_given_kg": round(boom.given_kg, 3),
        "boom_peak_load_n": round(boom.peak_load_n, 1),
        "boom_events": [[round(t_s, 3), what] for t_s, what in boom.events],
    }


def hold_of(t_ns: NDArray[np.int64], phases: Sequence[PhaseChange], hold_s: float) -> tuple[int, int]:
    """Return start and end of the hold in ns, the same instant when there is none; a truth stands for its step."""
    entries = [k for k, change in enumerate(phases) if change.new is Phase.HOLD]
    if not entries or len(t_ns) < 2:
        return 0, 0
    start_ns = phases[entries[-1]].t_ns
    left = [change.t_ns for change in phases[entries[-1] + 1 :]]
    truth_end_ns = int(t_ns[-1] + (t_ns[-1] - t_ns[-2]))
    return start_ns, max(start_ns, min([start_ns + round(hold_s / NS), truth_end_ns, *left[:1]]))


def inside(br: Mat, half_m: Sequence[float]) -> NDArray[np.bool_]:
    """Return which BR (n, 3) lie in the box of half-widths (3,), edges included."""
    return np.logical_and.reduce(np.abs(br) <= np.asarray(half_m), axis=1)


def statistics(br: Mat) -> dict[str, Any]:
    """Return mean, mean absolute, sigma and largest absolute value per axis, and the 3D RMS, of BR (n, 3)."""
    if len(br) == 0:
        return dict.fromkeys(("br_mean_m", "br_abs_mean_m", "br_sigma_m", "br_max_m", "br_rms_3d_m"))
    return {
        "br_mean_m": br.mean(axis=0).tolist(),
        "br_abs_mean_m": np.abs(br).mean(axis=0).tolist(),
        "br_sigma_m": br.std(axis=0).tolist(),
        "br_max_m": np.abs(br).max(axis=0).tolist(),
        "br_rms_3d_m": float(np.sqrt(np.einsum("ij,ij->i", br, br).mean())),
    }
