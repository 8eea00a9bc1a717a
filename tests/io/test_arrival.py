"""What arrival says about a stamp: bounds, lag, clocks that are not ours, reads that come late."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.io.arrival import MAX_AHEAD_NS, MAX_LAG_NS, WINDOW_NS, ArrivalBounds
from companion.io.datalink import FRAME_SIZE, TIME_PERIOD_NS, TankerReceiver, encode_frame
from companion.messages import Reject, TankerState

MS = 1_000_000
S = 1_000 * MS
BAUD = 19_600
ON_LINE_NS = 28_061_224


def frame_at(stamp_ns):
    return encode_frame(TankerState(stamp_ns, np.zeros(3), np.array([205.7, 0.0, 0.0]), np.eye(3), np.zeros(3)))


def test_a_frame_is_28_milliseconds_on_the_line():
    assert ArrivalBounds(BAUD).transmission_ns(FRAME_SIZE) == ON_LINE_NS


@given(st.integers(-150 * MS, 500 * MS), st.lists(st.integers(0, 28 * MS), min_size=20, max_size=60))
def test_the_lag_is_what_waiting_does_not_explain(behind_ns, waits_ns):
    """A sender whose clock is behind by ``behind``, frames that wait their turn: the least wait is left beside it."""
    bounds = ArrivalBounds(BAUD)
    bounds.read(2 * S)
    faults = set()
    for k, wait_ns in enumerate(waits_ns):
        sent_ns = 2 * S + k * 40 * MS
        now_ns = sent_ns + wait_ns + ON_LINE_NS
        faults.add(bounds.fault(sent_ns - behind_ns, FRAME_SIZE, bounds.read(now_ns), now_ns))
    if behind_ns < -MAX_AHEAD_NS - 28 * MS:
        assert faults == {"future_stamp"}
        assert bounds.lag_ns is None
    elif behind_ns >= -MAX_AHEAD_NS:
        assert bounds.lag_ns == behind_ns + min(waits_ns)
        longest = max(behind_ns + w for w in waits_ns)
        assert faults <= ({""} if longest <= MAX_LAG_NS else {"", "stale_stamp"})
    if behind_ns > MAX_LAG_NS + 100 * MS:  # between two reads there are 68 ms at most, and the first wait
        assert faults == {"stale_stamp"}


def test_the_lag_forgets():
    bounds = ArrivalBounds(BAUD)
    for t_ns, late_ns in ((0, 10 * MS), (S, 30 * MS), (S + WINDOW_NS, 40 * MS)):
        now_ns = t_ns + late_ns + ON_LINE_NS
        bounds.fault(t_ns, FRAME_SIZE, bounds.read(now_ns), now_ns)
    assert bounds.lag_ns == 40 * MS
    now_ns = 3 * S + WINDOW_NS + 50 * MS + ON_LINE_NS
    bounds.fault(3 * S + WINDOW_NS, FRAME_SIZE, bounds.read(now_ns), now_ns)
    assert bounds.lag_ns == 40 * MS


def outcomes(stamp_of, *, until_s=4.0, read_every_ms=5, hold=(9.9, 9.9), uncertain_ns=None):
    """Return what comes of a report every 40 ms, read every few ms but not during ``hold`` (s)."""
    receiver, events, line = TankerReceiver(0.0, BAUD), [], []
    start_ns, sent_ns = 100 * S, 100 * S
    for now_ns in range(start_ns, start_ns + int(until_s * S), read_every_ms * MS):
        while sent_ns + ON_LINE_NS <= now_ns:
            line.append(frame_at(stamp_of(sent_ns)))
            sent_ns += 40 * MS
        if hold[0] * S <= now_ns - start_ns < hold[1] * S:
            continue
        events += [(now_ns, e) for e in receiver.receive(b"".join(line), now_ns, 0, uncertain_ns)]
        line.clear()
    return receiver, events


def reasons(events):
    return [e.reason if isinstance(e, Reject) else "" for _, e in events]


def test_a_true_clock_is_believed_and_its_lag_is_the_reading():
    receiver, events = outcomes(lambda t_ns: t_ns)
    assert set(reasons(events)) == {""}
    assert 0 <= receiver.bounds.lag_ns <= 5 * MS


@pytest.mark.parametrize("behind_ms", [-90, 40, 200])
def test_a_small_constant_lag_is_left_to_the_filter(behind_ms):
    receiver, events = outcomes(lambda t_ns: t_ns - behind_ms * MS)
    assert set(reasons(events)) == {""}
    assert behind_ms * MS - 1 * MS <= receiver.bounds.lag_ns <= behind_ms * MS + 6 * MS


@pytest.mark.parametrize(
    ("off_s", "reason"), [(18.0, "future_stamp"), (-18.0, "stale_stamp"), (-37.0, "stale_stamp"), (-0.4, "stale_stamp"),
                          (0.2, "future_stamp"), (100.0, "future_stamp")],
)
def test_stamps_that_are_not_gps_time_are_found(off_s, reason):
    """18 s: UTC for GPS time; 37 s: TAI."""
    _, events = outcomes(lambda t_ns: t_ns + round(off_s * S))
    assert set(reasons(events)) == {reason}


@pytest.mark.parametrize(("step_s", "reason"), [(2.0, "future_stamp"), (-2.0, "stale_stamp"), (-0.5, "stale_stamp")])
def test_a_clock_that_steps_is_found_at_the_step(step_s, reason):
    _, events = outcomes(lambda t_ns: t_ns + (round(step_s * S) if t_ns >= 102 * S else 0))
    told = reasons(events)
    first = told.index(reason)
    assert set(told[:first]) == {""}
    assert set(told[first:]) == {reason}


def test_frames_that_have_waited_for_a_reader_are_good():
    """The companion was held up for a second: its frames are late, and true."""
    _, events = outcomes(lambda t_ns: t_ns, hold=(1.0, 2.0))
    assert set(reasons(events)) == {""}
    assert len(events) == 100


def test_what_is_older_than_two_seconds_is_stale_however_long_nobody_has_read():
    _, events = outcomes(lambda t_ns: t_ns, until_s=6.0, hold=(1.0, 5.0))
    told = reasons(events)
    stale = told.count("stale_stamp")
    assert stale == pytest.approx(50, abs=2)
    assert set(told[: told.index("stale_stamp")]) == {""} == set(told[told.index("stale_stamp") + stale :])


def test_stamps_wrap_every_256_seconds():
    wrap_ns = TIME_PERIOD_NS
    receiver = TankerReceiver(0.0, BAUD)
    for k in range(-50, 50):
        stamp_ns = 3 * wrap_ns + k * 40 * MS
        [state] = receiver.receive(frame_at(stamp_ns), stamp_ns + ON_LINE_NS, 0)
        assert isinstance(state, TankerState)
        assert abs(state.t_ns - stamp_ns) <= 8_000


@pytest.mark.parametrize("ahead_ms", [12, 20, 50, 90])
def test_a_clock_that_is_ahead_is_found_however_little_when_ours_is_known(ahead_ms):
    """Frames wait up to 8 ms for a reader: those too that would be possible by themselves are refused."""
    _, events = outcomes(lambda t_ns: t_ns + ahead_ms * MS, read_every_ms=8, uncertain_ns=1 * MS)
    assert set(reasons(events)[3:]) == {"future_stamp"}
    _, events = outcomes(lambda t_ns: t_ns + ahead_ms * MS, uncertain_ns=100 * MS)
    assert set(reasons(events)) == {""}, "within what our own time may err"


def test_a_single_stamp_ahead_takes_no_other_with_it():
    _, events = outcomes(lambda t_ns: t_ns + (40 * MS if t_ns == 101 * S else 0), uncertain_ns=1 * MS)
    told = reasons(events)
    assert told.count("future_stamp") == 1
    assert set(told) == {"", "future_stamp"}


@pytest.mark.parametrize("behind_ms", [0, 40, 200])
def test_a_clock_that_is_true_or_behind_is_never_ahead(behind_ms):
    _, events = outcomes(lambda t_ns: t_ns - behind_ms * MS, uncertain_ns=0)
    assert set(reasons(events)) == {""}
