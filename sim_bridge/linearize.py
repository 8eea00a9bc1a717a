"""Trim and linear model of the receiver, and the data file that guidance designs its law from (thesis 3.4 to 3.8).

State x = (V, alpha, beta, p, q, r, psi, theta, phi) in m/s, rad and rad/s; input u in the order of
``sim_bridge.truth.EFFECTORS``; x' = A (x - x0) + B (u - u0) about straight and level flight at Mach 0.65, 6000 m.
Central differences of the JSBSim model itself: ``FGLinearization`` knows four inputs only.
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
from companion.geometry import Mat, Vec
from sim_bridge.plant.fdm import Fdm, InitialCondition, PlantError
from sim_bridge.plant.response import identify_response
from sim_bridge.plant.world import ALTITUDE_M, MACH, UAV_INPUTS
from sim_bridge.truth import EFFECTORS

STATES = ("V", "alpha", "beta", "p", "q", "r", "psi", "theta", "phi")
LONGITUDINAL = (0, 1, 4, 7)
LATERAL = (2, 3, 5, 8)
AIRFRAME_FILE = FIRMWARE_CONFIGS / "airframes" / "ice101.toml"
RECEPTACLE_FRD_M = (2.0, 0.0, -1.0)
"""Estimated: on the back, behind the nose."""
BIAS_RAD = {"amt": math.radians(8.0), "ssd": math.radians(6.0)}
"""One-sided effectors stand a little open in trim, so that both signs of a moment are at hand on either side."""
STEPS = (0.1, *(1e-3,) * 8)
UNKNOWN = AttitudeResponse(
    roll_rad_s=1.0, roll_damping=1.0, pitch_rad_s=1.0, pitch_damping=1.0, thrust_lag_s=1.0, delay_s=0.0
)


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """One eigenvalue (rad/s) with its name; of a complex pair the one with positive imaginary part."""

    name: str
    eigenvalue: complex


@dataclass(frozen=True, slots=True, eq=False)
class Linearization:
    """What was found. ``residual`` is the largest of u', w' (m/s2) and q' (rad/s2) at trim."""

    airframe: AirframeConfig
    residual: float
    modes: tuple[Mode, ...]


def linearize() -> Linearization:
    """Trim, linearise and identify the receiver; raises PlantError when it does not trim."""
    fdm = Fdm("ice101", UAV_INPUTS, 0.005, ALTITUDE_M)
    speed = cruise_speed_m_s(fdm)
    x0, u0, residual = trim(fdm, speed)
    A, B = differences(fdm, x0, u0)
    airframe = AirframeConfig(
        name="ice101",
        receptacle_frd_m=RECEPTACLE_FRD_M,
        mass_kg=round(fdm.mass_kg, 3),
        trim=TrimConfig(
            airspeed_m_s=speed,
            altitude_m=ALTITUDE_M,
            alpha_rad=float(x0[1]),
            throttle=float(u0[0]),
            effectors=tuple(u0.tolist()),
        ),
        response=UNKNOWN,
        A=tuple(tuple(row) for row in A.tolist()),
        B=tuple(tuple(row) for row in B.tolist()),
        source="written by `sim-bridge linearize` from sim_bridge/aircraft/aircraft/ice101/ice101.xml",
    )
    airframe = msgspec.structs.replace(airframe, response=identify_response(airframe))
    return Linearization(airframe, residual, modes_of(A))


def cruise_speed_m_s(fdm: Fdm) -> float:
    """Return true airspeed at Mach 0.65, 6000 m."""
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), (200.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    return MACH * fdm.speed_of_sound_m_s()


def effectors_at(throttle: float, flap_rad: float) -> list[float]:
    """Return the input vector with TEF and PF at one angle and the one-sided effectors at their bias."""
    by_kind = {"throttle": throttle, "tef": flap_rad, "pf": flap_rad, "lef": 0.0, **BIAS_RAD}
    return [by_kind[name.split("_", maxsplit=1)[0]] for name in EFFECTORS]


def rates(fdm: Fdm, x: Vec, u: Vec) -> Vec:
    """Return x' (9,) of the JSBSim model at state ``x`` (9,) and input ``u`` (10,)."""
    V, alpha, beta, p, q, r, psi, theta, phi = x.tolist()
    uvw = (V * math.cos(alpha) * math.cos(beta), V * math.sin(beta), V * math.sin(alpha) * math.cos(beta))
    fdm.set_inputs((*u.tolist(), *(0.0,) * 6))
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), uvw, (psi, theta, phi), (p, q, r)))
    (du, dv, dw), (dp, dq, dr) = fdm.accelerations()
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


