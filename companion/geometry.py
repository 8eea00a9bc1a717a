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

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GRAVITY_M_S2 = 9.80665
"""Standard gravity, down."""

Vec = NDArray[np.float64]
Mat = NDArray[np.float64]

R_cam_crf: Mat = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Thesis camera axes (forward, right, down) to optical axes (right, down, forward)."""

IDENTITY: Mat = np.eye(3)
IDENTITY.setflags(write=False)


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
    cps, sps = math.cos(yaw_rad), math.sin(yaw_rad)
    cth, sth = math.cos(pitch_rad), math.sin(pitch_rad)
    cph, sph = math.cos(roll_rad), math.sin(roll_rad)
    # Here and below: plain floats row by row in one tuple, over which numpy is quicker than over its own in lists.
    return np.array((
        cth * cps, sph * sth * cps - cph * sps, cph * sth * cps + sph * sps,
        cth * sps, sph * sth * sps + cph * cps, cph * sth * sps - sph * cps,
        -sth, sph * cth, cph * cth,
    )).reshape(3, 3)  # fmt: skip


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
    norm = math.sqrt(q @ q)
    if not 0.9 < norm < 1.1:  # also false for NaN
        msg = f"quaternion norm {norm:.3g} is not 1"
        raise ValueError(msg)
    w, x, y, z = (q / norm).tolist()
    return np.array((
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )).reshape(3, 3)  # fmt: skip


def quaternion_from_rotation(R: Mat) -> Vec:
    """Return the Hamilton quaternion (w, x, y, z) with w >= 0 of a rotation matrix.

    Picks the largest of the four squared components first (Shepperd 1978), so it is exact near half turns too.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = R.tolist()
    trace = r00 + r11 + r22
    largest = max(trace, r00, r11, r22)
    if largest == trace:
        q = np.array((1.0 + trace, r21 - r12, r02 - r20, r10 - r01))
    elif largest == r00:
        q = np.array((r21 - r12, 1.0 + 2 * r00 - trace, r01 + r10, r02 + r20))
    elif largest == r11:
        q = np.array((r02 - r20, r01 + r10, 1.0 + 2 * r11 - trace, r12 + r21))
    else:
        q = np.array((r10 - r01, r02 + r20, r12 + r21, 1.0 + 2 * r22 - trace))
    q /= math.sqrt(q @ q)
    return q if q[0] >= 0 else -q


def exp_so3(rotation_vector_rad: Vec) -> Mat:
    """Return the rotation by the angle and about the axis of a (3,) rotation vector (Rodrigues)."""
    v = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = math.sqrt(v @ v)
    K = skew(v)
    if angle < 1e-8:
        return IDENTITY + K + 0.5 * (K @ K)
    a = math.sin(angle) / angle
    b = (1.0 - math.cos(angle)) / (angle * angle)
    return IDENTITY + a * K + b * (K @ K)


def log_so3(R: Mat) -> Vec:
    """Return the rotation vector (3,) in rad, angle in [0, pi], of a rotation matrix."""
    q = quaternion_from_rotation(R)
    sin_half = float(np.sqrt(q[1:] @ q[1:]))
    if sin_half < 1e-12:
        return 2.0 * q[1:]
    return q[1:] * (2.0 * np.arctan2(sin_half, q[0]) / sin_half)


def skew(v: Vec) -> Mat:
    """Return the matrix of the cross product: ``skew(v) @ x == np.cross(v, x)``."""
    x, y, z = np.asarray(v).tolist()
    return np.array((0.0, -z, y, z, 0.0, -x, -y, x, 0.0)).reshape(3, 3)
