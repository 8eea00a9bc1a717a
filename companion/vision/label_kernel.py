"""Labels and pose made to agree, compiled: what fits is kept, what cannot be told is left out.

Rules
-----
* ``limits``: [gate, rival odds, label odds]. A label fits when its studentised residual is within the gate, in sigmas.
  It counts only where the others and the prior foretell its place so well that it is likelier than a false detection
  there by exp(label odds), and likelier than any other detection by exp(rival odds).
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
from companion.vision.pose_fit import LOG_2PI, Ints, fit, foretold, inverse_of, project, spread

SMALLEST = 1e-12
"""Added to the variances of a prior, in m^2 and rad^2, so that one known exactly has an information matrix."""

FARTHEST_M = 1e4
"""No marker is farther than this from the tanker's origin: numbers beyond are as bad as those that are not finite."""

STRAINED = 2.5
"""Sigmas beyond which a label does not fit well."""

ROUNDS = 6
"""Rounds of fitting and labelling anew at most."""


@njit(cache=True, nogil=True, error_model="numpy")
def weigh(points: Mat, rays: Mat, sigma: Vec, weight: Vec, odds: float, variance: Vec, gain: Vec) -> bool:
    """Write variance and gain of each detection; say whether all numbers can be, sigma and weight positive."""
    good = True
    for i in range(points.shape[0]):
        for k in range(3):
            good = good and abs(points[i, k]) < FARTHEST_M
    for j in range(rays.shape[0]):
        variance[j] = sigma[j] * sigma[j]
        gain[j] = np.log(odds * weight[j])
        good = good and np.isfinite(rays[j, 0] + rays[j, 1] + variance[j] + gain[j]) and sigma[j] > 0.0
    return good


@njit(cache=True, nogil=True, error_model="numpy")
def two_priors(cov: Mat, gross_sigma: float, gross_probability: float, prior: NDArray[np.float64],
               log_prior: Vec) -> bool:
    """Write both priors of the rules from a covariance (6, 6); say whether it is finite and positive definite."""
    both = np.zeros((6, 6))
    for k in range(2):
        for a in range(6):
            for b in range(6):
                both[a, b] = cov[a, b] if k == 0 or (a >= 3 and b >= 3) else 0.0
            both[a, a] += SMALLEST + (gross_sigma**2 if k == 1 and a < 3 else 0.0)
        log_det = inverse_of(both, prior[k])
        log_prior[k] = np.log(gross_probability if k == 1 else 1.0 - gross_probability)
        log_prior[k] -= 0.5 * (6.0 * LOG_2PI + log_det)
    return np.isfinite(log_prior[0] + log_prior[1])


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
        for j in range(rays.shape[0]):
            squared[i, j] = np.inf
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
        least = np.inf
        for j in range(squared.shape[1]):
            if squared[i, j] < least:
                least, labels[i] = squared[i, j], j
        if labels[i] >= 0:
            for k in range(squared.shape[0]):
                if squared[k, labels[i]] < least or (k < i and squared[k, labels[i]] == least):
                    labels[i] = -1
                    break


