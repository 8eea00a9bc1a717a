import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import FusionConfig, IntegrityConfig
from companion.estimation.aircraft import Aircraft
from companion.estimation.blend import BY_GPS, BY_VISION, Blend
from companion.geometry import SE3, R_cam_crf, rotation_from_euler
from companion.messages import (
    Detections,
    FusedPose,
    OwnAttitude,
    OwnPosition,
    PoseMeasurement,
    Reject,
    TankerState,
    TimeStep,
    VisionOutput,
)

MS = 1_000_000
T_FRD_CAM = SE3(rotation_from_euler(0.0, 0.467, 0.0) @ R_cam_crf.T, np.array([5.0, 0.0, -0.3]))
R_OWN, R_TANKER = rotation_from_euler(0.02, 0.06, -0.1), rotation_from_euler(0.01, 0.03, 0.02)
V_OWN, V_TANKER = np.array([206.0, 0.5, -0.2]), np.array([205.5, 0.0, 0.1])


def place(t_ns, relative_m):
    """Both aircraft at an instant; the receiver sits at ``relative_m`` from the tanker at t = 0."""
    t = t_ns * 1e-9
    return np.asarray(relative_m) + V_OWN * t, V_TANKER * t


def new():
    """Return both aircraft, and a blend of what they will tell."""
    config = FusionConfig(min_markers=5)
    aircraft = Aircraft(config, T_FRD_CAM)
    return aircraft, Blend(config, aircraft)


def fed(relative_m, until_ms=200, gps_bias=(0.0, 0.0, 0.0)):
    aircraft, b = new()
    for t_ns in range(0, until_ms * MS + 1, 20 * MS):
        p_own, p_tanker = place(t_ns, relative_m)
        assert aircraft.own_attitude_event(OwnAttitude(t_ns, R_OWN, np.full(3, 1e-16 * t_ns))) is None
        assert aircraft.own_position_event(OwnPosition(t_ns, p_own + np.asarray(gps_bias), V_OWN)) is None
        assert aircraft.tanker_event(TankerState(t_ns, p_tanker, V_TANKER, R_TANKER, np.zeros(3))) is None
        assert b.positions() == []
    return aircraft, b


def true_pose(t_ns, relative_m):
    p_own, p_tanker = place(t_ns, relative_m)
    return (SE3(R_OWN, p_own) @ T_FRD_CAM).inverse() @ SE3(R_TANKER, p_tanker)


def measurement(t_ns, T, markers=9):
    return PoseMeasurement(t_ns, T, np.arange(9), markers, 5, 0.01, 1e-4, 0.01 * np.eye(6))


def blended(b, t_ns, T=None, markers=9):
    """Return the blend with a pose at an exposure, or with a frame that shows none."""
    nothing = Detections(t_ns, np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.uint8))
    pose = None if T is None else measurement(t_ns, T, markers)
    labels = np.full(9, -1) if pose is None else pose.labels
    [fused] = b.vision(VisionOutput(t_ns, 0, nothing, np.empty((0, 2)), labels, pose, None))
    assert isinstance(fused, FusedPose)
    return fused


@given(st.floats(min_value=0, max_value=200))
def test_weight_is_a_clipped_line(d):
    w = new()[1].gps_weight(d)
    assert w == pytest.approx(np.clip((d - 40) / 15, 0, 1))


def test_gps_pose_is_the_true_pose_at_an_instant_between_samples():
    aircraft, b = fed([-45.0, -15.0, 25.0])
    t_ns = 153 * MS
    T, truth = aircraft.gps_prior(t_ns), true_pose(t_ns, [-45.0, -15.0, 25.0])
    assert np.allclose(T.t, truth.t, atol=1e-6)
    assert np.allclose(T.R, truth.R, atol=1e-9)
    assert np.allclose(b.prior(t_ns).T_cam_tanker.t, T.t, atol=1e-12)
    assert not b.prior(t_ns).tracked


@pytest.mark.parametrize(("relative_m", "weight"), [([-200.0, 0, 30], 0.0), ([-29.0, 0, 9], 1.0)])
def test_far_away_gps_alone_and_near_vision_alone(relative_m, weight):
    bias = np.array([1.0, -2.0, 3.0])
    _, b = fed(relative_m, gps_bias=bias)
    truth = true_pose(180 * MS, relative_m)
    fused = blended(b, 180 * MS, truth)
    assert fused.vision_weight == weight
    error = np.linalg.norm(fused.T_cam_tanker.t - truth.t)
    assert error == pytest.approx(0.0 if weight else np.linalg.norm(bias), abs=1e-6)


def test_between_d2_and_d1_it_is_the_thesis_line_between_both():
    relative_m, bias = [-45.0, 0.0, 22.0], np.array([0.4, 0.0, 0.0])
    _, b = fed(relative_m, gps_bias=bias)
    truth = true_pose(180 * MS, relative_m)
    fused = blended(b, 180 * MS, truth)
    assert 0.0 < fused.vision_weight < 1.0
    line = fused.vision_weight * truth.t + (1 - fused.vision_weight) * fused.T_cam_tanker_gps.t
    assert np.allclose(fused.T_cam_tanker.t, line, atol=1e-12)


def test_angles_come_from_the_inu_whatever_vision_says():
    _, b = fed([-29.0, 0, 9])
    truth = true_pose(180 * MS, [-29.0, 0, 9])
    turned = SE3(truth.R @ rotation_from_euler(0.1, 0.1, 0.1), truth.t)
    assert np.allclose(blended(b, 180 * MS, turned).T_cam_tanker.R, truth.R, atol=1e-9)


