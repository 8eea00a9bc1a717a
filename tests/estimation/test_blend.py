import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import FusionConfig
from companion.estimation.blend import Blend
from companion.geometry import SE3, R_cam_crf, rotation_from_euler
from companion.messages import OwnAttitude, OwnPosition, PoseMeasurement, Reject, TankerState

MS = 1_000_000
T_FRD_CAM = SE3(rotation_from_euler(0.0, 0.467, 0.0) @ R_cam_crf.T, np.array([5.0, 0.0, -0.3]))
R_OWN, R_TANKER = rotation_from_euler(0.02, 0.06, -0.1), rotation_from_euler(0.01, 0.03, 0.02)
V_OWN, V_TANKER = np.array([206.0, 0.5, -0.2]), np.array([205.5, 0.0, 0.1])


def place(t_ns, relative_m):
    """Both aircraft at an instant; the receiver sits at ``relative_m`` from the tanker at t = 0."""
    t = t_ns * 1e-9
    return np.asarray(relative_m) + V_OWN * t, V_TANKER * t


def fed(relative_m, until_ms=200, gps_bias=(0.0, 0.0, 0.0)):
    b = Blend(FusionConfig(min_markers=5), T_FRD_CAM)
    for t_ns in range(0, until_ms * MS + 1, 20 * MS):
        p_own, p_tanker = place(t_ns, relative_m)
        assert b.own_attitude_event(OwnAttitude(t_ns, R_OWN, np.zeros(3))) is None
        assert b.own_position_event(OwnPosition(t_ns, p_own + np.asarray(gps_bias), V_OWN)) is None
        assert b.tanker_event(TankerState(t_ns, p_tanker, V_TANKER, R_TANKER, np.zeros(3))) is None
    return b


def true_pose(t_ns, relative_m):
    p_own, p_tanker = place(t_ns, relative_m)
    return (SE3(R_OWN, p_own) @ T_FRD_CAM).inverse() @ SE3(R_TANKER, p_tanker)


def measurement(t_ns, T, markers=9):
    return PoseMeasurement(t_ns, T, np.arange(9), markers, 5, 0.01, 1e-4, 0.01 * np.eye(6))


@given(st.floats(min_value=0, max_value=200))
def test_weight_is_a_clipped_line(d):
    w = Blend(FusionConfig(d1_m=55, d2_m=40), T_FRD_CAM).gps_weight(d)
    assert w == pytest.approx(np.clip((d - 40) / 15, 0, 1))


def test_gps_pose_is_the_true_pose_at_an_instant_between_samples():
    b = fed([-45.0, -15.0, 25.0])
    t_ns = 153 * MS
    T, truth = b.prior(t_ns), true_pose(t_ns, [-45.0, -15.0, 25.0])
    assert np.allclose(T.t, truth.t, atol=1e-6)
    assert np.allclose(T.R, truth.R, atol=1e-9)


@pytest.mark.parametrize(("relative_m", "weight"), [([-200.0, 0, 30], 0.0), ([-29.0, 0, 9], 1.0)])
def test_far_away_gps_alone_and_near_vision_alone(relative_m, weight):
    bias = np.array([1.0, -2.0, 3.0])
    b = fed(relative_m, gps_bias=bias)
    truth = true_pose(180 * MS, relative_m)
    fused = b.update(180 * MS, measurement(180 * MS, truth))
    assert fused.vision_weight == weight
    error = np.linalg.norm(fused.T_cam_tanker.t - truth.t)
    assert error == pytest.approx(0.0 if weight else np.linalg.norm(bias), abs=1e-6)


def test_between_d2_and_d1_it_is_the_thesis_line_between_both():
    relative_m, bias = [-45.0, 0.0, 22.0], np.array([0.4, 0.0, 0.0])
    b = fed(relative_m, gps_bias=bias)
    truth = true_pose(180 * MS, relative_m)
    fused = b.update(180 * MS, measurement(180 * MS, truth))
    assert 0.0 < fused.vision_weight < 1.0
    line = fused.vision_weight * truth.t + (1 - fused.vision_weight) * fused.T_cam_tanker_gps.t
    assert np.allclose(fused.T_cam_tanker.t, line, atol=1e-12)


def test_angles_come_from_the_inu_whatever_vision_says():
    b = fed([-29.0, 0, 9])
    truth = true_pose(180 * MS, [-29.0, 0, 9])
    turned = SE3(truth.R @ rotation_from_euler(0.1, 0.1, 0.1), truth.t)
    assert np.allclose(b.update(180 * MS, measurement(180 * MS, turned)).T_cam_tanker.R, truth.R, atol=1e-9)


def test_four_markers_do_not_count_and_the_last_blend_is_carried_on_until_stale():
    relative_m, bias = [-29.0, 0.0, 9.0], np.array([0.0, 0.0, 2.0])
    b = fed(relative_m, until_ms=1000, gps_bias=bias)
    b.update(500 * MS, measurement(500 * MS, true_pose(500 * MS, relative_m)))
    few = b.update(600 * MS, measurement(600 * MS, true_pose(600 * MS, [-20.0, 0, 0]), markers=4))
    assert few.markers_used == 0
    assert np.allclose(few.T_cam_tanker.t, true_pose(600 * MS, relative_m).t, atol=1e-3)
    stale = b.update(900 * MS, None)
    assert np.linalg.norm(stale.T_cam_tanker.t - true_pose(900 * MS, relative_m).t) == pytest.approx(2.0, abs=1e-3)


def test_stale_or_missing_sources_give_no_estimate():
    assert Blend(FusionConfig(), T_FRD_CAM).prior(0) is None
    b = fed([-29.0, 0, 9])
    assert b.prior(200 * MS) is not None
    assert b.prior(200 * MS + 301 * MS) is None


def test_time_that_does_not_go_forward_is_a_counted_reject():
    b = fed([-29.0, 0, 9])
    r = b.own_position_event(OwnPosition(100 * MS, np.zeros(3), np.zeros(3)))
    assert isinstance(r, Reject)
    assert (r.source, r.reason) == ("position", "time_not_forward")
    assert np.allclose(b.prior(200 * MS).t, true_pose(200 * MS, [-29.0, 0, 9]).t, atol=1e-6)


def test_estimate_is_as_old_as_its_oldest_source():
    b = fed([-29.0, 0, 9])
    b.own_attitude_event(OwnAttitude(260 * MS, R_OWN, np.zeros(3)))
    _, anchor = b.relative_position(b.align(260 * MS))
    assert b.estimate_ns(anchor) == 200 * MS
    assert dataclasses.is_dataclass(b.align(260 * MS))
