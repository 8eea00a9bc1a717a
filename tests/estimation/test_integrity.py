"""Integrity: what protection promises, which faults are found how soon, and that there are none without one."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from integrity_scenes import CONFIG, FRAME_NS, LIGHTS, MARKERS, S, World, first_s, fly, monitor
from scipy.special import ndtri

from companion.config import IntegrityConfig
from companion.config.estimation import integrity_rules
from companion.messages import FilterState, FilterUpdate, Reject, Sources

NINE = tuple(range(9))


def world(seed=1, **fields):
    return World(np.random.default_rng(seed), **fields)


def moved(marker, off_m):
    table = np.zeros_like(MARKERS)
    table[marker] = off_m
    return table


def last(watcher, w, frames=40):
    return fly(watcher, w, frames)[-1][0]


def again(watcher, w, **changed):
    """Return what a monitor says of the last frame's state with other fields."""
    _, state, _ = w.frame()
    return watcher.at(replace(state, **changed), w.sources())


# -- what protection promises ------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-3, 2.0), st.floats(1.0, 10.0))
def test_protection_grows_with_sigma_and_is_never_below_its_multiple(sigma_m, factor):
    watcher, w = monitor(), world()
    last(watcher, w, 10)
    _, state, _ = w.frame()
    small, large = (
        watcher.at(replace(state, cov_mrf_br_m2=sigma**2 * np.eye(3)), w.sources()).protection_mrf_m
        for sigma in (sigma_m, factor * sigma_m)
    )
    k = float(-ndtri(CONFIG.risk / 4.0))
    assert (small >= k * sigma_m).all()
    assert (large >= small - 1e-12).all()
    assert (large <= factor * small + 1e-12).all()  # what does not come from sigma does not grow with it


def test_protection_is_wider_for_less_risk():
    levels = [last(monitor(msgspec.structs.replace(CONFIG, risk=risk)), world()).protection_mrf_m
              for risk in (1e-3, 1e-5, 1e-7)]
    assert (np.diff(levels, axis=0) > 0.0).all()


def test_the_alert_limit_is_the_desired_window_at_the_box_and_wider_along_the_approach():
    at_box, behind = last(monitor(), world()), last(monitor(), world(br_m=(-15.0, 0.0, 5.0)))
    assert np.allclose(at_box.alert_mrf_m, [0.40, 1.87, 0.90], atol=0.01)
    assert np.allclose(behind.alert_mrf_m - [0.40, 1.87, 0.90], CONFIG.alert_growth * np.hypot(15.0, 5.0), atol=0.01)
    assert at_box.may_dock
    assert behind.may_dock


def test_no_dock_when_protection_is_beyond_the_alert_limit():
    watcher, w = monitor(), world()
    last(watcher, w)
    poor = again(watcher, w, cov_mrf_br_m2=np.diag([0.1, 0.01, 0.01]) ** 2)
    assert poor.protection_mrf_m[0] > poor.alert_mrf_m[0]
    assert not poor.may_dock
    assert poor.faults == ()


def test_once_surely_within_the_limit_window_the_receiver_must_stay_so():
    watcher, w = monitor(), world()
    assert last(watcher, w).may_dock
    assert not again(watcher, w, p_mrf_br_m=np.array([-2.08, 0.0, 0.0])).may_dock
    assert again(watcher, w, p_mrf_br_m=np.array([-3.5, 0.0, 0.0])).may_dock  # on its way out, aft
    assert again(watcher, w, p_mrf_br_m=np.array([-2.08, 0.0, 0.0])).may_dock  # and on its way in again


def test_on_the_edge_of_the_limit_window_nothing_flickers_and_who_waits_outside_may_come_again():
    watcher, w = monitor(), world(br_m=np.array([-3.5, 0.0, 0.0]))
    last(watcher, w)
    _, state, _ = w.frame()
    edge = [replace(state, p_mrf_br_m=np.array([x, 0.0, 0.0])) for x in (-2.0, -1.8, -2.0, -1.8, -2.05)]
    assert all(watcher.at(s, w.sources()).may_dock for s in edge)
    entered = replace(state, p_mrf_br_m=np.zeros(3))
    assert watcher.at(entered, w.sources()).may_dock
    assert not watcher.at(edge[-1], w.sources()).may_dock
    for _ in range(70):  # 3.5 s
        _, state, _ = w.frame()
        last(watcher, w, 1)
        outside = replace(state, p_mrf_br_m=np.array([-2.9, 0.0, 0.0]))
        answer = watcher.at(outside, w.sources())
    assert answer.may_dock


