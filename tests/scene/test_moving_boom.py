"""A boom that swings, telescopes and steers: what it hides and how it is drawn, against Embree and plain geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tanker_scene import CONTACT, START, Scene, Tracer
from test_occlusion import camera_in_tanker, traced_share

from companion.geometry import SE3, Vec
from sim_bridge.scene.boom_mesh import RUDDEVATORS, TELESCOPE, TELESCOPE_M, TUBE_M, boom_mesh, boom_poses
from sim_bridge.scene.visibility import marker_visibility
from sim_bridge.truth import BoomState

angles = st.tuples(st.floats(0.1, 0.8), st.floats(-0.3, 0.3), st.floats(8.5, 14.7))


def hung(scene: Scene, elevation: float, azimuth: float, length: float, right: float = 0.0,
         left: float = 0.0) -> BoomState:
    return BoomState(scene.boom.pivot_tanker_m, elevation, azimuth, length, ruddevators_rad=(right, left))


def along(boom: BoomState, points_tanker: Vec) -> Vec:
    """Return how far points (n, 3) are from the pivot along the boom."""
    axis = (boom.tip_tanker_m() - boom.pivot_tanker_m) / boom.length_m
    return (points_tanker - boom.pivot_tanker_m) @ axis


@given(where=angles)
@settings(max_examples=30)
def test_the_telescope_slides_in_its_tube(scene: Scene, where: tuple[float, float, float]) -> None:
    """It ends at the tip, starts inside the tube, and what shows of it is what the boom is longer than the tube."""
    boom = hung(scene, *where)
    reach = along(boom, boom_poses(boom)[TELESCOPE].transform(boom_mesh()[TELESCOPE].vertices))
    tube = along(boom, boom_poses(boom)[0].transform(boom_mesh()[0].vertices))
    assert reach.max() == pytest.approx(boom.length_m, abs=1e-9)
    assert reach.min() == pytest.approx(boom.length_m - TELESCOPE_M, abs=1e-9)
    assert tube.min() < reach.min() < tube.max() == pytest.approx(TUBE_M, abs=1e-9)


@given(where=angles, turn=st.floats(-0.6, 0.6))
@settings(max_examples=30)
def test_ruddevators_turn_about_their_hinges(scene: Scene, where: tuple[float, float, float], turn: float) -> None:
    """Trailing edges go down in the boom's own axes for positive angles, on either side, and roots stay in the tube."""
    still, turned = hung(scene, *where), hung(scene, *where, turn, turn)
    T_boom_tanker = boom_poses(still)[0].inverse()
    for k in RUDDEVATORS:
        mesh = boom_mesh()[k]
        a, b = (T_boom_tanker.transform(boom_poses(s)[k].transform(mesh.vertices)) for s in (still, turned))
        trailing = int(np.argmin(mesh.vertices[:, 0]))
        assert np.sign(b[trailing, 2] - a[trailing, 2]) == np.sign(turn) or abs(turn) < 1e-6
        hinge = np.abs(mesh.vertices[:, [0, 2]]).sum(axis=1) < 0.05
        assert np.allclose(a[hinge], b[hinge], atol=0.05)
        root = np.abs(mesh.vertices[:, 1]) < 0.2
        assert np.hypot(b[root, 1], b[root, 2]).max() < 0.55


def test_opposite_ruddevators_mirror_each_other(scene: Scene) -> None:
    flip = np.array([1.0, -1.0, 1.0])
    a, b = (boom_poses(hung(scene, 0.5, 0.0, 11.0, *turn)) for turn in ((0.3, -0.1), (-0.1, 0.3)))
    right, left = (boom_mesh()[k].vertices for k in RUDDEVATORS)
    seen = {tuple(p) for p in np.round(a[2].transform(right) * flip, 6) + 0.0}
    assert seen == {tuple(p) for p in np.round(b[3].transform(left), 6) + 0.0}


def swinging(scene: Scene, count: int, seed: int) -> list[tuple[SE3, BoomState]]:
    """Return the receiver between pre-contact and contact, and a boom whose tip it carries or that swings about it."""
    r = np.random.default_rng(seed)
    pairs = []
    for k in range(count):
        place = CONTACT + r.uniform(0, 0.5) * (START - CONTACT) * np.array([1.0, 0.2, 0.3]) + r.normal(0, 0.5, 3)
        T_ned_frd = scene.T_ned_frd(place, *r.normal(0, 0.03, 3))
        boom = hung(scene, *r.uniform((0.0, -0.35, 8.5), (0.9, 0.35, 14.5)), *r.uniform(-0.4, 0.4, 2))
        if k % 3 == 0:  # in contact: the tip is in the receptacle
            tip = (scene.T_ned_tanker.inverse() @ T_ned_frd).transform(np.array([2.0, 0.0, -1.0]))
            reach = tip - boom.pivot_tanker_m
            length = float(np.sqrt(reach @ reach))
            elevation, azimuth = float(np.arcsin(reach[2] / length)), float(np.arctan2(reach[1], -reach[0]))
            boom = replace(boom, elevation_rad=elevation, azimuth_rad=azimuth, length_m=length)
            np.testing.assert_allclose(boom.tip_tanker_m(), tip, atol=1e-9)
        pairs.append((T_ned_frd, boom))
    return pairs


def test_lights_behind_a_moving_boom_are_hidden_as_embree_hides_them(scene: Scene) -> None:
    camera = scene.cameras["default"]
    ours, traced, without = [], [], []
    for T_ned_frd, boom in swinging(scene, 60, 31):
        T = camera_in_tanker(scene, camera, T_ned_frd)
        tracer = Tracer(boom)
        ours.append(marker_visibility(camera, scene.tanker, scene.T_ned_tanker, T_ned_frd, boom))
        traced.append([traced_share(tracer, T, camera, c, scene.tanker.marker_radius_m) for c in scene.markers()])
        away = replace(boom, elevation_rad=-1.2)
        without.append(marker_visibility(camera, scene.tanker, scene.T_ned_tanker, T_ned_frd, away))
    a, b = np.array(ours).ravel(), np.array(traced).ravel()
    assert np.sum(np.array(without).ravel() - a > 0.05) > 5  # the boom, and nothing else, hides these
    np.testing.assert_allclose(a, b, atol=0.06)
