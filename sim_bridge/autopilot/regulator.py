"""The thesis' regulator, whole (3.3, eq. 3.10 to 3.13): law ``surfaces``, ten effectors by one static gain.

Equations
---------
Deviations from trim (x0, u0), lengths in the psi frame (``mrf``: ``ned`` turned by the formation's heading)::

    X_AUG = [V, alpha, beta, p, q, r, psi, theta, phi, e_x, e_y, e_z, int e_x, int e_y, int e_z]      (3.10)
    J = integral of Y' Q Y + U' R U,  Y = [e, int e],  Q and R diagonal                               (3.11, 3.12)
    U = -K X_AUG,  cmd = U + u0                                                                       (3.13)

K (10, 15) by ``control.lqr`` on the A and B of the airframe; e is the receptacle (arm ``a`` in body axes) against the
place where it should be::

    e_x' = V + E_x,  e_y' = V0 (psi + beta - phi sin alpha0) + E_y,  e_z' = V0 (alpha - theta) + E_z,  E = R0 (w x a)

The place comes from outside (``OffsetCommand``), some tens of milliseconds old; in between e is carried on by the
receiver's own inertial motion and the velocity of the place. Beyond the thesis: e is cut to ``ERROR_MAX``, and an
integral waits while it would push an effector further past its limit.

Actuators, delays and the throttle's lag are not in the design. With them as states (10 lags, 30 stored commands) the
same effort gives 5 to 10 % more deviation and holds with more extra delay; the fifteen hold with 0.045 s more than the
actuators have.

Cures
-----
Flown as written, the law has three traps; ``Cures`` says what is done about each, and can leave it out for tests.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import control
import numpy as np

from companion.config import AirframeConfig, ConfigError
from companion.geometry import Mat, Vec, rotation_from_euler
from sim_bridge.autopilot.lasting_wind import LastingWind
from sim_bridge.autopilot.setpoints import OffsetCommand
from sim_bridge.plant.actuators import default_channels
from sim_bridge.sensors import InertialSample, Triple
from sim_bridge.truth import EFFECTORS

ERROR_MAX = 2.0
"""e is cut to this many of the amounts that it is weighed by: a step of metres would take the effectors to their limits
and leave nothing for the lateral motion, which is unstable."""
INTEGRAL_MAX_M_S = 20.0
HISTORY_NS = 1_000_000_000
"""How far back the instant of a place may lie, and twice the life of a setpoint."""
RIGHT = [i for i, name in enumerate(EFFECTORS) if name.endswith("_r")]
LEFT = [i for i, name in enumerate(EFFECTORS) if name.endswith("_l")]
ONE_SIDED = [i for i, name in enumerate(EFFECTORS) if name.startswith(("amt", "ssd"))]


@dataclass(frozen=True, slots=True)
class Cures:
    """What is done about the traps of the law as written.

    ``inertial_flow``: V, alpha, beta from velocity over the ground, less the wind that lasts, and attitude. The law
    takes them for the motion of the aircraft, so with an air-data probe it chases the gusts; and without the lasting
    wind an aircraft that crabs would look like one that slips. ``one_sided``: tips and spoilers only open. The trim
    has them a little open, and what one side cannot close the other opens more. ``true_relative_velocity``: the law
    takes V, psi and theta for the velocity relative to the place, which they are only while the place flies straight
    and does not yaw: 0.01 rad of heading look like 2 m/s. So they are replaced by the values that give the true one.
    """

    inertial_flow: bool = True
    one_sided: bool = True
    true_relative_velocity: bool = True


@dataclass(frozen=True, slots=True)
class RegulatorWeights:
    """Q and R of eq. 3.11 as the amounts that cost the same: 1 / amount^2 is the weight.

    ``error_m`` and ``integral_m_s`` per axis x, y, z; effectors by kind, throttle 0..1, surfaces in rad. ``roll_rad``
    is beyond the thesis: Y as in eq. 3.12 leaves a lateral mode of 2.5 rad/s with a damping of 0.2, which gusts swing
    to 35 degrees of bank in severe turbulence; infinity for Y as written. ``fix_s``: time constant with which the
    carried e follows the places that come, so that the noise of single fixes does not reach the surfaces.
    """

    error_m: Triple = (1.0, 0.08, 0.3)
    integral_m_s: Triple = (3.0, 0.4, 0.5)
    throttle: float = 0.15
    amt: float = 0.12
    tef: float = 0.15
    lef: float = 0.1
    pf: float = 0.12
    ssd: float = 0.12
    roll_rad: float = 0.15
    fix_s: float = 0.1

    def state_costs(self) -> Vec:
        """Return the diagonal (15,) of Q over X_AUG; of the airframe's own nine states only phi may have a weight."""
        costs = np.concatenate((np.zeros(9), 1.0 / np.square(self.error_m), 1.0 / np.square(self.integral_m_s)))
        costs[8] = 1.0 / self.roll_rad**2
        return costs

    def effort_costs(self) -> Vec:
        """Return the diagonal (10,) of R."""
        amounts = [getattr(self, name.split("_", maxsplit=1)[0]) for name in EFFECTORS]
        return 1.0 / np.square(amounts)


