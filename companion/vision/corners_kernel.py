"""Corner detection, compiled: structure tensor, least eigenvalue, point estimate (see ``companion.vision.corners``)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

BOX = 2
"""Half the width less one half of the square over which the tensor is averaged for a candidate: 5 by 5 pixels."""

STEPS = 10
SETTLED_PX = 0.005

U, V, SIGMA, STRENGTH = range(4)
"""Columns of a table of corners: place in px, standard deviation in px, least eigenvalue of the averaged tensor."""


def kernel(function: Any) -> Any:
    """Compile as every kernel here is: cached, without the interpreter's lock, exact floating point."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)


@kernel
def tensors(image: U8, left: int, top: int, h: int, w: int) -> F32:
    """Return g_x g_x, g_x g_y, g_y g_y (3, h, w), summed over the colours, of the window that starts at (left, top).

    Gradients are Scharr's, in steps of 1/255 per px. Zero on and beyond the picture's border. Products of whole numbers
    side by side, as the colours lie in the picture, so that many are worked on at a time.
    """
    field = np.zeros((3, h, w), np.float32)
    flat, stride, scale = image.reshape(-1), 3 * image.shape[1], np.float32(1.0 / 32.0**2)
    first, last = max(1 - left, 0), min(w, image.shape[1] - 1 - left)
    n = max(3 * (last - first), 0)
    product = np.empty((3, n), np.int32)
    for j in range(max(1 - top, 0), min(h, image.shape[0] - 1 - top)):
        start = (top + j) * stride + 3 * (left + first)
        above, here, below = flat[start - stride - 3 :], flat[start - 3 :], flat[start + stride - 3 :]
        for k in range(n):
            falling = np.int32(below[k + 6]) - np.int32(above[k])
            rising = np.int32(above[k + 6]) - np.int32(below[k])
            gx = np.int32(3) * (falling + rising) + np.int32(10) * (np.int32(here[k + 6]) - np.int32(here[k]))
            gy = np.int32(3) * (falling - rising) + np.int32(10) * (np.int32(below[k + 3]) - np.int32(above[k + 3]))
            product[0, k], product[1, k], product[2, k] = gx * gx, gx * gy, gy * gy
        for c in range(3):
            for i in range(first, last):
                k = 3 * (i - first)
                field[c, j, i] = scale * np.float32(product[c, k] + product[c, k + 1] + product[c, k + 2])
    return field


@kernel
def least_eigenvalues(field: F32) -> F32:
    """Return the least eigenvalue (h, w) of the tensor averaged over a square; zero where that is not whole."""
    _, h, w = field.shape
    n = 2 * BOX + 1
    strength = np.zeros((h, w), np.float32)
    rows = np.empty((3, h, w), np.float32)
    for k in range(3):
        for j in range(h):
            for i in range(BOX, w - BOX):
                total = np.float32(0.0)
                for d in range(n):
                    total += field[k, j, i - BOX + d]
                rows[k, j, i] = total
    share = np.float32(1.0 / (n * n))
    for j in range(BOX, h - BOX):
        for i in range(BOX, w - BOX):
            a, b, c = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for d in range(n):
                a, b, c = a + rows[0, j - BOX + d, i], b + rows[1, j - BOX + d, i], c + rows[2, j - BOX + d, i]
            half, skewed = np.float32(0.5) * (a + c), np.float32(0.5) * (a - c)
            strength[j, i] = (half - math.sqrt(skewed * skewed + b * b)) * share
    return strength


@kernel
def is_greatest(strength: F32, j: int, i: int, apart: int) -> bool:
    """Return whether nothing in the square about (j, i) is greater; of equals the first one counts."""
    h, w = strength.shape
    value = strength[j, i]
    for y in range(max(j - apart, 0), min(j + apart + 1, h)):
        for x in range(max(i - apart, 0), min(i + apart + 1, w)):
            if strength[y, x] > value or (strength[y, x] == value and (y < j or (y == j and x < i))):
                return False
    return True


@kernel
def peaks(strength: F32, margin: int, apart: int, least: float, places: I64) -> int:
    """Write row and column of the strongest local maxima to ``places`` (most, 2), strongest first; return how many.

    A maximum is the greatest of the square of ``apart`` pixels to each side, no nearer to the rim than ``margin``.
    """
    h, w = strength.shape
    most, count = len(places), 0
    for j in range(margin, h - margin):
        for i in range(margin, w - margin):
            value = strength[j, i]
            if value < least or (count == most and value <= strength[places[most - 1, 0], places[most - 1, 1]]):
                continue
            if not is_greatest(strength, j, i, apart):
                continue
            n = count if count < most else most - 1
            while n > 0 and strength[places[n - 1, 0], places[n - 1, 1]] < value:
                places[n, 0], places[n, 1] = places[n - 1, 0], places[n - 1, 1]
                n -= 1
            places[n, 0], places[n, 1] = j, i
            count = min(count + 1, most)
    return count