def test_nothing_seen_is_no_fault_and_no_leave_to_dock():
    watcher, w = monitor(), world()
    _, state, _ = w.frame()
    never = watcher.at(state, Sources(state.t_ns, state.t_ns, state.t_ns, None))
    assert (never.may_dock, never.faults, never.notes) == (False, (), ("unseen",))
    assert np.isfinite(never.protection_mrf_m).all()
    assert (never.protection_mrf_m >= 1e3).all()
    last(watcher, w)
    sight_ns = w.t_ns
    for late_s, known in ((0.3, True), (0.5, False)):
        t_ns = sight_ns + round(late_s * S)
        later = watcher.at(replace(state, t_ns=t_ns), Sources(t_ns, t_ns, t_ns, sight_ns))
        assert later.may_dock is known
        assert ("unseen" in later.notes) is not known


def test_markers_that_simulated_vision_projects_are_not_seen():
    """From the start, and after real ones: what GPS says is no proof of what GPS says."""

    def projected(watcher, w, frames):
        for _ in range(frames):
            (seen, fused), state, _ = w.frame()
            seen.detections.sigma_px[:] = 0.0
            watcher.see(seen)
            watcher.see(fused)
        return watcher.at(state, w.sources())

    never = projected(monitor(), world(), 40)
    assert (never.may_dock, never.faults, never.notes) == (False, (), ("unseen",))
    assert (never.protection_mrf_m >= 1e3).all()
    watcher, w = monitor(), world()
    assert last(watcher, w).may_dock
    assert not projected(watcher, w, 20).may_dock
    assert last(watcher, w).may_dock


@pytest.mark.parametrize("seen", [NINE[:5], NINE[:6], NINE[:8], NINE])
def test_five_to_nine_markers_protect_a_contact(seen):
    assert last(monitor(), world(seen=seen)).may_dock


def test_ten_markers_protect_a_contact(monkeypatch):
    extra = msgspec.structs.replace(LIGHTS[0], id=10, p_tanker_m=(5.0, 4.0, 1.5))
    monkeypatch.setattr("integrity_scenes.MARKERS", np.vstack((MARKERS, extra.p_tanker_m)))
    zero = {"moved_m": np.zeros((10, 3)), "lasting_px": np.zeros((10, 2)), "seen": tuple(range(10))}
    assert last(monitor(lights=(*LIGHTS, extra)), world(**zero)).may_dock


def after_nine(seen, frames=10):
    watcher, w = monitor(), world()
    last(watcher, w)
    w.seen = seen
    return last(watcher, w, frames)


def test_few_markers_protect_less_and_one_not_at_all():
    levels = [after_nine(seen).protection_mrf_m for seen in (NINE, (1, 2, 3, 7), (1, 7))]
    assert levels[2][0] > levels[1][0] > levels[0][0]  # along the sight
    alone = after_nine((7,))
    assert not alone.may_dock
    assert alone.faults == ()
    assert (alone.protection_mrf_m >= 1e3).all()


def test_few_markers_from_the_start_say_nothing_of_the_mount():
    flown = fly(monitor(), world(seen=(1, 2, 3, 7), mount_rad=(0.0, 0.02, 0.0)), 40)
    assert all(i.faults == () and not i.may_dock for i, _ in flown)
    assert all((np.abs(error_m) < i.protection_mrf_m).all() for i, error_m in flown)


def test_what_nine_markers_have_shown_of_three_is_remembered():
    watcher, w = monitor(), world()
    last(watcher, w)
    w.seen = (1, 2, 7)
    after = last(watcher, w, 10).protection_mrf_m
    fresh = last(monitor(), world(seen=(1, 2, 7)), 10).protection_mrf_m
    assert (after < 0.5 * fresh).all()
    later = last(watcher, w, 400).protection_mrf_m
    assert (later > after).all()


# -- faults ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("marker", NINE)
def test_a_marker_that_jumps_in_the_hold_is_found_within_half_a_second(marker):
    watcher, w = monitor(), world().usual()
    assert last(watcher, w).faults == ()
    w.moved_m = w.moved_m + moved(marker, [0.0, 0.3, 0.0])
    flown = fly(watcher, w, 12)
    assert first_s(flown, f"marker {LIGHTS[marker].id}") <= 0.5
    assert not flown[-1][0].may_dock


