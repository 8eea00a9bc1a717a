"""Synthetic frames for integrity: the shipped camera and lights, noise as the tests assume it, and faults on demand."""

from dataclasses import dataclass, field, replace

import numpy as np

from companion.config import FIRMWARE_CONFIGS, landmarks, load_setup
from companion.estimation.integrity import IntegrityMonitor
from companion.geometry import SE3, exp_so3, rotation_from_euler
from companion.messages import (
    Detections,
    FusedPose,
    PoseMeasurement,
    RelativeState,
    Sources,
    VisionOutput,
)
from companion.pipeline import eye_of
from companion.vision.camera import T_frd_cam, project
from companion.vision.refinement import refine_pose

S = 1_000_000_000
SETUP = load_setup(FIRMWARE_CONFIGS / "sitl" / "docking.toml")
CAMERA, VISION, CONFIG = SETUP.camera, SETUP.config.vision, SETUP.config.integrity
LIGHTS = landmarks(SETUP.tanker, VISION)
MARKERS = np.array([m.p_tanker_m for m in LIGHTS])
BOX = np.array(SETUP.tanker.box_tanker_m)
RECEPTACLE = np.array(SETUP.airframe.receptacle_frd_m)
FOCAL_PX = CAMERA.fx_px
PASSING_PX = 0.035
FRAME_NS = 50_000_000
R_NED_TANKER = np.eye(3)


def monitor(config=CONFIG, lights=LIGHTS):
    return IntegrityMonitor(config, SETUP.tanker.window, eye_of(CAMERA), lights, VISION)


def receiver(br_m, euler=(0.0, 0.05, 0.0)):
    """Return T_cam_tanker and R_ned_frd of a receiver whose receptacle is at ``br_m`` from the box; tanker level."""
    R_ned_frd = rotation_from_euler(*euler)
    p_ned_frd = BOX + np.asarray(br_m) - R_ned_frd @ RECEPTACLE
    return (SE3(R_ned_frd, p_ned_frd) @ T_frd_cam(CAMERA)).inverse(), R_ned_frd


@dataclass
class World:
    """One flight's truth and its errors.

    ``moved_m`` (n, 3) of lights against the map, ``lasting_px`` (n, 2), ``gps_off_ned_m``, ``mount_rad`` (3,) by which
    the camera is turned against the configuration, ``seen`` markers with a label, ``cov_m2`` that the estimate claims.
    """

    rng: np.random.Generator
    br_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moved_m: np.ndarray = field(default_factory=lambda: np.zeros_like(MARKERS))
    lasting_px: np.ndarray = field(default_factory=lambda: np.zeros((len(MARKERS), 2)))
    gps_off_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gps_sigma_m: float = 0.14
    mount_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seen: tuple[int, ...] = tuple(range(len(MARKERS)))
    cov_m2: np.ndarray = field(default_factory=lambda: 0.003**2 * np.eye(3))
    t_ns: int = S

    def usual(self):
        """Draw calibration, light and survey as the configuration says that they are."""
        n = len(MARKERS)
        lasting = self.rng.normal(0.0, CONFIG.sigma_px, (n, 2))
        return replace(self, moved_m=self.rng.normal(0.0, CONFIG.map_sigma_m, (n, 3)), lasting_px=lasting)

    def detections(self, T_cam_tanker):
        uv = project(CAMERA, T_cam_tanker, MARKERS + self.moved_m) + self.lasting_px
        uv = uv + self.rng.normal(0.0, PASSING_PX, uv.shape)
        n = len(uv)
        return Detections(self.t_ns, uv, np.full(n, 20.0), np.full(n, PASSING_PX), np.zeros(n, dtype=np.uint8))

    def labels(self):
        labels = np.full(len(MARKERS), -1)
        labels[list(self.seen)] = self.seen
        return labels

    def frame(self):
        """Return the next frame: (outputs of vision and blend, relative state, error of BR in mrf)."""
        self.t_ns += FRAME_NS
        T_true, R_ned_frd = receiver(self.br_m)
        T_true = SE3(exp_so3(np.array(self.mount_rad)) @ T_true.R, exp_so3(np.array(self.mount_rad)) @ T_true.t)
        T_nominal, _ = receiver(self.br_m)
        found = self.detections(T_true)
        pose = self.pose(found, T_true, T_nominal)
        seen = VisionOutput(self.t_ns, 0, found, found.uv_px, self.labels(), pose, None)
        gps = np.array(self.gps_off_ned_m) + self.rng.normal(0.0, self.gps_sigma_m, 3)
        R_cam_ned = T_nominal.R @ R_NED_TANKER.T
        T_gps = SE3(T_nominal.R, T_nominal.t - R_cam_ned @ gps)
        t = T_nominal.t if pose is None else pose.T_cam_tanker.t
        fused = FusedPose(self.t_ns, SE3(T_nominal.R, t), T_gps, 1.0, len(self.seen))
        error_m = -R_cam_ned.T @ (t - T_nominal.t)
        return (seen, fused), self.state(fused.T_cam_tanker, R_ned_frd, error_m), error_m

    def pose(self, found, T_true, T_nominal):
        """Return the pose of the labelled markers as the vision solves it: few with the attitude of the INS."""
        at = np.array(self.seen, dtype=int)
        if len(at) < VISION.min_markers_ins:
            return None
        uv = (found.uv_px[at] - [CAMERA.cx_px, CAMERA.cy_px]) / FOCAL_PX
        sigma = np.full(len(at), np.hypot(PASSING_PX, VISION.sigma_px) / FOCAL_PX)
        attitude = () if len(at) >= VISION.min_markers else (T_nominal.R, VISION.ins_sigma_rad**2 * np.eye(3))
        p = refine_pose(MARKERS[at], uv, T_true, sigma, *attitude)
        return PoseMeasurement(self.t_ns, p.T_cam_tanker, self.labels(), len(at), 1, 0.0, p.image_error, p.cov)

    def state(self, T_cam_tanker, R_ned_frd, error_m):
        zero = np.zeros(3)
        return RelativeState(
            self.t_ns, self.t_ns, np.array(self.br_m) + error_m, zero, zero, zero, R_ned_frd, zero, 0.0, 0.0,
            T_cam_tanker, float(np.linalg.norm(T_cam_tanker.t)), 1.0, len(self.seen), self.cov_m2,
        )

    def sources(self):
        return Sources(self.t_ns, self.t_ns, self.t_ns, self.t_ns)


def fly(watcher, world, frames):
    """Show frames to a monitor; return (integrity, error of BR (3,)) of each."""
    out = []
    for _ in range(frames):
        outputs, state, error_m = world.frame()
        for output in outputs:
            watcher.see(output)
        out.append((watcher.at(state, world.sources()), error_m))
    return out


def first_s(flown, fault):
    """Return after how many seconds of frames a fault is first told, infinite when never."""
    return next((k * FRAME_NS / S for k, (i, _) in enumerate(flown, 1) if fault in i.faults), np.inf)
