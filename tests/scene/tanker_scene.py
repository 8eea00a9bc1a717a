"""The scene of these tests, and an independent ray tracer over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from companion.config import FIRMWARE_CONFIGS, CameraConfig, TankerConfig, load
from companion.geometry import SE3, Mat, Vec, rotation_from_euler
from companion.vision.camera import T_frd_cam
from sim_bridge.scene.boom_mesh import boom_poses
from sim_bridge.scene.tanker_parts import tanker_parts
from sim_bridge.truth import BoomState

START = np.array([-50.0, -20.0, 30.0])
CONTACT = np.array([-29.0, 0.0, 9.0])


@dataclass(frozen=True)
class Scene:
    """Tanker in level flight with its boom at rest, and both cameras."""

    tanker: TankerConfig
    cameras: dict[str, CameraConfig]
    boom: BoomState
    T_ned_tanker: SE3

    def T_ned_frd(self, p_tanker: Vec, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> SE3:
        """Place the receiver in tanker axes, turned by small angles off the tanker's own attitude."""
        return self.T_ned_tanker @ SE3(rotation_from_euler(yaw, pitch, roll), np.asarray(p_tanker, dtype=np.float64))

    def T_cam_tanker(self, camera: CameraConfig, T_ned_frd: SE3) -> SE3:
        return (T_ned_frd @ T_frd_cam(camera)).inverse() @ self.T_ned_tanker

    def markers(self) -> Mat:
        return np.array([m.p_tanker_m for m in self.tanker.markers])


def level_scene() -> Scene:
    """Return the shipped tanker, boom at rest, level at 6000 m, and the shipped cameras."""
    tanker = load(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig)
    cameras = {n: load(FIRMWARE_CONFIGS / "cameras" / f"{n}.toml", CameraConfig) for n in ("default", "thesis")}
    b = tanker.boom
    boom = BoomState(np.array(b.pivot_tanker_m), b.elevation_rad, b.azimuth_rad, b.length_m)
    return Scene(tanker, cameras, boom, SE3(rotation_from_euler(0.3, 0.064, 0.0), np.array([1000.0, 500.0, -6000.0])))


class Tracer:
    """Embree over tanker and boom in tanker axes: who is hit first, independent of the rasterizer."""

    def __init__(self, boom: BoomState) -> None:
        mesh, part = tanker_parts()
        vertices = mesh.vertices.copy()
        for k, T in enumerate(boom_poses(boom), start=1):
            vertices[part == k] = T.transform(mesh.vertices[part == k])
        self.scene = EmbreeScene()
        self.mesh = TriangleMesh(self.scene, vertices.astype(np.float32), mesh.triangles.astype(np.int32))

    def distance(self, origin: Vec, directions: Mat) -> Vec:
        """Return the distance (n,) to the first hit in units of each direction's length; inf where there is none."""
        origins = np.tile(origin, (len(directions), 1)).astype(np.float32)
        hit = self.scene.run(origins, directions.astype(np.float32), query="DISTANCE")
        return np.where(hit > 1e6, np.inf, hit)