def trim(fdm: Fdm, speed_m_s: float) -> tuple[Vec, Vec, float]:
    """Return (x0, u0, residual) of straight and level flight; raises PlantError when there is none."""

    def state(z: Vec) -> tuple[Vec, Vec]:
        alpha, flap, throttle = z.tolist()
        x = np.array([speed_m_s, alpha, 0.0, 0.0, 0.0, 0.0, 0.0, alpha, 0.0])
        return x, np.array(effectors_at(throttle, flap))

    def unbalanced(z: Vec) -> Vec:
        dx = rates(fdm, *state(z))
        return np.array([dx[0], dx[1] * speed_m_s, dx[4]])

    found = root(unbalanced, np.array([0.06, -0.05, 0.5]), tol=1e-12)
    residual = float(np.abs(unbalanced(found.x)).max())
    if not residual < 1e-6:
        msg = f"ice101 does not trim at {speed_m_s:.1f} m/s: {residual:.3g} left over"
        raise PlantError(msg)
    x0, u0 = state(found.x)
    return x0, u0, residual


def differences(fdm: Fdm, x0: Vec, u0: Vec) -> tuple[Mat, Mat]:
    """Return A (9, 9) and B (9, 10) by central differences about (x0, u0); noise below 1e-9 becomes zero."""
    A = np.empty((9, 9))
    B = np.empty((9, 10))
    for j, h in enumerate(STEPS):
        e = np.eye(9)[j] * h
        A[:, j] = (rates(fdm, x0 + e, u0) - rates(fdm, x0 - e, u0)) / (2 * h)
    for j in range(10):
        e = np.eye(10)[j] * 1e-3
        B[:, j] = (rates(fdm, x0, u0 + e) - rates(fdm, x0, u0 - e)) / 2e-3
    A[np.abs(A) < 1e-9] = 0.0
    B[np.abs(B) < 1e-9] = 0.0
    return A, B


def modes_of(A: Mat) -> tuple[Mode, ...]:
    """Return the named modes of thesis 3.7 and 3.8, fastest first in each plane."""
    found = []
    for plane, names in ((LONGITUDINAL, ("short period", "phugoid")), (LATERAL, ("lateral",))):
        values = [complex(v) for v in np.linalg.eigvals(A[np.ix_(plane, plane)]) if v.imag >= 0.0]
        values.sort(key=abs, reverse=True)
        for i, value in enumerate(values):
            name = names[min(i, len(names) - 1)] if value.imag > 0 or plane == LATERAL else "longitudinal"
            found.append(Mode(name, value))
    return tuple(found)


def report(result: Linearization) -> str:
    """Return the trim, the modes and the identified response as text for people."""
    a = result.airframe
    surfaces = zip(EFFECTORS[1:], a.trim.effectors[1:], strict=True)
    lines = [
        f"{a.name} at {a.trim.airspeed_m_s:.2f} m/s (Mach {MACH}), {a.trim.altitude_m:.0f} m, {a.mass_kg:.0f} kg",
        f"trim: alpha {math.degrees(a.trim.alpha_rad):.3f} deg, throttle {a.trim.throttle:.3f}, "
        f"residual {result.residual:.1e}",
        "      " + ", ".join(f"{name} {math.degrees(v):.2f}" for name, v in surfaces) + " deg",
        "",
        f"{'mode':14} {'eigenvalue (1/s)':>22} {'frequency':>10} {'damping':>8}",
    ]
    for mode in result.modes:
        v = mode.eigenvalue
        text = f"{v.real:+.4f}" + (f" +- {v.imag:.4f}j" if v.imag else "")
        lines.append(f"{mode.name:14} {text:>22} {abs(v):10.4f} {-v.real / abs(v):8.3f}")
    r = a.response
    lines += [
        "",
        f"closed attitude loops: roll {r.roll_rad_s:.2f} rad/s damping {r.roll_damping:.2f}, "
        f"pitch {r.pitch_rad_s:.2f} rad/s damping {r.pitch_damping:.2f}, "
        f"thrust lag {r.thrust_lag_s:.2f} s, delay {r.delay_s * 1e3:.0f} ms",
    ]
    lines += matrix("A (columns: states)", STATES, STATES, a.A)
    lines += matrix("B (columns: throttle 0..1, surfaces rad)", STATES, EFFECTORS, a.B)
    return "\n".join(lines)


def matrix(
    title: str, rows: tuple[str, ...], columns: tuple[str, ...], values: tuple[tuple[float, ...], ...]
) -> list[str]:
    """Return the lines of a table of ``values`` (rows, columns)."""
    head = " " * 7 + "".join(f"{name:>10}" for name in columns)
    body = [f"{name:7}" + "".join(f"{v:10.4f}" for v in row) for name, row in zip(rows, values, strict=True)]
    return ["", title, head, *body]


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
