"""How late each input's content is when it arrives, as it goes on, and what ignoring that would cost.

The latency of a sample is its arrival less its stamp: exposure, transmission, queues and what the clocks are apart. It
is what has to be bridged by inertial data; at 206 m/s ten milliseconds are two metres. No clock: instants come in.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.messages import NS, CameraFrame, Event, InputLatency, MarkerFrame, OwnAttitude, OwnPosition, TankerState

WINDOW_NS = 5_000_000_000
TOLD_NS = 1_000_000_000

INPUTS: dict[type, str] = {
    CameraFrame: "camera", MarkerFrame: "camera", OwnAttitude: "attitude", OwnPosition: "position",
    TankerState: "datalink",
}  # fmt: skip


class LatencyMonitor:
    """Keeps the latencies of the last ``WINDOW_NS`` by source, and tells once a second."""

    def __init__(self) -> None:
        self._samples: dict[str, deque[tuple[int, int]]] = {}
        self._due_ns: int | None = None
        self._speed_m_s = 0.0

    def event(self, event: Event, now_ns: int) -> None:
        """Take an event that arrives at ``now_ns``; what is no input with a latency is left alone."""
        source = INPUTS.get(type(event))
        if source is None:
            return
        self.arrived(source, event.t_ns, now_ns)
        if isinstance(event, OwnPosition):
            self._speed_m_s = float(np.sqrt(event.v_ned_m_s @ event.v_ned_m_s))

    def arrived(self, source: str, stamp_ns: int, now_ns: int) -> None:
        """Note that content of ``stamp_ns`` has come at ``now_ns``."""
        self._samples.setdefault(source, deque()).append((now_ns, now_ns - stamp_ns))

    def due(self, now_ns: int, speed_m_s: float | None = None) -> list[InputLatency]:
        """Return the figures of every source heard in the window, once a second; else nothing.

        ``speed_m_s``: of the receiver; by default that of its last position.
        """
        if self._due_ns is None:
            self._due_ns = now_ns + TOLD_NS
        if now_ns < self._due_ns:
            return []
        self._due_ns = now_ns + TOLD_NS
        speed = self._speed_m_s if speed_m_s is None else speed_m_s
        told = []
        for source, samples in sorted(self._samples.items()):
            while samples and now_ns - samples[0][0] > WINDOW_NS:
                samples.popleft()
            if samples:
                late_s = NS * np.array([late_ns for _, late_ns in samples], dtype=float)
                mean_s, jitter_s = float(late_s.mean()), float(late_s.std())
                told.append(InputLatency(now_ns, source, mean_s, jitter_s, float(late_s.max()), mean_s * speed))
        return told
