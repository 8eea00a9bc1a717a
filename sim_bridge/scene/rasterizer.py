"""Compiled kernels of the camera picture: triangles into samples of depth.

Rules
-----
* Pixel centres lie at integers: pixel i reaches from i - 0.5 to i + 0.5, and holds ``ss`` by ``ss`` samples.
* The depth buffer keeps 1/z, which is affine in the picture; larger is nearer.
* A row of the triangle table ``tri``, in samples, is: two left edges and two right ones (LEFT, RIGHT; one that is alone
  is there twice) as s, t of x = s y + t, between which it lies; 1/z (INVERSE) and red, green, blue from 0 to 255
  (COLOUR) as a x + b y + c; least and greatest colour of its corners (LEAST, MOST). A level edge is the box's.
* A ``corner`` or screen vertex is x, y in samples and 1/z.
* No views of arrays are taken in loops over pixels: each costs as much as the pixel. Indices that cannot be negative
  are unsigned there, so that the loop holds no test for it.
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

NEAR_M = 0.2
BLOCK = 16
SKY = -1
LEFT, RIGHT, INVERSE, COLOUR, LEAST, MOST, COLUMNS = 0, 4, 8, 11, 20, 23, 26


def kernel(function: Any) -> Any:
    """Compile as every kernel here is: cached, without the interpreter's lock, exact floating point."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)


@kernel
def transmission(x: float, y: float, z: float, air: F64, waves: F64) -> float:
    """Return what haze and cloud leave of the radiance of a point in camera axes; see ``air``.

    ``air`` (5,): share that haze leaves, extinction per metre, radiance; ``waves`` (n, 5): vector in camera axes, phase
    at the camera, amplitude.
    """
    if air[1] == 0.0:
        return air[0]
    density = 1.0
    for w in range(len(waves)):
        half = 0.5 * (waves[w, 0] * x + waves[w, 1] * y + waves[w, 2] * z)
        density += waves[w, 4] * math.sin(half + waves[w, 3])
    return air[0] * math.exp(-air[1] * max(density, 0.0) * math.sqrt(x * x + y * y + z * z))


