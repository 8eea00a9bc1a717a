"""A receiver in straight flight, known exactly: what the tests of sensors, navigation and vehicle fly."""

import numpy as np

from companion.config import AirframeConfig, AttitudeResponse, TrimConfig
from companion.geometry import rotation_from_euler
from sim_bridge.truth import BodyState

SPEED_M_S = 205.7
ALPHA_RAD = 0.064
BETA_RAD = 0.02
EULER_RAD = (0.4, 0.07, 0.1)
STEP_NS = 5_000_000
LIFT_M_S2_RAD = 150.0
THRUST_M_S2 = 8.0
THROTTLE = 0.35


def airframe() -> AirframeConfig:
    """Return a receiver near trim with round slopes of lift and thrust."""
    A, B = np.zeros((9, 9)), np.zeros((9, 10))
    A[1, 1] = -LIFT_M_S2_RAD / SPEED_M_S
    B[0, 0] = THRUST_M_S2
    return AirframeConfig(
        name="point",
        receptacle_frd_m=(2.0, 0.0, -1.0),
        mass_kg=14855.0,
        trim=TrimConfig(
            airspeed_m_s=SPEED_M_S, altitude_m=6000.0, alpha_rad=ALPHA_RAD, throttle=THROTTLE,
            effectors=(THROTTLE,) + (0.0,) * 9,
        ),
        response=AttitudeResponse(
            roll_rad_s=8.0, roll_damping=0.8, pitch_rad_s=5.5, pitch_damping=0.8, thrust_lag_s=0.4, delay_s=0.03
        ),
        A=tuple(map(tuple, A.tolist())),
        B=tuple(map(tuple, B.tolist())),
    )  # fmt: skip


def state_at(t_ns: int, euler: tuple[float, float, float] = EULER_RAD) -> BodyState:
    """Return the truth of straight flight at constant attitude and speed, in air that moves to the left."""
    R = rotation_from_euler(*euler)
    v_body = SPEED_M_S * np.array(
        [np.cos(ALPHA_RAD) * np.cos(BETA_RAD), np.sin(BETA_RAD), np.sin(ALPHA_RAD) * np.cos(BETA_RAD)]
    )
    v_ned = R @ v_body
    return BodyState(
        t_ns=t_ns,
        p_ned_m=np.array([10.0, -20.0, -30.0]) + v_ned * (t_ns * 1e-9),
        v_ned_m_s=v_ned,
        R_ned_body=R,
        omega_body_rad_s=np.array([0.01, -0.02, 0.03]),
        specific_force_body_m_s2=np.array([0.5, 0.1, -9.7]),
        v_air_body_m_s=v_body + np.array([0.0, 3.0, 0.0]),
    )


class Quiet(np.random.Generator):
    """A generator that never deviates, for sensors without noise."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def standard_normal(self, size: tuple[int, int]) -> np.ndarray:
        return np.zeros(size)
