"""Inner loops of the receiver's autopilot: roll, pitch and thrust commands in, ten effector commands out.

Rules
-----
* Flow angles are inertial: alpha and beta come from velocity over the ground and attitude, never from the air. Loops
  closed on air-data angles chase the gusts and diverge in light turbulence.
* Gains are LQR (``control.lqr``) on the trimmed linear model of the airframe file, with angular accelerations as inputs
  and the lag of actuators, delay and sampling as states. The law knows those states by running the same lag itself.
* Commands go through a second-order reference for roll and for pitch, flown by feed-forward; feedback acts on what differs
  from it. So what guidance sees is the reference, and integral action does not make a step overshoot.
* Wanted accelerations are spread over the effectors by weighted least squares; what saturates is held at its limit and
  the rest is spread again, so that effectors that deflect one way only (AMT, SSD) are used as far as they go.
* Direct lift: flaps that give lift without moment make the vertical velocity follow that of the same aircraft in calm air,
  so that gusts move it less. It fades out slowly and leaves the path to the pitch command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np

from companion.config import AirframeConfig
from companion.geometry import Mat, Vec
from sim_bridge.autopilot.inner_kernels import LAW_STATES, inner_step
from sim_bridge.plant.actuators import default_channels

LAG_S = 0.035
"""Of the design model: 20 ms servo lag, 10 ms delay, half a 5 ms sample and one integration step."""
EFFORT = (0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.5, 0.1, 0.1)
"""Deflection (rad) of the nine surfaces that costs the same: tips, trailing edges, leading edges (unused), pitch flap,
spoilers."""


@dataclass(frozen=True, slots=True)
class InnerGains:
    """References of roll and pitch (rad/s, damping), feedback of roll, pitch and sideslip (rad/s), integral action, direct lift.
    """

    roll_model_rad_s: float = 8.0
    pitch_model_rad_s: float = 6.0
    model_damping: float = 0.85
    roll_rad_s: float = 10.0
    pitch_rad_s: float = 7.5
    sideslip_rad_s: float = 2.0
    integral_per_s: float = 0.5
    lift_per_s: float = 4.0
    lift_fade_s: float = 5.0
    lift_max_m_s2: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """What the autopilot's sensors say: attitude (3, 3), body rates (3,), inertial velocity (3,)."""

    t_ns: int
    R_ned_frd: Mat
    omega_frd_rad_s: Vec
    v_ned_m_s: Vec


class InnerLoops:
    """Attitude and thrust controller of one airframe; call it every ``dt_s``."""

    def __init__(self, airframe: AirframeConfig, dt_s: float = 0.005, gains: InnerGains | None = None) -> None:
        """Design the gains; the state starts at rest in trim."""
        g = gains or InnerGains()
        A, B = np.array(airframe.A), np.array(airframe.B)
        trim = airframe.trim
        channels = default_channels()
        self._trim = np.array(trim.effectors)
        self._surfaces = np.ascontiguousarray(B[3:6, 1:])
        self._squares = np.array(EFFORT) ** 2
        self._low = np.array([c.low for c in channels[1:]]) - self._trim[1:]
        self._high = np.array([c.high for c in channels[1:]]) - self._trim[1:]
        self._lift = lift_without_moment(B, trim.airspeed_m_s, self._squares)
        pitch_lift = B[1, 1:] @ spread(self._surfaces, self._squares) @ np.array([0.0, 1.0, 0.0])
        self._K_pitch = pitch_gains(A, float(pitch_lift), g)
        self._K_lateral = lateral_gains(A, g)
        self._model = (
            g.roll_model_rad_s, g.model_damping, g.pitch_model_rad_s, g.model_damping,
            float(A[3, 3]), float(A[4, 1]), float(A[4, 4]), -float(A[1, 1]),
        )  # fmt: skip
        lag_share = 1.0 - math.exp(-dt_s / LAG_S)
        self._fixed = (dt_s, trim.alpha_rad, lag_share, g.lift_per_s, 1.0 / g.lift_fade_s, g.lift_max_m_s2)
        self._speed, self._dt_s, self._throttle = trim.airspeed_m_s, dt_s, trim.throttle
        self._alpha = trim.alpha_rad
        self.reset()

    def reset(self) -> None:
        """Forget everything: integrals, lags and the calm-air reference."""
        self._law = np.zeros(LAW_STATES)
        self._held_m = 0.0

    def step(self, roll_cmd_rad: float, pitch_cmd_rad: float, thrust_cmd: float, sensed: Sensed) -> Vec:
        """Return commands (10,) in the order of ``sim_bridge.truth.EFFECTORS``: throttle 0..1, surfaces in rad."""
        out = np.empty(10)
        inner_step(
            roll_cmd_rad, pitch_cmd_rad, sensed.R_ned_frd, sensed.omega_frd_rad_s, sensed.v_ned_m_s, self._law,
            self._K_pitch, self._K_lateral, self._model, self._surfaces, self._squares, self._low, self._high, self._lift, self._trim,
            self._fixed, out,
        )  # fmt: skip
        out[0] = min(max(thrust_cmd, 0.0), 1.0)
        return out

    def hold_step(self, sensed: Sensed) -> Vec:
        """Return commands that level the wings, stop climb or descent and hold the trim speed: the fallback."""
        v_n, v_e, v_d = sensed.v_ned_m_s.tolist()
        self._held_m = min(max(self._held_m + v_d * self._dt_s, -30.0), 30.0)
        pitch = self._alpha + min(max(0.004 * v_d + 0.001 * self._held_m, -0.1), 0.1)
        slow = self._speed - math.sqrt(v_n * v_n + v_e * v_e + v_d * v_d)
        return self.step(0.0, pitch, self._throttle + 0.1 * slow, sensed)


