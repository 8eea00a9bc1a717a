"""Small dense algebra of the pose solvers, compiled: systems by Cholesky, moves of a pose, errors of an attitude.

Symmetric matrices are read from their lower triangle.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec

REGULAR = 1e-13
"""Smallest pivot of a regular matrix, as a fraction of its diagonal element: below it, it is rounding."""


@njit(cache=True, nogil=True, error_model="numpy")
def attitude_error(R: Mat, R_prior: Mat, e: Vec, A: Mat) -> bool:
    """Write e = log(R R_prior^T) and its Jacobian A = I - K / 2 + k K K, K = skew(e); False near a half turn."""
    E = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            E[i, j] = R[i, 0] * R_prior[j, 0] + R[i, 1] * R_prior[j, 1] + R[i, 2] * R_prior[j, 2]
    x, y, z = 0.5 * (E[2, 1] - E[1, 2]), 0.5 * (E[0, 2] - E[2, 0]), 0.5 * (E[1, 0] - E[0, 1])
    sine, cosine = np.sqrt(x * x + y * y + z * z), 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0)
    angle, scale, k = np.arctan2(sine, cosine), 1.0, 1.0 / 12.0
    if angle > 1e-4:
        scale = angle / sine
        k = 1.0 / (angle * angle) - (1.0 + cosine) / (2.0 * angle * sine)
    e[0], e[1], e[2] = scale * x, scale * y, scale * z
    for i in range(3):
        for j in range(3):
            A[i, j] = k * e[i] * e[j]  # K K = e e^T - e.e I
        A[i, i] += 1.0 - k * angle * angle
    A[0, 1], A[1, 0] = A[0, 1] + 0.5 * e[2], A[1, 0] - 0.5 * e[2]
    A[0, 2], A[2, 0] = A[0, 2] - 0.5 * e[1], A[2, 0] + 0.5 * e[1]
    A[1, 2], A[2, 1] = A[1, 2] + 0.5 * e[0], A[2, 1] - 0.5 * e[0]
    return bool(cosine > -0.99)


@njit(cache=True, nogil=True, error_model="numpy")
def factor(N: Mat, damping: float, L: Mat) -> bool:
    """Write the Cholesky factor of N, its diagonal raised by the fraction ``damping``, into L; False when singular."""
    for i in range(N.shape[0]):
        raised = N[i, i] * (1.0 + damping)
        for j in range(i + 1):
            total = raised if i == j else N[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if j < i:
                L[i, j] = total / L[j, j]
            elif total > REGULAR * raised:
                L[i, i] = np.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def solve(L: Mat, g: Vec, d: Vec) -> float:
    """Write the solution of L L^T d = g into d and return d.g."""
    n = len(d)
    for i in range(n):
        total = g[i]
        for k in range(i):
            total -= L[i, k] * d[k]
        d[i] = total / L[i, i]
    squared = 0.0
    for i in range(n):
        squared += d[i] * d[i]
    for i in range(n - 1, -1, -1):
        total = d[i]
        for k in range(i + 1, n):
            total -= L[k, i] * d[k]
        d[i] = total / L[i, i]
    return squared


@njit(cache=True, nogil=True, error_model="numpy")
def invert(L: Mat, P: Mat) -> None:
    """Write (L L^T)^-1 into P, both triangles; L is overwritten by its inverse."""
    n = P.shape[0]
    for j in range(n):
        for i in range(j, n):
            total = 1.0 if i == j else 0.0
            for k in range(j, i):
                total -= L[i, k] * P[k, j]
            P[i, j] = total / L[i, i]
    for j in range(n):
        for i in range(j, n):
            L[i, j] = P[i, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += L[k, i] * L[k, j]
            P[i, j] = P[j, i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def move(R: Mat, t: Vec, d: Vec, R_new: Mat, t_new: Vec) -> None:
    """Write t + d[:3] and exp(d[3:]) R (Rodrigues, column by column)."""
    x, y, z = d[3], d[4], d[5]
    squared = x * x + y * y + z * z
    a, b = 1.0 - squared / 6.0, 0.5 - squared / 24.0
    if squared > 1e-8:
        angle = np.sqrt(squared)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
    for k in range(3):
        t_new[k] = t[k] + d[k]
        p, q, r = R[0, k], R[1, k], R[2, k]
        e, f, g = y * r - z * q, z * p - x * r, x * q - y * p
        R_new[0, k] = p + a * e + b * (y * g - z * f)
        R_new[1, k] = q + a * f + b * (z * e - x * g)
        R_new[2, k] = r + a * g + b * (x * f - y * e)


@njit(cache=True, nogil=True, error_model="numpy")
def is_rotation(R: Mat) -> bool:
    """Say whether R (3, 3) is a rotation within 1e-6: the moves keep what it is."""
    worst = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # Each row is the cross product of the two others, and of length one.
        worst = max(worst, abs(R[i, 0] ** 2 + R[i, 1] ** 2 + R[i, 2] ** 2 - 1.0))
        worst = max(worst, abs(R[j, 1] * R[k, 2] - R[j, 2] * R[k, 1] - R[i, 0]))
        worst = max(worst, abs(R[j, 2] * R[k, 0] - R[j, 0] * R[k, 2] - R[i, 1]))
        worst = max(worst, abs(R[j, 0] * R[k, 1] - R[j, 1] * R[k, 0] - R[i, 2]))
    return worst < 1e-6
