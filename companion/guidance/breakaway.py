"""The breakaway: aft and down, on absolute attitude, with no need of an estimate.

Rules
-----
* Wings level, nose below level flight by ``breakaway_descent_rad``, thrust ``breakaway_thrust``, the heading that was
  last known: an autopilot flies that by its own attitude alone, whatever the companion still knows.
* Level flight again once clear of the tanker: by the estimate when there is a fresh one (``breakaway_separation_m``),
  otherwise after ``breakaway_level_s``. Once level it stays level.
* That it is latched, and who ends it, is the phases' affair.
"""

from __future__ import annotations

import math

from companion.config import AirframeConfig, GuidanceConfig
from companion.guidance.causes import View, near_of
from companion.messages import NS, AttitudeSetpoint


class Breakaway:
    """``see`` in every guidance step, whatever the phase; ``setpoint`` in those of a breakaway, after ``begin``."""

    def __init__(self, config: GuidanceConfig, airframe: AirframeConfig) -> None:
        self._config, self._trim = config, airframe.trim
        self._yaw_rad = 0.0
        self._begun_ns = 0
        self._clear = False

    def see(self, view: View) -> None:
        """Keep the receiver's heading as long as it is known."""
        if view.state is not None:
            R = view.state.R_ned_frd
            yaw_rad = math.atan2(R[1, 0], R[0, 0])
            self._yaw_rad = yaw_rad if math.isfinite(yaw_rad) else self._yaw_rad

    def begin(self, t_ns: int) -> None:
        """Begin anew."""
        self._begun_ns, self._clear = t_ns, False

    def setpoint(self, view: View) -> AttitudeSetpoint:
        """Return what to fly now; ``view`` need not have a state."""
        self._clear = self._clear or self._is_clear(view)
        trim, c = self._trim, self._config
        if self._clear:
            return AttitudeSetpoint(view.t_ns, 0.0, trim.alpha_rad, self._yaw_rad, trim.throttle)
        pitch_rad = trim.alpha_rad - c.breakaway_descent_rad
        return AttitudeSetpoint(view.t_ns, 0.0, pitch_rad, self._yaw_rad, c.breakaway_thrust)

    def _is_clear(self, view: View) -> bool:
        state, c = view.state, self._config
        near = None if state is None else near_of(state)
        if state is None or near is None or abs(view.t_ns - state.estimate_t_ns) * NS > c.estimate_stale_s:
            return (view.t_ns - self._begun_ns) * NS >= c.breakaway_level_s
        return near.range_m > c.breakaway_separation_m
