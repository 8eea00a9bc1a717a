"""Runs with noise on the markers, after labeling (7.5.1) and before it (7.5.3), and how they went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from companion.vision.camera import pixels_to_normalised
from companion.vision.labeling import label_mutual_nearest
from sim_bridge.study import axes, thesis_numbers
from sim_bridge.study.recording import Recording, labelled
from sim_bridge.study.solvers import NAMES, label_for_chain, track

FOCAL_M = 0.05
"""Focal length that turns the thesis' metres on the sensor into ours: it does not give its own. With 50 mm its noise
goes from 0 to 0.0063 on the plane z = 1, 1.4 px of the 320x200 camera. Others are tried too."""

RUN_S = 45.0
WRONG_M = 5.0
"""An estimate further off than this is wrong; with 5 markers and the most noise a right one is off by a metre or so."""

LAST_FRAMES = 20
DROPOUTS_S = ((11.7, 11.8, 3), (27.7, 31.2, 7), (31.2, 33.0, 6), (33.0, 40.0, 5))
"""From, to, and how many markers the thesis saw then (7.5.1); before, between and after all are seen."""

When = Literal["after", "before"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """One solver over one noisy run.

    ``diverged``: wrong in each of the last two seconds, with all markers seen. ``wrong`` and ``held``: the shares of
    frames with a wrong estimate, and without a new one. ``rms_m`` x y z over the whole run.
    ``mislabelled``: how many labels were wrong (noise before labeling).
    """

    diverged: bool
    wrong: float
    held: float
    rms_m: tuple[float, float, float]
    mislabelled: int


def sigma(power: float, focal_m: float = FOCAL_M) -> float:
    """Return the standard deviation on the plane z = 1 of band-limited white noise of a power (7.5.1)."""
    return float(np.sqrt(power / thesis_numbers.CORRELATION_TIME_S)) / focal_m


def seen_markers(t_s: Vec, n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which of n markers are seen (k, n): drop-outs as the thesis tells them, of markers drawn by chance."""
    seen = np.ones((len(t_s), n), dtype=bool)
    for start_s, end_s, count in DROPOUTS_S:
        during = (t_s > start_s - 1e-6) & (t_s < end_s - 1e-6)
        seen[np.ix_(during, rng.permutation(n)[count:])] = False
    return seen


def noisy_after(recording: Recording, frames: int, power: float, focal_m: float, rng: np.random.Generator) -> Mat:
    """Return the labelled markers (frames, n, 2) with noise (Fig. 7.18)."""
    uv = recording.uv[:frames]
    return uv + sigma(power, focal_m) * rng.standard_normal(uv.shape)


def noisy_before(
    recording: Recording, frames: int, power: float, focal_m: float, rng: np.random.Generator
) -> tuple[Mat, Mat, int, int]:
    """Put noise on the detections and label them: as the thesis does, and as the chain does.

    Returns both sets of markers (frames, n, 2) and how many labels of each are of another marker.
    """
    camera, vision = recording.setup.camera, recording.setup.config.vision
    scale, deviation = np.array([camera.fx_px, camera.fy_px]), sigma(power, focal_m)
    nearest, robust = np.full((2, frames, len(recording.markers), 2), np.nan)
    wrong = [0, 0]
    for k in range(frames):
        clean = recording.detected_px[k]
        px = clean + deviation * scale * rng.standard_normal(clean.shape)
        labels = label_mutual_nearest(recording.predicted_px[k], px, vision.labeling.max_distance_px)
        nearest[k] = labelled(recording.setup, px, labels)
        wrong[0] += mistaken(labels, recording.labels[k])
        labels = label_for_chain(recording, k, pixels_to_normalised(camera, px), deviation)
        robust[k] = labelled(recording.setup, px, labels)
        wrong[1] += mistaken(labels, recording.labels[k])
    return nearest, robust, wrong[0], wrong[1]


def mistaken(labels: NDArray[np.int64], right: NDArray[np.int64]) -> int:
    """Return how many labels name another detection than the right one."""
    return int(np.sum((labels >= 0) & (labels != right)))


def run(
    recording: Recording, when: When, power: float, focal_m: float, dropouts: bool, seeds: tuple[int, ...]
) -> dict[str, list[Outcome]]:
    """Run every solver with the noise of every seed; the same noise for all of them and, but for its size, powers."""
    frames = recording.until(RUN_S)
    true = axes.xyz(np.array([T.t for T in recording.T_true[:frames]]))
    out: dict[str, list[Outcome]] = {name: [] for name in NAMES}
    for seed in seeds:
        rng = np.random.default_rng([seed, 75])
        seen = seen_markers(recording.t_s[:frames], len(recording.markers), rng)
        wrong_labels = dict.fromkeys(NAMES, 0)
        if when == "after":
            uv = noisy_after(recording, frames, power, focal_m, rng)
            by_name = dict.fromkeys(NAMES, uv)
        else:
            nearest, robust, missed, missed_robust = noisy_before(recording, frames, power, focal_m, rng)
            by_name = {name: robust if name == "chain" else nearest for name in NAMES}
            wrong_labels = {name: missed_robust if name == "chain" else missed for name in NAMES}
        for name in NAMES:
            uv = by_name[name]
            if dropouts:
                uv = np.where(seen[:, :, None], uv, np.nan)
            t, _, fresh = track(name, recording, uv, recording.T_prior[0], sigma(power, focal_m))
            out[name].append(judge(axes.xyz(t) - true, fresh, wrong_labels[name]))
    return out


def judge(error_m: Mat, fresh: NDArray[np.bool_], mislabelled: int) -> Outcome:
    """Return how a run went by its errors (k, 3) and whether each frame gave a new estimate (k,)."""
    wrong = ~(np.einsum("ij,ij->i", error_m, error_m) < WRONG_M**2)  # NaN is wrong
    x, y, z = np.sqrt(np.mean(np.square(error_m), axis=0))
    held = float(1.0 - fresh.mean())
    return Outcome(bool(wrong[-LAST_FRAMES:].all()), float(wrong.mean()), held, (x, y, z), mislabelled)


def noisy_errors(
    recording: Recording, power: float, focal_m: float, seed: int
) -> tuple[dict[str, Mat], NDArray[np.int64]]:
    """Return each solver's errors of x y z (k, 3) in one run with noise after labeling, and the markers seen (k,)."""
    frames = recording.until(RUN_S)
    true = axes.xyz(np.array([T.t for T in recording.T_true[:frames]]))
    rng = np.random.default_rng([seed, 75])
    seen = seen_markers(recording.t_s[:frames], len(recording.markers), rng)
    uv = np.where(seen[:, :, None], noisy_after(recording, frames, power, focal_m, rng), np.nan)
    noise = sigma(power, focal_m)
    errors = {name: axes.xyz(track(name, recording, uv, recording.T_prior[0], noise)[0]) - true for name in NAMES}
    return errors, seen.sum(axis=1)
