"""Compiled kernels of the camera picture: triangles, spheres and sky into pixels.

Rules
-----
* A picture is cut into tiles. A tile is drawn by one thread from its own list of triangles, in the list's order, so
  that the picture has the same bits for any number of threads. Nothing is shared but what is read.
* Pixel centres lie at integers: pixel i reaches from i - 0.5 to i + 0.5, and holds ``ss`` by ``ss`` samples.
* The depth buffer keeps 1/z, which is affine in the picture; larger is nearer.
* A row of the triangle table ``tri``, in samples, is: three edges (0-8) as side, s, t: the inside is right of
  x = s y + t when side is 1, left of it when -1, and where s y + t >= 0 when 0; 1/z (9-11), red (12-14), green (15-17)
  and blue (18-20) as a x + b y + c; least and greatest colour of the corners (21-26).
* No views of arrays are taken in loops over pixels: each costs as much as the pixel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

TILE = 32
"""Edge of a tile in pixels: depth and index of its samples stay in a core's cache."""

NEAR_M = 0.2
COLUMNS = 27
SKY = -1


def kernel(function: Any) -> Any:
    """Compile as every kernel here is: cached, without the interpreter's lock, exact floating point."""
    return njit(cache=True, nogil=True)(function)


@kernel
def light_vertices(vertices: F64, normals: F64, colours: F64, part: I32, T: F64, R_ned: F64, light: F64, xyz: F64,
                   rgb: F64) -> None:
    """Turn vertices (n, 3) into camera axes ``xyz`` and shade them into ``rgb`` (n, 3).

    ``T`` (k, 3, 4) maps part k to the camera, ``R_ned`` (k, 3, 3) its normals to north-east-down. ``light`` rows:
    direction to the sun, sunlight, light from above and from below; what is reflected is colour times their sum.
    """
    for i in range(len(vertices)):
        M, R = T[part[i]], R_ned[part[i]]
        v, n = vertices[i], normals[i]
        for r in range(3):
            xyz[i, r] = M[r, 0] * v[0] + M[r, 1] * v[1] + M[r, 2] * v[2] + M[r, 3]
        n0 = R[0, 0] * n[0] + R[0, 1] * n[1] + R[0, 2] * n[2]
        n1 = R[1, 0] * n[0] + R[1, 1] * n[1] + R[1, 2] * n[2]
        n2 = R[2, 0] * n[0] + R[2, 1] * n[1] + R[2, 2] * n[2]
        sun = max(0.0, n0 * light[0, 0] + n1 * light[0, 1] + n2 * light[0, 2])
        up = 0.5 - 0.5 * n2
        for r in range(3):
            rgb[i, r] = colours[i, r] * (sun * light[1, r] + up * light[2, r] + (1.0 - up) * light[3, r])


