"""What can be wrong with the estimate this very moment: means over seconds come too late for that.

Rules
-----
* What the last frames say of the estimate's place bounds its error as they see it: no mean, no noise subtracted.
* Between the newest frame and now nothing judges what the aircraft tell. A velocity, and an attitude of the tanker, may
  be wrong by what plausibility lets through, and the receiver's stamps or the camera's by ``STAMPS_S``: one of them,
  as one hypothesis each. What neither tells since its newest sample, it may do: half ``MOVES_M_S2`` times the age
  squared, beside everything else.
* ``may_dock`` needs every source fresh, the newest frame not refused by the filter, and both for ``SETTLE_S``, by
  frames that were exposed after the last doubt.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.estimation.integrity_sources import REFUSALS
from companion.estimation.plausibility import LET_THROUGH_M_S, LET_THROUGH_RAD
from companion.geometry import Mat, Vec, log_so3, skew
from companion.messages import NS, FilterUpdate, FusedPose, PoseMeasurement, RelativeState, Sources

FRESH_S = {"attitude": 0.2, "position": 0.2, "datalink": 0.25}
"""How old the newest sample may be: several are missing then. The guard breaks away at 0.4 s."""
SETTLE_S = 0.25
FRAMES_S = 0.25
STAMPS_S = 0.3
MOVES_M_S2 = 6.0
"""What either aircraft does against the acceleration of the last moments, with its elevators and in gusts."""


class Moment:
    """Watches the last frames and the age of the sources."""

    def __init__(self, sight_stale_s: float) -> None:
        self._sight_stale_s = sight_stale_s
        self.restart()

    def restart(self) -> None:
        """Forget every frame."""
        self._off: deque[tuple[int, Vec, Vec]] = deque()
        self._refused_ns: int | None = None
        self._taken_ns: int | None = None
        self._doubt_ns: int | None = None

    def update(self, update: FilterUpdate) -> None:
        """Take note of a frame that the filter refuses, or by which it begins anew."""
        if update.source == "pixels" and update.reason in REFUSALS:
            self._refused_ns = update.t_ns

    def frame(self, pose: PoseMeasurement | None, fused: FusedPose) -> None:
        """Take a frame after the fusion has; ``pose`` if it found its own rotation."""
        if self._refused_ns == fused.t_ns:
            self._doubt(fused.t_ns)
        elif fused.markers_used > 0:
            self._taken_ns = fused.t_ns
        while self._off and (fused.t_ns - self._off[0][0]) * NS > FRAMES_S:
            self._off.popleft()
        if pose is not None:
            T = pose.T_cam_tanker
            self._off.append((fused.t_ns, T.t - fused.T_cam_tanker.t, log_so3(T.R @ fused.T_cam_tanker.R.T)))

    def _doubt(self, t_ns: int) -> None:
        self._doubt_ns = t_ns if self._doubt_ns is None else max(t_ns, self._doubt_ns)

    def notes(self, t_ns: int, sources: Sources) -> tuple[str, ...]:
        """Return what speaks against docking at an instant; nothing when all is well."""
        stamps = {"attitude": sources.attitude_ns, "position": sources.position_ns, "datalink": sources.tanker_ns}
        stale = tuple(f"stale {name}" for name, at_ns in stamps.items() if older(t_ns, at_ns, FRESH_S[name]))
        if older(t_ns, sources.sight_ns, self._sight_stale_s):
            stale = (*stale, "unseen")
        if stale:
            self._doubt(t_ns)
            return stale
        settled = self._doubt_ns is None or (
            self._taken_ns is not None and (self._taken_ns - self._doubt_ns) * NS >= SETTLE_S
        )
        return () if settled else ("unsettled",)

    def off_m(self, t_cam_m: Vec, R_mrf_cam: Mat) -> Vec:
        """Return the largest (3,), mrf, by which one of the last frames leaves the estimate: with the camera oriented
        by the INS, and by the picture (``integrity_leave_out.moves``)."""
        if not self._off:
            return np.zeros(3)
        place, turn = np.array([o[1] for o in self._off]), np.array([o[2] for o in self._off])
        turned = place + turn @ skew(t_cam_m).T
        largest: Vec = np.abs(np.vstack((place, turned)) @ R_mrf_cam.T).max(axis=0)
        return largest


def unjudged_m(state: RelativeState, sources: Sources, R_mrf_cam: Mat) -> Vec:
    """Return what nothing has judged since the newest frame (3,), mrf: the largest of the hypotheses on each axis."""
    age_s = age(state.t_ns, sources.sight_ns)
    lever_m = R_mrf_cam @ state.T_cam_tanker.t
    across_m = np.sqrt(np.maximum(lever_m @ lever_m - lever_m**2, 0.0))
    stamps_m = np.abs(state.v_mrf_br_m_s) * STAMPS_S
    hypotheses = (stamps_m, LET_THROUGH_RAD * across_m, np.full(3, LET_THROUGH_M_S * age_s))
    return np.asarray(np.max(hypotheses, axis=0))


def moved_m(t_ns: int, sources: Sources) -> float:
    """Return what the aircraft may have moved by since they told it last."""
    own_s, tanker_s = age(t_ns, sources.position_ns), age(t_ns, sources.tanker_ns)
    return 0.5 * MOVES_M_S2 * (own_s * own_s + tanker_s * tanker_s)


def older(t_ns: int, at_ns: int | None, limit_s: float) -> bool:
    """Tell whether a sample is older than a limit, or has never come."""
    return at_ns is None or (t_ns - at_ns) * NS > limit_s


def age(t_ns: int, at_ns: int | None) -> float:
    """Return how old a sample is, in s; what has never come is a second old."""
    return 1.0 if at_ns is None else abs(t_ns - at_ns) * NS
