"""The flights that are flown by the hundred: by detections, from near or from where the thesis begins."""

from __future__ import annotations

import math
from typing import Any, Literal

import msgspec
import numpy as np

from companion.config import Setup
from sim_bridge.margins import PATH_S, START_TANKER_M, with_guidance
from sim_bridge.runs.many import Job
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.sensor_conditions import AircraftSensors, GpsErrors, Outage

Method = Literal["filter", "blend"]
Turbulence = Literal["light", "moderate"]
replace = msgspec.structs.replace

STREAM = 6
"""Keeps what is drawn here apart from the flight's own chance, which has the same seed."""

FROM_NEAR_S = 25.0
"""From the start 5 m off to the hold at the latest."""


def near(name: str, seed: int, hold_s: float, **scenario_fields: Any) -> tuple[Scenario, Setup]:
    """Return a flight of a scenario that begins 5 m from the box, the thesis' one path, by detections."""
    fields = {"vision_input": "detections", "start_tanker_m": START_TANKER_M, "timeout_s": hold_s + FROM_NEAR_S}
    scenario = replace(load_scenario(name), seed=seed, hold_s=hold_s, **{**fields, **scenario_fields})
    setup = with_guidance(scenario.setup(), procedure="direct", self_test=False, path_duration_s=PATH_S)
    return scenario, setup


def far(name: str, seed: int, **scenario_fields: Any) -> tuple[Scenario, Setup]:
    """Return a flight of a scenario as it is, by detections unless told otherwise."""
    scenario = replace(load_scenario(name), seed=seed, **{"vision_input": "detections", **scenario_fields})
    return scenario, scenario.setup()


def fused_by(setup: Setup, method: Method) -> Setup:
    """Choose the fusion."""
    return replace(setup, config=replace(setup.config, fusion=replace(setup.config.fusion, method=method)))


def without_gps(job: Job, from_s: float) -> Job:
    """Return the flight with both aircraft's GPS out from an instant to the end."""
    scenario = job.scenario
    out = (Outage(from_s=from_s, until_s=scenario.timeout_s + 1.0),)
    sensors = scenario.sensors

    def blind(aircraft: AircraftSensors) -> AircraftSensors:
        return replace(aircraft, gps_outages=(*aircraft.gps_outages, *out))

    sensors = replace(sensors, receiver=blind(sensors.receiver), tanker=blind(sensors.tanker))
    return Job(f"{job.label}, no GPS", replace(scenario, sensors=sensors), job.setup, job.world)


def with_drawn_errors(job: Job) -> Job:
    """Return the flight with what the filter estimates drawn from what its configuration expects of it.

    The camera is mounted off by ``boresight_initial_rad`` per axis, and the two GPS err slowly against each other by
    ``gps_bias_sigma_m`` in ``gps_bias_s``. A state that always were nought would make any estimate look too modest.
    """
    expected = job.setup.config.fusion.filter
    rng = np.random.default_rng([job.scenario.seed, STREAM])
    yaw, pitch, roll = rng.normal(0.0, expected.boresight_initial_rad, 3).tolist()
    camera = job.setup.camera
    world = replace(job.setup, camera=replace(
        camera, mount_yaw_rad=camera.mount_yaw_rad + yaw, mount_pitch_rad=camera.mount_pitch_rad + pitch,
        mount_roll_rad=camera.mount_roll_rad + roll,
    ))
    slow = GpsErrors(slow_sigma_m=expected.gps_bias_sigma_m / math.sqrt(2.0), slow_s=expected.gps_bias_s)
    sensors = job.scenario.sensors
    receiver, tanker = (replace(aircraft, gps=slow) for aircraft in (sensors.receiver, sensors.tanker))
    scenario = replace(job.scenario, sensors=replace(sensors, receiver=receiver, tanker=tanker))
    return Job(job.label, scenario, job.setup, world)
