"""Is one of the markers not where the map has it? Residual means, solution separation, markers left without a label.

Rules
-----
* The bias of a marker is judged by its deleted residual (``integrity_leave_out``), averaged over ``QUICK_S`` and over
  the window, in metres across the line of sight. Noise averages out, calibration, light and survey do not.
* A mean beyond its threshold is a fault of the marker without which chi2, with the weights of the pose, falls most: one
  false marker makes the residuals of the others large too (data snooping, Baarda 1968).
* What the bias may be is remembered: while few markers are seen, what many have shown of a marker still holds, and
  grows by ``GROWTH_M_S``. A light does not move; its label can, which shows in a jump.
* A marker inside the picture that has no label for long while ``ENOUGH`` others have is no fault: boom, light and the
  picture's edge do that. With a detection beside its place all that while, always as far off, it is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config import IntegrityConfig, VisionConfig
from companion.estimation.integrity_alarm import Alarm, faded
from companion.estimation.integrity_leave_out import LeftOut, Seen, covariance, leave_out, linearised, moves
from companion.geometry import SE3, Mat, Vec
from companion.messages import NS, VisionOutput

QUICK_S = 0.25
CONFIRM_S, CLEAR_S = 0.3, 2.0
"""How long a mean is beyond its threshold before it is a fault, and within it before it is none."""
UNTOLD_M = 100.0
"""Standard deviation of the bias of a marker of which nothing has been seen."""
GROWTH_M_S = 0.005
ENOUGH = 4
BESIDE_M = 1.0
"""How far off a marker's place, in metres across the line of sight, its light may be looked for."""
BESIDE_S = 2.0
STEADY_M = 0.10
"""Root mean square scatter of a light that is the marker's, as seen against the pose."""
PRESENT = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """What is needed of the camera: focal length, size of the picture, place on the receiver, and its lens.

    ``project(T_cam_tanker, points (n, 3))`` gives pixels (n, 2), NaN where it cannot see; ``rays(pixels (n, 2))`` gives
    undistorted coordinates on z = 1.
    """

    focal_px: float
    size_px: tuple[int, int]
    T_frd_cam: SE3
    project: Callable[[SE3, Mat], Mat]
    rays: Callable[[Mat], Mat]


@dataclass(frozen=True, slots=True, eq=False)
class Separations:
    """Per hypothesis h: what the camera's place may be off by if it is true (h, 3), camera axes, and covariances.

    ``cov`` (h, 3, 3) of that; ``common`` (3, 3) of what calibration, light and survey do to the place meanwhile.
    """

    off_m: Mat
    cov: NDArray[np.float64]
    common: Mat


