"""How well a flight went: BR against the window of thesis Tab. 1.1, over the hold, from the truth.

Rules
-----
* The hold begins when the companion enters HOLD, and lasts ``hold_s`` of the scenario. When HOLD is entered more than
  once the last time counts, because a flight ends with it. It is cut short by leaving HOLD and by the end of the truth.
* Docked: the whole hold was flown, at least the asked share of it inside the desired window, never outside the limit.
* What was not measured is None: without a hold there is no mean of BR. The share inside the window is 0.0 then.
* Safety is scored over the whole flight (``Safety``). In contact and hold the receptacle has to be in the limit box
  below the tanker; in every other phase, breakaway too, it may be aft of it, below it or beside it, but never forward
  of it or above it: in standby too, where the autopilot flies by itself, but for a standby in which a pilot does
  (``TAKEN_OVER``), and before the first engagement. A collision, a centre of mass in the space of the tanker, counts in
  any phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.config import WindowConfig
from companion.geometry import Mat, Vec
from companion.guidance.modes import TAKEN_OVER
from companion.messages import NS, Phase, PhaseChange
from sim_bridge.plant.boom import Boom
from sim_bridge.scenario import TANKER_SPACE_M, Scenario
from sim_bridge.truth import Truth

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


class Safety:
    """Watches one flight, and tells afterwards whether it was safe all the time."""

    def __init__(self, window: WindowConfig) -> None:
        self._limit_m = np.array(window.limit_m)
        self._t_ns: list[int] = []
        self._br: list[Vec] = []
        self._p_tanker_m: list[Vec] = []

    def see(self, truth: Truth, p_mrf_br_m: Vec) -> None:
        """Take the truth of one instant, and BR (3,) with it; 50 Hz is enough."""
        self._t_ns.append(truth.t_ns)
        self._br.append(np.array(p_mrf_br_m))
        self._p_tanker_m.append(truth.tanker.R_ned_body.T @ (truth.uav.p_ned_m - truth.tanker.p_ned_m))

    def result(self, phases: Sequence[PhaseChange], fault_ns: int | None = None) -> dict[str, Any]:
        """Return what ``summary.json`` says of safety.

        ``collision``; ``closest_m`` least distance of the receiver's centre of mass from the space of the tanker
        (``TANKER_SPACE_M``, 0 in a collision); ``outside_limit_m`` how far the receptacle was where it may not be, at
        most (0: never); ``breakaway_delay_s`` from ``fault_ns`` to the first breakaway after it, None without either.
        """
        if not self._t_ns:
            return dict.fromkeys(("collision", "closest_m", "outside_limit_m", "breakaway_delay_s"))
        low, high = np.array(TANKER_SPACE_M).T
        p = np.array(self._p_tanker_m)
        away_m = np.linalg.norm(np.maximum(np.maximum(low - p, p - high), 0.0), axis=1)
        broke = [c.t_ns for c in phases if c.new is Phase.BREAKAWAY and fault_ns is not None and c.t_ns >= fault_ns]
        return {
            "collision": bool((away_m == 0.0).any()),
            "closest_m": round(float(away_m.min()), 3),
            "outside_limit_m": round(float(self._outside_m(phases).max()), 3),
            "breakaway_delay_s": round((broke[0] - fault_ns) * NS, 3) if broke and fault_ns is not None else None,
        }

    def _outside_m(self, phases: Sequence[PhaseChange]) -> Vec:
        """Return how far (n,) BR is where it may not be."""
        br, t_ns = np.array(self._br), np.array(self._t_ns)
        forward_or_above = np.maximum(br[:, 0] - self._limit_m[0], -br[:, 2] - self._limit_m[2])
        outside_box = (np.abs(br) - self._limit_m).max(axis=1)
        outside_m = np.zeros(len(br))
        engaged = False
        for change, end_ns in zip(phases, [*(c.t_ns for c in phases[1:]), t_ns[-1] + 1], strict=False):
            meant = (t_ns >= change.t_ns) & (t_ns < end_ns)
            standby = change.new is Phase.STANDBY
            engaged = engaged or not standby
            if engaged and not (standby and change.reason == TAKEN_OVER):
                boxed = change.new in (Phase.CONTACT, Phase.HOLD)
                outside_m[meant] = (outside_box if boxed else forward_or_above)[meant]
        return np.maximum(outside_m, 0.0)


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
