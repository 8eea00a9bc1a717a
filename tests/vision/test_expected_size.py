"""How large a light should look: against the outline of the sphere itself, projected point by point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, CameraConfig, load
from companion.geometry import SE3
from companion.vision.camera import project
from companion.vision.expected_size import apparent_radius_px

RADIUS_M = 0.1
CAMERAS = {n: load(FIRMWARE_CONFIGS / f"cameras/{n}.toml", CameraConfig) for n in ("default", "thesis", "example_ros")}


def outline_radius_px(camera, centre):
    """Return the radius of the disc of as much area as the sphere's projected outline."""
    d = np.linalg.norm(centre)
    axis = centre / d
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(axis, across)
    share = 1.0 - (RADIUS_M / d) ** 2
    points = centre * share + RADIUS_M * np.sqrt(share) * ring
    u, v = project(camera, SE3.identity(), points).T
    return np.sqrt(abs(np.sum(u * np.roll(v, 1) - v * np.roll(u, 1))) / 2.0 / np.pi)


@settings(max_examples=60)
@given(st.sampled_from(sorted(CAMERAS)), st.floats(-0.6, 0.6), st.floats(-0.45, 0.45), st.floats(8.0, 60.0))
def test_it_is_the_size_of_the_projected_outline(name, x, y, z):
    camera, centre = CAMERAS[name], np.array([x, y, 1.0]) * z
    found = apparent_radius_px(camera, SE3.identity(), centre[None], RADIUS_M)
    assert found[0] == pytest.approx(outline_radius_px(camera, centre), rel=3e-3)


def test_what_is_not_ahead_has_no_size():
    places = np.array([[0.0, 0.0, -5.0], [0.0, 1.0, 0.0], [0.0, 0.0, 20.0]])
    found = apparent_radius_px(CAMERAS["default"], SE3.identity(), places, RADIUS_M)
    assert np.isnan(found).tolist() == [True, True, False]
