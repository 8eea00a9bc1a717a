"""Composition root: from a configuration to a running service. Nothing else builds an adapter.

    camera ──ZmqCamera──▶                                          ┌─▶ MavlinkUdp ──▶ autopilot
    autopilot ──MavlinkUdp──▶ run_live ─▶ Service ─▶ Pipeline ─────┤
    tanker ──SerialDatalink──▶                                     └─▶ RunRecorder ──▶ run folder
"""

from __future__ import annotations

import signal
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from companion.config import Setup
from companion.geometry import SE3
from companion.io.camera import open_camera
from companion.io.clock import MonotonicClock
from companion.io.console import FlightConsole
from companion.io.datalink import SerialDatalink
from companion.io.mavlink import MavlinkUdp
from companion.io.recorder import RunRecorder, create_run_folder
from companion.messages import CameraFrame, Output, PhaseChange
from companion.ports import EventSource
from companion.runtime import Service, held_for_s, run_live
from companion.vision.chain import VisionChain


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line adds to a configuration."""

    name: str = "run"
    run_dir: Path | None = None
    stop_after_hold_s: float | None = None


def warm_up(setup: Setup) -> None:
    """Compile what numba compiles, before the first picture counts."""
    chain = VisionChain(setup.camera, setup.tanker, setup.config.vision)
    image = np.zeros((setup.camera.height_px, setup.camera.width_px, 3), dtype=np.uint8)
    ahead = SE3(np.eye(3), np.array([0.0, 0.0, 40.0]))
    chain.process(CameraFrame(0, 0, image), ahead)
    chain.process(CameraFrame(0, 0, image), SE3(np.eye(3), np.array([0.0, 0.0, 30.0])))


class Stop:
    """Set by Ctrl-C, by SIGTERM or when the hold has lasted long enough."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGINT, self._ask)
        signal.signal(signal.SIGTERM, self._ask)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True


def run(setup: Setup, options: RunOptions) -> int:
    """Run the service until it is stopped; raises ConfigError before it starts. Returns the exit code."""
    links = setup.config.links
    clock = MonotonicClock()
    stop = Stop()
    warm_up(setup)
    with ExitStack() as stack:
        folder = options.run_dir or create_run_folder(setup.config.recorder.out, options.name)
        folder.mkdir(parents=True, exist_ok=True)
        recorder = stack.enter_context(RunRecorder(folder, setup, t0_ns=clock.now_ns()))
        autopilot = MavlinkUdp(links, clock, recorder.mavlink)
        stack.callback(autopilot.close)
        sources: list[EventSource] = [autopilot]
        if links.datalink:
            sources.append(SerialDatalink(links.datalink, clock, links.origin_altitude_m, autopilot.offset_ns))
        if links.camera:
            sources.append(open_camera(links.camera, setup.camera, clock, autopilot.offset_ns))
        for source in sources[1:]:
            stack.callback(source.close)
        console = stack.enter_context(FlightConsole(setup))

        def watch(output: Output) -> None:
            console.output(output)
            if isinstance(output, PhaseChange):
                autopilot.say(f"phase {output.new}: {output.reason}")

        service = Service(setup, clock, autopilot, recorder, watch)

        def done() -> bool:
            enough = options.stop_after_hold_s
            return stop.asked or (enough is not None and held_for_s(service, clock.now_ns()) >= enough)

        slips = run_live(service, sources, clock, setup.config.guidance.rate_hz, done)
        recorder.write_summary({"deadline_slips": slips, "phase": str(service.phase)})
    return 0
