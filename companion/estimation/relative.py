"""From the fused estimate to what guidance flies on: receptacle R against box B, in the psi frame.

``BR`` in ``mrf`` (thesis 3.3, Fig. 3.8): the box is fixed in tanker axes, so the tanker's attitude turns it; ``mrf``
is ``ned`` turned by the tanker's nominal heading, and turns with it (``box_motion``). The rate that goes with it is
that of the receiver's centre of mass against the moving box, as seen in the turning frame: v - v_box - Omega x BR, with
Omega the nominal turn rate. The box's velocity has the tanker's rotation in it, by its body rates; the frame has not:
0.01 rad of yaw in a gust would turn 206 m/s into two of lateral speed. The receiver's own lever is left to the law,
which knows how the aircraft turns.
"""

from __future__ import annotations

import numpy as np

from companion.config import AirframeConfig, TankerConfig
from companion.estimation.aircraft import Aircraft
from companion.estimation.box_motion import BoxMotion, BoxObserver
from companion.estimation.fusion import Fusion, Relative
from companion.geometry import SE3, Mat, Vec, rotation_from_euler, skew
from companion.messages import RelativeState, Sources


class RelativeEstimator:
    """Turns what a fusion knows into ``RelativeState`` at any instant."""

    def __init__(self, fusion: Fusion, aircraft: Aircraft, tanker: TankerConfig, airframe: AirframeConfig) -> None:
        self._fusion, self._aircraft = fusion, aircraft
        self._box_tanker_m = np.array(tanker.box_tanker_m)
        self._receptacle_frd_m = np.array(airframe.receptacle_frd_m)
        self.restart()

    def restart(self) -> None:
        """Forget how the box moved: time has stepped."""
        self._observer = BoxObserver(self._box_tanker_m)

    def shift(self, step_ns: int) -> None:
        """Move what is known of the box' motion in time."""
        self._observer.shift(step_ns)

    def sources(self) -> Sources:
        """Return how new the newest sample of each source is."""
        a = self._aircraft
        return Sources(a.attitude_ns, a.position_ns, a.tanker_ns, self._fusion.sight_ns)

    def at(self, t_ns: int) -> RelativeState | None:
        """Return the relative state at an instant, or None when a source is missing or stale."""
        fused = self._fusion.at(t_ns)
        return None if fused is None else self._state(t_ns, fused)

    def _state(self, t_ns: int, fused: Relative) -> RelativeState:
        a = fused.aligned
        box = self._box(t_ns)
        R_mrf_ned = rotation_from_euler(box.heading0_rad, 0.0, 0.0).T
        R_ned_frd = a.own_attitude.R_ned_body
        box_ned_m = fused.R_correction @ (a.tanker_attitude.R_ned_body @ self._box_tanker_m)
        p_mrf_br = R_mrf_ned @ (fused.p_ned_m + R_ned_frd @ self._receptacle_frd_m - box_ned_m)
        turning = np.array([-p_mrf_br[1], p_mrf_br[0], 0.0]) * box.turn_rate_rad_s
        p_ned_frd = fused.p_ned_m + R_ned_frd @ fused.T_frd_cam.t  # camera from the tanker's centre of mass
        R_cam_ned = (R_ned_frd @ fused.T_frd_cam.R).T
        T_cam_tanker = SE3(R_cam_ned @ fused.R_correction @ a.tanker_attitude.R_ned_body, -R_cam_ned @ p_ned_frd)
        return RelativeState(
            t_ns=t_ns,
            estimate_t_ns=fused.estimate_ns,
            p_mrf_br_m=p_mrf_br,
            v_mrf_br_m_s=R_mrf_ned @ (a.own.v_ned_m_s - box.v_ned_m_s + fused.dv_ned_m_s) - turning,
            v_ned_box_m_s=box.v_ned_m_s,
            a_ned_box_m_s2=box.a_ned_m_s2,
            R_ned_frd=R_ned_frd,
            omega_frd_rad_s=a.own_attitude.omega_body_rad_s,
            heading0_rad=box.heading0_rad,
            turn_rate_rad_s=box.turn_rate_rad_s,
            T_cam_tanker=T_cam_tanker,
            range_m=float(np.sqrt(T_cam_tanker.t @ T_cam_tanker.t)),
            vision_weight=fused.vision_weight,
            markers_used=fused.markers_used,
            cov_mrf_br_m2=self._cov(fused, R_mrf_ned, box_ned_m, R_ned_frd @ self._receptacle_frd_m),
        )

    def _cov(self, fused: Relative, R_mrf_ned: Mat, box_ned_m: Vec, receptacle_ned_m: Vec) -> Mat:
        """Return the covariance (3, 3) of BR in ``mrf``: position, and each aircraft's attitude on its own lever.

        The noise of the receiver's INS turns both levers, as rigidly as what the tanker's attitude is told against.
        """
        J = np.zeros((3, 12))
        J[:, :3], J[:, 6:9] = R_mrf_ned, R_mrf_ned @ skew(box_ned_m)
        J[:, 9:] = R_mrf_ned @ skew(box_ned_m - receptacle_ned_m)
        return J @ fused.cov @ J.T

    def _box(self, t_ns: int) -> BoxMotion:
        """Return how the box moves at an instant. Of reports that come between two calls, the newest is enough."""
        motion, attitude = self._aircraft.tanker_motion, self._aircraft.tanker_attitude
        newest_ns = motion.newest_ns
        if newest_ns is not None and self._observer.is_new(newest_ns):
            m, a = motion.at(newest_ns), attitude.at(newest_ns)
            if m is not None and a is not None:
                self._observer.update(newest_ns, m.v_ned_m_s, a.R_ned_body, a.omega_body_rad_s)
        return self._observer.at(t_ns)
