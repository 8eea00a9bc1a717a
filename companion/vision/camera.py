"""The camera: pinhole with Brown distortion, and its place on the receiver (thesis 4.1, 4.2.2).

Rules
-----
* ``cam`` is the optical frame, right, down, forward; the thesis' CRF is forward, right, down at the same point.
* Pixels ``uv_px``: u right, v down, centres at integers. Normalised coordinates lie on the plane z = 1, undistorted;
  they take the place of the thesis' metres on the sensor (its eq. 4.1 with f = 1).
* What cannot be seen is NaN: points at or behind the plane of the camera, and points so far off the axis that the
  distortion polynomial has turned back.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from companion.config import CameraConfig
from companion.geometry import SE3, Mat, R_cam_crf, rotation_from_euler

NEAREST_M = 1e-6
"""Points nearer to the camera's plane than this, in metres, count as behind it."""

NEWTON_STEPS = 20


def T_frd_cam(camera: CameraConfig) -> SE3:
    """Return the camera's place on the receiver: optical axes ``cam`` to body axes ``frd``."""
    R_frd_crf = rotation_from_euler(camera.mount_yaw_rad, camera.mount_pitch_rad, camera.mount_roll_rad)
    return SE3(R_frd_crf @ R_cam_crf.T, np.array(camera.p_frd_cam_m, dtype=np.float64))


def project(camera: CameraConfig, T_cam_tanker: SE3, points: Mat) -> Mat:
    """Project points (n, 3) in m, tanker axes, to pixels (n, 2); NaN where the camera cannot see (thesis eq. 4.1)."""
    p_cam = T_cam_tanker.transform(np.asarray(points, dtype=np.float64))
    z = p_cam[:, 2]
    z = np.where(z > NEAREST_M, z, np.nan)
    return normalised_to_pixels(camera, p_cam[:, :2] / z[:, None])


def normalised_to_pixels(camera: CameraConfig, uv: Mat) -> Mat:
    """Map undistorted coordinates (n, 2) on z = 1 to pixels (n, 2); NaN beyond the reach of the distortion model."""
    xy = np.asarray(uv, dtype=np.float64)
    if any(camera.distortion):
        too_far = np.einsum("ij,ij->i", xy, xy) >= distortion_reach_squared(camera.distortion)
        xy = np.where(too_far[:, None], np.nan, distort(camera.distortion, xy))
    return xy * np.array([camera.fx_px, camera.fy_px]) + np.array([camera.cx_px, camera.cy_px])


def pixels_to_normalised(camera: CameraConfig, uv_px: Mat) -> Mat:
    """Map pixels (n, 2) to undistorted coordinates (n, 2) on z = 1 (thesis 4.2.2, "scale").

    The distortion is inverted by Newton's method from the distorted point; a pixel that no ray reaches is NaN.
    """
    px = np.asarray(uv_px, dtype=np.float64)
    target = (px - np.array([camera.cx_px, camera.cy_px])) / np.array([camera.fx_px, camera.fy_px])
    return undistort(camera.distortion, target) if any(camera.distortion) else target


def distort(distortion: tuple[float, float, float, float, float], xy: Mat) -> Mat:
    """Apply Brown's model (Brown 1966, in OpenCV's order k1, k2, p1, p2, k3) to (n, 2) coordinates on z = 1."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[:, 0], xy[:, 1]
    s = x * x + y * y
    radial = 1.0 + s * (k1 + s * (k2 + s * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=1,
    )


def undistort(distortion: tuple[float, float, float, float, float], target: Mat) -> Mat:
    """Invert ``distort`` for (n, 2) coordinates to 1e-10; NaN where there is no inverse within the model's reach."""
    k1, k2, p1, p2, k3 = distortion
    reach = distortion_reach_squared(distortion)
    xy = target.copy()
    for _ in range(NEWTON_STEPS):
        x, y = xy[:, 0], xy[:, 1]
        s = x * x + y * y
        radial = 1.0 + s * (k1 + s * (k2 + s * k3))
        slope = 2.0 * (k1 + s * (2.0 * k2 + s * 3.0 * k3))
        a = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        b = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        d = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        error = distort(distortion, xy) - target
        determinant = a * d - b * b
        determinant = np.where(np.abs(determinant) > 1e-6, determinant, np.nan)
        step = np.stack([d * error[:, 0] - b * error[:, 1], a * error[:, 1] - b * error[:, 0]], axis=1)
        step /= determinant[:, None]
        xy = xy - step
        if not np.any(np.abs(step) > 1e-13):
            break
    missed = np.abs(distort(distortion, xy) - target).max(axis=1) > 1e-10
    return np.where((missed | (np.einsum("ij,ij->i", xy, xy) >= reach))[:, None], np.nan, xy)


@lru_cache(maxsize=32)
def distortion_reach_squared(distortion: tuple[float, float, float, float, float]) -> float:
    """Return the squared radius on z = 1 at which the radial polynomial stops growing; inf when it never does."""
    k1, k2, _, _, k3 = distortion
    # In w = 1 / s of the squared radius s the slope is a cubic that begins with one: no coefficient to divide by.
    roots = np.roots([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
    turning = [float(w.real) for w in roots if abs(float(w.imag)) < 1e-12 and float(w.real) > 1e-9]
    return 1.0 / max(turning) if turning else float("inf")
