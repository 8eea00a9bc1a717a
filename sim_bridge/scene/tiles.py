"""Compiled kernels of the camera picture: sky, airframe and the view of the lights, tile by tile.

A picture is cut into tiles. A row of tiles is drawn by one thread, each from its own list of triangles, in the list's
order, so that the picture has the same bits for any number of threads. Nothing is shared but what is read.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scene.background import draw_sky
from sim_bridge.scene.rasterizer import COLOUR, F32, F64, I32, LEAST, MOST, SKY, U8, draw_triangle, kernel

TILE = 32
"""Edge of a tile in pixels, even: depth and index of its samples stay in a core's cache."""

SS = 4
"""Samples per pixel and axis. A constant: the loops over a pixel's samples are unrolled."""

EDGE = TILE * SS


@kernel
def sort_into_tiles(box: I32, count: int, across: int, down: int) -> tuple[I32, I32]:
    """Return (starts (tiles + 1,), triangle indices by tile) for ``count`` triangles' boxes."""
    starts = np.zeros(across * down + 1, np.int32)
    for t in range(count):
        for j in range(box[t, 2] // EDGE, box[t, 3] // EDGE + 1):
            for i in range(box[t, 0] // EDGE, box[t, 1] // EDGE + 1):
                starts[j * across + i + 1] += 1
    for k in range(across * down):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    members = np.empty(starts[-1], np.int32)
    for t in range(count):
        for j in range(box[t, 2] // EDGE, box[t, 3] // EDGE + 1):
            for i in range(box[t, 0] // EDGE, box[t, 1] // EDGE + 1):
                members[fill[j * across + i]] = t
                fill[j * across + i] += 1
    return starts, members


@kernel
def draw_spheres(spheres: F64, box: I32, offset: I32, fine: I32, mask: U8, lens: F64, x0: int, y0: int,
                 depth: F32) -> None:
    """Mark in ``mask`` the samples of each sphere that are in front of the tile's depth buffer.

    ``spheres`` (n, 4) centre in camera axes and radius; ``box`` (n, 4) pixel bounds, last ones included; sphere n has
    ``fine[n]`` by ``fine[n]`` samples a pixel from ``mask[offset[n]]`` on; a ray meets a sphere where |t d - c| = r.
    ``lens`` fx fy cx cy and the tile's first pixel (x0, y0) in pixels.
    """
    across, down = 1.0 / lens[0], 1.0 / lens[1]
    for s in range(len(spheres)):
        finer, k, width = 1.0 / fine[s], fine[s], (box[s, 1] - box[s, 0] + 1) * fine[s]
        cx, cy, cz, r = spheres[s, 0], spheres[s, 1], spheres[s, 2], spheres[s, 3]
        outside = cx * cx + cy * cy + cz * cz - r * r
        for v in range(max(box[s, 2], y0) * k, (min(box[s, 3], y0 + TILE - 1) + 1) * k):
            y = (v + 0.5) * finer
            dy, j = (y - 0.5 - lens[3]) * down, int(y * SS) - y0 * SS
            for u in range(max(box[s, 0], x0) * k, (min(box[s, 1], x0 + TILE - 1) + 1) * k):
                x = (u + 0.5) * finer
                dx = (x - 0.5 - lens[2]) * across
                dd, dc = dx * dx + dy * dy + 1.0, dx * cx + dy * cy + cz
                under = dc * dc - dd * outside
                if under < 0.0:
                    continue
                if dd > (dc - math.sqrt(under)) * depth[j, int(x * SS) - x0 * SS]:
                    mask[offset[s] + (v - box[s, 2] * k) * width + u - box[s, 0] * k] = 1


@kernel
def find_extremes(ident: I32, row: int, low: I32, high: I32) -> None:
    """Write least and greatest index among the samples of each pixel of a row to ``low`` and ``high`` at i * SS."""
    for i in range(EDGE):
        low[i] = high[i] = ident[row, i]
    for j in range(row + 1, row + SS):
        for i in range(EDGE):
            low[i], high[i] = min(low[i], ident[j, i]), max(high[i], ident[j, i])
    width = 1
    while width < SS:
        step = min(width, SS - width)
        for i in range(EDGE - step):
            low[i], high[i] = min(low[i], low[i + step]), max(high[i], high[i + step])
        width += step


@kernel
def count_samples(ident: I32, j0: int, i0: int, low: int, high: int, who: I32, count: I32) -> int:
    """List the triangles among the samples of one pixel, from ``high`` down to ``low``, and the samples of each.

    Returns the list's length. One pass for each but the last, without a branch on what is found.
    """
    n, left, now = 0, SS * SS, high
    while now != low:
        same, below = 0, low
        for j in range(np.uint32(j0), np.uint32(j0 + SS)):
            for i in range(np.uint32(i0), np.uint32(i0 + SS)):
                t = ident[j, i]
                same += t == now
                below = max(below, t if t < now else low)
        who[n], count[n] = now, same
        n, left, now = n + 1, left - same, below
    who[n], count[n] = low, left
    return n + 1


@kernel
def colour_of(tri: F64, t: int, c: int, x: float, y: float) -> float:
    """Return colour channel c of triangle t at (x, y) in samples, 0..255; beyond its edge, that of its corners."""
    k = COLOUR + 3 * c
    return min(max(tri[t, k] * x + tri[t, k + 1] * y + tri[t, k + 2], tri[t, LEAST + c]), tri[t, MOST + c])


@kernel
def resolve_tile(tri: F64, ident: I32, x0: int, y0: int, touched: I32, picture: U8) -> None:
    """Lay the mean colour of every pixel's samples over the sky in the tile at (x0, y0), where ``touched`` says.

    ``touched`` first and last column and row of pixels of the tile. Colour is taken once for each triangle in a pixel,
    at the pixel's centre.
    """
    h, w, _ = picture.shape
    low, high = np.empty(EDGE, np.int32), np.empty(EDGE, np.int32)
    who, count = np.empty(SS * SS, np.int32), np.empty(SS * SS, np.int32)
    scale = 1.0 / (SS * SS)
    for j in range(touched[2], min(touched[3], h - 1 - y0) + 1):
        find_extremes(ident, j * SS, low, high)
        y = (y0 + j + 0.5) * SS - 0.5
        for i in range(touched[0], min(touched[1], w - 1 - x0) + 1):
            t = high[i * SS]
            if t == SKY:
                continue
            x = (x0 + i + 0.5) * SS - 0.5
            if low[i * SS] == t:
                for c in range(3):
                    picture[y0 + j, x0 + i, c] = np.uint8(min(255.0, colour_of(tri, t, c, x, y) + 0.5))
                continue
            n = count_samples(ident, j * SS, i * SS, low[i * SS], t, who, count)
            for c in range(3):
                total = 0.0
                for k in range(n):
                    sky = who[k] == SKY
                    value = float(picture[y0 + j, x0 + i, c]) if sky else colour_of(tri, who[k], c, x, y)
                    total += count[k] * value
                picture[y0 + j, x0 + i, c] = np.uint8(min(255.0, total * scale + 0.5))


@kernel
def draw_airframe(members: I32, tri: F64, box: I32, x0: int, y0: int, depth: F32, ident: I32,
                  touched: I32) -> None:
    """Draw a tile's triangles, of which there is one at least; ``touched`` gets the pixels that they may be in."""
    touched[0], touched[1], touched[2], touched[3] = TILE, 0, TILE, 0
    for t in members:
        touched[0], touched[1] = min(touched[0], box[t, 0] // SS - x0), max(touched[1], box[t, 1] // SS - x0)
        touched[2], touched[3] = min(touched[2], box[t, 2] // SS - y0), max(touched[3], box[t, 3] // SS - y0)
    touched[0], touched[1] = max(touched[0], 0), min(touched[1], TILE - 1)
    touched[2], touched[3] = max(touched[2], 0), min(touched[3], TILE - 1)
    ident[touched[2] * SS : (touched[3] + 1) * SS] = SKY
    for t in members:
        draw_triangle(tri[t], t, box[t], x0 * SS, y0 * SS, depth, ident)


@kernel
def draw_tiles(which: I32, starts: I32, members: I32, tri: F64, box: I32, spheres: F64, sphere_box: I32, offset: I32,
               fine: I32, mask: U8, lens: F64, sky: NDArray[np.uint64], R_ned_cam: F64, picture: U8) -> None:
    """Draw the rows of tiles in ``which`` into ``picture`` (h, w, 3), without markers; fill the spheres' ``mask``."""
    h, w, _ = picture.shape
    across = (w + TILE - 1) // TILE
    depth = np.zeros((EDGE, EDGE), np.float32)
    ident = np.empty((EDGE, EDGE), np.int32)
    texels, coarse = np.empty((3, w // 2 + 1), np.int32), np.empty((TILE // 2 + 1, 6 * (w // 2 + 1)), np.uint16)
    lines, touched = picture.reshape(h, 3 * w), np.empty(4, np.int32)
    for row in which:
        y0 = row * TILE
        draw_sky(sky, R_ned_cam, lens, texels, coarse, y0, lines[y0 : y0 + TILE])
        for column in range(across):
            x0, tile = column * TILE, row * across + column
            mine = members[starts[tile] : starts[tile + 1]]
            if len(mine) > 0:
                draw_airframe(mine, tri, box, x0, y0, depth, ident, touched)
                resolve_tile(tri, ident, x0, y0, touched, picture)
            draw_spheres(spheres, sphere_box, offset, fine, mask, lens, x0, y0, depth)
            if len(mine) > 0:
                depth[touched[2] * SS : (touched[3] + 1) * SS] = 0.0
