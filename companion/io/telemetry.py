"""MAVLink messages to the pipeline's events and back: wire types, units and ranges stop here.

Each function takes a generated message and ``t_ns``, the instant of validity on the companion's base, and returns an
event, or a ``Reject`` when the content cannot be.
"""

from __future__ import annotations

import math

import numpy as np

from companion.geometry import quaternion_from_rotation, rotation_from_euler, rotation_from_quaternion
from companion.io.mavlink_codec import Message, dialect
from companion.messages import (
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Command,
    GpsStatus,
    OffsetSetpoint,
    OwnAttitude,
    OwnPosition,
    Reject,
    Setpoint,
    VelocitySetpoint,
)

SOURCE = "mavlink"
MAX_RATE_RAD_S = 20.0
MAX_POSITION_M = 1e6
MAX_SPEED_M_S = 1000.0

ARDUPLANE_GUIDED = 15
PX4_MAIN_MODE_OFFBOARD = 6

COMMANDS: dict[Command, tuple[int, float | None]] = {
    Command.ENGAGE: (dialect.MAV_CMD_USER_1, 0.0),
    Command.PRE_CONTACT: (dialect.MAV_CMD_USER_1, 1.0),
    Command.CONTACT: (dialect.MAV_CMD_USER_1, 2.0),
    Command.DISCONNECT: (dialect.MAV_CMD_USER_1, 3.0),
    Command.BREAKAWAY: (dialect.MAV_CMD_USER_2, None),
    Command.CLEAR: (dialect.MAV_CMD_USER_3, None),
    Command.REAL_VISION: (dialect.MAV_CMD_USER_4, None),
    Command.SIMULATED_VISION: (dialect.MAV_CMD_USER_5, None),
}
"""What an operator sends as COMMAND_LONG to our component: number and first parameter; parameters are not used else."""

COMMAND_NUMBERS = frozenset(number for number, _ in COMMANDS.values())

IGNORE_POSITION = 0x007
IGNORE_ACCELERATION = 0x1C0
IGNORE_YAW_RATE = 0x800
"""Of POSITION_TARGET_TYPEMASK, three axes each where there are three."""

IGNORE_BODY_RATES = (
    dialect.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | dialect.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | dialect.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
)


def own_attitude(message: Message, t_ns: int) -> OwnAttitude | Reject:
    """ATTITUDE_QUATERNION: Hamilton wxyz from body to NED, body rates in rad/s."""
    q = (message.q1, message.q2, message.q3, message.q4)
    rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
    if not all(map(math.isfinite, (*q, *rates))):
        return Reject(t_ns, SOURCE, "not_finite", "ATTITUDE_QUATERNION")
    if max(map(abs, rates)) > MAX_RATE_RAD_S:
        return Reject(t_ns, SOURCE, "out_of_range", f"ATTITUDE_QUATERNION rates {rates} rad/s")
    try:
        R_ned_frd = rotation_from_quaternion(np.array(q))
    except ValueError as error:
        return Reject(t_ns, SOURCE, "bad_quaternion", str(error))
    return OwnAttitude(t_ns, R_ned_frd, np.array(rates))


def own_position(message: Message, t_ns: int) -> OwnPosition | Reject:
    """LOCAL_POSITION_NED: metres and metres per second from the local origin."""
    p = (message.x, message.y, message.z)
    v = (message.vx, message.vy, message.vz)
    if not all(map(math.isfinite, (*p, *v))):
        return Reject(t_ns, SOURCE, "not_finite", "LOCAL_POSITION_NED")
    if max(map(abs, p)) > MAX_POSITION_M or max(map(abs, v)) > MAX_SPEED_M_S:
        return Reject(t_ns, SOURCE, "out_of_range", f"LOCAL_POSITION_NED {p} m, {v} m/s")
    return OwnPosition(t_ns, np.array(p), np.array(v))


def autopilot_status(message: Message, t_ns: int) -> AutopilotStatus:
    """HEARTBEAT: whether the autopilot is armed, and whether it follows our setpoints."""
    armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
    return AutopilotStatus(t_ns, AutopilotMode.GUIDED if follows(message) else AutopilotMode.MANUAL, armed)


def gps_status(message: Message, t_ns: int) -> GpsStatus:
    """GPS_RAW_INT: whether the receiver has a three-dimensional fix (differential and RTK ones are that as well)."""
    return GpsStatus(t_ns, bool(dialect.GPS_FIX_TYPE_3D_FIX <= message.fix_type <= dialect.GPS_FIX_TYPE_PPP))


