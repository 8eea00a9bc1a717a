"""The tanker with its boom as one mesh in parts, as the receiver's camera sees it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.geometry import SE3
from sim_bridge.scene.ambient import shade_recesses
from sim_bridge.scene.boom_mesh import boom_mesh, boom_poses
from sim_bridge.scene.clutter import red_paint
from sim_bridge.scene.meshing import Mesh, merge
from sim_bridge.scene.tanker_mesh import tanker_mesh
from sim_bridge.truth import BoomState


def in_parts(parts: list[Mesh]) -> tuple[Mesh, NDArray[np.int32]]:
    """Return meshes as one, and the part (0, 1, ...) of every vertex."""
    part = np.repeat(np.arange(len(parts)), [len(p.vertices) for p in parts]).astype(np.int32)
    return merge(parts), part


@lru_cache(maxsize=2)
def tanker_parts(painted: bool = False) -> tuple[Mesh, NDArray[np.int32]]:
    """Return tanker and boom as one mesh, and the part of every vertex; ``painted`` red or not."""
    airframe = merge([tanker_mesh(), *red_paint()]) if painted else tanker_mesh()
    return in_parts([shade_recesses(airframe), *boom_mesh()])


def tanker_poses(T_ned_tanker: SE3, boom: BoomState) -> list[SE3]:
    """Return T_ned_part of the parts of ``tanker_parts``."""
    return [T_ned_tanker, *(T_ned_tanker @ T for T in boom_poses(boom))]
