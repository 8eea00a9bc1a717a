"""The thesis' fusion of GPS and machine vision (section 3.2, eq. 3.9, Fig. 3.5 to 3.7).

Rules
-----
* Angles come from the two INUs, always. Vision corrects the translation only.
* ``t = w t_gps + (1 - w) t_mv`` with ``w = (d - d2) / (d1 - d2)`` clipped to 0..1 and d the distance camera to tanker:
  all GPS at d1 and beyond, all vision at d2 and nearer (the text prints the interval the wrong way round).
* Vision counts with at least ``min_markers`` markers (five in the thesis). Without it the last blend is carried on by
  the inertial velocities for ``vision_stale_s``; after that GPS alone is left.
* The blend, carried to the next exposure, is the next frame's prior (predicted markers, start rotation).
* Both aircraft are brought to the instant of the exposure first (``aircraft``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.config import FusionConfig
from companion.estimation.aircraft import Aircraft, Aligned
from companion.estimation.fusion import Prior, Relative
from companion.geometry import SE3, Mat, Vec
from companion.messages import NS, FusedPose, Output, VisionOutput


def nominal_cov(p_m: float, v_m_s: float, angle_rad: float) -> Mat:
    """Return a covariance (12, 12) of ``Relative`` with these sigmas per axis, none for the receiver's INS."""
    return np.diag(np.repeat([p_m, v_m_s, angle_rad, 0.0], 3) ** 2)


BY_VISION = nominal_cov(0.05, 0.06, 0.001)
BY_GPS = nominal_cov(0.92, 0.06, 0.001)
"""The blend knows no covariance: what a pose and a difference of two GPS are good for, said once and for all. The noise
of two GPS, 0.15 m, and what they err against each other for minutes, 0.9 m (``IntegrityConfig.gps_own_m``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Relative position at the instant of the last blend, and what is needed to carry it on."""

    t_ns: int
    p_ned_tanker_frd_m: Vec  # from the tanker's to the receiver's centre of mass, in ned axes
    travel_difference_m: Vec
    vision_weight: float
    markers_used: int


class Blend:
    """Keeps the last blend (``fusion.Fusion``). No clock."""

    def __init__(self, config: FusionConfig, aircraft: Aircraft) -> None:
        self._config = config
        self._aircraft = aircraft
        self._anchor: Anchor | None = None

    @property
    def sight_ns(self) -> int | None:
        """Return the exposure of the last blend that vision was in."""
        return None if self._anchor is None else self._anchor.t_ns

    def restart(self) -> None:
        """Forget the last blend."""
        self._anchor = None

    def shift(self, step_ns: int) -> None:
        """Move the last blend in time."""
        if self._anchor is not None:
            self._anchor = replace(self._anchor, t_ns=self._anchor.t_ns + step_ns)

    def positions(self) -> list[Output]:
        """Nothing to do: positions are read where they are needed."""
        return []

    def relative_position(self, a: Aligned) -> tuple[Vec, Anchor | None]:
        """Return the best relative position of the centres of mass (3,) in ned and the anchor that it rests on.

        The anchor is the last blend while it is fresh enough, None when the position is GPS alone.
        """
        anchor = self._anchor
        if anchor is None or (a.t_ns - anchor.t_ns) * NS > self._config.vision_stale_s:
            return a.p_ned_gps_m, None
        return anchor.p_ned_tanker_frd_m + (a.travel_difference_m - anchor.travel_difference_m), anchor

    def prior(self, t_ns: int) -> Prior | None:
        """Return the predicted ``T_cam_tanker`` at an exposure: the last blend carried on, or GPS."""
        a = self._aircraft.align(t_ns)
        if a is None:
            return None
        p_ned, anchor = self.relative_position(a)
        tracked = anchor is not None and anchor.vision_weight >= 0.5  # more vision than GPS
        return Prior(self._aircraft.T_cam_tanker(a, p_ned), tracked)

    def vision(self, seen: VisionOutput) -> list[Output]:
        """Blend at the instant of an exposure (eq. 3.9); nothing when the aircraft cannot be aligned at it.

        Without a valid pose the anchor stays what it was, so the last blend is carried on until it is stale.
        """
        pose, aircraft = seen.pose, self._aircraft
        a = aircraft.align(seen.t_ns)
        if a is None:
            return []
        T_gps = aircraft.T_cam_tanker(a, a.p_ned_gps_m)
        if pose is None or pose.markers_used < self._config.min_markers:
            p_ned, anchor = self.relative_position(a)
            weight = 0.0 if anchor is None else anchor.vision_weight
            return [FusedPose(seen.t_ns, aircraft.T_cam_tanker(a, p_ned), T_gps, weight, 0)]
        w_gps = self.gps_weight(float(np.sqrt(T_gps.t @ T_gps.t)))
        t_blend = w_gps * T_gps.t + (1.0 - w_gps) * pose.T_cam_tanker.t
        p_ned = a.own_attitude.R_ned_body @ (-aircraft.T_frd_cam.transform(t_blend))
        self._anchor = Anchor(seen.t_ns, p_ned, a.travel_difference_m, 1.0 - w_gps, pose.markers_used)
        return [FusedPose(seen.t_ns, SE3(T_gps.R, t_blend), T_gps, 1.0 - w_gps, pose.markers_used)]

    def gps_weight(self, distance_m: float) -> float:
        """Return the weight of GPS at a distance (eq. 3.9)."""
        d1, d2 = self._config.d1_m, self._config.d2_m
        return min(1.0, max(0.0, (distance_m - d2) / (d1 - d2)))

    def at(self, t_ns: int) -> Relative | None:
        """Return the blend, carried to an instant; None when a source is missing or stale."""
        a = self._aircraft.align(t_ns)
        if a is None:
            return None
        p_ned, anchor = self.relative_position(a)
        aircraft = self._aircraft
        oldest_ns = aircraft.oldest_fix_ns() if anchor is None else min(aircraft.oldest_ns(), anchor.t_ns)
        weight = 0.0 if anchor is None else anchor.vision_weight
        return Relative(
            aligned=a,
            p_ned_m=p_ned,
            dv_ned_m_s=np.zeros(3),
            R_correction=np.eye(3),
            T_frd_cam=self._aircraft.T_frd_cam,
            cov=weight * BY_VISION + (1.0 - weight) * BY_GPS,
            estimate_ns=oldest_ns,
            sight_ns=self.sight_ns,
            vision_weight=weight,
            markers_used=0 if anchor is None else anchor.markers_used,
        )
