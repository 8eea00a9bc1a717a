"""What the boom operator sees (thesis Fig. 2.6): boom, receiver and what lies below, from under the tanker's tail.

A window in the belly ahead of the boom's pivot, looking aft and down along the boom. It is for people: the picture is
gamma-coded, and has neither noise nor lens.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig
from companion.geometry import SE3
from companion.vision.camera import T_frd_cam
from sim_bridge.scene.air import Air
from sim_bridge.scene.ambient import shade_recesses
from sim_bridge.scene.background import pack_sky
from sim_bridge.scene.boom_mesh import boom_mesh, boom_poses
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.drawing import Canvas, Triangles, pinhole_of
from sim_bridge.scene.light import illumination
from sim_bridge.scene.receiver_mesh import uav_mesh
from sim_bridge.scene.sky import make_sky
from sim_bridge.scene.tanker_parts import in_parts
from sim_bridge.truth import BoomState

WINDOW = CameraConfig(
    name="operator", width_px=640, height_px=480, rate_hz=2.0, fx_px=470.0, fy_px=470.0, cx_px=319.5, cy_px=239.5,
    p_frd_cam_m=(-14.6, 0.0, 3.2), mount_yaw_rad=np.pi, mount_pitch_rad=-0.45,
)
"""As a camera in tanker axes: the lower edge of the operator's window, 1.6 m ahead of the pivot and under it."""

GAMMA = 2.2


def operator_view(conditions: PictureConditions, seed: int) -> OperatorView | None:
    """Return the view that these conditions ask to be recorded, None when they do not."""
    return OperatorView(conditions, np.random.default_rng(seed)) if conditions.operator_view else None


class OperatorView:
    """Draws the operator's view; keep one, its buffers are used again."""

    def __init__(self, conditions: PictureConditions, rng: np.random.Generator, window: CameraConfig = WINDOW,
                 threads: int = 1) -> None:
        """Make sky and wisps of cloud from ``rng``; ``window`` in tanker axes where a camera has the receiver's."""
        light = illumination(conditions)
        self._pinhole, self._T_tanker_cam = pinhole_of(window), T_frd_cam(window)
        mesh, part = in_parts([shade_recesses(uav_mesh()), *boom_mesh()])
        triangles = Triangles(mesh, part, light, Air(light, rng.spawn(1)[0]))
        self._canvas = Canvas(self._pinhole, triangles, pack_sky(make_sky(rng, light)), threads)
        self._nothing = self._pinhole.place_spheres(np.zeros((0, 3)), np.zeros(0))
        code = 255.0 * (np.minimum(light.rest * np.arange(256.0), 255.0) / 255.0) ** (1.0 / GAMMA)
        self._code = np.round(code).astype(np.uint8)

    def render(self, T_ned_tanker: SE3, T_ned_uav: SE3, boom: BoomState) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3) uint8 RGB."""
        T_ned_boom = [T_ned_tanker @ T for T in boom_poses(boom)]
        T_ned_cam, mask = T_ned_tanker @ self._T_tanker_cam, np.zeros(0, np.uint8)
        picture = self._canvas.draw([T_ned_uav, *T_ned_boom], T_ned_cam, self._nothing, mask)
        return np.asarray(cv2.LUT(picture, self._code))
