"""Labels that are verified: which detection is which marker, when any of them may be missing or false.

Rules
-----
* A marker may have no detection and a detection may be no marker. A set of labels counts only when one pose explains
  all of it, when it is far likelier than chance, and when no other set comes near it.
* First the assignment at the prior, gated by its covariance: in most frames it is right, and cheap to verify. Where it
  does not settle the matter, every pair of markers votes with every pair of detections, with the attitude of the prior
  and a position that may be metres off (``consensus``).
* What cannot be told is left out: a label with a rival as near, and a label that the others do not foretell closely.
* Not verified means no labels at all: -1 throughout, and a ``reason``.

================= ====================================================================================================
reason            meaning
================= ====================================================================================================
``prior``         the prior or its covariance is not finite, or the covariance is not positive definite
``no_detections`` no detection is finite
``few_agree``     fewer than ``min_agree`` labels agree on a pose, or not clearly more than chance would bring
``ambiguous``     another set of labels explains the detections as well, and too few labels are common to both
``too_many``      more detections than the search without an attitude can go through (``reacquisition``)
================= ====================================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from companion.config import LabelingConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.consensus import settle_all, vote
from companion.vision.label_kernel import FARTHEST_M, first_labels, settle, squared_distances, two_priors, weigh
from companion.vision.pose_fit import LOG_2PI, Ints, fit, project

CANDIDATES = 16
"""Sets of labels of the vote that are looked at closely."""

FEW = 6
"""Labels up to which two at a time are always taken for wrong."""

NEAR_SIGMAS = 25.0
"""How far false labels may bend a pose off true ones, in sigmas of the bent pose and the detection's noise."""

