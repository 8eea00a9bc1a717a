"""Marker detection, compiled: what a component of lit pixels measures (see ``companion.vision.detection``).

The opening behind a marker slides a least value over rows and columns by doubling its width, so that its cost grows
with the logarithm of the width.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat
from companion.vision.detection_kernel import BOTTOM, FIRST, I32, LAST, LEFT, OWNER, RIGHT, ROW, TOP, U8, kernel

I16 = NDArray[np.int16]

RIM_PX = 1
"""How far beyond its lit pixels a marker's light reaches."""

U, V, TOTAL, PEAK, XX, XY, YY, NOISE_U, NOISE_V, HUE, CLIPPED, WHITE, BRIGHT, CORE, COLUMNS = range(15)
"""Columns of a table of measures.

Centroid in px; covered area in px; greatest redness; second central moments in px^2 over the covered area; variance of
the centroid in px^2 for a redness noise of one step; greatest redness as a share of red less the least channel there, 1
for red and 0 for yellow or magenta; pixels whose red is at the end of the scale; share of pixels whose channels all
are; greatest value of a pixel's least channel, 0..1; redness at the centroid as a share of the greatest.
"""

CLIP = 254
"""A channel from here on is at the end of its scale."""

BEYOND = np.int16(32767)


@kernel
def own_pixels(runs: I32, c: int, left: int, top: int, own: U8) -> None:
    """Mark in ``own``, whose first pixel is (left, top), component c and its rim, without what is lit of others."""
    h, w = own.shape
    own[:] = 0
    start, end = np.searchsorted(runs[:, ROW], top - RIM_PX), np.searchsorted(runs[:, ROW], top + h + RIM_PX)
    for k in range(start, end):
        if runs[k, OWNER] == c:
            for y in range(max(runs[k, ROW] - RIM_PX - top, 0), min(runs[k, ROW] + RIM_PX - top, h - 1) + 1):
                for x in range(max(runs[k, FIRST] - RIM_PX - left, 0), min(runs[k, LAST] + RIM_PX - left, w - 1) + 1):
                    own[y, x] = 1
    for k in range(start, end):
        y = runs[k, ROW] - top
        if runs[k, OWNER] != c and 0 <= y < h:
            for x in range(max(runs[k, FIRST] - left, 0), min(runs[k, LAST] - left, w - 1) + 1):
                own[y, x] = 0


@kernel
def slide_least(values: I16, size: int) -> None:
    """Replace each value by the least of the square of ``size`` whose first corner it is; the last ones are void."""
    h, w = values.shape
    width = 1
    while width < size:
        step = min(width, size - width)
        for j in range(h):
            for i in range(w - step):
                values[j, i] = min(values[j, i], values[j, i + step])
        for j in range(h - step):
            for i in range(w):
                values[j, i] = min(values[j, i], values[j + step, i])
        width += step


@kernel
def surroundings(image: U8, left: int, top: int, h: int, w: int, size: int) -> I16:
    """Return the opening (h, w) of the redness with a square of ``size`` in the window whose first pixel is given.

    Redness is signed here: the sky's is far below zero. What is beyond the picture is left out.
    """
    half, reach = size // 2, size - 1  # the opening looks this far: once for the least, once for the greatest
    values = np.full((h + 2 * reach, w + 2 * reach), BEYOND, np.int16)
    for j in range(max(reach - top, 0), min(h + 2 * reach, image.shape[0] + reach - top)):
        for i in range(max(reach - left, 0), min(w + 2 * reach, image.shape[1] + reach - left)):
            y, x = top - reach + j, left - reach + i
            values[j, i] = np.int16(image[y, x, 0]) - np.int16(max(image[y, x, 1], image[y, x, 2]))
    slide_least(values, size)
    for j in range(h + reach):
        inside = 0 <= top - half + j < image.shape[0]
        for i in range(w + reach):
            values[j, i] = -values[j, i] if inside and 0 <= left - half + i < image.shape[1] else BEYOND
    slide_least(values[: h + reach, : w + reach], size)
    return -values[:h, :w]


