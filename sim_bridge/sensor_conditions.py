"""How a flight senses: parts of a scenario. Every default is the thesis' sensor (3.2), or the picture chain's noise.

In a scenario file, for example::

    [[sensors.receiver.gps_outages]]
    from_s = 60.0
    until_s = 200.0

    [sensors.receiver.gps]
    bias_ned_m = [1.0, -1.0, 1.0]

    [sensors.receiver.ins]
    attitude_drift_rad_s = [4.8e-6, 0.0, 0.0]
"""

from __future__ import annotations

from companion.config import Struct, Vec3

STILL: Vec3 = (0.0, 0.0, 0.0)


class MarkerSensorConditions(Struct, frozen=True, kw_only=True):
    """Simulated detections, ``vision_input = "detections"``: what stands in for picture and detection.

    ``sigma_px``: standard deviation of a centroid per axis. The picture chain's own, against the truth of one whole
    flight with the thesis camera (seed 1003), is 0.025 to 0.04 px at 10 to 60 m. ``dropout``: probability that a marker
    is not seen in a frame, each for itself.
    """

    sigma_px: float = 0.035
    dropout: float = 0.0


class GpsErrors(Struct, frozen=True, kw_only=True):
    """What GPS errs by beyond the thesis' noise: a constant bias, and about it a slow one, of one size on all axes.

    The slow one is a Gauss-Markov process with standard deviation ``slow_sigma_m`` and correlation time ``slow_s``.
    """

    bias_ned_m: Vec3 = STILL
    slow_sigma_m: float = 0.0
    slow_s: float = 60.0


class Outage(Struct, frozen=True, kw_only=True):
    """No fixes in this part of the flight, in seconds since its start."""

    from_s: float
    until_s: float


class InsErrors(Struct, frozen=True, kw_only=True):
    """What an INS errs by beyond the thesis' noise, from the start of the flight on.

    ``attitude_drift_rad_s``: how fast yaw, pitch and roll drift off (1 degree per hour is 4.85e-6);
    ``attitude_walk``: the same at random, rad per root of a second. ``gyro_bias_rad_s``: of p, q, r as they are told.
    The velocity in ``ned`` turns with the attitude that is told. ``velocity_drift_m_s2`` in ``ned`` and
    ``velocity_walk``, m/s per root of a second: while GPS is out, with which the INS keeps its velocity right; when GPS
    is back the error settles. ``accelerometer_noise_power``: band-limited noise as the thesis has it on other channels,
    (m/s^2)^2 per hertz, none in the thesis.
    """

    attitude_drift_rad_s: Vec3 = STILL
    attitude_walk: float = 0.0
    gyro_bias_rad_s: Vec3 = STILL
    velocity_drift_m_s2: Vec3 = STILL
    velocity_walk: float = 0.0
    accelerometer_noise_power: float = 0.0


class AircraftSensors(Struct, frozen=True, kw_only=True):
    """The sensors of one aircraft; its GPS errors are its own, beside those that both share."""

    gps: GpsErrors = GpsErrors()
    gps_outages: tuple[Outage, ...] = ()
    ins: InsErrors = InsErrors()


class SensorConditions(Struct, frozen=True, kw_only=True):
    """All of them. ``common_gps`` errs alike for both aircraft, as satellites and atmosphere do."""

    common_gps: GpsErrors = GpsErrors()
    receiver: AircraftSensors = AircraftSensors()
    tanker: AircraftSensors = AircraftSensors()
    markers: MarkerSensorConditions = MarkerSensorConditions()


def sensor_rules(c: SensorConditions) -> list[tuple[bool, str]]:
    """Return what must hold of the conditions, each with the text for when it does not."""
    return [
        *gps_rules(c.common_gps, "sensors.common_gps"),
        *aircraft_rules(c.receiver, "sensors.receiver"),
        *aircraft_rules(c.tanker, "sensors.tanker"),
        (0.0 <= c.markers.sigma_px <= 20.0, "sensors.markers.sigma_px: must be in 0..20 pixels"),
        (0.0 <= c.markers.dropout <= 1.0, "sensors.markers.dropout: is a probability and must be in 0..1"),
    ]


def gps_rules(c: GpsErrors, where: str) -> list[tuple[bool, str]]:
    """Return the rules of one GPS."""
    return [
        (within(c.bias_ned_m, 1000.0), f"{where}.bias_ned_m: must be within 1000 metres"),
        (0.0 <= c.slow_sigma_m <= 1000.0, f"{where}.slow_sigma_m: must be in 0..1000 metres"),
        (0.1 <= c.slow_s <= 1e6, f"{where}.slow_s: must be in 0.1..1000000 seconds"),
    ]


def aircraft_rules(c: AircraftSensors, where: str) -> list[tuple[bool, str]]:
    """Return the rules of one aircraft's sensors."""
    ins = c.ins
    return [
        *gps_rules(c.gps, f"{where}.gps"),
        (all(0.0 <= o.from_s < o.until_s for o in c.gps_outages),
         f"{where}.gps_outages: from_s must be at least 0 and before until_s"),
        (within(ins.attitude_drift_rad_s, 0.01),
         f"{where}.ins.attitude_drift_rad_s: must be within 0.01 (radians per second: 1 degree per hour is 4.85e-6)"),
        (0.0 <= ins.attitude_walk <= 0.01, f"{where}.ins.attitude_walk: must be in 0..0.01 rad per root of a second"),
        (within(ins.gyro_bias_rad_s, 0.1), f"{where}.ins.gyro_bias_rad_s: must be within 0.1 radians per second"),
        (within(ins.velocity_drift_m_s2, 1.0), f"{where}.ins.velocity_drift_m_s2: must be within 1 metre per second^2"),
        (0.0 <= ins.velocity_walk <= 10.0, f"{where}.ins.velocity_walk: must be in 0..10 m/s per root of a second"),
        (0.0 <= ins.accelerometer_noise_power <= 10.0,
         f"{where}.ins.accelerometer_noise_power: must be in 0..10 (m/s^2)^2 per hertz"),
    ]


def within(values: Vec3, limit: float) -> bool:
    """Tell whether all are numbers of at most ``limit`` in size."""
    return all(abs(v) <= limit for v in values)
