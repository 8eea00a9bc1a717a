"""The picture that the receiver's camera takes of the tanker.

Rules
-----
* Values are linear in radiance, in full scales of the sensor (a white sheet in the sun is about 0.9): a camera for
  measuring, without a gamma curve. Lights may be brighter than one; the sensor clips them.
* A light is a red sphere of radiance ``LIGHT`` = 4 full scales in the red channel. A sunlit white surface has about
  30 kcd/m2, of which a fifth is red; four times that over the disc of a sphere of 10 cm radius is some 800 cd, an
  aircraft's anti-collision light. Even spread over four pixels, as when the sphere measures 0.76 px in the 320x200
  picture at 60 m, it exceeds the threshold of detection; nearer ones clip in their middle.
* The lens spreads a point by a Gaussian of 0.5 px before the pixels integrate: with less, the centroid of a light that
  is smaller than a pixel would not follow it. Everything else is softened by the supersampling alone.
* The same generator state gives the same bits, with any number of threads.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from math import erf

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, ConfigError, TankerConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import T_frd_cam, bends, normalised_to_pixels, pixels_to_normalised
from sim_bridge.scene import lights, tiles
from sim_bridge.scene import rasterizer as kernels
from sim_bridge.scene.ambient import shade_recesses
from sim_bridge.scene.background import pack_sky
from sim_bridge.scene.clutter import Glow, glows, hot_pixels, red_paint
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.meshing import Mesh, merge
from sim_bridge.scene.sky import make_sky
from sim_bridge.scene.tanker_mesh import boom_mesh, boom_poses, tanker_mesh
from sim_bridge.truth import BoomState

CLEAR_DAY = PictureConditions()
LIGHT = (4.0, 0.12, 0.12)
SPREAD_PX = 0.5
NOISE = 1.2
"""Standard deviation of the sensor's noise in steps of 1/255."""

NOISE_OFFSETS = 65536
FINE = 12
"""Samples per pixel and axis of a sphere of up to FINE_RADIUS_PX; larger ones need fewer."""

FINE_RADIUS_PX = 1.5
SUN_NED = np.array([-0.45, 0.50, -0.74])
SUNLIGHT = (0.62, 0.62, 0.60)
FROM_ABOVE = (0.38, 0.44, 0.52)
FROM_BELOW = (0.60, 0.64, 0.70)
LIT_BY = np.array([SUN_NED / np.sqrt(SUN_NED @ SUN_NED), SUNLIGHT, FROM_ABOVE, FROM_BELOW])


@dataclass(frozen=True, slots=True, eq=False)
class Spheres:
    """Lights in one pinhole picture: centre and radius (n, 4), pixel bounds, samples per pixel, place in the mask."""

    centres: Mat
    box: NDArray[np.int32]
    fine: NDArray[np.int32]
    offset: NDArray[np.int32]
    samples: int


@lru_cache(maxsize=2)
def scene_mesh(painted: bool = False) -> tuple[Mesh, NDArray[np.int32]]:
    """Return tanker, boom and telescope as one mesh, and the part (0, 1, 2) of every vertex; ``painted`` red or not."""
    airframe = merge([tanker_mesh(), *red_paint()]) if painted else tanker_mesh()
    parts = [shade_recesses(airframe), *boom_mesh()]
    part = np.repeat(np.arange(3), [len(p.vertices) for p in parts]).astype(np.int32)
    return merge(parts), part


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
        return Spheres(spheres, box, fine, (ends - sizes).astype(np.int32), int(ends[-1]))


@lru_cache(maxsize=8)
def pinhole_of(camera: CameraConfig) -> Pinhole:
    """Return the camera's pinhole picture; finding it for a distorted camera is slow."""
    return Pinhole(camera)


