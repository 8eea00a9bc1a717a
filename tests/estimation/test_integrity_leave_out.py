"""Leaving one marker out in closed form, against solving without it; means and alarms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from integrity_scenes import FOCAL_PX, MARKERS, receiver

from companion.estimation.integrity_alarm import Alarm, RunningMean
from companion.estimation.integrity_leave_out import covariance, leave_out, linearised, moves
from companion.geometry import SE3, log_so3
from companion.vision.refinement import pose_covariance, refine_pose

S = 1_000_000_000
NONE = np.zeros((6, 6))


def refined(rng, which, br_m=(-3.0, 1.0, 2.0), noise_px=0.3):
    T, _ = receiver(br_m)
    q = T.transform(MARKERS[which])
    uv = q[:, :2] / q[:, 2:] + rng.normal(0.0, noise_px / FOCAL_PX, (len(which), 2))
    sigma = np.full(len(which), 0.3 / FOCAL_PX)
    pose = refine_pose(MARKERS[which], uv, T, sigma)
    return pose, linearised(which, MARKERS[which], uv, sigma**2, pose.T_cam_tanker), uv, sigma


@pytest.mark.parametrize("seed", range(5))
def test_separation_is_that_of_solving_again_without_the_marker(seed):
    which = np.arange(9)
    pose, seen, uv, sigma = refined(np.random.default_rng(seed), which)
    out = leave_out(seen, pose.cov)
    for i in which:
        rest = which != i
        without = refine_pose(MARKERS[rest], uv[rest], pose.T_cam_tanker, sigma[rest])
        separation = out.sensitivity[i] @ out.deleted[i]
        spread = np.sqrt(np.diag(without.cov))
        turn = log_so3(pose.T_cam_tanker.R @ without.T_cam_tanker.R.T)
        moved = np.concatenate((pose.T_cam_tanker.t - without.T_cam_tanker.t, turn))
        assert (np.abs(separation - moved) < 0.02 * spread).all()
        # The covariance of the separation is what the covariance grows by (ARAIM's sigma of the separation).
        grown = out.sensitivity[i] @ (sigma[i] ** 2 * out.spread[i]) @ out.sensitivity[i].T
        assert np.allclose(grown, without.cov - pose.cov, atol=0.03 * np.abs(without.cov).max())


def test_covariance_is_that_of_the_vision_and_needs_enough_markers():
    which = np.array([0, 3, 4, 7, 8])
    pose, seen, _, sigma = refined(np.random.default_rng(1), which)
    told = pose_covariance(MARKERS[which], pose.T_cam_tanker, sigma)
    assert np.allclose(covariance(seen, NONE), told, rtol=1e-8, atol=1e-14)
    T, _ = receiver((0.0, 0.0, 0.0))
    uv = T.transform(MARKERS[:2])
    two = linearised(np.arange(2), MARKERS[:2], uv[:, :2] / uv[:, 2:], sigma[:2] ** 2, T)
    assert covariance(two, NONE) is None
    attitude = np.diag([0.0] * 3 + [1e6] * 3)
    assert covariance(two, attitude) is not None


def test_three_markers_say_nothing_of_each_other():
    which = np.array([1, 2, 7])
    T, _ = receiver((0.0, 0.0, 0.0))
    q = T.transform(MARKERS[which])
    seen = linearised(which, MARKERS[which], q[:, :2] / q[:, 2:], np.full(3, 1e-6), T)
    out = leave_out(seen, covariance(seen, NONE))
    assert not out.tested.any()
    assert np.isfinite(out.deleted).all()


def test_a_marker_behind_the_camera_is_no_frame():
    T, _ = receiver((0.0, 0.0, 0.0))
    behind = SE3(T.R, T.t - [0.0, 0.0, 40.0])
    assert linearised(np.arange(9), MARKERS, np.zeros((9, 2)), np.full(9, 1e-6), behind) is None


@given(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_a_turn_of_the_pose_turns_the_place_back(a, b, c):
    t = np.array([1.0, -2.0, 25.0])
    turn = np.array([a, b, c])
    move = np.concatenate((np.cross(turn, t), turn))[:, None]  # the whole picture turned: the place is the same
    assert np.allclose(moves(t, move, turns=True), 0.0, atol=1e-12)
    assert np.allclose(moves(t, move, turns=False)[:, 0], np.cross(turn, t))


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=40))
def test_a_running_mean_lies_among_its_samples_and_counts_fewer_than_there_were(samples):
    mean = RunningMean(1, 1.0)
    for k, x in enumerate(samples):
        mean.add(k * S // 10, np.array([x]))
    assert min(samples) - 1e-9 <= mean.mean[0] <= max(samples) + 1e-9
    assert 1.0 <= mean.count <= min(len(samples), 1.0 / (1.0 - np.exp(-0.1))) + 1e-9


def test_a_running_mean_begins_anew_after_a_gap():
    mean = RunningMean(1, 0.5)
    for k in range(20):
        mean.add(k * S // 20, np.array([9.0]))
    mean.add(4 * S, np.array([1.0]))
    assert (mean.mean[0], mean.count) == (1.0, 1.0)


def test_an_alarm_waits_and_stays():
    alarm = Alarm(0.3, 1.0)
    raised = [alarm.update(k * S // 20, fails=5 <= k < 20) for k in range(60)]
    assert raised.index(True) == 11
    assert not raised[-1]
    assert 39 <= len(raised) - raised[::-1].index(True) <= 41


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_an_alarm_that_never_fails_for_long_enough_is_never_raised(fails):
    alarm = Alarm(10.0, 1.0)
    assert not any(alarm.update(k * S // 20, fails=f) for k, f in enumerate(fails))
