from __future__ import annotations

import pytest
from tanker_scene import Scene, Tracer, level_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return level_scene()


@pytest.fixture(scope="session")
def tracer(scene: Scene) -> Tracer:
    return Tracer(scene.boom)