def test_four_markers_do_not_count_and_the_last_blend_is_carried_on_until_stale():
    relative_m, bias = [-29.0, 0.0, 9.0], np.array([0.0, 0.0, 2.0])
    _, b = fed(relative_m, until_ms=1000, gps_bias=bias)
    blended(b, 500 * MS, true_pose(500 * MS, relative_m))
    few = blended(b, 600 * MS, true_pose(600 * MS, [-20.0, 0, 0]), markers=4)
    assert few.markers_used == 0
    assert np.allclose(few.T_cam_tanker.t, true_pose(600 * MS, relative_m).t, atol=1e-3)
    stale = blended(b, 900 * MS)
    assert np.linalg.norm(stale.T_cam_tanker.t - true_pose(900 * MS, relative_m).t) == pytest.approx(2.0, abs=1e-3)


def test_a_prior_is_tracked_while_vision_outweighs_gps_and_not_when_it_is_stale():
    _, b = fed([-29.0, 0, 9], until_ms=1000)
    blended(b, 500 * MS, true_pose(500 * MS, [-29.0, 0, 9]))
    assert b.sight_ns == 500 * MS
    assert b.prior(790 * MS).tracked
    assert not b.prior(810 * MS).tracked
    _, far = fed([-200.0, 0, 30])
    blended(far, 180 * MS, true_pose(180 * MS, [-200.0, 0, 30]))
    assert not far.prior(200 * MS).tracked


def test_stale_or_missing_sources_give_no_estimate():
    aircraft, b = new()
    assert (b.prior(0), aircraft.gps_prior(0), b.at(0)) == (None, None, None)
    empty = VisionOutput(0, 0, Detections(0, *[np.empty(0)] * 4), np.empty((0, 2)), np.full(9, -1), None, None)
    assert b.vision(empty) == []
    _, b = fed([-29.0, 0, 9])
    assert b.prior(200 * MS) is not None
    assert b.prior(200 * MS + 301 * MS) is None


def test_time_that_does_not_go_forward_is_a_counted_reject():
    aircraft, b = fed([-29.0, 0, 9])
    r = aircraft.own_position_event(OwnPosition(100 * MS, np.zeros(3), np.zeros(3)))
    assert isinstance(r, Reject)
    assert r.source == "position"
    assert np.allclose(b.prior(200 * MS).T_cam_tanker.t, true_pose(200 * MS, [-29.0, 0, 9]).t, atol=1e-6)


def test_an_estimate_is_as_old_as_its_oldest_source():
    relative_m = [-29.0, 0, 9]
    aircraft, b = fed(relative_m)
    aircraft.own_attitude_event(OwnAttitude(260 * MS, R_OWN, np.zeros(3)))
    assert b.at(260 * MS).estimate_ns == 200 * MS
    blended(b, 140 * MS, true_pose(140 * MS, relative_m))
    assert b.at(260 * MS).estimate_ns == 140 * MS


def test_an_estimate_says_how_good_its_sources_are():
    relative_m, bias = [-29.0, 0.0, 9.0], np.array([0.0, 0.0, 2.0])
    _, b = fed(relative_m, until_ms=1000, gps_bias=bias)
    by_gps = b.at(500 * MS)
    blended(b, 500 * MS, true_pose(500 * MS, relative_m))
    by_vision = b.at(600 * MS)
    there = np.subtract(*place(600 * MS, relative_m))
    assert np.allclose(by_vision.p_ned_m, there, atol=1e-3)
    assert np.allclose(by_gps.p_ned_m, np.subtract(*place(500 * MS, relative_m)) + bias, atol=1e-6)
    assert np.array_equal(by_gps.cov, BY_GPS)
    assert (np.diag(by_gps.cov)[:3] >= IntegrityConfig().gps_own_m ** 2).all(), "what two GPS err for minutes"
    assert np.array_equal(by_vision.cov, BY_VISION)


def test_a_restart_forgets_the_last_blend():
    relative_m, bias = [-29.0, 0.0, 9.0], np.array([0.0, 0.0, 2.0])
    aircraft, b = fed(relative_m, gps_bias=bias)
    blended(b, 180 * MS, true_pose(180 * MS, relative_m))
    b.restart()
    assert b.sight_ns is None
    assert b.at(200 * MS).vision_weight == 0.0
    assert np.allclose(b.prior(200 * MS).T_cam_tanker.t, aircraft.gps_prior(200 * MS).t)


def test_a_continuous_step_of_the_clock_takes_the_last_blend_along():
    relative_m, bias, step_ns = [-29.0, 0.0, 9.0], np.array([0.0, 0.0, 2.0]), 3000 * MS
    aircraft, b = fed(relative_m, gps_bias=bias)
    blended(b, 180 * MS, true_pose(180 * MS, relative_m))
    before = b.at(200 * MS)
    aircraft.time_step_event(TimeStep(200 * MS, "mavlink", step_ns, continuous=True))
    b.shift(step_ns)
    after = b.at(200 * MS + step_ns)
    assert np.allclose(after.p_ned_m, before.p_ned_m, atol=1e-9)
    assert after.vision_weight == before.vision_weight == 1.0
    assert b.sight_ns == 180 * MS + step_ns
