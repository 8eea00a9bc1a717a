"""From the aligned aircraft and the blend to what guidance flies on: receptacle R against box B, in the psi frame.

``BR`` in ``mrf`` (thesis 3.3, Fig. 3.8): the box is fixed in tanker axes, so the tanker's attitude turns it; ``mrf`` is
``ned`` turned by the tanker's nominal heading, which is taken from the tanker's course (the mean of what it has told).
The rate that goes with it is the difference of the inertial velocities of the centres of mass. Both lever arms are left
out on purpose: 0.01 rad of tanker yaw in a gust would look like lateral speed that no receiver should follow, and the
receiver's own roll rate at a receptacle one metre above its axis closes a loop that the docking law does not know of.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import AirframeConfig, TankerConfig
from companion.estimation.blend import Aligned, Blend
from companion.geometry import Mat, Vec, rotation_from_euler
from companion.messages import NS, RelativeState

HEADING_S = 10.0
"""Time constant with which the nominal heading follows the tanker's course."""


class RelativeEstimator:
    """Turns a ``Blend`` into ``RelativeState`` at any instant."""

    def __init__(self, blend: Blend, tanker: TankerConfig, airframe: AirframeConfig) -> None:
        self._blend = blend
        self._box_tanker_m = np.array(tanker.box_tanker_m)
        self._receptacle_frd_m = np.array(airframe.receptacle_frd_m)
        self._course: Vec | None = None
        self._course_ns = 0

    def at(self, t_ns: int) -> RelativeState | None:
        """Return the relative state at an instant, or None when a source is missing or stale."""
        a = self._blend.align(t_ns)
        if a is None:
            return None
        p_ned, anchor = self._blend.relative_position(a)
        heading0, R_mrf_ned = self._psi_frame(a)
        R_ned_frd = a.own_attitude.R_ned_body
        omega = a.own_attitude.omega_body_rad_s
        p_ned_br = p_ned + R_ned_frd @ self._receptacle_frd_m - a.tanker_attitude.R_ned_body @ self._box_tanker_m
        v_ned = a.own.v_ned_m_s - a.tanker.v_ned_m_s
        T_cam_tanker = self._blend.T_cam_tanker_of(a, p_ned)
        return RelativeState(
            t_ns=t_ns,
            estimate_t_ns=self._blend.estimate_ns(anchor),
            p_mrf_br_m=R_mrf_ned @ p_ned_br,
            v_mrf_br_m_s=R_mrf_ned @ v_ned,
            v_ned_tanker_m_s=a.tanker.v_ned_m_s,
            R_ned_frd=R_ned_frd,
            omega_frd_rad_s=omega,
            heading0_rad=heading0,
            T_cam_tanker=T_cam_tanker,
            range_m=float(np.sqrt(T_cam_tanker.t @ T_cam_tanker.t)),
            vision_weight=0.0 if anchor is None else anchor.vision_weight,
            markers_used=0 if anchor is None else anchor.markers_used,
        )

    def _psi_frame(self, a: Aligned) -> tuple[float, Mat]:
        course = a.tanker.v_ned_m_s[:2]
        speed = float(np.hypot(course[0], course[1]))
        # A tanker that stands still has no course; on a bench its nose serves.
        course = course / speed if speed > 1.0 else a.tanker_attitude.R_ned_body[:2, 0]
        if self._course is None:
            self._course = course
        else:
            share = 1.0 - math.exp(-max(0, a.t_ns - self._course_ns) * NS / HEADING_S)
            self._course = self._course + share * (course - self._course)
        self._course_ns = a.t_ns
        heading0 = float(np.arctan2(self._course[1], self._course[0]))
        return heading0, rotation_from_euler(heading0, 0.0, 0.0).T
