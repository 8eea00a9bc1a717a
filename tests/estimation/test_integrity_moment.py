"""What can be wrong this very moment: refused frames, stale sources, what nothing has judged yet."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_scenes import FRAME_NS, S, World, monitor

from companion.estimation.integrity_moment import FRESH_S, SETTLE_S, STAMPS_S
from companion.estimation.integrity_sources import REFUSALS
from companion.estimation.plausibility import LET_THROUGH_M_S, LET_THROUGH_RAD
from companion.geometry import SE3, exp_so3
from companion.messages import FilterUpdate, Sources

SETTLED_FRAMES = round(SETTLE_S * S / FRAME_NS)


def world(**fields):
    return World(np.random.default_rng(5), **fields)


def told(watcher, w, *, frames=1, reason="", change=lambda fused: fused):
    """Show frames, each with what the filter says of it, and return what is said after the last."""
    for _ in range(frames):
        (seen, fused), state, _ = w.frame()
        for output in (seen, FilterUpdate(w.t_ns, "pixels", 18.0, 18, reason), change(fused)):
            watcher.see(output)
    return watcher.at(state, w.sources()), state


@pytest.fixture
def settled():
    """Return a monitor that has let dock, and its world."""
    watcher, w = monitor(), world()
    assert told(watcher, w, frames=20)[0].may_dock
    return watcher, w


@pytest.mark.parametrize("reason", sorted(REFUSALS))
def test_no_dock_while_the_newest_frame_is_refused_nor_before_some_have_been_taken_since(settled, reason):
    watcher, w = settled
    refused, _ = told(watcher, w, reason=reason)
    assert not refused.may_dock
    assert (refused.faults, refused.notes) == ((), ("unsettled",))
    for _ in range(SETTLED_FRAMES - 1):
        assert not told(watcher, w)[0].may_dock
    again, _ = told(watcher, w)
    assert again.may_dock
    assert again.notes == ()


def test_a_single_marker_or_a_gps_fix_that_is_refused_is_no_refused_frame(settled):
    watcher, w = settled
    _, state = told(watcher, w)
    for source in ("marker 3", "gps"):
        watcher.see(FilterUpdate(w.t_ns, source, 99.0, 2, "gate"))
    assert watcher.at(state, w.sources()).may_dock
    assert told(watcher, w)[0].may_dock


@pytest.mark.parametrize("name", sorted(FRESH_S))
def test_no_dock_on_a_stale_source_nor_before_frames_have_been_taken_since(settled, name):
    watcher, w = settled
    _, state = told(watcher, w)
    field = {"datalink": "tanker_ns"}.get(name, f"{name}_ns")

    def aged(age_s):
        return replace(w.sources(), **{field: w.t_ns - round(age_s * S)})

    assert watcher.at(state, aged(FRESH_S[name] - 0.05)).notes == ()
    old = watcher.at(state, aged(FRESH_S[name] + 0.01))
    assert not old.may_dock
    assert (old.faults, old.notes) == ((), (f"stale {name}",))
    assert np.isfinite(old.protection_mrf_m).all()
    assert watcher.at(state, w.sources()).notes == ("unsettled",)  # it is back, but nothing has judged it yet
    assert not told(watcher, w, frames=SETTLED_FRAMES - 1)[0].may_dock
    assert told(watcher, w)[0].may_dock


def test_a_restart_forgets_doubts_and_frames(settled):
    watcher, w = settled
    told(watcher, w, reason="gate")
    watcher.restart()
    assert told(watcher, w, frames=20)[0].may_dock


@pytest.mark.parametrize("off_m", [(0.5, 0.0, 0.0), (0.0, -0.4, 0.0), (0.0, 0.0, 1.2)])
def test_what_the_newest_frame_says_is_protected_against_at_once(settled, off_m):
    """An estimate that jumps is caught by the first frame: a mean over a quarter of a second would halve it."""
    watcher, w = settled
    before, state = told(watcher, w)
    R_cam_ned = state.T_cam_tanker.R  # a tanker that flies level and north: its axes are those of ned and mrf

    def jumped(fused):
        T = fused.T_cam_tanker
        return replace(fused, T_cam_tanker=SE3(T.R, T.t - R_cam_ned @ np.array(off_m)))

    after, _ = told(watcher, w, change=jumped)
    there = np.array(off_m) != 0.0
    assert (after.protection_mrf_m[there] > np.abs(off_m)[there]).all()
    assert (before.protection_mrf_m < 0.3).all()


def test_an_attitude_of_the_tanker_that_the_frame_contradicts_is_protected_against_on_the_lever(settled):
    watcher, w = settled
    _, state = told(watcher, w)
    lever_m = float(np.linalg.norm(state.T_cam_tanker.t))
    pitched = state.T_cam_tanker.R @ exp_so3(np.array([0.0, 0.03, 0.0]))
    after, _ = told(watcher, w, change=lambda f: replace(f, T_cam_tanker=SE3(pitched, f.T_cam_tanker.t)))
    assert after.protection_mrf_m[2] > 0.9 * 0.03 * lever_m


def test_what_nothing_has_judged_since_the_newest_frame_is_protected_against(settled):
    watcher, w = settled
    _, state = told(watcher, w)
    still = watcher.at(state, w.sources()).protection_mrf_m
    assert still[2] > LET_THROUGH_RAD * 25.0
    closing = replace(state, v_mrf_br_m_s=np.array([1.0, 0.0, -2.0]))
    fast = watcher.at(closing, w.sources()).protection_mrf_m
    assert fast[0] > 1.0 * STAMPS_S
    assert fast[2] > 2.0 * STAMPS_S
    t_ns = w.t_ns + S // 5
    later = watcher.at(replace(state, t_ns=t_ns), Sources(t_ns, t_ns, t_ns, w.t_ns)).protection_mrf_m
    assert (later > LET_THROUGH_M_S * 0.2).all()


@pytest.mark.parametrize("field", ["position_ns", "tanker_ns"])
def test_an_aircraft_that_tells_nothing_may_have_moved(settled, field):
    watcher, w = settled
    _, state = told(watcher, w)
    new = watcher.at(state, w.sources()).protection_mrf_m
    old = watcher.at(state, replace(w.sources(), **{field: w.t_ns - S // 5})).protection_mrf_m
    np.testing.assert_allclose(old - new, 0.5 * 6.0 * 0.2**2)
