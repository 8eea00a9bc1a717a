"""What the lens scatters of the sun over the whole picture.

The veil falls off with the square of the angle to the sun, as in the Stiles-Holladay formula (CIE 31, 1976), and is
even within CORE_RAD of it; it goes out as the airframe covers the sun, and is there too while the sun is just outside
of the picture.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig
from companion.geometry import SE3, Mat
from companion.vision.camera import pixels_to_normalised
from sim_bridge.scene import lights
from sim_bridge.scene.light import Illumination
from sim_bridge.scene.rasterizer import F64, I32
from sim_bridge.scene.sky import SUN_DISC_RAD
from sim_bridge.scene.visibility import unit_disc

GRID_PX = 8
REFERENCE_RAD, CORE_RAD = math.radians(10.0), math.radians(1.5)
LEAST_AHEAD = 0.17
"""Cosine of the angle to the axis below which the sun is beside the lens and no longer in it."""

FAR_M = 1e5
RAYS = 32


class Glare:
    """The veil of one camera; ``level`` full scales 10 degrees from an unhidden default sun."""

    def __init__(self, camera: CameraConfig, light: Illumination, level: float) -> None:
        self._size = (camera.width_px, camera.height_px)
        self._light, self._colour = light, 255.0 * level * light.scale * light.rest * light.sun
        u, v = (np.linspace(0.5 * n / k - 0.5, n - 0.5 - 0.5 * n / k, k) for n, k in
                ((n, max(2, n // GRID_PX)) for n in self._size))
        places = np.stack(np.meshgrid(u, v), axis=2)
        rays = pixels_to_normalised(camera, places.reshape(-1, 2)).reshape(places.shape)
        self._rays = np.dstack([rays, np.ones(rays.shape[:2])])
        self._rays /= np.sqrt(np.sum(self._rays**2, axis=2))[..., None]

    def visible_share(self, tri: F64, box: I32, count: int, sample_lens: F64, T_ned_cam: SE3) -> float:
        """Return the share of the sun's disc that no triangle of the table hides, 0 when it is beside the lens."""
        to_sun = T_ned_cam.R.T @ self._light.sun_ned
        if to_sun[2] < LEAST_AHEAD:
            return 0.0
        seen = np.empty(RAYS, np.uint8)
        sphere = np.append(FAR_M * to_sun, FAR_M * SUN_DISC_RAD)
        lights.sphere_visibility(tri, box, count, sphere, sample_lens, unit_disc(RAYS), seen)
        return float(seen.mean())

    def lay_over(self, picture: NDArray[np.uint8], share: float, T_ned_cam: SE3) -> NDArray[np.uint8]:
        """Return the exposed picture (h, w, 3) with the veil of ``share`` of the sun over it."""
        if share == 0.0:
            return picture
        veil = np.float32(share) * self._veil(T_ned_cam.R).astype(np.float32)
        return np.asarray(cv2.add(picture, cv2.resize(veil, self._size), dtype=cv2.CV_8U), dtype=np.uint8)

    def _veil(self, R_ned_cam: Mat) -> Mat:
        """Return the veil of the whole sun on the coarse grid (m, n, 3), in steps of 1/255."""
        away = np.arccos(np.clip(self._rays @ (R_ned_cam.T @ self._light.sun_ned), -1.0, 1.0))
        return (REFERENCE_RAD / np.maximum(away, CORE_RAD))[..., None] ** 2 * self._colour