def augmented(airframe: AirframeConfig) -> tuple[Mat, Mat]:
    """Return A (15, 15) and B (15, 10) over X_AUG (eq. 3.10)."""
    V0, alpha0 = airframe.trim.airspeed_m_s, airframe.trim.alpha_rad
    A, B = np.zeros((15, 15)), np.zeros((15, 10))
    A[:9, :9], B[:9] = airframe.A, airframe.B
    A[9, 0] = 1.0
    A[10, [2, 6, 8]] = V0, V0, -V0 * math.sin(alpha0)
    A[11, [1, 7]] = V0, -V0
    x, y, z = airframe.receptacle_frd_m
    arm = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # omega x a = arm omega
    A[9:12, 3:6] = rotation_from_euler(0.0, alpha0, 0.0) @ arm
    A[12:15, 9:12] = np.eye(3)
    return A, B


def design(airframe: AirframeConfig, weights: RegulatorWeights) -> Mat:
    """Return K (10, 15) of eq. 3.13; raises ConfigError when the airframe cannot be regulated with these weights."""
    A, B = augmented(airframe)
    try:
        K, _, _ = control.lqr(A, B, np.diag(weights.state_costs()), np.diag(weights.effort_costs()))
    except (np.linalg.LinAlgError, ValueError) as error:
        msg = f"airframe {airframe.name}: no regulator over its ten effectors ({error}); see its A and B"
        raise ConfigError(msg) from None
    return np.ascontiguousarray(K)


class CarriedError:
    """e in ``ned`` between the places that come: carried on by what the receptacle and the place fly.

    Plain floats: three of them are quicker than an array, and this runs at every step, whoever flies.
    """

    def __init__(self, arm_frd_m: Triple, dt_s: float, fix_s: float) -> None:
        """Carry the point at ``arm_frd_m`` of the body."""
        self._arm, self._dt_s, self._fix_s = arm_frd_m, dt_s, fix_s
        self._travel: deque[tuple[int, Triple]] = deque()  # instant, where the receptacle is from where the body began
        self._body: Triple = (0.0, 0.0, 0.0)
        self._v: Triple | None = None
        self._command: OffsetCommand | None = None
        self._error: Triple = (0.0, 0.0, 0.0)
        self._here: Triple = (0.0, 0.0, 0.0)

    def reset(self) -> None:
        """Forget the places; the travel is kept, for the next one to be carried on by."""
        self._command = None

    def watch(self, sample: InertialSample, R_ned_frd: Mat) -> None:
        """Take the receiver's motion of one step."""
        v = sample.v_ned_m_s
        if self._v is not None:
            n, e, d = self._v
            x, y, z = self._body
            half = 0.5 * self._dt_s
            self._body = x + half * (n + v[0]), y + half * (e + v[1]), z + half * (d + v[2])
        self._v = v
        x, y, z = self._body
        a, b, c = self._arm
        row0, row1, row2 = R_ned_frd.tolist()
        here = (
            x + row0[0] * a + row0[1] * b + row0[2] * c,
            y + row1[0] * a + row1[1] * b + row1[2] * c,
            z + row2[0] * a + row2[1] * b + row2[2] * c,
        )
        self._travel.append((sample.t_ns, here))
        while self._travel[0][0] < sample.t_ns - HISTORY_NS:
            self._travel.popleft()

    def at(self, command: OffsetCommand) -> Triple:
        """Return e now: that of ``command`` when it is the first, else the carried one, drawn towards it when new."""
        here, was = self._travel[-1][1], self._here
        v = command.v_ned_m_s
        if command is self._command:
            e = self._error
            self._error = (
                e[0] + here[0] - was[0] - v[0] * self._dt_s,
                e[1] + here[1] - was[1] - v[1] * self._dt_s,
                e[2] + here[2] - was[2] - v[2] * self._dt_s,
            )
        else:
            self._error = self._renewed(command, here, was)
            self._command = command
        self._here = here
        return self._error

    def _renewed(self, command: OffsetCommand, here: Triple, was: Triple) -> Triple:
        t_ns = self._travel[-1][0]
        then, age_s = self._receptacle_at(command.t_ns), (t_ns - command.t_ns) * 1e-9
        share = 1.0
        if self._command is not None:
            share -= math.exp(-max(command.t_ns - self._command.t_ns, 0) * 1e-9 / self._fix_s)
        out = []
        for k in range(3):
            v = command.v_ned_m_s[k]
            told = here[k] - then[k] - command.offset_ned_m[k] - v * age_s
            carried = self._error[k] + here[k] - was[k] - v * self._dt_s
            out.append(carried + share * (told - carried))
        return out[0], out[1], out[2]

    def _receptacle_at(self, t_ns: int) -> Triple:
        """Return where the receptacle was at ``t_ns``; the oldest or newest that is known beyond them."""
        back = min((self._travel[-1][0] - t_ns) * 1e-9 / self._dt_s, len(self._travel) - 1.0)
        if back <= 0.0:
            return self._travel[-1][1]
        whole = int(back)
        after, share = self._travel[-1 - whole][1], back - whole
        if share == 0.0:
            return after
        x, y, z = (q + share * (p - q) for p, q in zip(self._travel[-2 - whole][1], after, strict=True))
        return x, y, z


