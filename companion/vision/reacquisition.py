"""Labels without a usable prior: with the attitude from the two INUs and no position, or with nothing at all.

Rules
-----
* With the attitude: pairs of markers and of detections vote for a translation, anywhere before the camera
  (``consensus``). Without: triples vote for a pose (``p3p``). No attitude is assumed then, not even a likely one.
* What is found is settled, challenged and concluded as in ``robust_labeling``, with a prior that says next to nothing,
  and more labels must agree: ``min_agree`` + 1 with the attitude, ``min_agree_blind`` without.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np

from companion.config import LabelingConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.consensus import settle_all
from companion.vision.p3p import vote_blind
from companion.vision.pose_fit import LOG_2PI, Ints
from companion.vision.robust_labeling import (
    CANDIDATES,
    Candidate,
    Labels,
    Scene,
    by_consensus,
    challenged,
    conclude,
    limits_of,
    refused,
    scene_of,
)

ANY_TURN_RAD = 2.0
"""Standard deviation per axis of a rotation of which nothing is known."""

TRIPLES = 24
"""Triples of markers that are tried: any six of nine markers hold at least one of them."""

MOST_TRIES = 250_000
"""Triples of markers on triples of detections, at about 0.3 us each."""


def reacquire(
    points_tanker: Mat,
    uv: Mat,
    sigma: Vec,
    config: LabelingConfig,
    R_cam_tanker: Mat | None = None,
) -> Labels:
    """Label markers (n, 3), m, tanker axes, with detections uv (m, 2) on z = 1, from the detections alone.

    ``sigma`` (m,) standard deviation per axis on z = 1. ``R_cam_tanker`` (3, 3) known to ``config.prior_sigma_rad``, or
    None. Not verified when the detections do not single out one set of labels, and ``too_many`` when there are more of
    them than can be tried without an attitude (about 20). Raises ValueError for wrong shapes only.
    """
    scene = scene_of(points_tanker, uv, sigma, config, None)
    if R_cam_tanker is None:
        return without_attitude(scene, config)
    R = np.ascontiguousarray(R_cam_tanker, dtype=np.float64)
    if R.shape != (3, 3):
        msg = f"R_cam_tanker must be (3, 3), not {R.shape}"
        raise ValueError(msg)
    middle = SE3(R, np.array([0.0, 0.0, 0.5 * config.max_range_m]))
    priors, cov = vague(0.5 * config.max_range_m, config.prior_sigma_rad)
    if not np.isfinite(R).all():
        return refused(scene, middle, cov, "prior")
    if len(scene.rays) == 0:
        return refused(scene, middle, cov, "no_detections")
    reach = (2.0 * config.max_range_m, config.prior_sigma_rad, config.max_range_m)
    found = by_consensus(scene, middle, priors, limits_of(config), config, reach)
    return judged(scene, found, middle, priors, cov, config, config.min_agree + 1)


def vague(sigma_m: float, sigma_rad: float) -> tuple[tuple[Mat, Vec], Mat]:
    """Return priors as ``robust_labeling.priors_of`` does, both kinds alike, and the covariance (6, 6)."""
    variances = np.array([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    information = np.tile(np.diag(1.0 / variances), (2, 1, 1))
    return (information, np.full(2, -0.5 * (6.0 * LOG_2PI + np.log(variances).sum()))), np.diag(variances)


def judged(scene: Scene, found: list[Candidate], origin: SE3, priors: tuple[Mat, Vec], cov: Mat,
           config: LabelingConfig, least: int) -> Labels:
    """Challenge the best of what was found, and conclude."""
    if not found:
        return refused(scene, origin, cov, "few_agree", searched=True)
    found = challenged(scene, found, origin, priors, limits_of(config), config)
    return conclude(scene, found, origin, cov, priors, config, least, searched=True)


def without_attitude(scene: Scene, config: LabelingConfig) -> Labels:
    """Label by triples of markers on triples of detections."""
    origin = SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * config.max_range_m]))
    priors, cov = vague(0.5 * config.max_range_m, ANY_TURN_RAD)
    n, m = len(scene.points), len(scene.rays)
    if m == 0:
        return refused(scene, origin, cov, "no_detections")
    triples = spread_triples(scene.points.tobytes(), n)
    if len(triples) * m * (m - 1) * (m - 2) > MOST_TRIES:
        return refused(scene, origin, cov, "too_many", searched=True)
    votes, T, labels = np.zeros(CANDIDATES), np.zeros((CANDIDATES, 12)), np.full((CANDIDATES, n), -1)
    least = max(config.min_agree_blind - 1, 4)
    vote_blind(scene.points, scene.rays, scene.variance, triples, config.max_range_m, least, votes, T, labels)
    found = [
        settled_at(scene, SE3(T[k, :9].reshape(3, 3), T[k, 9:]), priors, config, labels[k])
        for k in np.argsort(-votes, kind="stable") if votes[k] > 0.0
    ]
    if not found:
        return refused(scene, origin, cov, "few_agree", searched=True)
    best = max(found, key=lambda c: c.score)
    best.deviation[:] = 0.0  # from its own pose, about which it is challenged
    return judged(scene, found, best.T, priors, cov, config, config.min_agree_blind)


def settled_at(scene: Scene, T: SE3, priors: tuple[Mat, Vec], config: LabelingConfig, labels: Ints) -> Candidate:
    """Settle one candidate about its own pose."""
    fitting, sure, scores = labels[None].copy(), np.empty((1, len(labels)), dtype=np.int64), np.empty(1)
    d, R, t, P = np.zeros((1, 6)), np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((1, 6, 6))
    settle_all(scene.points, scene.rays, scene.variance, config.map_sigma_m, np.ascontiguousarray(T.R),
               np.ascontiguousarray(T.t), *priors, scene.gain, limits_of(config), np.full(1, -1), fitting, sure, d, R,
               t, P, scores)
    return Candidate(fitting[0], float(scores[0]), sure[0], SE3(R[0], t[0]), P[0], d[0])


@lru_cache(maxsize=8)
def spread_triples(points: bytes, n: int) -> Ints:
    """Return TRIPLES triples (s, 3) of markers, widely spread, no pair of markers in many more of them than another.

    A triple on a line fixes no pose and is left out. ``points`` are the bytes of an (n, 3) array, as a key.
    """
    p = np.frombuffer(points).reshape(n, 3)
    areas = {}
    for a, b, c in combinations(range(n), 3):
        areas[a, b, c] = float(np.linalg.norm(np.cross(p[b] - p[a], p[c] - p[a])))
    widest, extent = max(areas.values(), default=0.0), float(np.sum((p - p[:1]) ** 2))
    left = {c for c, area in areas.items() if area > 0.02 * widest and area > 1e-4 * extent}
    used: dict[tuple[int, int], int] = {}
    chosen: list[tuple[int, ...]] = []
    while left and len(chosen) < TRIPLES:
        best = min(left, key=lambda c: (sum(4 ** used.get(pair, 0) for pair in combinations(c, 2)), -areas[c], c))
        left.discard(best)
        chosen.append(best)
        for pair in combinations(best, 2):
            used[pair] = used.get(pair, 0) + 1
    return np.array(chosen, dtype=np.int64).reshape(-1, 3)
