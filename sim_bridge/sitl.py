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
from pathlib import Path
from typing import Any

import msgspec

from companion.command_line import flight_arguments
from companion.config import ConfigError, Setup
from companion.io.recorder import create_run_folder, read_records
from companion.messages import NS, Phase, PhaseChange
from sim_bridge.flight import BREAKAWAY_WATCH_S, Flown
from sim_bridge.scenario import Scenario
from sim_bridge.scene.operator_view import operator_view
from sim_bridge.scoring import Safety, score
from sim_bridge.serve import Served, serve
from sim_bridge.simulation import BoxTruth, nominal_heading_rad
from sim_bridge.truth import Truth
from sim_bridge.truth_log import TruthLog

START_S = 120.0
"""How long a companion may take to answer: imports, and compiling on its first run."""
STOP_S = 15.0
BAD_INPUT = 2


def companion_command(scenario: Scenario, setup: Setup, folder: Path, t0_ns: int) -> list[str]:
    """Return the command line of the companion's process."""
    links = setup.config.links
    return [
        sys.executable, "-m", "companion", "run", scenario.companion, "--run-dir", str(folder), "--t0-ns", str(t0_ns),
        "--mavlink", links.mavlink, "--datalink", links.datalink, "--camera", links.camera,
        *flight_arguments(setup.config), "--stop-after-hold", str(scenario.hold_s),
        "--stop-after-breakaway", str(BREAKAWAY_WATCH_S), "--stop-with-parent",
    ]  # fmt: skip


class CompanionProcess:
    """The companion as a child: started when the wires are up, asked to stop at the end (``asked``).

    Its standard input is a pipe that closes when this process ends, however it does (``--stop-with-parent``).
    """

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self.asked = False

    def start(self) -> None:
        """Start the child."""
        self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE)

    @property
    def code(self) -> int | None:
        """Return the exit code, None while it runs or before it has been started."""
        return None if self._process is None else self._process.poll()

    def stop(self) -> None:
        """Ask the child to stop, and make it stop when it does not."""
        if self._process is None:
            return
        with self._process as process:  # closes the pipe, and waits
            if process.poll() is not None:
                return
            self.asked = True
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


def fly_sitl(scenario: Scenario, setup: Setup, stick_url: str | None = None) -> Flown:
    """Fly a scenario on the wall clock with a companion process of its own.

    Raises ConfigError when a wire is not free, and when the companion did not start or ended as it should not; then
    what has been recorded stays. Ctrl-C ends the flight as time-up does, and the summary says so.
    """
    flight = _SitlFlight(scenario, setup)
    try:
        served = serve(scenario, setup, flight.stop, flight.see, flight.ready, flight.heard, stick_url)
    finally:
        flight.close()
    folder, truth_log = flight.recording
    if not served.interrupted:
        flight.check()
    phases = recorded_phases(folder)
    result = score(truth_log.series(), phases, setup.tanker.window, scenario)
    result |= flight.safety.result(phases, served.fault_ns)
    return Flown(folder, _write_summary(folder, scenario, served, result))


class _SitlFlight:
    """What lives beside the serving: the run folder with the truth, the companion's process, when to stop."""

    def __init__(self, scenario: Scenario, setup: Setup) -> None:
        self._scenario, self._setup = scenario, setup
        self._box = BoxTruth(setup, nominal_heading_rad(scenario))
        self.safety = Safety(setup.tanker.window)
        self._companion: CompanionProcess | None = None
        self._recording: tuple[Path, TruthLog] | None = None
        self._started_s = 0.0
        self._heard = False
        self._flown_s = 0.0

    @property
    def recording(self) -> tuple[Path, TruthLog]:
        """Return run folder and truth, which are there once the wires are up."""
        assert self._recording is not None
        return self._recording

    def ready(self) -> None:
        """Make the run folder and start the companion: the wires are up."""
        t0_ns = time.monotonic_ns()
        folder = create_run_folder(self._setup.config.recorder.out, self._scenario.name)
        view = operator_view(self._scenario.picture, self._scenario.seed)
        self._recording = folder, TruthLog(folder, self._setup, t0_ns=t0_ns, operator=view)
        self._companion = CompanionProcess(companion_command(self._scenario, self._setup, folder, t0_ns))
        self._companion.start()
        self._started_s = time.monotonic()

    def heard(self) -> None:
        """Note that the companion has answered."""
        self._heard = True

    def see(self, truth: Truth) -> None:
        """Record the truth on the companion's clock."""
        self._flown_s = truth.t_ns * NS
        stamped, p_mrf_br_m = msgspec.structs.replace(truth, t_ns=time.monotonic_ns()), self._box.p_mrf_br_m(truth)
        self.recording[1].append(stamped, p_mrf_br_m)
        self.safety.see(stamped, p_mrf_br_m)

    def stop(self) -> bool:
        """Tell whether the companion has ended, or time is up: simulated time, or that to start in."""
        assert self._companion is not None
        if self._companion.code is not None:
            return True
        if self._heard:
            return self._flown_s >= self._scenario.timeout_s
        return time.monotonic() - self._started_s > START_S

    def close(self) -> None:
        """Stop the companion and close the truth."""
        if self._companion is not None:
            self._companion.stop()
        if self._recording is not None:
            self._recording[1].close()

    def check(self) -> None:
        """Raise ConfigError when the companion did not start, did not answer or did not end by itself or by us."""
        assert self._companion is not None
        code, asked = self._companion.code, self._companion.asked
        if code == BAD_INPUT:
            msg = "the companion did not start; its message is above"
        elif code not in ((0, -signal.SIGTERM) if asked else (0,)):
            msg = f"the companion ended with code {code}; its message is above"
        elif asked and not self._heard:
            msg = f"the companion has not answered within {START_S:.0f} s; is {self._setup.config.links.mavlink} right?"
        else:
            return
        raise ConfigError(msg)


def recorded_phases(folder: Path) -> list[PhaseChange]:
    """Return the phase changes of a recording; none when the companion ended before it recorded."""
    path = folder / "events.jsonl"
    return [
        PhaseChange(r["t_ns"], Phase(r["old"]), Phase(r["new"]), r["reason"])
        for r in (read_records(path) if path.is_file() else ())
        if r["kind"] == "PhaseChange"
    ]


def _write_summary(folder: Path, scenario: Scenario, served: Served, result: dict[str, Any]) -> dict[str, Any]:
    """Add truth and scenario to the summary that the companion has written."""
    path = folder / "summary.json"
    own = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    summary = {
        **own, **result, **served.refuelling, "faults": [str(fault) for fault in scenario.faults],
        "seed": scenario.seed, "scenario": scenario.name,
        "late_steps": served.late_steps, "flown_s": served.flown_s, "plant_failure": served.plant_failure,
        "interrupted": served.interrupted,
    }
    path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary
