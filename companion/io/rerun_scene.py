"""What ``flight.rrd`` and ``truth.rrd`` have in common: one stream with our timelines, the scene and its colours.

Rules
-----
* ``world`` has the axes of ``mrf`` (forward, right, down) and its origin at the tanker's centre of mass, because at
  200 m/s nothing that stands still can be looked at.
* Timelines: ``sim_time``, a message's ``t_ns`` from the recording's zero on, and ``frame``, the camera's sequence.
* Only the files ``rerun_*`` use rerun.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from companion.config import ConfigError, Setup
from companion.geometry import Mat
from companion.io.rerun_view import APPLICATION_ID, flight_blueprint

AXES = ("x", "y", "z")

ESTIMATE = (90, 170, 255)
TRUTH = (245, 245, 245)
REFERENCE = (200, 160, 255)
DESIRED = (80, 200, 120)
LIMIT = (235, 110, 70)
MARKER = (255, 60, 50)
DETECTED = (255, 230, 60)
BOOM = (230, 200, 120)

# The receiver's outline for the picture, in frd: a tailless delta of 13.1 m by 11.4 m (ICE-101; shape estimated).
_UAV_RIM_M = np.array([
    [6.6, 0.0, 0.0], [-5.4, 5.7, 0.0], [-5.9, 5.7, 0.0], [-4.3, 2.7, 0.0], [-6.5, 0.0, 0.0], [-4.3, -2.7, 0.0],
    [-5.9, -5.7, 0.0], [-5.4, -5.7, 0.0],
])  # fmt: skip
_UAV_TOP_M = np.array([-0.5, 0.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class MeshArrays:
    """A body to draw: ``vertices_m``, ``normals`` (n, 3) in its axes, ``triangles`` (m, 3), ``rgb`` (n, 3) uint8."""

    vertices_m: Mat
    normals: Mat
    triangles: NDArray[Any]
    rgb: NDArray[np.uint8]

    def to_rerun(self) -> rr.Mesh3D:
        """Return the mesh as the viewer takes it."""
        return rr.Mesh3D(
            vertex_positions=self.vertices_m,
            vertex_normals=self.normals,
            triangle_indices=self.triangles,
            vertex_colors=self.rgb,
        )


def uav_wires() -> list[Mat]:
    """Return the receiver as lines (n, 3) in ``frd``: its rim, and spokes to its back."""
    rim = np.vstack([_UAV_RIM_M, _UAV_RIM_M[:1]])
    return [rim, *(np.stack([corner, _UAV_TOP_M]) for corner in _UAV_RIM_M[[0, 1, 4, 7]])]


class SceneStream:
    """One .rrd file. Both files of a run carry its recording id, so that the viewer shows them as one recording."""

    def __init__(self, path: Path, setup: Setup, t0_ns: int, recording_id: str) -> None:
        self.rec = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id)
        try:
            path.open("wb").close()
            self.rec.save(path, default_blueprint=flight_blueprint(setup.tanker.window))
        except (OSError, RuntimeError) as error:  # the SDK's own word for a disk that is full is RuntimeError
            msg = f"{path}: cannot be written ({error}); give another folder with --out"
            raise ConfigError(msg) from None
        self.rec.send_recording_name(recording_id)
        self._t0_ns = t0_ns

    def times(self, t_ns: Any, frames: Sequence[int] | None = None) -> list[rr.TimeColumn]:
        """Return the index columns for instants in ns (n,), and for the pictures' sequence numbers when given."""
        since = (np.asarray(t_ns, dtype=np.int64) - self._t0_ns).astype("timedelta64[ns]")
        columns = [rr.TimeColumn("sim_time", duration=since)]
        return columns if frames is None else [*columns, rr.TimeColumn("frame", sequence=frames)]

    def columns(self, entity: str, times: list[rr.TimeColumn], columns: Any) -> None:
        """Send a batch."""
        rr.send_columns(entity, times, columns, recording=self.rec)

    def scalars(self, entity: str, t_ns: Any, values: Any) -> None:
        """Send values (n,) or, as k lines of one entity, (n, k)."""
        values = np.asarray(values, dtype=np.float64)
        columns = rr.Scalars.columns(scalars=values.reshape(-1))
        if values.ndim == 2:
            columns = columns.partition(lengths=[values.shape[1]] * values.shape[0])
        self.columns(entity, self.times(t_ns), columns)

    def poses(self, entity: str, t_ns: Any, R: Mat, t_m: Mat) -> None:
        """Send poses: R (n, 3, 3) and t_m (n, 3) of the entity in its parent."""
        quaternions = Rotation.from_matrix(R).as_quat()
        self.columns(entity, self.times(t_ns), rr.Transform3D.columns(translation=t_m, quaternion=quaternions))

    def texts(self, entity: str, rows: Sequence[tuple[int, str, str]]) -> None:
        """Send lines of (t_ns, level, text)."""
        t_ns, levels, lines = zip(*rows, strict=True)
        self.columns(entity, self.times(t_ns), rr.TextLog.columns(text=lines, level=levels))

    def pictures(self, entity: str, t_ns: Any, pictures: Sequence[NDArray[np.uint8]], quality: int) -> None:
        """Send pictures (h, w, 3) RGB as JPEG."""
        flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
        jpegs = [cv2.imencode(".jpg", p[:, :, ::-1], flags)[1].tobytes() for p in pictures]
        self.columns(entity, self.times(t_ns),
                     rr.EncodedImage.columns(blob=jpegs, media_type=["image/jpeg"] * len(jpegs)))

    def static(self, entity: str, *what: Any) -> None:
        """Log what does not change."""
        self.rec.log(entity, *what, static=True)

    def line(self, entity: str, names: Sequence[str], colour: tuple[int, ...], width: float = 1.5) -> None:
        """Name and colour the lines of a plot's entity."""
        n = len(names)
        self.static(entity, rr.SeriesLines(names=list(names), colors=[colour] * n, widths=[width] * n))

    def close(self) -> None:
        """Flush, waiting five seconds at most, and close the file.

        A disk that has filled up meanwhile ends the file early; the SDK has said so on stderr by then.
        """
        with suppress(RuntimeError):
            self.rec.flush(timeout_sec=5.0)
        self.rec.disconnect()


