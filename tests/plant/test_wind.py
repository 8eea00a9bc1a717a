from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import AirframeConfig, TankerConfig
from sim_bridge.plant.conditions import PlantConditions, WindConfig
from sim_bridge.plant.wind import Wind
from sim_bridge.plant.world import World
from sim_bridge.truth import BodyState, Truth

speeds = st.floats(-60.0, 60.0)
shears = st.floats(-0.2, 0.2)


@given(n=speeds, e=speeds, sn=shears, se=shears, h=st.floats(-500, 500))
def test_wind_is_linear_in_height(n: float, e: float, sn: float, se: float, h: float) -> None:
    wind = Wind(WindConfig(north_m_s=n, east_m_s=e, north_shear_per_s=sn, east_shear_per_s=se))
    assert wind.at(0.0) == (n, e)
    np.testing.assert_allclose(np.add(wind.at(h), wind.at(-h)), (2 * n, 2 * e), atol=1e-9)
    np.testing.assert_allclose(np.subtract(wind.at(h), wind.at(0.0)), (sn * h, se * h), atol=1e-9)


def make(tanker: TankerConfig, airframe: AirframeConfig, wind: WindConfig, turbulence: str, heading: float) -> World:
    conditions = PlantConditions(wind=wind)
    start = (-50.0, -20.0, 30.0)
    rng = np.random.default_rng(3)
    return World(tanker, airframe, start, turbulence, True, rng, heading, conditions=conditions)


def air_of(body: BodyState) -> np.ndarray:
    """Velocity of the air in ned at an aircraft."""
    return body.v_ned_m_s - body.R_ned_body @ body.v_air_body_m_s


def after(world: World, airframe: AirframeConfig, steps: int) -> Truth:
    for _ in range(steps):
        world.step(np.array(airframe.trim.effectors))
    return world.truth


@pytest.mark.parametrize("turbulence", ["none", "moderate"])
def test_flight_in_wind_is_the_calm_flight_carried_along(
    tanker: TankerConfig, airframe: AirframeConfig, turbulence: str
) -> None:
    """Galilei: gusts drift with the wind, so nothing in the air can tell that it moves."""
    blow, heading = np.array([31.0, -17.0, 0.0]), 0.8
    calm, windy = (make(tanker, airframe, wind, turbulence, heading)
                   for wind in (WindConfig(), WindConfig(north_m_s=blow[0], east_m_s=blow[1])))
    for steps in (0, 1, 600):
        a, b = after(calm, airframe, steps), after(windy, airframe, steps)
        for name in ("uav", "tanker"):
            still, carried = getattr(a, name), getattr(b, name)
            np.testing.assert_allclose(carried.p_ned_m, still.p_ned_m + blow * a.t_ns * 1e-9, atol=1e-5)
            np.testing.assert_allclose(carried.v_ned_m_s, still.v_ned_m_s + blow, atol=1e-5)
            np.testing.assert_allclose(carried.v_air_body_m_s, still.v_air_body_m_s, atol=1e-5)
            np.testing.assert_allclose(carried.R_ned_body, still.R_ned_body, atol=1e-7)
            np.testing.assert_allclose(carried.omega_body_rad_s, still.omega_body_rad_s, atol=1e-7)
    assert np.abs(a.uav.omega_body_rad_s).max() > (1e-3 if turbulence == "moderate" else 0.0)


def test_start_in_wind_is_trimmed(tanker: TankerConfig, airframe: AirframeConfig) -> None:
    wind = WindConfig(north_m_s=-25.0, east_m_s=30.0, north_shear_per_s=0.05, east_shear_per_s=-0.02)
    truth, calm = (make(tanker, airframe, w, "none", 2.0).truth for w in (wind, WindConfig()))
    for body, still in ((truth.uav, calm.uav), (truth.tanker, calm.tanker)):
        assert np.linalg.norm(body.v_air_body_m_s) == pytest.approx(airframe.trim.airspeed_m_s, abs=1e-6)
        assert body.v_air_body_m_s[1] == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(body.specific_force_body_m_s2, still.specific_force_body_m_s2, atol=1e-6)
        height = -body.p_ned_m[2]
        np.testing.assert_allclose(air_of(body), [-25.0 + 0.05 * height, 30.0 - 0.02 * height, 0.0], atol=1e-6)
    below = truth.uav.p_ned_m[2] - truth.tanker.p_ned_m[2]
    slower = air_of(truth.tanker) - air_of(truth.uav)
    np.testing.assert_allclose(slower, np.array([0.05, -0.02, 0.0]) * below, atol=1e-6)


def test_tanker_crabs_and_keeps_heading_height_and_airspeed(tanker: TankerConfig, airframe: AirframeConfig) -> None:
    world = make(tanker, airframe, WindConfig(east_m_s=40.0), "none", 0.0)
    truth = after(world, airframe, 2400)
    body = truth.tanker
    assert math.atan2(body.v_ned_m_s[1], body.v_ned_m_s[0]) == pytest.approx(math.atan2(40.0, 205.69), abs=1e-3)
    assert math.atan2(body.R_ned_body[1, 0], body.R_ned_body[0, 0]) == pytest.approx(0.0, abs=1e-3)
    assert abs(body.p_ned_m[2]) < 0.1
    assert np.linalg.norm(body.v_air_body_m_s) == pytest.approx(airframe.trim.airspeed_m_s, abs=0.05)