GATED_OUT = 1e6
"""Cost of a pair outside the gate, for the assignment."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Outcome of a labeling.

    ``labels`` (n,) index into the detections, -1 without one. ``T_cam_tanker`` the pose that explains them, ``cov``
    (6, 6) its covariance (translation in m, rotation in rad, camera axes, left perturbation); the prior's when not
    verified. ``agreed`` how many labels; ``left_out`` how many more would fit, but are not sure.
    ``score`` log of how much likelier than chance; ``margin`` what is between it and the best set of labels that
    contradicts it, infinite when none was found. ``searched`` whether the prior's assignment was not enough.
    """

    labels: Ints
    T_cam_tanker: SE3
    cov: Mat
    verified: bool
    ambiguous: bool
    reason: str
    agreed: int
    left_out: int
    score: float
    margin: float
    searched: bool


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is labelled: finite markers (n, 3) and detections (m, 2), and where those stood in the input."""

    points: Mat
    rays: Mat
    variance: Vec
    gain: Vec
    marker: Ints
    detection: Ints
    n_markers: int


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """All labels that one pose explains, their score, those of them that are sure, and the pose of these."""

    fitting: Ints
    score: float
    labels: Ints
    T: SE3
    cov: Mat
    deviation: Vec


def label_robust(
    points_tanker: Mat,
    uv: Mat,
    sigma: Vec,
    prior_T_cam_tanker: SE3,
    cov_prior: Mat,
    config: LabelingConfig,
    weight: Vec | None = None,
) -> Labels:
    """Label markers (n, 3), m, tanker axes, with detections uv (m, 2) on the plane z = 1, or say that it cannot be.

    ``sigma`` (m,) standard deviation per axis of the detections on z = 1. ``cov_prior`` (6, 6) covariance of the prior:
    translation in m, then rotation in rad, along camera axes; R = exp(rotation) R_prior, t = t_prior + translation. Its
    translation may be wrong by several ``config.gross_sigma_m``; its rotation is taken to be what it says.
    ``weight`` (m,) in 0..1: how much like a light a detection looks; zero does not count.

    Raises ValueError for wrong shapes only; numbers that are not finite are markers or detections that do not count.
    """
    scene = scene_of(points_tanker, uv, sigma, config, weight)
    limits = limits_of(config)
    priors = priors_of(prior_T_cam_tanker, cov_prior, config)
    if priors is None:
        return refused(scene, prior_T_cam_tanker, np.full((6, 6), np.nan), "prior")
    if len(scene.rays) == 0:
        return refused(scene, prior_T_cam_tanker, cov_prior, "no_detections")
    first, sure = at_the_prior(scene, prior_T_cam_tanker, cov_prior, priors, limits, config)
    if sure:
        return conclude(scene, [first], prior_T_cam_tanker, cov_prior, priors, config, config.min_agree,
                    searched=False)
    sigma_rad = math.sqrt(max(float(np.trace(cov_prior[3:, 3:])), 0.0) / 3.0)
    reach_m = config.gate_sigma * config.gross_sigma_m
    found = by_consensus(scene, prior_T_cam_tanker, priors, limits, config, (reach_m, sigma_rad, config.max_range_m))
    found = challenged(scene, [first, *found], prior_T_cam_tanker, priors, limits, config)
    return conclude(scene, found, prior_T_cam_tanker, cov_prior, priors, config, config.min_agree,
                    searched=True)


def scene_of(points_tanker: Mat, uv: Mat, sigma: Vec, config: LabelingConfig, weight: Vec | None) -> Scene:
    """Check shapes and leave out what is not finite."""
    points = np.ascontiguousarray(points_tanker, dtype=np.float64)
    rays = np.ascontiguousarray(uv, dtype=np.float64)
    noise = np.ascontiguousarray(sigma, dtype=np.float64)
    like = np.ones(len(rays)) if weight is None else np.ascontiguousarray(weight, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or rays.ndim != 2 or rays.shape[1] != 2:
        msg = f"points_tanker must be (n, 3) and uv (m, 2), not {points.shape} and {rays.shape}"
        raise ValueError(msg)
    if noise.shape != (len(rays),) or like.shape != (len(rays),):
        msg = f"sigma and weight must be ({len(rays)},) like uv, not {noise.shape} and {like.shape}"
        raise ValueError(msg)
    odds = config.detection_probability / ((1.0 - config.detection_probability) * config.false_density)
    variance, gain = np.empty(len(rays)), np.empty(len(rays))
    marker, detection = np.arange(len(points)), np.arange(len(rays))
    if not weigh(points, rays, noise, like, odds, variance, gain):
        marker = np.flatnonzero((np.abs(points) < FARTHEST_M).all(axis=1))
        good = np.isfinite(rays).all(axis=1) & np.isfinite(variance) & np.isfinite(gain) & (noise > 0)
        detection = np.flatnonzero(good)
        points, rays, variance, gain = points[marker], rays[detection], variance[detection], gain[detection]
    return Scene(points, rays, variance, gain, marker, detection, len(points_tanker))


def limits_of(config: LabelingConfig) -> Vec:
    """Return the limits of ``label_kernel``."""
    return np.array([config.gate_sigma, config.min_rival_odds, config.min_label_odds])


def priors_of(prior: SE3, cov_prior: Mat, config: LabelingConfig) -> tuple[Mat, Vec] | None:
    """Return the information matrices (2, 6, 6) and log densities (2,) of the prior as it is and grossly wrong."""
    cov = np.ascontiguousarray(cov_prior, dtype=np.float64)
    if cov.shape != (6, 6) or prior.R.shape != (3, 3) or prior.t.shape != (3,):
        msg = f"the prior must be R (3, 3), t (3,) with a covariance (6, 6), not {cov.shape}"
        raise ValueError(msg)
    information, log_density = np.empty((2, 6, 6)), np.empty(2)
    known = two_priors(cov, config.gross_sigma_m, config.gross_probability, information, log_density)
    finite = np.isfinite(prior.R).all() and np.isfinite(prior.t).all()
    return (information, log_density) if known and finite else None


def at_the_prior(scene: Scene, prior: SE3, cov: Mat, priors: tuple[Mat, Vec], limits: Vec,
                 config: LabelingConfig) -> tuple[Candidate, bool]:
    """Assign at the prior and settle; and say whether no search is needed.

    It is not when every marker has a label that fits: no shift brings all of a set of points onto itself. Nor when
    every detection is one and the gates left no choice: what contradicts these labels is then no larger a set, and
    needs a prior that is grossly wrong. Or, where the configuration says so, when ``sure_agree`` labels are sure: what
    is looked for is then so many points near the prior that another set of as many would have to be a second tanker.
    """
    n, m = len(scene.points), len(scene.rays)
    labels = np.empty(n, dtype=np.int64)
    R0, t0 = np.ascontiguousarray(prior.R), np.ascontiguousarray(prior.t)
    plain, squared, log_det = first_labels(
        scene.points, scene.rays, scene.variance, config.map_sigma_m, R0, t0, np.ascontiguousarray(cov, np.float64),
        limits[0], labels)
    if not plain:
        labels = assign(squared, log_det, scene.gain)
    d, R, t, P, sure = np.zeros(6), np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty(n, dtype=np.int64)
    score = settle(scene.points, scene.rays, scene.variance, config.map_sigma_m, R0, t0, *priors, 0, scene.gain,
                   limits, -1, labels, sure, d, R, t, P)
    fits = int(np.count_nonzero(labels >= 0))
    whole = fits == n or (fits == m and plain)
    agreed = int(np.count_nonzero(sure >= 0))
    enough = agreed > config.min_agree and score > config.min_score
    many = 0 < config.sure_agree <= agreed
    return Candidate(labels, score, sure, SE3(R, t), P, d), (whole or many) and enough


def assign(squared: Mat, log_det: Vec, gain: Vec) -> Ints:
    """Return the labels of least total cost, where a marker may go without (a null column each)."""
    n, m = squared.shape
    cost = np.zeros((n, m + n))
    # A prior that leaves no uncertainty has a determinant of zero, a marker that cannot be has none.
    spread = np.nan_to_num(log_det, nan=GATED_OUT, posinf=GATED_OUT, neginf=-GATED_OUT)
    pair = 0.5 * (np.where(np.isfinite(squared), squared, GATED_OUT) + spread[:, None]) + LOG_2PI - gain[None]
    cost[:, :m] = np.where(np.isfinite(squared), np.clip(pair, -GATED_OUT, GATED_OUT), GATED_OUT)
    columns = linear_sum_assignment(cost)[1]
    return np.where(columns < m, columns, -1)


def by_consensus(scene: Scene, prior: SE3, priors: tuple[Mat, Vec], limits: Vec, config: LabelingConfig,
                 reach: tuple[float, float, float]) -> list[Candidate]:
    """Return the sets of labels that pairs of markers voted for, settled; ``reach`` in m, rad, m of range."""
    n = len(scene.points)
    R0, t0 = np.ascontiguousarray(prior.R), np.ascontiguousarray(prior.t)
    votes, t, labels = np.zeros(CANDIDATES), np.zeros((CANDIDATES, 3)), np.full((CANDIDATES, n), -1)
    reach_m, sigma_rad, range_m = reach
    vote(scene.points, scene.rays, scene.variance, R0, t0, reach_m, sigma_rad, range_m, config.min_agree, votes, t,
         labels)
    order = np.argsort(-votes, kind="stable")
    order = order[votes[order] > 0.0]
    starts = np.zeros((len(order), 6))
    starts[:, :3] = t[order] - t0
    return settled(scene, prior, priors, limits, config, starts, labels[order], np.full(len(order), -1))


def settled(scene: Scene, origin: SE3, priors: tuple[Mat, Vec], limits: Vec, config: LabelingConfig, d: Mat,
            fitting: Ints, barred: Ints) -> list[Candidate]:
    """Settle candidates from deviations d (k, 6), labels (k, n), and a marker (k,) that must find another label."""
    k = len(d)
    sure, scores = np.empty(fitting.shape, dtype=np.int64), np.empty(k)
    R, t, P = np.empty((k, 3, 3)), np.empty((k, 3)), np.empty((k, 6, 6))
    settle_all(scene.points, scene.rays, scene.variance, config.map_sigma_m, np.ascontiguousarray(origin.R),
               np.ascontiguousarray(origin.t), *priors, scene.gain, limits, barred, fitting, sure, d, R, t, P,
               scores)
    return [Candidate(fitting[i], float(scores[i]), sure[i], SE3(R[i], t[i]), P[i], d[i]) for i in range(k)]


def challenged(scene: Scene, found: list[Candidate], prior: SE3, priors: tuple[Mat, Vec], limits: Vec,
               config: LabelingConfig) -> list[Candidate]:
    """Add to the candidates what becomes of the best one when any one of its labels is taken for wrong, or any two.

    Two false labels can bear each other out and bend the pose, so that true ones no longer fit. Two at a time are tried
    where that may be: among few labels, and where a detection lies somewhat off a marker without a label.
    """
    best = max(found, key=lambda c: c.score)
    used = np.flatnonzero(best.fitting >= 0).tolist()
    doubts: list[tuple[int, ...]] = [(i,) for i in used]
    if len(used) <= FEW or near_miss(scene, best, config):
        doubts += combinations(used, 2)
    starts, labels = np.tile(best.deviation, (len(doubts), 1)), np.tile(best.fitting, (len(doubts), 1))
    for k, doubt in enumerate(doubts):
        labels[k, doubt[1:]] = -1  # the first is barred by ``settle``
    barred = np.array([doubt[0] for doubt in doubts], dtype=np.int64)
    return found + settled(scene, prior, priors, limits, config, starts, labels, barred)


def near_miss(scene: Scene, best: Candidate, config: LabelingConfig) -> bool:
    """Say whether a marker without a label has a detection without one within NEAR_SIGMAS of its place."""
    free, unused = best.fitting < 0, np.ones(len(scene.rays), dtype=bool)
    unused[best.fitting[~free]] = False
    points, n = np.ascontiguousarray(scene.points[free]), int(np.count_nonzero(free))
    uv, J, squared = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, len(scene.rays)))
    project(points, best.T.R, best.T.t, uv, J)
    squared_distances(scene.rays, scene.variance, config.map_sigma_m, uv, J, best.cov, NEAR_SIGMAS, squared)
    return bool(np.isfinite(squared[:, unused]).any())


def conclude(scene: Scene, found: list[Candidate], prior: SE3, cov_prior: Mat, priors: tuple[Mat, Vec],
             config: LabelingConfig, least: int, *, searched: bool) -> Labels:
    """Take the best set of labels if it is good enough, without what comparable sets see differently."""
    best = max(found, key=lambda c: c.score)
    if np.count_nonzero(best.labels >= 0) < least or not best.score > config.min_score:
        return refused(scene, prior, cov_prior, "few_agree", searched=searched)
    labels, margin = best.labels, np.inf
    for other in found:
        if contradict(best.fitting, other.fitting):
            margin = min(margin, best.score - other.score)
            if best.score - other.score < config.min_margin:
                labels = np.where(labels == other.fitting, labels, -1)
    agreed = int(np.count_nonzero(labels >= 0))
    if agreed < least:
        return refused(scene, prior, cov_prior, "ambiguous", searched=searched)
    T, cov = best.T, best.cov
    if labels is not best.labels and not np.array_equal(labels, best.labels):
        T, cov = pose_of(scene, labels, prior, priors, best.deviation, config)
    full = np.full(scene.n_markers, -1)
    used = labels >= 0
    full[scene.marker[used]] = scene.detection[labels[used]]
    left_out = int(np.count_nonzero(best.fitting >= 0)) - agreed
    return Labels(full, T, cov, True, False, "", agreed, left_out, best.score, margin, searched)


def pose_of(scene: Scene, labels: Ints, prior: SE3, priors: tuple[Mat, Vec], start: Vec,
            config: LabelingConfig) -> tuple[SE3, Mat]:
    """Return the pose of some labels and its covariance, under the prior that may be grossly wrong."""
    n = len(labels)
    R, t, P, uv, J = np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty((n, 2)), np.empty((n, 2, 6))
    fit(scene.points, scene.rays, scene.variance, config.map_sigma_m, labels, np.ascontiguousarray(prior.R),
        np.ascontiguousarray(prior.t), priors[0][1], start.copy(), R, t, P, uv, J)
    return SE3(R, t), P


def contradict(a: Ints, b: Ints) -> bool:
    """Say whether each of two sets holds a label that the other lacks; a smaller set of the same is no rival."""
    differ = a != b
    return bool(np.any(differ & (a >= 0)) and np.any(differ & (b >= 0)))


def refused(scene: Scene, prior: SE3, cov: Mat, reason: str, *, searched: bool = False) -> Labels:
    """Return that nothing is labelled, and why."""
    none = np.full(scene.n_markers, -1, dtype=np.int64)
    return Labels(none, prior, cov, False, reason == "ambiguous", reason, 0, 0, -np.inf, 0.0, searched)
