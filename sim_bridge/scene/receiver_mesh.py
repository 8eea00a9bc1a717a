"""The receiver: a tailless delta like the ICE-101, for the 3D view and the boom operator's.

Rules
-----
* Body axes ``frd``: forward, right, down in m. 13 m long, 11.4 m span, 65 degrees of sweep; thickness is estimated.
* Control surfaces are painted where thesis Fig. 3.3 has them, and do not move.
* The receptacle is a dark square on the back at [2, 0, -1] m, between white lines that lead the boom to it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from companion.geometry import Mat, Vec
from sim_bridge.scene.meshing import Mesh, aerofoil, loft, merge
from sim_bridge.scene.paints import BLACK, DARK, METAL, STEALTH, WHITE

SPAN_Y = np.array([0.0, 0.35, 0.7, 1.1, 1.6, 2.3, 3.0, 4.0, 5.0, 5.7])
PANEL = (0.27, 0.30, 0.33)
EDGE = (0.42, 0.45, 0.48)

LEADING_FLAP = ((2.9, 1.75), (2.3, 1.75), (-4.05, 4.75), (-3.65, 4.75))
TRAILING_FLAP = ((-4.1, 2.0), (-4.95, 2.0), (-5.45, 4.0), (-4.55, 4.0))
PITCH_FLAP = ((-4.6, 0.75), (-5.6, 0.75), (-5.0, 1.9), (-4.1, 1.9))
SPOILER = ((-1.6, 1.9), (-2.5, 1.9), (-3.4, 3.6), (-2.7, 3.6))
EXHAUST = ((-4.7, -0.55), (-5.85, -0.55), (-5.85, 0.55), (-4.7, 0.55))
LEAD_LINE = ((5.2, 0.60), (2.7, 0.30), (2.7, 0.42), (5.2, 0.72))
"""Outlines on the right half of the back, x and y in m; ``EXHAUST`` and the lead line's middle are symmetric."""


def edges(y: Vec) -> tuple[Vec, Vec, Vec]:
    """Return leading and trailing edge x and how far the body swells (0..1) at span stations |y|."""
    lead = 7.0 - np.tan(np.radians(65.0)) * y * np.clip(0.55 + y / 2.0, 0.0, 1.0)
    trail = np.interp(y, [0.0, 2.6, 4.6, 5.7], [-6.0, -4.9, -5.8, -5.3])
    lead = np.where(y >= SPAN_Y[-1], trail + 0.25, lead)
    return lead, trail, np.exp(-((y / 1.0) ** 2))


def section(y: float) -> Mat:
    """Return the closed section (13, 3) of the right half at span station y >= 0: lower side, edge, upper side."""
    lead, trail, hump = (float(v) for v in edges(np.array(y)))
    return aerofoil(np.array([lead, y, 0.05]), lead - trail, 0.05 + 0.105 * hump, 0.004 * hump)


def back_z(x: Vec, y: Vec) -> Vec:
    """Return the height z of the mesh's upper skin (n,) at places inside the outline, straight between its sections."""
    skin = [section(float(s))[6:] for s in SPAN_Y]  # from the leading edge to the trailing one
    heights = np.array([np.interp(-x, -s[:, 0], s[:, 2]) for s in skin])
    return np.array([np.interp(abs(v), SPAN_Y, heights[:, k]) for k, v in enumerate(y)])


def patch(outline: tuple[tuple[float, float], ...], paint: tuple[float, float, float], rise_m: float = 0.03,
          steps: int = 8) -> Mesh:
    """Return a plate on the back over four corners (x, y), ``rise_m`` proud of the skin."""
    a, b, c, d = (np.array(p) for p in outline)
    across = np.linspace(0.0, 1.0, steps + 1)[:, None]
    rings = []
    for s in across[:, 0]:
        xy = (1.0 - across) * (a + s * (b - a)) + across * (d + s * (c - d))
        z = back_z(xy[:, 0], xy[:, 1])
        rings.append(np.concatenate([np.column_stack([xy, z - rise_m]), np.column_stack([xy, z + 0.05])[::-1]]))
    return loft(np.stack(rings), paint)


def smooth_ridge(half: Mesh) -> Mesh:
    """Return the half with normals in the plane of symmetry where it meets the other one, so that no edge shows."""
    normals = half.normals.copy()
    seam = (np.abs(half.vertices[:, 1]) < 1e-9) & (np.abs(normals[:, 1]) < 0.9)
    normals[seam, 1] = 0.0
    normals[seam] /= np.sqrt(np.sum(normals[seam] ** 2, axis=1))[:, None]
    return Mesh(half.vertices, half.triangles, half.colours, normals)


@lru_cache(maxsize=1)
def uav_mesh() -> Mesh:
    """Return the receiver in ``frd`` axes."""
    right = loft(np.stack([section(float(y)) for y in SPAN_Y]), STEALTH)
    plates = [
        patch(LEADING_FLAP, EDGE), patch(TRAILING_FLAP, PANEL), patch(PITCH_FLAP, PANEL), patch(SPOILER, PANEL),
        patch(LEAD_LINE, WHITE),
    ]
    square = np.array([[-0.25, -1.06], [0.25, -1.06], [0.25, -0.6], [-0.25, -0.6]])
    receptacle = loft(np.stack([np.column_stack([np.full(4, x), square]) for x in (2.3, 1.7)]), DARK)
    well = np.array([[-0.12, -1.075], [0.12, -1.075], [0.12, -0.9], [-0.12, -0.9]])
    slot = loft(np.stack([np.column_stack([np.full(4, x), well]) for x in (2.15, 1.85)]), BLACK)
    halves = [smooth_ridge(right), *plates]
    return merge([*halves, *(h.mirrored() for h in halves), patch(EXHAUST, METAL), receptacle, slot])
