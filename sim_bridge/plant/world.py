"""The outside world at 200 Hz: tanker, receiver, air, wake and boom, on one clock.

``ned`` has its origin where the tanker's centre of mass starts, at 6000 m; the ground is flat (see ``plant.fdm``). One
``step`` advances exactly ``dt_s``. The same generator gives the same flight, bit for bit.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import AirframeConfig, TankerConfig, Vec3
from companion.geometry import GRAVITY_M_S2, Vec
from sim_bridge.plant.actuators import ActuatorConfig, Actuators
from sim_bridge.plant.aircraft_data import AIRCRAFT, read_aircraft
from sim_bridge.plant.boom import AirAtBoom, Boom, Carrier, Receptacle
from sim_bridge.plant.bow_wave import bow_wave_m_s
from sim_bridge.plant.conditions import PlantConditions
from sim_bridge.plant.fdm import Fdm, InitialCondition, PlantError
from sim_bridge.plant.gusts import GustField
from sim_bridge.plant.tanker import INPUTS as TANKER_INPUTS
from sim_bridge.plant.tanker import TankerAutopilot, TankerTrim, trim_tanker
from sim_bridge.plant.wake import Wake
from sim_bridge.plant.wind import Wind, start_in_wind
from sim_bridge.truth import EFFECTORS, Truth

MACH = 0.65
ALTITUDE_M = 6000.0
WAKE_INPUTS = ("wake/dCD", "wake/dCL", "wake/dCm", "wake/dCl", "wake/dCn", "wake/dCY")
UAV_INPUTS = (*(f"effector/{name}" for name in EFFECTORS), *WAKE_INPUTS)
CALM_WAKE = (0.0,) * 6


class World:
    """Everything that the companion cannot know; ``truth`` tells it."""

    def __init__(
        self,
        tanker: TankerConfig,
        airframe: AirframeConfig,
        start_tanker_m: tuple[float, float, float] | Vec,
        turbulence: str,
        wake: bool,
        rng: np.random.Generator,
        heading_rad: float = 0.0,
        dt_s: float = 0.005,
        actuators: ActuatorConfig | None = None,
        conditions: PlantConditions | None = None,
    ) -> None:
        """Put both aircraft into trimmed flight; ``start_tanker_m`` is the receiver's centre of mass in tanker axes.

        Raises PlantError when an aircraft cannot be trimmed or loaded, ValueError for an unknown turbulence.
        """
        self._conditions = conditions or PlantConditions()
        self._dt_ns = round(dt_s * 1e9)
        self.t_ns = 0
        self._boom = Boom(tanker.boom, self._conditions.boom, dt_s, tanker.box_tanker_m, tanker.window)
        self._receptacle_frd_m = airframe.receptacle_frd_m
        self._gusts = GustField(turbulence, rng, heading_rad)
        self._wind = Wind(self._conditions.wind)
        data = {name: read_aircraft(name) for name in AIRCRAFT}  # JSBSim takes a file with anything in it
        self._tanker = Fdm("kc135r", TANKER_INPUTS, dt_s, ALTITUDE_M)
        trim = self._start_tanker(airframe.trim.airspeed_m_s, heading_rad)
        weight_n = self._tanker.mass_kg * GRAVITY_M_S2
        self._wake = Wake(weight_n, self._tanker.air_density_kg_m3(), trim.speed_m_s) if wake else None
        lift_slope = data["ice101"].coefficients["CLa"].value
        self._downwash_m_s = self._downwash(tanker.box_tanker_m, lift_slope, trim.speed_m_s)
        self._uav = Fdm("ice101", UAV_INPUTS, dt_s, ALTITUDE_M)
        errors = self._conditions.airframe
        for name, factor in {**errors.coefficients, "effectiveness": errors.effectiveness}.items():
            self._uav.scale_coefficient(name, factor)
        slower = (actuators or ActuatorConfig()).with_delay(errors.actuator_delay_s)
        self._actuators = Actuators(np.array(airframe.trim.effectors), dt_s, slower)
        p_ned_m = self._tanker.rotation() @ np.asarray(start_tanker_m, dtype=np.float64)
        self._uav.set_receptacle(airframe.receptacle_frd_m)
        self._start_uav(airframe, p_ned_m, heading_rad)
        self._pulled = False
        self._truth: Truth | None = None

    def _start_tanker(self, speed_m_s: float, heading_rad: float) -> TankerTrim:
        tanker, origin, course = self._tanker, (0.0, 0.0, 0.0), self._conditions.course
        turning = None
        if course.kind == "racetrack":
            turning = trim_tanker(tanker, speed_m_s, origin, heading_rad, course.bank_rad)
        trim = trim_tanker(tanker, speed_m_s, origin, heading_rad)
        start_in_wind(tanker, trim.start(origin, heading_rad), self._wind)
        dt_s = self._dt_ns * 1e-9
        self._tanker_autopilot = TankerAutopilot(tanker, trim, heading_rad, 0.0, dt_s, course, turning, self._wind)
        return trim

    def _start_uav(self, airframe: AirframeConfig, p_ned_m: Vec, heading_rad: float) -> None:
        alpha, speed = airframe.trim.alpha_rad, airframe.trim.airspeed_m_s
        self._uav.set_inputs((*self._actuators.position.tolist(), *CALM_WAKE))
        n, e, d = p_ned_m.tolist()
        v_body = (speed * math.cos(alpha), 0.0, speed * math.sin(alpha))
        start_in_wind(self._uav, InitialCondition((n, e, d), v_body, (heading_rad, alpha, 0.0)), self._wind)

    @property
    def boom(self) -> Boom:
        """The boom: its events and counters, and its operator's stick."""
        return self._boom

    @property
    def truth(self) -> Truth:
        """This instant, exactly; built when asked for."""
        if self._truth is None:
            self._truth = Truth(
                t_ns=self.t_ns,
                uav=self._uav.state(self.t_ns),
                tanker=self._tanker.state(self.t_ns),
                boom=self._boom.state,
                uav_effectors=self._actuators.position.copy(),
            )
        return self._truth

    def step(self, uav_effectors: Vec) -> None:
        """Advance one step under commands (10,) for the effectors; raises PlantError when something is not finite."""
        self._truth = None
        if not self._actuators.step(uav_effectors):
            msg = "an effector command is not a finite number"
            raise PlantError(msg)
        self._uav.set_inputs((*self._actuators.position.tolist(), *self._wake_increments()))
        self._tanker_autopilot.step()
        self._meet_gust(self._uav)
        air_ned_m_s = self._meet_gust(self._tanker)
        self._uav.step()
        self._tanker.step()
        self.t_ns += self._dt_ns
        if self._conditions.boom.operator != "fixed":
            self._step_boom(air_ned_m_s)

    def _step_boom(self, air_ned_m_s: Vec3) -> None:
        tanker, uav, boom = self._tanker, self._uav, self._boom
        north, east, down = air_ned_m_s
        air = AirAtBoom(tanker.air_density_kg_m3(), (north, east, down + self._downwash_m_s), bow_wave_m_s)
        carrier = Carrier(*tanker.motion(), *tanker.accelerations())
        boom.step(carrier, Receptacle(*uav.motion(), self._receptacle_frd_m), air)
        pull = boom.force_on_receptacle_ned_n
        if boom.contact or self._pulled:
            self._pulled = boom.contact
            x, y, z = (uav.rotation().T @ pull).tolist()
            uav.set_boom_force((x, y, z))
            uav.set_transferred(boom.given_kg)
            tanker.set_transferred(-boom.given_kg)

    def _meet_gust(self, aircraft: Fdm) -> Vec3:
        """Put the aircraft into the air at its place; return that air's velocity."""
        wind_n, wind_e = self._wind.at(-aircraft.p_d)
        if self._gusts.calm:
            aircraft.set_gust(wind_n, wind_e, 0.0)
            return wind_n, wind_e, 0.0
        # Where the aircraft is in the air that drifts with the wind.
        drift_n, drift_e = self._wind.at(0.0)
        t_s = self.t_ns * 1e-9
        north, east, down, p, q, r = self._gusts.at(
            aircraft.p_n - drift_n * t_s, aircraft.p_e - drift_e * t_s, aircraft.p_d,
            math.cos(aircraft.yaw), math.sin(aircraft.yaw), aircraft.span_m,
        )
        aircraft.set_gust(wind_n + north, wind_e + east, down)
        aircraft.set_rotary_gust(p, q, r)
        return wind_n + north, wind_e + east, down

    def _downwash(self, box_tanker_m: Vec3, lift_slope: float, speed_m_s: float) -> float:
        """Return how fast the air behind the tanker's wing sinks at the box: what takes the receiver's lift there."""
        if self._wake is None:
            return 0.0
        return -self._wake.increments(*box_tanker_m)[1] / lift_slope * speed_m_s

    def _wake_increments(self) -> tuple[float, ...]:
        if self._wake is None:
            return CALM_WAKE
        tanker, uav = self._tanker, self._uav
        north, east, down = uav.p_n - tanker.p_n, uav.p_e - tanker.p_e, uav.p_d - tanker.p_d
        c, s = math.cos(tanker.yaw), math.sin(tanker.yaw)
        return self._wake.increments(north * c + east * s, east * c - north * s, down)