@kernel
def plane(x: F64, y: F64, f0: float, f1: float, f2: float, row: F64, k: int) -> None:
    """Write a, b, c of the affine function with values f0, f1, f2 at three points to ``row[k:k + 3]``."""
    inverse = 1.0 / ((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    a = ((f1 - f0) * (y[2] - y[0]) - (f2 - f0) * (y[1] - y[0])) * inverse
    b = ((f2 - f0) * (x[1] - x[0]) - (f1 - f0) * (x[2] - x[0])) * inverse
    row[k], row[k + 1], row[k + 2] = a, b, f0 - a * x[0] - b * y[0]


@kernel
def put_triangle(corner: F64, lens: F64, size: I32, scratch: F64, row: F64, box: I32) -> bool:
    """Fill one row of the triangle table from three corners (3, 6: x y z in camera axes, red green blue).

    ``lens`` fx fy cx cy in samples, ``size`` width and height in samples, ``box`` least and greatest column and row of
    samples. Returns False when nothing of it is in the picture. ``scratch`` (3, 3) is work space.
    """
    x, y, w = scratch[0], scratch[1], scratch[2]
    for i in range(3):
        w[i] = 1.0 / corner[i, 2]
        x[i] = lens[0] * corner[i, 0] * w[i] + lens[2]
        y[i] = lens[1] * corner[i, 1] * w[i] + lens[3]
    x_min, x_max = min(x[0], x[1], x[2]), max(x[0], x[1], x[2])
    y_min, y_max = min(y[0], y[1], y[2]), max(y[0], y[1], y[2])
    if x_max < 0.0 or y_max < 0.0 or x_min > size[0] - 1 or y_min > size[1] - 1:
        return False
    box[0], box[1] = math.ceil(max(x_min, 0.0)), math.floor(min(x_max, size[0] - 1.0))
    box[2], box[3] = math.ceil(max(y_min, 0.0)), math.floor(min(y_max, size[1] - 1.0))
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    if box[0] > box[1] or box[2] > box[3] or area < 1e-9:
        return False
    for i in range(3):
        j = (i + 1) % 3
        a, b, c = y[i] - y[j], x[j] - x[i], x[i] * y[j] - x[j] * y[i]
        row[3 * i] = 0.0 if a == 0.0 else math.copysign(1.0, a)
        row[3 * i + 1], row[3 * i + 2] = (b, c) if a == 0.0 else (-b / a, -c / a)
    plane(x, y, w[0], w[1], w[2], row, 9)
    for c in range(3):
        f0, f1, f2 = corner[0, 3 + c], corner[1, 3 + c], corner[2, 3 + c]
        plane(x, y, f0, f1, f2, row, 12 + 3 * c)
        row[21 + c], row[24 + c] = min(f0, f1, f2), max(f0, f1, f2)
    return True


@kernel
def set_up_triangles(xyz: F64, rgb: F64, triangles: I32, lens: F64, size: I32, tri: F64, box: I32) -> int:
    """Clip at the near plane, cull what faces away or lies outside, fill ``tri`` and ``box``; returns their count."""
    count = 0
    corner, poly, scratch = np.empty((3, 6)), np.empty((4, 6)), np.empty((3, 3))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ahead = (xyz[a, 2] > NEAR_M) + (xyz[b, 2] > NEAR_M) + (xyz[c, 2] > NEAR_M)
        if ahead == 0:
            continue
        facing = (
            xyz[a, 0] * (xyz[b, 1] * xyz[c, 2] - xyz[b, 2] * xyz[c, 1])
            + xyz[a, 1] * (xyz[b, 2] * xyz[c, 0] - xyz[b, 0] * xyz[c, 2])
            + xyz[a, 2] * (xyz[b, 0] * xyz[c, 1] - xyz[b, 1] * xyz[c, 0])
        )
        if facing >= 0.0:
            continue
        for k in range(3):
            v = triangles[t, 2 - k]
            for n in range(3):
                corner[k, n], corner[k, 3 + n] = xyz[v, n], rgb[v, n]
        if ahead == 3:
            count += put_triangle(corner, lens, size, scratch, tri[count], box[count])
            continue
        for k in range(1, clip_near(corner, poly) - 1):
            corner[0], corner[1], corner[2] = poly[0], poly[k], poly[k + 1]
            count += put_triangle(corner, lens, size, scratch, tri[count], box[count])
    return count


@kernel
def clip_near(corner: F64, poly: F64) -> int:
    """Cut a triangle at z = NEAR_M; write the polygon that is left to ``poly`` (4, 6) and return its corners."""
    n = 0
    for i in range(3):
        p, q = corner[i], corner[(i + 1) % 3]
        if p[2] > NEAR_M:
            poly[n] = p
            n += 1
        if (p[2] > NEAR_M) != (q[2] > NEAR_M):
            poly[n] = p + (q - p) * ((NEAR_M - p[2]) / (q[2] - p[2]))
            poly[n, 2] = NEAR_M
            n += 1
    return n


@kernel
def sort_into_tiles(box: I32, count: int, edge: int, across: int, down: int) -> tuple[I32, I32]:
    """Return (starts (tiles + 1,), triangle indices by tile) for tiles of ``edge`` samples."""
    starts = np.zeros(across * down + 1, np.int32)
    for t in range(count):
        for j in range(box[t, 2] // edge, box[t, 3] // edge + 1):
            for i in range(box[t, 0] // edge, box[t, 1] // edge + 1):
                starts[j * across + i + 1] += 1
    for k in range(across * down):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    members = np.empty(starts[-1], np.int32)
    for t in range(count):
        for j in range(box[t, 2] // edge, box[t, 3] // edge + 1):
            for i in range(box[t, 0] // edge, box[t, 1] // edge + 1):
                members[fill[j * across + i]] = t
                fill[j * across + i] += 1
    return starts, members


@kernel
def draw_triangle(row: F64, index: int, bounds: I32, x0: int, y0: int, depth: F32, ident: I32) -> None:
    """Draw one triangle into a tile whose first sample is (x0, y0), row by row between its edges."""
    edge = depth.shape[0]
    first, last = max(bounds[2] - y0, 0), min(bounds[3] - y0, edge - 1)
    for j in range(first, last + 1):
        y = float(j + y0)
        left, right = float(bounds[0]), float(bounds[1])
        for k in range(3):
            side, x = row[3 * k], row[3 * k + 1] * y + row[3 * k + 2]
            if side > 0.0:
                left = max(left, x)
            elif side < 0.0:
                right = min(right, x)
            elif x < 0.0:
                right = -1.0
        if right < left:
            continue
        i0, i1 = max(math.ceil(left) - x0, 0), min(math.floor(right) - x0, edge - 1)
        w = np.float32(row[10] * y + row[11] + row[9] * x0)
        step = np.float32(row[9])
        d, m = depth[j], ident[j]
        for i in range(i0, i1 + 1):
            wi = w + step * np.float32(i)
            if wi > d[i]:
                d[i] = wi
                m[i] = index


@kernel
def draw_depth(xyz: F64, triangles: I32, lens: F64, size: I32, tri: F64, box: I32) -> F32:
    """Return 1/z (n, n) of a square picture of ``size`` with one sample per pixel, 0 where there is nothing.

    ``tri`` and ``box`` are work space with a row per triangle, enough when all are ahead of the camera.
    """
    count = set_up_triangles(xyz, xyz, triangles, lens, size, tri, box)
    depth, ident = np.zeros((size[0], size[0]), np.float32), np.empty((size[0], size[0]), np.int32)
    for t in range(count):
        draw_triangle(tri[t], t, box[t], 0, 0, depth, ident)
    return depth


@kernel
def draw_spheres(spheres: F64, box: I32, offset: I32, fine: I32, mask: U8, lens: F64, x0: int, y0: int, depth: F32,
                 ss: int) -> None:
    """Mark in ``mask`` the samples of each sphere that are in front of the tile's depth buffer.

    ``spheres`` (n, 4) centre in camera axes and radius; ``box`` (n, 4) pixel bounds, last ones included; sphere n has
    ``fine[n]`` by ``fine[n]`` samples a pixel from ``mask[offset[n]]`` on; a ray meets a sphere where |t d - c| = r.
    ``lens`` fx fy cx cy and the tile's first pixel (x0, y0) in pixels.
    """
    for s in range(len(spheres)):
        k, width = fine[s], (box[s, 1] - box[s, 0] + 1) * fine[s]
        cx, cy, cz, r = spheres[s, 0], spheres[s, 1], spheres[s, 2], spheres[s, 3]
        outside = cx * cx + cy * cy + cz * cz - r * r
        for v in range(max(box[s, 2], y0) * k, (min(box[s, 3], y0 + TILE - 1) + 1) * k):
            dy = ((v + 0.5) / k - 0.5 - lens[3]) / lens[1]
            j = (2 * v + 1) * ss // (2 * k) - y0 * ss
            for u in range(max(box[s, 0], x0) * k, (min(box[s, 1], x0 + TILE - 1) + 1) * k):
                dx = ((u + 0.5) / k - 0.5 - lens[2]) / lens[0]
                dd, dc = dx * dx + dy * dy + 1.0, dx * cx + dy * cy + cz
                under = dc * dc - dd * outside
                if under < 0.0:
                    continue
                i = (2 * u + 1) * ss // (2 * k) - x0 * ss
                if dd > (dc - math.sqrt(under)) * depth[j, i]:
                    mask[offset[s] + (v - box[s, 2] * k) * width + u - box[s, 0] * k] = 1


@kernel
def look_up_sky(cube: U8, d0: float, d1: float, d2: float, row: int, column: int, out: F32) -> None:
    """Write the sky along the direction (d0, d1, d2) to ``out[row, column]`` (3,): bilinear in a cube (6, n, n, 3).

    Face 2 k is seen along +axis k of north-east-down, 2 k + 1 along -axis k; columns and rows are the next two axes.
    """
    a0, a1, a2 = abs(d0), abs(d1), abs(d2)
    if a0 >= a1 and a0 >= a2:
        face, p, q, m = (0 if d0 > 0 else 1), d1, d2, a0
    elif a1 >= a2:
        face, p, q, m = (2 if d1 > 0 else 3), d2, d0, a1
    else:
        face, p, q, m = (4 if d2 > 0 else 5), d0, d1, a2
    half = 0.5 * (cube.shape[1] - 1)
    u, v = (p / m + 1.0) * half, (q / m + 1.0) * half
    i, j = min(int(u), cube.shape[1] - 2), min(int(v), cube.shape[1] - 2)
    fu, fv = np.float32(u - i), np.float32(v - j)
    for c in range(3):
        f00, f01 = np.float32(cube[face, j, i, c]), np.float32(cube[face, j, i + 1, c])
        f10, f11 = np.float32(cube[face, j + 1, i, c]), np.float32(cube[face, j + 1, i + 1, c])
        top, bottom = f00 + (f01 - f00) * fu, f10 + (f11 - f10) * fu
        out[row, column, c] = top + (bottom - top) * fv


@kernel
def draw_sky(cube: U8, R_ned_cam: F64, lens: F64, x0: int, y0: int, coarse: F32, sky: F32) -> None:
    """Fill ``sky`` (TILE, TILE, 3) with the sky behind the tile at (x0, y0).

    It is looked up at every second pixel, as fine as the cube's own faces, and halved between.
    """
    half = TILE // 2
    for j in range(half + 1):
        y = (y0 + 2 * j - lens[3]) / lens[1]
        for i in range(half + 1):
            x = (x0 + 2 * i - lens[2]) / lens[0]
            d0 = R_ned_cam[0, 0] * x + R_ned_cam[0, 1] * y + R_ned_cam[0, 2]
            d1 = R_ned_cam[1, 0] * x + R_ned_cam[1, 1] * y + R_ned_cam[1, 2]
            d2 = R_ned_cam[2, 0] * x + R_ned_cam[2, 1] * y + R_ned_cam[2, 2]
            look_up_sky(cube, d0, d1, d2, j, i, coarse)
    quarter = np.float32(0.25)
    for j in range(half):
        for i in range(half):
            for c in range(3):
                a, b = coarse[j, i, c], coarse[j, i + 1, c]
                d, e = coarse[j + 1, i, c], coarse[j + 1, i + 1, c]
                sky[2 * j, 2 * i, c] = a
                sky[2 * j, 2 * i + 1, c] = (a + b) * np.float32(0.5)
                sky[2 * j + 1, 2 * i, c] = (a + d) * np.float32(0.5)
                sky[2 * j + 1, 2 * i + 1, c] = (a + b + d + e) * quarter


@kernel
def add_samples(tri: F64, t: int, run: int, x: float, y: float, out: F32) -> None:
    """Add ``run`` samples of the colour of triangle t, taken at (x, y) in samples, to ``out`` (3,) in 0..255."""
    for c in range(3):
        value = tri[t, 12 + 3 * c] * x + tri[t, 13 + 3 * c] * y + tri[t, 14 + 3 * c]
        out[c] += np.float32(255.0 * run * min(max(value, tri[t, 21 + c]), tri[t, 24 + c]))


@kernel
def resolve_pixel(tri: F64, ident: I32, j0: int, i0: int, ss: int, x: float, y: float, out: F32) -> int:
    """Add up the colours (0..255) of one pixel's samples in ``out``; returns how many of them saw the sky.

    Colour is taken once for each run of samples of one triangle, at the pixel's centre (x, y) in samples.
    """
    sky, run, last = 0, 0, ident[j0, i0]
    for j in range(j0, j0 + ss):
        for i in range(i0, i0 + ss):
            now = ident[j, i]
            if now != last:
                if last == SKY:
                    sky += run
                else:
                    add_samples(tri, last, run, x, y, out)
                last, run = now, 0
            run += 1
    if last == SKY:
        return sky + run
    add_samples(tri, last, run, x, y, out)
    return sky


@kernel
def resolve_tile(tri: F64, ident: I32, ss: int, sky: F32, x0: int, y0: int, picture: U8) -> None:
    """Write the mean colour of every pixel's samples, ``sky`` where they saw it, to the tile at (x0, y0)."""
    h, w, _ = picture.shape
    colour = np.empty(3, np.float32)
    scale = np.float32(1.0 / (ss * ss))
    for j in range(min(TILE, h - y0)):
        for i in range(min(TILE, w - x0)):
            colour[:] = 0.0
            xs, ys = (x0 + i + 0.5) * ss - 0.5, (y0 + j + 0.5) * ss - 0.5
            unhit = np.float32(resolve_pixel(tri, ident, j * ss, i * ss, ss, xs, ys, colour))
            for c in range(3):
                value = (colour[c] + unhit * sky[j, i, c]) * scale + np.float32(0.5)
                picture[y0 + j, x0 + i, c] = np.uint8(min(np.float32(255.0), value))


@kernel
def draw_tiles(which: I32, starts: I32, members: I32, tri: F64, box: I32, spheres: F64, sphere_box: I32, offset: I32,
               fine: I32, mask: U8, lens: F64, ss: int, cube: U8, R_ned_cam: F64, picture: U8) -> None:
    """Draw the tiles named in ``which`` into ``picture`` (h, w, 3), without markers, and fill the spheres' ``mask``."""
    h, w, _ = picture.shape
    across = (w + TILE - 1) // TILE
    depth = np.empty((TILE * ss, TILE * ss), np.float32)
    ident = np.empty((TILE * ss, TILE * ss), np.int32)
    coarse, sky = np.empty((TILE // 2 + 1, TILE // 2 + 1, 3), np.float32), np.empty((TILE, TILE, 3), np.float32)
    dirty = True
    for tile in which:
        x0, y0 = (tile % across) * TILE, (tile // across) * TILE
        if dirty:
            depth[:] = 0.0
            ident[:] = SKY
        for k in range(starts[tile], starts[tile + 1]):
            t = members[k]
            draw_triangle(tri[t], t, box[t], x0 * ss, y0 * ss, depth, ident)
        dirty = starts[tile] < starts[tile + 1]
        draw_spheres(spheres, sphere_box, offset, fine, mask, lens, x0, y0, depth, ss)
        draw_sky(cube, R_ned_cam, lens, x0, y0, coarse, sky)
        if dirty:
            resolve_tile(tri, ident, ss, sky, x0, y0, picture)
            continue
        for j in range(min(TILE, h - y0)):
            for i in range(min(TILE, w - x0)):
                for c in range(3):
                    picture[y0 + j, x0 + i, c] = np.uint8(sky[j, i, c] + np.float32(0.5))
