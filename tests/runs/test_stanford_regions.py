"""Regions of the Stanford plot: by hand, and that every instant is in one and only one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_records import record_of, rows_of

from companion.config import WindowConfig
from sim_bridge.runs.plots import draw_stanford
from sim_bridge.runs.stanford import judge

WINDOW = WindowConfig()
ALERT = np.array([0.40, 1.87, 0.90])


def judged(error, protection, may_dock, true=(0.0, 0.0, 0.0), n=1):
    br = np.asarray(true) + error
    return judge(record_of(rows_of(
        n, br_true_m=true, br_m=br, protection_m=protection, alert_m=ALERT, may_dock=may_dock)), WINDOW)


def test_what_is_covered_is_nominal():
    found = judged((0.1, -0.2, 0.3), (0.2, 0.3, 0.4), 1.0)
    assert (found.nominal == 1).all()
    assert (found.told, found.allowed_count, found.held_back, found.false) == (1, 1, 0, False)


def test_an_error_beyond_its_protection_misleads():
    found = judged((0.3, -0.2, 0.3), (0.2, 0.3, 0.4), 1.0, n=4)
    assert found.misleading.tolist() == [4, 0, 0]
    assert found.nominal.tolist() == [0, 4, 4]
    assert found.false
    assert found.first_s == 0.0


def test_an_error_beyond_the_alert_limit_is_hazardous_whatever_the_protection():
    found = judged((0.1, -0.2, 1.0), (0.2, 0.3, 1.2), 1.0)
    assert found.hazardous.tolist() == [0, 0, 1]
    assert found.false


def test_nobody_docks_on_what_is_held_back():
    found = judged((9.0, 9.0, 9.0), (0.1, 0.1, 0.1), 0.0)
    assert not found.false
    assert found.held_back == 1
    assert found.refused.sum(axis=(1, 2)).tolist() == [1, 1, 1]
    assert found.allowed.sum() == 0


def test_truth_outside_the_limit_window_while_the_estimate_is_inside_is_false():
    found = judged((-0.1, 0.0, 0.0), (0.2, 0.3, 0.4), 1.0, true=(2.15, 0.0, 0.0))
    assert found.outside == 1
    assert found.false
    told = {"protection_m": 0.2, "alert_m": ALERT, "may_dock": 1.0}
    on_the_way = rows_of(1, br_true_m=(2.11, 0.0, 0.0), br_m=(2.09, 0.0, 0.0), **told)
    assert not judge(record_of(on_the_way, changes=((0.0, "standby"), (0.0, "approach"))), WINDOW).false
    assert judged((-0.02, 0.0, 0.0), (0.2, 0.3, 0.4), 1.0, true=(2.15, 0.0, 0.0)).outside == 0  # it knows


def test_without_an_estimate_or_integrity_nothing_is_judged():
    rows = rows_of(3, br_true_m=0.0, br_m=0.0, protection_m=0.1, alert_m=ALERT, may_dock=1.0)
    rows[0], rows[1] = rows_of(1, br_true_m=0.0)[0], rows_of(1, br_true_m=0.0, br_m=0.0)[0]
    assert judge(record_of(rows), WINDOW).told == 1


FINITE = st.floats(-1e4, 1e4, allow_subnormal=False)


@given(arrays(float, (5, 3), elements=FINITE), arrays(float, (5, 3), elements=st.floats(0.0, 1e6) | st.just(np.inf)),
       arrays(float, (5, 1), elements=st.sampled_from([0.0, 1.0])))
def test_every_instant_is_in_one_region_of_each_axis(error, protection, may_dock):
    rows = rows_of(5, br_true_m=0.0, br_m=error, protection_m=protection, alert_m=ALERT, may_dock=may_dock)
    found = judge(record_of(rows), WINDOW)
    assert (found.nominal + found.misleading + found.hazardous + found.held_back == found.told).all()
    assert (found.allowed + found.refused).sum(axis=(1, 2)).tolist() == [5, 5, 5]
    assert found.allowed.sum() == 3 * found.allowed_count
    beyond = (np.abs(error) > protection) | (np.abs(error) > ALERT)
    lied = (beyond & (may_dock == 1.0)).any()
    assert found.false == (lied or found.outside > 0)


def test_the_plot_is_drawn_with_nothing_and_with_something_in_it(tmp_path):
    nothing = judge(record_of(rows_of(2, br_true_m=0.0)), WINDOW)
    something = judged((0.3, 0.0, 0.0), (0.2, 0.3, np.inf), 1.0)
    for name, found in (("empty", [nothing]), ("some", [nothing, something])):
        draw_stanford(found, ALERT.tolist(), tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_what_lies_beyond_the_picture_is_in_its_last_bin():
    found = judged((0.0, 0.0, 0.0), (1e9, np.inf, 1e3), 0.0)
    assert found.refused[:, 0, -1].tolist()[:2] == [1, 1]
    assert found.refused.sum() == pytest.approx(3)
