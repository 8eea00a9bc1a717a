"""The thesis' fusion of GPS and machine vision (section 3.2, eq. 3.9, Fig. 3.5 to 3.7).

Rules
-----
* Angles come from the two INUs, always. Vision corrects the translation only.
* ``t = w t_gps + (1 - w) t_mv`` with ``w = (d - d2) / (d1 - d2)`` clipped to 0..1 and d the distance camera to tanker:
  all GPS at d1 and beyond, all vision at d2 and nearer (the text prints the interval the wrong way round).
* Vision counts with at least ``min_markers`` markers (five in the thesis). Without it the last blend is carried on by
  the inertial velocities for ``vision_stale_s``; after that GPS alone is left.
* The blend, carried to the next exposure, is the next frame's prior (predicted markers, start rotation).
* Both aircraft are brought to the instant of the exposure first (``alignment``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.config import FusionConfig
from companion.estimation.alignment import Attitude, AttitudeHistory, Motion, MotionHistory
from companion.geometry import SE3, Vec
from companion.messages import NS, FusedPose, OwnAttitude, OwnPosition, PoseMeasurement, Reject, TankerState


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Both aircraft at one instant."""

    t_ns: int
    own: Motion
    own_attitude: Attitude
    tanker: Motion
    tanker_attitude: Attitude


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Relative position at the instant of the last blend, and what is needed to carry it on."""

    t_ns: int
    p_ned_tanker_frd_m: Vec  # from the tanker's to the receiver's centre of mass, in ned axes
    travel_difference_m: Vec
    vision_weight: float
    markers_used: int


class Blend:
    """Keeps the histories of both aircraft and the last blend. Events in, poses out; no clock."""

    def __init__(self, config: FusionConfig, T_frd_cam: SE3) -> None:
        self._config = config
        self._T_frd_cam = T_frd_cam
        self._T_cam_frd = T_frd_cam.inverse()
        self.own_motion = MotionHistory()
        self.own_attitude = AttitudeHistory()
        self.tanker_motion = MotionHistory()
        self.tanker_attitude = AttitudeHistory()
        self._anchor: Anchor | None = None

    def own_attitude_event(self, m: OwnAttitude) -> Reject | None:
        """Take the receiver's attitude; a stamp that does not go forward is rejected."""
        if self.own_attitude.append(m.t_ns, m.R_ned_frd, m.omega_frd_rad_s):
            return None
        return Reject(m.t_ns, "attitude", "time_not_forward")

    def own_position_event(self, m: OwnPosition) -> Reject | None:
        """Take the receiver's position and velocity; a stamp that does not go forward is rejected."""
        if self.own_motion.append(m.t_ns, m.p_ned_m, m.v_ned_m_s):
            return None
        return Reject(m.t_ns, "position", "time_not_forward")

    def tanker_event(self, m: TankerState) -> Reject | None:
        """Take the tanker's state; a stamp that does not go forward is rejected."""
        if not self.tanker_motion.append(m.t_ns, m.p_ned_m, m.v_ned_m_s):
            return Reject(m.t_ns, "datalink", "time_not_forward")
        self.tanker_attitude.append(m.t_ns, m.R_ned_tanker, m.omega_tanker_rad_s)
        return None

    def align(self, t_ns: int) -> Aligned | None:
        """Return both aircraft at one instant, or None when a source has nothing, or only stale samples, for it."""
        own, own_attitude = self.own_motion.at(t_ns), self.own_attitude.at(t_ns)
        tanker, tanker_attitude = self.tanker_motion.at(t_ns), self.tanker_attitude.at(t_ns)
        if own is None or own_attitude is None or tanker is None or tanker_attitude is None:
            return None
        own_ns, attitude_ns, tanker_ns = self._newest()
        own_age_s = (t_ns - min(own_ns, attitude_ns)) * NS
        if own_age_s > self._config.own_stale_s or (t_ns - tanker_ns) * NS > self._config.tanker_stale_s:
            return None
        return Aligned(t_ns, own, own_attitude, tanker, tanker_attitude)

    def _newest(self) -> tuple[int, int, int]:
        return self.own_motion.newest_ns or 0, self.own_attitude.newest_ns or 0, self.tanker_motion.newest_ns or 0

    def T_cam_tanker_of(self, a: Aligned, p_ned_tanker_frd_m: Vec) -> SE3:
        """Return the thesis' ^C T_T (Fig. 3.6) from INU angles and the relative position of the centres of mass."""
        T_ned_frd = SE3(a.own_attitude.R_ned_body, p_ned_tanker_frd_m)
        T_ned_tanker = SE3(a.tanker_attitude.R_ned_body, np.zeros(3))
        return self._T_cam_frd @ T_ned_frd.inverse() @ T_ned_tanker

    def relative_position(self, a: Aligned) -> tuple[Vec, Anchor | None]:
        """Return the best relative position of the centres of mass (3,) in ned and the anchor that it rests on.

        The anchor is the last blend while it is fresh enough, None when the position is GPS alone.
        """
        anchor = self._anchor
        if anchor is None or (a.t_ns - anchor.t_ns) * NS > self._config.vision_stale_s:
            return a.own.p_ned_m - a.tanker.p_ned_m, None
        carried = a.own.travel_m - a.tanker.travel_m - anchor.travel_difference_m
        return anchor.p_ned_tanker_frd_m + carried, anchor

    def prior(self, t_ns: int) -> SE3 | None:
        """Return the predicted ``T_cam_tanker`` at an exposure: the last blend carried on, or GPS."""
        a = self.align(t_ns)
        return None if a is None else self.T_cam_tanker_of(a, self.relative_position(a)[0])

    def tracks(self, t_ns: int) -> bool:
        """Say whether the prior of an exposure rests on a blend that is fresh and more vision than GPS."""
        a = self._anchor
        return a is not None and (t_ns - a.t_ns) * NS <= self._config.vision_stale_s and a.vision_weight >= 0.5

    def gps_prior(self, t_ns: int) -> SE3 | None:
        """Return ``T_cam_tanker`` at an exposure by GPS and INU alone."""
        a = self.align(t_ns)
        return None if a is None else self.T_cam_tanker_of(a, a.own.p_ned_m - a.tanker.p_ned_m)

    def update(self, t_ns: int, pose: PoseMeasurement | None) -> FusedPose | None:
        """Blend at the instant of an exposure (eq. 3.9); None when the aircraft cannot be aligned at it.

        Without a valid pose the anchor stays what it was, so the last blend is carried on until it is stale.
        """
        a = self.align(t_ns)
        if a is None:
            return None
        T_gps = self.T_cam_tanker_of(a, a.own.p_ned_m - a.tanker.p_ned_m)
        if pose is None or pose.markers_used < self._config.min_markers:
            p_ned, anchor = self.relative_position(a)
            weight = 0.0 if anchor is None else anchor.vision_weight
            return FusedPose(t_ns, self.T_cam_tanker_of(a, p_ned), T_gps, weight, 0)
        w_gps = self.gps_weight(float(np.sqrt(T_gps.t @ T_gps.t)))
        t_blend = w_gps * T_gps.t + (1.0 - w_gps) * pose.T_cam_tanker.t
        T_cam_tanker = SE3(T_gps.R, t_blend)
        p_ned = a.own_attitude.R_ned_body @ (-self._T_frd_cam.transform(t_blend))
        difference = a.own.travel_m - a.tanker.travel_m
        self._anchor = Anchor(t_ns, p_ned, difference, 1.0 - w_gps, pose.markers_used)
        return FusedPose(t_ns, T_cam_tanker, T_gps, 1.0 - w_gps, pose.markers_used)

    def gps_weight(self, distance_m: float) -> float:
        """Return the weight of GPS at a distance (eq. 3.9)."""
        d1, d2 = self._config.d1_m, self._config.d2_m
        return min(1.0, max(0.0, (distance_m - d2) / (d1 - d2)))

    def estimate_ns(self, anchor: Anchor | None) -> int:
        """Return how old the newest estimate is at heart: the oldest of the newest samples that it rests on."""
        newest = min(self._newest())
        return newest if anchor is None else min(newest, anchor.t_ns)
