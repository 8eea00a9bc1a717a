"""The clock offset against a clock that is known, over ways that take time."""

import random

from hypothesis import given
from hypothesis import strategies as st

from companion.io.timesync import WRAP_MS, ClockOffset, nearest_wrapped

MS = 1_000_000
S = 1_000 * MS


def exchange(clock: ClockOffset, now_ns: int, offset_ns: int, there_ns: int, back_ns: int) -> str | None:
    """One round trip that takes ``there`` and ``back``."""
    ts1 = clock.request(now_ns)
    return clock.answer(ts1, ts1 + there_ns + offset_ns, now_ns + there_ns + back_ns)


@given(st.integers(-(2**60), 2**60), st.integers(0, 20 * MS))
def test_equal_ways_give_the_exact_offset(offset_ns: int, way_ns: int):
    clock = ClockOffset()
    assert clock.offset_ns is None
    exchange(clock, S, offset_ns, way_ns, way_ns)
    assert clock.offset_ns == offset_ns
    assert clock.to_ours_ns(clock.to_other_ns(123)) == 123


@given(st.integers(0, 2**32))
def test_the_error_stays_under_half_the_best_round_trip(seed: int):
    rng = random.Random(seed)
    clock, offset_ns, best = ClockOffset(), 77 * S, None
    for i in range(20):
        there, back = rng.randrange(1, 60 * MS), rng.randrange(1, 60 * MS)
        assert exchange(clock, i * 100 * MS, offset_ns, there, back) is None
        best = min(best or there + back, there + back)
        assert clock.offset_ns is not None
        assert abs(clock.offset_ns - offset_ns) <= best // 2 + 1
    assert clock.round_trip_ns == best
    assert clock.jumps == 0


def test_latency_with_queues_converges_below_half_a_millisecond():
    rng = random.Random(1)
    clock, offset_ns = ClockOffset(), -5 * S
    for i in range(20):
        there, back = (MS + int(rng.expovariate(1 / (3 * MS))) for _ in range(2))
        exchange(clock, i * 100 * MS, offset_ns, there, back)
    assert clock.offset_ns is not None
    assert abs(clock.offset_ns - offset_ns) < MS // 2


def test_a_rebooted_clock_is_followed_at_once():
    clock = ClockOffset()
    for i in range(10):
        exchange(clock, i * S, 500 * S, MS, MS)
    exchange(clock, 10 * S, -3 * S, 2 * MS, 2 * MS)
    assert clock.offset_ns == -3 * S
    assert clock.jumps == 1


def test_drift_is_followed():
    clock = ClockOffset()
    for i in range(60):
        exchange(clock, i * S, 50_000 * i, MS, MS)  # 50 us a second
    assert clock.offset_ns is not None
    assert abs(clock.offset_ns - 50_000 * 59) <= 550_000


def test_a_settled_offset_creeps_to_a_better_one():
    clock = ClockOffset()
    for i in range(20):
        exchange(clock, i * 100 * MS, 0, 5 * MS, 3 * MS)
    assert clock.offset_ns == MS
    offsets = []
    for i in range(20):
        exchange(clock, (3 + i) * S, 0, MS, MS)
        offsets.append(clock.offset_ns)
    assert offsets[0] == 900_000
    assert offsets[-1] == 0
    assert clock.jumps == 0


def test_slow_and_strange_answers_are_not_used():
    clock = ClockOffset()
    assert exchange(clock, S, 0, 150 * MS, 150 * MS) == "timesync_slow"
    assert clock.offset_ns is None
    ts1 = clock.request(2 * S)
    assert clock.answer(ts1 + 1, 99 * S, 2 * S + MS) is None  # not ours
    assert clock.offset_ns is None
    assert clock.answer(ts1, 99 * S, 2 * S) is None
    assert clock.answer(ts1, 7 * S, 2 * S + MS) is None  # the same answer again
    assert clock.offset_ns == 97 * S


@given(st.integers(0, 2**50), st.integers(-(2**31) + 1, 2**31 - 1))
def test_wrapped_milliseconds_come_back_near_the_expected(true_ms: int, error_ms: int):
    assert nearest_wrapped(true_ms % WRAP_MS, WRAP_MS, true_ms + error_ms) == true_ms
