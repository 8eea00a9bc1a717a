"""The docking law ``attitude``: a linear quadratic regulator with integral states over roll, pitch, thrust setpoints.

The thesis' regulator (3.3, eq. 3.10 to 3.13) drives ten effectors. Over a link the unstable airframe needs its inner
loops in the autopilot, so this law keeps the thesis' error, integral states, trim and psi frame and commands what an
autopilot obeys. The design model, per axis pair, in deviations from trim:

Longitudinal, x = [e_x, e_z, v_x, v_z, theta, q, T, int e_x, int e_z], u = [theta_cmd, T_cmd]::

    e' = v,  alpha = theta + v_z / V0   (no steady climb: gamma = -v_z / V0)
    v_x' = X_V v_x + X_a alpha + X_th theta + X_q q + X_T T
    v_z' = V0 (Z_V v_x + Z_a alpha + Z_th theta + (Z_q - 1) q + Z_T T)
    theta' = q,  q' = w^2 (theta_cmd - theta) - 2 zeta w q,  T' = (T_cmd - T) / tau

with X, Z the rows of V and alpha of the airframe's A and B (``sim-bridge linearize``).
Lateral, x = [e_y, v_y, phi, p, int e_y], u = [phi_cmd]: ``v_y' = g phi``, phi of second order as theta.

Both are sampled at the guidance rate, the autopilot's delay enters as whole samples of stored commands, and
``control.dlqr`` gives the static gain. e_x, e_y, e_z are BR minus the cubic reference in ``mrf``; what the regulator
has commanded is remembered cut to the envelope, so a saturated command does not wind up the model.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import control
import numpy as np
from scipy.linalg import expm

from companion.config import AirframeConfig, ConfigError, GuidanceConfig
from companion.geometry import GRAVITY_M_S2, Mat, Vec, euler_from_rotation, rotation_from_euler
from companion.guidance.disturbance import Disturbance
from companion.guidance.feed_forward import FeedForward, place
from companion.guidance.path import Reference
from companion.messages import AttitudeSetpoint, RelativeState

V, ALPHA, Q, THETA = 0, 1, 4, 7  # rows of the airframe's A and B
THROTTLE = 0
FAR_M = 4.0
"""An error counts no more than this: from afar it comes with the speed that this is worth, and does not swing past."""


@dataclass(frozen=True, slots=True, eq=False)
class Regulator:
    """Static gain ``u = -K [x, last commands oldest first]`` at a fixed rate; ``closed_poles`` for the record."""

    K: Mat
    delay_steps: int
    inputs: int
    closed_poles: Vec


def sampled(A: Mat, B: Mat, dt_s: float) -> tuple[Mat, Mat]:
    """Return the zero-order-hold discretisation of x' = A x + B u."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    e = expm(block * dt_s)
    return e[:n, :n], e[:n, n:]


def with_delay(A: Mat, B: Mat, steps: int) -> tuple[Mat, Mat]:
    """Return the sampled system whose input acts ``steps`` samples later; the stored commands are states."""
    n, m = B.shape
    size = n + m * steps
    Ad, Bd = np.zeros((size, size)), np.zeros((size, m))
    Ad[:n, :n] = A
    if steps == 0:
        return A, B
    Ad[:n, n : n + m] = B
    Ad[n : size - m, n + m :] = np.eye(m * (steps - 1))
    Bd[size - m :] = np.eye(m)
    return Ad, Bd


def regulator(A: Mat, B: Mat, state_weights: Vec, input_weights: Vec, dt_s: float, delay_s: float) -> Regulator:
    """Design the sampled LQR for x' = A x + B u with an input delay (eq. 3.11 with Y = the weighted states)."""
    steps = round(delay_s / dt_s)
    Ad, Bd = with_delay(*sampled(A, B, dt_s), steps)
    Q = np.zeros_like(Ad)
    n = len(state_weights)
    Q[:n, :n] = np.diag(state_weights)
    try:
        K, _, poles = control.dlqr(Ad, Bd, Q, np.diag(input_weights))
    except np.linalg.LinAlgError as error:
        msg = f"guidance.weights: no docking law for this airframe with them ({error}); see its A, B and response"
        raise ConfigError(msg) from None
    return Regulator(np.asarray(K), steps, B.shape[1], np.asarray(poles))


