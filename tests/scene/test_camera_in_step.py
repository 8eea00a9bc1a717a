"""The simulated camera on its clock: pictures come after their latency, however long they take to draw."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Any

import msgspec
import numpy as np
import pytest
from tanker_scene import CONTACT, Scene

from companion.config import Setup, load_setup
from companion.config.rules import camera_rules
from companion.geometry import SE3
from sim_bridge.scenario import load_scenario
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.simulation import Camera
from sim_bridge.truth import BodyState, Truth

STEP_NS = 5_000_000


class Slow(Executor):
    """Draws nothing until it is told to."""

    def __init__(self) -> None:
        self.asked: list[tuple[Future[Any], Any]] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.asked.append((future, lambda: fn(*args, **kwargs)))
        return future

    def finish(self) -> None:
        for future, draw in self.asked:
            future.set_result(draw())


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_setup(load_scenario("docking").companion)


def truth(scene: Scene, t_ns: int) -> Truth:
    def body(T: SE3) -> BodyState:
        v = np.array([205.0, 0.0, 0.0])
        return BodyState(t_ns, T.t + 1e-9 * t_ns * v, v, T.R, np.zeros(3), np.zeros(3), v)

    return Truth(t_ns, body(scene.T_ned_frd(CONTACT)), body(scene.T_ned_tanker), scene.boom, np.zeros(10))


def test_without_an_executor_pictures_come_just_after_their_latency(scene: Scene, setup: Setup) -> None:
    camera, alone = Camera(setup, np.random.default_rng(3)), np.random.default_rng(3)
    picture, came = CameraPicture(setup.camera, setup.tanker, alone), []
    latency_ns, period_ns = round(1e9 * setup.camera.latency_s), round(1e9 / setup.camera.rate_hz)
    for step in range(24):
        now = truth(scene, step * STEP_NS)
        camera.expose(now)
        came += [(now.t_ns, f) for f in camera.delivered(now.t_ns)]
    assert [t_ns for t_ns, _ in came] == [k * period_ns + latency_ns for k in range(len(came))]
    assert [f.t_ns for _, f in came] == [k * period_ns for k in range(len(came))]
    for _, frame in came:
        at = truth(scene, frame.t_ns)
        np.testing.assert_array_equal(frame.image, picture.expose(at.tanker, at.uav, at.boom))
    assert len(came) == 2


def test_with_an_executor_late_pictures_come_late_and_in_order(scene: Scene, setup: Setup) -> None:
    slow = Slow()
    camera = Camera(setup, np.random.default_rng(3), slow)
    for t_ns in (0, 50_000_000):
        camera.expose(truth(scene, t_ns))
    assert camera.delivered(200_000_000) == []
    slow.finish()
    assert [f.sequence for f in camera.delivered(205_000_000)] == [0, 1]


def test_an_exposure_longer_than_the_period_is_refused(setup: Setup) -> None:
    long = msgspec.structs.replace(setup.camera, exposure_s=0.06)
    broken = [text for holds, text in camera_rules(long) if not holds]
    assert broken == ["exposure_s must not be longer than from picture to picture, 1 / rate_hz"]
