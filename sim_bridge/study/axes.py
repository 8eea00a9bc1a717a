"""The thesis' way to write a pose, X = [x y z psi theta phi] in its camera axes, for one pose and for many."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.geometry import SE3, Mat, R_cam_crf, Vec, rotation_from_euler

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")


def pose(xyz_m: Sequence[float] | Vec, psi_theta_phi_rad: Sequence[float] | Vec) -> SE3:
    """Return ``T_cam_tanker`` of X: R_crf_tanker = Rx(phi) Ry(theta) Rz(psi) (eq. 5.41)."""
    yaw, pitch, roll = psi_theta_phi_rad
    return SE3(R_cam_crf @ rotation_from_euler(yaw, pitch, roll).T, R_cam_crf @ np.asarray(xyz_m, dtype=np.float64))


def xyz(t_cam_tanker: Mat) -> Mat:
    """Return positions (k, 3) or (3,) of the optical camera axes in the thesis', m."""
    return t_cam_tanker @ R_cam_crf


def rpy(R_cam_tanker: Mat) -> Mat:
    """Return roll, pitch, yaw (k, 3) in rad of rotations (k, 3, 3)."""
    R = np.einsum("ji,kjl->kli", R_cam_crf, R_cam_tanker)  # R_tanker_crf, whose Euler angles these are
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    return np.stack([np.arctan2(R[:, 2, 1], R[:, 2, 2]), pitch, yaw], axis=1)


def six(t: Mat, R: Mat) -> Mat:
    """Return (k, 6) x y z roll pitch yaw of many poses in optical axes."""
    return np.concatenate([xyz(t), rpy(R)], axis=1)


def six_of(poses: Sequence[SE3]) -> Mat:
    """Return (k, 6) x y z roll pitch yaw of poses."""
    return six(np.array([T.t for T in poses]), np.array([T.R for T in poses]))


def differences(a: Mat, b: Mat) -> Mat:
    """Return a - b of (k, 6), angles within half a turn."""
    d = a - b
    d[:, 3:] = (d[:, 3:] + np.pi) % (2.0 * np.pi) - np.pi
    return d


def image(T_cam_tanker: SE3, points: Mat) -> Mat:
    """Return points (n, 3), tanker axes, on the plane z = 1 (n, 2)."""
    q = T_cam_tanker.transform(points)
    return q[:, :2] / q[:, 2:]
