"""The core on one page: events in, outputs out; no input, output or clock.

``handle`` takes one event and returns what follows from it, in order. Live service and lockstep simulation call
the same method with the same events. ``mark`` is told the name of each stage as it ends; a driver that owns a clock
turns that into latencies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, Setup, landmarks
from companion.estimation.aircraft import Aircraft
from companion.estimation.blend import Blend
from companion.estimation.filter import RelativeFilter
from companion.estimation.fusion import Fusion
from companion.estimation.integrity import IntegrityMonitor
from companion.estimation.integrity_markers import Eye
from companion.estimation.relative import RelativeEstimator
from companion.geometry import Mat
from companion.guidance.approach import Approach
from companion.health import HealthMonitor
from companion.messages import (
    AutopilotStatus,
    CameraFrame,
    Command,
    Event,
    GpsStatus,
    MarkerFrame,
    OperatorCommand,
    Output,
    OwnAttitude,
    OwnPosition,
    Phase,
    Reject,
    TankerState,
    Tick,
    TimeStep,
    VisionMode,
    VisionModeChange,
)
from companion.vision.camera import T_frd_cam, pixels_to_normalised, project
from companion.vision.chain import VisionChain

VISION_MODES = {Command.REAL_VISION: VisionMode.REAL, Command.SIMULATED_VISION: VisionMode.SIMULATED}


def unmarked(stage: str) -> None:
    """Ignore the end of a stage: for drivers that do not measure."""


def fusion_of(setup: Setup, aircraft: Aircraft, markers: Mat) -> Fusion:
    """Return the fusion that the configuration asks for; ``markers`` (n, 3) in the order of the labels."""
    config, camera = setup.config, setup.camera
    if config.fusion.method == "filter":
        ids = tuple(m.id for m in landmarks(setup.tanker, config.vision))
        return RelativeFilter(config.fusion, aircraft, camera, markers, partial(pixels_to_normalised, camera), ids)
    return Blend(config.fusion, aircraft)


class Pipeline:
    """Vision, estimation and guidance, wired."""

    def __init__(self, setup: Setup, mark: Callable[[str], None] = unmarked) -> None:
        self._mark = mark
        self.vision = VisionChain(setup.camera, setup.tanker, setup.config.vision)
        self.aircraft = Aircraft(setup.config.fusion, T_frd_cam(setup.camera))
        self.fusion: Fusion = fusion_of(setup, self.aircraft, self.vision.markers)
        self.relative = RelativeEstimator(self.fusion, self.aircraft, setup.tanker, setup.airframe)
        config = setup.config
        self.integrity = IntegrityMonitor(
            config.integrity, setup.tanker.window, eye_of(setup.camera), landmarks(setup.tanker, config.vision),
            config.vision,
        )
        self.approach = Approach(setup.config.guidance, setup.airframe, setup.tanker.window)
        self.monitor = HealthMonitor(setup)
        self._last_frame: CameraFrame | MarkerFrame | None = None
        self._seen_real = False  # a pose of a picture since real vision was switched on

        self._handlers: dict[type, Callable[[Any], list[Output]]] = {
            CameraFrame: self._frame,
            MarkerFrame: self._frame,
            Tick: self._tick,
            OwnAttitude: lambda event: _only(self.aircraft.own_attitude_event(event)),
            OwnPosition: lambda event: self._position(self.aircraft.own_position_event(event)),
            TankerState: lambda event: self._position(self.aircraft.tanker_event(event)),
            GpsStatus: self._gps,
            TimeStep: self._time_step,
            AutopilotStatus: self._status,
            OperatorCommand: self._command,
            Reject: lambda event: [event],
        }

    @property
    def phase(self) -> Phase:
        """Return the present phase."""
        return self.approach.phase

    def handle(self, event: Event) -> list[Output]:
        """Take one event and return its outputs."""
        self.monitor.event(event)
        outputs = self._handlers[type(event)](event)
        for output in outputs:
            self.monitor.output(output)
        return outputs

    def _status(self, status: AutopilotStatus) -> list[Output]:
        self.approach.status_event(status)
        return []

    def _command(self, command: OperatorCommand) -> list[Output]:
        mode = VISION_MODES.get(command.command)
        if mode is not None:
            self.vision.mode = mode
            return [VisionModeChange(command.t_ns, mode)]
        self.approach.command_event(command.command)
        return []

    def _position(self, reject: Reject | None) -> list[Output]:
        return self._judged(self.fusion.positions()) if reject is None else [reject]

    def _gps(self, status: GpsStatus) -> list[Output]:
        self.aircraft.gps_event(status)
        return []

    def _time_step(self, step: TimeStep) -> list[Output]:
        """Move what was stamped before the step; begin anew where it cannot be put beside what comes after it.

        Samples, and what rests on them, move in time together.
        """
        self.aircraft.time_step_event(step)
        if step.continuous:
            self.fusion.shift(step.step_ns)
            self.relative.shift(step.step_ns)
            return []
        self.fusion.restart()
        self.relative.restart()
        self.integrity.restart()
        return []

    def _frame(self, frame: CameraFrame | MarkerFrame) -> list[Output]:
        fault = self._standstill(frame)
        if fault:
            return [Reject(frame.t_ns, "camera", fault)]
        # Simulated vision projects what GPS says: its own answer as prior would feed on itself (thesis 4.2.5, 7.3).
        looks = self.vision.mode is VisionMode.REAL
        if looks:
            known = self.fusion.prior(frame.t_ns)
            prior = None if known is None else known.T_cam_tanker
            tracked = known is not None and known.tracked and self._seen_real
        else:
            prior, tracked = self.aircraft.gps_prior(frame.t_ns), False
        if prior is None:
            return [Reject(frame.t_ns, "vision", "no_prior")]
        seen = self.vision.process(frame, prior, tracked=tracked)
        self._seen_real = looks and (self._seen_real or seen.pose is not None)
        self._mark("vision")
        fused = self.fusion.vision(seen)
        outputs = self._judged([seen, *fused])
        self._mark("fusion")
        return outputs

    def _judged(self, outputs: list[Output]) -> list[Output]:
        for output in outputs:
            self.integrity.see(output)
        return outputs

    def _standstill(self, frame: CameraFrame | MarkerFrame) -> str:
        """Say what shows that the camera stands still: a stamp, or a picture bit for bit, that has been before.

        A sensor's noise never repeats, and a frozen picture flown on leads forward for ever.
        """
        last = self._last_frame
        if last is not None and frame.t_ns <= last.t_ns:
            return "time_not_forward"
        self._last_frame = frame
        looks = self.vision.mode is VisionMode.REAL
        return "frozen" if looks and last is not None and _repeats(frame, last) else ""

    def _tick(self, tick: Tick) -> list[Output]:
        state = self.relative.at(tick.t_ns)
        sources = self.relative.sources()
        integrity = None if state is None else self.integrity.at(state, sources)
        health = self.monitor.step(tick.t_ns, self.phase, sources)
        outputs: list[Output] = [o for o in (health, state, integrity) if o is not None]
        outputs += self.approach.step(tick.t_ns, state, sources, integrity)
        self._mark("guidance")
        return outputs


def eye_of(camera: CameraConfig) -> Eye:
    """Return what integrity needs of a camera."""
    return Eye(
        math.sqrt(camera.fx_px * camera.fy_px), (camera.width_px, camera.height_px), T_frd_cam(camera),
        partial(project, camera), partial(pixels_to_normalised, camera),
    )


def _repeats(frame: CameraFrame | MarkerFrame, last: CameraFrame | MarkerFrame) -> bool:
    """Say whether a frame shows bit for bit what the last one showed; no markers at all are no repeat."""
    if isinstance(frame, CameraFrame) and isinstance(last, CameraFrame):
        return _same_picture(frame.image, last.image)
    if isinstance(frame, MarkerFrame) and isinstance(last, MarkerFrame):
        uv_px = frame.detections.uv_px
        return len(uv_px) > 0 and np.array_equal(uv_px, last.detections.uv_px)
    return False


def _same_picture(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> bool:
    """Compare a few pixels first, where two pictures that differ nearly always do. What is no picture is no repeat."""
    pictures = isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.ndim == b.ndim == 3
    return pictures and np.array_equal(a[::16, ::16], b[::16, ::16]) and np.array_equal(a, b)


def _only(reject: Reject | None) -> list[Output]:
    return [] if reject is None else [reject]

