"""How long integrity takes for a frame and for an answer."""

import time

import numpy as np
import pytest
from integrity_scenes import World, fly, monitor

pytestmark = pytest.mark.bench

FRAME_MS, ANSWER_MS = 0.3, 0.05


def test_cost():
    watcher, w = monitor(), World(np.random.default_rng(1))
    fly(watcher, w, 50)
    frames = [w.frame() for _ in range(300)]
    seen_ns, said_ns = [], []
    for outputs, state, _ in frames:
        sources = w.sources()
        start_ns = time.perf_counter_ns()
        for output in outputs:
            watcher.see(output)
        between_ns = time.perf_counter_ns()
        watcher.at(state, sources)
        seen_ns.append(between_ns - start_ns)
        said_ns.append(time.perf_counter_ns() - between_ns)
    frame_ms, answer_ms = np.median(seen_ns) * 1e-6, np.median(said_ns) * 1e-6
    print(f"\nintegrity: a frame {frame_ms:.3f} ms ({frame_ms / FRAME_MS:.2f} of its budget), "
          f"an answer {answer_ms:.3f} ms ({answer_ms / ANSWER_MS:.2f})")
    assert len(seen_ns) == 300
