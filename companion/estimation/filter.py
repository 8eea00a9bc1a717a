"""The filter of relative position, velocity and attitude, beside the thesis' blend (3.2).

Rules
-----
* Between measurements the two INS carry the estimate: the difference of their integrated velocities is the relative
  motion, and the filter estimates what has to be added to it (``filter_state``).
* Measurements are the difference of the two GPS positions (one in ``GPS_PERIOD_S``: positions that come oftener are
  dead reckoned from the same fix), and labelled markers, one by one, as pixels. Each is taken at its instant, in the
  order of instants (``filter_history``), if it fits (``filter_steps``).
* A receiver's GPS without a fix is not used, nor are positions that were refused and carried on by velocities.
* When the labeling has no labels but the filter knows where the markers are, it tells them apart itself
  (``filter_association``).
* The estimate is as old as the newest that it rests on: positions while GPS is taken, else the last sight.

Error-state filters, and measurements out of order by going back: Maybeck, Stochastic Models, Estimation and Control 1,
1979, ch. 6; Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from companion.config import CameraConfig, FusionConfig
from companion.estimation.aircraft import Aircraft, Aligned
from companion.estimation.filter_history import FilterHistory
from companion.estimation.filter_measurements import FrameReader, Measurement, geometry_of, gps_difference
from companion.estimation.filter_noise import OWN, TANKER, TRAVEL, InsNoise, ages_of
from companion.estimation.filter_state import BORESIGHT, THETA, Estimate, P, V
from companion.estimation.filter_steps import Steps
from companion.estimation.fusion import Prior, Relative
from companion.geometry import SE3, Mat, Vec, exp_so3
from companion.messages import NS, FilterState, FilterUpdate, FusedPose, Output, VisionOutput

GPS_PERIOD_S = 0.1
"""Two positions so far apart rest on two fixes."""

GPS_CARRIES_S = 0.5
"""The estimate rests on GPS for so long after the last difference of positions that was taken."""

TRACKED_M = 0.3
"""Standard deviation of the position in space below which few labels are enough."""


class RelativeFilter:
    """Reads an ``Aircraft`` and vision (``fusion.Fusion``). No clock.

    ``markers`` (n, 3), m, tanker axes, in the order of the labels; ``to_plane`` brings pixels (k, 2) to z = 1.
    ``ids`` (n,) name the markers in updates, their rows without.
    """

    def __init__(
        self, config: FusionConfig, aircraft: Aircraft, camera: CameraConfig, markers: Mat,
        to_plane: Callable[[Mat], Mat], ids: tuple[int, ...] = (),
    ) -> None:
        self._config, self._aircraft = config, aircraft
        self._reader = FrameReader(config.filter, camera, markers, to_plane)
        self._steps = Steps(config.filter, markers, ids)
        c = config.filter
        self._noise = InsNoise(c)
        self._gps_alone_m2 = 3.0 * c.gps_bias_sigma_m**2
        self.restart()

    def restart(self) -> None:
        """Forget everything: time has stepped."""
        self._history = FilterHistory(self._steps, self._config.filter.horizon_s)
        self._gps_taken_ns: int | None = None

    def shift(self, step_ns: int) -> None:
        """Move all instants: our clock has stepped, and the samples with it."""
        self._history.shift(step_ns)
        self._gps_taken_ns = None if self._gps_taken_ns is None else self._gps_taken_ns + step_ns

    @property
    def sight_ns(self) -> int | None:
        """Return the exposure of the newest frame from which a marker was taken."""
        newest = self._history.newest
        return None if newest is None else newest.sight_ns

    def positions(self) -> list[Output]:
        """Take the difference of positions at the instant of the tanker's newest state, if it rests on other fixes."""
        t_ns, aircraft = self._aircraft.tanker_ns, self._aircraft
        if t_ns is None or (self._gps_taken_ns is not None and (t_ns - self._gps_taken_ns) * NS < GPS_PERIOD_S):
            return []
        if aircraft.without_fix(t_ns):
            return []
        a = aircraft.align(t_ns)
        if a is None or a.carried:
            return []
        self._gps_taken_ns = t_ns
        return self._take(gps_difference(a, self._noise.gaps(a)))

    def _take(self, m: Measurement) -> list[Output]:
        outcome = self._history.take(m)
        if isinstance(outcome, str):
            return [FilterUpdate(m.t_ns, "pixels" if m.order[1] else "gps", 0.0, 0, outcome)]
        return list(outcome.updates)

    def vision(self, seen: VisionOutput) -> list[Output]:
        """Take what was seen in one frame, labelled or not, at its exposure."""
        a = self._aircraft.align(seen.t_ns)
        if a is None:
            return []
        noise = self._noise.table(a, ages_of(self._aircraft, seen.t_ns))
        geometry = geometry_of(a, self._aircraft.T_frd_cam, noise, self._noise.gaps(a))
        updates = self._take(self._reader.read(seen, geometry))
        e = self._history.before(seen.t_ns)
        T_gps = self._aircraft.T_cam_tanker(a, a.p_ned_gps_m)
        if e is None or not e.ready:
            return [*updates, FusedPose(seen.t_ns, T_gps, T_gps, 0.0, 0)]
        x, cov = self._steps.carried(e, seen.t_ns, self._noise.gaps(a))
        used = e.markers_used if e.sight_ns == seen.t_ns else 0
        fused = FusedPose(seen.t_ns, self._pose(a, x), T_gps, self._vision_weight(cov), used)
        return [*updates, fused, FilterState(seen.t_ns, x, np.sqrt(np.diag(cov)), cov)]

    def _vision_weight(self, cov: Mat) -> float:
        """Return by which share the position's variance is below that of two GPS alone."""
        return max(0.0, 1.0 - float(cov[0, 0] + cov[1, 1] + cov[2, 2]) / self._gps_alone_m2)

    def _T_frd_cam(self, x: Vec) -> SE3:
        nominal = self._aircraft.T_frd_cam
        return SE3(nominal.R @ exp_so3(x[BORESIGHT]), nominal.t)

    def _pose(self, a: Aligned, x: Vec) -> SE3:
        """Return ``T_cam_tanker`` of a state."""
        T_frd_cam = self._T_frd_cam(x)
        T_ned_cam = SE3(a.own_attitude.R_ned_body, a.travel_difference_m + x[P]) @ T_frd_cam
        return T_ned_cam.inverse() @ SE3(exp_so3(x[THETA]) @ a.tanker_attitude.R_ned_body, np.zeros(3))

    def prior(self, t_ns: int) -> Prior | None:
        """Return what is known of the tanker's pose at an exposure; before the start what GPS says."""
        a = self._aircraft.align(t_ns)
        if a is None:
            return None
        e = self._history.before(t_ns)
        if e is None or not e.ready:
            return Prior(self._aircraft.T_cam_tanker(a, a.p_ned_gps_m), tracked=False)
        x, cov = self._steps.carried(e, t_ns, self._noise.gaps(a))
        seen_s = np.inf if e.sight_ns is None else (t_ns - e.sight_ns) * NS
        sure = float(cov[0, 0] + cov[1, 1] + cov[2, 2]) <= TRACKED_M**2
        return Prior(self._pose(a, x), sure and seen_s <= self._config.filter.sight_lasts_s)

    def at(self, t_ns: int) -> Relative | None:
        """Return the estimate at an instant; None before the start and when a source is missing or stale."""
        a = self._aircraft.align(t_ns)
        e = self._history.before(t_ns)
        if a is None or e is None or not e.ready:
            return None
        x, cov = self._steps.carried(e, t_ns, self._noise.gaps(a))
        return Relative(
            aligned=a,
            p_ned_m=a.travel_difference_m + x[P],
            dv_ned_m_s=x[V],
            R_correction=exp_so3(x[THETA]),
            T_frd_cam=self._T_frd_cam(x),
            cov=self._told_cov(a, cov, np.inf if e.sight_ns is None else (t_ns - e.sight_ns) * NS),
            estimate_ns=self._estimate_ns(e, t_ns),
            sight_ns=e.sight_ns,
            vision_weight=self._vision_weight(cov),
            markers_used=e.markers_used,
        )

    def _told_cov(self, a: Aligned, cov: Mat, since_sight_s: float) -> Mat:
        """Return the covariance (12, 12) of ``Relative``: the state's, and the noise of what is told now."""
        ages = ages_of(self._aircraft, a.t_ns)
        noise, out = self._noise.table(a, ages), np.zeros((12, 12))
        out[:9, :9] = cov[:9, :9]
        out[P, P] += noise[TRAVEL]
        out[V, V] += self._noise.velocity(a, ages)
        out[THETA, THETA] += noise[OWN] + noise[TANKER]
        out[9:, 9:] = noise[OWN]
        out[THETA, 9:] = out[9:, THETA] = -noise[OWN]  # the receiver's noise turns the tanker against it
        of_tanker = self._noise.with_travel(a, ages.tanker_s, since_sight_s)
        of_own = -self._noise.with_travel(a, ages.position_s, since_sight_s)
        out[P, THETA] += of_tanker - of_own
        out[THETA, P] = out[P, THETA].T
        out[P, 9:], out[9:, P] = of_own, of_own.T
        return out

    def _estimate_ns(self, e: Estimate, t_ns: int) -> int:
        """Return how old the estimate is: INS samples, and GPS while it is taken, else the last sight."""
        oldest_ns = self._aircraft.oldest_ns()
        by_gps = e.gps_ns is not None and (t_ns - e.gps_ns) * NS <= GPS_CARRIES_S
        if by_gps:
            return oldest_ns
        return min(oldest_ns, max(e.sight_ns or 0, e.gps_ns or 0))
