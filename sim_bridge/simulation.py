"""The world outside the companion, stepped in simulated time: the same for lockstep and for the wall clock.

One step is 5 ms. At its instant t: sensors and autopilot see the truth of t, the camera exposes if it is due, the
tanker reports if it is due; then the plant moves on to t + 5 ms. What would be on the wires comes back as bytes and
pictures, at the instant at which it would arrive.
"""

from __future__ import annotations

import math
from collections import deque
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.config import Setup
from companion.geometry import Mat, Vec, rotation_from_euler
from companion.io.datalink import encode_frame
from companion.messages import CameraFrame, Command, MarkerFrame, Phase, TankerState
from sim_bridge.autopilot import StandInAutopilot, TankerReporter
from sim_bridge.datalink import SerialPacer
from sim_bridge.fault_injection import Faults
from sim_bridge.marker_sensor import MarkerCamera
from sim_bridge.operator import ScheduledOperator
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.world import World
from sim_bridge.scenario import Scenario
from sim_bridge.scene.camera_picture import CLEAR_DAY, CameraPicture
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.sensor_conditions import GpsErrors
from sim_bridge.sensor_errors import GpsBias
from sim_bridge.truth import Truth

STEP_NS = 5_000_000
TRUTH_EVERY = 4  # steps: 50 Hz
RADIO = (Command.BREAKAWAY, Command.DISCONNECT)
"""What the receiver's operator says on the radio too, so that the boom lets go."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What reaches the companion at ``t_ns``: bytes of both links, pictures or detections."""

    t_ns: int
    mavlink: bytes
    datalink: bytes
    frames: list[CameraFrame] | list[MarkerFrame]


class SerialLine(Protocol):
    """The tanker's serial line: a ``SerialPacer`` in lockstep, a pty on the wall clock."""

    def write(self, data: bytes, now_ns: int) -> bool:
        """Hand a frame to the line."""

    def due(self, now_ns: int) -> bytes:
        """Return the bytes that have come out at the other end; nothing when they went out by another way."""


class Camera:
    """Exposes at its rate, delivers after its latency.

    Pictures are drawn beside the simulation. With an ``executor`` one that is not ready in time is delivered late;
    without one the simulation waits for it, so that what arrives when does not depend on the machine.
    """

    def __init__(self, setup: Setup, rng: np.random.Generator, executor: Executor | None = None,
                 conditions: PictureConditions = CLEAR_DAY) -> None:
        camera = setup.camera
        self._picture = CameraPicture(camera, setup.tanker, rng, conditions=conditions)
        self._period_ns = round(1e9 / camera.rate_hz)
        self._latency_ns = round(camera.latency_s * 1e9)
        self._next_ns = 0
        self._sequence = 0
        self._executor, self._waits = executor or ThreadPoolExecutor(1), executor is None
        self._under_way: deque[tuple[int, int, Future[NDArray[np.uint8]]]] = deque()

    def expose(self, truth: Truth, lights: Mat | None = None) -> None:
        """Take a picture if one is due; ``lights`` (n, 3), tanker axes: where they are when not where they belong."""
        if truth.t_ns < self._next_ns:
            return
        self._next_ns += self._period_ns
        picture = self._executor.submit(self._picture.expose, truth.tanker, truth.uav, truth.boom, lights)
        self._under_way.append((truth.t_ns, self._sequence, picture))
        self._sequence += 1

    def delivered(self, t_ns: int) -> list[CameraFrame]:
        """Return the pictures that have arrived by ``t_ns``, in the order of their exposure."""
        frames = []
        while self._under_way:
            exposed_ns, sequence, picture = self._under_way[0]
            if exposed_ns + self._latency_ns > t_ns or not (self._waits or picture.done()):
                break
            self._under_way.popleft()
            frames.append(CameraFrame(exposed_ns, sequence, picture.result()))
        return frames


