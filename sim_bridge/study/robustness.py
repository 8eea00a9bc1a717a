"""Runs with noise on the markers, after labeling (7.5.1) and before it (7.5.3), and how they went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat, Vec
from companion.vision.labeling import label_mutual_nearest
from sim_bridge.study import axes, thesis_numbers
from sim_bridge.study.recording import Recording, labelled
from sim_bridge.study.solvers import NAMES, look, track, whole_chain

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


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Noisy detections of one frame (m, 2) px, and which of them each marker truly is (n,), -1 for none."""

    px: Mat
    right: NDArray[np.int64]


def noisy_before(
    recording: Recording, seen: NDArray[np.bool_], power: float, focal_m: float, rng: np.random.Generator
) -> list[Seen]:
    """Return the detections with noise, without those of the markers that are not ``seen`` (frames, n)."""
    camera = recording.setup.camera
    scale = sigma(power, focal_m) * np.array([camera.fx_px, camera.fy_px])
    frames = []
    for k, there in enumerate(seen):
        clean, labels = recording.detected_px[k], recording.labels[k]
        kept = np.ones(len(clean), dtype=bool)
        kept[labels[~there & (labels >= 0)]] = False
        place = np.cumsum(kept) - 1
        right = np.where(there & (labels >= 0), place[labels], -1)
        frames.append(Seen((clean + scale * rng.standard_normal(clean.shape))[kept], right))
    return frames


def mistaken(labels: NDArray[np.int64], right: NDArray[np.int64]) -> int:
    """Return how many labels name another detection than the right one."""
    return int(np.sum((labels >= 0) & (labels != right)))


def label_all(recording: Recording, frames: list[Seen]) -> tuple[Mat, int]:
    """Label noisy detections as the thesis does: the markers (frames, n, 2) on z = 1, and how many labels are wrong."""
    limit_px = recording.setup.config.vision.labeling.max_distance_px
    uv, wrong = np.empty((len(frames), len(recording.markers), 2)), 0
    for k, frame in enumerate(frames):
        labels = label_mutual_nearest(recording.predicted_px[k], frame.px, limit_px)
        uv[k] = labelled(recording.setup, frame.px, labels)
        wrong += mistaken(labels, frame.right)
    return uv, wrong


def fly_chain(recording: Recording, frames: list[Seen], noise_px: float) -> tuple[Mat, NDArray[np.bool_], int]:
    """Return the chain's positions (frames, 3) by its own labels, which of them are new, and wrong labels passed on."""
    chain = whole_chain(recording.setup)
    t, fresh, wrong = np.empty((len(frames), 3)), np.zeros(len(frames), dtype=bool), 0
    for k, frame in enumerate(frames):
        pose = look(chain, frame.px, recording.T_prior[k], noise_px)
        t[k], fresh[k] = (recording.T_gps[k] if pose is None else pose.T_cam_tanker).t, pose is not None
        wrong += 0 if pose is None else mistaken(pose.labels, frame.right)
    return t, fresh, wrong


def run(
    recording: Recording, when: When, power: float, focal_m: float, dropouts: bool, seeds: tuple[int, ...]
) -> dict[str, list[Outcome]]:
    """Run every solver with the noise of every seed; the same noise for all of them and, but for its size, powers."""
    frames = recording.until(RUN_S)
    true = axes.xyz(np.array([T.t for T in recording.T_true[:frames]]))
    noise, T_start = sigma(power, focal_m), recording.T_prior[0]
    out: dict[str, list[Outcome]] = {name: [] for name in NAMES}
    for seed in seeds:
        rng = np.random.default_rng([seed, 75])
        seen = seen_markers(recording.t_s[:frames], len(recording.markers), rng)
        if not dropouts:
            seen[:] = True
        if when == "after":
            uv, wrong = np.where(seen[:, :, None], noisy_after(recording, frames, power, focal_m, rng), np.nan), 0
        else:
            noisy = noisy_before(recording, seen, power, focal_m, rng)
            uv, wrong = label_all(recording, noisy)
        for name in NAMES:
            if when == "before" and name == "chain":
                t, fresh, mislabelled = fly_chain(recording, noisy, noise * recording.scale_px())
            else:
                (t, _, fresh), mislabelled = track(name, recording, uv, T_start, noise), wrong
            out[name].append(judge(axes.xyz(t) - true, fresh, mislabelled))
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
