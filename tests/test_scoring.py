"""The score of a flight, on series whose score is known."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.config import WindowConfig
from companion.messages import Phase, PhaseChange
from sim_bridge.scenario import Scenario
from sim_bridge.scoring import Safety, Series, score, statistics
from sim_bridge.truth import BodyState, BoomState, Truth

WINDOW = WindowConfig()
SCENARIO = Scenario(name="s", companion="c.toml", hold_s=20.0)
HOLD_FROM_S = 30.0
STEP_S = 0.02


def approach(hold_br: np.ndarray) -> Series:
    """From 45 m behind a straight way into B within 30 s, then the given BR (n, 3)."""
    n = round(HOLD_FROM_S / STEP_S)
    way = np.linspace(1.0, 0.0, n, endpoint=False)[:, None] * [-45.0, -20.0, 30.0]
    br = np.vstack([way, hold_br])
    return np.arange(len(br)) * round(1e9 * STEP_S), br


def change(t_s: float, old: Phase, new: Phase) -> PhaseChange:
    return PhaseChange(round(1e9 * t_s), old, new, f"to {new}")


ENTERED = [change(HOLD_FROM_S, Phase.APPROACH, Phase.HOLD)]
STILL = np.zeros((round(20.0 / STEP_S), 3))


def excursion(axis: int, br_m: float, seconds: float) -> np.ndarray:
    br = STILL.copy()
    br[100 : 100 + round(seconds / STEP_S), axis] = br_m
    return br


def test_a_perfect_flight() -> None:
    s = score(approach(STILL), ENTERED, WINDOW, SCENARIO)
    assert s["docked"]
    assert s["hold_s"] == pytest.approx(20.0)
    assert s["in_window_fraction"] == 1.0
    assert s["br_mean_m"] == s["br_sigma_m"] == s["br_max_m"] == [0.0, 0.0, 0.0]
    assert s["br_rms_3d_m"] == 0.0
    assert s["breakaway"] is None
    # y is inside at 1.87 of 20 m, z at 0.9 of 30, x last, at 0.4 of 45: 0.267 s before the end of 30 s.
    assert s["time_to_window_s"] == pytest.approx(29.74)


@pytest.mark.parametrize(
    ("br_m", "axis", "seconds", "docked", "share"),
    [
        (0.5, 0, 0.5, True, 0.975),  # outside desired for a moment
        (0.5, 0, 1.2, False, 0.94),  # outside desired for too long
        (-1.9, 1, 0.5, True, 0.975),
        (-2.2, 1, 0.02, False, 0.999),  # one sample outside the limit
        (2.5, 2, 0.5, True, 0.975),
        (2.6, 2, 0.02, False, 0.999),
        (0.40, 0, 20.0, True, 1.0),  # the edge is inside
    ],
)
def test_window_and_limit(br_m: float, axis: int, seconds: float, docked: bool, share: float) -> None:
    s = score(approach(excursion(axis, br_m, seconds)), ENTERED, WINDOW, SCENARIO)
    assert s["docked"] is docked
    assert s["in_window_fraction"] == pytest.approx(share, abs=1e-3)
    assert s["br_max_m"][axis] == abs(br_m)


def test_what_happens_before_and_after_the_hold_does_not_count() -> None:
    t_ns, br = approach(np.vstack([STILL, np.full((500, 3), 9.0)]))
    s = score((t_ns, br), ENTERED, WINDOW, SCENARIO)
    assert s["docked"]
    assert s["br_max_m"] == [0.0, 0.0, 0.0]


def test_a_hold_cut_short_is_not_docked() -> None:
    s = score(approach(STILL[:500]), ENTERED, WINDOW, SCENARIO)
    assert not s["docked"]
    assert s["hold_s"] == pytest.approx(10.0)
    assert s["in_window_fraction"] == 1.0


def test_a_breakaway_ends_the_hold_and_is_told() -> None:
    phases = [*ENTERED, change(HOLD_FROM_S + 5.0, Phase.HOLD, Phase.BREAKAWAY)]
    s = score(approach(STILL), phases, WINDOW, SCENARIO)
    assert not s["docked"]
    assert s["hold_s"] == pytest.approx(5.0)
    assert s["breakaway"] == "to breakaway"


def test_the_last_hold_counts() -> None:
    phases = [
        *ENTERED,
        change(HOLD_FROM_S + 1.0, Phase.HOLD, Phase.STANDBY),
        change(HOLD_FROM_S + 2.0, Phase.APPROACH, Phase.HOLD),
    ]
    br = np.vstack([STILL, np.zeros((100, 3))])
    br[20] = 5.0  # in the first hold
    assert score(approach(br), phases, WINDOW, SCENARIO)["docked"]


def test_a_breakaway_as_the_hold_completes_does_not_undo_it() -> None:
    phases = [*ENTERED, change(HOLD_FROM_S + 20.01, Phase.HOLD, Phase.BREAKAWAY)]
    assert score(approach(STILL), phases, WINDOW, SCENARIO)["docked"]


def test_without_a_hold_nothing_is_claimed() -> None:
    for series in (approach(STILL), (np.empty(0, dtype=np.int64), np.empty((0, 3)))):
        s = score(series, [], WINDOW, SCENARIO)
        assert s["docked"] is False
        assert s["hold_s"] == 0.0
        assert s["in_window_fraction"] == 0.0
        assert s["br_mean_m"] is s["br_rms_3d_m"] is None
    assert s["time_to_window_s"] is None


def test_the_score_is_plain_json() -> None:
    s = score(approach(STILL), ENTERED, WINDOW, SCENARIO)
    assert msgspec.json.decode(msgspec.json.encode(s)) == s


@given(arrays(np.float64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.floats(-100.0, 100.0)))
def test_statistics_agree_with_each_other(br: np.ndarray) -> None:
    s = statistics(br)
    mean, absolute, sigma, largest = (np.array(s[k]) for k in ("br_mean_m", "br_abs_mean_m", "br_sigma_m", "br_max_m"))
    assert s["br_rms_3d_m"] ** 2 == pytest.approx(float((mean**2 + sigma**2).sum()), abs=1e-9)
    assert (np.abs(mean) <= absolute + 1e-9).all()
    assert (absolute <= largest + 1e-9).all()


@given(st.integers(0, 2), st.floats(-3.0, 3.0), st.integers(0, 1000))
def test_more_time_outside_never_scores_better(axis: int, br_m: float, samples: int) -> None:
    shorter = score(approach(excursion(axis, br_m, samples * STEP_S / 2)), ENTERED, WINDOW, SCENARIO)
    longer = score(approach(excursion(axis, br_m, samples * STEP_S)), ENTERED, WINDOW, SCENARIO)
    assert longer["in_window_fraction"] <= shorter["in_window_fraction"]
    assert shorter["docked"] or not longer["docked"]


# ---- safety ----------------------------------------------------------------------------------------------------------

BROKE = [change(1.0, Phase.APPROACH, Phase.HOLD), change(2.0, Phase.HOLD, Phase.BREAKAWAY)]


def body(p_ned_m, t_ns) -> BodyState:
    zero = np.zeros(3)
    return BodyState(t_ns, np.array(p_ned_m, dtype=float), zero, np.eye(3), zero, zero, zero)


def watched(way) -> Safety:
    """Return the score of a receiver at places (n, 3) below the tanker, BR with it, 50 Hz."""
    safety = Safety(WINDOW)
    box_to_centre = np.array([-30.0, 0.0, 10.0])
    for k, br in enumerate(way):
        t_ns = k * 20_000_000
        boom = BoomState(np.zeros(3), 0.5, 0.0, 10.0)
        truth = Truth(t_ns, body(box_to_centre + br, t_ns), body((0.0, 0.0, 0.0), t_ns), boom, np.zeros(10))
        safety.see(truth, np.array(br, dtype=float))
    return safety


def still(seconds, br=(0.0, 0.0, 0.0)):
    return [br] * round(seconds * 50)


@pytest.mark.parametrize(("way", "outside_m"), [
    (still(3.0), 0.0),
    (still(1.5) + still(0.1, (0.0, 2.4, 0.0)) + still(1.4), 0.3),  # beside the box in the hold
    (still(1.5) + still(0.1, (-2.3, 0.0, 0.0)) + still(1.4), 0.2),  # behind it in the hold
    (still(2.0) + still(1.0, (-20.0, 5.0, 20.0)), 0.0),  # aft, down and beside it in a breakaway
    (still(2.5) + still(0.5, (2.5, 0.0, 0.0)), 0.4),  # forward of it in a breakaway
    (still(2.5) + still(0.5, (0.0, 0.0, -3.0)), 0.44),  # above it in a breakaway
    (still(0.5, (9.0, 0.0, 0.0)) + still(2.5), 0.0),  # before the first engagement
])
def test_the_limit_box_below_the_tanker_is_not_left(way, outside_m) -> None:
    assert watched(way).result(BROKE)["outside_limit_m"] == pytest.approx(outside_m)


@pytest.mark.parametrize(("reason", "outside_m"), [
    ("pilot took over", 0.0), ("killed", 0.9), ("autopilot left guided", 0.9), ("operator's clear", 0.9)])
def test_in_standby_only_a_pilot_may_be_ahead_of_the_box(reason, outside_m) -> None:
    left = PhaseChange(round(2.0e9), Phase.HOLD, Phase.STANDBY, reason)
    told = watched(still(2.5) + still(0.5, (3.0, 0.0, 0.0))).result([BROKE[0], left])
    assert told["outside_limit_m"] == pytest.approx(outside_m)
    before = PhaseChange(0, Phase.STANDBY, Phase.STANDBY, "")  # as a record of many flights begins
    assert watched(still(0.5, (9.0, 0.0, 0.0)) + still(2.5)).result([before, *BROKE])["outside_limit_m"] == 0.0


def test_a_collision_is_a_centre_of_mass_in_the_space_of_the_tanker() -> None:
    clear, hit = watched(still(3.0)).result(BROKE), watched([*still(3.0), (1.0, 0.0, -5.0)]).result(BROKE)
    assert (clear["collision"], clear["closest_m"]) == (False, 4.0)
    assert (hit["collision"], hit["closest_m"]) == (True, 0.0)


@pytest.mark.parametrize(("fault_s", "delay_s"), [(1.6, 0.4), (2.0, 0.0), (2.1, None), (None, None)])
def test_the_delay_of_a_breakaway_counts_from_the_fault(fault_s, delay_s) -> None:
    told = watched(still(3.0)).result(BROKE, None if fault_s is None else round(1e9 * fault_s))
    assert told["breakaway_delay_s"] == (None if delay_s is None else pytest.approx(delay_s))


def test_nothing_seen_is_nothing_said() -> None:
    assert set(Safety(WINDOW).result(BROKE).values()) == {None}
