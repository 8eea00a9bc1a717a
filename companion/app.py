"""Composition root: from a configuration to a running service. Nothing else builds an adapter.

    camera ──ZmqCamera──▶                                          ┌─▶ MavlinkUdp ──▶ autopilot
    autopilot ──MavlinkUdp──▶ run_live ─▶ Service ─▶ Pipeline ─────┤
    tanker ──SerialDatalink──▶                                     └─▶ RunRecorder ──▶ run folder
"""

from __future__ import annotations

import math
import select
import signal
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from companion.config import ConfigError, Setup
from companion.io.camera import open_camera
from companion.io.clock import MonotonicClock
from companion.io.console import FlightConsole
from companion.io.datalink import SerialDatalink
from companion.io.mavlink import MavlinkUdp, OnBytes
from companion.io.recorder import RunRecorder, create_run_folder
from companion.messages import Output, Phase, PhaseChange, Reject, VisionModeChange
from companion.ports import Clock
from companion.rehearsal import rehearse_flight
from companion.runtime import Service, Watched, in_phase_s, run_live
from companion.vision.rehearsal import rehearse


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line adds to a configuration."""

    name: str = "run"
    run_dir: Path | None = None
    t0_ns: int | None = None
    stop_after_hold_s: float | None = None
    stop_after_breakaway_s: float | None = None
    stop_with_parent: bool = False


def warm_up(setup: Setup) -> None:
    """Compile what numba compiles and load what loads late, before the first picture counts.

    Raises ConfigError for a configuration that no pipeline can be built of.
    """
    rehearse_flight(setup)
    rehearse(setup.camera, setup.tanker, setup.config.vision)


def enough(seconds: float | None) -> float:
    """Return a time to wait for; for ever when none is given."""
    return math.inf if seconds is None else seconds


class Stop:
    """Set by Ctrl-C and SIGTERM; ``with_parent``: and when standard input, a pipe that nobody writes to, is closed."""

    def __init__(self, *, with_parent: bool = False) -> None:
        self._asked = False
        self._with_parent = with_parent
        signal.signal(signal.SIGINT, self._ask)
        signal.signal(signal.SIGTERM, self._ask)

    @property
    def asked(self) -> bool:
        """Return whether it is time to stop."""
        if self._with_parent and select.select([sys.stdin], [], [], 0.0)[0]:
            self._asked = True
        return self._asked

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self._asked = True


def open_links(setup: Setup, clock: Clock, on_bytes: OnBytes, stack: ExitStack) -> tuple[MavlinkUdp, list[Watched]]:
    """Open every link of the configuration; raises ConfigError. Return the autopilot and all sources."""
    links = setup.config.links
    autopilot = MavlinkUdp(links, clock, on_bytes)
    stack.callback(autopilot.close)
    sources = [Watched(autopilot, clock, "mavlink", links.mavlink,
                       "is the autopilot (or sim-bridge serve) running, and does it send there?")]
    if links.datalink:
        datalink = SerialDatalink(
            links.datalink, clock, links.origin_altitude_m, autopilot.offset_ns, autopilot.uncertain_ns
        )
        stack.callback(datalink.close)
        sources.append(Watched(datalink, clock, "datalink", links.datalink,
                               "does the tanker (or sim-bridge serve) send, and at this rate?"))
    if links.camera:
        camera = open_camera(links.camera, setup.camera, clock, autopilot.offset_ns)
        stack.callback(camera.close)
        sources.append(Watched(camera, clock, "camera", links.camera, "is the camera (or sim-bridge serve) running?"))
    return autopilot, sources


def open_folder(setup: Setup, options: RunOptions) -> Path:
    """Return the run folder, made; raises ConfigError."""
    folder = options.run_dir or create_run_folder(setup.config.recorder.out, options.name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{folder}: cannot be created ({error.strerror}); give a writable folder"
        raise ConfigError(msg) from None
    return folder


def run(setup: Setup, options: RunOptions) -> int:
    """Run the service until it is stopped; raises ConfigError before it starts. Returns the exit code."""
    clock = MonotonicClock()
    t0_ns = clock.now_ns() if options.t0_ns is None else options.t0_ns
    stop = Stop(with_parent=options.stop_with_parent)
    with ExitStack() as stack:

        def on_bytes(t_ns: int, data: bytes) -> None:
            recorder.mavlink(t_ns, data)  # nothing flows before the loop runs

        # Links first: one that cannot be had leaves no empty recording behind.
        autopilot, sources = open_links(setup, clock, on_bytes, stack)
        warm_up(setup)
        recorder = stack.enter_context(RunRecorder(open_folder(setup, options), setup, t0_ns=t0_ns))
        console = stack.enter_context(FlightConsole(setup, t0_ns=t0_ns))

        def watch(output: Output) -> None:
            console.output(output)
            if isinstance(output, PhaseChange):
                autopilot.say(f"phase {output.new}: {output.reason}")
            elif isinstance(output, VisionModeChange):
                autopilot.say(f"vision {output.mode}")
            elif isinstance(output, Reject) and output.source in ("operator", "self_test"):
                autopilot.say(f"{output.reason}: {output.detail}")
                console.notice(f"{output.source}: {output.reason}, {output.detail}")
            elif isinstance(output, Reject) and output.reason == "silent":
                console.notice(f"{output.source}: {output.detail}")

        service = Service(setup, clock, autopilot, recorder, watch)

        def done() -> bool:
            now_ns = clock.now_ns()
            return (
                stop.asked
                or in_phase_s(service, Phase.HOLD, now_ns) >= enough(options.stop_after_hold_s)
                or in_phase_s(service, Phase.BREAKAWAY, now_ns) >= enough(options.stop_after_breakaway_s)
            )

        if options.run_dir is None:
            console.notice(f"recording to {recorder.folder}")
        slips = run_live(service, sources, clock, setup.config.guidance.rate_hz, done)
        recorder.write_summary({"deadline_slips": slips, "phase": str(service.phase)})
    return 0
