"""Simulator and companion as two processes on the wall clock: what ``make sitl`` flies.

Both processes are on one machine and so on one monotonic clock: truth is stamped with it, which puts it beside the
companion's estimates without any clock offset.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from companion.config import ConfigError, Setup
from companion.io.recorder import create_run_folder, read_records
from companion.messages import Phase, PhaseChange
from sim_bridge.flight import BREAKAWAY_WATCH_S, Flown
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import score
from sim_bridge.serve import Served, serve
from sim_bridge.simulation import BoxTruth
from sim_bridge.truth import Truth
from sim_bridge.truth_log import TruthLog

STOP_S = 15.0
BAD_INPUT = 2


def companion_command(scenario: Scenario, setup: Setup, folder: Path, t0_ns: int) -> list[str]:
    """Return the command line of the companion's process."""
    links, config = setup.config.links, setup.config
    return [
        sys.executable, "-m", "companion", "run", scenario.companion, "--run-dir", str(folder), "--t0-ns", str(t0_ns),
        "--mavlink", links.mavlink, "--datalink", links.datalink, "--camera", links.camera,
        "--pose", config.vision.solver, "--stop-after-hold", str(scenario.hold_s),
        "--stop-after-breakaway", str(BREAKAWAY_WATCH_S),
    ]  # fmt: skip


class CompanionProcess:
    """The companion as a child: started when the wires are up, asked to stop at the end."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the child."""
        self._process = subprocess.Popen(self._command)

    @property
    def code(self) -> int | None:
        """Return the exit code, None while it runs or before it has been started."""
        return None if self._process is None else self._process.poll()

    def stop(self) -> None:
        """Ask the child to stop, and make it stop when it does not."""
        if self._process is None or self._process.poll() is not None:
            return
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def fly_sitl(scenario: Scenario, setup: Setup) -> Flown:
    """Fly a scenario on the wall clock with a companion process of its own; raises ConfigError before the flight."""
    t0_ns = time.monotonic_ns()
    folder = create_run_folder(setup.config.recorder.out, scenario.name)
    box = BoxTruth(setup, scenario.heading_rad)
    with TruthLog(folder, setup, t0_ns=t0_ns) as truth_log:

        def see(truth: Truth) -> None:
            truth_log.append(replace(truth, t_ns=time.monotonic_ns()), box.p_mrf_br_m(truth))

        served = _fly_beside(scenario, setup, companion_command(scenario, setup, folder, t0_ns), see)
        result = score(truth_log.series(), recorded_phases(folder), setup.tanker.window, scenario)
    return Flown(folder, _write_summary(folder, scenario, served, result))


def _fly_beside(scenario: Scenario, setup: Setup, command: list[str], see: Callable[[Truth], None]) -> Served:
    """Serve until the companion has ended or time is up; raises ConfigError when the companion could not start."""
    companion = CompanionProcess(command)
    started = time.monotonic()

    def stop() -> bool:
        return companion.code is not None or time.monotonic() - started > scenario.timeout_s

    try:
        served = serve(scenario, setup, stop, see, companion.start)
    finally:
        companion.stop()
    if companion.code == BAD_INPUT:
        msg = "the companion did not start; its message is above"
        raise ConfigError(msg)
    return served


def recorded_phases(folder: Path) -> list[PhaseChange]:
    """Return the phase changes of a recording."""
    return [
        PhaseChange(r["t_ns"], Phase(r["old"]), Phase(r["new"]), r["reason"])
        for r in read_records(folder / "events.jsonl")
        if r["kind"] == "PhaseChange"
    ]


def _write_summary(folder: Path, scenario: Scenario, served: Served, result: dict[str, Any]) -> dict[str, Any]:
    """Add truth and scenario to the summary that the companion has written."""
    path = folder / "summary.json"
    own = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    summary = {
        **own, **result, "seed": scenario.seed, "scenario": scenario.name, "late_steps": served.late_steps,
        "plant_failure": served.plant_failure,
    }
    path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary
