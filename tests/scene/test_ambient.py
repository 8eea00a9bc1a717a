from __future__ import annotations

import numpy as np

from sim_bridge.scene.ambient import DARKEST, shade_recesses
from sim_bridge.scene.meshing import Mesh, merge, revolution

X = np.linspace(3.0, -3.0, 25)


def egg(z: float) -> Mesh:
    """Return a convex body 6 m long and 2 m thick at height z, painted white."""
    return revolution(list(X), list(np.sqrt(np.maximum(1.0 - (X / 3.0) ** 2, 1e-4))), (0.0, z), 24, (1.0, 1.0, 1.0))


def test_a_convex_body_shades_nothing_of_itself() -> None:
    assert shade_recesses(egg(0.0)).colours.min() > 0.95


def test_bodies_darken_the_sides_that_face_each_other() -> None:
    pair = shade_recesses(merge([egg(-1.2), egg(1.2)]))
    upper = pair.vertices[:, 2] < 0
    inward = np.where(upper, pair.normals[:, 2], -pair.normals[:, 2])
    near = (inward > 0.9) & (np.abs(pair.vertices[:, 0]) < 0.6)
    assert DARKEST - 1e-9 <= pair.colours[near].mean() < 0.75
    assert pair.colours[inward < -0.5].min() > 0.95