class MarkerTest:
    """Keeps what is known of each marker of a map (n, 3) with ``ids``."""

    def __init__(
        self, config: IntegrityConfig, eye: Eye, vision: VisionConfig, markers: Mat, ids: tuple[int, ...]
    ) -> None:
        self._config, self._eye, self._vision = config, eye, vision
        self._markers, self._ids = markers, ids
        self._focal_px = eye.focal_px
        self._threshold = -2.0 * math.log(config.false_alarm / max(len(ids), 1))  # chi-square, two degrees of freedom
        self._size = np.array(eye.size_px)
        self.restart()

    def restart(self) -> None:
        """Forget every frame."""
        n = len(self._ids)
        self._means = {tau: _Means(n, tau) for tau in (QUICK_S, self._config.window_s)}
        self._alarms = [Alarm(CONFIRM_S, CLEAR_S) for _ in self._ids]
        self._bias_m, self._sigma_m = np.zeros((n, 2)), np.full(n, UNTOLD_M)
        self._t_ns: int | None = None
        self._beside = _Beside(n)
        self.separations: Separations | None = None
        self.separations_turning: Separations | None = None
        self.noise_share = 1.0

    @property
    def faults(self) -> tuple[str, ...]:
        """Return the markers that are wrong."""
        beside = self._beside.alarms
        return tuple(f"marker {self._ids[i]}" for i, a in enumerate(self._alarms) if a.raised or beside[i].raised)

    def see(self, seen: VisionOutput, T_cam_tanker: SE3, prior_information: Mat) -> None:
        """Take a frame at a pose; ``prior_information`` (6, 6) of the pose from elsewhere, used with few markers."""
        gap_s = 0.0 if self._t_ns is None else max((seen.t_ns - self._t_ns) * NS, 0.0)
        self._t_ns = seen.t_ns
        self._sigma_m = np.minimum(self._sigma_m + GROWTH_M_S * gap_s, UNTOLD_M)
        which = np.flatnonzero(seen.labels >= 0)
        frame = self._frame(seen, which, T_cam_tanker)
        P = None if frame is None else self._covariance(seen, frame, prior_information)
        if frame is None or P is None:
            self.separations = self.separations_turning = None
            return
        left_out = leave_out(frame, P)
        lasting, passing = self._variances(seen, frame)
        self._judge(seen.t_ns, frame, left_out, lasting, passing)
        self.noise_share = float(np.mean(lasting / frame.variance))
        self.separations = self._separate(T_cam_tanker, frame, left_out, lasting, turns=False)
        self.separations_turning = self._separate(T_cam_tanker, frame, left_out, lasting, turns=True)
        if len(which) >= ENOUGH:
            self._look_beside(seen, T_cam_tanker)

    def _frame(self, seen: VisionOutput, which: NDArray[np.int64], T_cam_tanker: SE3) -> Seen | None:
        if len(which) == 0:
            return None
        at = seen.labels[which]
        uv = self._eye.rays(seen.detections.uv_px[at])
        variance = (np.hypot(seen.detections.sigma_px[at], self._vision.sigma_px) / self._focal_px) ** 2
        return linearised(which, self._markers[which], uv, variance, T_cam_tanker)

    def _covariance(self, seen: VisionOutput, frame: Seen, prior_information: Mat) -> Mat | None:
        """Return the covariance of the pose: from the markers alone while they are many, as the vision solves it."""
        if seen.pose is not None and len(frame.which) >= self._vision.min_markers:
            return seen.pose.cov
        return covariance(frame, prior_information)

    def _variances(self, seen: VisionOutput, frame: Seen) -> tuple[Vec, Vec]:
        """Return variances (k,) on z = 1 of what lasts (calibration, survey, a light half hidden) and what passes."""
        at = seen.labels[frame.which]
        sigma = seen.detections.sigma_px[at] / self._focal_px
        odd = seen.detections.flags[at] != 0
        lasting = (self._config.sigma_px / self._focal_px) ** 2 + (self._config.map_sigma_m / frame.depth_m) ** 2
        return lasting + np.where(odd, sigma**2, 0.0), np.where(odd, 0.0, sigma**2)

    def _judge(self, t_ns: int, frame: Seen, left_out: LeftOut, lasting: Vec, passing: Vec) -> None:
        """Take the deleted residuals into the means, and hold these to their thresholds."""
        k = left_out.tested
        which, depth_m, spread = frame.which[k], frame.depth_m[k], left_out.spread[k]
        beyond, fall = np.zeros(len(self._ids)), np.zeros(len(self._ids))
        for means in self._means.values():
            means.add(t_ns, which, left_out.deleted[k] * depth_m[:, None])
            squared = over_spread(means.mean[which], spread) / depth_m**2
            variance = lasting[k] + passing[k] / means.count[which]
            beyond[which] = np.maximum(beyond[which], squared / variance)
            fall[which] = np.maximum(fall[which], squared / frame.variance[k])
        worst = int(np.argmax(fall))
        fails = (beyond > self._threshold).tolist()
        for i, alarm in enumerate(self._alarms):
            alarm.update(t_ns, fails=(i == worst and any(fails)) or (alarm.raised and fails[i]))
        quick = self._means[QUICK_S]
        self._remember(which, quick.mean[which],
                       np.sqrt(widest(spread) * (lasting[k] + passing[k] / quick.count[which])) * depth_m)

    def _remember(self, which: NDArray[np.int64], bias_m: Mat, sigma_m: Vec) -> None:
        """Keep what is told of biases (k, 2) where it is better than what is known."""
        better = sigma_m <= self._sigma_m[which]
        self._bias_m[which[better]] = bias_m[better]
        self._sigma_m[which[better]] = sigma_m[better]

    def _separate(self, T: SE3, frame: Seen, left_out: LeftOut, lasting: Vec, *, turns: bool) -> Separations:
        S = moves(T.t, left_out.sensitivity, turns=turns) / frame.depth_m[:, None, None]  # per metre of bias
        bias_m, sigma_m = self._bias_m[frame.which], self._sigma_m[frame.which]
        SS = S @ S.transpose(0, 2, 1)
        off_m = (S @ bias_m[:, :, None])[:, :, 0]
        common = (SS * (lasting * frame.depth_m**2)[:, None, None]).sum(axis=0)
        return Separations(off_m, SS * (sigma_m**2)[:, None, None], common)

    def _look_beside(self, seen: VisionOutput, T: SE3) -> None:
        """Look for lights beside the places of markers that have no label."""
        bare = np.flatnonzero(seen.labels < 0)
        places = self._eye.project(T, self._markers[bare])
        depth_m = T.transform(self._markers[bare])[:, 2]
        rest = np.delete(seen.detections.uv_px, seen.labels[seen.labels >= 0], axis=0)
        inside = ((places > -0.5) & (places < self._size - 0.5)).all(axis=1)
        found = np.full((len(bare), 2), np.nan)
        if len(rest) and len(bare):
            off = (rest[None] - places[:, None]) * (depth_m / self._focal_px)[:, None, None]
            squared = np.where(np.isfinite(off).all(axis=2), (off**2).sum(axis=2), np.inf)
            nearest = squared.argmin(axis=1)
            near = squared[np.arange(len(bare)), nearest] < BESIDE_M**2
            found[near] = off[near, nearest[near]]
        self._beside.take(seen.t_ns, bare[inside], found[inside])