class Triangles:
    """The table of the triangles in view, and the buffers behind it."""

    def __init__(self, painted: bool = False) -> None:
        self._scene = scene_mesh(painted)
        mesh, _ = self._scene
        self._xyz, self._rgb, self._screen = (np.empty_like(mesh.vertices) for _ in range(3))
        self.table = np.empty((2 * len(mesh.triangles), kernels.COLUMNS))
        self.box = np.empty((2 * len(mesh.triangles), 4), np.int32)

    def place(self, pinhole: Pinhole, ss: int, T_ned_tanker: SE3, T_ned_cam: SE3, boom: BoomState) -> int:
        """Light and place tanker and boom before the camera, with ``ss`` samples per pixel; returns the rows filled."""
        mesh, part = self._scene
        T_cam_ned = T_ned_cam.inverse()
        T_ned_part = [T_ned_tanker, *(T_ned_tanker @ T for T in boom_poses(boom))]
        T = np.stack([(T_cam_ned @ T_part).as_matrix()[:3] for T_part in T_ned_part])
        R_ned = np.stack([T_part.R for T_part in T_ned_part])
        kernels.light_vertices(mesh.vertices, mesh.normals, mesh.colours, part, T, R_ned, LIT_BY, self._xyz, self._rgb)
        size = np.array([pinhole.width * ss, pinhole.height * ss], np.int32)
        lens = pinhole.sample_lens(ss)
        return int(kernels.set_up_triangles(self._xyz, self._rgb, mesh.triangles, lens, size, self._screen, self.table,
                                            self.box))