def spread(surfaces: Mat, squares: Vec) -> Mat:
    """Return the (9, 3) weighted pseudo-inverse of ``surfaces`` (3, 9), deflections costing 1 / ``squares`` (9,)."""
    weighted = squares[:, None] * surfaces.T
    return weighted @ np.linalg.inv(surfaces @ weighted)


def lift_without_moment(B: Mat, speed_m_s: float, squares: Vec) -> Vec:
    """Return deflections (9,) for 1 m/s2 of upward acceleration with no angular acceleration."""
    rows = np.vstack((B[3:6, 1:], -speed_m_s * B[1, 1:]))
    flaps = squares.copy()
    flaps[[0, 1, 7, 8]] = 0.0
    weighted = flaps[:, None] * rows.T
    return weighted @ np.linalg.pinv(rows @ weighted) @ np.array([0.0, 0.0, 0.0, 1.0])


def pitch_gains(A: Mat, lift_per_pitch: float, g: InnerGains) -> Vec:
    """Return K (5,) over alpha, q, theta error, its integral, lagged pitch acceleration; input: q' command."""
    F = np.zeros((5, 5))
    F[0, 0], F[0, 1], F[0, 4] = A[1, 1], A[1, 4], lift_per_pitch
    F[1, 0], F[1, 1], F[1, 4] = A[4, 1], A[4, 4], 1.0
    F[2, 1] = F[3, 2] = 1.0
    F[4, 4] = -1.0 / LAG_S
    G = np.array([[0.0], [0.0], [0.0], [0.0], [1.0 / LAG_S]])
    w4 = g.pitch_rad_s**4
    K, _, _ = control.lqr(F, G, np.diag([0.0, 0.0, w4, w4 * g.integral_per_s**2, 0.0]), np.eye(1))
    return np.ascontiguousarray(np.asarray(K)[0])


def lateral_gains(A: Mat, g: InnerGains) -> Mat:
    """Return K (2, 7) over beta, p, r, phi error, its integral, lagged p' and r'; inputs: p' and r' commands."""
    F = np.zeros((7, 7))
    order = [2, 3, 5, 8]
    F[:4, :4] = A[np.ix_(order, order)]
    F[4, 3] = F[1, 5] = F[2, 6] = 1.0
    F[5, 5] = F[6, 6] = -1.0 / LAG_S
    G = np.zeros((7, 2))
    G[5, 0] = G[6, 1] = 1.0 / LAG_S
    w4 = g.roll_rad_s**4
    Q = np.diag([g.sideslip_rad_s**4, 0.0, 0.0, w4, w4 * g.integral_per_s**2, 0.0, 0.0])
    K, _, _ = control.lqr(F, G, Q, np.eye(2))
    return np.ascontiguousarray(np.asarray(K))
