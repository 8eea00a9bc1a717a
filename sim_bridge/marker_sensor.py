"""A camera that hands over detections instead of pictures: for flights in numbers, where drawing would take the time.

Rules
-----
* Markers are projected truly, through the camera's lens at mid-exposure; what is behind the camera or outside the
  picture is not seen. Nothing hides a marker: the boom does so in pictures only.
* A centroid has Gaussian noise, independent from marker to marker and frame to frame, and its ``sigma_px`` says so.
* The order of the detections says nothing of whose they are: it is that of the picture's rows, as detection gives it.
* Rate and latency are the camera's.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from companion.config import ConfigError, Setup
from companion.geometry import SE3, Mat
from companion.messages import Detections, MarkerFrame
from companion.vision.camera import NEAREST_M, T_frd_cam, normalised_to_pixels
from sim_bridge.sensor_conditions import MarkerSensorConditions
from sim_bridge.truth import Truth

HALO_PX = 0.9
"""By how much the radius of a light's lit pixels exceeds that of its outline: lens, clipping and whole pixels; measured
with the thesis camera in one flight (seed 1003), from 10 to 60 m."""


class MarkerCamera:
    """Exposes at the camera's rate, delivers detections after its latency."""

    def __init__(self, setup: Setup, rng: np.random.Generator, conditions: MarkerSensorConditions) -> None:
        """Take the generator that only this camera uses.

        Raises ConfigError for a companion that looks for corners: markers are all that is detected here.
        """
        detector = setup.config.vision.detector
        if detector != "lights":
            msg = (f'vision_input = "detections" gives lights, and vision.detector is "{detector}"; '
                   'use vision_input = "pictures", or --detector lights')
            raise ConfigError(msg)
        self._camera, self._rng, self._conditions = setup.camera, rng, conditions
        self._markers = np.array([m.p_tanker_m for m in setup.tanker.markers], dtype=np.float64)
        self._reach_px_m = setup.tanker.marker_radius_m * math.sqrt(setup.camera.fx_px * setup.camera.fy_px)
        self._T_cam_frd = T_frd_cam(setup.camera).inverse()
        self._size = np.array([setup.camera.width_px, setup.camera.height_px])
        self._period_ns = round(1e9 / setup.camera.rate_hz)
        self._latency_ns = round(setup.camera.latency_s * 1e9)
        self._next_ns = 0
        self._sequence = 0
        self._under_way: deque[MarkerFrame] = deque()

    def expose(self, truth: Truth, lights: Mat | None = None) -> None:
        """Look if it is time to; ``lights`` (n, 3), tanker axes: where they are when not where they belong."""
        if truth.t_ns < self._next_ns:
            return
        self._next_ns += self._period_ns
        T_cam_tanker = self._T_cam_frd @ truth.uav.T_ned_body().inverse() @ truth.tanker.T_ned_body()
        self._under_way.append(MarkerFrame(truth.t_ns, self._sequence, self.detect(truth.t_ns, T_cam_tanker, lights)))
        self._sequence += 1

    def delivered(self, t_ns: int) -> list[MarkerFrame]:
        """Return what has arrived by ``t_ns``, in the order of exposure."""
        frames = []
        while self._under_way and self._under_way[0].t_ns + self._latency_ns <= t_ns:
            frames.append(self._under_way.popleft())
        return frames

    def detect(self, t_ns: int, T_cam_tanker: SE3, lights: Mat | None = None) -> Detections:
        """Return the markers that are seen from there; draws the same share of chance whatever is seen."""
        n, sigma_px = len(self._markers), self._conditions.sigma_px
        p_cam_m = T_cam_tanker.transform(self._markers if lights is None else lights)
        depth_m = np.where(p_cam_m[:, 2] > NEAREST_M, p_cam_m[:, 2], np.nan)
        uv_px = normalised_to_pixels(self._camera, p_cam_m[:, :2] / depth_m[:, None])
        uv_px += sigma_px * self._rng.standard_normal((n, 2))
        kept = self._rng.random(n) >= self._conditions.dropout
        seen = np.flatnonzero(kept & ((uv_px > -0.5) & (uv_px < self._size - 0.5)).all(axis=1))
        seen = seen[np.argsort(uv_px[seen, 1], kind="stable")]
        area_px = np.round(np.pi * (self._reach_px_m / depth_m[seen] + HALO_PX) ** 2)
        return Detections(t_ns, uv_px[seen], area_px, np.full(len(seen), sigma_px), np.zeros(len(seen), dtype=np.uint8))
