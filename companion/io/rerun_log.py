"""The recording for eyes: ``flight.rrd``, of all messages of the companion.

Rules
-----
* The flight never waits: messages go into a queue, a thread of its own draws them in batches of columns. When it falls
  behind, pictures are dropped first, then the rest; both are counted.
* Of the pictures ``recorder.image_rate_hz`` are kept, with the detections of just those frames, so that points and
  picture always belong together.
* A message kind is one row of ``_DRAWERS``, or of those of ``rerun_trust``.
"""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr

from companion.config import Setup, landmarks
from companion.geometry import Mat
from companion.io.rerun_scene import (
    AXES,
    DETECTED,
    ESTIMATE,
    SceneStream,
    draw_plot_lines,
    draw_setup,
)
from companion.io.rerun_trust import DRAWERS as TRUST_DRAWERS
from companion.io.rerun_trust import TrustDrawer
from companion.messages import (
    AttitudeSetpoint,
    CameraFrame,
    Event,
    FusedPose,
    GuidanceOutput,
    MarkerFrame,
    Output,
    Phase,
    PhaseChange,
    Reject,
    RelativeState,
    VisionModeChange,
    VisionOutput,
)
from companion.vision.camera import T_frd_cam

BATCH_S = 0.5
PIXEL_CENTRE = 0.5
"""Centres of pixels are at integers with us, at halves in the viewer."""
QUEUE_LENGTH = 200_000
QUEUED_PICTURES = 30
PATH_STEP_NS = 250_000_000
PATH_POINTS = 800
REJECT_PAUSE_NS = 1_000_000_000
"""The log for people takes one reject of a kind per second; ``events.jsonl`` has them all."""

PHASE_COLOURS = {
    Phase.STANDBY: (120, 120, 120),
    Phase.SELF_TEST: (150, 110, 190),
    Phase.JOIN: (90, 140, 220),
    Phase.OBSERVATION: (70, 170, 215),
    Phase.PRE_CONTACT: (60, 185, 175),
    Phase.APPROACH: (220, 180, 70),
    Phase.CONTACT: (225, 140, 60),
    Phase.HOLD: (80, 180, 110),
    Phase.DISCONNECT: (150, 160, 90),
    Phase.BREAKAWAY: (220, 70, 60),
}


