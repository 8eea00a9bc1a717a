"""Truth to measurements: the sensors of thesis 3.2, for the receiver and (a second pair) for the tanker.

Beyond the thesis, where the scenario asks for it: outages and biases of GPS, drift of the INS (``sensor_errors``).

Rules
-----
* Noise is band-limited white: covariance n_p / T, drawn once and held for T (thesis 3.2). The signal under it is not
  held.
* The inertial velocity is what the thesis measures, V, alpha and beta with their noise, turned by the measured Euler
  angles. alpha and beta are inertial flow angles: a gust does not move them.
* GPS tells where the centre of mass was one sample ago (thesis: unit delay); its fix carries that instant.
* The INS' velocity is right while GPS comes; without it an error grows, which moves V, alpha and beta too.
* A generator is passed in and used by one sensor alone: its noise depends on its seed and the clock only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.messages import NS
from sim_bridge.sensor_conditions import InsErrors, Outage
from sim_bridge.sensor_errors import ZERO, GpsBias, InsDrift
from sim_bridge.truth import BodyState

Triple = tuple[float, float, float]

INERTIAL_PERIOD_NS = 50_000_000
GPS_PERIOD_NS = 100_000_000

EULER_SIGMA_RAD = math.sqrt(1e-9 / 0.05)
OMEGA_SIGMA_RAD_S = math.sqrt(1e-8 / 0.05)
FLOW_SIGMA_RAD = math.sqrt(1e-9 / 0.05)
SPEED_SIGMA_M_S = math.sqrt(1e-7 / 0.05)
GPS_SIGMA_M = math.sqrt(1e-3 / 0.1)
"""0.1 m on x, y and H."""

INERTIAL_SIGMA = (EULER_SIGMA_RAD,) * 3 + (OMEGA_SIGMA_RAD_S,) * 3 + (FLOW_SIGMA_RAD,) * 2 + (SPEED_SIGMA_M_S,)

NO_INS_ERRORS = InsErrors()

NOISE_BLOCK = 256
"""Rows drawn at once: a call of the generator costs as much as a hundred rows."""


class InertialSample(msgspec.Struct, frozen=True):
    """What the INS says at ``t_ns``.

    ``euler_rad`` yaw, pitch, roll; ``omega_rad_s`` p, q, r; ``speed_m_s``, ``alpha_rad``, ``beta_rad`` of the inertial
    velocity, and that velocity in ``ned``; ``specific_force_m_s2`` in body axes (no noise in the thesis);
    ``airspeed_m_s`` true airspeed, gusts included.
    """

    t_ns: int
    euler_rad: Triple
    omega_rad_s: Triple
    speed_m_s: float
    alpha_rad: float
    beta_rad: float
    v_ned_m_s: Triple
    specific_force_m_s2: Triple
    airspeed_m_s: float


@dataclass(frozen=True, slots=True)
class GpsFix:
    """Where the centre of mass was at ``t_ns``, which is before the fix was delivered."""

    t_ns: int
    p_ned_m: Triple


def noise_rows(rng: np.random.Generator, sigmas: tuple[float, ...]) -> Iterator[tuple[float, ...]]:
    """Yield rows of independent Gaussian noise for ever, one standard deviation a column."""
    while True:
        block = rng.standard_normal((NOISE_BLOCK, len(sigmas))) * sigmas
        yield from map(tuple, block.tolist())


class InertialSensor:
    """Inertial navigation unit and air data of one aircraft."""

    def __init__(self, rng: np.random.Generator, errors: InsErrors = NO_INS_ERRORS) -> None:
        """Take the generator that only this sensor uses."""
        self._drift = None
        if errors != NO_INS_ERRORS:
            self._drift = InsDrift(errors, rng.spawn(1)[0], INERTIAL_PERIOD_NS * NS)
        self._velocity_error = self._force_noise = ZERO
        self._rows = noise_rows(rng, INERTIAL_SIGMA)
        self._noise: tuple[float, ...] = (0.0,) * len(INERTIAL_SIGMA)
        self._slot: int | None = None

    def sample(self, truth: BodyState, gps_out: bool = False) -> InertialSample:
        """Measure the truth of one instant, with or without GPS to lean on; instants must not go back."""
        slot = truth.t_ns // INERTIAL_PERIOD_NS
        if slot != self._slot:
            self._slot = slot
            self._noise = next(self._rows)
            if self._drift is not None:
                self._take_drift(self._drift, truth.t_ns, gps_out)
        return self._measured(truth)

    def _take_drift(self, drift: InsDrift, t_ns: int, gps_out: bool) -> None:
        drift.advance(t_ns, gps_out)
        offsets = (*drift.euler_rad, *drift.gyro_bias_rad_s, 0.0, 0.0, 0.0)
        self._noise = tuple(noise + offset for noise, offset in zip(self._noise, offsets, strict=True))
        self._velocity_error, self._force_noise = drift.v_ned_m_s, drift.force_m_s2

    def _measured(self, truth: BodyState) -> InertialSample:
        n_yaw, n_pitch, n_roll, n_p, n_q, n_r, n_alpha, n_beta, n_speed = self._noise
        row0, row1, row2 = truth.R_ned_body.tolist()
        vn, ve, vd = truth.v_ned_m_s.tolist()
        p, q, r = truth.omega_body_rad_s.tolist()
        fx, fy, fz = truth.specific_force_body_m_s2.tolist()
        ax, ay, az = truth.v_air_body_m_s.tolist()
        n_fx, n_fy, n_fz = self._force_noise
        north, east, down = self._velocity_error
        vn, ve, vd = vn + north, ve + east, vd + down
        yaw = math.atan2(row1[0], row0[0]) + n_yaw
        pitch = math.asin(max(-1.0, min(1.0, -row2[0]))) + n_pitch
        roll = math.atan2(row2[1], row2[2]) + n_roll
        u = row0[0] * vn + row1[0] * ve + row2[0] * vd
        v = row0[1] * vn + row1[1] * ve + row2[1] * vd
        w = row0[2] * vn + row1[2] * ve + row2[2] * vd
        alpha = math.atan2(w, u) + n_alpha
        beta = math.atan2(v, math.hypot(u, w)) + n_beta
        speed = math.sqrt(u * u + v * v + w * w) + n_speed
        airspeed = math.sqrt(ax * ax + ay * ay + az * az) + n_speed
        return InertialSample(
            truth.t_ns, (yaw, pitch, roll), (p + n_p, q + n_q, r + n_r), speed, alpha, beta,
            velocity_ned(speed, alpha, beta, yaw, pitch, roll), (fx + n_fx, fy + n_fy, fz + n_fz), airspeed,
        )


def velocity_ned(speed: float, alpha: float, beta: float, yaw: float, pitch: float, roll: float) -> Triple:
    """Return the inertial velocity in ``ned`` (m/s) from V, alpha, beta and the Euler angles (m/s, rad)."""
    cos_beta = math.cos(beta)
    u, v, w = speed * math.cos(alpha) * cos_beta, speed * math.sin(beta), speed * math.sin(alpha) * cos_beta
    cph, sph = math.cos(roll), math.sin(roll)
    cth, sth = math.cos(pitch), math.sin(pitch)
    cps, sps = math.cos(yaw), math.sin(yaw)
    right, down = v * cph - w * sph, v * sph + w * cph
    forward = u * cth + down * sth
    return forward * cps - right * sps, forward * sps + right * cps, down * cth - u * sth


class GpsSensor:
    """GPS receiver of one aircraft: 10 Hz, 0.1 m, each fix delivered one sample after it was true.

    ``biases`` are added to every fix. During ``outages`` nothing is measured or delivered.
    """

    def __init__(
        self, rng: np.random.Generator, biases: Sequence[GpsBias] = (), outages: Sequence[Outage] = ()
    ) -> None:
        """Take the generator that only this sensor uses."""
        self._rows = noise_rows(rng, (GPS_SIGMA_M,) * 3)
        self._biases = tuple(biases)
        self._outages = tuple((round(o.from_s / NS), round(o.until_s / NS)) for o in outages)
        self._slot: int | None = None
        self._delayed: GpsFix | None = None

    def out(self, t_ns: int) -> bool:
        """Tell whether there are no fixes at this instant."""
        return any(begin_ns <= t_ns < end_ns for begin_ns, end_ns in self._outages)

    def sample(self, truth: BodyState) -> GpsFix | None:
        """Return the fix that is delivered at this instant, or None between fixes and before the first."""
        slot = truth.t_ns // GPS_PERIOD_NS
        if slot == self._slot:
            return None
        self._slot = slot
        delivered = self._delayed
        noise = next(self._rows)
        if self.out(truth.t_ns):
            self._delayed = None
            return None
        x, y, z = truth.p_ned_m.tolist()
        for n, e, d in (noise, *(bias.at(truth.t_ns) for bias in self._biases)):
            x, y, z = x + n, y + e, z + d
        self._delayed = GpsFix(truth.t_ns, (x, y, z))
        return delivered