@kernel
def light_vertices(vertices: F64, normals: F64, colours: F64, part: I32, T: F64, R_ned: F64, light: F64, air: F64,
                   waves: F64, xyz: F64, rgb: F64) -> None:
    """Turn vertices (n, 3) into camera axes ``xyz`` and shade them into ``rgb`` (n, 3).

    ``T`` (k, 3, 4) maps part k to the camera, ``R_ned`` (k, 3, 3) its normals to north-east-down. ``light`` rows:
    direction to the sun, sunlight, light from above and from below; what is reflected is colour times their sum, and
    seen through ``air`` and its ``waves`` (see ``transmission``).
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
        left = transmission(xyz[i, 0], xyz[i, 1], xyz[i, 2], air, waves)
        if left < 1.0:
            for r in range(3):
                rgb[i, r] = left * rgb[i, r] + (1.0 - left) * air[2 + r]


@kernel
def project_vertices(xyz: F64, lens: F64, screen: F64) -> None:
    """Write x, y in samples and 1/z of points in camera axes to ``screen``, in the first three columns of both.

    It may be ``xyz`` itself. What is written is meaningless for points that are not ahead.
    """
    for i in range(len(xyz)):
        w = 1.0 / xyz[i, 2]
        screen[i, 0] = lens[0] * xyz[i, 0] * w + lens[2]
        screen[i, 1] = lens[1] * xyz[i, 1] * w + lens[3]
        screen[i, 2] = w


@kernel
def put_plane(corner: F64, of: int, inverse: float, tri: F64, t: int, k: int) -> None:
    """Write a, b, c of the affine function that has row ``of`` of ``corner`` at its corners to ``tri[t, k:k + 3]``.

    ``inverse`` is one over twice the area of the triangle.
    """
    x1, x2 = corner[0, 1] - corner[0, 0], corner[0, 2] - corner[0, 0]
    y1, y2 = corner[1, 1] - corner[1, 0], corner[1, 2] - corner[1, 0]
    d1, d2 = corner[of, 1] - corner[of, 0], corner[of, 2] - corner[of, 0]
    a, b = (d1 * y2 - d2 * y1) * inverse, (d2 * x1 - d1 * x2) * inverse
    tri[t, k], tri[t, k + 1], tri[t, k + 2] = a, b, corner[of, 0] - a * corner[0, 0] - b * corner[1, 0]


@kernel
def put_edges(corner: F64, tri: F64, t: int) -> None:
    """Write the left and right edges of a triangle wound so that its area is positive to row t of the table."""
    left, right = LEFT, RIGHT
    for i in range(3):
        j = (i + 1) % 3
        a = corner[1, i] - corner[1, j]
        if a == 0.0:
            continue
        inverse = 1.0 / a  # the neighbour along this edge has exactly the same with both signs turned
        slope = (corner[0, i] - corner[0, j]) * inverse
        at = (corner[0, j] * corner[1, i] - corner[0, i] * corner[1, j]) * inverse
        if a > 0.0:
            tri[t, left], tri[t, left + 1] = slope, at
            left += 2
        else:
            tri[t, right], tri[t, right + 1] = slope, at
            right += 2
    if left == LEFT + 2:
        tri[t, LEFT + 2], tri[t, LEFT + 3] = tri[t, LEFT], tri[t, LEFT + 1]
    if right == RIGHT + 2:
        tri[t, RIGHT + 2], tri[t, RIGHT + 3] = tri[t, RIGHT], tri[t, RIGHT + 1]


@kernel
def put_triangle(corner: F64, size: I32, tri: F64, box: I32, t: int) -> bool:
    """Fill row t of the triangle table from the columns of ``corner`` (6, 3): x, y, 1/z, red, green, blue.

    ``size`` width and height in samples, ``box`` least and greatest column and row of samples. Returns False when it
    faces away or nothing of it is in the picture.
    """
    x0, x1, x2, y0, y1, y2 = corner[0, 0], corner[0, 1], corner[0, 2], corner[1, 0], corner[1, 1], corner[1, 2]
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if not area >= 1e-9:
        return False
    x_min, x_max = max(min(x0, x1, x2), 0.0), min(max(x0, x1, x2), size[0] - 1.0)
    y_min, y_max = max(min(y0, y1, y2), 0.0), min(max(y0, y1, y2), size[1] - 1.0)
    if x_max < x_min or y_max < y_min:
        return False
    box[t, 0], box[t, 1] = math.ceil(x_min), math.floor(x_max)
    box[t, 2], box[t, 3] = math.ceil(y_min), math.floor(y_max)
    if box[t, 0] > box[t, 1] or box[t, 2] > box[t, 3]:
        return False
    put_edges(corner, tri, t)
    inverse = 1.0 / area
    put_plane(corner, 2, inverse, tri, t, INVERSE)
    for c in range(3):
        f0, f1, f2 = corner[3 + c, 0], corner[3 + c, 1], corner[3 + c, 2]
        put_plane(corner, 3 + c, inverse, tri, t, COLOUR + 3 * c)
        tri[t, LEAST + c], tri[t, MOST + c] = min(f0, f1, f2), max(f0, f1, f2)
    return True


@kernel
def set_up_triangles(xyz: F64, rgb: F64, triangles: I32, lens: F64, size: I32, screen: F64, tri: F64, box: I32) -> int:
    """Clip at the near plane, cull what faces away or lies outside, fill ``tri`` and ``box``; returns their count.

    ``lens`` fx fy cx cy in samples; ``screen`` (n, 3) is work space.
    """
    project_vertices(xyz, lens, screen)
    count = np.int64(0)  # a bare zero would have put_triangle compiled for it and once more
    corner, space, poly = np.empty((6, 3)), np.empty((3, 6)), np.ones((4, 6))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 2], triangles[t, 1], triangles[t, 0]
        ahead = (xyz[a, 2] > NEAR_M) + (xyz[b, 2] > NEAR_M) + (xyz[c, 2] > NEAR_M)
        if ahead == 3:
            x, y = screen[a, 0], screen[a, 1]
            if (screen[b, 0] - x) * (screen[c, 1] - y) <= (screen[c, 0] - x) * (screen[b, 1] - y):
                continue
            for n in range(3):
                corner[n, 0], corner[n, 1], corner[n, 2] = screen[a, n], screen[b, n], screen[c, n]
                k = 3 + n
                corner[k, 0], corner[k, 1], corner[k, 2] = 255.0 * rgb[a, n], 255.0 * rgb[b, n], 255.0 * rgb[c, n]
            count += put_triangle(corner, size, tri, box, count)
        elif ahead > 0:
            for k in range(3):
                for n in range(3):
                    space[k, n], space[k, 3 + n] = xyz[triangles[t, 2 - k], n], 255.0 * rgb[triangles[t, 2 - k], n]
            corners = clip_near(space, poly)
            project_vertices(poly, lens, poly)
            for k in range(1, corners - 1):
                for n in range(6):
                    corner[n, 0], corner[n, 1], corner[n, 2] = poly[0, n], poly[k, n], poly[k + 1, n]
                count += put_triangle(corner, size, tri, box, count)
    return int(count)


@kernel
def clip_near(space: F64, poly: F64) -> int:
    """Cut a triangle (3, 6: x y z in camera axes, colour) at z = NEAR_M.

    Writes the polygon that is left to ``poly`` (4, 6) and returns its corners.
    """
    n = 0
    for i in range(3):
        j = (i + 1) % 3
        here, there = space[i, 2] - NEAR_M, space[j, 2] - NEAR_M
        if here > 0.0:
            for k in range(6):
                poly[n, k] = space[i, k]
            n += 1
        if (here > 0.0) != (there > 0.0):
            for k in range(6):
                poly[n, k] = space[i, k] + (space[j, k] - space[i, k]) * (here / (here - there))
            poly[n, 2] = NEAR_M
            n += 1
    return n


@kernel
def draw_triangle(row: F64, index: int, bounds: I32, x0: int, y0: int, depth: F32, ident: I32) -> None:
    """Draw one triangle into a tile whose first sample is (x0, y0), row by row between its edges.

    A row is worked on in whole BLOCKs, as many samples at a time as the processor takes: most rows are shorter than
    one, and starting and ending on its own samples would cost more than the samples.
    """
    edge = depth.shape[0]
    s0, t0, s1, t1 = row[LEFT], row[LEFT + 1], row[LEFT + 2], row[LEFT + 3]
    s2, t2, s3, t3 = row[RIGHT], row[RIGHT + 1], row[RIGHT + 2], row[RIGHT + 3]
    low, high = float(max(bounds[0], x0)), float(min(bounds[1], x0 + edge - 1))
    step, w_y, w_0 = np.float32(row[INVERSE]), row[INVERSE + 1], row[INVERSE + 2] + row[INVERSE] * x0
    for j in range(max(bounds[2], y0), min(bounds[3], y0 + edge - 1) + 1):
        y = float(j)
        left, right = max(low, s0 * y + t0, s1 * y + t1) - x0, min(high, s2 * y + t2, s3 * y + t3) - x0
        if right < left:
            continue
        i0, i1 = int(left), int(right)
        first, last = np.float32(i0 + (left > i0)), np.float32(i1)
        w, line = np.float32(w_y * y + w_0), np.uint64(j - y0)
        for i in range(np.uint64(i0 // BLOCK * BLOCK), np.uint64(min(i1 // BLOCK * BLOCK + BLOCK, edge))):
            x = np.float32(np.int32(i))
            wi = w + step * x
            if (wi > depth[line, i]) & (x >= first) & (x <= last):
                depth[line, i] = wi
                ident[line, i] = index


@kernel
def draw_depth(xyz: F64, triangles: I32, lens: F64, size: I32, tri: F64, box: I32) -> F32:
    """Return 1/z (n, n) of a square picture of ``size`` with one sample per pixel, 0 where there is nothing.

    ``tri`` and ``box`` are work space with a row per triangle, enough when all are ahead of the camera.
    """
    count = set_up_triangles(xyz, xyz, triangles, lens, size, np.empty_like(xyz), tri, box)
    depth, ident = np.zeros((size[0], size[0]), np.float32), np.empty((size[0], size[0]), np.int32)
    for t in range(count):
        draw_triangle(tri[t], t, box[t], 0, 0, depth, ident)
    return depth