def longitudinal_model(airframe: AirframeConfig) -> tuple[Mat, Mat]:
    """Return A (9, 9), B (9, 2) over [e_x, e_z, v_x, v_z, theta, q, T, int e_x, int e_z]; see the head of the file."""
    a, b = np.array(airframe.A), np.array(airframe.B)
    r, V0 = airframe.response, airframe.trim.airspeed_m_s
    A, B = np.zeros((9, 9)), np.zeros((9, 2))
    rx, _, rz = airframe.receptacle_frd_m
    A[0, 2] = A[1, 3] = A[7, 0] = A[8, 1] = 1.0
    A[0, 5], A[1, 5] = rz, -rx
    A[2, 2:7] = [a[V, V], a[V, ALPHA] / V0, a[V, ALPHA] + a[V, THETA], a[V, Q], b[V, THROTTLE]]
    A[3, 2:7] = [V0 * a[ALPHA, V], a[ALPHA, ALPHA], V0 * (a[ALPHA, ALPHA] + a[ALPHA, THETA]),
                 V0 * (a[ALPHA, Q] - 1.0), V0 * b[ALPHA, THROTTLE]]
    A[4, 5] = 1.0
    A[5, 4:6] = [-(r.pitch_rad_s**2), -2.0 * r.pitch_damping * r.pitch_rad_s]
    B[5, 0] = r.pitch_rad_s**2
    A[3] += r.pitch_sink_m * A[5]
    B[3] += r.pitch_sink_m * B[5]
    A[6, 6] = -1.0 / r.thrust_lag_s
    B[6, 1] = 1.0 / r.thrust_lag_s
    return A, B


def lateral_model(airframe: AirframeConfig) -> tuple[Mat, Mat]:
    """Return A (5, 5), B (5, 1) over [e_y, v_y, phi, p, int e_y]."""
    r, (_, _, rz) = airframe.response, airframe.receptacle_frd_m
    A, B = np.zeros((5, 5)), np.zeros((5, 1))
    A[0, 1] = A[4, 0] = 1.0
    A[0, 3] = -rz
    A[1, 2] = GRAVITY_M_S2
    A[2, 3] = 1.0
    A[3, 2:4] = [-(r.roll_rad_s**2), -2.0 * r.roll_damping * r.roll_rad_s]
    B[3, 0] = r.roll_rad_s**2
    return A, B


class _Channel:
    """One regulator with the memory of its own commands."""

    def __init__(self, regulator: Regulator, low: Vec, high: Vec) -> None:
        self._r = regulator
        self._low, self._high = low, high
        self._sent = np.zeros(regulator.delay_steps * regulator.inputs)

    def step(self, x: Vec, ahead: Vec) -> tuple[Vec, Vec]:
        """Return the command (from trim) inside its limits, and what was cut off.

        ``ahead`` is fed forward; the delayed commands that the regulator remembers are what feedback adds to it.
        """
        u = ahead - self._r.K @ np.concatenate([x, self._sent])
        command = np.clip(u, self._low, self._high)
        self._sent = np.concatenate([self._sent, command - ahead])[self._r.inputs :]
        return command, u - command

    def pushes(self, column: int, row: int, cut: Vec, error: float) -> bool:
        """Tell whether an error, integrated in state ``column``, would drive input ``row`` further into its limit."""
        return bool(-self._r.K[row, column] * error * cut[row] > 0.0)


