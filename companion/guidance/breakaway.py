"""The breakaway: aft and down, on absolute attitude, with no need of an estimate.

Rules
-----
* Wings level, nose below level flight by ``breakaway_descent_rad``, thrust ``breakaway_thrust``, the heading that was
  last known: an autopilot flies that by its own attitude alone, whatever the companion still knows.
* Level again once clear of the tanker, never before ``breakaway_level_s``: by a fresh estimate when it is farther than
  ``breakaway_separation_m`` and does not come forward any more; by time alone when there is no estimate to believe,
  because it, or what it rests on, is the cause (``DISTRUSTED``), because it is old, or because integrity sees a fault.
* Level takes ``LEVEL_THRUST`` of what level flight takes: a little slower than the tanker, and sinking a little, who is
  clear never closes in again, however long an operator takes. While an estimate says that it does, thrust stays low.
* That it is latched, and who ends it, is the phases' affair. Once level it stays level.
"""

from __future__ import annotations

import math

from companion.config import AirframeConfig, GuidanceConfig
from companion.guidance.causes import (
    ATTITUDE_STALE,
    DATALINK_STALE,
    ESTIMATE_LOST,
    INTEGRITY_FAILED,
    OFF_PATH,
    POSITION_STALE,
    SIGHT_LOST,
    Near,
    View,
    failing,
    near_of,
)
from companion.messages import NS, AttitudeSetpoint

DISTRUSTED = (
    SIGHT_LOST, DATALINK_STALE, ATTITUDE_STALE, POSITION_STALE, INTEGRITY_FAILED, ESTIMATE_LOST, OFF_PATH,
)  # fmt: skip
"""Causes after which the estimate says nothing that could be relied on."""

LEVEL_THRUST = 0.9
"""Of trim."""


class Breakaway:
    """``see`` in every guidance step, whatever the phase; ``setpoint`` in those of a breakaway, after ``begin``."""

    def __init__(self, config: GuidanceConfig, airframe: AirframeConfig) -> None:
        self._config, self._trim = config, airframe.trim
        self._yaw_rad = 0.0
        self._begun_ns = 0
        self._trusts = False
        self._clear = False

    def see(self, view: View) -> None:
        """Keep the receiver's heading as long as it is known."""
        if view.state is not None:
            R = view.state.R_ned_frd
            yaw_rad = math.atan2(R[1, 0], R[0, 0])
            self._yaw_rad = yaw_rad if math.isfinite(yaw_rad) else self._yaw_rad

    def begin(self, t_ns: int, cause: str) -> None:
        """Begin anew, for one of ``CAUSES``."""
        self._begun_ns, self._clear = t_ns, False
        self._trusts = not cause.startswith(DISTRUSTED)

    def setpoint(self, view: View) -> AttitudeSetpoint:
        """Return what to fly now; ``view`` need not have a state."""
        near = self._believed(view)
        self._clear = self._clear or self._is_clear(view.t_ns, near)
        trim, c = self._trim, self._config
        pitch_rad = trim.alpha_rad if self._clear else trim.alpha_rad - c.breakaway_descent_rad
        opens = near is None or near.forward_m_s <= 0.0
        thrust = LEVEL_THRUST * trim.throttle if self._clear and opens else c.breakaway_thrust
        return AttitudeSetpoint(view.t_ns, 0.0, pitch_rad, self._yaw_rad, thrust)

    def _believed(self, view: View) -> Near | None:
        """Return where the receiver is by an estimate that can be relied on; None without one."""
        state = view.state
        if not self._trusts or state is None or failing(view.integrity, protects=False):
            return None
        fresh = abs(view.t_ns - state.estimate_t_ns) * NS <= self._config.estimate_stale_s
        return near_of(state) if fresh else None

    def _is_clear(self, t_ns: int, near: Near | None) -> bool:
        if (t_ns - self._begun_ns) * NS < self._config.breakaway_level_s:
            return False
        return near is None or (near.range_m > self._config.breakaway_separation_m and near.forward_m_s <= 0.0)
