"""Labels and pose made to agree, compiled: what fits is kept, what cannot be told is left out.

Rules
-----
* ``limits``: [gate, rival gate, widest] in sigmas. A label fits when its studentised residual is within the gate. It
  counts only where the others foretell its place to within ``widest`` sigmas of its own noise, and where no other
  detection lies within the rival gate of the foretold place.
* ``prior``: [0] what the pose is expected to be, [1] the prior that may be grossly wrong. Each is an information
  matrix (6, 6) of the deviation from (R0, t0); ``log_prior`` (2,) holds the log density at zero deviation, with the
  log of the probability of that kind of prior.
* ``gain`` (m,): what the log probability gains by a detection being a marker, without its residual: the log of
  P_D / ((1 - P_D) lambda), with the probability that a marker is detected and the density of false points (the score
  of a track in multi-target tracking: Blackman, Popoli 1999, ch. 6).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from companion.vision.pose_fit import LOG_2PI, Ints, fit, foretold, project, spread

ROUNDS = 6
"""Rounds of fitting and labelling anew at most."""


@njit(cache=True, nogil=True, error_model="numpy")
def distance(ray: Vec, u: float, v: float, uu: float, uv: float, vv: float) -> float:
    """Return the squared Mahalanobis distance of a detection from a place of the given covariance."""
    du, dv = ray[0] - u, ray[1] - v
    return (vv * du * du - 2.0 * uv * du * dv + uu * dv * dv) / (uu * vv - uv * uv)


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distances(rays: Mat, variance: Vec, map_sigma: float, uv: Mat, J: NDArray[np.float64], P: Mat, gate: float,
                      squared: Mat) -> None:
    """Write the squared Mahalanobis distances (n, m) within the gate at a pose of covariance P; elsewhere infinity."""
    for i in range(uv.shape[0]):
        squared[i] = np.inf
        if not np.isfinite(uv[i, 0]):
            continue
        pp, pq, qq = spread(J[i], P)
        blur = (map_sigma * J[i, 0, 0]) ** 2
        for j in range(rays.shape[0]):
            own = variance[j] + blur
            d2 = distance(rays[j], uv[i, 0], uv[i, 1], pp + own, pq, qq + own)
            if d2 <= gate * gate:
                squared[i, j] = d2


@njit(cache=True, nogil=True, error_model="numpy")
def mutual(squared: Mat, labels: Ints) -> None:
    """Write the labels (n,) of pairs that are each other's nearest; the first of equals."""
    for i in range(squared.shape[0]):
        labels[i] = -1
        j = squared[i].argmin()
        if not np.isfinite(squared[i, j]):
            continue
        nearest = True
        for k in range(squared.shape[0]):
            nearest = nearest and (squared[k, j] > squared[i, j] or (k >= i and squared[k, j] == squared[i, j]))
        if nearest:
            labels[i] = j


@njit(cache=True, nogil=True, error_model="numpy")
def first_labels(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, P: Mat, gate: float,
                 labels: Ints) -> tuple[bool, Mat, Vec]:
    """Label by the prior alone: (whether no marker and no detection had a choice, costs (n, m), spread (n,)).

    Costs are squared distances within the gate plus the log determinant of the innovation, as an assignment needs
    them; infinite outside.
    """
    n, m = points.shape[0], rays.shape[0]
    uv, J, cost = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, m))
    project(points, R0, t0, uv, J)
    squared_distances(rays, variance, map_sigma, uv, J, P, gate, cost)
    mutual(cost, labels)
    plain, log_det = True, np.zeros(n)
    for i in range(n):
        choices = 0
        for j in range(m):
            choices += np.isfinite(cost[i, j])
        plain = plain and choices == (labels[i] >= 0)
        pp, pq, qq = spread(J[i], P)
        log_det[i] = np.log(pp * qq - pq * pq) if choices > 0 else 0.0
    return plain, cost, log_det


@njit(cache=True, nogil=True, error_model="numpy")
def drop_worst(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, uv: Mat, J: NDArray[np.float64], P: Mat,
               gate: float, widest: float) -> bool:
    """Take out the label that fits worst, or, when all fit, the one that the others foretell least; say if one was."""
    worst, at = 1.0, -1
    wide, wide_at = 1.0, -1
    for i in range(labels.shape[0]):
        j = labels[i]
        if j < 0:
            continue
        own = variance[j] + (map_sigma * J[i, 0, 0]) ** 2
        d2, _, _, uu, cross, vv = foretold(rays[j], uv[i], J[i], P, own)
        if d2 / gate**2 > worst:
            worst, at = d2 / gate**2, i
        largest = 0.5 * (uu + vv) + np.sqrt(0.25 * (uu - vv) ** 2 + cross**2) if np.isfinite(uu) else np.inf
        if largest / (own * widest**2) > wide:
            wide, wide_at = largest / (own * widest**2), i
    if at < 0:
        at = wide_at
    if at >= 0:
        labels[at] = -1
    return at >= 0


