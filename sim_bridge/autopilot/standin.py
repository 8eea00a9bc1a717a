"""The stand-in autopilot and the tanker's reporter: sensors, navigation, vehicle and inner loops, put together."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from companion.config import AirframeConfig
from companion.geometry import Vec, rotation_from_euler
from companion.messages import TankerState
from sim_bridge.autopilot.inner_loops import InnerLoops, Sensed
from sim_bridge.autopilot.navigation import DeadReckoner
from sim_bridge.autopilot.regulator import SurfaceRegulator
from sim_bridge.autopilot.setpoints import AttitudeCommand, OffsetCommand
from sim_bridge.autopilot.telemetry import Origin
from sim_bridge.autopilot.vehicle import Vehicle
from sim_bridge.sensor_conditions import AircraftSensors, GpsErrors
from sim_bridge.sensor_errors import GpsBias
from sim_bridge.sensors import GpsFix, GpsSensor, InertialSample, InertialSensor, Triple
from sim_bridge.truth import BodyState

THESIS_SENSORS = AircraftSensors()

GpsFault = Callable[[GpsFix | None, int], GpsFix | None]

HAND_OVER_S = 0.5
"""Time constant with which the last commands of one law go over into those of the other."""


class Navigation:
    """Sensors of one aircraft and the position that follows from them."""

    def __init__(
        self, rng: np.random.Generator, conditions: AircraftSensors = THESIS_SENSORS, common_gps: GpsBias | None = None,
        gps_fault: GpsFault | None = None,
    ) -> None:
        """Split the generator, so that inertial noise does not depend on how often GPS draws.

        ``common_gps``: what GPS errs by for both aircraft, one and the same process; ``gps_fault`` gives the fix that
        arrives, if any, for the one that is delivered, if any, at an instant in ns.
        """
        self._gps_fault = gps_fault
        inertial, gps, bias = rng.spawn(3)
        biases = [GpsBias(conditions.gps, bias)] if conditions.gps != GpsErrors() else []
        self._inertial = InertialSensor(inertial, conditions.ins)
        self._gps = GpsSensor(gps, biases if common_gps is None else [*biases, common_gps], conditions.gps_outages)
        self._reckoner = DeadReckoner()

    def measure(self, truth: BodyState) -> tuple[InertialSample, Triple | None, GpsFix | None]:
        """Return the inertial sample, the position at its instant (None before the first fix), and a new fix."""
        sample, fix = self._inertial.sample(truth, self._gps.out(truth.t_ns)), self._gps.sample(truth)
        if self._gps_fault is not None:
            fix = self._gps_fault(fix, truth.t_ns)
        return sample, self._reckoner.update(sample, fix), fix


class HandOver:
    """Keeps the effectors from jumping when the regulator takes over from the inner loops, or they from it."""

    def __init__(self, fade: float) -> None:
        """What is left of the difference is multiplied by ``fade`` at every step."""
        self._fade = fade
        self._regulated = False
        self._begins = False
        self._last: Vec | None = None
        self._difference = np.zeros(10)

    def begins(self, regulated: bool) -> bool:
        """Tell whether another law flies from this step on."""
        self._begins = regulated != self._regulated
        self._regulated = regulated
        return self._begins

    def smooth(self, wanted: Vec) -> Vec:
        """Return the commands (10,) for those that the law of this step wants."""
        if self._begins and self._last is not None:
            self._difference = self._last - wanted
        self._last = wanted + self._difference
        self._difference = self._fade * self._difference
        return self._last


class StandInAutopilot:
    """The receiver's autopilot: truth and bytes in, effector commands and bytes out, every ``dt_s``."""

    def __init__(
        self, airframe: AirframeConfig, rng: np.random.Generator, *, dt_s: float = 0.005, origin: Origin | None = None,
        sensors: AircraftSensors = THESIS_SENSORS, common_gps: GpsBias | None = None, gps_fault: GpsFault | None = None,
    ) -> None:
        """Build the autopilot of ``airframe``; ``rng`` is for its sensors alone."""
        self.vehicle = Vehicle(airframe, dt_s=dt_s, origin=origin)
        self._navigation = Navigation(rng, sensors, common_gps, gps_fault)
        self._loops = InnerLoops(airframe, dt_s)
        self._regulator = SurfaceRegulator(airframe, dt_s)
        self._hand_over = HandOver(math.exp(-dt_s / HAND_OVER_S))

    @property
    def rejects(self) -> Counter[str]:
        """What the vehicle dropped, by reason."""
        return self.vehicle.rejects

    def feed(self, data: bytes, t_ns: int) -> None:
        """Take MAVLink bytes that arrived at ``t_ns``."""
        self.vehicle.feed(data, t_ns)

    def step(self, truth: BodyState) -> Vec:
        """Measure, decide and control once; return effector commands (10,) (``sim_bridge.truth.EFFECTORS``)."""
        sample, p_ned_m, fix = self._navigation.measure(truth)
        command = self.vehicle.step(sample, p_ned_m, fix)
        sensed = Sensed(
            sample.t_ns, rotation_from_euler(*sample.euler_rad), np.array(sample.omega_rad_s),
            np.array(sample.v_ned_m_s), np.array(sample.specific_force_m_s2), sample.airspeed_m_s,
        )
        self._regulator.watch(sample, sensed.R_ned_frd)
        regulated = isinstance(command, OffsetCommand)
        if self._hand_over.begins(regulated):
            self._loops.reset()
            self._regulator.reset()
        effectors = self._hand_over.smooth(self._law_step(command, sample, sensed))
        self.vehicle.throttle = float(effectors[0])
        return effectors

    def _law_step(
        self, command: AttitudeCommand | OffsetCommand | None, sample: InertialSample, sensed: Sensed
    ) -> Vec:
        if command is None:
            return self._loops.hold_step(sensed)
        if isinstance(command, OffsetCommand):
            return self._regulator.step(command, sample)
        return self._loops.step(command.roll_rad, command.pitch_rad, command.thrust, sensed, command.lift_m_s2)

    def outgoing(self, t_ns: int) -> bytes:
        """Return the MAVLink frames that are due at ``t_ns``."""
        return self.vehicle.outgoing(t_ns)


class TankerReporter:
    """What the tanker tells over the datalink: its own sensors' state, at a fixed rate."""

    def __init__(
        self, rng: np.random.Generator, rate_hz: float = 25.0, sensors: AircraftSensors = THESIS_SENSORS,
        common_gps: GpsBias | None = None,
    ) -> None:
        """Report ``rate_hz`` times a second; ``rng`` is for the tanker's sensors alone."""
        self._navigation = Navigation(rng, sensors, common_gps)
        self._period_ns = round(1e9 / rate_hz)
        self._next_ns = 0

    def step(self, truth: BodyState) -> TankerState | None:
        """Measure once; return a state when one is due and the position is known."""
        sample, p_ned_m, _ = self._navigation.measure(truth)
        if p_ned_m is None or sample.t_ns < self._next_ns:
            return None
        self._next_ns = max(self._next_ns + self._period_ns, sample.t_ns)
        return TankerState(
            t_ns=sample.t_ns,
            p_ned_m=np.array(p_ned_m),
            v_ned_m_s=np.array(sample.v_ned_m_s),
            R_ned_tanker=rotation_from_euler(*sample.euler_rad),
            omega_tanker_rad_s=np.array(sample.omega_rad_s),
        )
