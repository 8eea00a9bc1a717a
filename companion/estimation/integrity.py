"""Integrity: how far the estimate can be trusted, and whether it is good enough to dock.

Rules
-----
* Protection by multiple hypothesis solution separation, as ARAIM does it for satellites (Blanch et al. 2012; Pervan,
  Pullen, Christie 1998; Brown 1996), over the markers of the map and over the sources. Per axis q of ``mrf``, with
  sigma_q of the estimate's covariance and of what calibration, light and survey do beside it::

      PL = max( K_free sigma_q,  max over hypotheses h of |d_hq| + K_fault sqrt(sigma_q^2 + sigma_hq^2) )

  d_h is how far the estimate lies from the one that h leaves untouched, sigma_h the standard deviation of d_h. The
  hypotheses: each labelled marker is wrong, twice, with the camera oriented by the INS and by the picture
  (``integrity_markers``); everything is but the vision of the moment, with attitudes of the INS; everything but the
  vision with its own (the camera's mount, an attitude). What GPS says otherwise is added, by the share that it has.
* Budget: half of ``risk`` without a fault, two-sided: Q(K_free) = risk / 4. The other half over n hypotheses, each with
  ``fault_probability`` p: Q(K_fault) = risk / (4 n p). With 1e-7, 1e-3, 20 hypotheses K is 5.45 and 4.71.
* False alarms: ``false_alarm`` per test. Markers: chi-square of two degrees of freedom, shared among them; sources:
  normal. Means, not frames, are tested, and a test must fail for a while (``integrity_alarm``).
* The alert limit is the desired window of thesis Tab. 1.1, wider by ``alert_growth`` metres for each metre from the
  box, as landing systems grow theirs along the approach. Once |BR| + PL has been within the limit window it must
  stay so.
* What can be wrong this very moment is among the hypotheses (``integrity_moment``): the difference to the last frames,
  and what nothing has judged since the newest.
* ``may_dock``: seen at most ``stale_s`` ago, every source fresh, the newest frame taken and some before it, no fault,
  protection within the alert limit. Nothing seen is no fault: protection is then ``UNKNOWN_M``, ``unseen`` among the
  notes. Markers that simulated vision projects, without noise, from what GPS says, are not seen. Notes never take
  ``may_dock`` away but ``unseen``, ``stale <source>`` and ``unsettled``.

==================== ==================================================================================================
fault                meaning
==================== ==================================================================================================
``marker <id>``      a marker is not where the map has it, or what is taken for it is another light
``boresight``        the camera is not mounted as the configuration says, or the attitudes of the INS do not fit
``attitude``         an attitude has left the vision's within seconds
``height_datum``     heights of the two aircraft differ from what the vision sees: another datum or pressure setting
``gps_vision``       positions across do; ``gps`` as a note after they had agreed
``residual``         the markers fit no pose for half of the last frames
``innovation <s>``   measurements of source s are not what the filter foretells; a note for GPS and single markers
==================== ==================================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from companion.config import CornerPointConfig, IntegrityConfig, VisionConfig, WindowConfig
from companion.config.structures import MarkerConfig
from companion.estimation.integrity_alarm import Alarm, RunningMean
from companion.estimation.integrity_markers import Eye, MarkerTest, Separations
from companion.estimation.integrity_moment import Moment, moved_m, unjudged_m
from companion.estimation.integrity_sources import AttitudeTest, GpsTest, InnovationTest
from companion.geometry import Mat, Vec, rotation_from_euler
from companion.messages import (
    NS,
    FilterState,
    FilterUpdate,
    FusedPose,
    Integrity,
    Output,
    RelativeState,
    Sources,
    VisionOutput,
)

UNKNOWN_M = 1e3
SOURCES = 2
"""Hypotheses beside those of the markers."""
ENTERED_M = 0.5
"""Within the limit window by so much, protection included, the receiver has entered it: less is the edge's flicker."""
LEFT_M, LEFT_S = 1.0, 3.0
"""Beyond the limit window by so much, or for so long, the receiver has left it and need not be within it."""
COAST_M, COAST_M_S = 0.03, 0.05
"""What the filter still knows of the place with few markers: to COAST_M, and so much worse for each second since many
were seen; INS velocities are that good, and the marker that is wrong had no part in them."""
FEW_S = 10.0
RESIDUAL_S = 1.0


