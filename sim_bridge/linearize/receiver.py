"""Trim and linear model of the receiver, and the data file that guidance designs its law from (thesis 3.4 to 3.8).

Input u in the order of ``sim_bridge.truth.EFFECTORS``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import tomli_w
from scipy.optimize import root

from companion.config import FIRMWARE_CONFIGS, AirframeConfig, AttitudeResponse, ConfigError, TrimConfig
from companion.geometry import Vec
from sim_bridge.linearize.model import (
    Condition,
    Mode,
    Plant,
    Trim,
    check_trim,
    differences,
    load,
    modes_of,
    rates,
    speed_m_s,
)
from sim_bridge.plant.actuators import default_channels
from sim_bridge.plant.response import identify_response
from sim_bridge.plant.world import UAV_INPUTS
from sim_bridge.truth import EFFECTORS

AIRFRAME_FILE = FIRMWARE_CONFIGS / "airframes" / "ice101.toml"
RECEPTACLE_FRD_M = (2.0, 0.0, -1.0)
"""Estimated: on the back, behind the nose."""
BIAS_RAD = {"amt": math.radians(8.0), "ssd": math.radians(6.0)}
"""One-sided effectors stand a little open in trim, so that both signs of a moment are at hand on either side."""
UNKNOWN = AttitudeResponse(
    roll_rad_s=1.0, roll_damping=1.0, pitch_rad_s=1.0, pitch_damping=1.0, thrust_lag_s=1.0, delay_s=0.0
)


@dataclass(frozen=True, slots=True, eq=False)
class Linearization:
    """What was found. ``residual`` is the largest of u', w' (m/s2) and q' (rad/s2) at trim.

    The response in ``airframe`` is that of the closed loops where the plant flies, elsewhere a placeholder.
    """

    airframe: AirframeConfig
    residual: float
    modes: tuple[Mode, ...]
    condition: Condition


def linearize(condition: Condition | None = None) -> Linearization:
    """Trim, linearise and identify the receiver.

    Raises ConfigError for a condition that the model says nothing about or a coefficient that it does not have,
    PlantError when the receiver does not trim.
    """
    condition = condition or Condition()
    plant = receiver(condition)
    speed = speed_m_s(plant.fdm, condition.mach)
    found = trim(plant, speed, condition)
    A, B = differences(plant, found.x, found.u)
    airframe = AirframeConfig(
        name="ice101",
        receptacle_frd_m=RECEPTACLE_FRD_M,
        mass_kg=round(plant.fdm.mass_kg, 3),
        trim=TrimConfig(
            airspeed_m_s=speed,
            altitude_m=condition.altitude_m,
            alpha_rad=float(found.x[1]),
            throttle=float(found.u[0]),
            effectors=tuple(found.u.tolist()),
        ),
        response=UNKNOWN,
        A=tuple(tuple(row) for row in A.tolist()),
        B=tuple(tuple(row) for row in B.tolist()),
        source="written by `sim-bridge linearize` from sim_bridge/aircraft/aircraft/ice101/ice101.xml",
    )
    if condition.designed:
        airframe = msgspec.structs.replace(airframe, response=identify_response(airframe))
    return Linearization(airframe, found.residual, modes_of(A), condition)


def receiver(condition: Condition) -> Plant:
    """Return the receiver at ``condition``, its wake calm."""
    _, fdm = load("ice101", UAV_INPUTS, condition)
    n = len(EFFECTORS)
    return Plant(fdm, EFFECTORS, (1.0,) * n, (0.0,) * (len(UAV_INPUTS) - n))


def effectors_at(throttle: float, flap_rad: float) -> list[float]:
    """Return the input vector with TEF and PF at one angle and the one-sided effectors at their bias."""
    by_kind = {"throttle": throttle, "tef": flap_rad, "pf": flap_rad, "lef": 0.0, **BIAS_RAD}
    return [by_kind[name.split("_", maxsplit=1)[0]] for name in EFFECTORS]


def trim(plant: Plant, speed: float, condition: Condition) -> Trim:
    """Return straight and level flight; raises PlantError when there is none within the effectors' limits."""

    def state(z: Vec) -> tuple[Vec, Vec]:
        alpha, flap, throttle = z.tolist()
        x = np.array([speed, alpha, 0.0, 0.0, 0.0, 0.0, 0.0, alpha, 0.0])
        return x, np.array(effectors_at(throttle, flap))

    def unbalanced(z: Vec) -> Vec:
        dx = rates(plant, *state(z))
        return np.array([dx[0], dx[1] * speed, dx[4]])

    found = root(unbalanced, np.array([0.06, -0.05, 0.5]), tol=1e-12)
    x0, u0 = state(found.x)
    result = Trim(x0, u0, float(np.abs(unbalanced(found.x)).max()))
    channels = zip(EFFECTORS, u0.tolist(), default_channels(), strict=True)
    check_trim("ice101", result, condition, {name: (value, c.low, c.high) for name, value, c in channels})
    return result


def write_airframe(path: Path = AIRFRAME_FILE) -> Linearization:
    """Linearise and write ``path`` as ``companion.config.AirframeConfig``; return what was found.

    Raises ConfigError when ``path`` cannot be written, PlantError when the receiver does not trim.
    """
    result = linearize()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(tomli_w.dumps(msgspec.to_builtins(result.airframe)).encode())
    except OSError as error:
        msg = f"{path}: cannot be written ({error.strerror}); give another file with --write"
        raise ConfigError(msg) from None
    return result
