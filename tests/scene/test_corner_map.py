"""The map of corners: on the mesh, in view, and where the detector finds them in rendered pictures without lights."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from tanker_scene import CONTACT, START, Scene, Tracer
from test_marker_map import bound_m, distances_to_skin

from companion.config import CameraConfig, LabelingConfig
from companion.geometry import SE3, Mat, exp_so3
from companion.vision.camera import pixels_to_normalised, project
from companion.vision.corners import Corners, detect_corners
from companion.vision.lhm import solve_lhm
from companion.vision.robust_labeling import label_robust
from sim_bridge.scene.camera_picture import CLEAR_DAY, CameraPicture
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.tanker_mesh import tanker_mesh

PATH = [START + s * (CONTACT - START) for s in np.linspace(0.0, 1.0, 7)]
LABELING = LabelingConfig(map_sigma_m=0.05, detection_probability=0.6, false_density=40.0, min_margin=6.0)
PRIOR_M, PRIOR_RAD = 0.3, 0.003


def corner_places(scene: Scene) -> Mat:
    return np.array([c.p_tanker_m for c in scene.tanker.corners])


def inside(camera: CameraConfig, uv: Mat, margin: float) -> np.ndarray:
    size = np.array([camera.width_px, camera.height_px])
    return np.all((uv >= margin) & (uv <= size - 1 - margin), axis=1)


def in_view(scene: Scene, tracer: Tracer, camera: CameraConfig, T_cam_tanker: SE3) -> np.ndarray:
    """Tell which corners are 6 px inside the picture, and not hidden: no part of the tanker is 0.5 m in front.

    Corners are on the skin, where the ray ends anyway: what ends within half a metre is the corner's own edge.
    """
    points = corner_places(scene)
    T_tanker_cam = T_cam_tanker.inverse()
    share = tracer.distance(T_tanker_cam.t, points - T_tanker_cam.t)
    reach = np.sqrt(np.sum((points - T_tanker_cam.t) ** 2, axis=1))
    return inside(camera, project(camera, T_cam_tanker, points), 6.0) & (share * reach > reach - 0.5)


def dark(scene: Scene) -> Scene:
    """Return the scene with lights too small to be drawn."""
    return Scene(msgspec.structs.replace(scene.tanker, marker_radius_m=1e-4), scene.cameras, scene.boom,
                 scene.T_ned_tanker)


def look(scene: Scene, name: str, places: list[np.ndarray], seed: int,
         conditions: PictureConditions = CLEAR_DAY) -> list[tuple[SE3, SE3, Corners]]:
    """Return the true pose, a prior as wrong as PRIOR says, and the corners found with it, at each place."""
    rng, camera = np.random.default_rng(seed), scene.cameras[name]
    picture, seen = CameraPicture(camera, scene.tanker, rng, conditions=conditions), []
    for p in places:
        T_ned_frd = scene.T_ned_frd(p + rng.normal(0.0, 0.3, 3), *rng.normal(0.0, 0.01, 3))
        T = scene.T_cam_tanker(camera, T_ned_frd)
        prior = SE3(exp_so3(rng.normal(0.0, PRIOR_RAD, 3)) @ T.R, T.t + rng.normal(0.0, PRIOR_M, 3))
        image = picture.render(scene.T_ned_tanker, T_ned_frd, scene.boom)
        seen.append((T, prior, detect_corners(image, project(camera, prior, corner_places(scene)))))
    return seen


def test_corners_are_on_the_airframe(scene: Scene) -> None:
    """Within 0.25 m: the point on which the corner of two outlines stays lies a little off either's skin."""
    away = [distances_to_skin(tanker_mesh(), p) for p in corner_places(scene)]
    assert max(away) < 0.25
    assert np.median(away) < 0.15


def test_corners_are_apart_and_far_from_a_line(scene: Scene) -> None:
    p = corner_places(scene)
    apart = np.sqrt(np.sum((p[:, None] - p[None]) ** 2, axis=2)) + 1e3 * np.eye(len(p))
    assert apart.min() > 1.0
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False) / np.sqrt(len(p))
    assert spread[1] > 4.0
    assert spread[2] > 0.4


@pytest.mark.parametrize(("name", "least"), [("default", 12), ("thesis", 10)])
def test_enough_are_in_view_from_start_to_contact(scene: Scene, tracer: Tracer, name: str, least: int) -> None:
    camera = scene.cameras[name]
    counts = [int(in_view(scene, tracer, camera, scene.T_cam_tanker(camera, scene.T_ned_frd(p))).sum()) for p in PATH]
    assert min(counts) >= least


def test_one_picture_bounds_the_position_within_the_window(scene: Scene) -> None:
    """Half a pixel per corner at 320x200, all of them: a decimetre or two across, half a metre along at the start."""
    camera = scene.cameras["thesis"]
    as_markers = msgspec.structs.replace(scene.tanker, markers=scene.tanker.corners)
    corners = Scene(as_markers, scene.cameras, scene.boom, scene.T_ned_tanker)
    at_start = bound_m(corners, scene.T_cam_tanker(camera, scene.T_ned_frd(START)), 0.5)
    at_contact = bound_m(corners, scene.T_cam_tanker(camera, scene.T_ned_frd(CONTACT)), 0.5)
    assert np.all(at_start < [0.2, 0.2, 0.5])
    assert np.all(at_contact < [0.05, 0.05, 0.1])


@pytest.mark.parametrize(("name", "share"), [("default", 0.6), ("thesis", 0.45)])
def test_the_detector_finds_them_without_lights(scene: Scene, name: str, share: float) -> None:
    """Of all corners in the picture, seen or hidden, this share has a candidate within 1.5 px, at every place."""
    camera = scene.cameras[name]
    for T, _, corners in look(dark(scene), name, PATH[::2], 11):
        uv = project(camera, T, corner_places(scene))
        uv = uv[inside(camera, uv, 6.0)]
        away = np.sqrt(np.sum((uv[:, None] - corners.uv_px[None]) ** 2, axis=2)).min(axis=1)
        assert np.mean(away < 1.5) >= share


def check_poses(scene: Scene, seen: list[tuple[SE3, SE3, Corners]]) -> None:
    """At 640x480: labels none of which is wrong, and a pose to 0.1 m across and 0.3 m along."""
    camera, points = scene.cameras["default"], corner_places(scene)
    cov = np.diag([PRIOR_M**2] * 3 + [PRIOR_RAD**2] * 3)
    for T, prior, corners in seen:
        rays = pixels_to_normalised(camera, corners.uv_px)
        labels = label_robust(points, rays, corners.sigma_px / camera.fx_px, prior, cov, LABELING).labels
        used = np.flatnonzero(labels >= 0)
        assert len(used) >= 6
        assert np.abs(corners.uv_px[labels[used]] - project(camera, T, points[used])).max() < 3.0
        pose = solve_lhm(points[used], rays[labels[used]], prior.R)
        assert pose.converged
        assert np.all(np.abs(pose.T_cam_tanker.t - T.t) < [0.1, 0.1, 0.3])


@pytest.mark.parametrize("lights", [True, False])
def test_labelled_corners_give_the_pose(scene: Scene, lights: bool) -> None:
    check_poses(scene, look(scene if lights else dark(scene), "default", PATH, 12))


@pytest.mark.parametrize("conditions", [PictureConditions(gain=0.25), PictureConditions(daylight=0.2),
                                        PictureConditions(haze=0.8)], ids=["underexposed", "dusk", "haze"])
def test_faint_corners_give_the_pose(scene: Scene, conditions: PictureConditions) -> None:
    check_poses(scene, look(scene, "default", PATH[::2], 13, conditions))
