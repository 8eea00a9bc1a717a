"""The tanker: trimmed flight at constant Mach and altitude, held by a plain autopilot (thesis 2.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import root

from sim_bridge.plant.fdm import LBF, Fdm, InitialCondition, PlantError

G = 9.80665
INPUTS = ("tanker/thrust-lbs", "tanker/elevator-rad", "tanker/aileron-rad", "tanker/rudder-rad")
ENGINE_LAG_S = 2.0
THRUST_MAX_N = 160e3
"""Estimated: 4 x 96.2 kN at rest at sea level times 0.42, the lapse of a high-bypass engine to Mach 0.65, 6000 m."""


@dataclass(frozen=True, slots=True)
class TankerTrim:
    """Straight and level flight."""

    speed_m_s: float
    alpha_rad: float
    elevator_rad: float
    thrust_n: float


def trim_tanker(fdm: Fdm, speed_m_s: float, p_ned_m: tuple[float, float, float], heading_rad: float) -> TankerTrim:
    """Trim ``fdm`` in straight and level flight and leave it there; raises PlantError when there is no such flight."""

    def place(x: list[float]) -> None:
        alpha, elevator, thrust = x
        fdm.set_inputs((thrust * fdm.mass_kg / LBF, elevator, 0.0, 0.0))
        v_body = (speed_m_s * math.cos(alpha), 0.0, speed_m_s * math.sin(alpha))
        fdm.reset(InitialCondition(p_ned_m, v_body, (heading_rad, alpha, 0.0)))

    def residual(x: list[float]) -> list[float]:
        place(x)
        (u, _, w), (_, q, _) = fdm.accelerations()
        return [u, w, q]

    found = root(residual, [0.03, 0.0, 0.7], tol=1e-11)
    if not max(abs(r) for r in residual(list(found.x))) < 1e-6:
        msg = f"the tanker has no straight flight at {speed_m_s:.1f} m/s"
        raise PlantError(msg)
    alpha, elevator, thrust = (float(v) for v in found.x)
    return TankerTrim(speed_m_s, alpha, elevator, thrust * fdm.mass_kg)


class TankerAutopilot:
    """Holds altitude, heading and speed: pitch, bank and yaw loops with rates, thrust through the engines' lag.

    Gains by hand for a short period near 2 rad/s, a bank loop near 1 rad/s and an altitude loop near 0.1 rad/s: soft,
    as an airliner's autopilot in turbulence.
    """

    def __init__(self, fdm: Fdm, trim: TankerTrim, heading_rad: float, altitude_down_m: float, dt_s: float) -> None:
        """Hold the state of ``trim`` at ``altitude_down_m`` (ned down) on ``heading_rad``."""
        self._fdm, self._trim = fdm, trim
        self._heading, self._down = heading_rad, altitude_down_m
        self._dt_s = dt_s
        self._share = 1.0 - math.exp(-dt_s / ENGINE_LAG_S)
        self._thrust_n = trim.thrust_n
        self._integral_m_s = 0.0

    def step(self) -> None:
        """Read the aircraft and set its controls for the next step."""
        f, trim = self._fdm, self._trim
        too_low_m = f.p_d - self._down
        self._integral_m_s += too_low_m * self._dt_s
        climb = 0.0008 * too_low_m + 0.004 * f.v_d + 0.00004 * self._integral_m_s
        pitch_error = f.pitch - (trim.alpha_rad + clamp(climb, 0.05))
        elevator = trim.elevator_rad + 0.8 * pitch_error + 0.8 * f.q
        turn = math.remainder(self._heading - f.yaw, 2.0 * math.pi)
        roll_error = f.roll - clamp(1.0 * turn, 0.2)
        aileron = 1.0 * roll_error + 1.0 * f.p
        rudder = 0.8 * (f.r - G / trim.speed_m_s * f.roll)
        speed = math.sqrt(f.v_n * f.v_n + f.v_e * f.v_e + f.v_d * f.v_d)
        wanted = trim.thrust_n + 0.15 * f.mass_kg * (trim.speed_m_s - speed)
        self._thrust_n += self._share * (min(max(wanted, 0.0), THRUST_MAX_N) - self._thrust_n)
        f.set_inputs((self._thrust_n / LBF, clamp(elevator, 0.3), clamp(aileron, 0.35), clamp(rudder, 0.35)))


def clamp(value: float, limit: float) -> float:
    """Return ``value`` within +-limit."""
    return min(max(value, -limit), limit)
