"""Lens distortion and its inverse, compiled (see ``companion.vision.camera``).

A lens is a flag and eight coefficients ``k``, and ``reach_squared``, how far from the axis on z = 1 it is of use.

* Brown's model with a denominator (Brown 1966; the rational form is OpenCV's), k1, k2, p1, p2, k3, k4, k5, k6:
  with s = x^2 + y^2, g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3),
  x_d = x g + 2 p1 x y + p2 (s + 2 x^2),  y_d = y g + p1 (s + 2 y^2) + 2 p2 x y.
* ``fisheye`` (Kannala and Brandt 2006, radial part), k1, k2, k3, k4: with theta the angle off the axis,
  r_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), along the direction of (x, y).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec

NEWTON_STEPS = 40
SOLVED = 1e-10
"""How closely an inverse has to give its distorted point back, on z = 1 and relative to one plus its radius."""

NEAR_AXIS = 1e-4
"""Up to this distance from the axis the arc tangent is a series, of which the next term is 2e-17."""


def kernel(function: Any) -> Any:
    """Compile as every kernel here is: cached, without the interpreter's lock, exact floating point."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)


@kernel
def radial(fisheye: bool, k: Vec, s: float) -> tuple[float, float]:
    """Return the gain g of the radius at the squared radius ``s``, and its slope dg/ds."""
    if fisheye:
        if s < NEAR_AXIS * NEAR_AXIS:
            theta, ratio, ratio_slope = math.sqrt(s), 1.0 - s / 3.0, -1.0 / 3.0 + 0.4 * s
        else:
            r = math.sqrt(s)
            theta = math.atan(r)
            ratio, ratio_slope = theta / r, (1.0 / (1.0 + s) - theta / r) / (2.0 * s)
        t = theta * theta
        gain = 1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))
        slope = k[0] + t * (2.0 * k[1] + t * (3.0 * k[2] + t * 4.0 * k[3]))
        return ratio * gain, ratio_slope * gain + ratio * slope * ratio / (1.0 + s)  # dt/ds = theta / (r (1 + s))
    top = 1.0 + s * (k[0] + s * (k[1] + s * k[4]))
    bottom = 1.0 + s * (k[5] + s * (k[6] + s * k[7]))
    top_slope = k[0] + s * (2.0 * k[1] + s * 3.0 * k[4])
    bottom_slope = k[5] + s * (2.0 * k[6] + s * 3.0 * k[7])
    return top / bottom, (top_slope * bottom - top * bottom_slope) / (bottom * bottom)


@kernel
def bend(fisheye: bool, k: Vec, x: float, y: float) -> tuple[float, float, float, float, float]:
    """Return the distorted point of (x, y) and the derivatives a = dx_d/dx, b = dx_d/dy = dy_d/dx, d = dy_d/dy."""
    s = x * x + y * y
    gain, slope = radial(fisheye, k, s)
    p1, p2 = (0.0, 0.0) if fisheye else (k[2], k[3])
    x_d = x * gain + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x)
    y_d = y * gain + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y
    a = gain + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    b = 2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    d = gain + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return x_d, y_d, a, b, d


@kernel
def unbend_radius(fisheye: bool, k: Vec, reach_squared: float, r_d: float) -> float:
    """Return the radius whose distorted radius is ``r_d``; NaN beyond the reach.

    The radius grows with its image all the way to the reach, so that Newton's steps can be held inside a bracket.
    """
    low, high = 0.0, math.sqrt(reach_squared)
    r = min(r_d, 0.5 * high)
    for _ in range(NEWTON_STEPS):
        gain, slope = radial(fisheye, k, r * r)
        error = r * gain - r_d
        if error > 0.0:
            high = r
        else:
            low = r
        step = error / (gain + 2.0 * r * r * slope)
        old, r = r, r - step
        if not low <= r <= high:
            r = 0.5 * (low + high) if high < math.inf else 2.0 * old + 1.0
        if abs(r - old) <= 1e-15 * r:
            break
    return r


@kernel
def distort_points(fisheye: bool, k: Vec, reach_squared: float, xy: Mat) -> Mat:
    """Return the distorted points (n, 2) of ``xy`` (n, 2), both on z = 1; NaN beyond the reach or where it folds."""
    out = np.full_like(xy, np.nan)
    for i in range(len(xy)):
        x, y = xy[i]
        if x * x + y * y < reach_squared:
            x_d, y_d, a, b, d = bend(fisheye, k, x, y)
            if a * d - b * b > 0.0:
                out[i] = x_d, y_d
    return out


@kernel
def undistort_points(fisheye: bool, k: Vec, reach_squared: float, target: Mat) -> Mat:
    """Invert ``distort_points`` to ``SOLVED`` for (n, 2) points; NaN where there is no inverse within the reach."""
    out = np.full_like(target, np.nan)
    for i in range(len(target)):
        u, v = target[i]
        r_d = math.sqrt(u * u + v * v)
        if not r_d < math.inf:
            continue
        scale = unbend_radius(fisheye, k, reach_squared, r_d) / r_d if r_d > 0.0 else 1.0
        x, y = u * scale, v * scale
        last = math.inf
        for _ in range(NEWTON_STEPS):  # for a lens without p1 and p2 there is little left to do
            x_d, y_d, a, b, d = bend(fisheye, k, x, y)
            e, f, determinant = x_d - u, y_d - v, a * d - b * b
            error = abs(e) + abs(f)
            if not error > 1e-15 or (error < 1e-12 and error >= last):
                break
            last = error
            x -= (d * e - b * f) / determinant
            y -= (a * f - b * e) / determinant
        x_d, y_d, a, b, d = bend(fisheye, k, x, y)
        if abs(x_d - u) + abs(y_d - v) < SOLVED * (1.0 + r_d) and x * x + y * y < reach_squared and a * d - b * b > 0.0:
            out[i] = x, y
    return out
