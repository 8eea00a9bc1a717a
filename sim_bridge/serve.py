"""The simulation on the wall clock, behind real wires: MAVLink over UDP, the tanker on a pty, pictures on a socket.

The clock starts when a companion answers, so that it may take its time to start. A machine that is too slow stretches
simulated time rather than skipping steps; how often a step began late is counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.config import ConfigError, Setup
from companion.io.camera import ZmqFrameSender
from companion.io.mavlink import MavlinkCodec, dialect
from companion.io.transport import UdpTransport
from companion.messages import CameraFrame
from sim_bridge.datalink import PtyLink
from sim_bridge.plant.fdm import PlantError
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import refuelling
from sim_bridge.simulation import STEP_NS, TRUTH_EVERY, Simulation
from sim_bridge.stick import StickPort
from sim_bridge.truth import Truth

LATE_NS = 2 * STEP_NS
CALL_NS = 200_000_000
REHEARSED_STEPS = 44
"""0.22 s: pictures of both cameras, reports of the tanker, the autopilot's streams."""


@dataclass(frozen=True, slots=True)
class Served:
    """How the serving went: simulated seconds, steps that began late, what the plant failed of, whether by Ctrl-C.

    ``fault_ns``: when the first of the scenario's faults began, on the wall clock.
    """

    flown_s: float
    late_steps: int
    plant_failure: str | None = None
    interrupted: bool = False
    refuelling: dict[str, Any] = field(default_factory=dict)
    fault_ns: int | None = None


class PtyLine:
    """A ``PtyLink`` as the simulation's serial line: what is due goes out on the pty."""

    def __init__(self, pty: PtyLink) -> None:
        self._pty = pty

    def write(self, data: bytes, now_ns: int) -> bool:
        """Hand a frame to the line."""
        return self._pty.write(data, now_ns)

    def due(self, now_ns: int) -> bytes:
        """Let the due bytes out on the pty."""
        self._pty.pump(now_ns)
        return b""


def companion_end(url: str) -> str:
    """Return the URL that reaches a companion listening at ``url``."""
    kind, _, rest = url.partition(":")
    if kind != "udpin":
        msg = f"mavlink '{url}': the simulator calls a companion that listens; use udpin:HOST:PORT"
        raise ConfigError(msg)
    return f"udpout:{rest}"


def pty_link(datalink: str) -> Path:
    """Return where the companion looks for the tanker's line, its folder made; raises ConfigError."""
    link = Path(datalink.rpartition(",")[0])
    try:
        link.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"datalink {link}: its folder cannot be made ({error.strerror}); choose another with --datalink"
        raise ConfigError(msg) from None
    return link


def wait_for_companion(transport: UdpTransport, stop: Callable[[], bool]) -> bool:
    """Send heartbeats until anybody answers; False when ``stop`` came first."""
    codec = MavlinkCodec(1, 1)
    call_ns = 0
    while not stop():
        if transport.poll():
            return True
        now_ns = time.monotonic_ns()
        if now_ns >= call_ns:
            call_ns = now_ns + CALL_NS
            transport.send(codec.pack(dialect.MAVLink_heartbeat_message(
                dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_GENERIC, 0, 0, dialect.MAV_STATE_BOOT, 3)))
        time.sleep(0.01)
    return False


def rehearse(scenario: Scenario, setup: Setup) -> None:
    """Step a simulation that nobody sees: kernels that compile on their first call would hold up the clock."""
    simulation = Simulation(scenario, setup)
    for _ in range(REHEARSED_STEPS):
        simulation.step()


def serve(
    scenario: Scenario, setup: Setup, stop: Callable[[], bool], see: Callable[[Truth], None],
    ready: Callable[[], None], heard: Callable[[], None] = lambda: None, stick_url: str | None = None,
) -> Served:
    """Serve one flight until ``stop``; ``see`` takes the truth at 50 Hz.

    ``ready`` is called when all wires are up, ``heard`` when a companion has answered; Ctrl-C after ``ready`` ends the
    serving as ``stop`` does. ``stick_url``: where the boom operator's joystick comes in. Raises ConfigError when a wire
    is not free, or the scenario's camera gives no pictures.
    """
    if scenario.vision_input != "pictures":
        msg = (f'scenario {scenario.name}: vision_input = "{scenario.vision_input}" flies in lockstep only; '
               'use sim-bridge fly, or vision_input = "pictures"')
        raise ConfigError(msg)
    links = setup.config.links
    with ExitStack() as stack:
        transport = UdpTransport("mavlink", companion_end(links.mavlink))
        stack.callback(transport.close)
        camera = ZmqFrameSender(links.camera)
        stack.callback(camera.close)
        # The pty last: it would take its name from a simulator that runs, and that one's camera port is busy.
        pty = PtyLink(scenario.datalink.rate_baud, pty_link(links.datalink))
        stack.callback(pty.close)
        stick = None if stick_url is None else StickPort(stick_url)
        if stick is not None:
            stack.callback(stick.close)
        executor = stack.enter_context(ThreadPoolExecutor(1))
        rehearse(scenario, setup)
        simulation = Simulation(scenario, setup, PtyLine(pty), executor)
        ready()
        try:
            if not wait_for_companion(transport, stop):
                return Served(0.0, 0)
        except KeyboardInterrupt:
            return Served(0.0, 0, interrupted=True)
        heard()
        return _pace(simulation, Wires(transport, camera, stick), stop, see)


@dataclass(frozen=True, slots=True)
class Wires:
    """What is plugged in."""

    transport: UdpTransport
    camera: ZmqFrameSender
    stick: StickPort | None


def _pace(simulation: Simulation, wires: Wires, stop: Callable[[], bool], see: Callable[[Truth], None]) -> Served:
    next_ns = time.monotonic_ns()
    step = late = 0
    failure, interrupted, fault_ns = None, False, None
    try:
        while not stop():
            behind_ns = time.monotonic_ns() - next_ns
            if behind_ns < 0:
                time.sleep(-behind_ns * 1e-9)
            elif behind_ns > LATE_NS:
                late += 1
                next_ns += behind_ns - LATE_NS  # stretch: never a burst of steps to catch up
            next_ns += STEP_NS
            if step % TRUTH_EVERY == 0:
                see(simulation.truth)
            if fault_ns is None and has_begun(simulation):
                fault_ns = time.monotonic_ns()
            _exchange(simulation, wires)
            step += 1
    except PlantError as error:
        failure = str(error)
    except KeyboardInterrupt:
        interrupted = True
    return Served(step * STEP_NS * 1e-9, late, failure, interrupted, refuelling(simulation.world.boom), fault_ns)


def has_begun(simulation: Simulation) -> bool:
    """Tell whether a fault of the scenario has begun."""
    began_ns = simulation.fault_began_ns
    return began_ns is not None and simulation.truth.t_ns >= began_ns


def _exchange(simulation: Simulation, wires: Wires) -> None:
    """Answer what has come since the last step, run one step, send what it brings."""
    transport = wires.transport
    for data, _ in transport.poll():
        transport.send(simulation.feed_mavlink(data, simulation.truth.t_ns))
    if wires.stick is not None:
        simulation.world.boom.stick(*wires.stick.poll(time.monotonic_ns()))
    arrivals = simulation.step()
    transport.send(arrivals.mavlink)
    for frame in arrivals.frames:
        if isinstance(frame, CameraFrame):
            wires.camera.send(frame)
