"""State space of a JSBSim aircraft about level flight, by central differences, and its modes.

State x = (V, alpha, beta, p, q, r, psi, theta, phi) in m/s, rad and rad/s; x' = A (x - x0) + B (u - u0).
``FGLinearization`` of JSBSim knows four inputs only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from companion.config import ConfigError
from companion.geometry import Mat, Vec
from sim_bridge.plant.aircraft_data import AircraftData, read_aircraft
from sim_bridge.plant.fdm import Fdm, InitialCondition, PlantError
from sim_bridge.plant.world import ALTITUDE_M, MACH

STATES = ("V", "alpha", "beta", "p", "q", "r", "psi", "theta", "phi")
LONGITUDINAL = (0, 1, 4, 7)
LATERAL = (2, 3, 5, 8)
STEPS = (0.1, *(1e-3,) * 8)
INPUT_STEP = 1e-3
MACH_RANGE = (0.55, 0.75)
ALTITUDE_RANGE_M = (3000.0, 9000.0)
"""Where the models are believed: coefficients are those of Mach 0.65, by Prandtl and Glauert within 10 % of these."""
RESIDUAL_MAX = 1e-6
ALPHA_MAX_RAD = 0.2
"""Incidence up to which linear lift and moment are believed: estimated."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Where an aircraft is trimmed, and factors on its coefficients by name."""

    mach: float = MACH
    altitude_m: float = ALTITUDE_M
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def designed(self) -> bool:
        """Whether this is the aircraft and the flight that the plant flies."""
        return self.mach == MACH and self.altitude_m == ALTITUDE_M and not self.factors

    def check(self) -> None:
        """Raise ConfigError when the models say nothing about this condition."""
        if not MACH_RANGE[0] <= self.mach <= MACH_RANGE[1]:
            msg = f"--mach {self.mach:g}: the aircraft models hold for Mach {MACH_RANGE[0]} to {MACH_RANGE[1]}"
            raise ConfigError(msg)
        if not ALTITUDE_RANGE_M[0] <= self.altitude_m <= ALTITUDE_RANGE_M[1]:
            low, high = ALTITUDE_RANGE_M
            msg = f"--altitude {self.altitude_m:g}: the aircraft models hold for {low:.0f} to {high:.0f} m"
            raise ConfigError(msg)


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """An aircraft and how its inputs are set: ``u`` times ``units`` (JSBSim's), then ``fixed``."""

    fdm: Fdm
    inputs: tuple[str, ...]
    units: tuple[float, ...]
    fixed: tuple[float, ...] = ()

    def set(self, u: Vec) -> None:
        """Set the inputs ``u`` (k,)."""
        self.fdm.set_inputs((*(v * unit for v, unit in zip(u.tolist(), self.units, strict=True)), *self.fixed))


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """One eigenvalue (rad/s) with its name; of a complex pair the one with positive imaginary part."""

    name: str
    eigenvalue: complex


@dataclass(frozen=True, slots=True, eq=False)
class Trim:
    """Level flight: x0 (9,), u0 (k,), and the largest of u', w' (m/s2) and q' (rad/s2) that is left over."""

    x: Vec
    u: Vec
    residual: float


def load(name: str, inputs: tuple[str, ...], condition: Condition) -> tuple[AircraftData, Fdm]:
    """Return the data of aircraft ``name`` and its model at ``condition``, coefficients scaled.

    Raises ConfigError for a condition or coefficient that the aircraft does not know, PlantError for incomplete files.
    """
    condition.check()
    data = read_aircraft(name)
    for coefficient in condition.factors:
        if coefficient not in data.coefficients:
            msg = f"--scale {coefficient}: {name} has no such coefficient; there are {', '.join(data.coefficients)}"
            raise ConfigError(msg)
    fdm = Fdm(name, inputs, 0.005, condition.altitude_m)
    for coefficient, factor in condition.factors.items():
        fdm.scale_coefficient(coefficient, factor)
    return data, fdm


def check_trim(name: str, trim: Trim, condition: Condition, limits: Mapping[str, tuple[float, float, float]]) -> None:
    """Raise PlantError unless ``trim`` is balanced, at small incidence, each (value, low, high) within its limits."""
    where = f"{name} does not trim at Mach {condition.mach:g}, {condition.altitude_m:.0f} m"
    if not trim.residual < RESIDUAL_MAX:
        msg = f"{where}: {trim.residual:.3g} left over"
        raise PlantError(msg)
    wanted = {"alpha": (float(trim.x[1]), -ALPHA_MAX_RAD, ALPHA_MAX_RAD), **limits}
    for what, (value, low, high) in wanted.items():
        if not low <= value <= high:
            msg = f"{where}: it would want {what} at {value:.3g}, beyond {low:.3g} to {high:.3g}"
            raise PlantError(msg)


