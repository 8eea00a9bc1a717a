"""Faults of the companion itself, in lockstep: swapped labels, a wrong map or mount in its files, its process killed.

What has to happen is in each docstring. The simulator's own faults are in ``test_fault_matrix``.
"""

import contextlib
import json
import signal
import socket
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w

from companion.app import warm_up
from companion.io.recorder import read_records
from companion.messages import NS, AttitudeSetpoint, Phase, PhaseChange
from companion.vision.labeler import Labelled
from sim_bridge.fault_cells import BREAKAWAY, FARTHER_M, HELD, UNSEEN, Cell
from sim_bridge.fault_matrix import fly_cell, matrix_flight
from sim_bridge.flight import Ending, LockstepCompanion, Unrecorded, run
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import Safety
from sim_bridge.serve import serve
from sim_bridge.simulation import BoxTruth, Simulation, nominal_heading_rad

SEED = 411
NOTHING = Cell("nothing", (), HELD, "")
CLEAN = Cell("clean", ("heartbeat.stuck@hold+1",), HELD, "a fault that changes nothing: it starts the watch's clock")


def companion_with(setup_of):
    """Return a builder of companions whose setup is not the simulator's."""
    return lambda setup, *rest: LockstepCompanion(setup_of(setup), *rest)


def test_labels_of_two_markers_swapped():
    """From 1 s into the hold every frame calls marker 1 two and 2 one: no pose holds, breakaway within 0.5 s."""
    cell = Cell("label-swap", CLEAN.faults, BREAKAWAY, "swapped labels explain no pose", UNSEEN)

    def build(setup, *rest):
        companion = LockstepCompanion(setup, *rest)
        labeler = companion.service.pipeline.vision._labeler
        honest = labeler.label

        def swapped(*args, **more):
            found = honest(*args, **more)
            if not isinstance(found, Labelled) or not since_hold(companion) >= 1.0:
                return found
            labels = found.labels.copy()
            labels[[0, 1]] = labels[[1, 0]]
            return replace(found, labels=labels)

        labeler.label = swapped
        return companion

    flight = fly_cell(cell, SEED, build)
    assert flight.safe
    assert flight.as_it_has_to, flight.phases
    assert flight.in_time, flight.safety


def since_hold(companion):
    """Return for how long the companion has been past the capture, s; below 0 before."""
    service = companion.service
    held = service.phase in (Phase.HOLD, Phase.BREAKAWAY)
    return (companion.clock.now_ns() - service.phase_since_ns) * NS if held else -1.0


@pytest.mark.parametrize("fusion", ["filter", "blend"])
def test_a_mount_that_is_wrong_in_the_companions_file(fusion):
    """One degree between file and aircraft: seen in the observation, before anybody is cleared to close in."""
    def turned(setup):
        config, camera = setup.config, setup.camera
        camera = msgspec.structs.replace(camera, mount_pitch_rad=camera.mount_pitch_rad + np.radians(1.0))
        method = msgspec.structs.replace(config.fusion, method=fusion)
        return msgspec.structs.replace(setup, camera=camera, config=msgspec.structs.replace(config, fusion=method))

    flight = fly_cell(FROM_THE_START, SEED, companion_with(turned))
    assert flight.safe
    assert [c.new for c in flight.phases] == [Phase.JOIN, Phase.OBSERVATION]


def test_a_marker_that_is_wrong_in_the_companions_map():
    """A metre off in the map: it is left out, and the other eight dock; nothing is ever off by more than the window."""
    def moved(setup):
        markers = list(setup.tanker.markers)
        x, y, z = markers[2].p_tanker_m
        markers[2] = msgspec.structs.replace(markers[2], p_tanker_m=(x, y - 1.0, z))
        return msgspec.structs.replace(setup, tanker=msgspec.structs.replace(setup.tanker, markers=tuple(markers)))

    flight = fly_cell(replace(CLEAN, watch_s=4.0), SEED, companion_with(moved))
    assert flight.safe
    assert flight.ended in HELD, flight.phases


