"""What of each light can be seen: truth for scoring and for choosing a marker map."""

from __future__ import annotations

import numpy as np

from companion.config import CameraConfig, TankerConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import T_frd_cam, normalised_to_pixels
from sim_bridge.scene import lights
from sim_bridge.scene.air import Air
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.drawing import Triangles, pinhole_of
from sim_bridge.scene.light import illumination
from sim_bridge.scene.rasterizer import NEAR_M
from sim_bridge.scene.tanker_parts import tanker_parts, tanker_poses
from sim_bridge.truth import BoomState

RAYS = 64
FINE = 32
"""Triangles that no sample of a grid this fine per pixel hits are left out: they hide nothing that counts."""


def marker_visibility(camera: CameraConfig, tanker: TankerConfig, T_ned_tanker: SE3, T_ned_frd: SE3,
                      boom: BoomState) -> Vec:
    """Return for each marker of the map (n,) the share 0..1 of its disc that is in the picture and not hidden."""
    points = np.array([m.p_tanker_m for m in tanker.markers], dtype=np.float64)
    return sphere_visibility(camera, points, tanker.marker_radius_m, T_ned_tanker, T_ned_frd, boom)


def sphere_visibility(camera: CameraConfig, points_tanker: Mat, radius_m: float, T_ned_tanker: SE3, T_ned_frd: SE3,
                      boom: BoomState) -> Vec:
    """Return the visible share (n,) of spheres at ``points_tanker`` (n, 3) in m, by RAYS rays to each."""
    T_ned_cam = T_ned_frd @ T_frd_cam(camera)
    pinhole, triangles = pinhole_of(camera), tanker_triangles()
    count = triangles.place(pinhole, FINE, tanker_poses(T_ned_tanker, boom), T_ned_cam)
    centres = (T_ned_cam.inverse() @ T_ned_tanker).transform(points_tanker)
    disc, lens = unit_disc(RAYS), pinhole.sample_lens(FINE)
    shares = np.zeros(len(centres))
    seen = np.empty(RAYS, np.uint8)
    for i, c in enumerate(centres):
        if c[2] <= radius_m + NEAR_M:
            continue
        sphere = np.append(c, radius_m)
        lights.sphere_visibility(triangles.table, triangles.box, count, sphere, lens, disc, seen)
        uv = normalised_to_pixels(camera, (c[:2] + radius_m * disc) / c[2])
        size = np.array([camera.width_px, camera.height_px])
        shares[i] = np.mean(np.all((uv > -0.5) & (uv < size - 0.5), axis=1) & (seen == 1))
    return shares


def tanker_triangles() -> Triangles:
    """Return the tanker's triangles by day, for depth alone."""
    light = illumination(PictureConditions())
    return Triangles(*tanker_parts(), light, Air(light, np.random.default_rng(0)))


def unit_disc(count: int) -> Mat:
    """Return points (count, 2) spread evenly over the unit circle (sunflower)."""
    k = np.arange(count)
    angle, radius = k * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt((k + 0.5) / count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
