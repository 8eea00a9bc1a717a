"""What a pinhole sees of triangles, spheres and sky: the drawing that the receiver's camera and others share.

The same arguments give the same bits, with any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, ConfigError
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import bends, pixels_to_normalised
from sim_bridge.scene import lights, tiles
from sim_bridge.scene import rasterizer as kernels
from sim_bridge.scene.air import Air
from sim_bridge.scene.background import U64
from sim_bridge.scene.light import Illumination
from sim_bridge.scene.meshing import Mesh

FINE = 12
"""Samples per pixel and axis of a sphere of up to FINE_RADIUS_PX; larger ones need fewer."""

FINE_RADIUS_PX = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Spheres:
    """Lights in one pinhole picture: centre and radius (n, 4), pixel bounds, samples per pixel, place in the mask."""

    centres: Mat
    box: NDArray[np.int32]
    fine: NDArray[np.int32]
    offset: NDArray[np.int32]
    samples: int


class Pinhole:
    """The undistorted picture that is drawn first: the camera's own, or one wide enough to bend into the camera's."""

    def __init__(self, camera: CameraConfig) -> None:
        self.width, self.height = camera.width_px, camera.height_px
        self.lens = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
        self.maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
        if bends(camera):
            self._widen(camera)

    def _widen(self, camera: CameraConfig) -> None:
        """Find where every pixel of the distorted picture looks, and make room for it."""
        u, v = np.meshgrid(np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px, dtype=np.float64))
        rays = pixels_to_normalised(camera, np.column_stack([u.ravel(), v.ravel()]))
        if np.isnan(rays).any():
            msg = f"camera {camera.name}: distortion has no inverse at the picture's corners; use smaller coefficients"
            raise ConfigError(msg)
        places = rays * self.lens[:2] + self.lens[2:]
        low = np.floor(places.min(axis=0)) - 2
        size = np.ceil(places.max(axis=0)) + 3 - low
        if size[0] * size[1] > 16 * camera.width_px * camera.height_px:
            msg = f"camera {camera.name}: distortion needs a 16 times larger picture; use smaller coefficients"
            raise ConfigError(msg)
        self.width, self.height = int(size[0]), int(size[1])
        self.lens[2:] -= low
        maps = (places - low).astype(np.float32).reshape(camera.height_px, camera.width_px, 2)
        self.maps = (np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1]))

    def sample_lens(self, ss: int) -> Vec:
        """Return fx, fy, cx, cy in units of samples, ``ss`` to a pixel, sample centres at integers."""
        return np.concatenate([self.lens[:2] * ss, (self.lens[2:] + 0.5) * ss - 0.5])

    def place_spheres(self, centres_cam: Mat, radii_m: Vec) -> Spheres:
        """Bound the lights that are ahead of the camera; bounds are empty (1, 0) for what is not in the picture."""
        box = np.empty((len(centres_cam), 4), np.int32)
        lights.bound_spheres(centres_cam, radii_m, self.lens, self.width, self.height, box)
        fine = np.where(radii_m * self.lens[0] < FINE_RADIUS_PX * centres_cam[:, 2], FINE, FINE // 3).astype(np.int32)
        sizes = (box[:, 1] - box[:, 0] + 1) * (box[:, 3] - box[:, 2] + 1) * fine * fine
        ends = np.cumsum(sizes)
        spheres = np.column_stack([centres_cam, radii_m])
        return Spheres(spheres, box, fine, (ends - sizes).astype(np.int32), int(sizes.sum()))


@lru_cache(maxsize=8)
def pinhole_of(camera: CameraConfig) -> Pinhole:
    """Return the camera's pinhole picture; finding it for a distorted camera is slow."""
    return Pinhole(camera)


class Triangles:
    """The table of the triangles in view of a mesh in parts, and the buffers behind it."""

    def __init__(self, mesh: Mesh, part: NDArray[np.int32], light: Illumination, air: Air) -> None:
        """Take a mesh and the part (n,) of each vertex."""
        self._mesh, self._part, self._lit_by, self._air = mesh, part, light.lit_by, air
        self._xyz, self._rgb, self._screen = (np.empty_like(mesh.vertices) for _ in range(3))
        self.table = np.empty((2 * len(mesh.triangles), kernels.COLUMNS))
        self.box = np.empty((2 * len(mesh.triangles), 4), np.int32)

    def place(self, pinhole: Pinhole, ss: int, T_ned_parts: Sequence[SE3], T_ned_cam: SE3) -> int:
        """Light and place the parts before the camera, with ``ss`` samples per pixel; returns the rows filled."""
        mesh, T_cam_ned = self._mesh, T_ned_cam.inverse()
        R_ned, t_ned = np.stack([T.R for T in T_ned_parts]), np.stack([T.t for T in T_ned_parts])
        T = np.concatenate([T_cam_ned.R @ R_ned, (t_ned @ T_cam_ned.R.T + T_cam_ned.t)[:, :, None]], axis=2)
        kernels.light_vertices(mesh.vertices, mesh.normals, mesh.colours, self._part, T, R_ned, self._lit_by,
                               *self._air.seen_from(T_ned_cam), self._xyz, self._rgb)
        size = np.array([pinhole.width * ss, pinhole.height * ss], np.int32)
        lens = pinhole.sample_lens(ss)
        return int(kernels.set_up_triangles(self._xyz, self._rgb, mesh.triangles, lens, size, self._screen, self.table,
                                            self.box))


class Canvas:
    """Draws triangles over the sky in a pinhole's picture, by ``threads`` at once."""

    def __init__(self, pinhole: Pinhole, triangles: Triangles, sky: U64, threads: int) -> None:
        """Take the packed sky cube."""
        self._pinhole, self._triangles, self._sky = pinhole, triangles, sky
        self._pool = ThreadPoolExecutor(max_workers=threads - 1) if threads > 1 else None
        across, down = (-(-n // tiles.TILE) for n in (pinhole.width, pinhole.height))
        self._shares = [np.arange(k, down, threads, dtype=np.int32) for k in range(threads)]
        self._grid = (across, down)
        self.count = 0
        """Triangles in view in the picture that was drawn last."""

    def draw(self, T_ned_parts: Sequence[SE3], T_ned_cam: SE3, spheres: Spheres,
             mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3); fill ``mask`` with the samples of the spheres that nothing hides."""
        pinhole = self._pinhole
        self.count = self._triangles.place(pinhole, tiles.SS, T_ned_parts, T_ned_cam)
        tri, box = self._triangles.table, self._triangles.box
        starts, members = tiles.sort_into_tiles(box, self.count, *self._grid)
        picture = np.empty((pinhole.height, pinhole.width, 3), np.uint8)

        def draw(share: NDArray[np.int32]) -> None:
            tiles.draw_tiles(share, starts, members, tri, box, spheres.centres, spheres.box, spheres.offset,
                             spheres.fine, mask, pinhole.lens, self._sky, T_ned_cam.R, picture)

        others = [self._pool.submit(draw, share) for share in self._shares[1:]] if self._pool else []
        draw(self._shares[0])
        for other in others:
            other.result()
        return picture
