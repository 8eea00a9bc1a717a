"""Who hides whom, against Embree: a ray tracer that shares nothing with the rasterizer but the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from tanker_scene import CONTACT, START, Scene, Tracer

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, Vec
from companion.vision.camera import T_frd_cam
from sim_bridge.scene import rasterizer as kernels
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.drawing import pinhole_of
from sim_bridge.scene.tanker_parts import tanker_poses
from sim_bridge.scene.visibility import marker_visibility, tanker_triangles, unit_disc


def poses_all_round(scene: Scene, count: int, seed: int) -> list[SE3]:
    """Return places all round the tanker, looking roughly at it, where much is hidden; some on the approach."""
    r = np.random.default_rng(seed)
    poses = [scene.T_ned_frd(START + s * (CONTACT - START), *r.normal(0, 0.1, 3)) for s in r.uniform(0, 1, count // 4)]
    while len(poses) < count:
        direction = r.normal(0, 1, 3)
        direction /= np.sqrt(direction @ direction)
        place = direction * r.uniform(16, 60) + r.uniform(-6, 6, 3)
        yaw, up = np.arctan2(-place[1], -place[0]), np.arcsin(place[2] / np.sqrt(place @ place))
        poses.append(scene.T_ned_frd(place, yaw, up - 0.467 + r.normal(0, 0.1), r.normal(0, 0.3)))
    return poses


def camera_in_tanker(scene: Scene, camera: CameraConfig, T_ned_frd: SE3) -> SE3:
    return scene.T_ned_tanker.inverse() @ T_ned_frd @ T_frd_cam(camera)


def traced_share(tracer: Tracer, T_tanker_cam: SE3, camera: CameraConfig, centre: Vec, radius: float) -> float:
    """Return the share of 256 rays to a sphere that are in the picture and meet nothing before it."""
    p = T_tanker_cam.inverse().transform(centre)
    if p[2] < 1.0:
        return 0.0
    ends = p + np.column_stack([radius * unit_disc(256), np.zeros(256)])
    rays = ends / ends[:, 2:]
    dc, dd = rays @ p, np.einsum("ij,ij->i", rays, rays)
    first = (dc - np.sqrt(np.maximum(dc**2 - dd * (p @ p - radius**2), 0.0))) / dd
    uv = rays[:, :2] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
    inside = np.all((uv > -0.5) & (uv < np.array([camera.width_px, camera.height_px]) - 0.5), axis=1)
    free = tracer.distance(T_tanker_cam.t, rays @ T_tanker_cam.R.T) > first
    return float(np.mean(inside & free))


def test_visible_shares_agree_with_embree(scene: Scene, tracer: Tracer) -> None:
    camera = scene.cameras["default"]
    ours, traced = [], []
    for T_ned_frd in poses_all_round(scene, 80, 11):
        ours.append(marker_visibility(camera, scene.tanker, scene.T_ned_tanker, T_ned_frd, scene.boom))
        T = camera_in_tanker(scene, camera, T_ned_frd)
        traced.append([traced_share(tracer, T, camera, c, scene.tanker.marker_radius_m) for c in scene.markers()])
    a, b = np.array(ours).ravel(), np.array(traced).ravel()
    assert min(np.sum(b == 0.0), np.sum(b == 1.0)) > 100
    assert np.sum((b > 0.02) & (b < 0.98)) > 10
    np.testing.assert_allclose(a, b, atol=0.06)


def test_picture_shows_just_the_lights_that_embree_sees(scene: Scene, tracer: Tracer) -> None:
    """Light laid on the picture, against the free part of each sphere's solid angle in pixels."""
    camera = scene.cameras["default"]
    dim, lit = (
        CameraPicture(camera, scene.tanker, np.random.default_rng(1), light=light, noise=0.0)
        for light in ((0.1, 0.1, 0.1), (0.9, 0.1, 0.1))
    )
    lights = 0
    for T_ned_frd in poses_all_round(scene, 40, 12):
        T = camera_in_tanker(scene, camera, T_ned_frd)
        red, low = (p.render(scene.T_ned_tanker, T_ned_frd, scene.boom)[..., 0].astype(float) for p in (lit, dim))
        shares = np.array([traced_share(tracer, T, camera, c, scene.tanker.marker_radius_m) for c in scene.markers()])
        p = T.inverse().transform(scene.markers())
        z, away = np.abs(p[:, 2]), np.sqrt(np.sum(p**2, axis=1))
        areas = np.pi * (camera.fx_px * scene.tanker.marker_radius_m / z) ** 2 * away / z  # an ellipse off the axis
        areas = np.where(shares > 0, areas, 0.0)
        expected = float(areas @ shares)
        lights += int(np.sum(shares > 0))
        assert float(np.sum(red - low)) / (0.8 * 255.0) == pytest.approx(expected, rel=0.04, abs=0.5)
    assert lights > 60


def drawn(scene: Scene, camera: CameraConfig, T_ned_frd: SE3) -> Mat:
    """Return 1/z at pixel centres by the rasterizer's own kernels, 0 for sky, one sample per pixel."""
    triangles, pinhole = tanker_triangles(), pinhole_of(camera)
    count = triangles.place(pinhole, 1, tanker_poses(scene.T_ned_tanker, scene.boom), T_ned_frd @ T_frd_cam(camera))
    depth, ident = np.zeros((640, 640), np.float32), np.full((640, 640), kernels.SKY, np.int32)
    for t in range(count):
        kernels.draw_triangle(triangles.table[t], t, triangles.box[t], 0, 0, depth, ident)
    np.testing.assert_array_equal(ident >= 0, depth > 0)
    return depth[: camera.height_px, : camera.width_px].astype(np.float64)


def test_outline_and_depth_agree_with_embree(scene: Scene, tracer: Tracer) -> None:
    """Pixel by pixel: the airframe covers the same pixels, but for a few on an edge, at the same distance."""
    camera = scene.cameras["thesis"]
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones(u.shape)], axis=2)
    for T_ned_frd in [scene.T_ned_frd(START), scene.T_ned_frd(CONTACT), *poses_all_round(scene, 8, 13)]:
        T = camera_in_tanker(scene, camera, T_ned_frd)
        traced = 1.0 / tracer.distance(T.t, rays.reshape(-1, 3) @ T.R.T).reshape(u.shape)
        ours = drawn(scene, camera, T_ned_frd)
        agree = np.abs(ours - traced) < 2e-3 * np.maximum(ours, traced)
        assert np.mean(agree | ((ours == 0) & (traced == 0))) > 0.999
        assert np.sum(ours > 0) > 500