class RerunLog:
    """Writes ``flight.rrd`` beside the flight; safe to close twice."""

    def __init__(self, path: Path, setup: Setup, *, t0_ns: int = 0, recording_id: str = "") -> None:
        """``t0_ns`` is the zero of ``sim_time``; the recording's id is the run folder's name unless given."""
        self.pictures_dropped = 0
        self.messages_dropped = 0
        self._queue: deque[Any] = deque()
        self._pictures_taken = 0  # written by the flight's thread only
        self._pictures_drawn = 0  # written by ours only
        self._picture_due_ns: int | None = None
        self._kept_sequence: int | None = None
        rate_hz = setup.config.recorder.image_rate_hz
        self._picture_step_ns = round(1e9 / rate_hz) if rate_hz > 0 else None
        self._stop = threading.Event()
        self._draw = _Draw(path, setup, t0_ns, recording_id or path.resolve().parent.name)
        self._thread = threading.Thread(target=self._run, name="rerun-log", daemon=True)
        self._thread.start()

    def event(self, event: Event) -> None:
        """Take an input: of those only pictures are drawn, rejects come out of the pipeline again."""
        if isinstance(event, CameraFrame | MarkerFrame):
            self._frame(event)

    def output(self, output: Output) -> None:
        """Take an output; of the vision's only those of the pictures that were kept."""
        if not isinstance(output, VisionOutput) or output.sequence == self._kept_sequence:
            self._put(output)

    def latency(self, t_ns: int, stage: str, duration_ns: int) -> None:
        """Take how long a stage took."""
        self._put((t_ns, stage, duration_ns))

    def _frame(self, frame: CameraFrame | MarkerFrame) -> None:
        if self._picture_step_ns is None:
            return
        due_ns = frame.t_ns if self._picture_due_ns is None else self._picture_due_ns
        if frame.t_ns < due_ns:
            return
        # On the grid of the rate while pictures come; from now on after a gap.
        self._picture_due_ns = max(due_ns + self._picture_step_ns, frame.t_ns + self._picture_step_ns // 2)
        if isinstance(frame, MarkerFrame):
            self._kept_sequence = frame.sequence
            return
        if self._pictures_taken - self._pictures_drawn >= QUEUED_PICTURES:
            self.pictures_dropped += 1
            return
        self._kept_sequence = frame.sequence
        self._pictures_taken += 1
        self._put(frame)

    def _put(self, message: Any) -> None:
        if len(self._queue) < QUEUE_LENGTH:
            self._queue.append(message)
        else:
            self.messages_dropped += 1

    def _run(self) -> None:
        while not self._stop.wait(BATCH_S):
            self._drain()
        self._drain()

    def _drain(self) -> None:
        batch: defaultdict[type, list[Any]] = defaultdict(list)
        for _ in range(len(self._queue)):
            message = self._queue.popleft()
            batch[type(message)].append(message)
        self._draw.batch(batch)
        self._pictures_drawn += len(batch.get(CameraFrame, ()))

    def close(self) -> None:
        """Draw what is queued and close the file; gives up after ten seconds."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join(timeout=10.0)
            self._draw.scene.close()


class _Draw:
    """Turns batches of messages of one kind into columns; lives in the thread of ``RerunLog``."""

    def __init__(self, path: Path, setup: Setup, t0_ns: int, recording_id: str) -> None:
        self.scene = SceneStream(path, setup, t0_ns, recording_id)
        self._trust = TrustDrawer(self.scene)
        self._setup = setup
        self._camera = T_frd_cam(setup.camera)
        self._path: deque[Mat] = deque(maxlen=PATH_POINTS)
        self._path_due_ns = 0
        self._reject_due_ns: dict[tuple[str, str], int] = {}
        draw_setup(self.scene, setup)
        draw_plot_lines(self.scene)
        self.scene.static("world/uav/camera", rr.Transform3D(translation=self._camera.t, mat3x3=self._camera.R))
        colours = list(PHASE_COLOURS.values())
        self.scene.static("phase", rr.StateConfiguration(values=[p.value for p in PHASE_COLOURS], colors=colours))
        self.scene.columns("phase", self.scene.times([t0_ns]), rr.StateChange.columns(state=[Phase.STANDBY.value]))

    def batch(self, batch: dict[type, list[Any]]) -> None:
        """Draw one batch."""
        for kind, drawer in _DRAWERS.items():
            if kind in batch:
                drawer(self, batch[kind])
        for kind, trust_drawer in TRUST_DRAWERS.items():
            if kind in batch:
                trust_drawer(self._trust, batch[kind])

    def pictures(self, frames: list[CameraFrame]) -> None:
        """Draw the camera's pictures as JPEG."""
        quality = [cv2.IMWRITE_JPEG_QUALITY, self._setup.config.recorder.jpeg_quality]
        jpegs = [cv2.imencode(".jpg", f.image[:, :, ::-1], quality)[1].tobytes() for f in frames]
        columns = rr.EncodedImage.columns(blob=jpegs, media_type=["image/jpeg"] * len(jpegs))
        times = self.scene.times([f.t_ns for f in frames], [f.sequence for f in frames])
        self.scene.columns("world/uav/camera/image", times, columns)

    def vision(self, outputs: list[VisionOutput]) -> None:
        """Draw detected markers as small squares with the marker's id, predicted ones as larger squares."""
        image, width_px = "world/uav/camera/image", self._setup.camera.width_px
        times = self.scene.times([o.t_ns for o in outputs], [o.sequence for o in outputs])
        labels = [label for o in outputs for label in detection_labels(o, self._setup)]
        detected = [o.detections.uv_px.reshape(-1, 2) for o in outputs]
        self._squares(f"{image}/detected", times, detected, DETECTED, width_px / 128, labels)
        predicted = [o.predicted_uv_px[np.isfinite(o.predicted_uv_px).all(axis=1)] for o in outputs]
        self._squares(f"{image}/predicted", times, predicted, ESTIMATE, width_px / 64)

    def _squares(
        self, entity: str, times: list[rr.TimeColumn], rows: list[Mat], colour: Any, half_px: float,
        labels: list[str] | None = None,
    ) -> None:
        centres = np.concatenate(rows)
        n = len(centres)
        columns = rr.Boxes2D.columns(
            centers=centres + PIXEL_CENTRE, half_sizes=np.full((n, 2), half_px), colors=[colour] * n, labels=labels,
            radii=[rr.Radius.ui_points(0.6)] * n,
        )
        self.scene.columns(entity, times, columns.partition(lengths=[len(row) for row in rows]))

    def relative(self, states: list[RelativeState]) -> None:
        """Draw both aircraft about the tanker, BR, range and the path flown."""
        t_ns = [s.t_ns for s in states]
        R_mrf_frd, R_mrf_tanker, p_mrf_uav = scene_poses(states, self._camera.R, self._camera.t)
        self.scene.poses("world/uav", t_ns, R_mrf_frd, p_mrf_uav)
        self.scene.poses("world/tanker", t_ns, R_mrf_tanker, np.zeros((len(states), 3)))
        box = R_mrf_tanker @ np.array(self._setup.tanker.box_tanker_m)
        self.scene.columns("world/window", self.scene.times(t_ns), rr.Transform3D.columns(translation=box))
        br = np.array([s.p_mrf_br_m for s in states])
        window = self._setup.tanker.window
        for k, axis in enumerate(AXES):
            self.scene.scalars(f"plots/br/{axis}/estimate", t_ns, br[:, k])
            for name, half in (("desired", window.desired_m[k]), ("limit", window.limit_m[k])):
                self.scene.scalars(f"plots/br/{axis}/{name}", [t_ns[0], t_ns[-1]], [[half, -half]] * 2)
        self.scene.scalars("plots/range", t_ns, [s.range_m for s in states])
        self._flown(t_ns, box + br)

    def _flown(self, t_ns: list[int], receptacle: Mat) -> None:
        """Draw the receptacle's way, a line that grows every second."""
        times, strips = [], []
        for t, point in zip(t_ns, receptacle, strict=True):
            if t >= self._path_due_ns:
                self._path.append(point)
                self._path_due_ns = t + PATH_STEP_NS
                if len(self._path) % 4 == 0:
                    times.append(t)
                    strips.append(np.array(self._path))
        if strips:
            n, thin = len(strips), rr.Radius.ui_points(1.0)
            columns = rr.LineStrips3D.columns(strips=strips, colors=[ESTIMATE] * n, radii=[thin] * n)
            self.scene.columns("world/flown", self.scene.times(times), columns)

    def fused(self, poses: list[FusedPose]) -> None:
        """Draw how much of the estimate is vision, and on how many markers it rests."""
        t_ns = [p.t_ns for p in poses]
        self.scene.scalars("plots/fusion/vision_weight", t_ns, [p.vision_weight for p in poses])
        self.scene.scalars("plots/fusion/markers", t_ns, [p.markers_used for p in poses])

    def guidance(self, steps: list[GuidanceOutput]) -> None:
        """Draw the path's reference."""
        reference = np.array([s.reference_mrf_m for s in steps])
        for k, axis in enumerate(AXES):
            self.scene.scalars(f"plots/br/{axis}/reference", [s.t_ns for s in steps], reference[:, k])

    def setpoints(self, setpoints: list[AttitudeSetpoint]) -> None:
        """Draw what the autopilot was asked for, in degrees and percent for people."""
        t_ns = [s.t_ns for s in setpoints]
        self.scene.scalars("plots/setpoint/roll_deg", t_ns, np.rad2deg([s.roll_rad for s in setpoints]))
        self.scene.scalars("plots/setpoint/pitch_deg", t_ns, np.rad2deg([s.pitch_rad for s in setpoints]))
        self.scene.scalars("plots/setpoint/thrust_percent", t_ns, [100.0 * s.thrust for s in setpoints])

    def phases(self, changes: list[PhaseChange]) -> None:
        """Draw the phase as a band and in the log."""
        times = self.scene.times([c.t_ns for c in changes])
        self.scene.columns("phase", times, rr.StateChange.columns(state=[c.new.value for c in changes]))
        self.scene.texts("log/phase", [(c.t_ns, "INFO", f"{c.old} -> {c.new}: {c.reason}") for c in changes])

    def modes(self, changes: list[VisionModeChange]) -> None:
        """Write switches of the vision's mode to the log."""
        self.scene.texts("log/vision", [(c.t_ns, "INFO", f"vision {c.mode}") for c in changes])

    def rejects(self, rejects: list[Reject]) -> None:
        """Write rejects to the log, one of a kind per second."""
        rows = []
        for r in rejects:
            if r.t_ns >= self._reject_due_ns.get((r.source, r.reason), r.t_ns):
                self._reject_due_ns[r.source, r.reason] = r.t_ns + REJECT_PAUSE_NS
                rows.append((r.t_ns, "WARN", f"{r.source}: {r.reason} {r.detail}".rstrip()))
        if rows:
            self.scene.texts("log/rejects", rows)

    def latencies(self, rows: list[tuple[int, str, int]]) -> None:
        """Draw how long the stages took, in ms."""
        stages: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)
        for t_ns, stage, duration_ns in rows:
            stages[stage].append((t_ns, duration_ns / 1e6))
        for stage, points in stages.items():
            t_ns_all, ms = zip(*points, strict=True)
            self.scene.scalars(f"plots/latency/{stage}", t_ns_all, ms)


