"""The search for the pose that most detections agree on, with the attitude known and the position not; compiled.

Two markers a, b seen on the rays v_i, v_j fix the translation: z_b v_j - z_a v_i = R (p_b - p_a) are three equations for
the two depths, and what is left over tells most wrong pairs at once. Every pair of markers with every pair of detections
gives a translation; the other markers vote for it by a detection where it puts them. The translations with most votes are
kept, one per set of labels.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from companion.vision.label_kernel import settle
from companion.vision.pose_fit import NEAREST_M, Ints

LOOSE = 3.5
"""Sigmas within which a detection votes."""

SHORTEST = 0.25
"""Pairs of markers nearer to each other than this share of the farthest pair are not asked: they fix no depth."""


@njit(cache=True, nogil=True, error_model="numpy")
def depths(vi: Vec, vj: Vec, d: Vec) -> tuple[float, float, float]:
    """Return z_a, z_b that bring z_b v_j - z_a v_i nearest to d (3,), for rays (2,) on z = 1, and the distance left."""
    ii = vi[0] * vi[0] + vi[1] * vi[1] + 1.0
    jj = vj[0] * vj[0] + vj[1] * vj[1] + 1.0
    ij = vi[0] * vj[0] + vi[1] * vj[1] + 1.0
    di = vi[0] * d[0] + vi[1] * d[1] + d[2]
    dj = vj[0] * d[0] + vj[1] * d[1] + d[2]
    det = ii * jj - ij * ij
    if not det > 1e-14:
        return -1.0, -1.0, np.inf
    za, zb = (ij * dj - jj * di) / det, (ii * dj - ij * di) / det
    x, y, z = vi[1] - vj[1], vj[0] - vi[0], vi[0] * vj[1] - vi[1] * vj[0]
    return za, zb, abs(d[0] * x + d[1] * y + d[2] * z) / np.sqrt(det)


@njit(cache=True, nogil=True, error_model="numpy")
def votes_of(turned: Mat, rays: Mat, variance: Vec, sigma_rad: float, a: int, b: int, separation: float, baseline: float,
             t: Vec, labels: Ints) -> tuple[int, float]:
    """Label every marker by the nearest detection where t puts it; (votes, mean square in units of the tolerance).

    The tolerance holds the noise, stretched beyond the pair that t rests on, and the unknown attitude.
    """
    n, m = turned.shape[0], rays.shape[0]
    za, zb = turned[a, 2] + t[2], turned[b, 2] + t[2]
    um = 0.5 * ((turned[a, 0] + t[0]) / za + (turned[b, 0] + t[0]) / zb)
    vm = 0.5 * ((turned[a, 1] + t[1]) / za + (turned[b, 1] + t[1]) / zb)
    votes, total = 0, 0.0
    for c in range(n):
        labels[c] = -1
        z = turned[c, 2] + t[2]
        if not z > NEAREST_M:
            continue
        u, v = (turned[c, 0] + t[0]) / z, (turned[c, 1] + t[1]) / z
        stretch = ((u - um) ** 2 + (v - vm) ** 2) / separation**2
        away, other = 0.0, 0.0
        for k in range(3):
            away += (turned[c, k] - turned[a, k]) ** 2
            other += (turned[c, k] - turned[b, k]) ** 2
        lever = min(away, other) + stretch * baseline**2
        nearest, at = np.inf, -1
        for j in range(m):
            squared = (rays[j, 0] - u) ** 2 + (rays[j, 1] - v) ** 2
            limit = LOOSE**2 * (variance[j] * (2.0 + 4.0 * stretch) + (sigma_rad / z) ** 2 * lever)
            if squared < limit and squared / limit < nearest:
                nearest, at = squared / limit, j
        for k in range(c):
            if at >= 0 and labels[k] == at:
                at = -1
        if at >= 0:
            labels[c] = at
            votes += 1
            total += nearest
    return votes, total / max(votes, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def keep(votes: int, spare: float, t: Vec, labels: Ints, kept_votes: Vec, kept_t: Mat, kept_labels: Ints) -> None:
    """Put a candidate in the place of the worst kept one if it is better; once only for a set of labels."""
    quality = votes - 0.5 * spare
    worst = 0
    for k in range(kept_votes.shape[0]):
        if np.array_equal(kept_labels[k], labels):
            if quality > kept_votes[k]:
                kept_votes[k], kept_t[k] = quality, t
            return
        if kept_votes[k] < kept_votes[worst]:
            worst = k
    if quality > kept_votes[worst]:
        kept_votes[worst], kept_t[worst], kept_labels[worst] = quality, t, labels


@njit(cache=True, nogil=True, error_model="numpy")
def shadowed(a: int, i: int, b: int, j: int, least: float, kept_votes: Vec, kept_labels: Ints) -> bool:
    """Say whether a well supported candidate holds these two labels already."""
    for k in range(kept_votes.shape[0]):
        if kept_votes[k] >= least and kept_labels[k, a] == i and kept_labels[k, b] == j:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def vote(points: Mat, rays: Mat, variance: Vec, R0: Mat, t0: Vec, reach_m: float, sigma_rad: float, range_m: float,
         least: int, kept_votes: Vec, kept_t: Mat, kept_labels: Ints) -> None:
    """Fill the kept candidates: votes (k,), translations (k, 3), labels (k, n).

    Translations farther than ``reach_m`` from t0, or with a marker of the pair beyond ``range_m``, are not looked at.
    """
    n, m = points.shape[0], rays.shape[0]
    turned = points @ R0.T
    labels, d, t = np.empty(n, dtype=np.int64), np.empty(3), np.empty(3)
    farthest = 0.0
    for a in range(n):
        for b in range(a):
            farthest = max(farthest, np.sum((turned[a] - turned[b]) ** 2))
    for a in range(n):
        for b in range(a):
            d[:] = turned[b] - turned[a]
            baseline = np.sqrt(np.sum(d**2))
            if not baseline > SHORTEST * np.sqrt(farthest):
                continue
            for i in range(m):
                for j in range(m):
                    if i == j or shadowed(a, i, b, j, least + 1.5, kept_votes, kept_labels):
                        continue
                    za, zb, left = depths(rays[i], rays[j], d)
                    if not (NEAREST_M < za < range_m and NEAREST_M < zb < range_m):
                        continue
                    noise = za * za * variance[i] + zb * zb * variance[j] + (sigma_rad * baseline) ** 2
                    if left * left > LOOSE * LOOSE * noise:
                        continue
                    off = 0.0
                    for k in range(3):
                        vi, vj = (rays[i, k], rays[j, k]) if k < 2 else (1.0, 1.0)
                        t[k] = 0.5 * (za * vi - turned[a, k] + zb * vj - turned[b, k])
                        off += (t[k] - t0[k]) ** 2
                    if off > reach_m * reach_m:
                        continue
                    apart = np.sqrt((rays[i, 0] - rays[j, 0]) ** 2 + (rays[i, 1] - rays[j, 1]) ** 2)
                    votes, spare = votes_of(turned, rays, variance, sigma_rad, a, b, apart, baseline, t, labels)
                    if votes >= least:
                        keep(votes, spare, t, labels, kept_votes, kept_t, kept_labels)


@njit(cache=True, nogil=True, error_model="numpy")
def settle_all(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, prior: NDArray[np.float64],
               log_prior: Vec, gain: Vec, limits: Vec, barred: Ints, fitting: Ints, labels: Ints, d: Mat,
               R: NDArray[np.float64], t: Mat, P: NDArray[np.float64], scores: Vec) -> None:
    """``settle`` from each deviation d (k, 6), its labels (k, n) and barred marker (k,), with the doubtful prior."""
    for k in range(d.shape[0]):
        scores[k] = settle(points, rays, variance, map_sigma, R0, t0, prior, log_prior, 1, gain, limits, barred[k],
                           fitting[k], labels[k], d[k], R[k], t[k], P[k])
