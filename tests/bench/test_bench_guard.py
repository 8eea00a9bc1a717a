"""Time of the guard, beside what numpy takes to check and cut four numbers."""

import sys
import timeit
from pathlib import Path

import numpy as np
import pytest

from companion.messages import AttitudeSetpoint, OffsetSetpoint, Phase, VelocitySetpoint

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "guidance"))
from guard_views import DT_NS, new_guard, view_at  # beside the guard's tests

pytestmark = pytest.mark.bench

STEPS = 2000
LOW, HIGH = np.array([-0.35, -0.06, -3.2, 0.0]), np.array([0.35, 0.18, 3.2, 1.0])


def numpys_s():
    """Return what it takes to check four numbers and to cut them to limits: what any guard does at least."""
    wanted = np.array([0.1, 0.06, 0.2, 0.4])
    return min(timeit.repeat(lambda: np.isfinite(wanted).all() and np.clip(wanted, LOW, HIGH), number=STEPS, repeat=5))


def guards_s(make):
    """Return what ``cause`` and ``passes`` take for ``STEPS`` steps in the hold, all well."""
    views = [view_at(k * DT_NS, Phase.HOLD) for k in range(1, STEPS + 1)]
    wanted = [make(k * DT_NS) for k in range(1, STEPS + 1)]

    def run():
        guard = new_guard()
        for setpoint, view in zip(wanted, views, strict=True):
            assert guard.cause(view) is None
            guard.passes(setpoint, view)

    return min(timeit.repeat(run, number=1, repeat=5))


def test_guard():
    numpy_s = numpys_s()
    print(f"\nnumpy isfinite and clip of four numbers: {numpy_s / STEPS * 1e6:.2f} us")
    for name, make in (
        ("attitude", lambda t_ns: AttitudeSetpoint(t_ns, 0.02, 0.06, 0.1, 0.3)),
        ("velocity", lambda t_ns: VelocitySetpoint(t_ns, (205.7, 0.3, 0.1), 0.0)),
        ("offset", lambda t_ns: OffsetSetpoint(t_ns, (0.1, 0.2, 0.3), (205.7, 0.3, 0.1), 0.0)),
    ):
        seconds = guards_s(make)
        print(f"guard, {name}: {seconds / STEPS * 1e6:.2f} us a step, {seconds / numpy_s:.1f} of numpy's")
        assert seconds > 0.0
