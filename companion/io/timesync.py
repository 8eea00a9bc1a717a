"""Where the autopilot's clock stands against ours, from the round trips of TIMESYNC.

A request leaves at ``ts1`` on our clock and comes back at ``now`` with the autopilot's instant ``tc1`` in between, so

    tc1 - now <= offset <= tc1 - ts1:  the middle is at most half the round trip off, however unequal the two ways are.

Rules
-----
* A bound widens with age, by what two crystals drift apart (100 ppm each). The sample whose bound is narrowest now
  gives the target: an answer that was held up is wide and moves nothing.
* An answer whose bound does not meet those of the window is an outlier, and moves nothing, until ``CONFIRMATIONS`` in
  a row agree with each other: then the other clock has stepped, and the window begins anew with them.
* The offset glides to its target: two positions are differenced whose stamps may lie on both sides of a change, and at
  206 m/s 1 ms is 0.2 m. At ``MAX_SLEW`` two stamps 70 ms apart differ by 0.35 ms too much or too little.
* What is too far for gliding is a step, which ``take_step`` tells: what was stamped before must not be put beside what
  comes after. Until it has settled the offset goes to its target at once, and tells that as well.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

WINDOW_NS = 10_000_000_000
MAX_ROUND_TRIP_NS = 200_000_000
MARGIN_NS = 1_000_000
"""Two bounds that miss each other by less still agree: clocks are read in steps, and not right at the wire."""
DRIFT = 2e-4
SETTLED_COUNT = 20
"""Samples until which the offset takes its target at once."""
STEP_NS = 20_000_000
UNSETTLED_STEP_NS = 1_000_000
SLEW_TIME_NS = 2_000_000_000
MAX_SLEW = 5e-3
CONFIRMATIONS = 3
SUSPECT_NS = 2_000_000_000
"""Outliers further apart do not confirm each other."""
WRAP_MS = 1 << 32


@dataclass(frozen=True, slots=True)
class Sample:
    """One round trip: when it ended on our clock, and the bounds of the offset at that instant."""

    t_ns: int
    low_ns: int
    high_ns: int

    @property
    def offset_ns(self) -> int:
        """Return the middle."""
        return (self.low_ns + self.high_ns) // 2

    @property
    def round_trip_ns(self) -> int:
        """Return how long the round trip took."""
        return self.high_ns - self.low_ns

    def widened(self, now_ns: int) -> tuple[int, int]:
        """Return the bounds at a later instant."""
        drift_ns = int(DRIFT * (now_ns - self.t_ns))
        return self.low_ns - drift_ns, self.high_ns + drift_ns

    def agrees(self, others: Sequence[Sample]) -> bool:
        """Tell whether one offset is within the bounds of this sample and of all earlier ones."""
        bounds = [other.widened(self.t_ns) for other in others]
        low_ns = max((low for low, _ in bounds), default=self.low_ns)
        high_ns = min((high for _, high in bounds), default=self.high_ns)
        return self.low_ns - MARGIN_NS <= high_ns and low_ns <= self.high_ns + MARGIN_NS


class ClockOffset:
    """Offset of another clock against ours: ``other = ours + offset_ns``; None before the first round trip.

    ``steps`` counts the steps; ``round_trip_ns`` is that of the sample that gives the target.
    """

    def __init__(self) -> None:
        self.offset_ns: int | None = None
        self.round_trip_ns: int | None = None
        self.steps = 0
        self._sent: deque[int] = deque(maxlen=32)
        self._samples: deque[Sample] = deque()
        self._suspects: list[Sample] = []
        self._count = 0
        self._target_ns = 0
        self._slewed_ns = 0
        self._step_ns = 0

    @property
    def doubtful(self) -> bool:
        """Tell whether the last answer did not agree with those before."""
        return bool(self._suspects)

    @property
    def uncertain_ns(self) -> int | None:
        """Return by how much ``offset_ns`` may be wrong: half the round trip, and what it has yet to slew.

        None before the first round trip, and while an answer contradicts those before.
        """
        if self.offset_ns is None or self.round_trip_ns is None or self.doubtful:
            return None
        return self.round_trip_ns // 2 + abs(self._target_ns - self.offset_ns)

    def request(self, now_ns: int) -> int:
        """Note that a request leaves now; return its ``ts1``, which is never one that is still under way."""
        ts1 = max(now_ns, self._sent[-1] + 1) if self._sent else now_ns
        self._sent.append(ts1)
        return ts1

    def answer(self, ts1_ns: int, tc1_ns: int, now_ns: int) -> str | None:
        """Take an answer; return why it is not used, or None. Answers to others' requests are no fault of anyone."""
        if ts1_ns not in self._sent:
            return None
        self._sent.remove(ts1_ns)
        if not 0 <= now_ns - ts1_ns <= MAX_ROUND_TRIP_NS:
            return "timesync_slow"
        return self._take(Sample(now_ns, tc1_ns - now_ns, tc1_ns - ts1_ns))

    def _take(self, sample: Sample) -> str | None:
        while len(self._samples) > 1 and sample.t_ns - self._samples[0].t_ns > WINDOW_NS:
            self._samples.popleft()
        if sample.agrees(self._samples):
            if not sample.agrees(self._suspects):  # one that is wide may agree with both
                self._suspects = []
            self._samples.append(sample)
        elif not self._confirmed(sample):
            return "timesync_outlier"
        self._count += 1
        best = min(self._samples, key=lambda s: s.round_trip_ns // 2 + int(DRIFT * (sample.t_ns - s.t_ns)))
        self.round_trip_ns, self._target_ns = best.round_trip_ns, best.offset_ns
        self._approach(sample.t_ns)
        return None

    def _confirmed(self, sample: Sample) -> bool:
        """Keep an outlier; True when there are enough that agree, and they have become the window."""
        recent = [s for s in self._suspects if sample.t_ns - s.t_ns <= SUSPECT_NS]
        self._suspects = [*recent, sample] if sample.agrees(recent) else [sample]
        if len(self._suspects) < CONFIRMATIONS:
            return False
        self._samples, self._suspects = deque(self._suspects), []
        return True

    def _approach(self, now_ns: int) -> None:
        """Go to the target: at once at the beginning, by a step when it is far, else a little."""
        off_ns = 0 if self.offset_ns is None else self._target_ns - self.offset_ns
        settled = self._count > SETTLED_COUNT
        far = abs(off_ns) > (STEP_NS if settled else UNSETTLED_STEP_NS)
        if far:
            self.steps += 1
            self._step_ns += off_ns
        if self.offset_ns is None or far or not settled:
            self.offset_ns, self._slewed_ns = self._target_ns, now_ns
        else:
            self.slew(now_ns)

    def slew(self, now_ns: int) -> None:
        """Let the offset glide towards its target; call this often."""
        if self.offset_ns is None or now_ns <= self._slewed_ns:
            return
        passed_ns, self._slewed_ns = now_ns - self._slewed_ns, now_ns
        off_ns = self._target_ns - self.offset_ns
        most_ns = min(MAX_SLEW * passed_ns, abs(off_ns) * min(1.0, passed_ns / SLEW_TIME_NS))
        self.offset_ns += round(most_ns if off_ns > 0 else -most_ns)

    def take_step(self) -> int:
        """Return by how much the offset has stepped since the last call, in ns; 0 for not at all."""
        step_ns, self._step_ns = self._step_ns, 0
        return step_ns

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
