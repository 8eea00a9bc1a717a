"""Haze and cloud between the camera and what it looks at.

Rules
-----
* What is left of a radiance after d metres is ``kept`` exp(-extinction d density); the rest is the air's own radiance.
* ``kept`` is haze that is the same for everything. Cloud has wisps: its density is one plus a sum of plane waves that
  stand still in the air and are flown through, taken half way to what is looked at (a mean along the way would cost a
  hundred times more and look the same).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.geometry import SE3, Mat, Vec
from sim_bridge.scene.light import Illumination
from sim_bridge.scene.rasterizer import transmission

WAVES = 6
LONGEST_M, SHORTEST_M = 900.0, 60.0
DEPTH = 0.45
"""RMS of the density about its mean (estimated: thin stratus is torn)."""


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """Plane waves of density in north-east-down: ``vectors`` (n, 3) rad/m, ``phases`` (n,), ``amplitudes`` (n,)."""

    vectors: Mat
    phases: Vec
    amplitudes: Vec


def draw_waves(rng: np.random.Generator) -> Waves:
    """Return waves of all lengths from LONGEST_M to SHORTEST_M; longer ones are higher, as in turbulence."""
    lengths = np.geomspace(LONGEST_M, SHORTEST_M, WAVES)
    directions = rng.standard_normal((WAVES, 3))
    directions /= np.sqrt(np.sum(directions**2, axis=1))[:, None]
    amplitudes = lengths ** (1.0 / 3.0)
    amplitudes *= DEPTH * math.sqrt(2.0) / np.sqrt(np.sum(amplitudes**2))
    return Waves(directions * (2.0 * math.pi / lengths)[:, None], rng.uniform(0.0, 2.0 * math.pi, WAVES), amplitudes)


class Air:
    """The air of one scenario, for ``rasterizer.light_vertices``."""

    def __init__(self, light: Illumination, rng: np.random.Generator) -> None:
        """Draw the wisps from ``rng`` when there is cloud."""
        self._share = np.array([light.kept, light.cloud_per_m, *light.air])
        self._waves = draw_waves(rng) if light.cloud_per_m > 0.0 else Waves(np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    def seen_from(self, T_ned_cam: SE3) -> tuple[Vec, Mat]:
        """Return (kept, extinction, radiance of the air; (5,)) and the waves (n, 5) in camera axes.

        A wave's row is its vector, its phase at the camera and its amplitude.
        """
        w = self._waves
        if len(w.phases) == 0:
            return self._share, np.zeros((0, 5))
        phases = np.mod(w.vectors @ T_ned_cam.t + w.phases, 2.0 * math.pi)
        return self._share, np.column_stack([w.vectors @ T_ned_cam.R, phases, w.amplitudes])

    def left_of(self, points_cam: Mat, T_ned_cam: SE3) -> Vec:
        """Return what is left (n,) of the radiance of ``points_cam`` (n, 3)."""
        share, waves = self.seen_from(T_ned_cam)
        if share[1] == 0.0:
            return np.full(len(points_cam), share[0])
        return np.array([transmission(p[0], p[1], p[2], share, waves) for p in points_cam])
