"""What really happened: ``truth.rrd`` beside the companion's recording, and ``truth.npz`` for figures.

Rules
-----
* Every instant that comes in is kept: how often, the simulator decides (50 Hz).
* Both aircraft are drawn about the tanker as in ``flight.rrd``, solid where the companion's belief is drawn as lines;
  ``mrf`` has the tanker's course of the first instant.
* ``truth.npz``: ``t_ns`` (n,), ``p_mrf_br_m`` (n, 3), ``p_ned_uav_m``, ``p_ned_tanker_m`` (n, 3), ``R_ned_frd``,
  ``R_ned_tanker`` (n, 3, 3), ``boom`` (n, 6): elevation and azimuth in rad, length in m, contact (0, 1), ruddevators
  right and left in rad.
* The boom moves in the scene at 10 Hz. What its operator sees, when it is asked for, is at ``operator/camera``, 2 Hz.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from companion.config import Setup
from companion.geometry import Mat, Vec, rotation_from_euler
from companion.io.rerun_scene import AXES, MeshArrays, SceneStream, draw_plot_lines, draw_setup, draw_truth_lines
from sim_bridge.scene.boom_mesh import boom_mesh, boom_poses
from sim_bridge.scene.meshing import Mesh
from sim_bridge.scene.operator_view import OperatorView
from sim_bridge.scene.receiver_mesh import uav_mesh
from sim_bridge.scene.tanker_mesh import tanker_mesh
from sim_bridge.truth import BoomState, Truth

BATCH = 250
"""Truths that are drawn together: five seconds."""

BOOM_EVERY, OPERATOR_EVERY = 5, 25
OPERATOR_JPEG = 85
BOOM_PARTS = ("tube", "telescope", "ruddevator_right", "ruddevator_left")


class TruthLog:
    """Writes the truth of one flight into its run folder; a context manager, safe to close twice.

    ``t0_ns`` is the zero of ``sim_time``; with the id of the folder's other recording the viewer shows both as one.
    ``operator`` draws what the boom operator sees.
    """

    def __init__(self, folder: Path, setup: Setup, *, t0_ns: int = 0, operator: OperatorView | None = None) -> None:
        self._folder = folder
        self._scene = SceneStream(folder / "truth.rrd", setup, t0_ns, folder.resolve().name)
        self._truths: list[Truth] = []
        self._br: list[Vec] = []
        self._drawn = 0
        self._R_mrf_ned: Mat = np.eye(3)
        self._closed = False
        self._operator = operator
        draw_setup(self._scene, setup)
        draw_plot_lines(self._scene)
        draw_truth_lines(self._scene)

    def append(self, truth: Truth, p_mrf_br_m: Vec) -> None:
        """Take one instant and its BR (3,), from box to receptacle in ``mrf``."""
        if not self._truths:
            self._begin(truth)
        self._truths.append(truth)
        self._br.append(np.array(p_mrf_br_m))
        if len(self._truths) - self._drawn >= BATCH:
            self._draw()

    def series(self) -> tuple[NDArray[np.int64], Mat]:
        """Return t_ns (n,) and BR (n, 3) in m, ``mrf``."""
        t_ns = np.array([t.t_ns for t in self._truths], dtype=np.int64)
        return t_ns, np.array(self._br, dtype=np.float64).reshape(-1, 3)

    def _begin(self, truth: Truth) -> None:
        course = float(np.arctan2(truth.tanker.v_ned_m_s[1], truth.tanker.v_ned_m_s[0]))
        self._R_mrf_ned = rotation_from_euler(course, 0.0, 0.0).T
        self._scene.static("world/truth/tanker/body", drawable(tanker_mesh()).to_rerun())
        for name, part in zip(BOOM_PARTS, boom_mesh(), strict=True):
            self._scene.static(f"world/truth/tanker/boom/{name}/body", drawable(part).to_rerun())
        self._scene.static("world/truth/uav/body", drawable(uav_mesh()).to_rerun())

    def _draw(self) -> None:
        new, br = self._truths[self._drawn :], np.array(self._br[self._drawn :])
        self._drawn = len(self._truths)
        if not new:
            return
        t_ns = [t.t_ns for t in new]
        R_mrf_uav = self._R_mrf_ned @ np.array([t.uav.R_ned_body for t in new])
        R_mrf_tanker = self._R_mrf_ned @ np.array([t.tanker.R_ned_body for t in new])
        p_mrf = np.array([t.uav.p_ned_m - t.tanker.p_ned_m for t in new]) @ self._R_mrf_ned.T
        self._scene.poses("world/truth/uav", t_ns, R_mrf_uav, p_mrf)
        self._scene.poses("world/truth/tanker", t_ns, R_mrf_tanker, np.zeros_like(p_mrf))
        for k, axis in enumerate(AXES):
            self._scene.scalars(f"plots/br/{axis}/truth", t_ns, br[:, k])
        self._draw_boom(new[::BOOM_EVERY])
        if self._operator is not None:
            self._draw_operator(self._operator, new[::OPERATOR_EVERY])

    def _draw_boom(self, truths: list[Truth]) -> None:
        t_ns, poses = [t.t_ns for t in truths], [boom_poses(t.boom) for t in truths]
        for k, name in enumerate(BOOM_PARTS):
            R, p = np.array([T[k].R for T in poses]), np.array([T[k].t for T in poses])
            self._scene.poses(f"world/truth/tanker/boom/{name}", t_ns, R, p)

    def _draw_operator(self, operator: OperatorView, truths: list[Truth]) -> None:
        pictures = [operator.render(t.tanker.T_ned_body(), t.uav.T_ned_body(), t.boom) for t in truths]
        self._scene.pictures("operator/camera", [t.t_ns for t in truths], pictures, OPERATOR_JPEG)

    def close(self) -> None:
        """Draw the rest and write ``truth.npz``; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._draw()
        self._scene.close()
        t_ns, br = self.series()
        with suppress(OSError):  # a full disk must not hide how the flight ended; the score is taken from memory
            np.savez(
                self._folder / "truth.npz",
                t_ns=t_ns,
                p_mrf_br_m=br,
                p_ned_uav_m=np.array([t.uav.p_ned_m for t in self._truths]),
                p_ned_tanker_m=np.array([t.tanker.p_ned_m for t in self._truths]),
                R_ned_frd=np.array([t.uav.R_ned_body for t in self._truths]),
                R_ned_tanker=np.array([t.tanker.R_ned_body for t in self._truths]),
                boom=np.array([boom_row(t.boom) for t in self._truths]),
            )

    def __enter__(self) -> TruthLog:
        """Return the log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close, whatever happened."""
        self.close()


def boom_row(boom: BoomState) -> list[float]:
    """Return a row of ``boom`` in ``truth.npz``."""
    return [boom.elevation_rad, boom.azimuth_rad, boom.length_m, float(boom.contact), *boom.ruddevators_rad]


def drawable(mesh: Mesh) -> MeshArrays:
    """Return a mesh of the scene with its reflectances, linear 0..1, as the viewer's gamma-coded bytes."""
    rgb = np.round(255.0 * np.clip(mesh.colours, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    return MeshArrays(mesh.vertices, mesh.normals, mesh.triangles, rgb)
