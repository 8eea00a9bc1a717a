"""Frames for the labeling tests: markers along the approach as a detector might give them, and whose light each is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.config import FIRMWARE_CONFIGS, CameraConfig, LabelingConfig, TankerConfig, load
from companion.geometry import SE3, Mat, Vec, exp_so3, log_so3, rotation_from_euler, skew
from companion.vision.camera import T_frd_cam, pixels_to_normalised, project
from companion.vision.robust_labeling import Labels
from sim_bridge.label_score import LabelScore

CAMERA = load(FIRMWARE_CONFIGS / "cameras/default.toml", CameraConfig)
TANKER = load(FIRMWARE_CONFIGS / "tankers/kc135r.toml", TankerConfig)
MARKERS = np.array([m.p_tanker_m for m in TANKER.markers])
NOISE_PX = 0.3
START, CONTACT = np.array([-52.0, -21.0, 32.0]), np.array([-28.0, 0.0, 8.5])


@dataclass(frozen=True)
class Trouble:
    """What can go wrong in a frame, and how often."""

    dropouts: int = 4
    spurious: int = 6
    near: float = 0.3
    split: float = 0.15
    merged: float = 0.1
    gross: float = 0.3


@dataclass(frozen=True, eq=False)
class Frame:
    """``truth`` (m,) the marker whose light a detection is, or -1; ``pure`` (m,) whether it is that, whole and alone.

    ``true_px`` (n, 2) where the lights truly are; ``whole`` how many of them are detected pure.
    """

    T_cam_tanker: SE3
    prior: SE3
    cov_prior: Mat
    uv_px: Mat
    truth: np.ndarray
    true_px: Mat
    gross_m: float
    pure: np.ndarray
    sigma: Vec

    @property
    def whole(self) -> int:
        return int(np.count_nonzero(self.pure))

    @property
    def uv(self) -> Mat:
        return pixels_to_normalised(CAMERA, self.uv_px)


def pose(rng: np.random.Generator) -> SE3:
    """Draw a pose on the approach, off the path by a metre or so, both aircraft turned by a degree or two."""
    place = START + rng.uniform(0.0, 1.0) * (CONTACT - START) + rng.normal(0.0, [1.0, 1.0, 0.7])
    T_ned_frd = SE3(rotation_from_euler(*rng.normal(0.0, 0.025, 3)), place)
    T_ned_tanker = SE3(rotation_from_euler(*rng.normal(0.0, 0.02, 3)), np.zeros(3))
    return (T_ned_frd @ T_frd_cam(CAMERA)).inverse() @ T_ned_tanker


def prior_of(rng: np.random.Generator, T: SE3, gross: float) -> tuple[SE3, Mat, float]:
    """Draw a prior: as good as its covariance says, or metres off, where one may fall on another."""
    stated_m = rng.choice([0.3, 1.0])
    off = rng.normal(0.0, 0.6 * stated_m, 3)
    if rng.random() < gross:
        a, b = rng.choice(len(MARKERS), 2, replace=False)
        off = T.R @ (MARKERS[a] - MARKERS[b]) + rng.normal(0.0, 0.1, 3)
        if rng.random() < 0.5 or np.linalg.norm(off) > 5.0:
            off = rng.normal(0.0, 1.0, 3)
            off *= rng.uniform(1.0, 5.0) / np.linalg.norm(off)
    turn = exp_so3(rng.normal(0.0, np.deg2rad(rng.uniform(0.2, 1.0)), 3))
    cov = np.diag([stated_m**2] * 3 + [0.02**2] * 3)
    return SE3(turn @ T.R, T.t + off), cov, float(np.linalg.norm(off))


def frame(rng: np.random.Generator, trouble: Trouble) -> Frame:
    """Draw a frame."""
    T = pose(rng)
    px = project(CAMERA, T, MARKERS)
    size = np.array([CAMERA.width_px, CAMERA.height_px])
    inside = np.flatnonzero(((px > 2.0) & (px < size - 3.0)).all(axis=1))
    gone = rng.choice(len(MARKERS), rng.integers(0, trouble.dropouts + 1), replace=False)
    lit = [int(i) for i in inside if i not in gone]
    places, truth, pure = [px[i] for i in lit], list(lit), [True] * len(lit)
    if lit and rng.random() < trouble.split:
        k, half = int(rng.integers(len(lit))), rng.uniform(0.7, 2.5) * direction(rng)
        places.append(places[k] - half)
        places[k], truth, pure[k] = places[k] + half, [*truth, truth[k]], False
    if lit and rng.random() < trouble.merged:
        k = int(rng.integers(len(lit)))
        places[k], pure[k] = places[k] + rng.uniform(1.0, 6.0) * direction(rng), False
    for _ in range(rng.integers(0, trouble.spurious + 1)):
        near = rng.random() < trouble.near
        places.append(px[rng.integers(len(px))] + rng.normal(0.0, 8.0, 2) if near else rng.uniform(0.0, size - 1.0))
        truth.append(-1)
    order = rng.permutation(len(truth))
    uv_px = (np.array(places).reshape(-1, 2) + rng.normal(0.0, NOISE_PX, (len(truth), 2)))[order]
    prior, cov, gross_m = prior_of(rng, T, trouble.gross)
    owners, whole = np.array(truth, dtype=np.int64), np.zeros(len(truth), dtype=bool)
    whole[: len(pure)] = pure
    sigma = np.full(len(owners), NOISE_PX / CAMERA.fx_px)
    return Frame(T, prior, cov, uv_px, owners[order], px, gross_m, whole[order], sigma)


def direction(rng: np.random.Generator) -> Vec:
    """Draw a unit vector (2,)."""
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def surprise(f: Frame, marker: int, detection: int) -> float:
    """Return how many sigmas a detection lies from where one who knows all the other labels expects a marker's light.

    He has the other lights' true labels with their noise, the prior's attitude, and a position that may be 3 m off; the
    measure is of his uncertainty and the detection's noise. What is within a few sigmas nobody can tell from the
    light itself. (Gauss-Newton, started at the true pose.)
    """
    others = [(i, k) for k, i in enumerate(f.truth) if f.pure[k] and i != marker]
    information = np.diag([1.0 / 3.0**2] * 3 + [1.0 / 0.02**2] * 3)
    T = f.T_cam_tanker
    for _ in range(4):
        d = np.concatenate([T.t - f.prior.t, log_so3(T.R @ f.prior.R.T)])
        A, g = information.copy(), -information @ d
        for i, k in others:
            uv_px, J = slope(T, i)
            A += J.T @ J / NOISE_PX**2
            g += J.T @ (f.uv_px[k] - uv_px) / NOISE_PX**2
        step = np.linalg.solve(A, g)
        T = SE3(exp_so3(step[3:]) @ T.R, T.t + step[:3])
    uv_px, J = slope(T, marker)
    S = J @ np.linalg.solve(A, J.T) + NOISE_PX**2 * np.eye(2)
    off = f.uv_px[detection] - uv_px
    return float(np.sqrt(off @ np.linalg.solve(S, off)))


def slope(T: SE3, marker: int) -> tuple[Vec, Mat]:
    """Return where a marker is in px (2,) and how that changes (2, 6) with translation in m and rotation in rad."""
    turned = T.R @ MARKERS[marker]
    x, y, z = turned + T.t
    J = np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]]) * CAMERA.fx_px / z
    uv_px = np.array([x, y]) / z * CAMERA.fx_px + np.array([CAMERA.cx_px, CAMERA.cy_px])
    return uv_px, np.hstack([J, -J @ skew(turned)])


@dataclass
class Tally:
    """Counts over frames, beside the confusion matrix: how far off wrong labels were, what was available."""

    score: LabelScore = field(default_factory=lambda: LabelScore(len(MARKERS)))
    off_px: list[float] = field(default_factory=list)
    surprises: list[float] = field(default_factory=list)
    five: int = 0
    five_verified: int = 0
    verified: int = 0
    searched: int = 0
    refusals: dict[str, int] = field(default_factory=dict)

    def add(self, f: Frame, labels: Labels) -> None:
        """Count a frame; keep the distance of every wrong label from where its marker's light truly is."""
        self.verified += labels.verified
        self.searched += labels.searched
        self.refusals[labels.reason] = self.refusals.get(labels.reason, 0) + 1
        for i in self.score.add(labels.labels, f.truth, f.pure):
            self.off_px.append(float(np.linalg.norm(f.uv_px[labels.labels[i]] - f.true_px[i])))
            self.surprises.append(surprise(f, int(i), int(labels.labels[i])))
        self.five += f.whole >= 5
        self.five_verified += f.whole >= 5 and labels.verified

    def text(self) -> str:
        """Return the table and what can be told from it."""
        share = 100 * self.five_verified / max(self.five, 1)
        return (
            f"{self.score.table()}\nverified {self.verified}; of {self.five} with five or more lights detected whole "
            f"{self.five_verified} ({share:.2f} %); searched {self.searched}; refusals {self.refusals}\n"
            f"wrong labels, from the light's true place in px {np.round(sorted(self.off_px), 2).tolist()}, "
            f"in sigmas of one who knows the other labels {np.round(sorted(self.surprises), 2).tolist()}"
        )


CONFIG = LabelingConfig()
