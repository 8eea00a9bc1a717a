"""Marker detection, compiled: noise, redness, runs of lit pixels, components (see ``companion.vision.detection``).

Runs of lit pixels, row by row, are joined into components with 8 neighbours (Rosenfeld and Pfaltz 1966, on runs).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

ROW, FIRST, LAST, OWNER = range(4)
"""Columns of a table of runs: row, first and last column of pixels, and the component."""

NOISE_ROWS, NOISE_SAMPLES, NOISE_USUAL = 40, 500, 1.5
NOISE_LEAST = 0.4
"""Rounding to whole steps alone has 0.29."""

SECOND_DIFFERENCE = 0.6745 * 6.0**0.5
"""Median of the magnitude of a - 2 b + c, where each has a normal deviation of one."""

AREA, LEFT, RIGHT, TOP, BOTTOM = range(5)
"""Columns of a table of components: lit pixels, and the first and last column and row of them."""


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
def noise_of(image: U8) -> tuple[float, float]:
    """Return the sensor's noise in one channel and the share of pixels whose green is at the end of its scale.

    The noise is a standard deviation in steps of 1/255, at least NOISE_LEAST.

    The median of the second differences of green along NOISE_ROWS rows, which edges hardly move; an integer v stands
    for all of v - 0.5 to v + 0.5. Pixels at either end of the scale have lost their noise and are left out; where few
    are left, NOISE_USUAL.
    """
    h, w, _ = image.shape
    seen = np.zeros(1021, np.int32)
    count, looked, white = 0, 1, 0
    for y in range(0, h, max(h // NOISE_ROWS, 1)):
        for x in range(1, w - 1, 2):
            a, b, c = np.int32(image[y, x - 1, 1]), np.int32(image[y, x, 1]), np.int32(image[y, x + 1, 1])
            inside = min(a, b, c) > 0 and max(a, b, c) < 255
            seen[abs(a - 2 * b + c)] += inside
            count += int(inside)
            looked += 1
            white += int(b == 255)
    if count < NOISE_SAMPLES:
        return NOISE_USUAL, white / looked
    below, v = 0, 0
    while v < 1020 and 2 * (below + seen[v]) < count:
        below += int(seen[v])
        v += 1
    inner = (0.5 * count - below) / max(seen[v], 1)
    median = 0.5 * inner if v == 0 else v - 0.5 + inner
    return max(NOISE_LEAST, median / SECOND_DIFFERENCE), white / looked


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
