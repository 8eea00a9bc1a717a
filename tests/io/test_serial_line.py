"""The serial line: pacing by arithmetic, then pyserial on a real pty."""

import os
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import ConfigError
from companion.io.clock import MonotonicClock
from companion.io.datalink import FRAME_SIZE, SerialDatalink, encode_frame
from companion.messages import Event, Reject, TankerState
from sim_bridge.datalink import PtyLink, SerialPacer

BAUD = 19_600
S = 1_000_000_000
MS = 1_000_000
CLOCK = MonotonicClock()


def frame_at(t_ns: int) -> bytes:
    return encode_frame(TankerState(t_ns, np.zeros(3), np.array([205.7, 0.0, 0.0]), np.eye(3), np.zeros(3)))


@pytest.fixture
def line(tmp_path: Path) -> Iterator[PtyLink]:
    opened = PtyLink(BAUD, tmp_path / "tanker")
    yield opened
    opened.close()
    opened.close()


@pytest.fixture
def datalink(line: PtyLink, tmp_path: Path) -> Iterator[SerialDatalink]:
    opened = SerialDatalink(f"{tmp_path / 'tanker'},{BAUD}", CLOCK, 0.0, lambda: 0)
    yield opened
    opened.close()
    opened.close()


def poll_until(datalink: SerialDatalink, line: PtyLink | None = None, timeout_s: float = 2.0) -> list[Event]:
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        if line is not None:
            line.pump(CLOCK.now_ns())
        events = datalink.poll()
        if events:
            return events
        time.sleep(0.001)
    return []


def test_a_frame_takes_28_milliseconds():
    pacer = SerialPacer(BAUD)
    data = bytes(range(FRAME_SIZE))
    pacer.write(data, S)
    assert pacer.due(S) == b""
    assert pacer.due(S + 510_000) == b""  # a byte is 10 bits of 51 us
    assert pacer.due(S + 511_000) == data[:1]
    assert pacer.due(S + 28_061_000) == data[1:-1]
    assert pacer.due(S + 28_062_000) == data[-1:]
    assert pacer.due(S + 9 * S) == b""


@given(
    st.lists(st.tuples(st.integers(0, 60 * MS), st.booleans()), max_size=60), st.sampled_from([1200, 19_600, 115_200])
)
def test_what_comes_out_is_what_went_in_and_never_faster_than_the_line(steps: list[tuple[int, bool]], baud: int):
    pacer, now_ns, accepted, out = SerialPacer(baud), 0, b"", b""
    for i, (wait_ns, write) in enumerate(steps):
        now_ns += wait_ns
        out += pacer.due(now_ns)
        assert len(out) * 10 <= baud * now_ns // S
        frame = bytes([i]) * FRAME_SIZE
        if write and pacer.write(frame, now_ns):
            accepted += frame
    assert out == accepted[: len(out)]
    assert out + pacer.due(now_ns + 10 * S) == accepted
    assert len(accepted) // FRAME_SIZE + pacer.dropped == sum(write for _, write in steps)


def test_a_line_that_is_asked_too_much_drops_frames_and_stays_fresh():
    pacer, delays, out = SerialPacer(BAUD), [], b""
    for now_ns in range(0, 2 * S, 10 * MS):  # 100 Hz on a line for 35.6 Hz
        pacer.write(now_ns.to_bytes(FRAME_SIZE, "big"), now_ns)
        out += pacer.due(now_ns)
        while len(out) >= FRAME_SIZE:
            delays.append(now_ns - int.from_bytes(out[:FRAME_SIZE], "big"))
            out = out[FRAME_SIZE:]
    assert len(delays) in (69, 70, 71)
    assert pacer.dropped > 100
    assert max(delays) < 70 * MS


def test_frames_come_through_pyserial_at_the_pace_of_the_line(line: PtyLink, datalink: SerialDatalink):
    arrivals: list[int] = []
    next_ns = start_ns = CLOCK.now_ns()
    while (now_ns := CLOCK.now_ns()) < start_ns + S:
        if now_ns >= next_ns:
            line.write(frame_at(now_ns), now_ns)
            next_ns += 10 * MS
        line.pump(now_ns)
        events = datalink.poll()
        assert all(isinstance(event, TankerState) for event in events)
        arrivals += [CLOCK.now_ns()] * len(events)
        time.sleep(0.0005)
    assert 25 <= len(arrivals) <= 36
    assert 27.0 < statistics.median(np.diff(arrivals)) / MS < 30.0
    assert line.lost == 0


