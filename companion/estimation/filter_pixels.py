"""The filter's numbers, compiled: labelled pixels of one frame.

Rules
-----
* Pixels are taken on the plane z = 1. INS attitude noise, and what the extrapolation of travels leaves, are the same
  for all markers of one frame: they are states of their own while the frame is taken (``NOISE`` of them), so that the
  innovations have the covariance that they have, and are dropped after it.
* Pixels are not linear in the state: a frame is taken again about its own result until that does not move (iterated
  Kalman filter, Bell and Cathey 1993).
* Each marker has to stand its own gate, those that fit best before the others; with fewer than half nothing is taken.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.estimation.filter_kernel import STATES, take_scalar
from companion.geometry import Mat, Vec

NOISE = 9
WIDE = STATES + NOISE
OWN_NOISE = 16
"""Where the noise of one frame begins: attitude of the receiver's, of the tanker's INS (ned), difference of travels."""

NEAREST_M = 0.1
"""A marker nearer to the camera's plane than this is not one that was seen."""

MOST_PASSES = 12
STILL = 0.004
"""Move of the position, in parts of the distance, or of an angle in rad, after which a frame is not taken again: what
is left out goes with its square, 0.007 px at f = 457 px."""

ALL_TAKEN, NOTHING_TAKEN, UNUSABLE = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def turned(r: Vec, R: Mat, out: Mat) -> None:
    """Write exp(r) R for R (3, n) (Rodrigues, column by column)."""
    squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    a, b = 1.0 - squared / 6.0, 0.5 - squared / 24.0
    if squared > 1e-8:
        angle = np.sqrt(squared)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
    for k in range(R.shape[1]):
        p, q, s = R[0, k], R[1, k], R[2, k]
        e, f, g = r[1] * s - r[2] * q, r[2] * p - r[0] * s, r[0] * q - r[1] * p
        out[0, k] = p + a * e + b * (r[1] * g - r[2] * f)
        out[1, k] = q + a * f + b * (r[2] * e - r[0] * g)
        out[2, k] = s + a * g + b * (r[0] * f - r[1] * e)


@njit(cache=True, nogil=True, error_model="numpy")
def rotate(R: Mat, v: Vec, out: Vec) -> None:
    """Write R v."""
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@njit(cache=True, nogil=True, error_model="numpy")
def cross(a: Vec, b: Vec, out: Vec) -> None:
    """Write a x b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy")
def marker_rows(x: Vec, geometry: Mat, markers: Mat, uv: Mat, H: Mat) -> bool:
    """Write where markers (k, 3) are on z = 1, uv (k, 2), and their rows H (2 k, 25) at x; False if one is not ahead.

    ``geometry`` (9, 3): R_cam_ned by the receiver's INS and the nominal mount (0:3), R_ned_tanker as told (3:6), camera
    from the receiver's centre of mass in camera axes (6), difference of travels (7), tanker's body rates (8).
    """
    R_tanker, R_cam, lever = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 1))
    turned(x[6:9], geometry[3:6], R_tanker)
    turned(-x[12:15], geometry[0:3], R_cam)
    turned(-x[12:15], geometry[6].copy().reshape((3, 1)), lever)
    w, q, m, rate, spun = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(markers)):
        cross(geometry[8], markers[k], spun)
        rotate(R_tanker, spun, rate)
        rotate(R_tanker, markers[k], w)
        for i in range(3):
            w[i] += rate[i] * x[15]
            q[i] = w[i] - geometry[7, i] - x[i]
        rotate(R_cam, q, m)
        for i in range(3):
            m[i] -= lever[i, 0]
        if not m[2] > NEAREST_M:
            return False
        for axis in range(2):
            uv[k, axis] = m[axis] / m[2]
            axis_row(axis, m, w, q, rate, R_cam, H[2 * k + axis])
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def axis_row(axis: int, m: Vec, w: Vec, q: Vec, rate: Vec, R_cam: Mat, h: Vec) -> None:
    """Write the row (25,) of one coordinate of a marker: at m (3,) in camera axes, w (3,) from the tanker's and q (3,)
    from the receiver's centre of mass in ned, moving with ``rate`` (3,) as the tanker turns."""
    g, a = np.zeros(3), np.empty(3)
    g[axis], g[2] = 1.0 / m[2], -m[axis] / (m[2] * m[2])
    rotate(R_cam.T, g, a)
    h[:] = 0.0
    h[15] = a[0] * rate[0] + a[1] * rate[1] + a[2] * rate[2]
    cross(w, a, h[19:22])
    cross(g, m, h[12:15])
    cross(a, q, h[16:19])
    for i in range(3):
        h[i] = h[22 + i] = -a[i]
        h[6 + i] = h[19 + i]


