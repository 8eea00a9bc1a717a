"""The terminal: plain lines, or a live table where there is a terminal; the thesis beside our result."""

from io import StringIO

import pytest
from rich.console import Console
from synthetic_flight import health, integrity, messages, synthetic_setup

from companion.config import WindowConfig
from companion.io.console import FlightConsole
from companion.io.result_table import result_table
from companion.messages import Health, Integrity, Phase, PhaseChange


def fly(console: Console, seconds: float) -> FlightConsole:
    with FlightConsole(synthetic_setup(), console) as shown:
        for direction, message in messages(synthetic_setup(), seconds, pictures=False):
            if direction == "out":
                shown.output(message)  # type: ignore[arg-type]
    return shown


def test_without_a_terminal_plain_lines_tell_every_phase() -> None:
    out = StringIO()
    fly(Console(file=out, width=40), 31.0)
    text = out.getvalue()
    assert "\x1b" not in text
    lines = text.splitlines()
    changes = [m for _, m in messages(synthetic_setup(), 31.0, pictures=False) if isinstance(m, PhaseChange)]
    health = [line for line in lines if "datalink" in line]
    assert health == ["t    3.0 s | datalink fails: stale for 0.5 s", "t    5.0 s | datalink is well again"]
    assert len(lines) == 1 + len(changes) + len(health) + 1
    for change in changes:
        assert sum(f"| {change.new:<11} |" in line for line in lines) == 1 + (change is changes[-1])
    assert "| hold        |" in lines[-1]
    assert "| may dock, x ±0.32 (0.40)  y ±0.15 (0.50)  z ±0.22 (0.50) m |" in lines[-1]
    assert "vision 100 %" in lines[-1]
    assert "setpoints 50 Hz" in lines[-1]
    assert all(len(line) > 40 for line in lines[1:] if line not in health)  # a log is not folded


def test_on_a_terminal_one_table_is_redrawn() -> None:
    out = StringIO()
    shown = fly(Console(file=out, width=100, force_terminal=True, _environ={"TERM": "xterm"}), 5.0)
    assert "\x1b[" in out.getvalue()
    assert "approach" in out.getvalue()
    plain = StringIO()
    Console(file=plain, width=100).print(shown.table())
    assert "100, 98 with a pose" in plain.getvalue()
    assert "4" in plain.getvalue().split("rejects")[1]


def test_a_stage_that_fails_has_a_row_until_it_is_well() -> None:
    def table(*told: Health | Integrity) -> str:
        out = StringIO()
        shown = FlightConsole(synthetic_setup(), Console(file=StringIO()))
        for message in told:
            shown.output(message)
        Console(file=out, width=100).print(shown.table())
        return out.getvalue()

    assert "health" not in table()
    assert "datalink stale for 0.5 s" in table(health(0), health(3_000_000_000))
    assert "all well" in table(health(0), health(3_000_000_000), health(5_000_000_000))
    assert "may not dock: gps_vision" in table(integrity(6_500_000_000))
    assert "may not dock: unseen" in table(integrity(0))
    assert "may not dock, x ±" in table(integrity(5_000_000_000))


def test_a_terminal_that_cannot_redraw_gets_lines() -> None:
    out = StringIO()
    fly(Console(file=out, width=100, force_terminal=True, _environ={"TERM": "dumb"}), 5.0)
    assert "\x1b" not in out.getvalue()
    assert "| approach" in out.getvalue()


def test_setpoints_that_stopped_are_at_zero_hertz() -> None:
    shown = FlightConsole(synthetic_setup(), Console(file=StringIO()))
    assert shown.setpoint_rate_hz() == 0.0
    for _, message in messages(synthetic_setup(), 2.0, pictures=False):
        if type(message).__name__ == "AttitudeSetpoint":
            shown.output(message)  # type: ignore[arg-type]
    assert shown.setpoint_rate_hz() == pytest.approx(50.0)
    shown.output(PhaseChange(4_000_000_000, Phase.APPROACH, Phase.BREAKAWAY, "later"))
    assert shown.setpoint_rate_hz() == 0.0


def test_the_result_stands_beside_the_thesis() -> None:
    text = result_table(
        {
            "docked": True, "hold_s": 60.0, "in_window_fraction": 0.987, "time_to_window_s": 48.2,
            "br_mean_m": [-0.01234, 0.02, 0.03], "br_sigma_m": [0.1, 0.2, 0.3], "br_max_m": [0.5, 0.6, 0.7],
            "br_rms_3d_m": 0.123, "pose_solver": "glsdc", "breakaway": None, "rejects": {"datalink.crc": 3},
            "latency_ms": {"vision": {"p50": 1.5, "p99": 2.5, "max": 9.5}},
            "integrity": {"may_dock_fraction": 0.995, "protection_max_m": [0.31, None, 0.5], "alert_m": [0.4, 0.5, 0.6],
                          "may_dock_s": 30.0, "faults": {"residual": 0.005}},
        },
        WindowConfig(),
    )  # fmt: skip
    assert text.startswith("docked: 98.7 % of 60.0 s hold inside the desired window, first inside after 48.2 s")
    for figure in ("0.0123", "0.123", "ours (GLSDC)", "0.2539", "0.369", "0.40", "2.56", "9.500", "datalink.crc 3"):
        assert figure in text
    trust = " ".join(text[text.index("trust:") :].split())
    assert "may dock in 99.5 % of the hold" in trust
    assert "x 0.31 (0.40), y - (0.50), z 0.50 (0.60); tests that failed: residual 0.5 %" in trust


def test_a_result_without_a_hold_shows_dashes_and_why() -> None:
    summary = {"docked": False, "hold_s": 0.0, "br_mean_m": None, "breakaway": "estimate lost"}
    text = result_table(summary, WindowConfig())
    assert text.startswith("not docked")
    assert "never inside" in text
    assert "breakaway: estimate lost" in text
    assert "rejects: none" in text