@njit(cache=True, nogil=True, error_model="numpy")
def leave_out_rivals(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, uv: Mat, J: NDArray[np.float64], P: Mat,
                     rival_gate: float) -> int:
    """Take out labels whose foretold place another detection is as well at; return how many."""
    contested = np.zeros(labels.shape[0], dtype=np.bool_)
    for i in range(labels.shape[0]):
        if labels[i] < 0:
            continue
        blur = (map_sigma * J[i, 0, 0]) ** 2
        own = variance[labels[i]] + blur
        _, u, v, uu, cross, vv = foretold(rays[labels[i]], uv[i], J[i], P, own)
        for j in range(rays.shape[0]):
            more = variance[j] + blur - own
            if j != labels[i] and distance(rays[j], u, v, uu + more, cross, vv + more) <= rival_gate**2:
                contested[i] = True
    for i in range(labels.shape[0]):
        if contested[i]:
            labels[i] = -1
    return contested.sum()


@njit(cache=True, nogil=True, error_model="numpy")
def score(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, prior: NDArray[np.float64], log_prior: Vec,
          gain: Vec, d: Vec, uv: Mat, J: NDArray[np.float64], log_det: float) -> float:
    """Return the log of how much likelier the labels are than that no detection is a marker (Laplace, over the pose)."""
    best = -np.inf
    for k in range(2):
        total = log_prior[k]
        for a in range(6):
            for b in range(6):
                total -= 0.5 * d[a] * prior[k, a, b] * d[b]
        best = max(best, total)
    total = best + 0.5 * (6.0 * LOG_2PI - log_det)
    for i in range(labels.shape[0]):
        j = labels[i]
        if j >= 0:
            own = variance[j] + (map_sigma * J[i, 0, 0]) ** 2
            squared = (rays[j, 0] - uv[i, 0]) ** 2 + (rays[j, 1] - uv[i, 1]) ** 2
            total += gain[j] - LOG_2PI - np.log(own) - 0.5 * squared / own
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def settle(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, prior: NDArray[np.float64],
           log_prior: Vec, which: int, gain: Vec, limits: Vec, labels: Ints, d: Vec, R: Mat, t: Vec,
           P: Mat) -> tuple[float, int]:
    """Fit, drop what does not fit, label anew at the fitted pose, until nothing changes; then leave out what is unsure.

    ``labels`` and ``d`` are the start and the answer; ``prior[which]`` counts in the fit. Writes R, t, P of the pose.
    Returns the score of the labels (-inf when none are left) and how many were left out because of rivals.
    """
    n, m = points.shape[0], rays.shape[0]
    uv, J, squared = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, m))
    fresh = np.empty(n, dtype=np.int64)
    information = prior[which]
    log_det = np.nan
    for _ in range(ROUNDS):
        log_det = fit(points, rays, variance, map_sigma, labels, R0, t0, information, d, R, t, P, uv, J)
        while np.isfinite(log_det) and drop_worst(rays, variance, map_sigma, labels, uv, J, P, limits[0], np.inf):
            log_det = fit(points, rays, variance, map_sigma, labels, R0, t0, information, d, R, t, P, uv, J)
        if not np.isfinite(log_det):
            labels[:] = -1
            return -np.inf, 0
        squared_distances(rays, variance, map_sigma, uv, J, P, limits[0], squared)
        mutual(squared, fresh)
        if np.array_equal(fresh, labels):
            break
        labels[:] = fresh
    rivals, changed = 0, True
    while changed:
        contested = leave_out_rivals(rays, variance, map_sigma, labels, uv, J, P, limits[1])
        rivals += contested
        if contested == 0:
            changed = drop_worst(rays, variance, map_sigma, labels, uv, J, P, limits[0], limits[2])
        if changed:
            log_det = fit(points, rays, variance, map_sigma, labels, R0, t0, information, d, R, t, P, uv, J)
            if not np.isfinite(log_det):
                labels[:] = -1
                return -np.inf, rivals
    if labels.max() < 0:
        return -np.inf, rivals
    return score(rays, variance, map_sigma, labels, prior, log_prior, gain, d, uv, J, log_det), rivals