def test_a_marker_five_centimetres_off_is_found_in_the_hold():
    found = [first_s(fly(monitor(), world(seed, moved_m=moved(7, [0.0, 0.06, 0.0])), 100), "marker 8")
             for seed in range(5)]
    assert max(found) <= 5.0


def test_a_light_beside_its_place_is_found_although_it_has_no_label():
    rest = tuple(i for i in NINE if i != 4)
    w = world(moved_m=moved(4, [0.0, 0.4, 0.0]), seen=rest)
    flown = fly(monitor(), w, 100)
    assert 2.0 <= first_s(flown, "marker 5") <= 3.0


def test_markers_that_boom_or_edge_hide_are_no_fault():
    class Hidden(World):
        def detections(self, T_cam_tanker):
            found = super().detections(T_cam_tanker)
            uv = found.uv_px.copy()
            uv[[7, 8]] = self.rng.uniform([150.0, 100.0], [450.0, 250.0], (2, 2))  # glints, somewhere else each time
            return replace(found, uv_px=uv)

    w = Hidden(np.random.default_rng(4), seen=NINE[:7])
    flown = fly(monitor(), w, 200)
    assert all(i.faults == () and i.may_dock for i, _ in flown)


@pytest.mark.parametrize("axis", range(2))
def test_a_camera_mounted_a_degree_off_is_found_within_a_second(axis):
    turn = np.zeros(3)
    turn[axis] = np.radians(1.0)
    flown = fly(monitor(), world(br_m=(-15.0, 0.0, 5.0), mount_rad=tuple(turn)), 40)
    assert first_s(flown, "boresight") <= 1.0
    # The blend flies on a place that the mount has turned away: protection says so from the first frame on.
    assert all((np.abs(error_m) < i.protection_mrf_m).all() for i, error_m in flown)


def test_an_attitude_that_leaves_is_found():
    watcher, w = monitor(), world()
    last(watcher, w)
    w.mount_rad = (0.0, 0.02, 0.0)
    assert first_s(fly(watcher, w, 20), "attitude") <= 0.6


def test_a_height_datum_is_found_before_hand_over_and_does_not_pass():
    flown = fly(monitor(), world(br_m=(-30.0, 0.0, 10.0), gps_off_ned_m=(0.0, 0.0, 5.0)), 400)
    assert first_s(flown, "height_datum") <= 3.0
    assert not flown[-1][0].may_dock
    assert "gps_vision" not in flown[-1][0].faults


def test_positions_across_that_differ_are_another_fault():
    flown = fly(monitor(), world(br_m=(-30.0, 0.0, 10.0), gps_off_ned_m=(0.0, -6.0, 0.0)), 100)
    assert first_s(flown, "gps_vision") <= 3.0
    assert "height_datum" not in flown[-1][0].faults


@pytest.mark.parametrize("off_m", [(1.4, -1.4, 1.4), (0.5, 1.0, -2.0)])
def test_what_good_gps_err_for_minutes_is_no_fault(off_m):
    assert all(i.faults == () for i, _ in fly(monitor(), world(gps_off_ned_m=off_m), 400))


def test_gps_that_leaves_after_it_had_agreed_is_a_note():
    watcher, w = monitor(), world()
    last(watcher, w, round(1.5 * CONFIG.agreed_s * S / FRAME_NS))
    w.gps_off_ned_m = (30.0, 0.0, 20.0)
    flown = fly(watcher, w, 100)
    assert all(i.faults == () and i.may_dock for i, _ in flown)
    assert "gps" in flown[-1][0].notes
    watcher.restart()
    assert first_s(fly(watcher, w, 100), "height_datum") <= 3.0


def stream(watcher, w, source, nis, reason="", count=60):
    for k in range(count):
        watcher.see(FilterUpdate(w.t_ns + k * FRAME_NS, source, nis, 3, reason))
    w.t_ns += count * FRAME_NS


@pytest.mark.parametrize(
    ("source", "nis", "reason", "faults", "notes"),
    [
        ("pixels", 3.0, "", (), ()),
        ("pixels", 30.0, "", ("innovation pixels",), ()),
        ("pixels", 300.0, "gate", ("innovation pixels",), ()),
        ("pixels", float("nan"), "no_labels", (), ()),
        ("gps", 300.0, "gate", (), ("innovation gps",)),
        ("marker 3", 300.0, "gate", (), ("innovation marker 3",)),
    ],
)
def test_innovations(source, nis, reason, faults, notes):
    watcher, w = monitor(), world()
    last(watcher, w)
    stream(watcher, w, source, nis, reason)
    now = last(watcher, w, 1)
    assert (now.faults, now.notes) == (faults, notes)
    stream(watcher, w, source, 3.0, count=200)
    assert last(watcher, w, 1).faults == ()