FROM_THE_START = Cell("from-the-start", ("heartbeat.stuck@0",), (), "a fault that changes nothing", watch_s=15.0,
                      start_tanker_m=FARTHER_M)


def test_the_companion_is_killed_in_the_hold_and_starts_again_after_two_seconds():
    """Half a second after the last setpoint the autopilot holds by itself; the new companion begins in standby, tests
    that the autopilot follows before it joins, and never brings the receiver where it may not be.
    """
    scenario, setup = matrix_flight(NOTHING, SEED)
    again = with_guidance(setup, self_test=True)
    warm_up(setup)
    simulation, safety = Simulation(scenario, setup), Safety(setup.tanker.window)
    box = BoxTruth(setup, nominal_heading_rad(scenario))
    first, second, following = [], [], []

    def see(truth):
        safety.see(truth, box.p_mrf_br_m(truth))
        following.append((truth.t_ns, simulation.autopilot.vehicle.following))

    companion = LockstepCompanion(setup, Unrecorded(), first.append)
    assert run(simulation, companion, Ending(2.0, 90.0), see) is None
    assert companion.service.phase is Phase.HOLD
    killed_ns = simulation.truth.t_ns
    for step in range(400):
        simulation.step()
        if step % 4 == 0:
            see(simulation.truth)
    restarted_ns = simulation.truth.t_ns
    companion = LockstepCompanion(again, Unrecorded(), second.append)
    assert run(simulation, companion, Ending(2.0, restarted_ns * NS + 40.0), see) is None

    assert not any(f for t, f in following if killed_ns + 0.55 / NS < t < restarted_ns)
    changes = [o for o in second if isinstance(o, PhaseChange)]
    assert [c.new for c in changes][:2] == [Phase.SELF_TEST, Phase.JOIN]
    setpoints = [o for o in second if isinstance(o, AttitudeSetpoint)]
    assert setpoints[0].t_ns >= changes[0].t_ns
    phases = [o for o in first if isinstance(o, PhaseChange)]
    told = safety.result([*phases, PhaseChange(killed_ns, Phase.HOLD, Phase.STANDBY, "killed"), *changes])
    assert not told["collision"]
    assert told["outside_limit_m"] == 0.0
    assert companion.service.phase in (Phase.HOLD, Phase.CONTACT, Phase.BREAKAWAY), changes


