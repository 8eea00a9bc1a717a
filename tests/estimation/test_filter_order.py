from dataclasses import replace

import filter_scene as fs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FilterConfig
from companion.estimation.filter_history import FilterHistory
from companion.estimation.filter_state import SIZE, Offset
from companion.estimation.filter_steps import Steps

C = FilterConfig()
DRAWN = fs.draw(11, length_s=2.6, frames_from_s=0.6)


def fed(measurements, horizon_s=C.horizon_s):
    history = FilterHistory(Steps(C, fs.MARKERS), horizon_s)
    outcomes = [history.take(m) for m in measurements]
    return history.newest, outcomes


@settings(max_examples=25)
@given(st.randoms(use_true_random=False), st.floats(0.0, 0.5))
def test_the_estimate_does_not_depend_on_the_order_of_arrival(random, latest_s):
    """Each measurement arrives up to so late, which is within the horizon."""
    arrivals = [(m.t_ns + random.uniform(0.0, latest_s) * fs.S, m) for m in DRAWN.measurements]
    mixed = [m for _, m in sorted(arrivals, key=lambda a: a[0])]
    expected, _ = fed(DRAWN.measurements)
    found, _ = fed(mixed)
    assert found.t_ns == expected.t_ns
    assert (found.x == expected.x).all()
    assert (found.cov == expected.cov).all()
    assert (found.sight_ns, found.gps_ns, found.ready) == (expected.sight_ns, expected.gps_ns, True)


def test_what_is_older_than_the_horizon_is_told_and_changes_nothing():
    late, rest = DRAWN.measurements[3], DRAWN.measurements[:3] + DRAWN.measurements[4:]
    expected, _ = fed(rest)
    found, outcomes = fed([*rest, late])
    assert outcomes[-1] == "too_old"
    assert (found.x == expected.x).all()


def test_what_comes_twice_is_told_and_changes_nothing():
    expected, _ = fed(DRAWN.measurements)
    found, outcomes = fed([*DRAWN.measurements, DRAWN.measurements[-1]])
    assert outcomes[-1] == "twice"
    assert (found.cov == expected.cov).all()


def test_an_estimate_at_an_instant_rests_on_nothing_after_it():
    history = FilterHistory(Steps(C, fs.MARKERS), C.horizon_s)
    for m in DRAWN.measurements:
        history.take(m)
    t_ns = DRAWN.measurements[-1].t_ns - 300 * fs.MS
    assert history.before(t_ns).t_ns <= t_ns < history.newest.t_ns
    assert np.trace(history.before(t_ns).cov[:3, :3]) > 0


@pytest.mark.parametrize("old_s", [0.2, 100.0])
def test_a_position_put_anew_explains_gps_by_bias_and_lag_and_only_by_a_young_difference(old_s):
    c = FilterConfig()
    steps, rng = Steps(c, fs.MARKERS), np.random.default_rng(1)
    place, lag_s, t_ns = np.array([-30.0, -3.0, 12.0]), 0.01, 200 * fs.S
    truth = np.zeros(SIZE)
    truth[0:3], truth[15] = place + np.array([1.5, -1.0, 1.0]), lag_s
    e = steps.unknown(t_ns)
    e.x[0:3], e.x[9:12], e.x[15] = place, [0.5, 0.5, 0.5], lag_s
    e.cov[:] = np.diag(np.repeat([0.02, 0.01, 1e-3, 0.3, 1e-3, 1e-5], [3, 3, 3, 3, 3, 1]) ** 2)
    gps = Offset(t_ns - round(old_s * fs.S), place + np.full(3, 7.0) + fs.V_TANKER * lag_s)
    e = replace(e, ready=True, sight_ns=t_ns, gps_offset=gps)
    sigma, reasons = np.full(9, 0.035 / fs.FOCAL_PX), []
    while "position_anew" not in reasons and len(reasons) < 40:
        t_ns += 20 * fs.MS
        e, outcome = steps.take(e, fs.frame_of(rng, t_ns, truth, np.zeros(3), sigma, c, 9, 0.1))
        reasons.append(outcome.updates[0].reason)
        if old_s < 1.0:
            e = replace(e, gps_offset=replace(gps, t_ns=t_ns))
    assert reasons[-1] == "position_anew"
    moved = truth[0:3] - place
    bias = np.array([7.0, 7.0, 7.0]) - moved if old_s < 1.0 else np.array([0.5, 0.5, 0.5]) - moved
    assert np.abs(e.x[9:12] - bias).max() < 0.1