@kernel
def point_estimate(field: F32, j: float, i: float, radius: int) -> tuple[float, float, float]:
    """Return (row, column, sigma in px) of the point nearest to all edge lines about (j, i); sigma NaN for none.

    Least squares of the distances to the lines through every pixel across its gradient, weighted with the squared
    gradient and a Gaussian about the estimate (Forstner and Gulch 1987), repeated until it stands.
    """
    _, h, w = field.shape
    y0, x0 = j, i
    spread = -0.5 / (0.5 * radius) ** 2
    bell = np.empty(2 * radius + 1)
    sigma = math.nan
    for _ in range(STEPS):
        a, b, c, p, q, r, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        row, column = math.floor(y0 + 0.5), math.floor(x0 + 0.5)
        for k in range(2 * radius + 1):
            bell[k] = math.exp(spread * (column - radius + k - x0) ** 2)
        for y in range(max(row - radius, 0), min(row + radius + 1, h)):
            dy = y - y0
            of_row = math.exp(spread * dy * dy)
            for x in range(max(column - radius, 0), min(column + radius + 1, w)):
                dx, weight = x - x0, of_row * bell[x - column + radius]
                xx, xy, yy = weight * field[0, y, x], weight * field[1, y, x], weight * field[2, y, x]
                a, b, c, total = a + xx, b + xy, c + yy, total + weight
                p, q = p + xx * dx + xy * dy, q + xy * dx + yy * dy
                r += xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy
        determinant = a * c - b * b
        if not determinant > 1e-6 * (a + c) ** 2:
            return y0, x0, math.nan
        x_step, y_step = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        y0, x0 = y0 + y_step, x0 + x_step
        misfit = max(r - p * x_step - q * y_step, 0.0) / total
        sigma = math.sqrt(0.5 * misfit * (a + c) / determinant)
        if abs(y0 - j) > radius or abs(x0 - i) > radius:
            return y0, x0, math.nan
        if abs(x_step) + abs(y_step) < SETTLED_PX:
            break
    return y0, x0, sigma


@kernel
def same_corner(found: Mat, count: int, u: float, v: float, apart: int) -> int:
    """Return which of the first ``count`` corners is nearer to (u, v) than ``apart`` px; ``count`` when none is."""
    for m in range(count):
        if (found[m, U] - u) ** 2 + (found[m, V] - v) ** 2 < apart * apart:
            return m
    return count


@kernel
def corners_in(image: U8, windows: I64, most: int, radius: int, apart: int, least: float, found: Mat) -> int:
    """Write the corners of ``windows`` (n, 4: first and last column, first and last row) to ``found`` (n * most, 4).

    Of corners nearer to each other than ``apart`` px the strongest stays; returns how many are left.
    """
    count, margin = np.int64(0), radius + BOX + 1
    places = np.empty((most, 2), np.int64)
    taken = np.empty((len(found), 2), np.int64)  # pixels that other windows share and have measured
    measured = 0
    for k in range(len(windows)):
        left, top = windows[k, 0] - margin, windows[k, 2] - margin
        h, w = windows[k, 3] - windows[k, 2] + 1 + 2 * margin, windows[k, 1] - windows[k, 0] + 1 + 2 * margin
        field = tensors(image, left, top, h, w)
        strength = least_eigenvalues(field)
        for n in range(peaks(strength, margin, apart, least, places)):
            row, column = places[n, 0], places[n, 1]
            again = False
            for m in range(measured):
                again |= taken[m, 0] == top + row and taken[m, 1] == left + column
            if again:
                continue
            taken[measured, 0], taken[measured, 1] = top + row, left + column
            measured += 1
            y, x, sigma = point_estimate(field, float(row), float(column), radius)
            if math.isnan(sigma):
                continue
            m = same_corner(found, count, left + x, top + y, apart)
            if m < count and found[m, STRENGTH] >= strength[row, column]:
                continue
            found[m, U], found[m, V] = left + x, top + y
            found[m, SIGMA], found[m, STRENGTH] = sigma, strength[row, column]
            count = max(count, m + 1)
    return int(count)