def test_the_first_partial_frame_is_dropped_and_old_bytes_are_flushed(line: PtyLink, tmp_path: Path):
    os.write(line._master, frame_at(CLOCK.now_ns()) * 3)  # what a line has kept from before
    time.sleep(0.02)
    datalink = SerialDatalink(f"{tmp_path / 'tanker'},{BAUD}", CLOCK, 0.0, lambda: 0)
    os.write(line._master, frame_at(CLOCK.now_ns())[30:])
    now_ns = CLOCK.now_ns()
    os.write(line._master, frame_at(now_ns))
    time.sleep(0.05)
    states = [event for event in datalink.poll() if isinstance(event, TankerState)]
    datalink.close()
    assert len(states) == 1
    assert abs(states[0].t_ns - now_ns) < 8_000


def test_noise_on_the_line_is_counted(line: PtyLink, datalink: SerialDatalink):
    line.write(b"\x00noise", CLOCK.now_ns() - S)
    [event] = poll_until(datalink, line)
    assert isinstance(event, Reject)
    assert (event.source, event.reason) == ("datalink", "garbage")


def test_a_line_that_breaks_is_told_and_taken_up_again(tmp_path: Path):
    line = PtyLink(BAUD, tmp_path / "tanker")
    datalink = SerialDatalink(f"{tmp_path / 'tanker'},{BAUD}", CLOCK, 0.0, lambda: 0)
    line.close()
    [event] = poll_until(datalink)
    assert isinstance(event, Reject)
    assert event.reason == "device_lost"
    assert datalink.poll() == []
    time.sleep(0.12)
    assert datalink.poll() == []  # a try while there is nothing
    line = PtyLink(BAUD, tmp_path / "tanker")
    assert poll_until(datalink, timeout_s=0.6) == []  # long enough for the next try
    line.write(frame_at(CLOCK.now_ns()), CLOCK.now_ns())
    events = poll_until(datalink, line)
    assert isinstance(events[0], TankerState)
    datalink.close()
    assert datalink.poll() == []
    line.close()


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("/dev/no-such-line,19600", "datalink /dev/no-such-line: no such device; plug it in"),
        ("/dev/null,19600", "datalink /dev/null: not a usable serial device"),
        ("/dev/ttyUSB0", "not DEVICE,BAUD"),
        ("/dev/ttyUSB0,fast", "not DEVICE,BAUD"),
        ("/dev/ttyUSB0,0", "not DEVICE,BAUD"),
        (",19600", "not DEVICE,BAUD"),
    ],
)
def test_a_device_that_cannot_be_opened_is_one_clear_line(spec: str, text: str):
    with pytest.raises(ConfigError, match=text) as caught:
        SerialDatalink(spec, CLOCK, 0.0, lambda: 0)
    assert "\n" not in str(caught.value)


def test_a_device_has_one_reader(datalink: SerialDatalink, tmp_path: Path):
    with pytest.raises(ConfigError, match="in use by another program"):
        SerialDatalink(f"{tmp_path / 'tanker'},{BAUD}", CLOCK, 0.0, lambda: 0)


def test_the_stable_name_comes_and_goes_with_the_line(tmp_path: Path):
    name = tmp_path / "tanker"
    name.symlink_to("/dev/pts/nothing-here-any-more")  # left by a crash
    line = PtyLink(BAUD, name)
    assert str(name.readlink()) == line.device
    line.close()
    assert not name.is_symlink()


def test_a_name_taken_over_by_another_line_is_left_alone(tmp_path: Path):
    first, second = (PtyLink(BAUD, tmp_path / "tanker") for _ in range(2))
    first.close()
    assert str((tmp_path / "tanker").readlink()) == second.device
    second.close()


def test_a_name_that_cannot_be_had_is_one_clear_line(tmp_path: Path):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(ConfigError, match="exists and is no link"):
        PtyLink(BAUD, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "precious"
    with pytest.raises(ConfigError, match="cannot be made"):
        PtyLink(BAUD, tmp_path / "no-such-folder" / "tanker")


def test_bytes_that_nobody_reads_are_lost_and_the_writer_never_waits(tmp_path: Path):
    line = PtyLink(4_000_000, tmp_path / "tanker")
    now_ns = 0
    started = time.monotonic()
    for _ in range(3000):
        line.write(bytes(FRAME_SIZE), now_ns)
        now_ns += MS
        line.pump(now_ns)
    line.close()
    assert line.lost > 0
    assert time.monotonic() - started < 2.0
