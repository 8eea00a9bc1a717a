"""Recorded sequences, and what the solvers do with them."""

import numpy as np
import pytest
from study_material import SEED, recorded

from companion.geometry import SE3
from sim_bridge.study import axes, thesis_numbers
from sim_bridge.study.accuracy import delay_s, delayed_images
from sim_bridge.study.convergence import edge, offset_translation, offset_yaw, scene_of
from sim_bridge.study.label_swap import swap
from sim_bridge.study.propagation import POWERS, departure, overlap_db, propagate, psd
from sim_bridge.study.recording import record
from sim_bridge.study.robustness import LAST_FRAMES, judge, noisy_before, run, seen_markers, sigma
from sim_bridge.study.solvers import NAMES, track


def test_the_same_seed_is_the_same_sequence():
    a, b = (record("rv", SEED, 1.0) for _ in range(2))
    assert np.array_equal(a.uv, b.uv)
    assert np.array_equal(a.track, b.track)
    assert all(np.array_equal(p.t, q.t) for p, q in zip(a.T_gps, b.T_gps, strict=True))
    other = record("rv", SEED + 1, 1.0)
    assert not np.array_equal(a.uv, other.uv)


def test_a_recording_holds_a_picture_every_tenth_of_a_second_and_the_truth_at_each():
    r = recorded("rv")
    assert np.allclose(np.diff(r.t_s), 0.1)
    assert r.t_s[-1] == pytest.approx(24.0, abs=0.15)
    at_pictures = np.stack([np.interp(r.t_s, r.track_s, r.track[:, k]) for k in range(3)], axis=1)
    assert np.allclose(at_pictures, axes.xyz(np.array([T.t for T in r.T_true])))


def test_labelled_markers_are_where_the_truth_projects_them():
    r = recorded("rv")
    for k in range(0, len(r.t_s), 20):
        off_px = (r.uv[k] - axes.image(r.T_true[k], r.markers)) * r.scale_px()
        assert np.nanmax(np.abs(off_px)) < 0.5
    assert np.isfinite(r.uv).mean() > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_simulated_vision_gives_back_what_gps_says(name):
    r = recorded("sv")
    t, R, fresh = track(name, r, r.uv, r.T_gps[0])
    assert fresh.all()
    off = axes.differences(axes.six(t, R), axes.six_of(r.T_gps))
    assert np.abs(off[:, :3]).max() < 0.02
    assert np.abs(off[:, 3:]).max() < 1e-3


def test_angles_and_positions_of_the_thesis_go_there_and_back():
    T = axes.pose(thesis_numbers.X0_M, (0.1, 0.467, -0.2))
    assert np.allclose(axes.six_of([T])[0], [60.5, 20.0, -2.5, -0.2, 0.467, 0.1])


@pytest.mark.parametrize("late_s", [-0.1, 0.0, 0.25])
def test_a_delay_is_found(late_s):
    r = recorded("sv")
    t_s = r.t_s[20:-20]
    xyz = np.stack([np.interp(t_s - late_s, r.track_s, r.track[:, k]) for k in range(3)], axis=1)
    assert delay_s(r, t_s, xyz) == pytest.approx(late_s, abs=2e-3)


def test_images_of_an_old_fix_are_those_of_the_fix_before():
    r = recorded("sv")
    old = delayed_images(r, 0.1)
    expected = axes.image(SE3(r.T_gps[50].R, r.T_gps[49].t), r.markers)
    assert np.allclose(old[50], expected, atol=1e-12)


def test_too_few_markers_keep_the_last_estimate():
    r = recorded("sv")
    uv = r.uv[:20].copy()
    uv[10, 4:], uv[12, 3:] = np.nan, np.nan
    for name, held in (("GLSDC", [12]), ("LHM", [10, 12]), ("SQPNP", [10, 12])):
        t, _, fresh = track(name, r, uv, r.T_gps[0])
        assert np.flatnonzero(~fresh).tolist() == held
        for k in held:
            assert np.array_equal(t[k], t[k - 1])


