"""What people see in the terminal: the flight as it goes on, and how it went.

Rules
-----
* A live table when standard error is a terminal that can redraw, a plain line every ``LINE_S`` when it is not.
  Standard output stays free for results.
* ``output`` only keeps the newest message of a kind; drawing is done by a thread (live) or once per line (plain).
"""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Sequence
from io import StringIO
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.budgets import BUDGETS
from companion.config import Setup, WindowConfig
from companion.messages import NS, FusedPose, Output, Phase, PhaseChange, Reject, RelativeState, Setpoint, VisionOutput

LINE_S = 5.0
REFRESH_HZ = 4.0
RATE_WINDOW = 50
AXES = ("x", "y", "z")

THESIS_MEAN_M = {"GLSDC": (0.2581, 0.0153, 0.1100), "LHM": (0.2539, 0.0034, 0.0966)}
THESIS_SIGMA_M = {"GLSDC": (0.2160, 0.0943, 0.0949), "LHM": (0.2166, 0.0898, 0.0875)}
"""Thesis Tab. 1.2, x y z."""

THESIS_RMS_3D_M = {"LHM": 0.369}
"""From Tab. 1.2: the root of the squared means and sigmas together."""

PHASE_STYLE = {Phase.APPROACH: "yellow", Phase.HOLD: "bold green", Phase.BREAKAWAY: "bold red", Phase.JOIN: "cyan"}


class FlightConsole:
    """Shows a flight while it goes on; a context manager. Feed it every output of the companion."""

    def __init__(self, setup: Setup, console: Console | None = None, t0_ns: int | None = None) -> None:
        """``t0_ns`` is the zero of the time shown, the first output's instant by default."""
        self._window = setup.tanker.window
        self._console = console or Console(stderr=True)
        self._t0_ns = t0_ns
        self._t_ns = 0
        self._phase = Phase.STANDBY
        self._reason = ""
        self._state: RelativeState | None = None
        self._fused: FusedPose | None = None
        self._setpoints: deque[int] = deque(maxlen=RATE_WINDOW)
        self._frames = 0
        self._poses = 0
        self._rejects: Counter[str] = Counter()
        self._line_due = time.monotonic()
        self._live: Live | None = None

    def output(self, output: Output) -> None:
        """Take one output of the companion."""
        self._t_ns = max(self._t_ns, output.t_ns)
        if self._t0_ns is None:
            self._t0_ns = output.t_ns
        if isinstance(output, RelativeState):
            self._state = output
        elif isinstance(output, FusedPose):
            self._fused = output
        elif isinstance(output, Setpoint):
            self._setpoints.append(output.t_ns)
        elif isinstance(output, VisionOutput):
            self._frames += 1
            self._poses += output.pose is not None
            self._count(output.reject)
        elif isinstance(output, Reject):
            self._count(output)
        elif isinstance(output, PhaseChange):
            self._phase, self._reason = output.new, output.reason
            self._line_due = 0.0
        if self._live is None and time.monotonic() >= self._line_due:
            self._print_line()

    def notice(self, text: str) -> None:
        """Print a line at once, above the live table if there is one."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _count(self, reject: Reject | None) -> None:
        if reject is not None:
            self._rejects[f"{reject.source}.{reject.reason}"] += 1

    def _print_line(self) -> None:
        self._line_due = time.monotonic() + LINE_S
        self._console.print(self.line(), highlight=False, markup=False, soft_wrap=True)

    def line(self) -> str:
        """Return the flight in one plain line."""
        parts = [f"t {self._seconds():6.1f} s", f"{self._phase:<9}"]
        if self._state is not None:
            br = "  ".join(f"{axis} {v:+7.2f}" for axis, v in zip(AXES, self._state.p_mrf_br_m, strict=True))
            parts += [f"BR {br} m", f"range {self._state.range_m:5.1f} m"]
        if self._fused is not None:
            parts += [f"{self._fused.markers_used} markers", f"vision {100 * self._fused.vision_weight:3.0f} %"]
        parts += [f"setpoints {self.setpoint_rate_hz():.0f} Hz", f"rejects {self._rejects.total()}"]
        return " | ".join(parts)

    def setpoint_rate_hz(self) -> float:
        """Return the rate of the last setpoints, 0.0 when they have stopped for a second."""
        sent = list(self._setpoints)
        if len(sent) < 2 or self._t_ns - sent[-1] > 1_000_000_000 or sent[-1] == sent[0]:
            return 0.0
        return (len(sent) - 1) / ((sent[-1] - sent[0]) * NS)

    def _seconds(self) -> float:
        return (self._t_ns - (self._t0_ns or 0)) * NS

    def table(self) -> Table:
        """Return the flight as the live table."""
        table = Table(title="refuelling approach", title_justify="left", show_header=False, min_width=64)
        table.add_column(style="dim", no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_row("time", f"{self._seconds():.1f} s")
        phase = Text.assemble((str(self._phase), PHASE_STYLE.get(self._phase, "")), (f"   {self._reason}", "dim"))
        table.add_row("phase", phase)
        if self._state is not None:
            table.add_row("BR", self._br(self._state.p_mrf_br_m.tolist()))
            table.add_row("range", f"{self._state.range_m:.1f} m")
        if self._fused is not None:
            weight = self._fused.vision_weight
            bar = "█" * round(10 * weight) + "░" * (10 - round(10 * weight))
            table.add_row("vision", f"{bar} {100 * weight:.0f} %, {self._fused.markers_used} markers")
        table.add_row("frames", f"{self._frames}, {self._poses} with a pose")
        table.add_row("setpoints", f"{self.setpoint_rate_hz():.0f} Hz")
        worst = ", ".join(f"{reason} {n}" for reason, n in self._rejects.copy().most_common(3))
        table.add_row("rejects", f"{self._rejects.total()}{f' ({worst})' if worst else ''}")
        return table

    def _br(self, br_m: Sequence[float]) -> Text:
        """Return BR with each axis green in the desired window, yellow in the limit, red outside."""
        text = Text()
        for axis, v, desired, limit in zip(AXES, br_m, self._window.desired_m, self._window.limit_m, strict=True):
            style = "green" if abs(v) <= desired else "yellow" if abs(v) <= limit else "red"
            text.append(f"{axis} {v:+7.2f}  ", style)
        return text.append("m", "dim")

    def __enter__(self) -> FlightConsole:
        """Start the live table on a terminal."""
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._live = Live(
                console=self._console, get_renderable=self.table, refresh_per_second=REFRESH_HZ, redirect_stdout=False
            )
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the last state standing."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        elif self._t0_ns is not None:
            self._print_line()


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
