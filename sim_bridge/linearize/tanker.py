"""Trim and linear model of the tanker, and its derivatives in the textbook's equations (thesis 2.1).

Input u: thrust in 100 kN, elevator, aileron, rudder in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.geometry import GRAVITY_M_S2, Mat
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
from sim_bridge.linearize.published import Derivatives
from sim_bridge.plant.aircraft_data import AircraftData
from sim_bridge.plant.fdm import LBF, Fdm
from sim_bridge.plant.tanker import INPUTS as TANKER_INPUTS
from sim_bridge.plant.tanker import trim_tanker

INPUTS = ("thrust", "elevator", "aileron", "rudder")
THRUST_UNIT_N = 1e5
ELEVATOR_MAX_RAD = 0.3
"""As far as the tanker's autopilot goes."""


@dataclass(frozen=True, slots=True, eq=False)
class TankerModel:
    """What was found: trim, A (9, 9), B (9, 4), modes, and the same aircraft in the textbook's equations."""

    condition: Condition
    mass_kg: float
    trim: Trim
    A: Mat
    B: Mat
    modes: tuple[Mode, ...]
    textbook: Derivatives


def linearize_tanker(condition: Condition | None = None) -> TankerModel:
    """Trim and linearise the tanker; raises as ``linearize`` does for the receiver."""
    condition = condition or Condition()
    data, fdm = load("kc135r", TANKER_INPUTS, condition)
    plant = Plant(fdm, INPUTS, (THRUST_UNIT_N / LBF, 1.0, 1.0, 1.0))
    speed = speed_m_s(fdm, condition.mach)
    level = trim_tanker(fdm, speed, (0.0, 0.0, 0.0), 0.0)
    x0 = np.array([speed, level.alpha_rad, 0.0, 0.0, 0.0, 0.0, 0.0, level.alpha_rad, 0.0])
    u0 = np.array([level.thrust_n / THRUST_UNIT_N, level.elevator_rad, 0.0, 0.0])
    left = rates(plant, x0, u0) * np.array([1.0, speed, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    trimmed = Trim(x0, u0, float(np.abs(left).max()))
    limits = {"elevator": (level.elevator_rad, -ELEVATOR_MAX_RAD, ELEVATOR_MAX_RAD)}
    check_trim("kc135r", trimmed, condition, limits)
    A, B = differences(plant, x0, u0)
    k = {name: value * condition.factors.get(name, 1.0) for name, value in data.values().items()}
    return TankerModel(condition, fdm.mass_kg, trimmed, A, B, modes_of(A), textbook(data, k, fdm, trimmed))


def textbook(data: AircraftData, k: dict[str, float], fdm: Fdm, trim: Trim) -> Derivatives:
    """Return the tanker with coefficients ``k`` at ``trim``; body-axis derivatives and inertia turned by its incidence.

    L, N, p, r turn as vectors: (L, N)_s = R (L, N), R = [[cos a, sin a], [-sin a, cos a]].
    """
    speed, alpha = float(trim.x[0]), float(trim.x[1])
    density = fdm.air_density_kg_m3()
    CL = fdm.mass_kg * GRAVITY_M_S2 / (0.5 * density * speed * speed * data.area_m2)
    R = np.array([[math.cos(alpha), math.sin(alpha)], [-math.sin(alpha), math.cos(alpha)]])
    Ixx, Iyy, Izz, Ixz = data.inertia_kg_m2
    inertia = R @ np.array([[Ixx, -Ixz], [-Ixz, Izz]]) @ R.T
    beta = R @ np.array([k["Clb"], k["Cnb"]])
    turning = R @ np.array([[k["Clp"], k["Clr"]], [k["Cnp"], k["Cnr"]]]) @ R.T
    return Derivatives(
        name="kc135r in the textbook's equations", source="kc135r.xml", area_m2=data.area_m2, span_m=data.span_m,
        chord_m=data.chord_m, mass_kg=fdm.mass_kg,
        inertia_kg_m2=(float(inertia[0, 0]), Iyy, float(inertia[1, 1]), -float(inertia[0, 1])),
        speed_m_s=speed, density_kg_m3=density,
        CL=CL, CD=k["CD0"] + k["CDk"] * CL * CL, CLa=k["CLa"], CDa=2.0 * k["CDk"] * CL * k["CLa"], Cma=k["Cma"],
        CLq=k["CLq"], Cmq=k["Cmq"], CYb=k["CYb"], Clb=float(beta[0]), Cnb=float(beta[1]), Clp=float(turning[0, 0]),
        Cnp=float(turning[1, 0]), Clr=float(turning[0, 1]), Cnr=float(turning[1, 1]),
    )  # fmt: skip
