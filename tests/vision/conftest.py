"""Scenes for the vision tests: the shipped cameras and tanker, random poses, and a painter of antialiased lights."""

from collections.abc import Callable

import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, CameraConfig, TankerConfig, load
from companion.geometry import SE3, Mat, R_cam_crf, exp_so3, rotation_from_euler

SKY, FUSELAGE, LAMP = (120.0, 160.0, 210.0), (150.0, 150.0, 150.0), (250.0, 20.0, 20.0)


@pytest.fixture(scope="session")
def camera() -> CameraConfig:
    return load(FIRMWARE_CONFIGS / "cameras/default.toml", CameraConfig)


@pytest.fixture(scope="session")
def tanker() -> TankerConfig:
    return load(FIRMWARE_CONFIGS / "tankers/kc135r.toml", TankerConfig)


@pytest.fixture(scope="session")
def markers(tanker: TankerConfig) -> Mat:
    return np.array([m.p_tanker_m for m in tanker.markers])


@pytest.fixture(scope="session")
def approach_pose() -> Callable[[np.random.Generator], SE3]:
    """Draw a pose of the tanker in the camera somewhere between start and contact."""

    def draw(rng: np.random.Generator) -> SE3:
        R = R_cam_crf @ rotation_from_euler(*rng.normal(0.0, 0.08, 3)) @ rotation_from_euler(0.0, -0.45, 0.0)
        return SE3(R, np.array([rng.uniform(-5, 5), rng.uniform(-4, 4), rng.uniform(22, 70)]))

    return draw


@pytest.fixture(scope="session")
def any_scene() -> Callable[[np.random.Generator, float], tuple[SE3, Mat, Mat]]:
    """Draw a cloud of 6 to 12 points in a box, at any attitude, near or far: (pose, points, noisy image points)."""

    def draw(rng: np.random.Generator, noise: float) -> tuple[SE3, Mat, Mat]:
        n = int(rng.integers(6, 13))
        points = rng.uniform(-1, 1, (n, 3)) * np.array([10.0, 12.0, rng.uniform(1.0, 6.0)])
        T = SE3(exp_so3(rng.uniform(-np.pi, np.pi, 3)), np.array([*rng.uniform(-6, 6, 2), rng.uniform(22, 80)]))
        q = T.transform(points)
        return T, points, q[:, :2] / q[:, 2:] + rng.normal(0.0, noise, (n, 2))

    return draw


@pytest.fixture(scope="session")
def paint() -> Callable[..., Mat]:
    """Paint lamps (u, v, radius in px) into a float picture, each pixel by the share of it that the disc covers."""

    def paint_lamps(picture: Mat, lamps: Mat, colour: tuple[float, float, float] = LAMP, samples: int = 16) -> Mat:
        sub = (np.arange(samples) + 0.5) / samples - 0.5
        for u, v, radius in lamps:
            reach = int(radius) + 2
            columns = np.arange(max(int(u) - reach, 0), min(int(u) + reach + 2, picture.shape[1]))
            rows = np.arange(max(int(v) - reach, 0), min(int(v) + reach + 2, picture.shape[0]))
            x, y = (columns[:, None] + sub).ravel() - u, (rows[:, None] + sub).ravel() - v
            inside = x[None, :] ** 2 + y[:, None] ** 2 <= radius**2
            share = inside.reshape(len(rows), samples, len(columns), samples).mean(axis=(1, 3))[..., None]
            window = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            window[:] = window * (1 - share) + np.array(colour) * share
        return picture

    return paint_lamps
