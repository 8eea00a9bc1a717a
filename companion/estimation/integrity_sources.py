"""Do the sources agree? GPS with vision, the camera's mount with the INS, the estimate with the vision of the moment,
and each measurement with what the filter foretells.

Rules
-----
* GPS against vision: the mean of their difference, in ``ned``. Two good GPS are off against each other by
  ``gps_own_m`` for minutes; errors that both share cancel. More than that, before the two have agreed for
  ``agreed_s``, is a fault: ``height_datum`` (down: QNH, geoid for ellipsoid) or ``gps_vision`` (across).
* Once they have agreed for that long, a difference is the GPS' fault, and no reason to stop: vision has redundancy
  that is tested in every frame, two GPS have none. It is told as the note ``gps``.
* The rotation of a pose against attitudes of the INS and nominal mount: its mean over the window is the mount's
  (``boresight``), also when a filter corrects it: a mount that has moved may move on. When the quick mean leaves that
  of the window, an attitude has gone (``attitude``). Only poses that found their own rotation count.
* Normalised innovations squared (Bar-Shalom, Li, Kirubarajan 2001, 5.4): a mean of ``TOO_LARGE`` times the degrees of
  freedom, or more than half of a source's measurements refused, is ``innovation <source>``. A note where something
  else judges: GPS, and single markers that the filter leaves out. A marker is only told of when it is left out: in
  every other frame of which some were taken it was not.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import IntegrityConfig
from companion.estimation.integrity_alarm import Alarm, RunningMean
from companion.geometry import IDENTITY, Mat, Vec, log_so3, skew
from companion.messages import NS, FilterUpdate, FusedPose, PoseMeasurement

QUICK_S = 0.25
SOURCE_ON_S, SOURCE_OFF_S = 1.0, 3.0
TURN_ON_S = 0.3
LATELY_S = 1.0
UNTOLD_RAD, DRIFT_RAD_S = 0.05, 5e-5
"""Standard deviation of the mount before any pose has found its own rotation, and what INS attitudes drift by."""
LEAST_S = 0.5
"""Means count from so much seen time on."""
LEAST_M = 1.5
"""Differences of GPS and vision below this are never a fault."""
MOST_M = 100.0
TOO_LARGE = 4.0
REFUSED = 0.5
LEAST_UPDATES = 10.0
REFUSALS = frozenset({"gate", "geometry", "wider", "position_anew", "bias_anew"})
"""Reasons of the filter that say that a measurement did not fit; others say that there was nothing to take."""
JUDGED_ELSEWHERE = ("gps", "marker")


class GpsTest:
    """GPS against vision."""

    def __init__(self, config: IntegrityConfig, sigmas: float) -> None:
        self._config = config
        self._limit = sigmas
        self.restart()

    def restart(self) -> None:
        """Forget every frame, and that the two have agreed."""
        self._difference = RunningMean(3, self._config.window_s)  # tanker axes: GPS less vision
        self._variance = RunningMean(3, self._config.window_s)
        self._began_ns: int | None = None
        self._judged_ns: int | None = None
        self._beyond = [False, False, False]
        self._agreed_s = 0.0
        self._t_ns: int | None = None
        self._height, self._across = Alarm(SOURCE_ON_S, SOURCE_OFF_S), Alarm(SOURCE_ON_S, SOURCE_OFF_S)
        self.off_ned_m: Vec = np.zeros(3)

    def see(self, pose: PoseMeasurement, fused: FusedPose) -> None:
        """Take a pose and what GPS says at the same instant."""
        R_tanker_cam = pose.T_cam_tanker.R.T
        if not self._difference.fresh(pose.t_ns, 3.0 * self._config.window_s):
            self._began_ns = pose.t_ns
        self._difference.add(pose.t_ns, R_tanker_cam @ (fused.T_cam_tanker_gps.t - pose.T_cam_tanker.t))
        self._variance.add(pose.t_ns, np.diag(R_tanker_cam @ pose.cov[:3, :3] @ R_tanker_cam.T))

    @property
    def agreed(self) -> bool:
        """Tell whether the two have agreed for long."""
        return self._agreed_s >= self._config.agreed_s

    def at(self, t_ns: int, R_ned_tanker: Mat) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return faults and notes at an instant."""
        passed_s = 0.0 if self._t_ns is None else max((t_ns - self._t_ns) * NS, 0.0)
        self._t_ns = t_ns
        known = self._difference.fresh(t_ns, 1.0) and self._seen_s(t_ns) >= LEAST_S
        if self._judged_ns != self._difference.t_ns:
            self._judge(R_ned_tanker)
        if not known:
            self.off_ned_m = np.zeros(3)
        north, east, down = self._beyond
        height = self._height.update(t_ns, fails=known and down)
        across = self._across.update(t_ns, fails=known and (north or east))
        if self.agreed:
            return (), ("gps",) if height or across else ()
        if known:
            self._agreed_s = 0.0 if north or east or down else self._agreed_s + min(passed_s, 0.1)
        return (("height_datum",) if height else ()) + (("gps_vision",) if across else ()), ()

    def _judge(self, R_ned_tanker: Mat) -> None:
        """Hold the mean difference to its limits, once for each new frame."""
        self._judged_ns = self._difference.t_ns
        self.off_ned_m = -(R_ned_tanker @ self._difference.mean)
        sigma = np.sqrt(self._config.gps_own_m**2 + R_ned_tanker**2 @ self._variance.mean)
        self._beyond = (np.abs(self.off_ned_m) > np.maximum(self._limit * sigma, LEAST_M)).tolist()

    def _seen_s(self, t_ns: int) -> float:
        return 0.0 if self._began_ns is None else (t_ns - self._began_ns) * NS


