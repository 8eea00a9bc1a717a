"""How far what the two INS tell of one instant may be off by noise, and by what has happened since they told it.

Rules
-----
* A velocity is told well along the path and badly across it: the noise of its angles times the speed (thesis 3.2: V
  0.0014 m/s; heading, pitch and both flow angles 1.4e-4 rad each, 0.041 m/s at 206 m/s).
* Past its newest sample an aircraft has gone on by what it last did. It errs by an acceleration that nobody has told:
  a, age: a age^2 / 2 of place, a age of velocity, and for angles likewise.
* A sample's noise stays as long as the sample does; a travel that is extrapolated errs by velocity noise times age.
* The velocity told turns with the attitude told, so that one noise moves an extrapolated travel and turns the lever of
  the box, the other way (``with_travel``).
* Across a gap between samples a travel is a trapezium of two velocities: it errs by T / 2 of the noise of each, and by
  what the aircraft did meanwhile against the straight line between them (``BETWEEN``). That stays in the travel.
* Samples are stamped a little wrong, which is a way along the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.config import FilterConfig
from companion.estimation.aircraft import Aircraft, Aligned
from companion.geometry import Mat, Vec, skew
from companion.messages import NS

OWN, TANKER, TRAVEL = slice(0, 3), slice(3, 6), slice(6, 9)
"""Rows of a table of noise: attitude of the receiver and of the tanker, difference of travels."""

BETWEEN = 8.0
"""An acceleration a that comes and goes within T leaves a T^2 / 8: half the largest that two equal velocities hide."""

Gaps = tuple[float, float, float]
"""Variance of the difference of travels by all gaps so far, path axes."""

NO_GAPS: Gaps = (0.0, 0.0, 0.0)

SLOWEST_M_S = 1.0
"""Below this speed there is no path."""


@dataclass(frozen=True, slots=True)
class Ages:
    """How long before the instant in question the newest samples were: not negative, s."""

    position_s: float
    attitude_s: float
    tanker_s: float


def ages_of(aircraft: Aircraft, t_ns: int) -> Ages:
    """Return how far what the aircraft have told is extrapolated at an instant."""
    stamps_ns = (aircraft.position_ns, aircraft.attitude_ns, aircraft.tanker_ns)
    return Ages(*(0.0 if stamp is None else max(0.0, (t_ns - stamp) * NS) for stamp in stamps_ns))


def path_axes(v_ned_m_s: Vec) -> Mat:
    """Return R_ned_path (3, 3): along a velocity, to the right in the horizon, down; ``ned`` when that is none."""
    n, e, d = v_ned_m_s.tolist()
    level, speed = (n * n + e * e) ** 0.5, (n * n + e * e + d * d) ** 0.5
    if level < SLOWEST_M_S:
        return np.eye(3)
    n, e, d, right_n, right_e = n / speed, e / speed, d / speed, -e / level, n / level
    return np.array([
        [n, right_n, -d * right_e], [e, right_e, d * right_n], [d, 0.0, n * right_e - e * right_n],
    ])  # fmt: skip


def turned(R: Mat, variance: Vec) -> Mat:
    """Return the covariance (3, 3) of what has variances (3,) along the columns of R."""
    C: Mat = (R * variance) @ R.T
    return C


class InsNoise:
    """Covariances of what two INS tell, with one configuration."""

    def __init__(self, c: FilterConfig) -> None:
        self._attitude, self._rate, self._hold_s = c.attitude_sigma_rad**2, c.rate_sigma_rad_s**2, c.velocity_hold_s
        self._velocity = np.array([c.speed_sigma_m_s, c.velocity_sigma_m_s, c.velocity_sigma_m_s]) ** 2
        self._stamp_s2 = c.stamp_sigma_s**2
        self._own, self._tanker = np.array(c.own_acceleration_m_s2) ** 2, np.array(c.tanker_acceleration_m_s2) ** 2
        self._own_turn, self._tanker_turn = np.array(c.own_turn_rad_s2) ** 2, np.array(c.tanker_turn_rad_s2) ** 2

    def table(self, a: Aligned, ages: Ages) -> Mat:
        """Return three covariances (9, 3), ``ned``: attitude of receiver and of tanker (left-hand), travels."""
        out = np.empty((9, 3))
        out[OWN] = self._attitude_cov(a.own_attitude.R_ned_body, ages.attitude_s, self._own_turn)
        out[TANKER] = self._attitude_cov(a.tanker_attitude.R_ned_body, ages.tanker_s, self._tanker_turn)
        v = a.tanker.v_ned_m_s
        variance = self._lag(ages.position_s, self._own) + self._lag(ages.tanker_s, self._tanker)
        variance[0] += self._stamp_s2 * float(v @ v)
        out[TRAVEL] = turned(path_axes(v), variance)
        return out

    def _lag(self, age_s: float, acceleration: Vec) -> Vec:
        """Return the variance (3,) of a travel, path axes, beyond that of velocity noise at random."""
        lasting: Vec = 0.25 * age_s**4 * acceleration + age_s * max(0.0, age_s - self._hold_s) * self._velocity
        return lasting

    def _attitude_cov(self, R: Mat, age_s: float, turn: Vec) -> Mat:
        if age_s == 0.0:
            return self._attitude * np.eye(3)
        return turned(R, self._attitude + age_s**2 * self._rate + 0.25 * age_s**4 * turn)

    def gaps(self, a: Aligned) -> Gaps:
        """Return what the difference of travels has taken in by gaps up to an instant."""
        (own2, own4), (tanker2, tanker4) = a.own.gaps, a.tanker.gaps
        if own2 == tanker2 == 0.0:
            return NO_GAPS
        by_noise = 0.5 * (own2 + tanker2) * self._velocity
        along, across, down = (by_noise + (own4 * self._own + tanker4 * self._tanker) / BETWEEN**2).tolist()
        return along, across, down

    def with_travel(self, a: Aligned, age_s: float, since_sight_s: float) -> Mat:
        """Return the covariance (3, 3) of a travel's error with that of the attitude of the same aircraft, ``ned``.

        A velocity that is turned by n errs by n x v, a travel by as much times as long as n lasts: from half a hold
        before the newest sample, on average; what was before the last sight is in the estimate by then. For the tanker;
        a travel of the receiver's counts with the other sign.
        """
        return min(age_s + 0.5 * self._hold_s, since_sight_s) * self._attitude * skew(a.tanker.v_ned_m_s)

    def velocity(self, a: Aligned, ages: Ages) -> Mat:
        """Return the covariance (3, 3) of the difference of the velocities told, ``ned``."""
        late = ages.position_s**2 * self._own + ages.tanker_s**2 * self._tanker
        return turned(path_axes(a.tanker.v_ned_m_s), 2.0 * self._velocity + late)
