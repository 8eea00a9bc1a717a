"""The filter's numbers, compiled: prediction, and what is linear in the state (``filter_pixels`` has the rest).

Measurements are taken one scalar after the other, with Joseph's form of the covariance, both triangles written alike:
it stays symmetric, and positive to rounding.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec

STATES = 16


@njit(cache=True, nogil=True, error_model="numpy")
def predict(x: Vec, P: Mat, dt: float, noise: Vec, v: Vec) -> None:
    """Carry state x (16,) and covariance P (16, 16) ``dt`` s on, in place; ``noise`` of ``process_noise``.

    ``v`` (3,): the path, along which travels have less noise than across it; of zeros: as across on all axes.
    """
    fade = np.exp(-dt / noise[4])
    for i in range(3):
        x[i] += dt * x[3 + i]
        x[9 + i] *= fade
        for j in range(STATES):
            P[i, j] += dt * P[3 + i, j]
            P[9 + i, j] *= fade
    for j in range(3):
        for i in range(STATES):
            P[i, j] += dt * P[i, 3 + j]
            P[i, 9 + j] *= fade
    squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    less = dt * (noise[7] - noise[0]) / squared if squared > 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            P[i, j] += less * v[i] * v[j]
        P[i, i] += noise[0] * dt + noise[1] * dt * dt * dt / 3.0
        P[i, 3 + i] += 0.5 * noise[1] * dt * dt
        P[3 + i, i] += 0.5 * noise[1] * dt * dt
        P[3 + i, 3 + i] += noise[1] * dt
        P[6 + i, 6 + i] += noise[2] * dt
        P[9 + i, 9 + i] += noise[3] * noise[3] * (1.0 - fade * fade)
        P[12 + i, 12 + i] += noise[5] * dt
    P[15, 15] += noise[6] * dt
    for i in range(STATES):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@njit(cache=True, nogil=True, error_model="numpy")
def take_scalar(x: Vec, P: Mat, h: Vec, residual: float, variance: float, b: Vec, c: Vec) -> float:
    """Take a measurement with row h (n,) in place; return its normalised innovation squared. b, c (n,): scratch."""
    n = len(x)
    S = variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        b[i] = total
        S += h[i] * total
    gain = 1.0 / S
    for i in range(n):  # P - k b^T, row by row, and (P - k b^T) h
        k, total = b[i] * gain, 0.0
        for j in range(n):
            P[i, j] -= k * b[j]
            total += P[i, j] * h[j]
        c[i] = total
        x[i] += k * residual
    for i in range(n):
        for j in range(i + 1):
            joseph = P[i, j] - c[i] * b[j] * gain + variance * gain * gain * b[i] * b[j]
            other = P[j, i] - c[j] * b[i] * gain + variance * gain * gain * b[i] * b[j]
            P[i, j] = P[j, i] = 0.5 * (joseph + other)
    return residual * residual * gain


@njit(cache=True, nogil=True, error_model="numpy")
def take_linear(x: Vec, P: Mat, H: Mat, z: Vec, variance: float, gate: float) -> float:
    """Take z (m,) = H (m, 16) x with independent noise, in place if its normalised innovation squared, which is
    returned, is not beyond ``gate``."""
    x_new, P_new = x.copy(), P.copy()
    b, c = np.empty(STATES), np.empty(STATES)
    nis = 0.0
    for k in range(len(z)):
        residual = z[k]
        for j in range(STATES):
            residual -= H[k, j] * x_new[j]
        nis += take_scalar(x_new, P_new, H[k], residual, variance, b, c)
    if nis <= gate:
        x[:] = x_new
        P[:, :] = P_new
    return nis
