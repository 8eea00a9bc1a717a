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
* What moves while the shutter is open is drawn in several places (``shutter``), and clips only after their mean.
* The same generator state gives the same bits, with any number of threads.
"""

from __future__ import annotations

from math import erf

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import CameraConfig, TankerConfig
from companion.geometry import SE3, Mat
from companion.vision.camera import T_frd_cam, normalised_to_pixels
from sim_bridge.scene import lights, tiles
from sim_bridge.scene.air import Air
from sim_bridge.scene.background import pack_sky
from sim_bridge.scene.clutter import Glow, glows, hot_pixels
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.drawing import Canvas, Spheres, Triangles, pinhole_of
from sim_bridge.scene.glare import Glare
from sim_bridge.scene.light import illumination
from sim_bridge.scene.shutter import Shutter
from sim_bridge.scene.sky import make_sky
from sim_bridge.scene.tanker_parts import tanker_parts, tanker_poses
from sim_bridge.truth import BodyState, BoomState

CLEAR_DAY = PictureConditions()
LIGHT = (4.0, 0.12, 0.12)
SPREAD_PX = 0.5
NOISE_OFFSETS = 65536

Instant = tuple[SE3, SE3]
"""T_ned_tanker and T_ned_cam at one instant of an exposure."""


class CameraPicture:
    """Draws what the camera sees; keep one per camera, its buffers are used again."""

    def __init__(self, camera: CameraConfig, tanker: TankerConfig, rng: np.random.Generator, threads: int = 2, *,
                 light: tuple[float, float, float] = LIGHT, noise: float | None = None,
                 conditions: PictureConditions = CLEAR_DAY) -> None:
        """Make sky and noise from ``rng``.

        ``light`` red, green, blue of the markers in full scales; ``conditions`` daylight, exposure and clutter;
        ``noise`` another than theirs, in steps of 1/255.
        """
        self.camera, self.tanker, self.threads = camera, tanker, threads
        self._rng, self._light = rng, illumination(conditions)
        self._pinhole, self._T_frd_cam = pinhole_of(camera), T_frd_cam(camera)
        markers = np.array([m.p_tanker_m for m in tanker.markers], dtype=np.float64)
        self._glows = [*glows(conditions.clutter), Glow(markers, tanker.marker_radius_m, np.array(light))]
        self._places = np.concatenate([g.places_tanker_m for g in self._glows])
        self._radii = np.concatenate([np.full(len(g.places_tanker_m), g.radius_m) for g in self._glows])
        pixels, shake, wisps = rng.spawn(3)
        self._hot = hot_pixels(pixels, conditions.hot_pixels, camera.height_px, camera.width_px)
        self._shutter, self._air = Shutter(camera, markers, conditions, shake), Air(self._light, wisps)
        sky = pack_sky(make_sky(rng, self._light))
        size = camera.width_px * camera.height_px * 3
        deviation = conditions.noise if noise is None else noise
        bank = deviation * rng.standard_normal(size + NOISE_OFFSETS)
        self._noise = np.clip(np.round(bank), -127, 127).astype(np.int8)
        self._spread = point_spread()
        self._cover = np.zeros((camera.height_px + 2 * lights.MARGIN, camera.width_px + 2 * lights.MARGIN), np.float32)
        self._triangles = Triangles(*tanker_parts("stripe" in conditions.clutter), self._light, self._air)
        self._canvas = Canvas(self._pinhole, self._triangles, sky, threads)
        glare = conditions.glare * float(conditions.cloud_per_m == 0.0)
        self._glare = Glare(camera, self._light, glare) if glare > 0.0 else None

    def render(self, T_ned_tanker: SE3, T_ned_frd: SE3, boom: BoomState) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3) uint8 RGB of the tanker from the receiver's camera, all standing still."""
        return self._take([(T_ned_tanker, T_ned_frd @ self._T_frd_cam)], boom)

    def expose(
        self, tanker: BodyState, uav: BodyState, boom: BoomState, markers: Mat | None = None
    ) -> NDArray[np.uint8]:
        """Return the picture (h, w, 3) uint8 RGB that is exposed about the instant of these states.

        ``markers`` (n, 3), tanker axes: where they are when they are not where the map has them.
        """
        return self._take(self._shutter.poses(tanker, uav), boom, markers)

    def _take(self, instants: list[Instant], boom: BoomState, markers: Mat | None = None) -> NDArray[np.uint8]:
        drawn = [self._draw(instant, boom, markers) for instant in instants]
        picture = drawn[0][0] if len(drawn) == 1 else mean_picture([d[0] for d in drawn])
        if self._pinhole.maps is not None:
            picture = cv2.remap(picture, *self._pinhole.maps, cv2.INTER_LINEAR)
        exposed = self._expose(picture, instants, [(d[1], d[2]) for d in drawn])
        if self._glare is not None:
            T_ned_cam = instants[len(instants) // 2][1]
            exposed = self._glare.lay_over(exposed, float(np.mean([d[3] for d in drawn])), T_ned_cam)
        start = int(self._rng.integers(NOISE_OFFSETS))
        lights.add_noise(exposed.reshape(-1), self._noise[start:])
        exposed[self._hot[:, 0], self._hot[:, 1], 0] = 255
        return exposed

    def _draw(self, instant: Instant, boom: BoomState, markers: Mat | None = None) -> tuple[
            NDArray[np.uint8], Spheres, NDArray[np.uint8], float]:
        """Return one instant: airframe, boom and sky, the lights and which of their samples show, the sun's share."""
        T_ned_tanker, T_ned_cam = instant
        T_cam_tanker = T_ned_cam.inverse() @ T_ned_tanker
        places = self._places if markers is None else np.concatenate([self._places[: -len(markers)], markers])
        spheres = self._pinhole.place_spheres(T_cam_tanker.transform(places), self._radii)
        mask = np.zeros(spheres.samples, np.uint8)
        picture = self._canvas.draw(tanker_poses(T_ned_tanker, boom), T_ned_cam, spheres, mask)
        share = 0.0
        if self._glare is not None:
            table, lens = self._triangles, self._pinhole.sample_lens(tiles.SS)
            share = self._glare.visible_share(table.table, table.box, self._canvas.count, lens, T_ned_cam)
        return picture, spheres, mask, share

    def _expose(self, picture: NDArray[np.uint8], instants: list[Instant],
                drawn: list[tuple[Spheres, NDArray[np.uint8]]]) -> NDArray[np.uint8]:
        """Return ``picture`` after the rest of the gain, with the lights of all instants spread by lens and distortion.

        ``picture`` itself is written over.
        """
        light, exposed = self._light, picture
        if light.rest > 1.0:
            exposed = cv2.LUT(picture, np.clip(light.rest * np.arange(256.0) + 0.5, 0.0, 255.0).astype(np.uint8))
        bent = [self._bend(spheres.centres) for spheres, _ in drawn]
        left = [self._air.left_of(s.centres[:, :3], T_ned_cam)
                for (s, _), (_, T_ned_cam) in zip(drawn, instants, strict=True)]
        first = 0
        for glow in self._glows:
            some = slice(first, first + len(glow.places_tanker_m))
            windows, share = [], 1.0 / len(drawn)
            for (spheres, mask), jacobian in zip(drawn, bent, strict=True):
                window = np.empty_like(spheres.box[some])
                lights.spread_lights(spheres.box[some], spheres.offset[some], spheres.fine[some], mask, jacobian[some],
                                     self._spread, share, self._cover, window)
                windows.append(window)
            through = np.concatenate([k[some] for k in left])[:, None]
            radiance = light.scale * through * glow.radiance + (1.0 - through) * light.air
            lights.add_lights(picture, exposed, self._cover, np.concatenate(windows), radiance, light.rest)
            first = some.stop
        return exposed

    def _bend(self, spheres: Mat) -> Mat:
        """Return how the lens moves pinhole pixels near each light (n, 8), for ``lights.spread_lights``.

        All zero for a light that is not ahead of the camera, or that the lens does not show.
        """
        lens = self._pinhole.lens
        xy = spheres[:, :2] / np.where(spheres[:, 2:3] > 0, spheres[:, 2:3], np.nan)
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


def mean_picture(pictures: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return the mean of pictures, rounded."""
    total = np.zeros(pictures[0].shape, np.uint16)
    for picture in pictures:
        total += picture
    return ((total + len(pictures) // 2) // len(pictures)).astype(np.uint8)


def point_spread(phases: int = 256) -> Mat:
    """Return (phases, 5): shares of a point in a pixel at each phase that fall on it and two pixels to either side."""
    at = (np.arange(phases) + 0.5) / phases
    edges = np.arange(-2, 4)[None, :] - at[:, None]
    below = np.vectorize(erf)(edges / (SPREAD_PX * np.sqrt(2.0)))
    shares = np.diff(below, axis=1)
    return shares / shares.sum(axis=1)[:, None]
