"""The camera: pinhole behind a lens that bends, and its place on the receiver (thesis 4.1, 4.2.2).

Rules
-----
* ``cam`` is the optical frame, right, down, forward; the thesis' CRF is forward, right, down at the same point.
* Pixels ``uv_px``: u right, v down, centres at integers. Normalised coordinates lie on the plane z = 1, undistorted;
  they take the place of the thesis' metres on the sensor (its eq. 4.1 with f = 1).
* The lens is Brown's (``plumb_bob``: OpenCV's k1, k2, p1, p2, k3), Brown's over a polynomial (``rational_polynomial``:
  k1, k2, p1, p2, k3, k4, k5, k6) or a fisheye (``equidistant``: k1, k2, k3, k4 of Kannala and Brandt). The names are
  those of ROS, the orders those of ROS and OpenCV.
* What cannot be seen is NaN: points at or behind the plane of the camera, and points so far off the axis that the
  distortion has turned back. A fisheye ends at 90 degrees off the axis, because coordinates on z = 1 do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

from companion.config import CameraConfig
from companion.config.structures import DistortionModel
from companion.geometry import SE3, Mat, R_cam_crf, Vec, rotation_from_euler
from companion.vision.lens_kernel import distort_points, undistort_points

NEAREST_M = 1e-6
"""Points nearer to the camera's plane than this, in metres, count as behind it."""


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
    if bends(camera):
        lens = lens_of(camera.distortion_model, camera.distortion)
        xy = distort_points(lens.fisheye, lens.k, lens.reach_squared, np.ascontiguousarray(xy))
    return xy * np.array([camera.fx_px, camera.fy_px]) + np.array([camera.cx_px, camera.cy_px])


def pixels_to_normalised(camera: CameraConfig, uv_px: Mat) -> Mat:
    """Map pixels (n, 2) to undistorted coordinates (n, 2) on z = 1 (thesis 4.2.2, "scale").

    The distortion is inverted by Newton's method, to 1e-10 on z = 1; a pixel that no ray reaches is NaN.
    """
    px = np.asarray(uv_px, dtype=np.float64)
    target = (px - np.array([camera.cx_px, camera.cy_px])) / np.array([camera.fx_px, camera.fy_px])
    if not bends(camera):
        return target
    lens = lens_of(camera.distortion_model, camera.distortion)
    return undistort_points(lens.fisheye, lens.k, lens.reach_squared, target)


def bends(camera: CameraConfig) -> bool:
    """Return whether the lens bends straight lines; an ``equidistant`` one does so even with zero coefficients."""
    return camera.distortion_model == "equidistant" or any(camera.distortion)


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A distortion as the kernels take it; ``k`` (8,), ``reach_squared`` on z = 1."""

    fisheye: bool
    k: Vec
    reach_squared: float


@lru_cache(maxsize=32)
def lens_of(model: DistortionModel, distortion: tuple[float, ...]) -> Lens:
    """Return the lens of a model and its coefficients, as many as the rules of the configuration let through."""
    k = np.zeros(8)
    k[: len(distortion)] = distortion
    return Lens(model == "equidistant", k, distortion_reach_squared(distortion, model))


def distortion_reach_squared(distortion: tuple[float, ...], model: DistortionModel = "plumb_bob") -> float:
    """Return the squared radius on z = 1 at which the distorted radius stops growing; inf when it never does.

    What would be farther out comes back into the picture, or, for the rational model, jumps to the other side. The
    tangential terms do not count here.
    """
    k1, k2, third, fourth, k3, k4, k5, k6 = (*distortion, *(0.0,) * (8 - len(distortion)))
    if model == "equidistant":
        theta_squared = first_root(Polynomial([1.0, 3.0 * k1, 5.0 * k2, 7.0 * third, 9.0 * fourth]))
        return float(np.tan(np.sqrt(theta_squared)) ** 2) if theta_squared < (np.pi / 2) ** 2 else float("inf")
    # r g(s) with g = top / bottom grows while top bottom + 2 s (top' bottom - top bottom') > 0.
    top, bottom = Polynomial([1.0, k1, k2, k3]), Polynomial([1.0, k4, k5, k6])
    slope = top * bottom + Polynomial([0.0, 2.0]) * (top.deriv() * bottom - top * bottom.deriv())
    return min(first_root(slope), first_root(bottom))


def first_root(polynomial: Polynomial) -> float:
    """Return the least positive root of a polynomial that is one at zero; inf when there is none."""
    # In 1 / s the coefficient of the highest power is the one: nothing small to divide by.
    roots = np.roots(polynomial.coef)
    turning = [float(w.real) for w in roots if abs(float(w.imag)) < 1e-12 and float(w.real) > 1e-9]
    return 1.0 / max(turning) if turning else float("inf")