class SurfaceRegulator:
    """Law ``surfaces``: an ``OffsetCommand`` in, ten effector commands out, every ``dt_s``."""

    def __init__(
        self,
        airframe: AirframeConfig,
        dt_s: float = 0.005,
        weights: RegulatorWeights | None = None,
        cures: Cures | None = None,
    ) -> None:
        """Design the gain; raises ConfigError when there is none."""
        self.cures = cures or Cures()
        self._weights = weights or RegulatorWeights()
        self.K = design(airframe, self._weights)
        channels = default_channels()
        self._low, self._high = np.array([c.low for c in channels]), np.array([c.high for c in channels])
        self._u0 = np.array(airframe.trim.effectors)
        if not self.cures.one_sided:
            self._u0[ONE_SIDED] = 0.0
        self._V0, self._alpha0 = airframe.trim.airspeed_m_s, airframe.trim.alpha_rad
        self._sin_alpha0 = math.sin(self._alpha0)
        self._dt_s = dt_s
        self._R_ned_frd = np.eye(3)
        self._reach_m = ERROR_MAX * np.array(self._weights.error_m)
        self._carried = CarriedError(airframe.receptacle_frd_m, dt_s, self._weights.fix_s)
        self._wind = LastingWind(airframe, dt_s)
        self.reset()

    def reset(self) -> None:
        """Forget integrals and places: somebody else flew in between."""
        self.integral_m_s = np.zeros(3)
        self._carried.reset()

    def watch(self, sample: InertialSample, R_ned_frd: Mat) -> None:
        """Take the motion of one step, whoever flies."""
        self._R_ned_frd = R_ned_frd
        self._carried.watch(sample, R_ned_frd)
        self._wind.watch(sample, R_ned_frd)

    def step(self, command: OffsetCommand, sample: InertialSample) -> Vec:
        """Return commands (10,) in the order of eq. 3.3, after ``watch`` of the same sample."""
        cos, sin = math.cos(command.heading_rad), math.sin(command.heading_rad)
        x, y, z = self._carried.at(command)
        e = np.array([cos * x + sin * y, cos * y - sin * x, z])
        near = np.clip(e, -self._reach_m, self._reach_m)
        x9 = self._deviations(command, sample, cos, sin)
        wanted = self._u0 - self.K @ np.array((*x9, *near.tolist(), *self.integral_m_s.tolist()))
        if self.cures.one_sided:
            keep_differences(wanted, self._low, self._high)
        out: Vec = np.clip(wanted, self._low, self._high)
        grows = (out - wanted) @ self.K[:, 12:] * near > 0.0  # would push further what is cut off already
        step = np.where(grows | (near != e), 0.0, self._dt_s * near)
        self.integral_m_s = np.clip(self.integral_m_s + step, -INTEGRAL_MAX_M_S, INTEGRAL_MAX_M_S)
        return out

    def _deviations(self, command: OffsetCommand, sample: InertialSample, cos: float, sin: float) -> tuple[float, ...]:
        """Return the first nine of X_AUG; see ``Cures``."""
        yaw, pitch, roll = sample.euler_rad
        V, alpha, beta = sample.speed_m_s, sample.alpha_rad, sample.beta_rad
        if self.cures.inertial_flow:
            V, alpha, beta = self._wind.flow(sample, self._R_ned_frd)
        dV, psi, theta = V - self._V0, math.remainder(yaw - command.heading_rad, 2.0 * math.pi), pitch - self._alpha0
        if self.cures.true_relative_velocity:
            n, e, d = (own - place for own, place in zip(sample.v_ned_m_s, command.v_ned_m_s, strict=True))
            dV = cos * n + sin * e
            psi = (cos * e - sin * n) / self._V0 - beta + roll * self._sin_alpha0
            theta = alpha - self._alpha0 - d / self._V0
        return (dV, alpha - self._alpha0, beta, *sample.omega_rad_s, psi, theta, roll)


def keep_differences(wanted: Vec, low: Vec, high: Vec) -> None:
    """Move the means of right and left so that their differences, which are roll and yaw, fit into the limits.

    Of a pair that only opens, both open by as much as one of them should close. What is lost is drag, lift or pitch,
    which the airframe can be without for a while; roll and yaw it cannot, they are unstable (3.8).
    """
    reach = 0.5 * (high - low)[RIGHT]
    half = np.clip(0.5 * (wanted[RIGHT] - wanted[LEFT]), -reach, reach)
    mean = np.clip(0.5 * (wanted[RIGHT] + wanted[LEFT]), low[RIGHT] + np.abs(half), high[RIGHT] - np.abs(half))
    wanted[RIGHT] = mean + half
    wanted[LEFT] = mean - half
