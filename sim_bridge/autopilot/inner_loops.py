"""Inner loops of the receiver's autopilot: roll, pitch and thrust commands in, ten effector commands out.

Rules
-----
* Flow angles are inertial: alpha and beta come from velocity over the ground and attitude, never from the air. Loops
  closed on air-data angles chase the gusts and diverge in light turbulence.
* Commands go through a second-order reference for roll and for pitch, flown by feed-forward; feedback acts on what
  differs from it. So what guidance sees is the reference, and integral action does not make a step overshoot.
* Feedback is LQR (``control.lqr``) on the trimmed linear model of the airframe file, with angular accelerations as
  inputs and the lag of actuators, delay and sampling as states, which the law knows by running the same lag itself.
* Wanted accelerations are spread over the effectors by weighted least squares within their limits, so that those that
  deflect one way only (AMT, SSD) are used as far as they go. Commands never ask for more than the actuators' rate:
  beyond it lag grows with the size of a command and the loops diverge.
* Direct lift: flaps that give lift without moment hold the vertical velocity near that of the same aircraft in calm
  air, so that gusts move it less. It fades out slowly and leaves the path to the pitch command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np

from companion.config import AirframeConfig
from companion.geometry import Mat, Vec
from sim_bridge.autopilot.inner_kernels import LAW_STATES, Constants, inner_step
from sim_bridge.plant.actuators import default_channels
from sim_bridge.truth import BodyState

LAG_S = 0.035
"""Of the design model: 20 ms servo lag, 10 ms delay, half a 5 ms sample and one integration step."""
AIRSPEED_S = 1.0
"""Gusts are averaged out of the airspeed that the fallback holds."""
EFFORT = (0.3, 0.3, 0.5, 0.5, 0.0, 0.0, 0.5, 0.2, 0.2)
"""Deflection (rad) of the nine surfaces that costs the same: tips, trailing edges, leading edges (slow: not used),
pitch flap, spoilers."""


@dataclass(frozen=True, slots=True)
class InnerGains:
    """References of roll and pitch (rad/s, damping); feedback of roll, pitch, sideslip (rad/s); direct lift."""

    roll_model_rad_s: float = 8.0
    pitch_model_rad_s: float = 6.0
    model_damping: float = 0.85
    roll_rad_s: float = 9.0
    pitch_rad_s: float = 7.0
    sideslip_rad_s: float = 2.0
    integral_per_s: float = 0.5
    lift_per_s: float = 0.8
    lift_fade_s: float = 6.0
    lift_max_m_s2: float = 2.0
    gust_rad_s: float = 8.0
    gust_gain: float = 0.5
    wind_s: float = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """What the autopilot's sensors say: attitude (3, 3), body rates (3,), inertial velocity (3,), specific force (3,)
    in body axes, true airspeed.
    """

    t_ns: int
    R_ned_frd: Mat
    omega_frd_rad_s: Vec
    v_ned_m_s: Vec
    specific_force_m_s2: Vec
    airspeed_m_s: float


def perfect(state: BodyState) -> Sensed:
    """Return what sensors without errors say of an aircraft."""
    air = state.v_air_body_m_s
    return Sensed(
        state.t_ns, state.R_ned_body, state.omega_body_rad_s, state.v_ned_m_s, state.specific_force_body_m_s2,
        float(np.sqrt(air @ air)),
    )


class InnerLoops:
    """Attitude and thrust controller of one airframe; call one of its steps every ``dt_s``."""

    def __init__(self, airframe: AirframeConfig, dt_s: float = 0.005, gains: InnerGains | None = None) -> None:
        """Design the gains; the first step starts from the attitude that it is given."""
        trim = airframe.trim
        self._trim = np.array(trim.effectors)
        self._constants = design(airframe, dt_s, gains or InnerGains())
        self._dt_s, self._speed_m_s = dt_s, trim.airspeed_m_s
        self._alpha_rad, self._throttle = trim.alpha_rad, trim.throttle
        self.reset()

    def reset(self) -> None:
        """Forget everything: integrals, lags, references, the calm-air path."""
        self._law = np.zeros(LAW_STATES)
        self._sunk_m = 0.0
        self._airspeed_m_s: float | None = None

    def step(
        self, roll_cmd_rad: float, pitch_cmd_rad: float, thrust_cmd: float, sensed: Sensed, lift_cmd_m_s2: float = 0.0
    ) -> Vec:
        """Return commands (10,) in the order of ``sim_bridge.truth.EFFECTORS``: throttle 0..1, surfaces in rad.

        ``lift_cmd_m_s2``: upward acceleration that the flaps shall give beside what the attitude gives.
        """
        surfaces = np.empty(9)
        inner_step(
            roll_cmd_rad, pitch_cmd_rad, lift_cmd_m_s2, sensed.R_ned_frd, sensed.omega_frd_rad_s, sensed.v_ned_m_s,
            sensed.specific_force_m_s2, self._law, self._constants, surfaces,
        )  # fmt: skip
        out = self._trim.copy()
        out[1:] += surfaces
        out[0] = min(max(thrust_cmd, 0.0), 1.0)
        return out

    def hold_step(self, sensed: Sensed) -> Vec:
        """Return commands that level the wings, stop climb or descent and hold the trim speed: the fallback."""
        v_d = float(sensed.v_ned_m_s[2])
        self._sunk_m = min(max(self._sunk_m + v_d * self._dt_s, -30.0), 30.0)
        pitch = self._alpha_rad + min(max(0.004 * v_d + 0.0015 * self._sunk_m, -0.1), 0.1)
        if self._airspeed_m_s is None:
            self._airspeed_m_s = sensed.airspeed_m_s
        self._airspeed_m_s += self._dt_s / AIRSPEED_S * (sensed.airspeed_m_s - self._airspeed_m_s)
        slow_m_s = self._speed_m_s - self._airspeed_m_s
        return self.step(0.0, pitch, self._throttle + 0.1 * slow_m_s, sensed)


def design(airframe: AirframeConfig, dt_s: float, g: InnerGains) -> Constants:
    """Return everything that the compiled step needs, from the linear model at trim."""
    A, B = np.array(airframe.A), np.array(airframe.B)
    channels = default_channels()[1:]
    trim = np.array(airframe.trim.effectors[1:])
    squares = np.array(EFFORT) ** 2
    moments = np.ascontiguousarray(B[3:6, 1:])
    return Constants(
        dt_s=dt_s,
        alpha0=airframe.trim.alpha_rad,
        lag_share=1.0 - math.exp(-dt_s / LAG_S),
        K_pitch=pitch_gains(A, pitch_sink_m(airframe) / airframe.trim.airspeed_m_s, g),
        K_lateral=lateral_gains(A, g),
        reference=(g.roll_model_rad_s, g.model_damping, g.pitch_model_rad_s, g.model_damping),
        L_p=float(A[3, 3]),
        M_alpha=float(A[4, 1]),
        M_q=float(A[4, 4]),
        Z_alpha=-float(A[1, 1]),
        moments=moments,
        squares=squares,
        low=np.array([c.low for c in channels]) - trim,
        high=np.array([c.high for c in channels]) - trim,
        slew=np.array([c.rate_per_s * dt_s for c in channels]),
        lift=lift_without_moment(B, airframe.trim.airspeed_m_s, squares),
        lift_gain=g.lift_per_s,
        lift_fade=1.0 / g.lift_fade_s,
        lift_max=g.lift_max_m_s2,
        gust_share=1.0 - math.exp(-dt_s * g.gust_rad_s),
        gust_gain=g.gust_gain,
        side_m_s2=float(A[2, 2]) * airframe.trim.airspeed_m_s,
        side_share=1.0 - math.exp(-dt_s / g.wind_s),
    )


def pitch_sink_m(airframe: AirframeConfig) -> float:
    """Return the downward acceleration (m/s2) of the flaps that give a pitch acceleration of 1 rad/s2."""
    B = np.array(airframe.B)
    nose_up = spread(B[3:6, 1:], np.array(EFFORT) ** 2) @ np.array([0.0, 1.0, 0.0])
    return float(airframe.trim.airspeed_m_s * B[1, 1:] @ nose_up)


def spread(moments: Mat, squares: Vec) -> Mat:
    """Return the (9, 3) weighted pseudo-inverse of ``moments`` (3, 9), deflections costing 1 / ``squares`` (9,)."""
    weighted = squares[:, None] * moments.T
    return weighted @ np.linalg.inv(moments @ weighted)


def lift_without_moment(B: Mat, speed_m_s: float, squares: Vec) -> Vec:
    """Return deflections (9,) of the flaps for 1 m/s2 of upward acceleration with no angular acceleration."""
    rows = np.vstack((B[3:6, 1:], -speed_m_s * B[1, 1:]))
    flaps = squares.copy()
    flaps[[0, 1, 7, 8]] = 0.0  # neither tips nor spoilers
    weighted = flaps[:, None] * rows.T
    return weighted @ np.linalg.pinv(rows @ weighted) @ np.array([0.0, 0.0, 0.0, 1.0])


def pitch_gains(A: Mat, lift_per_pitch: float, g: InnerGains) -> Vec:
    """Return K (5,) over alpha, q, theta error, its integral, lagged pitch acceleration; input: q' command."""
    F = np.zeros((5, 5))
    F[0, 0], F[0, 1], F[0, 4] = A[1, 1], A[1, 4], lift_per_pitch
    F[1, 0], F[1, 1], F[1, 4] = A[4, 1], A[4, 4], 1.0
    F[2, 1] = F[3, 2] = 1.0
    F[4, 4] = -1.0 / LAG_S
    inputs = np.array([[0.0], [0.0], [0.0], [0.0], [1.0 / LAG_S]])
    w4 = g.pitch_rad_s**4
    K, _, _ = control.lqr(F, inputs, np.diag([0.0, 0.0, w4, w4 * g.integral_per_s**2, 0.0]), np.eye(1))
    return np.ascontiguousarray(np.asarray(K)[0])


def lateral_gains(A: Mat, g: InnerGains) -> Mat:
    """Return K (2, 7) over beta, p, r, phi error, its integral, lagged p' and r'; inputs: p' and r' commands."""
    F = np.zeros((7, 7))
    order = [2, 3, 5, 8]
    F[:4, :4] = A[np.ix_(order, order)]
    F[4, 3] = F[1, 5] = F[2, 6] = 1.0
    F[5, 5] = F[6, 6] = -1.0 / LAG_S
    inputs = np.zeros((7, 2))
    inputs[5, 0] = inputs[6, 1] = 1.0 / LAG_S
    w4 = g.roll_rad_s**4
    Q = np.diag([g.sideslip_rad_s**4, 0.0, 0.0, w4, w4 * g.integral_per_s**2, 0.0, 0.0])
    K, _, _ = control.lqr(F, inputs, Q, np.eye(2))
    return np.ascontiguousarray(np.asarray(K))
