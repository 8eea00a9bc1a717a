"""The boom operator's view: receiver and boom where they are, against plain projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tanker_scene import Scene

from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import T_frd_cam, project
from sim_bridge.scene.boom_mesh import TELESCOPE, boom_mesh, boom_poses
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.operator_view import WINDOW, OperatorView, operator_view
from sim_bridge.scene.receiver_mesh import uav_mesh
from sim_bridge.truth import BoomState

FAR = SE3(np.eye(3), np.array([-5000.0, 0.0, -5000.0]))
RECEPTACLE = np.array([2.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def view() -> OperatorView:
    return OperatorView(PictureConditions(), np.random.default_rng(1))


def in_window(points_tanker: Mat) -> Mat:
    return project(WINDOW, T_frd_cam(WINDOW).inverse(), points_tanker)


def docked(scene: Scene, boom: BoomState, off_m: Vec) -> SE3:
    """Return the receiver with its receptacle ``off_m`` from the boom's tip."""
    return scene.T_ned_frd(boom.tip_tanker_m() + off_m - RECEPTACLE)


def changed(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return least and greatest column and row of what differs by more than a little."""
    v, u = np.nonzero(np.abs(a.astype(int) - b).max(axis=2) > 12)
    return np.array([u.min(), u.max(), v.min(), v.max()])


@pytest.mark.parametrize("off_m", [(0.0, 0.0, 0.0), (-4.0, 1.5, 1.0)])
def test_the_receiver_is_drawn_where_it_is(scene: Scene, view: OperatorView, off_m: tuple[float, ...]) -> None:
    T_ned_uav = docked(scene, scene.boom, np.array(off_m))
    box = changed(view.render(scene.T_ned_tanker, T_ned_uav, scene.boom),
                  view.render(scene.T_ned_tanker, FAR, scene.boom))
    outline = in_window((scene.T_ned_tanker.inverse() @ T_ned_uav).transform(uav_mesh().vertices))
    expected = [outline[:, 0].min(), outline[:, 0].max(), outline[:, 1].min(), outline[:, 1].max()]
    np.testing.assert_allclose(box[:2], expected[:2], atol=2.5)
    np.testing.assert_allclose(box[3], expected[3], atol=2.5)  # its tail may be behind the ruddevators


@pytest.mark.parametrize(("elevation", "azimuth", "length"), [(0.52, 0.0, 11.5), (0.6, 0.15, 14.0), (0.45, -0.15, 9.0)])
def test_the_boom_ends_where_its_tip_is(scene: Scene, view: OperatorView, elevation: float, azimuth: float,
                                        length: float) -> None:
    boom = BoomState(scene.boom.pivot_tanker_m, elevation, azimuth, length)
    up = replace(boom, elevation_rad=-1.4)
    box = changed(view.render(scene.T_ned_tanker, FAR, boom), view.render(scene.T_ned_tanker, FAR, up))
    telescope = in_window(boom_poses(boom)[TELESCOPE].transform(boom_mesh()[TELESCOPE].vertices))
    assert box[3] == pytest.approx(telescope[:, 1].max(), abs=2.5)


def test_only_relative_places_count(scene: Scene, view: OperatorView) -> None:
    """The same formation elsewhere looks the same: sky and sea are far away."""
    turned = SE3(scene.T_ned_tanker.R, scene.T_ned_tanker.t + np.array([300.0, -200.0, 50.0]))
    T_ned_uav = docked(scene, scene.boom, np.zeros(3))
    moved = turned @ scene.T_ned_tanker.inverse() @ T_ned_uav
    np.testing.assert_array_equal(view.render(scene.T_ned_tanker, T_ned_uav, scene.boom),
                                  view.render(turned, moved, scene.boom))


def test_it_is_drawn_only_when_it_is_asked_for() -> None:
    assert operator_view(PictureConditions(), 1) is None
    assert operator_view(PictureConditions(operator_view=True), 1) is not None
