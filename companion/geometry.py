"""Rotations and rigid transforms, and the names of the frames.

Rules
-----
* ``T_a_b`` maps frame b to frame a: ``p_a = T_a_b @ p_b``; inner names cancel, ``T_a_c = T_a_b @ T_b_c``
* Rotations are (3, 3) float64 matrices inside. Quaternions live at boundaries only: Hamilton, wxyz, w >= 0.
* Euler angles are yaw psi, pitch theta, roll phi of the aerospace sequence z-y'-x'', in rad.

========== ======================================================================================
frame      meaning
========== ======================================================================================
``ned``    local north-east-down, fixed origin at the start of the flight (thesis ERF)
``mrf``    ``ned`` turned about down by the tanker's nominal heading psi0 (thesis MRF, "psi frame")
``tanker`` tanker body: forward, right, down; origin at its centre of mass (thesis TRF)
``frd``    receiver body: forward, right, down; origin at its centre of mass (thesis URF)
``cam``    camera, optical: right, down, forward; origin at the centre of projection. The thesis'
           CRF is forward, right, down at the same point: ``R_cam_crf`` below converts.
========== ======================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]
Mat = NDArray[np.float64]

R_cam_crf: Mat = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Thesis camera axes (forward, right, down) to optical axes (right, down, forward)."""


@dataclass(frozen=True, slots=True, eq=False)
class SE3:
    """Rigid transform ``p_a = R p_b + t``; R (3, 3) rotation, t (3,) in metres."""

    R: Mat
    t: Vec

    @staticmethod
    def identity() -> SE3:
        """Return the transform that changes nothing."""
        return SE3(np.eye(3), np.zeros(3))

    def inverse(self) -> SE3:
        """Return ``T_b_a`` for this ``T_a_b``."""
        return SE3(self.R.T.copy(), -self.R.T @ self.t)

    def as_matrix(self) -> Mat:
        """Return the (4, 4) homogeneous matrix (thesis eq. 4.3)."""
        T = np.eye(4)
        T[:3, :3] = self.R
        T[:3, 3] = self.t
        return T

    def transform(self, points: Mat) -> Mat:
        """Map points of shape (3,) or (n, 3)."""
        return points @ self.R.T + self.t

    def compose(self, other: SE3) -> SE3:
        """Return ``T_a_c`` from this ``T_a_b`` and other ``T_b_c``."""
        return SE3(self.R @ other.R, self.R @ other.t + self.t)

    def __matmul__(self, other: SE3) -> SE3:
        """Compose: ``T_a_c = T_a_b @ T_b_c``. Points go through ``transform``."""
        return self.compose(other)


def rotation_from_euler(yaw_rad: float, pitch_rad: float, roll_rad: float) -> Mat:
    """Return ``R_ned_body`` for the aerospace angles psi, theta, phi."""
    cps, sps = np.cos(yaw_rad), np.sin(yaw_rad)
    cth, sth = np.cos(pitch_rad), np.sin(pitch_rad)
    cph, sph = np.cos(roll_rad), np.sin(roll_rad)
    return np.array(
        [
            [cth * cps, sph * sth * cps - cph * sps, cph * sth * cps + sph * sps],
            [cth * sps, sph * sth * sps + cph * cps, cph * sth * sps - sph * cps],
            [-sth, sph * cth, cph * cth],
        ]
    )


def euler_from_rotation(R_ned_body: Mat) -> tuple[float, float, float]:
    """Return (yaw, pitch, roll) in rad of ``R_ned_body``; at pitch = +-pi/2 roll is 0."""
    sin_pitch = -float(R_ned_body[2, 0])
    if abs(sin_pitch) > 1.0 - 1e-12:
        yaw = float(np.arctan2(-R_ned_body[0, 1], R_ned_body[1, 1]))
        return yaw, float(np.copysign(np.pi / 2, sin_pitch)), 0.0
    yaw = float(np.arctan2(R_ned_body[1, 0], R_ned_body[0, 0]))
    roll = float(np.arctan2(R_ned_body[2, 1], R_ned_body[2, 2]))
    return yaw, float(np.arcsin(sin_pitch)), roll


def rotation_from_quaternion(q_wxyz: Vec) -> Mat:
    """Return the rotation of a Hamilton quaternion (w, x, y, z), normalised here.

    Raises ValueError when the quaternion is not finite or its norm is not within 10 % of one, which at a boundary
    tells a wrong message from a rounded one.
    """
    q = np.asarray(q_wxyz, dtype=np.float64)
    norm = float(np.sqrt(q @ q))
    if not 0.9 < norm < 1.1:  # also false for NaN
        msg = f"quaternion norm {norm:.3g} is not 1"
        raise ValueError(msg)
    w, x, y, z = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R: Mat) -> Vec:
    """Return the Hamilton quaternion (w, x, y, z) with w >= 0 of a rotation matrix.

    Picks the largest of the four squared components first (Shepperd 1978), so it is exact near half turns too.
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    squares = np.array([trace, R[0, 0], R[1, 1], R[2, 2]])
    k = int(np.argmax(squares))
    if k == 0:
        q = np.array([1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    elif k == 1:
        q = np.array([R[2, 1] - R[1, 2], 1.0 + 2 * R[0, 0] - trace, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]])
    elif k == 2:
        q = np.array([R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], 1.0 + 2 * R[1, 1] - trace, R[1, 2] + R[2, 1]])
    else:
        q = np.array([R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1.0 + 2 * R[2, 2] - trace])
    q /= np.sqrt(q @ q)
    return q if q[0] >= 0 else -q


def exp_so3(rotation_vector_rad: Vec) -> Mat:
    """Return the rotation by the angle and about the axis of a (3,) rotation vector (Rodrigues)."""
    v = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = float(np.sqrt(v @ v))
    K = skew(v)
    if angle < 1e-8:
        return np.eye(3) + K + 0.5 * (K @ K)
    a = np.sin(angle) / angle
    b = (1.0 - np.cos(angle)) / (angle * angle)
    return np.eye(3) + a * K + b * (K @ K)


def log_so3(R: Mat) -> Vec:
    """Return the rotation vector (3,) in rad, angle in [0, pi], of a rotation matrix."""
    q = quaternion_from_rotation(R)
    sin_half = float(np.sqrt(q[1:] @ q[1:]))
    if sin_half < 1e-12:
        return 2.0 * q[1:]
    return q[1:] * (2.0 * np.arctan2(sin_half, q[0]) / sin_half)


def skew(v: Vec) -> Mat:
    """Return the matrix of the cross product: ``skew(v) @ x == np.cross(v, x)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
