"""The clock offset against a clock that is known, over ways that take time, drop, garble and lie."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.io.timesync import (
    CONFIRMATIONS,
    DRIFT,
    MARGIN_NS,
    MAX_SLEW,
    SETTLED_COUNT,
    STEP_NS,
    WRAP_MS,
    ClockOffset,
    nearest_wrapped,
)

MS = 1_000_000
S = 1_000 * MS

ways = st.tuples(st.integers(0, 90 * MS), st.integers(0, 90 * MS))
seeds = st.integers(0, 2**32)


def exchange(clock: ClockOffset, now_ns: int, offset_ns: int, there_ns: int, back_ns: int) -> str | None:
    """One round trip that takes ``there`` and ``back``."""
    ts1 = clock.request(now_ns)
    return clock.answer(ts1, ts1 + there_ns + offset_ns, now_ns + there_ns + back_ns)


def settled(offset_ns: int, way_ns: int = MS, until_ns: int = 10 * S) -> ClockOffset:
    """A clock that has had a round trip every 100 ms, the last of which began at ``until_ns``."""
    clock = ClockOffset()
    for t_ns in range(until_ns - (SETTLED_COUNT + 5) * 100 * MS, until_ns + 1, 100 * MS):
        exchange(clock, t_ns, offset_ns, way_ns, way_ns)
    assert clock.offset_ns == offset_ns
    return clock


@given(st.integers(-(2**60), 2**60), st.integers(0, 20 * MS))
def test_equal_ways_give_the_exact_offset(offset_ns: int, way_ns: int):
    clock = ClockOffset()
    assert clock.offset_ns is None
    exchange(clock, S, offset_ns, way_ns, way_ns)
    assert clock.offset_ns == offset_ns
    assert clock.to_ours_ns(clock.to_other_ns(123)) == 123


@given(seeds)
def test_the_error_stays_under_half_the_best_round_trip_and_the_drift_that_is_allowed(seed: int):
    rng = random.Random(seed)
    clock, offset_ns, best = ClockOffset(), 77 * S, None
    for i in range(20):
        there, back = rng.randrange(1, 60 * MS), rng.randrange(1, 60 * MS)
        assert exchange(clock, i * 100 * MS, offset_ns, there, back) is None
        best = min(best or there + back, there + back)
        assert clock.offset_ns is not None
        assert clock.round_trip_ns is not None
        assert best <= clock.round_trip_ns <= best + 2 * DRIFT * 2 * S
        assert abs(clock.offset_ns - offset_ns) <= clock.round_trip_ns // 2 + 1


def test_latency_with_queues_converges_below_half_a_millisecond():
    rng = random.Random(1)
    clock, offset_ns = ClockOffset(), -5 * S
    for i in range(20):
        there, back = (MS + int(rng.expovariate(1 / (3 * MS))) for _ in range(2))
        exchange(clock, i * 100 * MS, offset_ns, there, back)
    assert clock.offset_ns is not None
    assert abs(clock.offset_ns - offset_ns) < MS // 2


@given(st.integers(-(2**50), 2**50), ways)
def test_one_answer_over_unequal_ways_moves_nothing_beyond_its_bound(offset_ns: int, way: tuple[int, int]):
    clock = settled(offset_ns, 2 * MS)
    exchange(clock, 11 * S, offset_ns, *way)
    for t_ns in range(11 * S, 20 * S, 20 * MS):
        clock.slew(t_ns)
        assert abs(clock.offset_ns - offset_ns) <= min(sum(way) // 2, 2 * MS) + DRIFT * 2 * S
    assert clock.steps == 0


@given(st.integers(-(2**62), 2**62), st.integers(0, 50 * MS))
def test_one_wild_answer_moves_nothing_at_all(wild_ns: int, way_ns: int):
    clock = settled(5 * S)
    reason = exchange(clock, 11 * S, wild_ns, way_ns, way_ns)
    moved = abs(wild_ns - 5 * S)
    if moved > way_ns + 2 * MS + MARGIN_NS + DRIFT * 3 * S:
        assert reason == "timesync_outlier"
    exchange(clock, 12 * S, 5 * S, MS, MS)
    clock.slew(13 * S)
    assert abs(clock.offset_ns - 5 * S) <= min(moved, way_ns + 1)
    assert not clock.doubtful
    assert clock.take_step() == 0


@given(seeds)
def test_a_peer_that_answers_garbage_between_good_answers_changes_nothing(seed: int):
    rng = random.Random(seed)
    clock = settled(5 * S)
    for i in range(60):
        good = rng.random() < 0.5
        ts1 = clock.request(11 * S + i * 100 * MS)
        tc1 = ts1 + 5 * S + MS if good else rng.choice([0, 1, -1, 2**63 - 1, rng.randrange(2**62)])
        reason = clock.answer(ts1, tc1, ts1 + 2 * MS)
        assert (reason is None) == good
    assert clock.offset_ns == 5 * S


def test_a_clock_that_stands_still_is_never_believed():
    clock = settled(5 * S)
    for i in range(100):
        ts1 = clock.request(11 * S + i * 100 * MS)
        assert clock.answer(ts1, 7 * S, ts1 + 2 * MS) == "timesync_outlier"
    assert clock.offset_ns == 5 * S


@pytest.mark.parametrize("step_ns", [-503 * S, -290 * MS, -STEP_NS - 1, STEP_NS + 1, 250 * MS, 10**6 * S])
def test_a_step_is_believed_after_a_few_answers_that_agree(step_ns: int):
    clock = settled(500 * S)
    for k in range(CONFIRMATIONS):
        assert clock.offset_ns == 500 * S
        assert clock.take_step() == 0
        exchange(clock, 11 * S + k * 100 * MS, 500 * S + step_ns, MS, MS)
    assert clock.offset_ns == 500 * S + step_ns
    assert clock.take_step() == step_ns
    assert (clock.take_step(), clock.steps) == (0, 1)


@given(seeds)
def test_a_step_is_found_among_answers_that_are_held_up(seed: int):
    rng = random.Random(seed)
    clock = settled(0)
    for i in range(10):
        there, back = rng.randrange(1, 60 * MS), rng.randrange(1, 60 * MS)
        exchange(clock, 11 * S + i * 100 * MS, -290 * MS, there, back)
    assert clock.steps >= 1
    assert abs(clock.offset_ns + 290 * MS) <= 60 * MS
    for t_ns in range(12 * S, 20 * S, 20 * MS):
        clock.slew(t_ns)
    assert abs(clock.offset_ns + 290 * MS) <= clock.round_trip_ns // 2 + MS


def test_the_first_answer_may_have_been_wild():
    clock = ClockOffset()
    exchange(clock, S, 10**9 * S, MS, MS)
    for i in range(CONFIRMATIONS):
        exchange(clock, 2 * S + i * 100 * MS, 5 * S, MS, MS)
    assert clock.offset_ns == 5 * S
    assert clock.take_step() == 5 * S - 10**9 * S


@given(st.integers(6 * MS - STEP_NS, STEP_NS - 6 * MS), st.integers(1, 100))
def test_what_is_no_step_is_glided_to(off_ns: int, every_ms: int):
    clock = settled(0)
    last_ns = 10 * S + 2 * MS
    for t_ns in range(11 * S, 40 * S, every_ms * MS):
        before = clock.offset_ns
        if t_ns // (100 * MS) != last_ns // (100 * MS):
            exchange(clock, t_ns - 2 * MS, off_ns, MS, MS)
        clock.slew(t_ns)
        assert abs(clock.offset_ns - before) <= MAX_SLEW * (t_ns - last_ns) + 1
        last_ns = t_ns
    assert clock.take_step() == 0
    assert abs(clock.offset_ns - off_ns) <= 2 * MARGIN_NS + MS  # what the two bounds leave open


@given(st.floats(-1e-4, 1e-4), seeds)
def test_drift_of_crystals_is_followed(drift: float, seed: int):
    rng = random.Random(seed)
    clock = settled(0, until_ns=0)
    for i in range(120):
        there, back = MS + rng.randrange(3 * MS), MS + rng.randrange(3 * MS)
        t_ns = (1 + i) * S
        assert exchange(clock, t_ns, int(drift * t_ns), there, back) is None
        for k in range(50):
            clock.slew(t_ns + k * 20 * MS)
        assert abs(clock.offset_ns - drift * (t_ns + S)) <= 4 * MS
    assert clock.steps == 0


@given(st.permutations(range(8)))
def test_answers_out_of_order_are_as_good(order: list[int]):
    clock = ClockOffset()
    sent = [clock.request(S + k * MS) for k in range(8)]
    for place, k in enumerate(order):
        now_ns = S + (20 + place) * MS
        assert clock.answer(sent[k], 9 * S + (sent[k] + now_ns) // 2, now_ns) is None
    assert clock.offset_ns == 9 * S


def test_slow_strange_and_repeated_answers_are_not_used():
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
