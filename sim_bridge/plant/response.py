"""The receiver alone in calm air, and how its closed attitude loops follow a step: what guidance designs its law on."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from companion.config import AirframeConfig, AttitudeResponse
from companion.geometry import Mat, Vec
from sim_bridge.autopilot.inner_loops import InnerLoops, perfect, pitch_sink_m
from sim_bridge.plant.actuators import THROTTLE, Actuators
from sim_bridge.plant.fdm import Fdm, InitialCondition
from sim_bridge.plant.world import ALTITUDE_M, CALM_WAKE, UAV_INPUTS

DT_S = 0.005
STEP_RAD = {"roll": 0.01, "pitch": 0.004}
"""Small, so that no limit of the references is met: what the loops do round the commands of a docking."""
LENGTH_S = 1.5


def step_response(airframe: AirframeConfig, axis: str, size_rad: float, length_s: float = LENGTH_S) -> Mat:
    """Return (n, 2): time (s) and the roll or pitch angle (rad) from trim after a step command at t = 0."""
    trim = airframe.trim
    fdm = Fdm("ice101", UAV_INPUTS, DT_S, ALTITUDE_M)
    actuators = Actuators(np.array(trim.effectors), DT_S)
    v_body = (trim.airspeed_m_s * math.cos(trim.alpha_rad), 0.0, trim.airspeed_m_s * math.sin(trim.alpha_rad))
    fdm.set_inputs((*trim.effectors, *CALM_WAKE))
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), v_body, (0.0, trim.alpha_rad, 0.0)))
    loops = InnerLoops(airframe, DT_S)
    roll = size_rad if axis == "roll" else 0.0
    pitch = trim.alpha_rad + (size_rad if axis == "pitch" else 0.0)
    track = []
    for k in range(round(length_s / DT_S)):
        state = fdm.state(0)
        track.append((k * DT_S, fdm.roll if axis == "roll" else fdm.pitch - trim.alpha_rad))
        actuators.step(loops.step(roll, pitch, trim.throttle, perfect(state)))
        fdm.set_inputs((*actuators.position.tolist(), *CALM_WAKE))
        fdm.step()
    return np.array(track)


def second_order_step(t_s: Vec, natural_rad_s: float, damping: float) -> Vec:
    """Return the unit step response of w^2 / (s^2 + 2 z w s + w^2) at times ``t_s``, zero before t = 0."""
    t = np.maximum(t_s, 0.0)
    root = np.sqrt(complex(damping * damping - 1.0))
    if abs(root) < 1e-6:
        return 1.0 - (1.0 + natural_rad_s * t) * np.exp(-natural_rad_s * t)
    s1, s2 = natural_rad_s * (-damping + root), natural_rad_s * (-damping - root)
    return np.real(1.0 + (s2 * np.exp(s1 * t) - s1 * np.exp(s2 * t)) / (s1 - s2))


def identify_response(airframe: AirframeConfig) -> AttitudeResponse:
    """Fit both attitude loops by second-order lags with one common delay; thrust lag is the throttle's."""
    tracks = {axis: step_response(airframe, axis, size) for axis, size in STEP_RAD.items()}

    def misfit(z: Vec) -> Vec:
        roll_w, roll_z, pitch_w, pitch_z, delay = z
        parts = []
        for axis, w, damping in (("roll", roll_w, roll_z), ("pitch", pitch_w, pitch_z)):
            t, angle = tracks[axis].T
            parts.append(angle / STEP_RAD[axis] - second_order_step(t - delay, w, damping))
        return np.concatenate(parts)

    fit = least_squares(misfit, [8.0, 0.8, 6.0, 0.8, 0.03], bounds=([1, 0.2, 1, 0.2, 0.0], [40, 3, 40, 3, 0.2]))
    roll_w, roll_z, pitch_w, pitch_z, delay = (round(float(v), 4) for v in fit.x)
    return AttitudeResponse(
        roll_rad_s=roll_w,
        roll_damping=roll_z,
        pitch_rad_s=pitch_w,
        pitch_damping=pitch_z,
        thrust_lag_s=THROTTLE.lag_s,
        delay_s=delay,
        pitch_sink_m=round(pitch_sink_m(airframe), 4),
    )
