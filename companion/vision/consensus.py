"""The search for the pose that most detections agree on, with the attitude known and the position not; compiled.

Two markers a, b seen on the rays v_i, v_j fix the translation: z_b v_j - z_a v_i = R (p_b - p_a) are three equations
for the two depths, and what is left over tells most wrong pairs at once. Every pair of markers with every pair of
detections gives a translation; the other markers vote for it by a detection where it puts them. The translations with
most votes are kept, one per set of labels.
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
def votes_of(turned: Mat, rays: Mat, variance: Vec, sigma_rad: float, a: int, b: int, separation: float,
             baseline: float, t: Vec, labels: Ints) -> tuple[int, float]:
    """Label every marker by the nearest detection where t puts it; (votes, mean square in units of the tolerance).

    The tolerance holds the noise, stretched beyond the pair that t rests on, and the unknown attitude.
    """
    n, m, d = turned.shape[0], rays.shape[0], np.empty(3)
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
        lever = min(between(turned, a, c, d), between(turned, b, c, d)) ** 2 + stretch * baseline**2
        nearest, at = 1.0, -1
        for j in range(m):
            squared = (rays[j, 0] - u) ** 2 + (rays[j, 1] - v) ** 2
            squared /= LOOSE**2 * (variance[j] * (2.0 + 4.0 * stretch) + (sigma_rad / z) ** 2 * lever)
            if squared < nearest:
                nearest, at = squared, j
        if at >= 0 and untaken(labels, c, at):
            labels[c] = at
            votes += 1
            total += nearest
    return votes, total / max(votes, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def untaken(labels: Ints, c: int, j: int) -> bool:
    """Say whether no marker before c has detection j."""
    free = True
    for k in range(c):
        free = free and labels[k] != j
    return free


@njit(cache=True, nogil=True, error_model="numpy")
def keep(votes: int, spare: float, t: Vec, labels: Ints, kept_votes: Vec, kept_t: Mat, kept_labels: Ints) -> None:
    """Put a candidate in the place of the worst kept one if it is better; once only for a set of labels."""
    quality, at = votes - 0.5 * spare, 0
    for k in range(kept_votes.shape[0]):
        same = True
        for c in range(labels.shape[0]):
            same = same and kept_labels[k, c] == labels[c]
        if same:
            at = k
            break
        if kept_votes[k] < kept_votes[at]:
            at = k
    if quality > kept_votes[at]:
        kept_votes[at] = quality
        for c in range(t.shape[0]):
            kept_t[at, c] = t[c]
        for c in range(labels.shape[0]):
            kept_labels[at, c] = labels[c]


@njit(cache=True, nogil=True, error_model="numpy")
def shadowed(a: int, i: int, b: int, j: int, least: float, kept_votes: Vec, kept_labels: Ints) -> bool:
    """Say whether a well supported candidate holds these two labels already."""
    for k in range(kept_votes.shape[0]):
        if kept_votes[k] >= least and kept_labels[k, a] == i and kept_labels[k, b] == j:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def translation_of(turned: Mat, rays: Mat, variance: Vec, sigma_rad: float, range_m: float, a: int, b: int, i: int,
                   j: int, d: Vec, t: Vec) -> bool:
    """Write the translation t (3,) of markers a, b, apart by d (3,), on rays i, j; say whether there can be one."""
    za, zb, left = depths(rays[i], rays[j], d)
    if not (NEAREST_M < za < range_m and NEAREST_M < zb < range_m):
        return False
    lever = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    noise = za * za * variance[i] + zb * zb * variance[j] + sigma_rad**2 * lever
    for k in range(2):
        t[k] = 0.5 * (za * rays[i, k] - turned[a, k] + zb * rays[j, k] - turned[b, k])
    t[2] = 0.5 * (za - turned[a, 2] + zb - turned[b, 2])
    return left * left <= LOOSE * LOOSE * noise


@njit(cache=True, nogil=True, error_model="numpy")
def between(p: Mat, a: int, b: int, d: Vec) -> float:
    """Write the vector d (3,) from point a to point b of p (n, 3), and return its length."""
    for k in range(3):
        d[k] = p[b, k] - p[a, k]
    return np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])


@njit(cache=True, nogil=True, error_model="numpy")
def try_pair(turned: Mat, rays: Mat, variance: Vec, t0: Vec, reach_m: float, sigma_rad: float, range_m: float,
             least: int, a: int, b: int, kept_votes: Vec, kept_t: Mat, kept_labels: Ints) -> None:
    """Put markers a, b on every pair of rays, and what is possible to the vote."""
    labels, d, t = np.empty(turned.shape[0], dtype=np.int64), np.empty(3), np.empty(3)
    baseline = between(turned, a, b, d)
    for i in range(rays.shape[0]):
        for j in range(rays.shape[0]):
            if i == j or shadowed(a, i, b, j, least + 1.5, kept_votes, kept_labels):
                continue
            if not translation_of(turned, rays, variance, sigma_rad, range_m, a, b, i, j, d, t):
                continue
            if (t[0] - t0[0]) ** 2 + (t[1] - t0[1]) ** 2 + (t[2] - t0[2]) ** 2 > reach_m**2:
                continue
            apart = np.sqrt((rays[i, 0] - rays[j, 0]) ** 2 + (rays[i, 1] - rays[j, 1]) ** 2)
            votes, spare = votes_of(turned, rays, variance, sigma_rad, a, b, apart, baseline, t, labels)
            if votes >= least:
                keep(votes, spare, t, labels, kept_votes, kept_t, kept_labels)


@njit(cache=True, nogil=True, error_model="numpy")
def vote(points: Mat, rays: Mat, variance: Vec, R0: Mat, t0: Vec, reach_m: float, sigma_rad: float, range_m: float,
         least: int, kept_votes: Vec, kept_t: Mat, kept_labels: Ints) -> None:
    """Fill the kept candidates: votes (k,), translations (k, 3), labels (k, n).

    Translations farther than ``reach_m`` from t0, or with a marker of the pair beyond ``range_m``, are not looked at.
    """
    n = points.shape[0]
    turned, d, farthest = np.zeros((n, 3)), np.empty(3), 0.0
    for c in range(n):
        for k in range(3):
            turned[c, k] = R0[k, 0] * points[c, 0] + R0[k, 1] * points[c, 1] + R0[k, 2] * points[c, 2]
    for a in range(n):
        for b in range(a):
            farthest = max(farthest, between(turned, a, b, d))
    for a in range(n):
        for b in range(a):
            if between(turned, a, b, d) > SHORTEST * farthest:
                try_pair(turned, rays, variance, t0, reach_m, sigma_rad, range_m, least, a, b, kept_votes, kept_t,
                         kept_labels)


@njit(cache=True, nogil=True, error_model="numpy")
def settle_all(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, prior: NDArray[np.float64],
               log_prior: Vec, gain: Vec, limits: Vec, barred: Ints, fitting: Ints, labels: Ints, d: Mat,
               R: NDArray[np.float64], t: Mat, P: NDArray[np.float64], scores: Vec) -> None:
    """``settle`` from each deviation d (k, 6), its labels (k, n) and barred marker (k,), with the doubtful prior."""
    for k in range(d.shape[0]):
        scores[k] = settle(points, rays, variance, map_sigma, R0, t0, prior, log_prior, 1, gain, limits, barred[k],
                           fitting[k], labels[k], d[k], R[k], t[k], P[k])
