"""Both aircraft at one instant, from what each tells of itself; every fusion begins here.

Positions are only differenced at one instant (at 206 m/s one millisecond is 0.21 m): samples of attitude, position and
velocity are kept in histories and brought to the instant that is asked for. What cannot follow on what was before
(``plausibility``) is not kept, and said.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.config import FusionConfig
from companion.estimation.alignment import Attitude, AttitudeHistory, Motion, MotionHistory
from companion.estimation.plausibility import RECEIVER, TANKER, AttitudeWatch, MotionWatch, Repetition, Verdict
from companion.geometry import SE3, Vec
from companion.messages import NS, GpsStatus, OwnAttitude, OwnPosition, Reject, TankerState, TimeStep

GPS_STATUS_S = 3.0
"""What a GPS has said of itself holds for so long: it is told once a second or oftener."""


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Both aircraft at one instant."""

    t_ns: int
    own: Motion
    own_attitude: Attitude
    tanker: Motion
    tanker_attitude: Attitude

    @property
    def p_ned_gps_m(self) -> Vec:
        """Return the receiver's centre of mass against the tanker's (3,) as their positions have it."""
        return self.own.p_ned_m - self.tanker.p_ned_m

    @property
    def travel_difference_m(self) -> Vec:
        """Return how far (3,) the receiver has moved against the tanker since the start, by velocity alone."""
        return self.own.travel_m - self.tanker.travel_m

    @property
    def carried(self) -> bool:
        """Tell whether a position was not told but carried on by velocities: the two say nothing of GPS then."""
        return self.own.carried or self.tanker.carried