@njit(cache=True, nogil=True, error_model="numpy")
def innovation(P: Mat, H: Mat, k: int, sigma: float) -> tuple[float, float, float]:
    """Return the covariance (uu, uv, vv) of the innovation of marker k."""
    uu, cc, vv = sigma * sigma, 0.0, sigma * sigma
    for i in range(WIDE):
        s, t = 0.0, 0.0
        for j in range(WIDE):
            s += P[i, j] * H[2 * k, j]
            t += P[i, j] * H[2 * k + 1, j]
        uu += H[2 * k, i] * s
        cc += H[2 * k + 1, i] * s
        vv += H[2 * k + 1, i] * t
    return uu, cc, vv


@njit(cache=True, nogil=True, error_model="numpy")
def squared_size(u: float, v: float, uu: float, cc: float, vv: float) -> float:
    """Return (u, v) S^-1 (u, v)^T."""
    return (vv * u * u - 2.0 * cc * u * v + uu * v * v) / (uu * vv - cc * cc)


@njit(cache=True, nogil=True, error_model="numpy")
def widened(x: Vec, P: Mat, noise: Mat, x_wide: Vec, P_wide: Mat) -> None:
    """Write state and covariance with the noise of one frame beside them; ``noise`` (9, 3) of ``InsNoise.table``."""
    x_wide[:] = 0.0
    P_wide[:, :] = 0.0
    x_wide[:STATES] = x
    P_wide[:STATES, :STATES] = P
    for k in range(NOISE // 3):
        for i in range(3):
            for j in range(3):
                P_wide[OWN_NOISE + 3 * k + i, OWN_NOISE + 3 * k + j] = noise[3 * k + i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def residual_of(x: Vec, x_at: Vec, h: Vec, measured: float, expected: float) -> float:
    """Return what is left of a measurement at x, linearised at x_at."""
    left = measured - expected
    for j in range(WIDE):
        left -= h[j] * (x[j] - x_at[j])
    return left


@njit(cache=True, nogil=True, error_model="numpy")
def one_pass(
    x: Vec, P: Mat, x_at: Vec, H: Mat, uv: Mat, expected: Mat, sigma: Vec, order: NDArray[np.int64], gate: float,
    nis: Vec,
) -> float:
    """Take markers in ``order``, in place, those within ``gate``; write their nis (k,), negative of those left out.

    Returns the sum of what was taken.
    """
    b, c = np.empty(WIDE), np.empty(WIDE)
    total = 0.0
    for k in order:
        uu, cc, vv = innovation(P, H, k, sigma[k])
        u = residual_of(x, x_at, H[2 * k], uv[k, 0], expected[k, 0])
        v = residual_of(x, x_at, H[2 * k + 1], uv[k, 1], expected[k, 1])
        nis[k] = squared_size(u, v, uu, cc, vv)
        if not nis[k] <= gate:
            nis[k] = -nis[k]
            continue
        total += nis[k]
        for axis in range(2):
            r = residual_of(x, x_at, H[2 * k + axis], uv[k, axis], expected[k, axis])
            take_scalar(x, P, H[2 * k + axis], r, sigma[k] * sigma[k], b, c)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def moved(x: Vec, x_at: Vec, distance_m: float) -> bool:
    """Tell whether the point at which a frame was taken was too far from what came out."""
    step, turn = 0.0, 0.0
    for i in range(3):
        step += (x[i] - x_at[i]) ** 2
        turn = max(turn, abs(x[6 + i] - x_at[6 + i]), abs(x[12 + i] - x_at[12 + i]))
    return bool(step > (STILL * distance_m) ** 2 or turn > STILL)


@njit(cache=True, nogil=True, error_model="numpy")
def take_pixels(
    x: Vec, P: Mat, geometry: Mat, markers: Mat, uv: Mat, sigma: Vec, noise: Mat, gate: float, alone: Vec, nis: Vec
) -> tuple[int, float]:
    """Take labelled markers (k, 3) seen at uv (k, 2), sigma (k,) on z = 1, in place; return status and NIS.

    ``alone`` (k,): normalised innovation squared of each marker against the state before the frame; ``nis`` (k,):
    against what the markers before it have left, those that fit best first; negative when it is beyond ``gate`` and
    the marker was left out. With fewer than half of them taken nothing is.
    """
    n = len(markers)
    x_prior, P_prior, x_wide, P_wide = np.empty(WIDE), np.empty((WIDE, WIDE)), np.empty(WIDE), np.empty((WIDE, WIDE))
    H, expected = np.empty((2 * n, WIDE)), np.empty((n, 2))
    widened(x, P, noise, x_prior, P_prior)
    x_at = x_prior.copy()
    if not marker_rows(x_at, geometry, markers, expected, H):
        return UNUSABLE, np.inf
    for k in range(n):
        uu, cc, vv = innovation(P_prior, H, k, sigma[k])
        alone[k] = squared_size(uv[k, 0] - expected[k, 0], uv[k, 1] - expected[k, 1], uu, cc, vv)
    order = np.argsort(alone)
    distance_m = np.sqrt(np.sum((geometry[7] + x[:3]) ** 2))
    total, gated, settled, open_gate, closed_for_good = 0.0, False, False, False, False
    for _ in range(MOST_PASSES):
        x_wide[:] = x_prior
        P_wide[:, :] = P_prior
        total = one_pass(x_wide, P_wide, x_at, H, uv, expected, sigma, order, np.inf if open_gate else gate, nis)
        gated, settled = not open_gate, not moved(x_wide, x_at, distance_m)
        if gated and settled:
            break
        # Far from where it is linear a good marker looks wrong: the point is found first, with all, then the gate is
        # closed, and stays so: what only settles with markers that the gate refuses is not taken.
        closed_for_good = closed_for_good or settled
        open_gate = not closed_for_good
        x_at[:STATES] = x_wide[:STATES]
        if not marker_rows(x_at, geometry, markers, expected, H):
            return UNUSABLE, np.inf
    if not (gated and settled):
        return UNUSABLE, np.inf
    taken = 0
    for k in range(n):
        taken += nis[k] >= 0.0
    if taken == 0 or 2 * taken < n:
        return NOTHING_TAKEN, np.sum(alone)
    if not (np.all(np.isfinite(x_wide)) and np.all(np.isfinite(P_wide))):
        return UNUSABLE, np.inf
    x[:] = x_wide[:STATES]
    P[:, :] = P_wide[:STATES, :STATES]
    return ALL_TAKEN, total


@njit(cache=True, nogil=True, error_model="numpy")
def expected_pixels(x: Vec, P: Mat, geometry: Mat, markers: Mat, noise: Mat, uv: Mat, S: Mat) -> bool:
    """Write where markers (k, 3) are expected on z = 1, uv (k, 2), and with what covariance, S (k, 3): uu, uv, vv."""
    n = len(markers)
    x_wide, P_wide, H = np.empty(WIDE), np.empty((WIDE, WIDE)), np.empty((2 * n, WIDE))
    widened(x, P, noise, x_wide, P_wide)
    if not marker_rows(x_wide, geometry, markers, uv, H):
        return False
    for k in range(n):
        S[k, 0], S[k, 1], S[k, 2] = innovation(P_wide, H, k, 0.0)
    return True
