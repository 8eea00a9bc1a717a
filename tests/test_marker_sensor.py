"""Simulated detections: true projections with stated noise, at the camera's rate and latency, through the chain."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import ConfigError
from companion.geometry import SE3, R_cam_crf, exp_so3
from companion.messages import MarkerFrame, Tick
from companion.pipeline import Pipeline
from companion.vision.camera import project
from companion.vision.chain import VisionChain
from sim_bridge.flight import stamped
from sim_bridge.marker_sensor import MarkerCamera
from sim_bridge.scenario import load_scenario
from sim_bridge.sensor_conditions import MarkerSensorConditions
from sim_bridge.serve import serve
from sim_bridge.simulation import Simulation

SCENARIO = msgspec.structs.replace(load_scenario("docking"), vision_input="detections")
SETUP = SCENARIO.setup()
MARKERS = np.array([m.p_tanker_m for m in SETUP.tanker.markers])
AHEAD = SE3(R_cam_crf, np.array([0.0, -2.0, 30.0]))


def camera(seed: int = 1, **conditions: float) -> MarkerCamera:
    return MarkerCamera(SETUP, np.random.default_rng(seed), MarkerSensorConditions(**conditions))


def test_without_noise_detections_are_the_projections_of_the_markers_in_the_picture() -> None:
    found = camera(sigma_px=0.0).detect(0, AHEAD)
    true = project(SETUP.camera, AHEAD, MARKERS)
    size = [SETUP.camera.width_px, SETUP.camera.height_px]
    inside = true[((true > -0.5) & (true < np.array(size) - 0.5)).all(axis=1)]
    assert len(found.uv_px) == len(inside) > 4
    assert {tuple(p) for p in found.uv_px} == {tuple(p) for p in inside}
    assert (np.diff(found.uv_px[:, 1]) >= 0).all()


def test_noise_has_the_stated_sigma_and_no_mean() -> None:
    sensor, true = camera(sigma_px=0.2), project(SETUP.camera, AHEAD, MARKERS)
    errors = []
    for _ in range(2000):
        uv_px = sensor.detect(0, AHEAD).uv_px
        nearest = np.linalg.norm(uv_px[:, None] - true[None], axis=2).argmin(axis=1)
        errors.append(uv_px - true[nearest])
    error = np.concatenate(errors)
    assert error.std(axis=0) == pytest.approx([0.2, 0.2], rel=0.03)
    assert np.abs(error.mean(axis=0)).max() < 5 * 0.2 / np.sqrt(len(error))


@pytest.mark.parametrize("dropout", [0.0, 0.3, 1.0])
def test_each_marker_drops_out_with_the_stated_probability(dropout: float) -> None:
    sensor, full = camera(dropout=dropout), len(camera().detect(0, AHEAD).uv_px)
    share = np.mean([len(sensor.detect(0, AHEAD).uv_px) for _ in range(2000)]) / full
    assert share == pytest.approx(1.0 - dropout, abs=0.02)


def three(limit: float) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(-limit, limit), min_size=3, max_size=3)


@given(three(np.pi), three(200.0))
def test_wherever_the_tanker_is_what_is_detected_is_in_the_picture(rotation: list[float], place: list[float]) -> None:
    found = camera(sigma_px=0.5).detect(7, SE3(exp_so3(np.array(rotation)) @ R_cam_crf, np.array(place)))
    assert found.t_ns == 7
    assert np.isfinite(found.uv_px).all()
    assert (found.area_px > 0).all()
    assert ((found.uv_px > -0.5) & (found.uv_px < [SETUP.camera.width_px - 0.5, SETUP.camera.height_px - 0.5])).all()


def test_the_chain_finds_the_true_pose_from_simulated_detections() -> None:
    # Nothing but the centroids' noise: calibration and map are exact here.
    config = msgspec.structs.replace(SETUP.config.vision, sigma_px=1e-3)
    chain, sensor = VisionChain(SETUP.camera, SETUP.tanker, config), camera()
    off = SE3(AHEAD.R, AHEAD.t + np.array([0.3, -0.2, 0.4]))
    errors = []
    for k in range(200):
        seen = chain.process(MarkerFrame(k, k, sensor.detect(k, AHEAD)), off, tracked=True)
        assert seen.pose is not None
        assert (seen.t_ns, seen.sequence) == (k, k)
        errors.append(seen.pose.T_cam_tanker.t - AHEAD.t)
    assert np.abs(np.array(errors)).max() < 0.1
    # Each error against the covariance that its measurement states: chi squared of 3, mean 3.
    nees = [e @ np.linalg.solve(seen.pose.cov[:3, :3], e) for e in errors]
    assert 2.5 < np.mean(nees) < 3.5


def test_frames_come_at_the_cameras_rate_after_its_latency_and_are_stamped_at_exposure() -> None:
    simulation = Simulation(SCENARIO, SETUP)
    frames = [(a.t_ns, f) for a in (simulation.step() for _ in range(110)) for f in a.frames]
    period_ns, latency_ns = round(1e9 / SETUP.camera.rate_hz), round(SETUP.camera.latency_s * 1e9)
    assert all(isinstance(f, MarkerFrame) for _, f in frames)
    assert [f.t_ns for _, f in frames] == [k * period_ns for k in range(len(frames))]
    assert [f.sequence for _, f in frames] == list(range(len(frames)))
    assert [t - f.t_ns for t, f in frames] == [latency_ns] * len(frames)
    assert len(frames) > 5


def test_another_stamp_is_the_detections_too() -> None:
    frame = stamped(MarkerFrame(5, 3, camera().detect(5, AHEAD)), 17)
    assert isinstance(frame, MarkerFrame)
    assert (frame.t_ns, frame.sequence, frame.detections.t_ns) == (17, 3, 17)


def test_detections_that_repeat_or_go_back_are_a_camera_that_stands_still() -> None:
    pipeline, found = Pipeline(SETUP), camera().detect(0, AHEAD)
    reasons = []
    for t_ns in (0, 50_000_000, 50_000_000):
        outputs = pipeline.handle(stamped(MarkerFrame(0, 0, found), t_ns))
        reasons += [o.reason for o in outputs]  # type: ignore[union-attr]
    assert reasons == ["no_prior", "frozen", "time_not_forward"]
    pipeline.handle(Tick(100_000_000))


def test_on_the_wall_clock_detections_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match="lockstep only"):
        serve(SCENARIO, SETUP, lambda: True, lambda truth: None, lambda: None)


def test_a_companion_that_looks_for_corners_is_refused_detections() -> None:
    vision = msgspec.structs.replace(SETUP.config.vision, detector="corners")
    setup = msgspec.structs.replace(SETUP, config=msgspec.structs.replace(SETUP.config, vision=vision))
    with pytest.raises(ConfigError, match="gives lights"):
        Simulation(SCENARIO, setup)


@pytest.mark.parametrize("line", [
    'vision_input = "dreams"', "[sensors.markers]\nsigma_px = -1.0", "[sensors.markers]\ndropout = 1.5",
    "[sensors.markers]\nsigma_px = nan",
    "[sensors.markers]\nsigma = 0.1",
])
def test_bad_values_are_one_clear_line(tmp_path, line: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "bad.toml"
    path.write_text(f'name = "bad"\ncompanion = "{SCENARIO.companion}"\n{line}\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
