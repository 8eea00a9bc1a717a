"""The poses that a camera goes through while its shutter is open.

Rules
-----
* A picture is stamped mid-exposure. Both aircraft move on as they do then, with constant velocity and turn rate; the
  boom keeps its angles (its tip moves by less than a tenth of what the camera turns by).
* One pose will do while nothing moves by more than STEP_PX: a smear of that width widens what the lens makes of a
  point by three parts in a hundred. Beyond, there are as many poses, evenly spread, as keep their distance below it.
* A mount that shakes turns the camera by a sum of tones about ``vibration_hz``, the same for the same seed.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, Vec, exp_so3
from companion.vision.camera import T_frd_cam
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.truth import BodyState

STEP_PX = 0.5
MOST = 16
TONES = 8
REACH_M = 25.0
"""No part of the tanker that matters is farther from its centre of mass."""

NEAREST_M = 5.0
OFF_AXIS = 1.6
"""A turn moves a point by this times the focal length at most, 38 degrees off the axis."""


class Vibration:
    """Angles of a shaking mount: TONES of random phase per axis, from half to one and a half times ``hz``."""

    def __init__(self, rms_rad: float, hz: float, rng: np.random.Generator) -> None:
        self.rms_rad = rms_rad
        self._omega = 2.0 * math.pi * hz * rng.uniform(0.5, 1.5, (3, TONES))
        self._phase = rng.uniform(0.0, 2.0 * math.pi, (3, TONES))

    def turn(self, t_s: float) -> Mat:
        """Return R_cam_shaken, the camera's turn at an instant."""
        angles = self.rms_rad * math.sqrt(2.0 / TONES) * np.sin(self._omega * t_s + self._phase).sum(axis=1)
        return exp_so3(angles)


class Shutter:
    """Finds the poses of one camera."""

    def __init__(self, camera: CameraConfig, points_tanker: Mat, conditions: PictureConditions,
                 rng: np.random.Generator) -> None:
        """Watch the motion of ``points_tanker`` (n, 3)."""
        self._exposure_s, self._focal_px = camera.exposure_s, max(camera.fx_px, camera.fy_px)
        self._T_frd_cam, self._points = T_frd_cam(camera), points_tanker
        rms_rad, hz = conditions.vibration_rad, conditions.vibration_hz
        self._vibration = Vibration(rms_rad, hz, rng) if rms_rad > 0.0 else None

    def poses(self, tanker: BodyState, uav: BodyState) -> list[tuple[SE3, SE3]]:
        """Return (T_ned_tanker, T_ned_cam) for each instant, in order; the middle of them is mid-exposure."""
        middle = (tanker.T_ned_body(), self._camera(uav, 0.0))
        if self._exposure_s == 0.0 or (self._vibration is None and self._bound_px(tanker, uav) <= STEP_PX):
            return [middle]
        ends = [self._at(tanker, uav, s * self._exposure_s) for s in (-0.5, 0.5)]
        count = math.ceil(self._travel_px([ends[0], middle, ends[1]]) / STEP_PX)
        if count <= 1:
            return [middle]
        count = min(count, MOST)
        return [self._at(tanker, uav, ((k + 0.5) / count - 0.5) * self._exposure_s) for k in range(count)]

    def _at(self, tanker: BodyState, uav: BodyState, offset_s: float) -> tuple[SE3, SE3]:
        return carried_on(tanker, offset_s), self._camera(uav, offset_s)

    def _camera(self, uav: BodyState, offset_s: float) -> SE3:
        T_ned_cam = carried_on(uav, offset_s) @ self._T_frd_cam
        if self._vibration is None:
            return T_ned_cam
        return SE3(T_ned_cam.R @ self._vibration.turn(1e-9 * uav.t_ns + offset_s), T_ned_cam.t)

    def _bound_px(self, tanker: BodyState, uav: BodyState) -> float:
        """Return more than anything of the tanker moves by in the picture; cheap."""
        away, drift = tanker.p_ned_m - uav.p_ned_m, tanker.v_ned_m_s - uav.v_ned_m_s
        turn, tanker_turn = length(uav.omega_body_rad_s), length(tanker.omega_body_rad_s)
        speed = length(drift) + REACH_M * tanker_turn + length(self._T_frd_cam.t) * turn
        near = max(length(away) - REACH_M, NEAREST_M)
        return self._exposure_s * self._focal_px * (OFF_AXIS * turn + speed / near)

    def _travel_px(self, poses: list[tuple[SE3, SE3]]) -> float:
        """Return how far the point that moves most goes from pose to pose."""
        places = [(T_ned_cam.inverse() @ T_ned_tanker).transform(self._points) for T_ned_tanker, T_ned_cam in poses]
        ahead = np.all([p[:, 2] > 1.0 for p in places], axis=0)
        if not ahead.any():
            return 0.0
        uv = np.array([self._focal_px * p[ahead, :2] / p[ahead, 2:] for p in places])
        return float(np.sqrt(np.sum(np.diff(uv, axis=0) ** 2, axis=2)).sum(axis=0).max())


def carried_on(body: BodyState, offset_s: float) -> SE3:
    """Return T_ned_body ``offset_s`` later, or earlier, with constant velocity and turn rate."""
    if offset_s == 0.0:
        return body.T_ned_body()
    R = body.R_ned_body @ exp_so3(body.omega_body_rad_s * offset_s)
    return SE3(R, body.p_ned_m + body.v_ned_m_s * offset_s)


def length(v: Vec) -> float:
    """Return the length of a vector (3,)."""
    return math.hypot(v[0], v[1], v[2])
