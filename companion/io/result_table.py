"""How a flight went, as text: ours beside the thesis."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from io import StringIO
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.budgets import BUDGETS
from companion.config import WindowConfig

AXES = ("x", "y", "z")

THESIS_MEAN_M = {"GLSDC": (0.2581, 0.0153, 0.1100), "LHM": (0.2539, 0.0034, 0.0966)}
THESIS_SIGMA_M = {"GLSDC": (0.2160, 0.0943, 0.0949), "LHM": (0.2166, 0.0898, 0.0875)}
"""Thesis Tab. 1.2, x y z."""

THESIS_RMS_3D_M = {"LHM": 0.369}
"""From Tab. 1.2: the root of the squared means and sigmas together."""


def result_table(summary: dict[str, Any], window: WindowConfig) -> str:
    """Return how a flight went as text: ours beside thesis Tab. 1.1 and 1.2, latency and rejects.

    Coloured when standard output is a terminal. What was not measured is shown as a dash.
    """
    out = StringIO()
    console = Console(file=out, force_terminal=sys.stdout.isatty(), width=100)
    console.print(_verdict(summary))
    console.print(_window_table(summary, window))
    console.print(_statistics_table(summary))
    if summary.get("latency_ms"):
        console.print(_latency_table(summary["latency_ms"]))
    if summary.get("contacts"):
        console.print(_refuelling(summary), highlight=False, markup=False)
    if summary.get("integrity"):
        console.print(_trust(summary["integrity"]), highlight=False, markup=False)
    rejects = ", ".join(f"{reason} {n}" for reason, n in summary.get("rejects", {}).items())
    console.print(f"rejects: {rejects or 'none'}", highlight=False, markup=False)
    return out.getvalue().rstrip("\n")


def _verdict(summary: dict[str, Any]) -> Text:
    docked = summary.get("docked", False)
    text = Text("docked" if docked else "not docked", "bold green" if docked else "bold red")
    share, hold_s = summary.get("in_window_fraction") or 0.0, summary.get("hold_s") or 0.0
    text.append(f": {100 * share:.1f} % of {hold_s:.1f} s hold inside the desired window", "")
    reached = summary.get("time_to_window_s")
    text.append(f", first inside after {reached:.1f} s" if reached is not None else ", never inside", "")
    if summary.get("breakaway"):
        text.append(f"; breakaway: {summary['breakaway']}", "red")
    return text


def _refuelling(summary: dict[str, Any]) -> str:
    contacts = summary["contacts"]
    lets_go = ", ".join(f"{reason} {n}" for reason, n in summary.get("disconnects", {}).items())
    return (
        f"boom: {contacts} contact{'s' if contacts > 1 else ''}, {summary['fuel_given_kg']:.0f} kg of fuel given, "
        f"peak load {summary['boom_peak_load_n'] / 1e3:.1f} kN; disconnects: {lets_go or 'none'}"
    )


def _trust(integrity: dict[str, Any]) -> str:
    if integrity.get("may_dock_fraction") is None:
        return "trust: may dock outside the hold only"
    pairs = zip(AXES, integrity["protection_max_m"], integrity["alert_m"], strict=True)
    bounds = ", ".join(f"{axis} {_or_dash(p)} ({_or_dash(alert)})" for axis, p, alert in pairs)
    faults = ", ".join(f"{name} {100 * share:.1f} %" for name, share in integrity.get("faults", {}).items())
    return (f"trust: may dock in {100 * integrity['may_dock_fraction']:.1f} % of the hold; largest protection level "
            f"(alert limit), m: {bounds}; tests that failed: {faults or 'none'}")


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _window_table(summary: dict[str, Any], window: WindowConfig) -> Table:
    table = Table("BR in the hold, m", *AXES, title="Window (thesis Tab. 1.1)", title_justify="left")
    table.add_row("desired, ±", *_numbers(window.desired_m, 2))
    table.add_row("limit, ±", *_numbers(window.limit_m, 2))
    table.add_row("ours, largest", *_numbers(summary.get("br_max_m"), 2))
    return table


def _statistics_table(summary: dict[str, Any]) -> Table:
    table = Table("BR in the hold, m", *AXES, "3D RMS", title="Accuracy (thesis Tab. 1.2)", title_justify="left")
    solver = str(summary.get("pose_solver", "-")).upper()
    rms = summary.get("br_rms_3d_m")
    absolute = [abs(v) for v in summary["br_mean_m"]] if summary.get("br_mean_m") else None
    table.add_row(f"ours ({solver}), |mean|", *_numbers(absolute, 4), "" if rms is None else f"{rms:.3f}")
    for name, mean in THESIS_MEAN_M.items():
        theirs = THESIS_RMS_3D_M.get(name)
        table.add_row(f"thesis {name}, |mean|", *_numbers(mean, 4), "" if theirs is None else f"{theirs:.3f}")
    table.add_row(f"ours ({solver}), sigma", *_numbers(summary.get("br_sigma_m"), 4), "")
    for name, sigma in THESIS_SIGMA_M.items():
        table.add_row(f"thesis {name}, sigma", *_numbers(sigma, 4), "")
    return table


def _latency_table(latency_ms: dict[str, dict[str, float]]) -> Table:
    table = Table("stage", "p50", "p99", "max", "budget p99", "what", title="Latency, ms", title_justify="left")
    for stage, q in latency_ms.items():
        budget = BUDGETS.get(stage)
        allowed = ("-", "") if budget is None else (f"{budget.p99_ms:.0f}", budget.what)
        table.add_row(stage, *(f"{q[key]:.3f}" for key in ("p50", "p99", "max")), *allowed)
    return table


def _numbers(values: Sequence[float] | None, digits: int) -> list[str]:
    return ["-"] * 3 if values is None else [f"{v:.{digits}f}" for v in values]
