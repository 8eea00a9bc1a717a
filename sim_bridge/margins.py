"""How much a law bears: the largest latency, slowest setpoints and worst errors of the airframe that still hold.

Rules
-----
* A law holds under a variation when every one of the seeds docks and holds (``scoring``: 95 % of the hold inside the
  desired window, never outside the limit). Nothing is tuned for it: the configuration is the scenario's.
* Seeds begin at 2001: neither tuned on nor reported.
* Flights begin 5 m from the box, go to it directly and see by detections (``vision_input``), so that they are short
  and quick.
* A ladder of values is searched by halves, so what lies above the first step that fails is not flown. The last step
  that holds is the margin; ``all`` means that the ladder ended before the law did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any, Literal

import msgspec
import numpy as np

from companion.app import warm_up
from companion.config import Setup
from companion.geometry import Vec
from companion.messages import Output, PhaseChange
from sim_bridge.flight import Ending, LockstepCompanion, Unrecorded, run
from sim_bridge.plant.conditions import AirframeErrors
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.scoring import score
from sim_bridge.simulation import BoxTruth, Simulation, nominal_heading_rad
from sim_bridge.truth import Truth

Law = Literal["attitude", "velocity", "surfaces"]
LAWS: tuple[Law, ...] = ("attitude", "velocity", "surfaces")
FIRST_SEED = 2001
START_TANKER_M = (-33.0, -2.0, 12.0)
PATH_S = 10.0
TIMEOUT_AFTER_HOLD_S = 60.0
replace = msgspec.structs.replace
Flight = tuple[Scenario, Setup]


@dataclass(frozen=True, slots=True)
class Ladder:
    """One quantity, from harmless to fatal; ``what`` is the table's row, ``scale`` turns values to its unit."""

    what: str
    values: tuple[float, ...]
    change: Callable[..., Flight]
    scale: float = 1000.0
    form: str = "{:.0f} ms"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Whether all seeds held, and the mean standard deviation (3,) of BR over those that came to a hold."""

    held: bool
    sigma_m: tuple[float, ...] | None


def late_setpoints(flight: Flight, value: float) -> Flight:
    """Delay setpoints on their way to the autopilot by ``value`` s."""
    scenario, setup = flight
    return replace(scenario, link=replace(scenario.link, setpoint_delay_s=value)), setup


def slow_setpoints(flight: Flight, value: float) -> Flight:
    """Run guidance, and send its setpoints, ``value`` times a second."""
    return flight[0], with_guidance(flight[1], rate_hz=value)


def late_actuators(flight: Flight, value: float) -> Flight:
    """Delay the actuators by ``value`` s more."""
    return with_errors(flight, actuator_delay_s=value)


def late_vision(flight: Flight, value: float) -> Flight:
    """Let ``value`` s pass from exposure to delivery."""
    scenario, setup = flight
    return scenario, replace(setup, camera=replace(setup.camera, latency_s=value))


def with_errors(flight: Flight, **errors: Any) -> Flight:
    """Let the airframe differ from its data."""
    scenario, setup = flight
    return replace(scenario, plant=replace(scenario.plant, airframe=AirframeErrors(**errors))), setup


def with_guidance(setup: Setup, **changed: Any) -> Setup:
    """Change the companion's guidance configuration."""
    return replace(setup, config=replace(setup.config, guidance=replace(setup.config.guidance, **changed)))


LADDERS = (
    Ladder("latency of setpoints added", (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0), late_setpoints),
    Ladder("slowest setpoints", (40.0, 25.0, 20.0, 10.0), slow_setpoints, 1.0, "{:.0f} Hz"),
    Ladder("delay of actuators added", (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05), late_actuators),
    Ladder("latency of vision", (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0), late_vision),
)
ERRORS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("nothing changed", {}),
    ("effectiveness x 0.8", {"effectiveness": 0.8}),
    ("effectiveness x 1.2", {"effectiveness": 1.2}),
    *((f"{name} x {factor}", {"coefficients": {name: factor}})
      for name, factors in (("Cnb", (0.5, 1.5)), ("Clb", (0.5, 1.5)), ("CLa", (0.9, 1.1))) for factor in factors),
)