def operator_command(message: Message) -> tuple[Command | None, int]:
    """COMMAND_LONG or COMMAND_INT: the command, if it is one of ours, and the MAV_RESULT to answer with.

    A first parameter that names no command, NaN among them, is denied: what a gate is told must not be guessed.
    """
    is_long = message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG
    if message.command not in COMMAND_NUMBERS or not is_long:
        return None, dialect.MAV_RESULT_UNSUPPORTED
    for command, (number, param1) in COMMANDS.items():
        if number == message.command and param1 in (None, message.param1):
            return command, dialect.MAV_RESULT_ACCEPTED
    return None, dialect.MAV_RESULT_DENIED


def follows(message: Message) -> bool:
    """Tell from a HEARTBEAT whether attitude setpoints are obeyed: each autopilot says it in its own way."""
    if message.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return bool(message.custom_mode == ARDUPLANE_GUIDED)
    if message.autopilot == dialect.MAV_AUTOPILOT_PX4:
        return bool(message.custom_mode >> 16 & 0xFF == PX4_MAIN_MODE_OFFBOARD)
    return bool(message.base_mode & dialect.MAV_MODE_FLAG_GUIDED_ENABLED)


def setpoint_message(setpoint: Setpoint, time_boot_ms: int, target: tuple[int, int]) -> Message | Reject:
    """Return the message of a setpoint of any law; a Reject when it must not leave."""
    if isinstance(setpoint, AttitudeSetpoint):
        return attitude_target(setpoint, time_boot_ms, target)
    return position_target(setpoint, time_boot_ms, target)


def position_target(
    setpoint: VelocitySetpoint | OffsetSetpoint, time_boot_ms: int, target: tuple[int, int]
) -> Message | Reject:
    """SET_POSITION_TARGET_LOCAL_NED: velocity, acceleration and yaw; or offset (LOCAL_OFFSET_NED), velocity and yaw."""
    offsets = isinstance(setpoint, OffsetSetpoint)
    p = setpoint.offset_ned_m if isinstance(setpoint, OffsetSetpoint) else (0.0, 0.0, 0.0)
    v = setpoint.v_ned_m_s
    a = (0.0, 0.0, 0.0) if isinstance(setpoint, OffsetSetpoint) else setpoint.a_ned_m_s2
    if not all(map(math.isfinite, (*p, *v, *a, setpoint.yaw_rad))):
        return Reject(setpoint.t_ns, SOURCE, "setpoint_not_finite", "not sent")
    if math.hypot(*p) > MAX_POSITION_M or math.hypot(*v) > MAX_SPEED_M_S:
        return Reject(setpoint.t_ns, SOURCE, "setpoint_out_of_range", f"{p} m, {v} m/s: not sent")
    frame = dialect.MAV_FRAME_LOCAL_OFFSET_NED if offsets else dialect.MAV_FRAME_LOCAL_NED
    mask = IGNORE_YAW_RATE | (IGNORE_ACCELERATION if offsets else IGNORE_POSITION)
    return dialect.MAVLink_set_position_target_local_ned_message(
        time_boot_ms, *target, frame, mask, *p, *v, *a, math.remainder(setpoint.yaw_rad, 2.0 * math.pi), 0.0
    )


def attitude_target(setpoint: AttitudeSetpoint, time_boot_ms: int, target: tuple[int, int]) -> Message | Reject:
    """SET_ATTITUDE_TARGET with attitude and thrust; a Reject when the setpoint must not leave.

    A NaN quaternion ends ArduPlane's simulation and one that is scaled is flown scaled, hence the checks here too.
    """
    angles = (setpoint.roll_rad, setpoint.pitch_rad, setpoint.yaw_rad)
    if not all(map(math.isfinite, (*angles, setpoint.thrust))):
        return Reject(setpoint.t_ns, SOURCE, "setpoint_not_finite", "not sent")
    in_range = abs(angles[0]) <= math.pi and abs(angles[1]) <= math.pi / 2 and 0.0 <= setpoint.thrust <= 1.0
    if not in_range:
        return Reject(setpoint.t_ns, SOURCE, "setpoint_out_of_range", f"{angles} rad, {setpoint.thrust}: not sent")
    q_wxyz = quaternion_from_rotation(rotation_from_euler(setpoint.yaw_rad, setpoint.pitch_rad, setpoint.roll_rad))
    return dialect.MAVLink_set_attitude_target_message(
        time_boot_ms=time_boot_ms,
        target_system=target[0],
        target_component=target[1],
        type_mask=IGNORE_BODY_RATES,
        q=q_wxyz.tolist(),
        body_roll_rate=0.0,
        body_pitch_rate=0.0,
        body_yaw_rate=0.0,
        thrust=setpoint.thrust,
    )