class KilledInTheHold:
    """The companion as a process: killed 2 s into its hold, started again 2 s later, watched until it holds again."""

    def __init__(self, config, scenario, setup, folder):
        self._command = [sys.executable, "-m", "companion", "run", str(config)]
        self._folders = [folder / "first", folder / "second"]
        self._process = None
        self._reached = {}
        self._read = [0, 0]
        self._next_s = 0.0
        self._end_s = time.monotonic() + 240.0
        self.phases = []
        self.safety, self._box = Safety(setup.tanker.window), BoxTruth(setup, nominal_heading_rad(scenario))
        self.t_ns = 0
        self.killed_ns = self._again_s = None

    def start(self, k):
        self._process = subprocess.Popen([*self._command, "--run-dir", str(self._folders[k])])

    def see(self, truth):
        self.t_ns = truth.t_ns
        self.safety.see(truth, self._box.p_mrf_br_m(truth))

    def stop(self):
        """Called at every step: look every fifth of a second at what the companion has recorded."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = now_s + 0.2
        self._look()
        k = 0 if self.killed_ns is None else 1
        held_s = now_s - self._reached.get((k, Phase.HOLD), now_s)
        away_s = now_s - self._reached.get((k, Phase.BREAKAWAY), now_s)
        if k == 0 and held_s > 2.0:
            self._process.kill()
            self._process.wait()
            self.killed_ns = self.t_ns
            self._change(Phase.STANDBY, "killed")
            self._again_s = now_s + 2.0
        elif k == 1 and self._again_s is not None and now_s > self._again_s:
            self._again_s = None
            self.start(1)
        return (k == 1 and max(held_s, away_s) > 3.0) or now_s > self._end_s

    def _look(self):
        k = 0 if self.killed_ns is None else 1
        events = self._folders[k] / "events.jsonl"
        if not events.is_file():
            return
        with events.open("rb") as file:
            file.seek(self._read[k])
            lines = file.read()
        whole = lines[: lines.rfind(b"\n") + 1]
        self._read[k] += len(whole)
        for line in whole.splitlines():
            record = json.loads(line) if b"PhaseChange" in line else {}
            if record.get("kind") == "PhaseChange":
                self._reached.setdefault((k, Phase(record["new"])), time.monotonic())
                self._change(Phase(record["new"]), record["reason"])

    def _change(self, new, reason):
        self.phases.append(PhaseChange(self.t_ns, self.phases[-1].new if self.phases else Phase.STANDBY, new, reason))

    def close(self):
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            self._process.wait(30.0)


def free_ports(n):
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, kind))
                   for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM)[:n]]
        for s in sockets:
            s.bind(("127.0.0.1", 0))
        return [s.getsockname()[1] for s in sockets]


@pytest.mark.slow
def test_the_process_of_the_companion_is_killed_in_the_hold_and_started_again(tmp_path):
    """Two processes on the wall clock: kill -9 in the hold. The simulator serves on, the autopilot holds by itself, and
    the companion that is started again begins with its self-test and is never where it may not be.
    """
    scenario, setup = matrix_flight(NOTHING, SEED)
    mavlink, camera = free_ports(2)
    links = msgspec.structs.replace(
        setup.config.links, mavlink=f"udpin:127.0.0.1:{mavlink}", camera=f"tcp://127.0.0.1:{camera}",
        datalink=f"{tmp_path / 'tanker'},19600",
    )
    guidance = msgspec.structs.replace(setup.config.guidance, self_test=True)
    config = msgspec.structs.replace(setup.config, links=links, guidance=guidance)
    setup = msgspec.structs.replace(setup, config=config)
    file = tmp_path / "companion.toml"
    file.write_text(written(config, scenario), encoding="utf-8")
    flight = KilledInTheHold(file, scenario, setup, tmp_path)
    try:
        served = serve(msgspec.structs.replace(scenario, vision_input="pictures"), setup, flight.stop, flight.see,
                       lambda: flight.start(0))
    finally:
        flight.close()
    assert served.plant_failure is None
    assert flight.killed_ns is not None, flight.phases
    after = [c.new for c in flight.phases if c.t_ns > flight.killed_ns]
    assert after[:2] == [Phase.SELF_TEST, Phase.JOIN], flight.phases
    assert after[-1] in (Phase.HOLD, Phase.BREAKAWAY), flight.phases
    told = flight.safety.result(flight.phases)
    assert not told["collision"]
    assert told["outside_limit_m"] == 0.0
    second = [r for r in read_records(tmp_path / "second" / "events.jsonl") if r["kind"] == "AttitudeSetpoint"]
    assert len(second) > 100
    assert np.isfinite([[r["roll_rad"], r["pitch_rad"], r["thrust"]] for r in second]).all()


def written(config, scenario: Scenario) -> str:
    """Return a companion's TOML with every value of ``config`` that is not the default of its field."""
    base = tomllib.loads(Path(scenario.companion).read_text(encoding="utf-8"))
    folder = Path(scenario.companion).parent
    for name in ("camera", "tanker", "airframe"):
        base[name] = str((folder / base[name]).resolve())
    changed = msgspec.to_builtins(config)
    base["links"], base["guidance"] = changed["links"], changed["guidance"]
    return tomli_w.dumps(base)


def with_guidance(setup, **changed):
    guidance = msgspec.structs.replace(setup.config.guidance, **changed)
    return msgspec.structs.replace(setup, config=msgspec.structs.replace(setup.config, guidance=guidance))