def test_a_marker_that_is_taken_again_is_no_longer_told_of():
    watcher, w = monitor(), world()
    last(watcher, w)

    def frames(count, marker):
        for _ in range(count):
            (seen, fused), state, _ = w.frame()
            for output in (seen, FilterUpdate(w.t_ns, "pixels", 16.0, 16), *marker(w.t_ns), fused):
                watcher.see(output)
        return watcher.at(state, w.sources()).notes

    assert frames(60, lambda t_ns: [FilterUpdate(t_ns, "marker 3", 50.0, 2, "gate")]) == ("innovation marker 3",)
    assert frames(20, lambda t_ns: []) == ("innovation marker 3",)
    assert frames(100, lambda t_ns: []) == ()


def test_markers_that_fit_no_pose_are_a_fault():
    watcher, w = monitor(), world()
    last(watcher, w)
    flown = []
    for _ in range(60):
        (seen, fused), state, _ = w.frame()
        watcher.see(replace(seen, pose=None, reject=Reject(w.t_ns, "vision", "residual")))
        watcher.see(fused)
        flown.append((watcher.at(state, w.sources()), None))
    assert first_s(flown, "residual") <= 2.5


def test_few_markers_lean_on_what_a_filter_knows():
    def with_filter():
        watcher, w = monitor(), world()
        last(watcher, w)
        watcher.see(FilterState(w.t_ns, np.zeros(16), np.full(16, 0.001), 1e-6 * np.eye(16)))
        return watcher, w

    (watcher, w), (plain, v) = with_filter(), (monitor(), world())
    last(plain, v)
    w.seen = v.seen = (1, 7)
    assert last(watcher, w, 5).protection_mrf_m[0] < last(plain, v, 5).protection_mrf_m[0]  # along the sight


# -- chance ------------------------------------------------------------------------------------------------------------


def test_no_false_alarm_and_no_error_beyond_protection_in_ten_thousand_frames():
    rng = np.random.default_rng(20)
    for _ in range(50):
        w = World(rng, br_m=tuple(rng.uniform([-20.0, -1.0, 0.0], [0.5, 1.0, 6.0]))).usual()
        flown = fly(monitor(), w, 200)
        assert all(i.faults == () and i.may_dock for i, _ in flown)
        assert all((np.abs(error_m) < i.protection_mrf_m).all() for i, error_m in flown)


@pytest.mark.parametrize(("tankers", "seed"), [(300, 21), pytest.param(5000, 22, marks=pytest.mark.slow)])
def test_a_marker_anywhere_never_takes_an_error_beyond_protection_while_it_may_dock(tankers, seed):
    """Tankers with one light 1 cm to 1 m off, labelled all the same; ten frames each, before an alarm and after it."""
    rng, docked = np.random.default_rng(seed), 0
    for _ in range(tankers):
        w = World(rng).usual()
        off = rng.normal(size=3)
        w.moved_m = w.moved_m + moved(rng.integers(9), off / np.linalg.norm(off) * 10.0 ** rng.uniform(-2.0, 0.0))
        for i, error_m in fly(monitor(), w, 10):
            docked += i.may_dock
            assert not i.may_dock or (np.abs(error_m) < i.protection_mrf_m).all()
    assert docked > 4 * tankers


# -- configuration -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value"),
    [("risk", 0.0), ("risk", 0.5), ("fault_probability", 1e-9), ("false_alarm", 0.0), ("alert_growth", -0.1),
     ("sigma_px", 0.0), ("map_sigma_m", -1.0), ("boresight_rad", 1.0), ("gps_own_m", 0.0), ("window_s", 0.0),
     ("stale_s", 0.0), ("agreed_s", 0.0)],
)
def test_rules(field, value):
    assert all(holds for holds, _ in integrity_rules(IntegrityConfig()))
    broken = [text for holds, text in integrity_rules(IntegrityConfig(**{field: value})) if not holds]
    assert any(f"integrity.{field}" in text for text in broken)
