"""Where the autopilot's clock stands against ours, from the round trips of TIMESYNC.

A request leaves at ``ts1`` on our clock and comes back at ``now`` with the autopilot's instant ``tc1`` in between, so

    offset = tc1 - (ts1 + now) / 2,   |error| <= (now - ts1) / 2

and the sample with the shortest way there and back binds the offset best. Samples live for a few seconds only, because
two crystals drift apart by some 10 us a second. Once it has settled the offset creeps instead of stepping: two
positions are differenced whose stamps may lie on both sides of a step, and at 206 m/s 1 ms is 0.2 m.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

WINDOW_NS = 10_000_000_000
MAX_ROUND_TRIP_NS = 200_000_000
JUMP_MARGIN_NS = 1_000_000
SETTLED_COUNT = 20
CREEP_NS = 100_000
"""Most that one sample moves a settled offset: at one sample a second, ten times what crystals drift apart."""
WRAP_MS = 1 << 32


@dataclass(frozen=True, slots=True)
class Sample:
    """One round trip: when it ended on our clock, how long it took, the offset that it gave."""

    t_ns: int
    round_trip_ns: int
    offset_ns: int


class ClockOffset:
    """Offset of another clock against ours: ``other = ours + offset_ns``; None before the first round trip."""

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        self.round_trip_ns: int | None = None
        self.jumps = 0
        self._sent: deque[int] = deque(maxlen=32)
        self._samples: deque[Sample] = deque()
        self._count = 0

    def request(self, now_ns: int) -> int:
        """Note that a request leaves now; return its ``ts1``, which is never one that is still under way."""
        ts1 = max(now_ns, self._sent[-1] + 1) if self._sent else now_ns
        self._sent.append(ts1)
        return ts1

    def answer(self, ts1_ns: int, tc1_ns: int, now_ns: int) -> str | None:
        """Take an answer; return why it cannot be used, or None. Answers to others' requests are no fault of anyone."""
        if ts1_ns not in self._sent:
            return None
        self._sent.remove(ts1_ns)
        round_trip_ns = now_ns - ts1_ns
        if not 0 <= round_trip_ns <= MAX_ROUND_TRIP_NS:
            return "timesync_slow"
        self._add(Sample(now_ns, round_trip_ns, tc1_ns - (ts1_ns + now_ns) // 2))
        return None

    def _add(self, sample: Sample) -> None:
        while self._samples and sample.t_ns - self._samples[0].t_ns > WINDOW_NS:
            self._samples.popleft()
        if self._samples and self._contradicts(sample):
            self._samples.clear()
            self._count = 0
            self.jumps += 1
        self._samples.append(sample)
        self._count += 1
        best = min(self._samples, key=lambda s: s.round_trip_ns)
        self.round_trip_ns = best.round_trip_ns
        if self.offset_ns is None or self._count <= SETTLED_COUNT:
            self.offset_ns = best.offset_ns
        else:
            self.offset_ns += max(-CREEP_NS, min(CREEP_NS, best.offset_ns - self.offset_ns))

    def _contradicts(self, sample: Sample) -> bool:
        """Tell whether the clock has jumped: the bounds of this sample and of the best one do not meet."""
        best = min(self._samples, key=lambda s: s.round_trip_ns)
        reach = (sample.round_trip_ns + best.round_trip_ns) // 2 + JUMP_MARGIN_NS
        return abs(sample.offset_ns - best.offset_ns) > reach

    def to_ours_ns(self, other_ns: int) -> int:
        """Return an instant of the other clock on ours; raises ValueError before the first round trip."""
        return other_ns - self._known()

    def to_other_ns(self, ours_ns: int) -> int:
        """Return an instant of our clock on the other; raises ValueError before the first round trip."""
        return ours_ns + self._known()

    def _known(self) -> int:
        if self.offset_ns is None:
            msg = "the other clock is not known yet"
            raise ValueError(msg)
        return self.offset_ns


def nearest_wrapped(value: int, period: int, expected: int) -> int:
    """Return the number congruent to ``value`` modulo ``period`` that lies nearest to ``expected``."""
    half = period // 2
    return expected + (value - expected + half) % period - half