_DRAWERS: dict[type, Callable[[_Draw, list[Any]], None]] = {
    CameraFrame: _Draw.pictures,
    VisionOutput: _Draw.vision,
    RelativeState: _Draw.relative,
    FusedPose: _Draw.fused,
    GuidanceOutput: _Draw.guidance,
    AttitudeSetpoint: _Draw.setpoints,
    PhaseChange: _Draw.phases,
    VisionModeChange: _Draw.modes,
    Reject: _Draw.rejects,
    tuple: _Draw.latencies,
}


def detection_labels(output: VisionOutput, setup: Setup) -> list[str]:
    """Return for each detection the id of the marker it was labelled as, or an empty string."""
    labels = [""] * len(output.detections.uv_px)
    for marker, index in zip(landmarks(setup.tanker, setup.config.vision), output.labels, strict=True):
        if index >= 0:
            labels[index] = str(marker.id)
    return labels


def scene_poses(states: list[RelativeState], R_frd_cam: Mat, p_frd_cam: Mat) -> tuple[Mat, Mat, Mat]:
    """Return R_mrf_frd (n, 3, 3), R_mrf_tanker (n, 3, 3) and the receiver's place p (n, 3) from the tanker, in mrf."""
    heading = np.array([s.heading0_rad for s in states])
    R_ned_mrf = np.zeros((len(states), 3, 3))
    R_ned_mrf[:, 0, 0] = R_ned_mrf[:, 1, 1] = np.cos(heading)
    R_ned_mrf[:, 1, 0] = np.sin(heading)
    R_ned_mrf[:, 0, 1] = -R_ned_mrf[:, 1, 0]
    R_ned_mrf[:, 2, 2] = 1.0
    R_mrf_frd = R_ned_mrf.transpose(0, 2, 1) @ np.array([s.R_ned_frd for s in states])
    R_cam_tanker = np.array([s.T_cam_tanker.R for s in states])
    p_cam_tanker = np.array([s.T_cam_tanker.t for s in states])
    p_frd_tanker = p_cam_tanker @ R_frd_cam.T + p_frd_cam
    p_mrf_uav = -np.einsum("nij,nj->ni", R_mrf_frd, p_frd_tanker)
    return R_mrf_frd, R_mrf_frd @ R_frd_cam @ R_cam_tanker, p_mrf_uav
