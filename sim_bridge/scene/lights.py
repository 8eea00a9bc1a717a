"""Compiled kernels of the lights and the sensor: what the lens makes of them, what hides them, noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scene.rasterizer import F32, F64, I32, INVERSE, LEFT, NEAR_M, RIGHT, U8, kernel

MARGIN = 4
"""Room about the picture of what the lights cover, so that what falls beyond its edge needs no test."""


@kernel
def bound_spheres(centres: F64, radii: F64, lens: F64, width: int, height: int, box: I32) -> None:
    """Write first and last column and row of pixels that each sphere's outline touches to ``box`` (n, 4).

    Cut to the picture; empty (1, 0, 1, 0) for a sphere that is not in it or not ahead.
    """
    limit = 0.5 * math.pi - 1e-6
    for s in range(len(centres)):
        box[s, 0], box[s, 1], box[s, 2], box[s, 3] = 1, 0, 1, 0
        z, radius = centres[s, 2], radii[s]
        if not z > radius + NEAR_M:
            continue
        for k in range(2):
            across = centres[s, k]
            middle, half = math.atan2(across, z), math.asin(min(1.0, radius / math.hypot(across, z)))
            low = lens[k] * math.tan(max(middle - half, -limit)) + lens[2 + k] + 0.5
            high = lens[k] * math.tan(min(middle + half, limit)) + lens[2 + k] + 0.5
            size = height if k else width
            box[s, 2 * k] = math.floor(min(max(low, 0.0), float(size)))
            box[s, 2 * k + 1] = math.floor(max(min(high, size - 0.5), -1.0))
        if box[s, 0] > box[s, 1] or box[s, 2] > box[s, 3]:
            box[s, 0], box[s, 1], box[s, 2], box[s, 3] = 1, 0, 1, 0


@kernel
def spread_lights(sphere_box: I32, offset: I32, fine: I32, mask: U8, jacobian: F64, spread: F64, weight: float,
                  cover: F32, window: I32) -> None:
    """Add ``weight`` times the light of every visible sphere sample to ``cover``, spread by the lens.

    ``cover`` (h + 2 MARGIN, w + 2 MARGIN): the share of each pixel that lights cover.

    ``jacobian`` (n, 8) maps a pinhole pixel to the picture about each sphere, to first order: x0, y0, then picture
    x = [2] + [3] dx + [4] dy and y = [5] + [6] dx + [7] dy. ``spread`` (p, 5): share of a point at phase p that falls
    on the pixels two before to two after its own. ``window`` (n, 4) gets first and last column and row of ``cover``
    that the sphere reaches, empty when none.
    """
    h, w = cover.shape
    phases = len(spread)
    for s in range(len(sphere_box)):
        k, J = fine[s], jacobian[s]
        width, height = (sphere_box[s, 1] - sphere_box[s, 0] + 1) * k, (sphere_box[s, 3] - sphere_box[s, 2] + 1) * k
        share = weight * abs(J[3] * J[7] - J[4] * J[6]) / (k * k)
        i_min, i_max, j_min, j_max = w, -1, h, -1
        n = offset[s] - 1
        for v in range(height):
            dy = sphere_box[s, 2] - 0.5 + (v + 0.5) / k - J[1]
            for u in range(width):
                n += 1
                if mask[n] == 0:
                    continue
                dx = sphere_box[s, 0] - 0.5 + (u + 0.5) / k - J[0]
                x, y = J[2] + J[3] * dx + J[4] * dy + 0.5, J[5] + J[6] * dx + J[7] * dy + 0.5
                i, j = math.floor(x), math.floor(y)
                left, top = i + MARGIN - 2, j + MARGIN - 2
                if left < 0 or top < 0 or left + 5 > w or top + 5 > h:
                    continue
                i_min, i_max, j_min, j_max = min(i_min, left), max(i_max, left), min(j_min, top), max(j_max, top)
                sx, sy = int((x - i) * phases), int((y - j) * phases)
                for b in range(5):
                    along = share * spread[sy, b]
                    for a in range(5):
                        cover[top + b, left + a] += np.float32(along * spread[sx, a])
        window[s, 0], window[s, 1], window[s, 2], window[s, 3] = i_min, i_max + 4, j_min, j_max + 4


@kernel
def add_lights(picture: U8, exposed: U8, cover: F32, window: I32, light: F64, gain: float) -> None:
    """Lay lights of colours ``light`` (n, 3), in full scales, over ``picture`` where ``cover`` says, clipping at 255.

    Where the windows of several meet, the first one's colour is taken. ``exposed`` gets the same times ``gain``; it may
    be ``picture`` itself when that is one. Only the parts of ``cover`` that ``window`` names are looked at, and left
    empty for the next picture.
    """
    h, w, _ = picture.shape
    for s in range(len(window)):
        for j in range(window[s, 2], window[s, 3] + 1):
            for i in range(window[s, 0], window[s, 1] + 1):
                c, y, x = min(float(cover[j, i]), 1.0), j - MARGIN, i - MARGIN
                cover[j, i] = 0.0
                if c > 0.0 and 0 <= x < w and 0 <= y < h:
                    for k in range(3):
                        value = float(picture[y, x, k]) * (1.0 - c) + 255.0 * light[s, k] * c
                        picture[y, x, k] = np.uint8(min(255.0, value + 0.5))
                        exposed[y, x, k] = np.uint8(min(255.0, gain * value + 0.5))


@kernel
def add_noise(values: U8, bank: NDArray[np.int8]) -> None:
    """Add as many numbers of ``bank`` to the flat picture ``values``, clipping at 0 and 255."""
    for i in range(len(values)):
        value = np.int32(values[i]) + np.int32(bank[i])
        values[i] = np.uint8(min(np.int32(255), max(np.int32(0), value)))


@kernel
def sphere_visibility(tri: F64, box: I32, count: int, sphere: F64, lens: F64, disc: F64, seen: U8) -> None:
    """Tell for each ray to a sphere whether no triangle is in front of it: ``seen`` (n,) 1 or 0.

    ``sphere`` centre in camera axes and radius; ``disc`` (n, 2) places in the unit circle, which is laid across the
    camera's axis; ``tri``, ``box``, ``count`` and ``lens`` as ``rasterizer.set_up_triangles`` has them, in samples.
    """
    x, y, z, r = sphere[0], sphere[1], sphere[2], sphere[3]
    reach = 2.0 * r * max(lens[0], lens[1]) / z + 2.0
    u0, v0 = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
    near = np.empty(count, np.int32)
    n = 0
    for t in range(count):
        if box[t, 0] <= u0 + reach and box[t, 1] >= u0 - reach and box[t, 2] <= v0 + reach and box[t, 3] >= v0 - reach:
            near[n] = t
            n += 1
    for k in range(len(disc)):
        dx, dy = (x + r * disc[k, 0]) / z, (y + r * disc[k, 1]) / z
        u, v = lens[0] * dx + lens[2], lens[1] * dy + lens[3]
        dd, dc = dx * dx + dy * dy + 1.0, dx * x + dy * y + z
        inside = dc * dc - dd * (x * x + y * y + z * z - r * r)
        inverse_depth = dd / (dc - math.sqrt(max(inside, 0.0)))
        seen[k] = 1
        for m in range(n):
            t = near[m]
            if tri[t, INVERSE] * u + tri[t, INVERSE + 1] * v + tri[t, INVERSE + 2] <= inverse_depth:
                continue
            left = max(tri[t, LEFT] * v + tri[t, LEFT + 1], tri[t, LEFT + 2] * v + tri[t, LEFT + 3])
            right = min(tri[t, RIGHT] * v + tri[t, RIGHT + 1], tri[t, RIGHT + 2] * v + tri[t, RIGHT + 3])
            # A level edge is in the box only, which is rounded inwards to samples.
            if left <= u <= right and box[t, 2] - 1 < v < box[t, 3] + 1:
                seen[k] = 0
                break