class Aircraft:
    """Histories of receiver and tanker. Events in; no clock."""

    def __init__(self, config: FusionConfig, T_frd_cam: SE3) -> None:
        self._config = config
        self.T_frd_cam = T_frd_cam
        self._T_cam_frd = T_frd_cam.inverse()
        self._before: tuple[int | None, int | None, int | None] = (None, None, None)
        self._begin()

    def restart(self) -> None:
        """Forget every sample; how new the newest ones were stays known."""
        self._before = self.attitude_ns, self.position_ns, self.tanker_ns
        self._begin()

    def _begin(self) -> None:
        self._last: Aligned | None = None
        self._gps: GpsStatus | None = None
        self.own_motion = MotionHistory()
        self.own_attitude = AttitudeHistory()
        self.tanker_motion = MotionHistory()
        self.tanker_attitude = AttitudeHistory()
        self._attitude_watch, self._tanker_attitude_watch = AttitudeWatch(RECEIVER), AttitudeWatch(TANKER)
        self._motion_watch, self._tanker_watch = MotionWatch(), MotionWatch()
        self._attitude_content, self._position_content, self._tanker_content = Repetition(), Repetition(), Repetition()

    def own_attitude_event(self, m: OwnAttitude) -> Reject | None:
        """Take the receiver's attitude; return what is odd about it, whether or not it counts."""
        self._last = None
        history = self.own_attitude
        fault = history.fault(m.t_ns)
        if not fault and self._attitude_content.lasts(m.t_ns, m.R_ned_frd, m.omega_frd_rad_s):
            fault = "frozen"
        if not fault:
            verdict = self._attitude_watch.judge(m.t_ns, m.R_ned_frd, m.omega_frd_rad_s, history)
            if verdict.taken:
                history.add(m.t_ns, m.R_ned_frd, m.omega_frd_rad_s)
            fault = verdict.reason
        return Reject(m.t_ns, "attitude", fault) if fault else None

    def own_position_event(self, m: OwnPosition) -> Reject | None:
        """Take the receiver's position and velocity; return what is odd about it, whether or not it counts."""
        self._last = None
        fault = self.own_motion.fault(m.t_ns)
        if not fault and self._position_content.lasts(m.t_ns, m.p_ned_m, m.v_ned_m_s):
            fault = "frozen"
        if not fault:
            verdict = self._motion_watch.judge(m.t_ns, m.p_ned_m, m.v_ned_m_s, self.own_motion)
            _keep(self.own_motion, verdict, m)
            fault = verdict.reason
        return Reject(m.t_ns, "position", fault) if fault else None

    def tanker_event(self, m: TankerState) -> Reject | None:
        """Take the tanker's state; return what is odd about it, whether or not it counts."""
        self._last = None
        attitude = (m.t_ns, m.R_ned_tanker, m.omega_tanker_rad_s)
        fault = self.tanker_motion.fault(m.t_ns)
        if not fault and self._tanker_content.lasts(m.t_ns, m.p_ned_m, m.v_ned_m_s, *attitude[1:]):
            fault = "frozen"
        if not fault:
            turned = self._tanker_attitude_watch.judge(*attitude, self.tanker_attitude)
            moved = self._tanker_watch.judge(m.t_ns, m.p_ned_m, m.v_ned_m_s, self.tanker_motion)
            if turned.taken:
                _keep(self.tanker_motion, moved, m)
                if moved.taken or moved.carried:
                    self.tanker_attitude.add(*attitude)
            fault = turned.reason or moved.reason
        return Reject(m.t_ns, "datalink", fault) if fault else None

    def gps_event(self, m: GpsStatus) -> None:
        """Take what the receiver's GPS says of itself."""
        self._gps = m

    def without_fix(self, t_ns: int) -> bool:
        """Tell whether the receiver's GPS has said lately that it has no fix."""
        status = self._gps
        return status is not None and not status.has_fix and (t_ns - status.t_ns) * NS <= GPS_STATUS_S

    def time_step_event(self, m: TimeStep) -> None:
        """A clock has stepped: move what was stamped before, or forget it where it belongs to no time any more."""
        if not m.continuous:
            self.restart()
            return
        self._last = None
        for moved in (
            self.own_motion, self.own_attitude, self.tanker_motion, self.tanker_attitude,
            self._attitude_watch, self._tanker_attitude_watch, self._motion_watch, self._tanker_watch,
            self._attitude_content, self._position_content, self._tanker_content,
        ):
            moved.shift(m.step_ns)
        if self._gps is not None:
            self._gps = replace(self._gps, t_ns=self._gps.t_ns + m.step_ns)

    @property
    def attitude_ns(self) -> int | None:
        """Return the stamp of the receiver's newest attitude."""
        newest_ns = self.own_attitude.newest_ns
        return self._before[0] if newest_ns is None else newest_ns

    @property
    def position_ns(self) -> int | None:
        """Return the stamp of the receiver's newest position."""
        newest_ns = self.own_motion.newest_ns
        return self._before[1] if newest_ns is None else newest_ns

    @property
    def tanker_ns(self) -> int | None:
        """Return the stamp of the tanker's newest state."""
        newest_ns = self.tanker_motion.newest_ns
        return self._before[2] if newest_ns is None else newest_ns

    def oldest_ns(self) -> int:
        """Return the oldest of the newest samples: what an estimate rests on at best; 0 when a source has none."""
        return min(self.position_ns or 0, self.attitude_ns or 0, self.tanker_ns or 0)

    def oldest_fix_ns(self) -> int:
        """Return the same for an estimate that rests on positions: those that were told, not carried."""
        return min(self.oldest_ns(), self.own_motion.fixed_ns or 0, self.tanker_motion.fixed_ns or 0)

    def align(self, t_ns: int) -> Aligned | None:
        """Return both aircraft at one instant, or None when a source has nothing, or only stale samples, for it.

        Several ask for one instant: the last answer is kept until something new is told.
        """
        if self._last is not None and self._last.t_ns == t_ns:
            return self._last
        own, own_attitude = self.own_motion.at(t_ns), self.own_attitude.at(t_ns)
        tanker, tanker_attitude = self.tanker_motion.at(t_ns), self.tanker_attitude.at(t_ns)
        if own is None or own_attitude is None or tanker is None or tanker_attitude is None:
            return None
        own_age_s = (t_ns - min(self.position_ns or 0, self.attitude_ns or 0)) * NS
        if own_age_s > self._config.own_stale_s or (t_ns - (self.tanker_ns or 0)) * NS > self._config.tanker_stale_s:
            return None
        self._last = Aligned(t_ns, own, own_attitude, tanker, tanker_attitude)
        return self._last

    def gps_prior(self, t_ns: int) -> SE3 | None:
        """Return ``T_cam_tanker`` at an exposure by GPS and INU alone (simulated vision, thesis 4.2.5)."""
        a = self.align(t_ns)
        return None if a is None else self.T_cam_tanker(a, a.p_ned_gps_m)

    def T_cam_tanker(self, a: Aligned, p_ned_tanker_frd_m: Vec) -> SE3:
        """Return the thesis' ^C T_T (Fig. 3.6) from INU angles and the relative position of the centres of mass."""
        T_ned_frd = SE3(a.own_attitude.R_ned_body, p_ned_tanker_frd_m)
        T_ned_tanker = SE3(a.tanker_attitude.R_ned_body, np.zeros(3))
        return self._T_cam_frd @ T_ned_frd.inverse() @ T_ned_tanker


def _keep(history: MotionHistory, verdict: Verdict, m: OwnPosition | TankerState) -> None:
    """Put a sample into a history by what is thought of it; one that is carried, where it should be."""
    if verdict.taken:
        history.add(m.t_ns, m.p_ned_m, m.v_ned_m_s)
    elif verdict.carried:
        expected = history.at(m.t_ns)
        if expected is not None:
            history.add(m.t_ns, expected.p_ned_m, m.v_ned_m_s, carried=True)
