from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from tanker_scene import Scene

from sim_bridge.scene.boom_mesh import boom_mesh, boom_poses
from sim_bridge.scene.meshing import Mesh
from sim_bridge.scene.receiver_mesh import uav_mesh
from sim_bridge.scene.tanker_mesh import tanker_mesh
from sim_bridge.truth import BoomState

MESHES = {"tanker": tanker_mesh(), "uav": uav_mesh(),
          **dict(zip(("boom", "telescope", "right ruddevator", "left ruddevator"), boom_mesh(), strict=True))}


@pytest.mark.parametrize("name", MESHES)
def test_every_edge_is_shared_by_two_faces_that_run_it_both_ways(name: str) -> None:
    """A closed surface, wound alike all over: what culling the far side rests on."""
    mesh = MESHES[name]
    _, welded = np.unique(np.round(mesh.vertices, 6), axis=0, return_inverse=True)
    corners = welded[mesh.triangles]
    runs: Counter[tuple[int, int]] = Counter()
    for i, j in ((0, 1), (1, 2), (2, 0)):
        runs.update(zip(corners[:, i].tolist(), corners[:, j].tolist(), strict=True))
    open_edges = [edge for edge, n in runs.items() if runs[edge[1], edge[0]] != n]
    assert not open_edges


@pytest.mark.parametrize("name", MESHES)
def test_faces_and_normals_point_out(name: str) -> None:
    mesh = MESHES[name]
    assert mesh.volume_m3() > 0
    np.testing.assert_allclose(np.sqrt(np.sum(mesh.normals**2, axis=1)), 1.0, atol=1e-5)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    along = np.einsum("ij,ikj->ik", cross, mesh.normals[mesh.triangles])
    assert np.all(along > 0)


def test_tanker_has_the_size_of_a_kc135() -> None:
    mesh = tanker_mesh()
    size = np.ptp(mesh.vertices, axis=0)
    assert size[0] == pytest.approx(41.53, abs=0.5)
    assert size[1] == pytest.approx(39.88, abs=0.1)
    assert mesh.vertices[:, 0].max() == pytest.approx(19.5, abs=0.1)
    assert -22.5 < mesh.vertices[:, 0].min() < -20.0


def test_uav_has_the_size_of_an_ice() -> None:
    np.testing.assert_allclose(np.ptp(uav_mesh().vertices, axis=0)[:2], [13.0, 11.4], atol=0.1)


@pytest.mark.parametrize("name", ["tanker", "uav"])
def test_left_and_right_are_alike(name: str) -> None:
    def corners(mesh: Mesh) -> list[tuple[float, ...]]:
        return sorted({tuple(p) for p in np.round(mesh.vertices, 4) + 0.0})

    np.testing.assert_allclose(corners(MESHES[name]), corners(MESHES[name].mirrored()), atol=2e-4)


@pytest.mark.parametrize("name", MESHES)
def test_no_paint_is_red(name: str) -> None:
    """Reflectance leads by red nowhere by more than a few steps of 255; detection asks for 60."""
    colours = MESHES[name].colours
    assert np.all((colours >= 0) & (colours <= 1))
    assert 255 * np.max(colours[:, 0] - colours[:, 1:].max(axis=1)) < 12


@pytest.mark.parametrize(("elevation", "azimuth", "length"), [(0.52, 0.0, 11.5), (0.35, 0.2, 9.0), (0.7, -0.25, 14.0)])
def test_boom_reaches_from_pivot_to_tip(scene: Scene, elevation: float, azimuth: float, length: float) -> None:
    state = BoomState(scene.boom.pivot_tanker_m, elevation, azimuth, length)
    T_fixed, T_telescope = boom_poses(state)[:2]
    fixed, telescope = boom_mesh()[:2]
    axis = (state.tip_tanker_m() - state.pivot_tanker_m) / length
    along = (T_telescope.transform(telescope.vertices) - state.pivot_tanker_m) @ axis
    assert along.max() == pytest.approx(length, abs=1e-9)
    assert along.min() < (T_fixed.transform(fixed.vertices) - state.pivot_tanker_m).dot(axis).max()
    tip = T_telescope.transform(telescope.vertices)[np.argmax(along)]
    assert np.sqrt(np.sum((tip - state.tip_tanker_m()) ** 2)) < 0.1