def draw_setup(scene: SceneStream, setup: Setup) -> None:
    """Draw what the companion knows before the flight: lights, box, boom, window, receiver and its camera's place."""
    tanker, camera = setup.tanker, setup.camera
    scene.static("world", rr.ViewCoordinates.FRD)
    markers = [m.p_tanker_m for m in tanker.markers]
    labels = [str(m.id) for m in tanker.markers]
    radius = max(tanker.marker_radius_m, 0.3)  # drawn larger than they are, or nobody would see them
    lights = rr.Points3D(markers, colors=MARKER, radii=radius, labels=labels, show_labels=False)
    scene.static("world/tanker/markers", lights)
    boom = tanker.boom
    aft, down = np.cos(boom.elevation_rad), np.sin(boom.elevation_rad)
    side = np.sin(boom.azimuth_rad)
    direction = np.array([-aft * np.cos(boom.azimuth_rad), aft * side, down])
    draw_boom(scene, "world/tanker/boom", np.array(boom.pivot_tanker_m), boom.length_m * direction)
    for name, half, colour in (("desired", tanker.window.desired_m, DESIRED), ("limit", tanker.window.limit_m, LIMIT)):
        box = rr.Boxes3D(centers=[[0, 0, 0]], half_sizes=[half], colors=colour, radii=0.03)
        scene.static(f"world/window/{name}", box)
    scene.static("world/uav/body", rr.LineStrips3D(uav_wires(), colors=ESTIMATE, radii=rr.Radius.ui_points(1.0)))
    scene.static("world/uav/receptacle", rr.Points3D([setup.airframe.receptacle_frd_m], colors=DETECTED, radii=0.2))
    pinhole = rr.Pinhole(
        focal_length=[camera.fx_px, camera.fy_px],
        principal_point=[camera.cx_px, camera.cy_px],
        resolution=[camera.width_px, camera.height_px],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=2.5,
    )
    scene.static("world/uav/camera", pinhole)


def draw_boom(scene: SceneStream, entity: str, pivot_tanker_m: Mat, reach_tanker_m: Mat) -> None:
    """Draw the boom as a line from its pivot, both arguments (3,) in tanker axes."""
    strip = np.stack([pivot_tanker_m, pivot_tanker_m + reach_tanker_m])
    scene.static(entity, rr.LineStrips3D([strip], colors=BOOM, radii=0.2))


def draw_plot_lines(scene: SceneStream) -> None:
    """Name and colour the lines of all plots."""
    for axis in AXES:
        base = f"plots/br/{axis}"
        scene.line(f"{base}/estimate", ["estimate"], ESTIMATE, 2.0)
        scene.line(f"{base}/reference", ["path"], REFERENCE, 1.0)
        scene.line(f"{base}/desired", ["desired", "desired"], DESIRED, 1.0)
        scene.line(f"{base}/limit", ["limit", "limit"], LIMIT, 1.0)
    scene.line("plots/range", ["range, m"], ESTIMATE, 2.0)
    scene.line("plots/fusion/vision_weight", ["vision weight"], ESTIMATE, 2.0)
    scene.line("plots/fusion/markers", ["markers used"], DETECTED, 1.5)
    for name, colour in (("roll_deg", ESTIMATE), ("pitch_deg", DETECTED), ("thrust_percent", LIMIT)):
        scene.line(f"plots/setpoint/{name}", [name.replace("_", ", ")], colour)


def draw_truth_lines(scene: SceneStream) -> None:
    """Name and colour the truth's lines in the plots of BR."""
    for axis in AXES:
        scene.line(f"plots/br/{axis}/truth", ["truth"], TRUTH, 1.5)
