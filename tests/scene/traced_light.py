"""Pictures of lights by Embree: an oracle for centroids that shares nothing with the rasterizer but mesh and colours.

A window about each light is traced with FINE by FINE rays to a pixel, in floating point and without a limit of
brightness; lens (a Gaussian on everything), exposure and clipping come afterwards, as in a camera.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from tanker_scene import CONTACT, START, Scene, Tracer

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import normalised_to_pixels, pixels_to_normalised
from sim_bridge.scene import rasterizer as kernels
from sim_bridge.scene.camera_picture import CLEAR_DAY, LIGHT, SPREAD_PX
from sim_bridge.scene.light import illumination
from sim_bridge.scene.tanker_parts import tanker_parts, tanker_poses

FINE = 16
HALF = 10
SKY = np.array([0.42, 0.60, 0.86])


class LightTracer:
    """Traces windows about the lights of one scene."""

    def __init__(self, scene: Scene, tracer: Tracer) -> None:
        self.scene, self.tracer = scene, tracer
        mesh, part = tanker_parts()
        T_ned_part = tanker_poses(scene.T_ned_tanker, scene.boom)
        T = np.stack([T_part.as_matrix()[:3] for T_part in T_ned_part])
        R_ned = np.stack([T_part.R for T_part in T_ned_part])
        self.rgb = np.empty_like(mesh.vertices)
        kernels.light_vertices(
            mesh.vertices, mesh.normals, mesh.colours, part, T, R_ned, illumination(CLEAR_DAY).lit_by,
            np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.zeros((0, 5)), np.empty_like(mesh.vertices), self.rgb
        )

    def background(self, origin: Vec, rays: Mat) -> tuple[Vec, Mat]:
        """Return distance (n,) and colour (n, 3) of what each ray meets: airframe, boom or sky."""
        mesh, _ = tanker_parts()
        origins = np.tile(origin, (len(rays), 1)).astype(np.float32)
        hit = self.tracer.scene.run(origins, rays.astype(np.float32), output=True)
        met = hit["primID"] >= 0
        corners = self.rgb[mesh.triangles[np.where(met, hit["primID"], 0)]]
        u, v = hit["u"][:, None], hit["v"][:, None]
        colour = (1.0 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        return np.where(met, hit["tfar"], np.inf), np.where(met[:, None], colour, SKY)

    def radiance(self, camera: CameraConfig, T_tanker_cam: SE3, left: int, top: int) -> Mat:
        """Return linear radiance (n, n, 3) of the window whose first pixel is (left, top), lens included."""
        size = (2 * HALF + 1) * FINE
        fine = (np.arange(size) + 0.5) / FINE - 0.5
        v, u = np.meshgrid(top + fine, left + fine, indexing="ij")
        flat = pixels_to_normalised(camera, np.column_stack([u.ravel(), v.ravel()]))
        rays = np.column_stack([flat, np.ones(len(flat))])
        nearest, colour = self.background(T_tanker_cam.t, rays @ T_tanker_cam.R.T)
        r = self.scene.tanker.marker_radius_m
        for c in T_tanker_cam.inverse().transform(self.scene.markers()):
            dc, dd = rays @ c, np.einsum("ij,ij->i", rays, rays)
            under = dc**2 - dd * (c @ c - r * r)
            meets = (under > 0) & ((dc - np.sqrt(np.maximum(under, 0.0))) / dd < nearest)
            colour[meets] = LIGHT
        picture = colour.reshape(size, size, 3)
        blurred = cv2.GaussianBlur(picture, (0, 0), SPREAD_PX * FINE, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred).reshape(2 * HALF + 1, FINE, 2 * HALF + 1, FINE, 3).mean(axis=(1, 3))

    def centres_px(self, camera: CameraConfig, T_cam_tanker: SE3) -> Mat:
        """Return the projections (n, 2) of the lights' centres."""
        c = T_cam_tanker.transform(self.scene.markers())
        return normalised_to_pixels(camera, c[:, :2] / c[:, 2:])


def expose(
    radiance: Mat, rng: np.random.Generator, gain: float = 1.0, noise: float = CLEAR_DAY.noise
) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) uint8 that a sensor of this gain and noise takes of ``radiance``."""
    clean = np.clip(np.round(255.0 * gain * radiance), 0, 255)
    return np.clip(np.round(clean + noise * rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)


def poses_on_the_way(scene: Scene, rng: np.random.Generator, count: int) -> list[SE3]:
    """Return places between start and contact, some off the path and turned a little."""
    along = rng.uniform(0.0, 1.0, count)
    return [
        scene.T_ned_frd(START + s * (CONTACT - START) + rng.normal(0, 0.5, 3), *rng.normal(0, 0.02, 3)) for s in along
    ]


def windows(tracer: LightTracer, camera: CameraConfig, poses: list[SE3]) -> tuple[list[Mat], Mat, Vec]:
    """Return radiance windows of all lights well inside the picture, (n, 4) first pixel and centre, and z in m."""
    pictures, centres, depths = [], [], []
    size = np.array([camera.width_px, camera.height_px])
    for T_ned_frd in poses:
        T = tracer.scene.T_cam_tanker(camera, T_ned_frd)
        z = T.transform(tracer.scene.markers())[:, 2]
        for p, depth in zip(tracer.centres_px(camera, T), z, strict=True):
            if np.all((p > HALF + 1) & (p < size - HALF - 2)):
                left, top = (round(float(c)) - HALF for c in p)
                pictures.append(tracer.radiance(camera, T.inverse(), left, top))
                centres.append((left, top, *p))
                depths.append(depth)
    return pictures, np.array(centres), np.array(depths)
