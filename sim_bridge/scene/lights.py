"""Compiled kernels of the lights and the sensor: what the lens makes of them, what hides them, noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scene.rasterizer import F32, F64, I32, U8, kernel


@kernel
def spread_lights(sphere_box: I32, offset: I32, fine: I32, mask: U8, jacobian: F64, spread: F64, cover: F32) -> None:
    """Add the light of every visible sphere sample to ``cover`` (h, w), spread by the lens.

    ``jacobian`` (n, 8) maps a pinhole pixel to the picture about each sphere, to first order: x0, y0, then picture
    x = [2] + [3] dx + [4] dy and y = [5] + [6] dx + [7] dy. ``spread`` (p, 5): share of a point at phase p that falls
    on the pixels two before to two after its own.
    """
    h, w = cover.shape
    phases = len(spread)
    for s in range(len(sphere_box)):
        k, J = fine[s], jacobian[s]
        width, height = (sphere_box[s, 1] - sphere_box[s, 0] + 1) * k, (sphere_box[s, 3] - sphere_box[s, 2] + 1) * k
        share = abs(J[3] * J[7] - J[4] * J[6]) / (k * k)
        for n in range(width * height):
            if mask[offset[s] + n] == 0:
                continue
            dx = sphere_box[s, 0] - 0.5 + (n % width + 0.5) / k - J[0]
            dy = sphere_box[s, 2] - 0.5 + (n // width + 0.5) / k - J[1]
            x, y = J[2] + J[3] * dx + J[4] * dy + 0.5, J[5] + J[6] * dx + J[7] * dy + 0.5
            i, j = math.floor(x), math.floor(y)
            sx, sy = spread[int((x - i) * phases)], spread[int((y - j) * phases)]
            for b in range(max(0, 2 - j), min(5, h + 2 - j)):
                for a in range(max(0, 2 - i), min(5, w + 2 - i)):
                    cover[j + b - 2, i + a - 2] += np.float32(share * sx[a] * sy[b])


@kernel
def add_lights(picture: U8, cover: F32, light: F64) -> None:
    """Lay lights of colour ``light`` (3,), in full scales, over ``picture`` where ``cover`` says, clipping at 255."""
    for y in range(cover.shape[0]):
        for x in range(cover.shape[1]):
            c = min(float(cover[y, x]), 1.0)
            if c > 0.0:
                for k in range(3):
                    value = float(picture[y, x, k]) * (1.0 - c) + 255.0 * light[k] * c
                    picture[y, x, k] = np.uint8(min(255.0, value + 0.5))


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
            if tri[t, 9] * u + tri[t, 10] * v + tri[t, 11] <= inverse_depth:
                continue
            covers = True
            for e in range(3):
                edge = tri[t, 3 * e + 1] * v + tri[t, 3 * e + 2]
                side = tri[t, 3 * e]
                covers = covers and ((side == 0.0 and edge >= 0.0) or (side != 0.0 and (u - edge) * side >= 0.0))
            if covers:
                seen[k] = 0
                break
