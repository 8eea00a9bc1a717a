"""Red and bright things that are no markers: navigation lights, glints and paint on the tanker, and hot pixels.

Rules
-----
* Glows are small spheres of some radiance, in full scales, and pass through the same lens as the markers.
* Navigation lights are red on the left wing tip, green on the right one and white on the tail cone, as on every
  aircraft; theirs are drawn with the radiance of the markers at half their radius, so that only their place tells.
* Glints are rows of spheres along edges that the sun could catch, white inside and orange at their ends.
* Nothing of it is within 1 m of a marker of the shipped map, so that the two stay apart at 320x200 too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from sim_bridge.scene.meshing import Mesh
from sim_bridge.scene.tanker_mesh import belly_strip, wing_station

RED_PAINT = (0.62, 0.05, 0.06)
NAVIGATION_RADIUS_M = 0.05
GLINT_RADIUS_M = 0.045
GLINT_STEP_M = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Glow:
    """Spheres of one colour: ``places_tanker_m`` (n, 3), ``radius_m``, ``radiance`` (3,) in full scales."""

    places_tanker_m: Mat
    radius_m: float
    radiance: Vec


def glows(clutter: Sequence[str]) -> list[Glow]:
    """Return what glows for the kinds of clutter asked for."""
    found = []
    if "navigation" in clutter:
        found += navigation_lights()
    if "glint" in clutter:
        found += glints()
    return found


def navigation_lights() -> list[Glow]:
    """Return the lights at both wing tips and the tail."""
    lead, _, z = wing_station(19.94)
    lights = [
        ((lead - 0.7, -20.0, z), (4.0, 0.12, 0.12)),
        ((lead - 0.7, 20.0, z), (0.12, 4.0, 0.8)),
        ((-20.98, 0.0, -1.18), (4.0, 4.0, 4.0)),
    ]
    return [Glow(np.array([place]), NAVIGATION_RADIUS_M, np.array(colour)) for place, colour in lights]


def glints() -> list[Glow]:
    """Return streaks on cowls and flap track fairings: orange at both ends, white between."""
    inner: list[tuple[float, float, float]] = []
    outer: list[tuple[float, float, float]] = []
    for y, steps in ((14.1, 9), (-14.1, 13), (6.2, 5), (-4.2, 7)):
        lead, trail, z = wing_station(abs(y))
        x, down = (lead + 1.6, z + 1.66 + 1.21) if abs(y) > 14 else (trail + 0.3, z + 0.28 + 0.23)
        for k in range(steps):
            place = (x + GLINT_STEP_M * (k - 0.5 * (steps - 1)), y, down)
            (outer if k in {0, steps - 1} else inner).append(place)
    return [
        Glow(np.array(outer), GLINT_RADIUS_M, np.array([5.0, 2.2, 0.8])),
        Glow(np.array(inner), GLINT_RADIUS_M, np.array([12.0, 10.0, 7.0])),
    ]


def red_paint() -> list[Mesh]:
    """Return a red line and two rows of red letters, as blocks, on the belly."""
    ahead = [belly_strip(x, x - 0.30, 0.95, 0.15, RED_PAINT) for x in (16.6, 15.9, 15.2, 14.5, 13.8)]
    aft = [belly_strip(x, x - 0.30, -1.15, 0.15, RED_PAINT) for x in (-8.3, -9.1, -9.9, -10.7, -11.5)]
    return [belly_strip(-8.2, -11.4, 1.15, 0.12, RED_PAINT), *ahead, *aft]


def hot_pixels(rng: np.random.Generator, count: int, height: int, width: int) -> NDArray[np.int64]:
    """Return ``count`` different places (count, 2), row and column."""
    flat = rng.choice(height * width, size=min(count, height * width), replace=False)
    return np.column_stack(np.divmod(flat, width))