class Simulation:
    """Aircraft, weather, sensors, camera, autopilot and datalink of one scenario."""

    def __init__(
        self, scenario: Scenario, setup: Setup, serial: SerialLine | None = None, executor: Executor | None = None
    ) -> None:
        """Put everything at its start; ``serial`` and ``executor`` are what the wall clock needs (see ``serve``)."""
        # One stream of chance for each thing that draws, so that a change in one leaves the others as they were.
        *seeds, fault_seeds = np.random.SeedSequence(scenario.seed).spawn(6)
        gust, own, tanker, camera, satellites = (np.random.default_rng(s) for s in seeds)
        self._faults = Faults(scenario.faults, setup, fault_seeds)
        self.world = World(
            setup.tanker, setup.airframe, np.array(scenario.start_tanker_m), scenario.turbulence, scenario.wake, gust,
            scenario.heading_rad, conditions=scenario.plant,
        )
        sensors = scenario.sensors
        common = GpsBias(sensors.common_gps, satellites) if sensors.common_gps != GpsErrors() else None
        self.autopilot = StandInAutopilot(setup.airframe, own, sensors=sensors.receiver, common_gps=common,
                                        gps_fault=self._faults.fix)
        self._reporter = TankerReporter(tanker, scenario.datalink.report_rate_hz, sensors.tanker, common)
        self._origin_altitude_m = setup.config.links.origin_altitude_m
        self._serial: SerialLine = serial or SerialPacer(scenario.datalink.rate_baud)
        self._camera = (
            Camera(setup, camera, executor, scenario.picture) if scenario.vision_input == "pictures"
            else MarkerCamera(setup, camera, scenario.sensors.markers)
        )
        self._operator = ScheduledOperator(setup.config.links, scenario.commands)

    @property
    def truth(self) -> Truth:
        """Return the truth of the present instant."""
        return self.world.truth

    @property
    def fault_began_ns(self) -> int | None:
        """Return when the first of the scenario's faults begins, once that is known; None without any."""
        return self._faults.began_ns

    @property
    def faults_touched(self) -> tuple[int, ...]:
        """Return how much each of the scenario's faults has changed so far; nought for one that has not arrived."""
        return self._faults.touched

    def phase_entered(self, phase: Phase, t_ns: int) -> None:
        """Take note of the companion's phase, which faults begin with; over wires it is read from its STATUSTEXT."""
        self._faults.phase_entered(phase, t_ns)

    def feed_mavlink(self, data: bytes, t_ns: int) -> bytes:
        """Give the autopilot bytes that reach it at ``t_ns``; return what it answers at once."""
        if not data:
            return b""
        self._faults.overhear(data, t_ns)
        self.autopilot.feed(data, t_ns)
        return self._faults.mavlink(self.autopilot.outgoing(t_ns), t_ns)

    def step(self) -> Arrivals:
        """Run one step; return what arrives at the companion at its instant."""
        truth = self.truth
        t_ns = truth.t_ns
        effectors = self.autopilot.step(truth.uav)
        state = self._reporter.step(truth.tanker)
        for frame in self._faults.datalink(None if state is None else self._report(state), t_ns):
            self._serial.write(frame, t_ns)
        self._camera.expose(self._seen_from(truth), self._faults.lights(t_ns))
        mavlink = self._faults.mavlink(self.autopilot.outgoing(t_ns), t_ns)
        for command in self._operator.due(t_ns):
            mavlink += self._operator.frame(command)
            if command in RADIO:  # the boom's operator hears it
                self.world.boom.disconnect(f"{command} called")
        frames = self._faults.frames(self._camera.delivered(t_ns), t_ns)
        arrivals = Arrivals(t_ns, mavlink, self._serial.due(t_ns), frames)
        self.world.step(effectors)
        return arrivals

    def _seen_from(self, truth: Truth) -> Truth:
        """Return the truth as the camera has it, which may have turned on its mount."""
        uav = self._faults.camera_body(truth.uav)
        return truth if uav is truth.uav else msgspec.structs.replace(truth, uav=uav)

    def _report(self, state: TankerState) -> bytes:
        """Return the frame of the tanker's report; a tanker that no frame can tell of any more is a failed plant."""
        try:
            return encode_frame(state, self._origin_altitude_m)
        except ValueError as error:
            raise PlantError(str(error)) from None


class BoxTruth:
    """True BR, the receptacle against the box, in the psi frame: what flights are scored on.

    Behind a tanker that turns (``heading_rad`` None) the psi frame has the tanker's course.
    """

    def __init__(self, setup: Setup, heading_rad: float | None) -> None:
        self._box_tanker_m = np.array(setup.tanker.box_tanker_m)
        self._receptacle_frd_m = np.array(setup.airframe.receptacle_frd_m)
        self._R_mrf_ned = None if heading_rad is None else rotation_from_euler(heading_rad, 0.0, 0.0).T

    def p_mrf_br_m(self, truth: Truth) -> Vec:
        """Return BR (3,) at the instant of ``truth``."""
        receptacle = truth.uav.T_ned_body().transform(self._receptacle_frd_m)
        box = truth.tanker.T_ned_body().transform(self._box_tanker_m)
        return self._psi_frame(truth) @ (receptacle - box)

    def _psi_frame(self, truth: Truth) -> Mat:
        if self._R_mrf_ned is not None:
            return self._R_mrf_ned
        course = math.atan2(truth.tanker.v_ned_m_s[1], truth.tanker.v_ned_m_s[0])
        return rotation_from_euler(course, 0.0, 0.0).T


def nominal_heading_rad(scenario: Scenario) -> float | None:
    """Return the heading of the formation, None behind a tanker that turns."""
    return scenario.heading_rad if scenario.plant.course.kind == "straight" else None