@kernel
def moments(share: Mat, weight: Mat, out: Mat) -> None:
    """Fill TOTAL, U, V, XX, XY, YY, NOISE_U and NOISE_V of ``out`` from shares (h, w), places from the first pixel.

    ``weight`` is what one step of redness adds to each share.
    """
    h, w = share.shape
    total, u, v = 0.0, 0.0, 0.0
    for j in range(h):
        for i in range(w):
            total, u, v = total + share[j, i], u + share[j, i] * i, v + share[j, i] * j
    u, v = u / total, v / total
    xx, xy, yy, noise_u, noise_v = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(h):
        for i in range(w):
            s, x, y, n = share[j, i], i - u, j - v, weight[j, i] ** 2
            xx, xy, yy = xx + s * x * x, xy + s * x * y, yy + s * y * y
            noise_u, noise_v = noise_u + n * x * x, noise_v + n * y * y
    out[TOTAL], out[U], out[V] = total, u, v
    out[XX], out[XY], out[YY] = xx / total, xy / total, yy / total
    out[NOISE_U], out[NOISE_V] = noise_u / total**2, noise_v / total**2


@kernel
def measure(image: U8, runs: I32, c: int, box: I32, out: Mat) -> None:
    """Fill a row of measures (COLUMNS,) of component c, weighted with how much of each pixel it covers.

    The surroundings are the morphological opening of the redness with a square wider than the marker: it follows a
    step from sky to fuselage behind the marker, where one level for all would draw the centroid to one side.
    """
    left, right = max(box[LEFT] - RIM_PX, 0), min(box[RIGHT] + RIM_PX, image.shape[1] - 1)
    top, bottom = max(box[TOP] - RIM_PX, 0), min(box[BOTTOM] + RIM_PX, image.shape[0] - 1)
    h, w = bottom - top + 1, right - left + 1
    size = (max(box[RIGHT] - box[LEFT], box[BOTTOM] - box[TOP]) + 2 * RIM_PX + 2) | 1
    own = np.empty((h, w), np.uint8)
    own_pixels(runs, c, left, top, own)
    ground, level = surroundings(image, left, top, h, w, size), np.empty((h, w), np.int16)
    full, chroma, bright, clipped, white, area = np.int16(0), 1, 0, 0.0, 0.0, 0.0
    for j in range(h):
        for i in range(w):
            red, other = image[top + j, left + i, 0], max(image[top + j, left + i, 1], image[top + j, left + i, 2])
            least = min(red, image[top + j, left + i, 1], image[top + j, left + i, 2])
            level[j, i] = np.int16(red) - np.int16(other)
            if own[j, i] and level[j, i] > full:
                full, chroma = level[j, i], red - least
            clipped += own[j, i] * (red >= CLIP)
            white += own[j, i] * (least >= CLIP)
            bright = max(bright, least * own[j, i])
            area += own[j, i]
    share, weight, any_red = np.empty((h, w)), np.empty((h, w)), False
    for j in range(h):
        for i in range(w):
            weight[j, i] = own[j, i] / max(full - ground[j, i], 1)
            share[j, i] = weight[j, i] * (level[j, i] - ground[j, i])
            any_red |= share[j, i] > 0.0
    if not any_red:  # as red all around as itself, which only a picture no larger than the component can be
        for j in range(h):
            for i in range(w):
                share[j, i] = own[j, i]
    moments(share, weight, out)
    out[PEAK], out[HUE], out[CLIPPED], out[WHITE] = full, full / chroma, clipped, white / area
    out[BRIGHT] = bright / 255.0
    out[CORE] = level[int(out[V] + 0.5), int(out[U] + 0.5)] / max(full, 1)
    out[U], out[V] = out[U] + left, out[V] + top


@kernel
def measures(image: U8, runs: I32, found: I32, kept: NDArray[np.int64]) -> Mat:
    """Return the measures (n, COLUMNS) of the components named in ``kept``."""
    table = np.empty((len(kept), COLUMNS))
    for n in range(len(kept)):
        measure(image, runs, kept[n], found[kept[n]], table[n])
    return table
