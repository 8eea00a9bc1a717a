"""One table of stages and how long each may take; the result table shows it beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Budget:
    """``p99_ms`` is what the 99th percentile of the stage should stay under; ``what`` is for people."""

    p99_ms: float
    what: str


BUDGETS: dict[str, Budget] = {
    "transport": Budget(30.0, "mid-exposure to the picture's arrival"),
    "vision": Budget(10.0, "detection, labeling, pose"),
    "fusion": Budget(1.0, "filter or blend"),
    "integrity": Budget(1.0, "tests and separations of a frame"),
    "guidance": Budget(3.0, "estimate, integrity, phase, path, law, guard"),
    "send": Budget(1.0, "setpoint to bytes on the link"),
    "exposure_to_setpoint": Budget(50.0, "mid-exposure to the first setpoint that rests on it"),
}