class CameraPicture:
    """Draws what the camera sees; keep one per camera, its buffers are used again."""

    def __init__(self, camera: CameraConfig, tanker: TankerConfig, rng: np.random.Generator, threads: int = 2, *,
                 light: tuple[float, float, float] = LIGHT, noise: float = NOISE,
                 conditions: PictureConditions = CLEAR_DAY) -> None:
        """Make sky and noise from ``rng``.

        ``light`` red, green, blue of the markers in full scales; ``noise`` standard deviation in steps of 1/255;
        ``conditions`` daylight, exposure and clutter.
        """
        self.camera, self.tanker, self.threads = camera, tanker, threads
        self._rng, self._conditions = rng, conditions
        self._pinhole, self._T_frd_cam = pinhole_of(camera), T_frd_cam(camera)
        markers = np.array([m.p_tanker_m for m in tanker.markers], dtype=np.float64)
        self._glows = [*glows(conditions.clutter), Glow(markers, tanker.marker_radius_m, np.array(light))]
        self._places = np.concatenate([g.places_tanker_m for g in self._glows])
        self._radii = np.concatenate([np.full(len(g.places_tanker_m), g.radius_m) for g in self._glows])
        self._hot = hot_pixels(rng.spawn(1)[0], conditions.hot_pixels, camera.height_px, camera.width_px)
        self._sky = pack_sky(make_sky(rng))
        size = camera.width_px * camera.height_px * 3
        self._noise = np.clip(np.round(noise * rng.standard_normal(size + NOISE_OFFSETS)), -127, 127).astype(np.int8)
        self._spread = point_spread()
        self._cover = np.zeros((camera.height_px + 2 * lights.MARGIN, camera.width_px + 2 * lights.MARGIN), np.float32)
        self._pool = ThreadPoolExecutor(max_workers=max(1, threads - 1)) if threads > 1 else None
        across, down = (-(-n // tiles.TILE) for n in (self._pinhole.width, self._pinhole.height))
        self._shares = [np.arange(k, down, threads, dtype=np.int32) for k in range(threads)]
        self._grid = (across, down)
        self._triangles = Triangles(painted="stripe" in conditions.clutter)

    def render(self, T_ned_tanker: SE3, T_ned_frd: SE3, boom: BoomState) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3) uint8 RGB of the tanker from the camera on the receiver."""
        T_ned_cam = T_ned_frd @ self._T_frd_cam
        T_cam_tanker = T_ned_cam.inverse() @ T_ned_tanker
        spheres = self._pinhole.place_spheres(T_cam_tanker.transform(self._places), self._radii)
        mask = np.zeros(spheres.samples, np.uint8)
        picture = self._draw(T_ned_tanker, T_ned_cam, boom, spheres, mask)
        if self._pinhole.maps is not None:
            picture = cv2.remap(picture, *self._pinhole.maps, cv2.INTER_LINEAR)
        exposed = self._expose(picture, spheres, mask)
        start = int(self._rng.integers(NOISE_OFFSETS))
        lights.add_noise(exposed.reshape(-1), self._noise[start:])
        exposed[self._hot[:, 0], self._hot[:, 1], 0] = 255
        return exposed

    def _draw(self, T_ned_tanker: SE3, T_ned_cam: SE3, boom: BoomState, spheres: Spheres,
              mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Draw airframe, boom and sky; fill ``mask`` with the samples of the lights that nothing hides."""
        pinhole = self._pinhole
        count = self._triangles.place(pinhole, tiles.SS, T_ned_tanker, T_ned_cam, boom)
        tri, box = self._triangles.table, self._triangles.box
        starts, members = tiles.sort_into_tiles(box, count, *self._grid)
        picture = np.empty((pinhole.height, pinhole.width, 3), np.uint8)

        def draw(share: NDArray[np.int32]) -> None:
            tiles.draw_tiles(share, starts, members, tri, box, spheres.centres, spheres.box, spheres.offset,
                             spheres.fine, mask, pinhole.lens, self._sky, T_ned_cam.R, picture)

        others = [self._pool.submit(draw, share) for share in self._shares[1:]] if self._pool else []
        draw(self._shares[0])
        for other in others:
            other.result()
        return picture

    def _expose(self, picture: NDArray[np.uint8], spheres: Spheres, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return ``picture`` in these conditions, with the visible samples of the lights spread by lens and distortion.

        ``picture`` itself is written over.
        """
        conditions, exposed = self._conditions, picture
        if not conditions.plain():
            picture = cv2.LUT(picture, conditions.surroundings_table())
            exposed = cv2.LUT(picture, conditions.gain_table())
        jacobian, window = self._bend(spheres.centres), np.empty_like(spheres.box)
        first = 0
        for glow in self._glows:
            some = slice(first, first + len(glow.places_tanker_m))
            lights.spread_lights(spheres.box[some], spheres.offset[some], spheres.fine[some], mask, jacobian[some],
                                 self._spread, self._cover, window[some])
            radiance = conditions.radiance_of_light(glow.radiance)
            lights.add_lights(picture, exposed, self._cover, window[some], radiance, conditions.gain)
            first = some.stop
        return exposed

    def _bend(self, centres_cam: Mat) -> Mat:
        """Return how the lens moves pinhole pixels near each light (n, 8), for ``lights.spread_lights``.

        All zero for a light that is not ahead of the camera, or that the lens does not show.
        """
        lens = self._pinhole.lens
        xy = centres_cam[:, :2] / np.where(centres_cam[:, 2:3] > 0, centres_cam[:, 2:3], np.nan)
        at = xy * lens[:2] + lens[2:]
        bend = np.zeros((len(at), 8))
        bend[:, :2] = at
        if self._pinhole.maps is None:
            bend[:, [2, 5]], bend[:, [3, 7]] = at, 1.0
        else:
            right, down = np.diag(0.5 / lens[:2])
            around = np.concatenate([xy, xy + right, xy - right, xy + down, xy - down])
            there = normalised_to_pixels(self.camera, around).reshape(5, -1, 2)
            bend[:, [2, 5]], bend[:, [3, 6]], bend[:, [4, 7]] = there[0], there[1] - there[2], there[3] - there[4]
        bend[np.isnan(bend).any(axis=1)] = 0.0
        return bend


def point_spread(phases: int = 256) -> Mat:
    """Return (phases, 5): shares of a point in a pixel at each phase that fall on it and two pixels to either side."""
    at = (np.arange(phases) + 0.5) / phases
    edges = np.arange(-2, 4)[None, :] - at[:, None]
    below = np.vectorize(erf)(edges / (SPREAD_PX * np.sqrt(2.0)))
    shares = np.diff(below, axis=1)
    return shares / shares.sum(axis=1)[:, None]
