"""What people see in the terminal while a flight goes on.

Rules
-----
* A live table when standard error is a terminal that can redraw, a plain line every ``LINE_S`` when it is not.
  Standard output stays free for results.
* Each change of phase is told at once, each stage that fails or is well again on a line of its own.
* ``output`` only keeps the newest message of a kind; drawing is done by a thread (live) or once per line (plain).
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.config import Setup
from companion.io.health_text import stage_line
from companion.messages import (
    NS,
    FusedPose,
    Health,
    Integrity,
    Output,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    Setpoint,
    StageHealth,
    VisionOutput,
)

LINE_S = 5.0
REFRESH_HZ = 4.0
RATE_WINDOW = 50
AXES = ("x", "y", "z")

PHASE_STYLE = {
    Phase.SELF_TEST: "magenta", Phase.JOIN: "cyan", Phase.OBSERVATION: "cyan", Phase.PRE_CONTACT: "cyan",
    Phase.APPROACH: "yellow", Phase.CONTACT: "bold yellow", Phase.HOLD: "bold green", Phase.DISCONNECT: "yellow",
    Phase.BREAKAWAY: "bold red",
}  # fmt: skip
PHASE_WIDTH = max(len(phase) for phase in Phase)


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
        self._integrity: Integrity | None = None
        self._stages: dict[str, StageHealth] = {}
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
        if isinstance(output, RelativeState | FusedPose | Integrity):
            self._keep(output)
        elif isinstance(output, Setpoint):
            self._setpoints.append(output.t_ns)
        elif isinstance(output, VisionOutput):
            self._frames += 1
            self._poses += output.pose is not None
            self._count(output.reject)
        elif isinstance(output, Reject):
            self._count(output)
        elif isinstance(output, Health):
            self._health(output)
        elif isinstance(output, PhaseChange):
            self._phase, self._reason = output.new, output.reason
            self._line_due = 0.0
        if self._live is None and time.monotonic() >= self._line_due:
            self._print_line()

    def _keep(self, output: RelativeState | FusedPose | Integrity) -> None:
        if isinstance(output, RelativeState):
            self._state = output
        elif isinstance(output, FusedPose):
            self._fused = output
        else:
            self._integrity = output

    def notice(self, text: str) -> None:
        """Print a line at once, above the live table if there is one."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _health(self, health: Health) -> None:
        lines = [stage_line(self._stages.get(s.name), s) for s in health.stages]
        self._stages = {s.name: s for s in health.stages}
        for line in filter(None, lines):
            self.notice(f"t {self._seconds():6.1f} s | {line}")

    def _count(self, reject: Reject | None) -> None:
        if reject is not None:
            self._rejects[f"{reject.source}.{reject.reason}"] += 1

    def _print_line(self) -> None:
        self._line_due = time.monotonic() + LINE_S
        self._console.print(self.line(), highlight=False, markup=False, soft_wrap=True)

    def line(self) -> str:
        """Return the flight in one plain line."""
        parts = [f"t {self._seconds():6.1f} s", f"{self._phase:<{PHASE_WIDTH}}"]
        if self._state is not None:
            br = "  ".join(f"{axis} {v:+7.2f}" for axis, v in zip(AXES, self._state.p_mrf_br_m, strict=True))
            parts += [f"BR {br} m", f"range {self._state.range_m:5.1f} m"]
        if self._fused is not None:
            parts += [f"{self._fused.markers_used} markers", f"vision {100 * self._fused.vision_weight:3.0f} %"]
        if self._integrity is not None:
            parts.append(trust_text(self._integrity))
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
        if self._integrity is not None:
            table.add_row("trust", Text(trust_text(self._integrity), "green" if self._integrity.may_dock else "yellow"))
        ill = [s for s in self._stages.values() if s.enabled and not s.healthy]
        for stage in ill:
            table.add_row("health", Text(f"{stage.name} {stage.detail}".rstrip(), "bold red"))
        if self._stages and not ill:
            table.add_row("health", "all well")
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


def trust_text(integrity: Integrity) -> str:
    """Return whether the receiver may dock, and by what: failing tests, or protection (alert limit) per axis in m."""
    word = "may dock" if integrity.may_dock else "may not dock"
    if integrity.faults:
        return f"{word}: {', '.join(integrity.faults)}"
    pairs = zip(AXES, integrity.protection_mrf_m, integrity.alert_mrf_m, strict=True)
    return f"{word}, {'  '.join(f'{axis} ±{p:.2f} ({alert:.2f})' for axis, p, alert in pairs)} m"