class DockingLaw:
    """Law ``attitude``. ``step`` once per guidance period; ``reset`` when guidance starts afresh."""

    def __init__(self, airframe: AirframeConfig, config: GuidanceConfig) -> None:
        self._airframe, self._config = airframe, config
        self._dt = 1.0 / config.rate_hz
        w = config.weights
        lon_Q = np.array([w.e_x, w.e_z, w.v_x, w.v_z, 0.0, w.q, 0.0, w.int_x, w.int_z])
        lat_Q = np.array([w.e_y, w.v_y, 0.0, w.p, w.int_y])
        delay_s = airframe.response.delay_s + config.link_delay_s
        self._lon = regulator(*longitudinal_model(airframe), lon_Q, np.array([w.pitch, w.thrust]), self._dt, delay_s)
        self._lat = regulator(*lateral_model(airframe), lat_Q, np.array([w.roll]), self._dt, delay_s)
        r = airframe.response
        self._lead_s = r.delay_s + config.link_delay_s + np.array(
            [2.0 * r.roll_damping / r.roll_rad_s, 2.0 * r.pitch_damping / r.pitch_rad_s, r.thrust_lag_s]
        )
        self._ahead = FeedForward(airframe, self._dt)
        self._disturbance = Disturbance(airframe, config.disturbance_rad_s, self._dt)
        self.reset()

    def reset(self) -> None:
        """Forget integrals and commands."""
        c, trim = self._config, self._airframe.trim
        pitch, roll = c.max_pitch_offset_rad, c.max_roll_rad
        low, high = np.array([-pitch, -trim.throttle]), np.array([pitch, 1.0 - trim.throttle])
        self._lon_channel = _Channel(self._lon, low, high)
        self._lat_channel = _Channel(self._lat, np.array([-roll]), np.array([roll]))
        self._ahead.reset()
        self._disturbance.reset()
        self.integral_m_s = np.zeros(3)
        self._thrusts = deque([0.0] * self._lon.delay_steps)
        self._thrust = 0.0  # the lagged thrust, from our own commands: the autopilot does not report it

    def step(self, state: RelativeState, reference: Reference) -> AttitudeSetpoint:
        """Return the setpoint for a relative state and where BR should be."""
        e = np.clip(state.p_mrf_br_m - reference.p_m, -FAR_M, FAR_M)
        v = state.v_mrf_br_m_s - reference.v_m_s
        yaw, pitch, roll = euler_from_rotation(state.R_ned_frd)
        p, q, _ = state.omega_frd_rad_s.tolist()
        at, R_ned_mrf = place(state, reference), rotation_from_euler(state.heading0_rad, 0.0, 0.0)
        d = self._disturbance.step(at.v_ned_m_s + R_ned_mrf @ v, (yaw, pitch, roll), q, self._thrust)
        v = R_ned_mrf.T @ (self._disturbance.v_ned_m_s - at.v_ned_m_s)
        climb = -float(at.v_ned_m_s[2]) / self._airframe.trim.airspeed_m_s
        ref, rate = self._ahead.step(R_ned_mrf.T @ (at.a_ned_m_s2 - d), climb)
        trim, i = self._airframe.trim, self.integral_m_s
        pitch_off, q_off = pitch - trim.alpha_rad - ref[1], q - self._turn_q(state, roll) - rate[1]
        lon = np.array([e[0], e[2], v[0], v[2], pitch_off, q_off, self._thrust - ref[2], i[0], i[2]])
        lat = np.array([e[1], v[1], roll - ref[0], p - rate[0], i[1]])
        lead = ref + self._lead_s * rate
        (d_pitch, d_thrust), lon_cut = self._lon_channel.step(lon, lead[1:])
        (roll_cmd,), lat_cut = self._lat_channel.step(lat, lead[:1])
        held = np.array([
            self._lon_channel.pushes(7, 1, lon_cut, e[0]),
            self._lat_channel.pushes(4, 0, lat_cut, e[1]),
            self._lon_channel.pushes(8, 0, lon_cut, e[2]),
        ])
        self.integral_m_s = self.integral_m_s + np.where(held | (np.abs(e) == FAR_M), 0.0, e * self._dt)
        self._follow(float(d_thrust))
        return AttitudeSetpoint(
            state.t_ns, float(roll_cmd), trim.alpha_rad + float(d_pitch), yaw, trim.throttle + float(d_thrust)
        )

    @staticmethod
    def _turn_q(state: RelativeState, roll_rad: float) -> float:
        """Return the pitch rate of the formation's steady turn."""
        return state.turn_rate_rad_s * math.sin(roll_rad)

    def _follow(self, thrust: float) -> None:
        """Let the thrust that is there follow what was commanded before the delay."""
        self._thrusts.append(thrust)
        follow = 1.0 - math.exp(-self._dt / self._airframe.response.thrust_lag_s)
        self._thrust += (self._thrusts.popleft() - self._thrust) * follow
