"""The autopilot's clock as the link uses it: when to ask for it, what a stamp of it is on ours, when it has stepped."""

from __future__ import annotations

from companion.io.telemetry import SOURCE
from companion.io.timesync import WRAP_MS, ClockOffset, nearest_wrapped
from companion.messages import Reject, TimeStep

NS_PER_MS = 1_000_000
FIRST_NS = 100_000_000
LATER_NS = 1_000_000_000
FIRST_COUNT = 20
MAX_AGE_NS = 2_000_000_000
MAX_AHEAD_NS = 50_000_000
ODD_AGE_NS = 150_000_000
ODD_AHEAD_NS = 20_000_000
"""Telemetry that is older, or further ahead, than it ever should be says that a clock may have stepped."""
ODD_STAMP_NS = 50_000_000
STEP_FOUND_NS = 3_000_000_000
"""A step is found within so long after it; stamps that have followed on one another for longer have not stepped."""


class AutopilotClock:
    """Offset by TIMESYNC; asked often at first and in doubt, later once a second."""

    def __init__(self) -> None:
        self.offset = ClockOffset()
        self._due_ns = 0
        self._asked = 0
        self._odd = False
        self._last_stamp: tuple[int, int] | None = None
        self._broken_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Tell whether to ask now; True counts as asked."""
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + (FIRST_NS if self._asked < FIRST_COUNT else LATER_NS)
        self._asked += 1
        return True

    def hurry(self, now_ns: int) -> None:
        """Ask soon, and often for a while."""
        self._asked = 0
        self._due_ns = min(self._due_ns, now_ns + FIRST_NS)

    def answer(self, ts1_ns: int, tc1_ns: int, now_ns: int) -> Reject | TimeStep | None:
        """Take an answer; return why it is not used, or by how much the clock is found to have stepped."""
        reason = self.offset.answer(ts1_ns, tc1_ns, now_ns)
        step_ns = self.offset.take_step()
        if step_ns:
            continuous = self._broken_ns is None or now_ns - self._broken_ns > STEP_FOUND_NS
            return TimeStep(now_ns, SOURCE, -step_ns, continuous)
        if reason is None:
            return None
        if self.offset.doubtful:
            self.hurry(now_ns)
        return Reject(now_ns, SOURCE, reason)

    def stamp(self, boot_ms: int, now_ns: int) -> int | Reject:
        """Return milliseconds since the autopilot's boot, modulo 2^32, on the companion's base."""
        if self.offset.offset_ns is None:
            return Reject(now_ns, SOURCE, "no_timesync", "the autopilot's clock is not known yet")
        self._follow(boot_ms, now_ns)
        expected_ms = self.offset.to_other_ns(now_ns) // NS_PER_MS
        t_ns = self.offset.to_ours_ns(nearest_wrapped(boot_ms, WRAP_MS, expected_ms) * NS_PER_MS)
        odd = not now_ns - ODD_AGE_NS <= t_ns <= now_ns + ODD_AHEAD_NS
        if odd and not self._odd:
            self.hurry(now_ns)
        self._odd = odd
        if now_ns - MAX_AGE_NS <= t_ns <= now_ns + MAX_AHEAD_NS:
            return t_ns
        reason = "future_stamp" if t_ns > now_ns else "stale_stamp"
        return Reject(now_ns, SOURCE, reason, f"{(t_ns - now_ns) * 1e-9:+.3f} s from now")

    def _follow(self, boot_ms: int, now_ns: int) -> None:
        """Note when the autopilot's stamps do not follow on one another: too far ahead, or back beyond late ones."""
        if self._last_stamp is not None:
            last_ms, last_ns = self._last_stamp
            passed_ns = nearest_wrapped(boot_ms - last_ms, WRAP_MS, 0) * NS_PER_MS
            if not -ODD_STAMP_NS <= passed_ns <= now_ns - last_ns + ODD_STAMP_NS:
                self._broken_ns = now_ns
        self._last_stamp = boot_ms, now_ns

    def gps_stamp(self, time_us: int, now_ns: int) -> int:
        """Return the instant of a fix: its own where that is on the autopilot's clock (it may be UTC), else now."""
        if self.offset.offset_ns is None:
            return now_ns
        t_ns = self.offset.to_ours_ns(time_us * 1000)
        return t_ns if now_ns - MAX_AGE_NS <= t_ns <= now_ns else now_ns