@njit(cache=True, nogil=True, error_model="numpy")
def first_labels(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, P: Mat, gate: float,
                 labels: Ints) -> tuple[bool, Mat, Vec]:
    """Label by the prior alone: (whether no marker and no detection had a choice, squared (n, m), log det (n,)).

    Squared Mahalanobis distances within the gate, infinite outside, and the log determinant of what the prior leaves
    open of each marker's place (without the detection's own noise, which is small beside it).
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
               gain: Vec, gate: float, least_odds: float) -> bool:
    """Take out the label that fits worst, or, when all fit, the one that the others support least; say if one was."""
    worst, at = gate**2, -1
    least, least_at = least_odds, -1
    for i in range(labels.shape[0]):
        j = labels[i]
        if j < 0:
            continue
        own = variance[j] + (map_sigma * J[i, 0, 0]) ** 2
        d2, _, _, uu, cross, vv = foretold(rays[j], uv[i], J[i], P, own)
        if d2 > worst:
            worst, at = d2, i
        odds = gain[j] - LOG_2PI - 0.5 * (np.log(uu * vv - cross * cross) + d2)
        if odds < least:
            least, least_at = odds, i
    if at < 0:
        at = least_at
    if at >= 0:
        labels[at] = -1
    return at >= 0


@njit(cache=True, nogil=True, error_model="numpy")
def drop_strained(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, uv: Mat, J: NDArray[np.float64], P: Mat,
                  gain: Vec, least_odds: float) -> bool:
    """Take out all labels at once that are unsure for not fitting well; say if one was.

    Where a false label strains a true one, both do not fit well, and taking out the worse could leave the false one.
    """
    strained, found = np.zeros(labels.shape[0], dtype=np.bool_), False
    for i in range(labels.shape[0]):
        j = labels[i]
        if j >= 0:
            own = variance[j] + (map_sigma * J[i, 0, 0]) ** 2
            d2, _, _, uu, cross, vv = foretold(rays[j], uv[i], J[i], P, own)
            odds = gain[j] - LOG_2PI - 0.5 * (np.log(uu * vv - cross * cross) + d2)
            strained[i] = d2 > STRAINED**2 and odds < least_odds
    for i in range(labels.shape[0]):
        if strained[i]:
            labels[i], found = -1, True
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def leave_out_rivals(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, uv: Mat, J: NDArray[np.float64], P: Mat,
                     rival_odds: float) -> int:
    """Take out labels whose foretold place suits another detection about as well; return how many."""
    contested, count = np.zeros(labels.shape[0], dtype=np.bool_), 0
    for i in range(labels.shape[0]):
        if labels[i] < 0:
            continue
        blur = (map_sigma * J[i, 0, 0]) ** 2
        own = variance[labels[i]] + blur
        d2, u, v, uu, cross, vv = foretold(rays[labels[i]], uv[i], J[i], P, own)
        for j in range(rays.shape[0]):
            more = variance[j] + blur - own
            if j != labels[i] and distance(rays[j], u, v, uu + more, cross, vv + more) <= d2 + 2.0 * rival_odds:
                contested[i] = True
    for i in range(labels.shape[0]):
        if contested[i]:
            labels[i] = -1
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def likelier_prior(prior: NDArray[np.float64], log_prior: Vec, d: Vec) -> tuple[int, float]:
    """Return which prior a deviation d (6,) more likely comes from, and the log density there."""
    best, which = -np.inf, 1
    for k in range(2):
        total = log_prior[k]
        for a in range(6):
            for b in range(6):
                total -= 0.5 * d[a] * prior[k, a, b] * d[b]
        if total > best:
            best, which = total, k
    return which, best


@njit(cache=True, nogil=True, error_model="numpy")
def score(rays: Mat, variance: Vec, map_sigma: float, labels: Ints, log_prior: float, gain: Vec, uv: Mat,
          J: NDArray[np.float64], log_det: float) -> float:
    """Return the log of how much likelier the labels are than that no detection is a marker.

    By Laplace's method over the pose; ``log_prior`` is the prior's log density at the fit, ``log_det`` that of its
    information.
    """
    total, count = log_prior + 0.5 * (6.0 * LOG_2PI - log_det), 0
    for i in range(labels.shape[0]):
        j = labels[i]
        if j >= 0:
            own = variance[j] + (map_sigma * J[i, 0, 0]) ** 2
            squared = (rays[j, 0] - uv[i, 0]) ** 2 + (rays[j, 1] - uv[i, 1]) ** 2
            total += gain[j] - LOG_2PI - np.log(own) - 0.5 * squared / own
            count += 1
    return total if count > 0 else -np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def agree(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, prior: NDArray[np.float64],
          log_prior: Vec, which: int, gain: Vec, gate: float, barred: int, fitting: Ints, d: Vec, R: Mat, t: Vec,
          P: Mat, uv: Mat, J: NDArray[np.float64]) -> tuple[float, float, int]:
    """Fit, drop what does not fit, label anew at the fitted pose, until nothing changes.

    Returns log det of the information (NaN when there is no fit), the log density of the prior, and which one it is.
    """
    n = points.shape[0]
    squared, fresh = np.empty((n, rays.shape[0])), np.empty(n, dtype=np.int64)
    log_det, density, not_again = np.nan, -np.inf, -1
    if barred >= 0:
        not_again, fitting[barred] = fitting[barred], -1
    for _ in range(ROUNDS):
        log_det = fit(points, rays, variance, map_sigma, fitting, R0, t0, prior[which], d, R, t, P, uv, J)
        while np.isfinite(log_det) and drop_worst(rays, variance, map_sigma, fitting, uv, J, P, gain, gate, -np.inf):
            log_det = fit(points, rays, variance, map_sigma, fitting, R0, t0, prior[which], d, R, t, P, uv, J)
        if not np.isfinite(log_det):
            break
        likelier, density = likelier_prior(prior, log_prior, d)
        squared_distances(rays, variance, map_sigma, uv, J, P, gate, squared)
        if barred >= 0:
            squared[barred, not_again] = np.inf
        mutual(squared, fresh)
        if likelier == which and same(fitting, fresh):
            break
        which = likelier
        copy(fresh, fitting)
    return log_det, density, which


@njit(cache=True, nogil=True, error_model="numpy")
def same(a: Ints, b: Ints) -> bool:
    """Say whether two sets of labels are the same."""
    equal = True
    for i in range(a.shape[0]):
        equal = equal and a[i] == b[i]
    return equal


@njit(cache=True, nogil=True, error_model="numpy")
def copy(source: Ints, target: Ints) -> None:
    """Write the labels of one set into another."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@njit(cache=True, nogil=True, error_model="numpy")
