"""The sky at infinity: blue above, haze at the horizon, a broken deck of cloud below, as the six faces of a cube.

The sun is a disc of 0.53 degrees in an aureole; in cloud there is nothing but cloud.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat
from sim_bridge.scene.light import HAZE, SUNLIGHT, Illumination

FACE_PX = 512
ZENITH = np.array([0.16, 0.36, 0.72])
MIDDLE = np.array([0.38, 0.60, 0.88])
SEA = np.array([0.16, 0.27, 0.40])
CLOUD = np.array([0.90, 0.92, 0.95])


SUN_DISC_RAD = 0.0046
DISC, AUREOLE, WIDE = 400.0, 0.9, 0.25
"""Of sunlight: the disc, which any exposure clips, and the parts of the aureole that fall off over 0.03 and 0.2 rad
(estimated: a clear sky at 6000 m)."""


def make_sky(rng: np.random.Generator, light: Illumination) -> NDArray[np.uint8]:
    """Return a sky cube (6, n, n, 3) uint8 in the order of ``background.draw_sky``; ``rng`` shapes the clouds."""
    high, low = cloud_noise(rng), cloud_noise(rng)
    cube = np.empty((6, FACE_PX, FACE_PX, 3), np.uint8)
    p, q = np.meshgrid(np.linspace(-1.0, 1.0, FACE_PX), np.linspace(-1.0, 1.0, FACE_PX))
    for face in range(6):
        axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
        d = np.empty((FACE_PX, FACE_PX, 3))
        d[..., axis], d[..., (axis + 1) % 3], d[..., (axis + 2) % 3] = sign, p, q
        d /= np.sqrt(np.sum(d * d, axis=2))[..., None]
        cube[face] = np.clip(255.0 * radiance_of(d, high, low, light) + 0.5, 0, 255).astype(np.uint8)
    return cube


def radiance_of(d: Mat, high: Mat, low: Mat, light: Illumination) -> Mat:
    """Return the radiance (n, n, 3) along unit directions ``d`` north-east-down in this light and air."""
    if light.cloud_per_m > 0.0:
        return np.broadcast_to(light.air, d.shape)
    clear = colour_of(d, high, low, light)
    away = np.arccos(np.clip(d @ light.sun_ned, -1.0, 1.0))[..., None]
    ring = AUREOLE * np.exp(-away / 0.03) + WIDE * np.exp(-away / 0.2)
    clear = clear + SUNLIGHT * light.sun * (ring + DISC * (away < SUN_DISC_RAD))
    return light.kept * light.surroundings * clear + (1.0 - light.kept) * light.air


def cloud_noise(rng: np.random.Generator, size: int = 1024) -> Mat:
    """Return a seamless (size, size) field of zero mean and unit deviation with the spectrum of clouds."""
    k = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]) * size
    amplitude = np.where(k > 0, 1.0 / np.maximum(k, 3.0) ** 1.75, 0.0) * np.exp(-((k / 220.0) ** 2))
    field = np.fft.irfft2(amplitude * np.fft.rfft2(rng.standard_normal((size, size))), s=(size, size))
    return (field - field.mean()) / field.std()


def layer(d: Mat, noise: Mat, scale: float, stretch: float) -> Mat:
    """Return ``noise`` seen on a horizontal layer along directions ``d`` (n, n, 3), repeated every 1/scale heights."""
    height = np.maximum(np.abs(d[..., 2]), 1e-3)
    size = noise.shape[0]
    u = np.mod(d[..., 0] / height * scale * stretch, 1.0) * size
    v = np.mod(d[..., 1] / height * scale, 1.0) * size
    tiled = np.pad(noise, 1, mode="wrap").astype(np.float32)
    return cv2.remap(tiled, (u + 1).astype(np.float32), (v + 1).astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)


def smooth(x: Mat, low: float, high: float) -> Mat:
    """Return the smooth step from 0 at ``low`` to 1 at ``high``."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def colour_of(d: Mat, high: Mat, low: Mat, light: Illumination) -> Mat:
    """Return the colour (n, n, 3) along unit directions ``d`` north-east-down without the sun.

    Never redder than green or blue.
    """
    up = -d[..., 2]
    t = np.clip(up, 0.0, 1.0)[..., None]
    above = HAZE + (MIDDLE - HAZE) * smooth(t, 0.0, 0.35) + (ZENITH - MIDDLE) * smooth(t, 0.3, 1.0)
    cirrus = 0.55 * smooth(layer(d, high, 0.06, 0.45), 0.1, 2.2) * smooth(up, 0.02, 0.25)
    above = above + (CLOUD - above) * cirrus[..., None]
    shape = layer(d, low, 0.05, 1.0)
    lit = (0.78 + 0.22 * smooth(shape, 0.0, 2.0))[..., None] * CLOUD
    below = light.below / light.sky * (SEA + (lit - SEA) * smooth(shape, -0.3, 0.5)[..., None])
    below = below + (HAZE - below) * np.exp(-np.abs(np.minimum(up, 0.0)) / 0.10)[..., None]
    blend = smooth(up, -0.015, 0.015)[..., None]
    return light.sky * (below + (above - below) * blend)