def speed_m_s(fdm: Fdm, mach: float) -> float:
    """Return true airspeed at ``mach`` and the altitude of the origin of ``fdm``."""
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), (200.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    return mach * fdm.speed_of_sound_m_s()


def rates(plant: Plant, x: Vec, u: Vec) -> Vec:
    """Return x' (9,) of the JSBSim model at state ``x`` (9,) and input ``u`` (k,)."""
    V, alpha, beta, p, q, r, psi, theta, phi = x.tolist()
    uvw = (V * math.cos(alpha) * math.cos(beta), V * math.sin(beta), V * math.sin(alpha) * math.cos(beta))
    plant.set(u)
    plant.fdm.reset(InitialCondition((0.0, 0.0, 0.0), uvw, (psi, theta, phi), (p, q, r)))
    (du, dv, dw), (dp, dq, dr) = plant.fdm.accelerations()
    dV = (uvw[0] * du + uvw[1] * dv + uvw[2] * dw) / V
    return np.array(
        [
            dV,
            (uvw[0] * dw - uvw[2] * du) / (uvw[0] ** 2 + uvw[2] ** 2),
            (dv - math.sin(beta) * dV) / (V * math.cos(beta)),
            dp,
            dq,
            dr,
            (q * math.sin(phi) + r * math.cos(phi)) / math.cos(theta),
            q * math.cos(phi) - r * math.sin(phi),
            p + (q * math.sin(phi) + r * math.cos(phi)) * math.tan(theta),
        ]
    )


def differences(plant: Plant, x0: Vec, u0: Vec) -> tuple[Mat, Mat]:
    """Return A (9, 9) and B (9, k) by central differences about (x0, u0); noise below 1e-9 becomes zero."""
    A = np.empty((9, 9))
    B = np.empty((9, len(u0)))
    for j, h in enumerate(STEPS):
        e = np.eye(9)[j] * h
        A[:, j] = (rates(plant, x0 + e, u0) - rates(plant, x0 - e, u0)) / (2 * h)
    for j in range(len(u0)):
        e = np.eye(len(u0))[j] * INPUT_STEP
        B[:, j] = (rates(plant, x0, u0 + e) - rates(plant, x0, u0 - e)) / (2 * INPUT_STEP)
    A[np.abs(A) < 1e-9] = 0.0
    B[np.abs(B) < 1e-9] = 0.0
    return A, B


def longitudinal_modes(A: Mat) -> tuple[Mode, ...]:
    """Return the modes of ``A`` (4, 4), fastest first: of two pairs short period and phugoid (thesis 3.7)."""
    values = _upper(A)
    if all(v.imag > 0.0 for v in values):
        return tuple(Mode(name, v) for name, v in zip(("short period", "phugoid"), values, strict=True))
    return tuple(Mode("longitudinal", v) for v in values)


def lateral_modes(A: Mat) -> tuple[Mode, ...]:
    """Return the modes of ``A`` (4, 4), fastest first: an ordinary aircraft's have names, four real ones (3.8) not."""
    values = _upper(A)
    pairs, real = [v for v in values if v.imag > 0.0], [v for v in values if v.imag == 0.0]
    if len(pairs) != 1:
        return tuple(Mode("lateral", v) for v in values)
    return (Mode("dutch roll", pairs[0]), Mode("roll", real[0]), Mode("spiral", real[1]))


def modes_of(A: Mat) -> tuple[Mode, ...]:
    """Return the modes of both planes of ``A`` (9, 9)."""
    along, across = (A[np.ix_(plane, plane)] for plane in (LONGITUDINAL, LATERAL))
    return longitudinal_modes(along) + lateral_modes(across)


def _upper(A: Mat) -> list[complex]:
    values = [complex(v) for v in np.linalg.eigvals(A) if v.imag >= 0.0]
    return sorted(values, key=abs, reverse=True)


def coupling(A: Mat) -> tuple[float, str]:
    """Return the largest entry of ``A`` (9, 9) that couples the planes, over the largest of its row, and its name."""
    across = (*LATERAL, STATES.index("psi"))
    worst, name = 0.0, "none"
    for i in range(9):
        largest = float(np.abs(A[i]).max())
        for j in range(9):
            if (i in across) != (j in across) and abs(A[i, j]) > worst * largest:
                worst, name = float(abs(A[i, j])) / largest, f"{STATES[i]}' over {STATES[j]}"
    return worst, name