def settle(points: Mat, rays: Mat, variance: Vec, map_sigma: float, R0: Mat, t0: Vec, prior: NDArray[np.float64],
           log_prior: Vec, which: int, gain: Vec, limits: Vec, barred: int, fitting: Ints, labels: Ints, d: Vec, R: Mat,
           t: Vec, P: Mat) -> float:
    """Bring labels and pose to agree (``agree``), then leave out what is unsure, one by one, fitting anew each time.

    ``fitting`` (n,) and ``d`` (6,) are the start; ``prior[which]`` counts until the pose tells which is likelier. The
    label ``fitting[barred]`` of the start is not given again; -1 bars none.
    Writes into ``fitting`` all labels that one pose explains, into ``labels`` those of them that are sure, and d, R, t,
    P of the pose of the sure ones. Returns the score of ``fitting``; -inf when there is none.
    """
    uv, J = np.empty((points.shape[0], 2)), np.empty((points.shape[0], 2, 6))
    log_det, density, which = agree(points, rays, variance, map_sigma, R0, t0, prior, log_prior, which, gain, limits[0],
                                    barred, fitting, d, R, t, P, uv, J)
    total = -np.inf
    if np.isfinite(log_det):
        total = score(rays, variance, map_sigma, fitting, density, gain, uv, J, log_det)
    copy(fitting, labels)
    changed = np.isfinite(log_det)
    if changed and drop_strained(rays, variance, map_sigma, labels, uv, J, P, gain, limits[2]):
        log_det = fit(points, rays, variance, map_sigma, labels, R0, t0, prior[which], d, R, t, P, uv, J)
    while changed and np.isfinite(log_det):
        changed = leave_out_rivals(rays, variance, map_sigma, labels, uv, J, P, limits[1]) > 0
        changed = changed or drop_worst(rays, variance, map_sigma, labels, uv, J, P, gain, limits[0], limits[2])
        if changed:
            log_det = fit(points, rays, variance, map_sigma, labels, R0, t0, prior[which], d, R, t, P, uv, J)
    if not np.isfinite(log_det):
        for i in range(labels.shape[0]):
            labels[i] = -1
    return total