class AttitudeTest:
    """The vision's rotation against that of the two INS, and the vision's place against the estimate's."""

    def __init__(self, config: IntegrityConfig, sigmas: float) -> None:
        self._config = config
        self._limit = sigmas
        self.restart()

    def restart(self) -> None:
        """Forget every frame."""
        self._turn = RunningMean(3, self._config.window_s)  # camera axes, R_vision = exp(turn) R_ins
        self._quick = RunningMean(3, QUICK_S)
        self._left = RunningMean(3, QUICK_S)  # the same against the estimate
        self._away = RunningMean(3, QUICK_S)
        self._boresight, self._attitude = Alarm(TURN_ON_S, SOURCE_OFF_S), Alarm(TURN_ON_S, SOURCE_OFF_S)
        self._cov: Mat = np.diag([0.0] * 3 + [UNTOLD_RAD**2] * 3)

    @property
    def faults(self) -> tuple[str, ...]:
        """Return the tests that fail."""
        return (("boresight",) if self._boresight.raised else ()) + (("attitude",) if self._attitude.raised else ())

    def away(self, t_ns: int) -> tuple[Vec, Mat]:
        """Return the estimate's place less the vision's (3,), camera axes, and the covariance (3, 3) of the latter.

        The camera is oriented by the INS and the mount. Nothing, with no covariance, when there has been no pose lately
        that found its own rotation.
        """
        if not self._away.fresh(t_ns, LATELY_S):
            return np.zeros(3), np.zeros((3, 3))
        return -self._away.mean, self._cov[:3, :3]

    def turned(self, t_ns: int, t_cam_m: Vec) -> tuple[Vec, Mat]:
        """Return the same with the camera oriented by the vision's rotation (``integrity_leave_out.moves``).

        When there has been no such pose lately, what the last ones said of the mount, growing by ``DRIFT_RAD_S``.
        """
        lever = np.hstack((IDENTITY, skew(t_cam_m)))
        if self._away.fresh(t_ns, LATELY_S):
            return -self._away.mean - lever[:, 3:] @ self._left.mean, lever @ self._cov @ lever.T
        age_s = 0.0 if self._away.t_ns is None else (t_ns - self._away.t_ns) * NS
        cov = self._cov[3:, 3:] + (DRIFT_RAD_S * age_s) ** 2 * IDENTITY
        return -lever[:, 3:] @ self._left.mean, lever[:, 3:] @ cov @ lever[:, 3:].T

    def see(self, pose: PoseMeasurement, fused: FusedPose, noise_share: float) -> None:
        """Take a pose that found its own rotation; ``noise_share``: of its covariance, what does not average out."""
        turn = log_so3(pose.T_cam_tanker.R @ fused.T_cam_tanker_gps.R.T)
        self._left.add(pose.t_ns, log_so3(pose.T_cam_tanker.R @ fused.T_cam_tanker.R.T))
        cov = noise_share * pose.cov
        self._away.add(pose.t_ns, pose.T_cam_tanker.t - fused.T_cam_tanker.t)
        self._turn.add(pose.t_ns, turn)
        self._quick.add(pose.t_ns, turn)
        self._cov = cov
        sigma = np.sqrt(np.diag(cov)[3:])
        limit = np.maximum(self._config.boresight_rad, self._limit * sigma)
        off = np.abs(self._turn.mean)
        self._boresight.update(pose.t_ns, fails=bool((off > limit).any() and self._turn.count >= 3.0))
        left = np.abs(self._quick.mean - self._turn.mean)
        self._attitude.update(pose.t_ns, fails=bool((left > 0.5 * limit).any()))


class InnovationTest:
    """Windowed normalised innovations squared of each source."""

    def __init__(self, config: IntegrityConfig) -> None:
        self._config = config
        self.restart()

    def restart(self) -> None:
        """Forget every measurement."""
        self._means: dict[str, RunningMean] = {}
        self._alarms: dict[str, Alarm] = {}
        self._frame_ns: int | None = None

    def see(self, update: FilterUpdate) -> None:
        """Take one measurement."""
        refused = update.reason in REFUSALS
        if not refused and (update.reason or not math.isfinite(update.nis)):
            return
        if update.source == "pixels" and not refused:
            self._not_left_out(update.t_ns)
        taken = np.array([0.0, 0.0, 1.0]) if refused else np.array([update.nis, float(update.dof), 0.0])
        self._take(update.source, update.t_ns, taken)

    def _not_left_out(self, t_ns: int) -> None:
        """Tell the markers that were not left out of the last frame; those of this one are told after it."""
        frame_ns, self._frame_ns = self._frame_ns, t_ns
        if frame_ns is None:
            return
        for source, mean in self._means.items():
            if source.startswith("marker") and mean.t_ns is not None and mean.t_ns < frame_ns:
                self._take(source, frame_ns, np.zeros(3))

    def _take(self, source: str, t_ns: int, told: Vec) -> None:
        """Take what is told of a measurement: nis, degrees of freedom, 1 if it was refused."""
        mean = self._means.setdefault(source, RunningMean(3, self._config.window_s))
        alarm = self._alarms.setdefault(source, Alarm(SOURCE_ON_S, SOURCE_OFF_S))
        mean.add(t_ns, told)
        nis, dof, share = mean.mean.tolist()
        large = nis > TOO_LARGE * dof or share > REFUSED
        alarm.update(t_ns, fails=mean.count >= LEAST_UPDATES and large)

    @property
    def failing(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return faults and notes."""
        names = [source for source, alarm in self._alarms.items() if alarm.raised]
        faults = tuple(f"innovation {s}" for s in names if not s.startswith(JUDGED_ELSEWHERE))
        return faults, tuple(f"innovation {s}" for s in names if s.startswith(JUDGED_ELSEWHERE))
