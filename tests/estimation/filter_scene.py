"""Material for the filter's tests: two aircraft, nine markers, a camera, and a flight with the noise that is assumed.

``draw`` makes a flight whose errors are drawn from what the configuration says of them, as measurements with truth.
"""

from dataclasses import dataclass, field

import numpy as np

from companion.config import CameraConfig, FilterConfig
from companion.estimation.filter_measurements import Geometry, GpsDifference, MarkerPixels, Offset, PixelFrame
from companion.estimation.filter_state import SIZE, initial_sigma
from companion.geometry import SE3, R_cam_crf, exp_so3, rotation_from_euler

MS = 1_000_000
S = 1_000_000_000
FOCAL_PX = 457.0
T_FRD_CAM = SE3(rotation_from_euler(0.0, 0.467, 0.0) @ R_cam_crf.T, np.array([5.0, 0.0, -0.3]))
CAMERA = CameraConfig(name="c", width_px=640, height_px=480, rate_hz=20.0, fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=319.5,
                      cy_px=239.5, p_frd_cam_m=(5.0, 0.0, -0.3), mount_pitch_rad=0.467)
MARKERS = np.array([
    [10.0, -0.97, 1.92], [2.29, 7.52, 3.19], [1.57, -8.3, 3.33], [-4.04, -12.01, 0.39], [-3.42, 11.01, 0.53],
    [-1.57, 8.01, 0.94], [-1.57, -8.01, 0.94], [-14.02, -0.97, 0.94], [-10.01, 0.0, 2.03],
])  # fmt: skip
R_OWN, R_TANKER = rotation_from_euler(0.02, 0.06, -0.1), rotation_from_euler(0.01, 0.03, 0.02)
V_TANKER = np.array([206.0, 3.0, -1.0])
OMEGA = np.array([0.01, -0.02, 0.03])


def geometry(travel_m, c, travel_sigma_m=1e-6):
    R_ned_cam = R_OWN @ T_FRD_CAM.R
    table = np.vstack([R_ned_cam.T, R_TANKER, T_FRD_CAM.R.T @ T_FRD_CAM.t, travel_m, OMEGA])
    noise = np.vstack([np.eye(3) * s**2 for s in (c.attitude_sigma_rad, c.attitude_sigma_rad, travel_sigma_m)])
    return Geometry(table, noise, R_ned_cam, R_OWN @ T_FRD_CAM.t, travel_m, V_TANKER)


def on_plane(r_m, theta, boresight, lag_s=0.0, own=(0.0, 0.0, 0.0), tanker=(0.0, 0.0, 0.0)):
    """Return where the markers are on z = 1 (9, 2), written with transforms and nothing of the filter."""
    R_tanker = exp_so3(np.asarray(tanker)) @ exp_so3(np.asarray(theta)) @ R_TANKER @ exp_so3(OMEGA * lag_s)
    T_ned_cam = SE3(exp_so3(np.asarray(own)) @ R_OWN, r_m) @ SE3(T_FRD_CAM.R @ exp_so3(np.asarray(boresight)),
                                                                 T_FRD_CAM.t)
    p = (T_ned_cam.inverse() @ SE3(R_tanker, np.zeros(3))).transform(MARKERS)
    return p[:, :2] / p[:, 2:]


@dataclass
class Drawn:
    """Measurements in order, and the true state (16,) at each."""

    measurements: list = field(default_factory=list)
    truth: list = field(default_factory=list)


def draw(seed, c=None, *, start_m=(-40.0, -10.0, 20.0), length_s=8.0, frames_from_s=2.0, markers=9, noisy=True):
    """Return a flight: GPS every 0.12 s, frames every 0.1 s, errors and noise drawn from configuration ``c``."""
    c = c or FilterConfig()
    rng = np.random.default_rng(seed)
    scale = 1.0 if noisy else 1e-3
    x = rng.standard_normal(SIZE) * initial_sigma(c)
    x[0:3] = start_m
    travel, out = np.zeros(3), Drawn()
    sigma_px = np.full(9, np.hypot(0.035, c.pixel_sigma_px) / FOCAL_PX)
    dt = 0.02
    for k in range(round(length_s / dt)):
        t_ns = S + k * 20 * MS
        if k % 6 == 0:
            noise = scale * rng.standard_normal(3) * np.sqrt(2.0) * c.gps_sigma_m
            out.measurements.append(GpsDifference(t_ns, x[0:3] + x[9:12] + V_TANKER * x[15] + noise, V_TANKER))
            out.truth.append(x.copy())
        if k % 5 == 0 and k * dt >= frames_from_s:
            out.measurements.append(frame_of(rng, t_ns, x, travel, sigma_px, c, markers, scale))
            out.truth.append(x.copy())
        told = np.array([0.4, 0.25, -0.25])
        travel = travel + dt * told
        x = x.copy()
        x[0:3] += dt * x[3:6] + scale * np.sqrt(dt) * travel_noise(rng, c)
        x[3:6] += scale * rng.standard_normal(3) * c.velocity_walk * np.sqrt(dt)
        x[6:9] += scale * rng.standard_normal(3) * c.attitude_walk * np.sqrt(dt)
        fade = np.exp(-dt / c.gps_bias_s)
        x[9:12] = fade * x[9:12] + scale * rng.standard_normal(3) * c.gps_bias_sigma_m * np.sqrt(1 - fade**2)
    return out


def travel_noise(rng, c):
    """Return what the travels err by in one second (3,): across the path and along it."""
    along = V_TANKER / np.linalg.norm(V_TANKER)
    across, speed = np.sqrt(2 * c.velocity_hold_s) * np.array([c.velocity_sigma_m_s, c.speed_sigma_m_s])
    noise = rng.standard_normal(3)
    noise = across * noise + (speed - across) * along * (along @ noise)
    return noise + c.position_walk * rng.standard_normal(3)


def frame_of(rng, t_ns, x, travel, sigma, c, markers=9, scale=1.0):
    """Return a frame as it is seen from the true state x (16,), with noise."""
    own, tanker = scale * c.attitude_sigma_rad * rng.standard_normal((2, 3))
    off = 0.0016 * scale * rng.standard_normal(3)
    uv = on_plane(travel + x[0:3], x[6:9], x[12:15], x[15], own, tanker)
    uv += scale * rng.standard_normal((9, 2)) * sigma[:, None]
    ids = np.sort(rng.permutation(9)[:markers])
    pixels = MarkerPixels(tuple(ids.tolist()), MARKERS[ids], uv[ids], sigma[ids])
    return PixelFrame(t_ns, geometry(travel + off, c, 0.0016), pixels, None, Offset(t_ns, x[0:3].copy()), 30.0)
