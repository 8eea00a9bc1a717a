"""The flying boom: a tube on its pivot, a telescope that slides in it, and the V of its two ruddevators.

Rules
-----
* Boom axes: x points from the boom to its pivot, y right, z down at elevation 0; the origin is the pivot.
* The telescope comes out of the tube and never out of its other end: what shows of it is the extension.
* Ruddevators turn whole about an axis across the boom, 42 degrees up on either side.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from companion.geometry import SE3, rotation_from_euler
from sim_bridge.scene.meshing import Mesh, aerofoil, loft, merge, revolution
from sim_bridge.scene.paints import BLACK, GREEN, GREY, LIGHT, METAL, YELLOW
from sim_bridge.truth import BoomState

TUBE_M = 8.3
TELESCOPE_M = 6.9
"""A telescope this long still sits in the tube with the boom 15 m long."""

DIHEDRAL_RAD = 0.733
HINGE_BOOM_M = np.array([-5.5, 0.0, 0.0])
TELESCOPE, RUDDEVATORS = 1, (2, 3)
"""Places in what ``boom_mesh`` and ``boom_poses`` return; the fixed tube is the first."""


def ruddevator() -> Mesh:
    """Return the right ruddevator about its hinge: x forward, y out along the hinge, z to its lower side."""
    stations = [(np.array([0.35 - 0.25 * r, r, 0.0]), 1.15 - 0.12 * r) for r in (0.15, 1.2, 2.35)]
    return loft(np.stack([aerofoil(lead, chord, 0.10) for lead, chord in stations]), LIGHT)


@lru_cache(maxsize=1)
def boom_mesh() -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """Return tube, telescope, right and left ruddevator, each about the origin of its pose in ``boom_poses``."""
    tube = revolution(
        [0.25, 0.0, -0.5, -2.5, -4.5, -6.5, -8.0, -TUBE_M], [0.10, 0.24, 0.30, 0.30, 0.30, 0.28, 0.22, 0.14],
        (0.0, 0.0), 16, GREY,
    )
    bands = [(TELESCOPE_M, 4.2, LIGHT), (4.2, 3.1, GREEN), (3.1, 2.5, YELLOW), (2.5, 0.9, LIGHT), (0.9, 0.3, BLACK)]
    pieces = [
        revolution(list(np.linspace(a, b, 1 + max(1, round(a - b)))), [0.115] * (1 + max(1, round(a - b))),
                   (0.0, 0.0), 12, colour)
        for a, b, colour in bands
    ]
    nozzle = revolution([0.35, 0.3, 0.1, 0.0], [0.10, 0.15, 0.13, 0.07], (0.0, 0.0), 12, METAL)
    return tube, merge([*pieces, nozzle]), ruddevator(), ruddevator().mirrored()


def boom_poses(boom: BoomState) -> tuple[SE3, SE3, SE3, SE3]:
    """Return T_tanker_part of the parts of ``boom_mesh`` for a boom's state; the telescope's origin is the tip."""
    R_tanker_boom = rotation_from_euler(-boom.azimuth_rad, boom.elevation_rad, 0.0)
    T_tanker_boom = SE3(R_tanker_boom, boom.pivot_tanker_m)
    right, left = (
        T_tanker_boom @ SE3(rotation_from_euler(0.0, 0.0, roll) @ rotation_from_euler(0.0, angle, 0.0), HINGE_BOOM_M)
        for roll, angle in zip((-DIHEDRAL_RAD, DIHEDRAL_RAD), boom.ruddevators_rad, strict=True)
    )
    return T_tanker_boom, SE3(R_tanker_boom, boom.tip_tanker_m()), right, left
