"""Compiled kernels of the sky behind everything.

The sky is looked up at every second pixel, as fine as the cube's own faces, and halved between. The three channels of a
texel share one word (``pack_sky``), so that one multiplication weighs all three.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scene.rasterizer import F64, I32, U8, kernel

U16 = NDArray[np.uint16]
U64 = NDArray[np.uint64]

LANE_BITS = 21
"""Bits of a channel in a packed texel: 8 of its value and 2 * PART_BITS of its weight, and one to spare."""

PART_BITS = 6
"""A texel is divided into 2^PART_BITS parts along each axis."""

PART = 1 << PART_BITS
LANE = (1 << LANE_BITS) - 1


def pack_sky(cube: U8) -> U64:
    """Return a sky cube (6, n, n, 3) as words (6 n, n), red lowest, face below face."""
    wide = cube.reshape(-1, cube.shape[2], 3).astype(np.uint64)
    return wide[..., 0] | wide[..., 1] << np.uint64(LANE_BITS) | wide[..., 2] << np.uint64(2 * LANE_BITS)


@kernel
def find_texels(n: int, R_ned_cam: F64, lens: F64, y: int, texels: I32) -> None:
    """Find where the pixels 0, 2, 4, ... of row y look in a sky cube whose faces have n by n texels.

    Face 2 k is seen along +axis k of north-east-down, 2 k + 1 along -axis k; columns and rows are the next two axes.
    ``texels`` (3, ...) gets the texel's place in the flat cube and how far past its middle, in PARTs, right and down.
    """
    half, across, down = 0.5 * (n - 1) * PART, 1.0 / lens[0], (y - lens[3]) / lens[1]
    r0, r1, r2 = R_ned_cam[0, 0], R_ned_cam[1, 0], R_ned_cam[2, 0]
    b0 = R_ned_cam[0, 1] * down + R_ned_cam[0, 2]
    b1 = R_ned_cam[1, 1] * down + R_ned_cam[1, 2]
    b2 = R_ned_cam[2, 1] * down + R_ned_cam[2, 2]
    size, last = np.int32(n), np.int32(n - 2)
    for i in range(texels.shape[1]):
        x = (2 * i - lens[2]) * across
        d0, d1, d2 = r0 * x + b0, r1 * x + b1, r2 * x + b2
        # Chosen, not branched to, so that a row is found several at a time.
        first, second = (abs(d0) >= abs(d1)) & (abs(d0) >= abs(d2)), abs(d1) >= abs(d2)
        face = np.int32(0) if first else (np.int32(2) if second else np.int32(4))
        m = d0 if first else (d1 if second else d2)
        p = d1 if first else (d2 if second else d0)
        q = d2 if first else (d0 if second else d1)
        scale = half / abs(m)
        u, v = np.int32(p * scale + half + 0.5), np.int32(q * scale + half + 0.5)
        column, row = min(u >> np.int32(PART_BITS), last), min(v >> np.int32(PART_BITS), last)
        texels[0, i] = ((face + np.int32(m <= 0.0)) * size + row) * size + column
        texels[1, i], texels[2, i] = u - column * np.int32(PART), v - row * np.int32(PART)


@kernel
def look_up_sky(sky: U64, texels: I32, row: int, coarse: U16) -> None:
    """Write the colours at ``texels`` to a row of ``coarse``, each twice side by side, in 64ths: bilinear in the cube.

    ``sky`` (6 n, n) is the packed cube.
    """
    flat, n, one, part = sky.reshape(-1), np.uint32(sky.shape[1]), np.uint32(1), np.uint64(PART)
    for i in range(texels.shape[1]):
        k, fu, fv = np.uint32(texels[0, i]), np.uint64(texels[1, i]), np.uint64(texels[2, i])
        near = flat[k] * (part - fu) + flat[k + one] * fu
        far = flat[k + n] * (part - fu) + flat[k + n + one] * fu
        word = near * (part - fv) + far * fv
        for c in range(3):
            value = (word >> np.uint64(c * LANE_BITS + 6)) & np.uint64(LANE >> 6)
            coarse[row, 6 * i + c] = coarse[row, 6 * i + 3 + c] = value


@kernel
def draw_sky(sky: U64, R_ned_cam: F64, lens: F64, texels: I32, coarse: U16, y0: int, lines: U8) -> None:
    """Fill ``lines`` (rows, 3 w), rows of a picture from y0 on whose channels lie side by side, with the sky.

    ``texels`` (3, w / 2 + 1) and ``coarse`` (rows / 2 + 1, 6 (w / 2 + 1)) are work space. As every look-up is there
    twice, each pixel is the mean of its own, the one to the right, and in odd rows the two below them.
    """
    rows, n = lines.shape
    for j in range(rows // 2 + 1):
        find_texels(sky.shape[1], R_ned_cam, lens, y0 + 2 * j, texels)
        look_up_sky(sky, texels, j, coarse)
    for r in range(rows):
        above, below = coarse[r // 2], coarse[(r + 1) // 2]
        a, b, c, d, line = above[:n], above[3 : n + 3], below[:n], below[3 : n + 3], lines[r]
        for k in range(n):
            line[k] = (a[k] + b[k] + c[k] + d[k] + 128) >> 8
