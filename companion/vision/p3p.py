"""Poses from three markers, each tried on all triples of detections, by votes of the other markers; compiled.

Three markers on three rays leave up to four poses: the real roots of a quartic in the ratio of two distances (Grunert
1841, as in Haralick, Lee, Ottenberg, Noelle 1994). Roots are looked for where it changes sign between ratios of 1/4 and
4, which holds for a tanker that is farther away than it is deep.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.consensus import keep, untaken
from companion.vision.pose_fit import NEAREST_M, Ints

RATIOS = 0.25 * 16.0 ** (np.arange(33) / 32.0)
"""Ratios of distances between which the quartic is looked at."""

LOOSE = 12.0
"""Sigmas within which a detection votes: three markers foretell the rest with several times their own noise."""


@njit(cache=True, nogil=True, error_model="numpy")
def quartic(a2: float, b2: float, c2: float, ca: float, cb: float, cg: float, A: Vec) -> None:
    """Write the coefficients A (5,), constant first, of the quartic in s3 / s1.

    a2, b2, c2 squared distances of markers 2-3, 1-3, 1-2; ca, cb, cg the cosines between the same rays.
    """
    q, p = (a2 - c2) / b2, (a2 + c2) / b2
    A[4] = (q - 1.0) ** 2 - 4.0 * c2 / b2 * ca * ca
    A[3] = 4.0 * (q * (1.0 - q) * cb - (1.0 - p) * ca * cg + 2.0 * c2 / b2 * ca * ca * cb)
    A[2] = 2.0 * (q * q - 1.0 + 2.0 * q * q * cb * cb + 2.0 * (b2 - c2) / b2 * ca * ca - 4.0 * p * ca * cb * cg
                  + 2.0 * (b2 - a2) / b2 * cg * cg)
    A[1] = 4.0 * (-q * (1.0 + q) * cb + 2.0 * a2 / b2 * cg * cg * cb - (1.0 - p) * ca * cg)
    A[0] = (1.0 + q) ** 2 - 4.0 * a2 / b2 * cg * cg


@njit(cache=True, nogil=True, error_model="numpy")
def value(A: Vec, v: float) -> float:
    """Return the quartic at v."""
    return (((A[4] * v + A[3]) * v + A[2]) * v + A[1]) * v + A[0]


@njit(cache=True, nogil=True, error_model="numpy")
def root_between(A: Vec, low: float, high: float, at_low: float) -> float:
    """Return the root in an interval over which the quartic changes sign: bisection, then Newton."""
    for _ in range(4):
        middle = 0.5 * (low + high)
        at_middle = value(A, middle)
        if (at_middle > 0.0) == (at_low > 0.0):
            low = middle
        else:
            high = middle
    v = 0.5 * (low + high)
    for _ in range(4):
        slope = ((4.0 * A[4] * v + 3.0 * A[3]) * v + 2.0 * A[2]) * v + A[1]
        if slope != 0.0:
            v = min(max(v - value(A, v) / slope, low), high)
    return v


@njit(cache=True, nogil=True, error_model="numpy")
def triad(p: Mat, E: Mat) -> None:
    """Write the axes E (3, 3), rows, of three points p (3, 3): along the first side, across, and normal to both."""
    x2, z2 = 0.0, 0.0
    for c in range(3):
        E[0, c], E[1, c] = p[1, c] - p[0, c], p[2, c] - p[0, c]
        x2 += E[0, c] ** 2
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        E[2, c] = E[0, a] * E[1, b] - E[0, b] * E[1, a]
        z2 += E[2, c] ** 2
    for c in range(3):
        E[0, c] /= np.sqrt(x2)
        E[2, c] /= np.sqrt(z2)
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        E[1, c] = E[2, a] * E[0, b] - E[2, b] * E[0, a]


@njit(cache=True, nogil=True, error_model="numpy")
def votes_at(points: Mat, rays: Mat, variance: Vec, R: Mat, t: Vec, labels: Ints) -> tuple[int, float]:
    """Label every marker by the nearest detection where the pose puts it; (votes, mean square in tolerances)."""
    votes, total = 0, 0.0
    for c in range(points.shape[0]):
        labels[c] = -1
        z = R[2, 0] * points[c, 0] + R[2, 1] * points[c, 1] + R[2, 2] * points[c, 2] + t[2]
        if not z > NEAREST_M:
            continue
        u = (R[0, 0] * points[c, 0] + R[0, 1] * points[c, 1] + R[0, 2] * points[c, 2] + t[0]) / z
        v = (R[1, 0] * points[c, 0] + R[1, 1] * points[c, 1] + R[1, 2] * points[c, 2] + t[1]) / z
        nearest, at = LOOSE**2, -1
        for j in range(rays.shape[0]):
            squared = ((rays[j, 0] - u) ** 2 + (rays[j, 1] - v) ** 2) / variance[j]
            if squared < nearest:
                nearest, at = squared, j
        if at >= 0 and untaken(labels, c, at):
            labels[c] = at
            votes += 1
            total += nearest / LOOSE**2
    return votes, total / max(votes, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def cosine(unit: Mat, i: int, j: int) -> float:
    """Return the cosine between two unit rays."""
    return unit[i, 0] * unit[j, 0] + unit[i, 1] * unit[j, 1] + unit[i, 2] * unit[j, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def try_triple(points: Mat, rays: Mat, variance: Vec, unit: Mat, triple: Ints, i: int, j: int, k: int, sides: Vec,
               E: Mat, range_m: float, least: int, A: Vec, kept_votes: Vec, kept_T: Mat, kept_labels: Ints) -> None:
    """Put the poses of three markers on the rays i, j, k to the vote; keep those with at least ``least`` votes.

    ``A`` (5,) is room for the quartic: one for all calls.
    """
    ca, cb, cg = cosine(unit, j, k), cosine(unit, i, k), cosine(unit, i, j)
    quartic(sides[0], sides[1], sides[2], ca, cb, cg, A)
    ratio = (sides[0] - sides[2]) / sides[1]
    low = RATIOS[0]
    at_low = value(A, low)
    for high in RATIOS[1:]:
        at_high = value(A, high)
        if (at_low > 0.0) != (at_high > 0.0):
            v = root_between(A, low, high, at_low)
            u = ((ratio - 1.0) * v * v - 2.0 * ratio * cb * v + 1.0 + ratio) / (2.0 * (cg - v * ca))
            s1 = np.sqrt(sides[1] / (1.0 + v * v - 2.0 * v * cb))
            if u > 0.0 and s1 < range_m:
                q, F, R, row = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(12)
                labels = np.empty(points.shape[0], dtype=np.int64)
                for c in range(3):
                    q[0, c], q[1, c], q[2, c] = s1 * unit[i, c], u * s1 * unit[j, c], v * s1 * unit[k, c]
                triad(q, F)
                for a in range(3):
                    for b in range(3):
                        R[a, b] = F[0, a] * E[0, b] + F[1, a] * E[1, b] + F[2, a] * E[2, b]
                        row[3 * a + b] = R[a, b]
                    p = points[triple[0]]
                    row[9 + a] = q[0, a] - R[a, 0] * p[0] - R[a, 1] * p[1] - R[a, 2] * p[2]
                votes, spare = votes_at(points, rays, variance, R, row[9:], labels)
                if votes >= least:
                    keep(votes, spare, row, labels, kept_votes, kept_T, kept_labels)
        low, at_low = high, at_high


@njit(cache=True, nogil=True, error_model="numpy")
def vote_blind(points: Mat, rays: Mat, variance: Vec, triples: Ints, range_m: float, least: int, kept_votes: Vec,
               kept_T: Mat, kept_labels: Ints) -> None:
    """Fill the kept candidates: votes (k,), R row by row with t (k, 12), labels (k, n); ``triples`` (s, 3) of markers.
    """
    m = rays.shape[0]
    unit, E, sides, A = np.empty((m, 3)), np.empty((3, 3)), np.empty(3), np.empty(5)
    for j in range(m):
        norm = np.sqrt(rays[j, 0] ** 2 + rays[j, 1] ** 2 + 1.0)
        unit[j, 0], unit[j, 1], unit[j, 2] = rays[j, 0] / norm, rays[j, 1] / norm, 1.0 / norm
    for s in range(triples.shape[0]):
        p = points[triples[s]]
        triad(p, E)
        for k in range(3):
            side = p[(k + 1) % 3] - p[(k + 2) % 3]
            sides[k] = np.sum(side * side)
        for i in range(m):
            for j in range(m):
                for k in range(m):
                    if (i - j) * (i - k) * (j - k) != 0:
                        try_triple(points, rays, variance, unit, triples[s], i, j, k, sides, E, range_m, least, A,
                                   kept_votes, kept_T, kept_labels)
