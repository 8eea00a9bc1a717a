"""The running latency of each input, against numbers that are known, and through the service."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.io.clock import SimulatedClock
from companion.io.recorder import RunRecorder
from companion.latencies import TOLD_NS, WINDOW_NS, LatencyMonitor
from companion.messages import InputLatency, OwnAttitude, OwnPosition, Reject, TankerState, Tick
from companion.runtime import Service

MS = 1_000_000
S = 1_000 * MS
V = np.array([200.0, 0.0, 50.0])


@given(st.lists(st.integers(-50, 900), min_size=1, max_size=50), st.floats(0.0, 400.0))
def test_figures_are_those_of_the_samples(late_ms, speed):
    monitor = LatencyMonitor()
    assert monitor.due(0, speed) == []
    for k, late in enumerate(late_ms):
        monitor.arrived("camera", k * 20 * MS - late * MS, k * 20 * MS)
    [told] = monitor.due(S, speed)
    assert (told.t_ns, told.source) == (S, "camera")
    assert told.mean_s == pytest.approx(np.mean(late_ms) / 1e3)
    assert told.jitter_s == pytest.approx(np.std(late_ms) / 1e3, abs=1e-9)
    assert told.worst_s == pytest.approx(max(late_ms) / 1e3)
    assert told.cost_m == pytest.approx(told.mean_s * speed)


def test_it_tells_once_a_second_and_forgets():
    monitor = LatencyMonitor()
    told = []
    for t_ns in range(0, 3 * S, 20 * MS):
        monitor.arrived("attitude", t_ns - 7 * MS, t_ns)
        told += monitor.due(t_ns)
    assert [t.t_ns for t in told] == [TOLD_NS, 2 * TOLD_NS]
    assert monitor.due(3 * S + WINDOW_NS) == []


def test_events_tell_source_latency_and_speed():
    monitor = LatencyMonitor()
    monitor.due(0)
    monitor.event(OwnAttitude(90 * MS, np.eye(3), np.zeros(3)), 100 * MS)
    monitor.event(OwnPosition(80 * MS, np.zeros(3), V), 100 * MS)
    monitor.event(TankerState(40 * MS, np.zeros(3), V, np.eye(3), np.zeros(3)), 100 * MS)
    monitor.event(Tick(0), 100 * MS)
    monitor.event(Reject(0, "camera", "silent"), 100 * MS)
    told = {t.source: t for t in monitor.due(S)}
    assert {source: round(t.mean_s * 1e3) for source, t in told.items()} == {
        "attitude": 10, "position": 20, "datalink": 60}
    assert told["datalink"].cost_m == pytest.approx(0.06 * np.linalg.norm(V))


class Sink:
    """Where nothing has to leave."""

    def send(self, setpoint):
        raise AssertionError(setpoint)

    def health(self, health):
        pass

    def phase(self, phase):
        raise AssertionError(phase)


def test_the_service_records_and_shows_what_each_input_costs(tmp_path):
    setup, clock, seen = load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml"), SimulatedClock(), []
    with RunRecorder(tmp_path, setup) as recorder:
        service = Service(setup, clock, Sink(), recorder, seen.append)
        for t_ns in range(100 * MS, 2 * S, 20 * MS):
            clock.set_ns(t_ns)
            service.dispatch(OwnPosition(t_ns - 30 * MS, V * (t_ns / S), V))
            service.dispatch(Tick(t_ns))
        recorder.write_summary({})
    told = [o for o in seen if isinstance(o, InputLatency)]
    assert [(t.source, t.t_ns) for t in told] == [("position", 1100 * MS)]
    summary = json.loads((tmp_path / "summary.json").read_text())["input_latency"]["position"]
    assert summary["mean_s"] == pytest.approx(0.03)
    assert summary["cost_m"] == pytest.approx(0.03 * np.linalg.norm(V))
