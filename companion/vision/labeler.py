"""Labels of one frame, by the configured rule: which search when, among which detections, with how many agreeing.

Rules
-----
* With a prior: about it; then anywhere with its attitude, for lights. Corners were looked for about the prior only, so
  that elsewhere there is nothing of the tanker to find, only what repeats its shapes.
* While tracking fewer labels than otherwise are enough. ``min_agree`` labels and fewer do not count when a detection
  near the markers is left over: then one of the few may be as false as that one.
* A search takes time with the third power of the detections: it gets those ``MOST`` nearest to where markers are
  expected, and the search anywhere the ``MOST`` largest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from companion.config import LabelingConfig, VisionConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.labeling import label_mutual_nearest
from companion.vision.pose_fit import Ints
from companion.vision.reacquisition import reacquire
from companion.vision.robust_labeling import Labels, label_robust

MOST = 32
"""Detections that a search goes through; 64 take 10 ms each time, 32 about 2 ms."""

LEFT_OVER = 0.1
"""How near to an expected marker, on z = 1, a detection without a label makes few labels doubtful: 46 px at f = 457."""

TRACKED_GROSS = 1e-4
"""How often a prior that rests on a vision just passed is grossly wrong."""

TRACKED_SCORE = 15.0
"""Log of how much likelier than chance a set of labels is at least then, because two or three can be enough. (Of 4000
frames with up to eight lights out and false ones near them, 98 in 100 with three lights were labelled with this, 72 in
100 with 20; with 12 a fourth more labels went to false lights.)"""

Stage = tuple[LabelingConfig, Mat]
"""Limits of a search and the covariance (6, 6) of the prior that it begins at."""


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """``labels`` (n,) index into the detections, -1 without one, and about where the tanker is."""

    labels: Ints
    T_cam_tanker: SE3 | None


class Labeler:
    """Says which detection each of ``markers`` (n, 3), m, tanker axes, is."""

    def __init__(self, markers: Mat, config: VisionConfig) -> None:
        self._markers = markers
        self._config = config.labeling
        self._anywhere = config.detector == "lights"
        if not self._anywhere:
            least = max(self._config.min_agree, config.corners.min_agree)
            self._config = msgspec.structs.replace(self._config, min_agree=least, min_agree_tracked=least)
        self._min_markers = config.min_markers
        self._far, self._near = stages(self._config)

    def label(
        self, predicted_px: Mat, uv_px: Mat, uv: Mat, sigma: Vec, area: Vec, prior: SE3 | None, *, tracked: bool
    ) -> Labelled | tuple[str, str]:
        """Return labels, or reason and detail of why nothing is sure.

        ``predicted_px`` (n, 2) and detections ``uv_px`` (m, 2) in px, the latter also as ``uv`` on z = 1, ``sigma``
        (m,) there and ``area`` (m,); ``prior`` T_cam_tanker or None.
        """
        if self._config.method == "mutual_nearest":
            return Labelled(label_mutual_nearest(predicted_px, uv_px, self._config.max_distance_px), prior)
        if len(uv) == 0:
            return "few_markers", f"0 of {self._min_markers}"
        found = self._anew(uv, sigma, area, None) if prior is None else self._search(uv, sigma, area, prior, tracked)
        return Labelled(found.labels, found.T_cam_tanker) if found.verified else ("labels", found.reason)

    def _search(self, uv: Mat, sigma: Vec, area: Vec, prior: SE3, tracked: bool) -> Labels:
        """Label about the prior; where that fails, anywhere with the prior's attitude."""
        expected = on_plane(prior, self._markers)
        kept = nearest_to(expected, uv)
        for config, cov_prior in (self._near, self._far) if tracked else (self._far,):
            found = label_robust(self._markers, uv[kept], sigma[kept], prior, cov_prior, config)
            found = in_all(found, kept)
            few = found.agreed <= self._config.min_agree
            if found.verified and not (few and left_over(expected, uv, found.labels)):
                return found
        if not self._anywhere or len(uv) <= self._config.min_agree:
            return refused(found)
        again = self._anew(uv, sigma, area, prior.R)
        return again if again.verified else refused(found)

    def _anew(self, uv: Mat, sigma: Vec, area: Vec, R_cam_tanker: Mat | None) -> Labels:
        kept = np.sort(np.argsort(-area, kind="stable")[:MOST])
        return in_all(reacquire(self._markers, uv[kept], sigma[kept], self._config, R_cam_tanker), kept)


def stages(config: LabelingConfig) -> tuple[Stage, Stage]:
    """Return limits and covariance of the prior: with GPS alone behind it, and with a vision just passed."""
    tracked = msgspec.structs.replace(
        config, min_agree=min(config.min_agree, config.min_agree_tracked), gross_probability=TRACKED_GROSS,
        min_score=max(config.min_score, TRACKED_SCORE),
    )
    far = np.diag([config.prior_sigma_m**2] * 3 + [config.prior_sigma_rad**2] * 3)
    near = np.diag([config.tracked_sigma_m**2] * 3 + [config.tracked_sigma_rad**2] * 3)
    return (config, far), (tracked, near)


def on_plane(T_cam_tanker: SE3, markers: Mat) -> Mat:
    """Return markers (k, 2) on the plane z = 1, those only that are before the camera."""
    p = T_cam_tanker.transform(markers)
    ahead = p[p[:, 2] > 0.0]
    return ahead[:, :2] / ahead[:, 2:]


def nearest_to(expected: Mat, uv: Mat) -> Ints:
    """Return the numbers, in order, of the ``MOST`` detections uv (m, 2) nearest to any expected place (k, 2)."""
    if len(uv) <= MOST or len(expected) == 0:
        return np.arange(min(len(uv), MOST))
    away = squared_distances(expected, uv).min(axis=0)
    return np.sort(np.argsort(away, kind="stable")[:MOST])


def left_over(expected: Mat, uv: Mat, labels: Ints) -> bool:
    """Say whether a detection without a label is near an expected place."""
    rest = np.delete(uv, labels[labels >= 0], axis=0)
    return bool((squared_distances(expected, rest) < LEFT_OVER**2).any())


def squared_distances(a: Mat, b: Mat) -> Mat:
    """Return the squared distances (k, m) of places a (k, 2) from b (m, 2)."""
    apart = a[:, None] - b[None]
    squared: Mat = np.einsum("kmi,kmi->km", apart, apart)
    return squared


def in_all(found: Labels, kept: Ints) -> Labels:
    """Return labels that count all detections for labels that count the ``kept`` ones."""
    labels = np.where(found.labels >= 0, kept[found.labels], -1)
    return replace(found, labels=labels)


def refused(found: Labels) -> Labels:
    """Return labels that are too few as none."""
    if not found.verified:
        return found
    none = np.full(len(found.labels), -1, dtype=np.int64)
    return replace(found, labels=none, verified=False, reason="few_agree", agreed=0)