def over_spread(b: Mat, spread: NDArray[np.float64]) -> Vec:
    """Return b^T spread^-1 b for vectors b (k, 2) and matrices (k, 2, 2)."""
    p, q, r = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    u, v = b[:, 0], b[:, 1]
    return np.asarray((r * u * u - 2.0 * q * u * v + p * v * v) / (p * r - q * q))


def widest(spread: NDArray[np.float64]) -> Vec:
    """Return the larger eigenvalue of symmetric matrices (k, 2, 2)."""
    p, q, r = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    return np.asarray(0.5 * (p + r) + np.hypot(0.5 * (p - r), q))


class _Means:
    """Running means of the markers' deleted residuals (n, 2), each with its own count."""

    def __init__(self, n: int, tau_s: float) -> None:
        self._tau_s = tau_s
        self.mean, self.count = np.zeros((n, 2)), np.zeros(n)
        self._t_ns = np.zeros(n, dtype=np.int64)

    def add(self, t_ns: int, which: NDArray[np.int64], samples: Mat) -> None:
        gap_s = (t_ns - self._t_ns[which]) * NS
        kept = np.where(gap_s > 3.0 * self._tau_s, 0.0, np.exp(-np.maximum(gap_s, 0.0) / self._tau_s))
        count = self.count[which] * kept + 1.0
        self.mean[which] += (samples - self.mean[which]) / count[:, None]
        self.count[which], self._t_ns[which] = count, t_ns


class _Beside:
    """Lights beside markers without a label: how often there is one, where, and how steadily."""

    def __init__(self, n: int) -> None:
        self.alarms = [Alarm(BESIDE_S, CLEAR_S) for _ in range(n)]
        self._present, self._count = np.zeros(n), np.zeros(n)
        self._mean, self._square = np.zeros((n, 2)), np.zeros(n)
        self._t_ns = np.zeros(n, dtype=np.int64)

    def take(self, t_ns: int, which: NDArray[np.int64], found: Mat) -> None:
        """Take offsets (k, 2) in m of lights beside the markers ``which``, NaN where there is none."""
        for i, off in zip(which.tolist(), found, strict=True):
            self._count[i], share = faded((t_ns - int(self._t_ns[i])) * NS, BESIDE_S, float(self._count[i]))
            self._t_ns[i] = t_ns
            there = bool(np.isfinite(off[0]))
            self._present[i] = there if share == 1.0 else self._present[i] + share * (there - self._present[i])
            if there:
                change = off - self._mean[i]
                self._mean[i] += change if share == 1.0 else share * change
                self._square[i] = 0.0 if share == 1.0 else self._square[i] + share * (change @ change - self._square[i])
        without = set(which.tolist())
        for i, alarm in enumerate(self.alarms):
            steady = self._present[i] > PRESENT and self._square[i] < STEADY_M**2
            alarm.update(t_ns, fails=i in without and bool(steady))