@pytest.mark.parametrize("name", NAMES)
def test_a_label_swap_is_over_in_the_next_right_frame(name):
    s = swap(recorded("rv"), name)
    assert s.good_again_s <= 20.2 + 1e-6
    if name == "chain":
        assert s.held == 2
        assert s.worst_m < 0.5
    else:
        assert s.worst_m > 2.0


def test_noise_on_one_marker_goes_through_linearly():
    p = propagate(recorded("sv"), 5)
    assert np.allclose(p.noise_m[POWERS[2]], np.sqrt(3.0) * p.noise_m[POWERS[0]])
    assert departure(p, "GLSDC") < 0.02
    assert departure(p, "LHM") < 0.2
    assert np.median(overlap_db(p, "GLSDC")) < 0.1


def test_a_periodogram_holds_the_power_of_its_noise():
    """Parseval for eq. 7.2: its mean over all frequencies is 2 pi times the mean square."""
    x = np.random.default_rng(8).standard_normal((401, 2))
    both_sides = np.concatenate([psd(x), psd(x)[1:]])  # an odd number of samples: only zero is there once
    assert np.allclose(both_sides.mean(axis=0), 2.0 * np.pi * np.mean(np.square(x), axis=0))


def test_noise_powers_are_those_of_the_thesis_table():
    for power, (_, _, _, deviation) in thesis_numbers.INPUT_NOISE.items():
        assert sigma(power, 1.0) == pytest.approx(deviation, rel=0.02)


def test_drop_outs_are_those_that_the_thesis_tells():
    t_s = np.arange(0.0, 45.05, 0.1)
    count = seen_markers(t_s, 9, np.random.default_rng(1)).sum(axis=1)
    told = {0.0: 9, 11.6: 9, 11.7: 3, 11.8: 9, 27.6: 9, 27.7: 7, 31.2: 6, 33.0: 5, 39.9: 5, 40.0: 9, 45.0: 9}
    assert {t: int(count[round(10 * t)]) for t in told} == told


def test_a_run_that_stays_wrong_has_diverged_and_one_that_comes_back_has_not():
    fresh = np.ones(100, dtype=bool)
    gone = np.zeros((100, 3))
    gone[30:] = 100.0
    assert judge(gone, fresh, 0).diverged
    back = gone.copy()
    back[-LAST_FRAMES + 3 :] = 0.0
    assert not judge(back, fresh, 0).diverged
    assert judge(np.full((100, 3), np.nan), fresh, 0).diverged


def test_detections_of_markers_that_are_not_seen_are_taken_out():
    r = recorded("rv")
    seen = np.ones((30, 9), dtype=bool)
    seen[:, [0, 4]] = False
    for k, frame in enumerate(noisy_before(r, seen, 0.0, 0.05, np.random.default_rng(0))):
        assert frame.right[0] == frame.right[4] == -1
        there = np.flatnonzero(frame.right >= 0)
        assert np.allclose(frame.px[frame.right[there]], r.detected_px[k][r.labels[k][there]])


def test_the_same_noise_seed_is_the_same_outcome_and_the_chain_is_never_wrong():
    r = recorded("rv")
    a, b = (run(r, "after", 5e-9, 0.05, False, (1, 2)) for _ in range(2))
    assert a == b
    assert all(o.wrong == 0.0 for o in a["chain"])
    quiet = run(r, "before", 0.0, 0.05, False, (1,))
    assert all(quiet[name][0].mislabelled == 0 for name in NAMES)
    assert max(quiet["LHM"][0].rms_m) < 0.1


def test_glsdc_has_an_edge_and_lhm_has_none_in_translation():
    scene = scene_of(recorded("sv"))
    end = edge(scene, "GLSDC", offset_translation, 200.0, 2.0)
    assert 5.0 < end < 200.0
    assert scene.frames_needed("GLSDC", offset_translation(end)) > 0
    assert scene.frames_needed("LHM", offset_translation(1e6)) > 0
    assert all(scene.frames_needed(name, offset_yaw(3.0)) > 0 for name in ("SQPNP", "EPNP", "chain", "LHM as listed"))
