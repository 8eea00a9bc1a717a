"""Marker detection, compiled: redness, runs of lit pixels, components, centroids (see ``companion.vision.detection``).

Runs of lit pixels, row by row, are joined into components with 8 neighbours (Rosenfeld and Pfaltz 1966, on runs). The
opening behind a marker slides a least value over rows and columns by doubling its width, so that its cost grows with
the logarithm of the width.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat

U8 = NDArray[np.uint8]
I16 = NDArray[np.int16]
I32 = NDArray[np.int32]

RIM_PX = 1
"""How far beyond its lit pixels a marker's light reaches."""

ROW, FIRST, LAST, OWNER = range(4)
"""Columns of a table of runs: row, first and last column of pixels, and the component."""

AREA, LEFT, RIGHT, TOP, BOTTOM = range(5)
"""Columns of a table of components: lit pixels, and the first and last column and row of them."""

BEYOND = np.int16(32767)


def kernel(function: Any) -> Any:
    """Compile as every kernel here is: cached, without the interpreter's lock, exact floating point."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)


@kernel
def redness_of(image: U8) -> U8:
    """Return red less the larger of green and blue, or zero when that is less, of a picture (h, w, 3)."""
    h, w, _ = image.shape
    redness = np.empty((h, w), np.uint8)
    for y in range(h):
        for x in range(w):
            red, other = image[y, x, 0], max(image[y, x, 1], image[y, x, 2])
            redness[y, x] = max(red, other) - other
    return redness


@kernel
def find_runs(values: U8, level: int) -> I32:
    """Return the runs (n, 4) of pixels whose value is above ``level``, in raster order, without owners."""
    h, w = values.shape
    runs = np.empty((h * ((w + 1) // 2), 4), np.int32)
    n = 0
    for y in range(h):
        brightest = np.uint8(0)
        for x in range(w):
            brightest = max(brightest, values[y, x])
        if brightest <= level:
            continue
        before = False
        for x in range(w):
            lit = values[y, x] > level
            if lit and not before:
                runs[n, ROW], runs[n, FIRST] = y, x
                n += 1
            if lit:
                runs[n - 1, LAST] = x
            before = lit
    return runs[:n].copy()


@kernel
def root_of(runs: I32, k: int) -> int:
    """Return the first run of the tree that run k is in, and hang the run nearer to it."""
    while runs[k, OWNER] != k:
        runs[k, OWNER] = runs[runs[k, OWNER], OWNER]
        k = runs[k, OWNER]
    return k


@kernel
def join_runs(runs: I32) -> I32:
    """Give every run its component, in raster order of their topmost pixels; return the components (m, 5)."""
    above = 0
    for k in range(len(runs)):
        runs[k, OWNER] = k
        while runs[above, ROW] < runs[k, ROW] - 1 or (
            runs[above, ROW] == runs[k, ROW] - 1 and runs[above, LAST] < runs[k, FIRST] - 1
        ):
            above += 1
        i = above
        while runs[i, ROW] == runs[k, ROW] - 1 and runs[i, FIRST] <= runs[k, LAST] + 1:
            a, b = root_of(runs, i), root_of(runs, k)
            runs[max(a, b), OWNER] = min(a, b)
            i += 1
    found = np.empty((len(runs), 5), np.int32)
    m = 0
    for k in range(len(runs)):
        row, first, last, up = runs[k, ROW], runs[k, FIRST], runs[k, LAST], runs[k, OWNER]
        if up == k:
            found[m, AREA], found[m, LEFT], found[m, RIGHT], found[m, TOP] = 0, first, last, row
            c, m = m, m + 1
        else:
            c = runs[up, OWNER]  # of an earlier run, which has its component by now
        runs[k, OWNER] = c
        found[c, AREA] += last - first + 1
        found[c, LEFT], found[c, RIGHT] = min(found[c, LEFT], first), max(found[c, RIGHT], last)
        found[c, BOTTOM] = row
    return found[:m].copy()


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
def centroid(image: U8, runs: I32, c: int, box: I32) -> tuple[float, float]:
    """Return the centroid (u, v) in px of component c, weighted with how much of each pixel it covers.

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
    full = 0
    for j in range(h):
        for i in range(w):
            y, x = top + j, left + i
            level[j, i] = np.int16(image[y, x, 0]) - np.int16(max(image[y, x, 1], image[y, x, 2]))
            full = max(full, level[j, i] * own[j, i])
    total, u, v, area, x_own, y_own = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(h):
        for i in range(w):
            share = own[j, i] * (level[j, i] - ground[j, i]) / max(full - ground[j, i], 1)
            total, u, v = total + share, u + share * i, v + share * j
            area, x_own, y_own = area + own[j, i], x_own + own[j, i] * i, y_own + own[j, i] * j
    if not total > 0.0:  # as red all around as itself, which only a picture no larger than the component can be
        total, u, v = area, x_own, y_own
    return left + u / total, top + v / total


@kernel
def centroids(image: U8, runs: I32, found: I32, kept: NDArray[np.int64]) -> Mat:
    """Return the centroids (n, 2) in px of the components named in ``kept``."""
    uv = np.empty((len(kept), 2))
    for n in range(len(kept)):
        uv[n, 0], uv[n, 1] = centroid(image, runs, kept[n], found[kept[n]])
    return uv