class IntegrityMonitor:
    """Sees what pipeline stages put out; says how far the estimate can be trusted. No clock."""

    def __init__(
        self, config: IntegrityConfig, window: WindowConfig, eye: Eye,
        markers: Sequence[MarkerConfig | CornerPointConfig], vision: VisionConfig,
    ) -> None:
        """``markers``: what the vision looks for (``companion.config.landmarks``), in the order of its labels."""
        self._config, self._vision = config, vision
        self._desired_m, self._limit_m = np.array(window.desired_m), np.array(window.limit_m)
        self._R_frd_cam = eye.T_frd_cam.R
        places = np.array([m.p_tanker_m for m in markers], dtype=np.float64).reshape(-1, 3)
        share = 4.0 * (2 * len(places) + SOURCES) * config.fault_probability
        self._k_free = float(-ndtri(config.risk / 4.0))
        self._k_fault = float(-ndtri(config.risk / share))
        sigmas = float(-ndtri(config.false_alarm / 6.0))  # three axes, two sides
        self._markers = MarkerTest(config, eye, vision, places, tuple(m.id for m in markers))
        self._gps = GpsTest(config, sigmas)
        self._attitude = AttitudeTest(config, sigmas)
        self._innovation = InnovationTest(config)
        self._moment = Moment(config.stale_s)
        self.restart()

    def restart(self) -> None:
        """Forget everything: time has stepped."""
        for test in (self._markers, self._gps, self._attitude, self._innovation, self._moment):
            test.restart()
        self._seen: VisionOutput | None = None
        self._sight_ns: int | None = None
        self._imagined_ns: int | None = None
        self._filtered = self._entered = False
        self._inside_ns = 0
        self._hypotheses: Separations | None = None
        self._many_ns: int | None = None
        self._misfits = RunningMean(1, RESIDUAL_S)
        self._residual = Alarm(RESIDUAL_S, RESIDUAL_S)
        self._sigma_attitude_rad = self._vision.ins_sigma_rad

    def see(self, output: Output) -> None:
        """Take an output of vision or fusion, in the order in which the pipeline makes them."""
        if isinstance(output, VisionOutput):
            self._vision_output(output)
        elif isinstance(output, FusedPose):
            self._fused(output)
        elif isinstance(output, FilterUpdate):
            self._innovation.see(output)
            self._moment.update(output)
        elif isinstance(output, FilterState):
            self._filtered = True
            self._sigma_attitude_rad = float(np.sqrt(output.sigma[6:9].max() ** 2 + output.sigma[12:15].max() ** 2))

    def _vision_output(self, seen: VisionOutput) -> None:
        misfit = seen.reject is not None and seen.reject.reason == "residual"
        self._misfits.add(seen.t_ns, np.array([1.0 if misfit else 0.0]))
        self._residual.update(seen.t_ns, fails=bool(self._misfits.mean[0] > 0.5))
        self._seen = seen

    def _fused(self, fused: FusedPose) -> None:
        """Judge the frame that the fusion has just taken."""
        seen, self._seen = self._seen, None
        if seen is None or seen.t_ns != fused.t_ns:
            return
        if imagined(seen):
            self._imagined_ns = seen.t_ns
            return
        if fused.markers_used > 0:
            self._sight_ns = seen.t_ns
        pose = seen.pose
        T = fused.T_cam_tanker if pose is None else pose.T_cam_tanker
        many = int(np.count_nonzero(seen.labels >= 0)) >= self._vision.min_markers
        self._markers.see(seen, T, self._known_before(seen.t_ns))
        self._hypotheses = None
        self._moment.frame(pose if many else None, fused)
        if pose is not None and many:
            self._many_ns = seen.t_ns
            self._gps.see(pose, fused)
            self._attitude.see(pose, fused, self._markers.noise_share)

    def _known_before(self, t_ns: int) -> Mat:
        """Return the information (6, 6) of the pose from INS, and from the filter's memory, that few markers add to."""
        information = np.zeros(6)
        information[3:] = 1.0 / self._sigma_attitude_rad**2
        age_s = math.inf if self._many_ns is None else (t_ns - self._many_ns) * NS
        if self._filtered and age_s < FEW_S:
            information[:3] = 1.0 / (COAST_M + COAST_M_S * age_s) ** 2
        return np.diag(information)

    def at(self, state: RelativeState, sources: Sources) -> Integrity:
        """Return what protects the estimate at its instant."""
        if sources.sight_ns is not None and sources.sight_ns == self._imagined_ns:
            sources = replace(sources, sight_ns=self._sight_ns)
        R_ned_cam = state.R_ned_frd @ self._R_frd_cam
        faults, notes = self._gps.at(state.t_ns, R_ned_cam @ state.T_cam_tanker.R)
        more, more_notes = self._innovation.failing
        faults += self._markers.faults + self._attitude.faults + more
        faults += ("residual",) if self._residual.raised else ()
        R_mrf_ned = rotation_from_euler(state.heading0_rad, 0.0, 0.0).T
        doubts = self._moment.notes(state.t_ns, sources)
        protection_m = np.full(3, UNKNOWN_M)
        if "unseen" not in doubts:
            protection_m = self._protection(state, sources, R_mrf_ned, R_mrf_ned @ R_ned_cam)
        br_m = np.abs(state.p_mrf_br_m)
        alert_m = self._desired_m + self._config.alert_growth * math.sqrt(br_m @ br_m)
        within = bool((protection_m <= alert_m).all()) and self._stays(state.t_ns, br_m, protection_m)
        may_dock = within and not (doubts or faults)
        return Integrity(state.t_ns, protection_m, alert_m, may_dock, faults, notes + more_notes + doubts)

    def _stays(self, t_ns: int, br_m: Vec, protection_m: Vec) -> bool:
        """Tell whether a receiver that has been surely within the limit window still is."""
        far_m = float((br_m + protection_m - self._limit_m).max())
        if far_m <= 0.0:
            self._inside_ns = t_ns
            self._entered = self._entered or far_m <= -ENTERED_M
        elif (br_m > self._limit_m + LEFT_M).any() or (t_ns - self._inside_ns) * NS > LEFT_S:
            self._entered = False
        return far_m <= 0.0 or not self._entered

    def _protection(self, state: RelativeState, sources: Sources, R_mrf_ned: Mat, R_mrf_cam: Mat) -> Vec:
        """Return the protection levels (3,): without a fault, and the largest of all hypotheses."""
        if self._hypotheses is None:
            self._hypotheses = self._gather(state)
        h = self._hypotheses
        if h is None:
            return np.full(3, UNKNOWN_M)
        # The diagonals alone: of the estimate's covariance, and of h.cov (h, 3, 3) and h.common turned into mrf.
        variance = state.cov_mrf_br_m2.diagonal() + ((R_mrf_cam @ h.common) * R_mrf_cam).sum(axis=1)
        of_hypotheses = ((R_mrf_cam @ h.cov) * R_mrf_cam).sum(axis=2)
        d = np.abs(h.off_m @ R_mrf_cam.T) + self._k_fault * np.sqrt(variance + of_hypotheses)
        gps = np.abs(R_mrf_ned @ self._gps.off_ned_m) * (1.0 - state.vision_weight)
        free = self._k_free * np.sqrt(variance)
        now_m = np.maximum(self._moment.off_m(state.T_cam_tanker.t, R_mrf_cam), unjudged_m(state, sources, R_mrf_cam))
        now_m += self._k_fault * np.sqrt(variance)
        largest_m = np.maximum(np.maximum(free, now_m), d.max(axis=0)) + gps + moved_m(state.t_ns, sources)
        protection: Vec = np.minimum(largest_m, UNKNOWN_M)
        return protection

    def _gather(self, state: RelativeState) -> Separations | None:
        """Put all hypotheses of the last frame side by side; None when nothing could be told from it."""
        plain, turning = self._markers.separations, self._markers.separations_turning
        if plain is None or turning is None:
            return None
        away_m, cov_place = self._attitude.away(state.t_ns)
        turned_m, cov_turned = self._attitude.turned(state.t_ns, state.T_cam_tanker.t)
        off_m = [away_m + plain.off_m, away_m[None], turned_m[None]]
        covs = [plain.cov, cov_place[None], cov_turned[None]]
        common = plain.common
        if self._filtered:
            off_m.append(turned_m + turning.off_m)
            covs.append(turning.cov)
            common = turning.common if np.trace(turning.common) > np.trace(common) else common
        return Separations(np.vstack(off_m), np.concatenate(covs), common)


def imagined(seen: VisionOutput) -> bool:
    """Tell whether the labelled markers of a frame were projected, not seen: what is seen has noise."""
    at = seen.labels[seen.labels >= 0]
    return len(at) > 0 and not seen.detections.sigma_px[at].any()
