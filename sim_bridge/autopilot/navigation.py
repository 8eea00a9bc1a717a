"""Dead reckoning: the last GPS fix, carried to now by the integrated inertial velocity.

A fix is 0.1 to 0.2 s old when it is used (thesis 3.2), which is 20 to 40 m of flight. The displacement since then is
known much better: with the velocity noise of the thesis it is good to about a centimetre. So the position that
leaves is valid at its stamp, and its error is the fix's.
"""

from __future__ import annotations

from collections import deque

from sim_bridge.sensors import GpsFix, InertialSample, Triple

HISTORY_NS = 500_000_000
"""How far back a fix can lie; GPS delay and period together are 0.2 s."""


class DeadReckoner:
    """Position of one aircraft at every inertial sample; None until the first fix."""

    def __init__(self) -> None:
        """Start without a fix and with an empty history."""
        self._travel: deque[tuple[int, Triple, Triple]] = deque()  # instant, displacement since the start, velocity
        self._anchor: Triple | None = None  # position of the start of the displacement, by the last fix
        self.late_fixes = 0

    def update(self, sample: InertialSample, fix: GpsFix | None) -> Triple | None:
        """Take one inertial sample and perhaps a fix; return the position (m, ``ned``) at the sample's instant."""
        s = self._advance(sample.t_ns, sample.v_ned_m_s)
        if fix is not None:
            back = self._travel_at(fix.t_ns)
            if back is None:
                self.late_fixes += 1
            else:
                x, y, z = fix.p_ned_m
                self._anchor = (x - back[0], y - back[1], z - back[2])
        if self._anchor is None:
            return None
        a = self._anchor
        return a[0] + s[0], a[1] + s[1], a[2] + s[2]

    def _advance(self, t_ns: int, v: Triple) -> Triple:
        """Integrate the velocity to ``t_ns`` (trapezia) and forget what is older than the history."""
        if not self._travel:
            self._travel.append((t_ns, (0.0, 0.0, 0.0), v))
            return 0.0, 0.0, 0.0
        t_old, s_old, v_old = self._travel[-1]
        half = 0.5e-9 * (t_ns - t_old)
        s = (
            s_old[0] + half * (v[0] + v_old[0]),
            s_old[1] + half * (v[1] + v_old[1]),
            s_old[2] + half * (v[2] + v_old[2]),
        )
        self._travel.append((t_ns, s, v))
        while self._travel[0][0] < t_ns - HISTORY_NS:
            self._travel.popleft()
        return s

    def _travel_at(self, t_ns: int) -> Triple | None:
        """Return the displacement at a past instant, between two samples by a straight line; None outside."""
        later: tuple[int, Triple, Triple] | None = None
        for entry in reversed(self._travel):
            t, s, _ = entry
            if t == t_ns:
                return s
            if t < t_ns:
                if later is None:
                    return None
                k = (t_ns - t) / (later[0] - t)
                b = later[1]
                return s[0] + k * (b[0] - s[0]), s[1] + k * (b[1] - s[1]), s[2] + k * (b[2] - s[2])
            later = entry
        return None