def fly_once(scenario: Scenario, setup: Setup) -> dict[str, Any]:
    """Fly without a recording; return what ``scoring.score`` says, ``docked`` false when the plant failed."""
    warm_up(setup)
    phases: list[PhaseChange] = []
    t_ns: list[int] = []
    br: list[Vec] = []
    box = BoxTruth(setup, nominal_heading_rad(scenario))

    def see(truth: Truth) -> None:
        t_ns.append(truth.t_ns)
        br.append(box.p_mrf_br_m(truth))

    def watch(output: Output) -> None:
        if isinstance(output, PhaseChange):
            phases.append(output)

    companion = LockstepCompanion(setup, Unrecorded(), watch, scenario.link.setpoint_delay_s)
    failure = run(Simulation(scenario, setup), companion, Ending(scenario.hold_s, scenario.timeout_s), see)
    result = score((np.array(t_ns), np.array(br)), phases, setup.tanker.window, scenario)
    return {**result, "docked": result["docked"] and failure is None}


def base(scenario_name: str, law: Law, hold_s: float) -> Flight:
    """Return the flight that is varied: near the box, by detections."""
    scenario = load_scenario(scenario_name)
    setup = with_guidance(scenario.setup(), law=law, path_duration_s=PATH_S, procedure="direct", self_test=False)
    near = replace(
        scenario, start_tanker_m=START_TANKER_M, vision_input="detections", hold_s=hold_s,
        timeout_s=hold_s + TIMEOUT_AFTER_HOLD_S,
    )
    return near, setup


class Bench:
    """Flies variations in worker processes; a law's unvaried flight is ``flight``."""

    def __init__(self, pool: ProcessPoolExecutor, flight: Flight, seeds: int) -> None:
        self._pool, self._flight = pool, flight
        self._seeds = range(FIRST_SEED, FIRST_SEED + seeds)

    def fly(self, change: Callable[[Flight], Flight]) -> Outcome:
        """Fly all seeds of one variation."""
        scenario, setup = change(self._flight)
        flights = [self._pool.submit(fly_once, replace(scenario, seed=seed), setup) for seed in self._seeds]
        results = [f.result() for f in flights]
        sigmas = [r["br_sigma_m"] for r in results if r["br_sigma_m"] is not None]
        mean = tuple(float(s) for s in np.mean(sigmas, axis=0)) if sigmas else None
        return Outcome(all(r["docked"] for r in results), mean)

    def climb(self, ladder: Ladder) -> str:
        """Return the highest value of a ladder that holds, in the table's words."""
        low, high = -1, len(ladder.values)
        while high - low > 1:
            middle = (low + high) // 2
            held = self.fly(partial(ladder.change, value=ladder.values[middle])).held
            low, high = (middle, high) if held else (low, middle)
        if low < 0:
            return "fails at " + ladder.form.format(ladder.values[0] * ladder.scale)
        text = ladder.form.format(ladder.values[low] * ladder.scale)
        return text + " (all)" if low == len(ladder.values) - 1 else text


@contextmanager
def workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes that start from nothing, as flights do."""
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield pool


def margins(
    scenario: str, laws: tuple[Law, ...], *, quick: bool, processes: int = 2, tell: Callable[[str], None] = print
) -> str:
    """Measure and return a markdown table; ``quick``: two seeds and short holds. ``tell`` hears of progress."""
    seeds, hold_s = (2, 15.0) if quick else (4, 40.0)
    columns: list[list[str]] = []
    with workers(processes) as pool:
        for law in laws:
            bench = Bench(pool, base(scenario, law, hold_s), seeds)
            column = []
            for what, errors in ERRORS:
                outcome = bench.fly(partial(with_errors, **errors))
                column.append(told(outcome))
                tell(f"{law}: {what}: {column[-1]}")
            for ladder in LADDERS:
                column.append(bench.climb(ladder))
                tell(f"{law}: {ladder.what}: {column[-1]}")
            columns.append(column)
    rows = [what for what, _ in ERRORS] + [ladder.what for ladder in LADDERS]
    head = f"| {seeds} seeds, {hold_s:.0f} s of hold | " + " | ".join(f"`{law}`" for law in laws) + " |"
    body = [f"| {what} | " + " | ".join(c[k] for c in columns) + " |" for k, what in enumerate(rows)]
    return "\n".join([head, "|---" * (len(laws) + 1) + "|", *body])


def told(outcome: Outcome) -> str:
    """Return an outcome as the table says it."""
    sigma = "no hold" if outcome.sigma_m is None else "σ " + " / ".join(f"{s:.3f}" for s in outcome.sigma_m)
    return sigma if outcome.held else f"**lost** ({sigma})"
