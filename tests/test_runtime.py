"""The drivers' parts: the ticker, the watch over sources, and the live loop on the machine's clock."""

import threading
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.io.clock import MonotonicClock, SimulatedClock
from companion.io.recorder import RunRecorder, read_records
from companion.messages import AutopilotMode, AutopilotStatus, Phase, Reject, Tick
from companion.runtime import SILENCE_NS, Service, Ticker, Watched, in_phase_s, run_live

S = 1_000_000_000
PERIOD_NS = 20_000_000


@given(st.lists(st.integers(0, 90_000_000), min_size=1, max_size=200))
def test_ticks_and_slips_together_are_the_deadlines_that_have_passed(steps_ns):
    ticker, now_ns, ticks = Ticker(50.0, 0), 0, 0
    for step_ns in steps_ns:
        now_ns += step_ns
        ticks += ticker.due(now_ns)
        assert not ticker.due(now_ns)  # never a burst
        assert ticks + ticker.slips == now_ns // PERIOD_NS + 1


def test_a_tick_in_time_is_no_slip():
    ticker = Ticker(50.0, 0)
    assert all(ticker.due(k * PERIOD_NS + 3_000_000) for k in range(100))
    assert ticker.slips == 0
    assert ticker.due(110 * PERIOD_NS)
    assert ticker.slips == 10


class Source:
    """What is put in comes out at the next poll."""

    def __init__(self):
        self.events = []
        self.closed = False

    def poll(self):
        events, self.events = self.events, []
        return events

    def close(self):
        self.closed = True


@pytest.fixture
def watched():
    clock, source = SimulatedClock(), Source()
    return clock, source, Watched(source, clock, "camera", "tcp://127.0.0.1:1", "is the camera running?")


def after(clock, watched, ns):
    clock.set_ns(clock.now_ns() + ns)
    return watched.poll()


def test_silence_is_told_once_per_silence(watched):
    clock, source, watch = watched
    assert watch.poll() == []
    assert after(clock, watch, SILENCE_NS - 1) == []
    told = after(clock, watch, 1)
    text = "nothing for 3 s at tcp://127.0.0.1:1: is the camera running?"
    assert told == [Reject(SILENCE_NS, "camera", "silent", text)]
    assert after(clock, watch, 10 * S) == []
    source.events = [Tick(0)]
    assert watch.poll() == [Tick(0)]
    assert [e.reason for e in after(clock, watch, SILENCE_NS)] == ["silent"]


def test_what_only_gives_rejects_is_told_with_the_reason(watched):
    clock, source, watch = watched
    watch.poll()
    wrong = Reject(0, "camera", "wrong_size", "640x480 instead of 320x200")
    source.events = [wrong]
    assert after(clock, watch, S) == [wrong]
    [told] = after(clock, watch, 2 * S)
    assert told.detail == "nothing usable for 3 s at tcp://127.0.0.1:1: wrong_size, 640x480 instead of 320x200"


def test_a_source_that_speaks_is_never_called_silent(watched):
    clock, source, watch = watched
    for _ in range(100):
        source.events = [Tick(0)]
        assert after(clock, watch, S) == [Tick(0)]
    watch.close()
    assert source.closed


class Sink:
    def send(self, setpoint):
        raise AssertionError(setpoint)

    def health(self, health):
        assert not health.well

    def phase(self, phase):
        raise AssertionError(phase)


def service_on(clock, folder):
    setup = load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")
    recorder = RunRecorder(folder, setup)
    return Service(setup, clock, Sink(), recorder), recorder


def test_the_live_loop_ticks_at_its_rate_and_passes_every_event(tmp_path):
    clock, source = MonotonicClock(), Source()
    service, recorder = service_on(clock, tmp_path)
    source.events = [AutopilotStatus(k, AutopilotMode.GUIDED, True) for k in range(10)]
    done = threading.Event()
    timer = threading.Timer(0.5, done.set)
    timer.start()
    start_ns = clock.now_ns()
    slips = run_live(service, [source], clock, 50.0, done.is_set)
    seconds = (clock.now_ns() - start_ns) / S
    recorder.close()
    records = list(read_records(tmp_path / "events.jsonl"))
    count = Counter((r["kind"], r["dir"]) for r in records)
    assert count["AutopilotStatus", "in"] == 10
    assert count["Tick", "in"] + slips == pytest.approx(50 * seconds, abs=2)
    late = [r for r in records if r["kind"] == "Reject" and r["dir"] == "out"]
    assert sum(int(r["detail"].split()[0]) for r in late) == slips
    stamps = [r["t_ns"] for r in records if r["kind"] == "Tick"]
    assert stamps == sorted(stamps)
    assert in_phase_s(service, Phase.HOLD, clock.now_ns()) == 0.0
