"""The tanker: trimmed flight at constant Mach and altitude on a plain autopilot (thesis 2.1), straight or turning."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import root

from companion.geometry import GRAVITY_M_S2
from sim_bridge.plant.conditions import CourseConfig, WindConfig
from sim_bridge.plant.fdm import LBF, Fdm, InitialCondition, PlantError
from sim_bridge.plant.wind import Wind

INPUTS = ("tanker/thrust-lbs", "tanker/elevator-rad", "tanker/aileron-rad", "tanker/rudder-rad")
ENGINE_LAG_S = 2.0
THRUST_MAX_N = 160e3
"""Estimated: 4 x 96.2 kN at rest at sea level times 0.42, the lapse of a high-bypass engine to Mach 0.65, 6000 m."""
LOAD_MAX = 6.0
"""Load factor beyond which no turn of the tanker is tried: twice what any transport bears, a bank of 80 degrees."""
ROLL_RATE_RAD_S = math.radians(3.0)
"""Into and out of turns: as airliners roll with passengers on board (estimated)."""


@dataclass(frozen=True, slots=True)
class TankerTrim:
    """Level flight: straight, or turning at ``bank_rad`` to the right."""

    speed_m_s: float
    alpha_rad: float
    elevator_rad: float
    thrust_n: float
    bank_rad: float = 0.0

    @property
    def pitch_rad(self) -> float:
        """Pitch angle that goes with level flight at this incidence and bank."""
        return math.atan(math.tan(self.alpha_rad) * math.cos(self.bank_rad))

    def start(self, p_ned_m: tuple[float, float, float], heading_rad: float) -> InitialCondition:
        """Return this flight at a place, in air at rest."""
        V, alpha, bank, pitch = self.speed_m_s, self.alpha_rad, self.bank_rad, self.pitch_rad
        turn = GRAVITY_M_S2 / V * math.tan(bank)
        level = turn * math.cos(pitch)
        omega = (-turn * math.sin(pitch), level * math.sin(bank), level * math.cos(bank))
        v_body = (V * math.cos(alpha), 0.0, V * math.sin(alpha))
        return InitialCondition(p_ned_m, v_body, (heading_rad, pitch, bank), omega)


def trim_tanker(
    fdm: Fdm, speed_m_s: float, p_ned_m: tuple[float, float, float], heading_rad: float, bank_rad: float = 0.0
) -> TankerTrim:
    """Trim ``fdm`` in level flight and leave it there; raises PlantError when there is no such flight.

    In a turn lift, thrust and pitching moment are balanced; the small rest in roll and yaw is the autopilot's.
    """

    def place(x: list[float]) -> TankerTrim:
        alpha, elevator, thrust = x
        trim = TankerTrim(speed_m_s, alpha, elevator, thrust * fdm.mass_kg, bank_rad)
        fdm.set_inputs((trim.thrust_n / LBF, elevator, 0.0, 0.0))
        fdm.reset(trim.start(p_ned_m, heading_rad))
        return trim

    def residual(x: list[float]) -> list[float]:
        place(x)
        (u, _, w), (_, q, _) = fdm.accelerations()
        return [u, w, q]

    # Near 90 degrees level flight turns at a rate that JSBSim is not asked for.
    tried = root(residual, [0.03, 0.0, 0.7], tol=1e-11) if math.cos(bank_rad) * LOAD_MAX > 1.0 else None
    if tried is None or not max(abs(r) for r in residual(tried.x.tolist())) < 1e-6:
        turning = f" turning at {math.degrees(bank_rad):.0f} degrees of bank" if bank_rad else ""
        msg = f"the tanker has no level flight at {speed_m_s:.1f} m/s{turning}"
        raise PlantError(msg)
    return place(tried.x.tolist())


class Course:
    """Where the tanker heads and how it banks over time.

    A racetrack is leg, half turn, leg, half turn, and again; bank goes up and down at ``ROLL_RATE_RAD_S``, and heading
    is what coordinated flight makes of it, psi' = g / V tan(bank).
    """

    def __init__(self, config: CourseConfig, heading_rad: float, speed_m_s: float) -> None:
        """Start on the first leg, on ``heading_rad``."""
        self._heading = heading_rad
        self._side = 1.0 if config.turn == "right" else -1.0
        self._leg_s = config.leg_s if config.kind == "racetrack" else math.inf
        self.bank_rad = config.bank_rad if config.kind == "racetrack" else 0.0
        self._rate = GRAVITY_M_S2 / speed_m_s
        self._roll_s = self.bank_rad / ROLL_RATE_RAD_S
        self._held_s = 0.0
        if self.bank_rad:
            held_rad = math.pi - 2.0 * self._rolled(self.bank_rad)
            self._held_s = held_rad / (self._rate * math.tan(self.bank_rad))
        self._turn_s = 2.0 * self._roll_s + self._held_s

    def _rolled(self, bank_rad: float) -> float:
        """Return the turn (rad) made while rolling from level to ``bank_rad``."""
        return -self._rate / ROLL_RATE_RAD_S * math.log(math.cos(bank_rad))

    def at(self, t_s: float) -> tuple[float, float]:
        """Return heading and bank in rad at ``t_s``."""
        if t_s < self._leg_s:
            return self._heading, 0.0
        half, since_s = divmod(t_s, self._leg_s + self._turn_s)
        heading = self._heading + self._side * math.pi * half
        in_s = since_s - self._leg_s
        if in_s < 0.0:
            return heading, 0.0
        out_s = self._turn_s - in_s
        bank = min(ROLL_RATE_RAD_S * min(in_s, out_s), self.bank_rad)
        held_s = min(max(in_s - self._roll_s, 0.0), self._held_s)
        turned = self._rate * math.tan(self.bank_rad) * held_s
        if in_s < out_s:
            turned += self._rolled(bank)
        else:
            turned += 2.0 * self._rolled(self.bank_rad) - self._rolled(bank)
        return heading + self._side * turned, self._side * bank


class TankerAutopilot:
    """Holds altitude, course and airspeed: pitch, bank and yaw loops with rates, thrust through the engines' lag.

    Gains by hand for a short period near 2 rad/s, a bank loop near 1 rad/s and an altitude loop near 0.1 rad/s: soft,
    as an airliner's autopilot in turbulence. What a turn needs of pitch, elevator and thrust is put in with its bank.
    Airspeed is taken against the mean wind, as from air data smoothed by inertial ones.
    """

    def __init__(
        self, fdm: Fdm, trim: TankerTrim, heading_rad: float, altitude_down_m: float, dt_s: float,
        course: CourseConfig | None = None, turning: TankerTrim | None = None, wind: Wind | None = None,
    ) -> None:
        """Hold the state of ``trim`` at ``altitude_down_m`` (ned down) on a course that starts on ``heading_rad``.

        ``turning`` is the trim at the course's bank, for a course that turns.
        """
        self._fdm, self._trim = fdm, trim
        self._course = Course(course or CourseConfig(), heading_rad, trim.speed_m_s)
        self._turning = turning or trim
        self._wind = wind or Wind(WindConfig())
        self._down = altitude_down_m
        self._dt_s = dt_s
        self._steps = 0
        self._bank = 0.0
        self._share = 1.0 - math.exp(-dt_s / ENGINE_LAG_S)
        self._thrust_n = trim.thrust_n
        self._integral_m_s = 0.0

    def step(self) -> None:
        """Read the aircraft and set its controls for the next step."""
        f, trim, turning = self._fdm, self._trim, self._turning
        heading, bank = self._course.at(self._steps * self._dt_s)
        roll_rate = (bank - self._bank) / self._dt_s
        self._steps, self._bank = self._steps + 1, bank
        # The share of the turn's load: 0 with level wings, 1 at the course's bank.
        share = (1.0 / math.cos(bank) - 1.0) / (1.0 / math.cos(turning.bank_rad) - 1.0) if bank else 0.0
        too_low_m = f.p_d - self._down
        self._integral_m_s += too_low_m * self._dt_s
        climb = 0.0008 * too_low_m + 0.004 * f.v_d + 0.00004 * self._integral_m_s
        pitch = trim.pitch_rad + share * (turning.pitch_rad - trim.pitch_rad)
        pitch_error = f.pitch - (pitch + clamp(climb, 0.05))
        pulled = GRAVITY_M_S2 / trim.speed_m_s * math.tan(bank) * math.sin(bank)
        elevator = trim.elevator_rad + share * (turning.elevator_rad - trim.elevator_rad)
        elevator += 0.8 * pitch_error + 0.8 * (f.q - pulled)
        turn = math.remainder(heading - f.yaw, 2.0 * math.pi)
        roll_error = f.roll - (bank + clamp(1.0 * turn, 0.2))
        aileron = 1.0 * roll_error + 1.0 * (f.p - roll_rate)
        rudder = 0.8 * (f.r - GRAVITY_M_S2 / trim.speed_m_s * math.sin(f.roll))
        thrust_n = trim.thrust_n + share * (turning.thrust_n - trim.thrust_n)
        wanted_n = thrust_n + 0.15 * f.mass_kg * (trim.speed_m_s - self._airspeed_m_s())
        self._thrust_n += self._share * (min(max(wanted_n, 0.0), THRUST_MAX_N) - self._thrust_n)
        f.set_inputs((self._thrust_n / LBF, clamp(elevator, 0.3), clamp(aileron, 0.35), clamp(rudder, 0.35)))

    def _airspeed_m_s(self) -> float:
        f = self._fdm
        wind_n, wind_e = self._wind.at(-f.p_d)
        north, east = f.v_n - wind_n, f.v_e - wind_e
        return math.sqrt(north * north + east * east + f.v_d * f.v_d)


def clamp(value: float, limit: float) -> float:
    """Return ``value`` within +-limit."""
    return min(max(value, -limit), limit)
