"""What the stand-in autopilot tells: one builder per MAVLink message and the timetable that sends them.

Rules
-----
* A stamp is the instant of the inertial sample that the content comes from. Steps fall on whole milliseconds, so the
  millisecond stamps of MAVLink lose nothing.
* A position that is not known yet is not sent; GPS_RAW_INT then says that there is no fix. It says so as well while
  the position is dead reckoned, because fixes have stopped coming.
* Intervals can be changed message by message (MAV_CMD_SET_MESSAGE_INTERVAL) up to ``MAX_RATE_HZ``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.io.mavlink_codec import Message, dialect
from sim_bridge.sensors import GpsFix, InertialSample, Triple

MAX_RATE_HZ = 100.0
"""Half the step rate of the inner loops."""

NS_PER_S = 1_000_000_000

DEFAULT_RATES_HZ: dict[int, float] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    dialect.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 10.0,
    dialect.MAVLINK_MSG_ID_VFR_HUD: 10.0,
}

IMU_FIELDS_UPDATED = 0x3F
"""HIGHRES_IMU: acceleration and rates; no magnetometer and no barometer in the thesis."""

SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG  # the INS has a heading: what ground stations ask this bit for
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
    | dialect.MAV_SYS_STATUS_AHRS
)

EARTH_A_M, EARTH_E2 = 6378137.0, 6.69437999014e-3
"""WGS 84 semi-major axis and squared eccentricity."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the origin of ``ned`` lies on the Earth; any place does, the companion flies in ``ned``."""

    latitude_deg: float = 45.0
    longitude_deg: float = 7.0
    altitude_m: float = 6000.0

    def geodetic(self, p_ned_m: Triple) -> tuple[int, int, int]:
        """Return latitude and longitude (1e-7 deg) and altitude (mm) of a position near the origin (first order)."""
        sin_lat = math.sin(math.radians(self.latitude_deg))
        w2 = 1.0 - EARTH_E2 * sin_lat * sin_lat
        north_radius = EARTH_A_M * (1.0 - EARTH_E2) / (w2 * math.sqrt(w2)) + self.altitude_m
        east_radius = (EARTH_A_M / math.sqrt(w2) + self.altitude_m) * math.sqrt(1.0 - sin_lat * sin_lat)
        latitude = self.latitude_deg + math.degrees(p_ned_m[0] / north_radius)
        longitude = self.longitude_deg + math.degrees(p_ned_m[1] / east_radius)
        return round(latitude * 1e7), round(longitude * 1e7), round((self.altitude_m - p_ned_m[2]) * 1e3)


@dataclass(slots=True)
class Snapshot:
    """What is known at the last step: the source of every stream."""

    sample: InertialSample
    p_ned_m: Triple | None
    fix: GpsFix | None
    throttle: float
    base_mode: int
    custom_mode: int
    system_status: int


def boot_ms(t_ns: int) -> int:
    """Return MAVLink's milliseconds since boot, which wrap at 2^32."""
    return (t_ns // 1_000_000) & 0xFFFFFFFF


def clamp16(value: float) -> int:
    """Round into a signed 16-bit field."""
    return max(-32768, min(32767, round(value)))


def clamp32(value: float) -> int:
    """Round into a signed 32-bit field."""
    return max(-(2**31), min(2**31 - 1, round(value)))


def quaternion_wxyz(yaw: float, pitch: float, roll: float) -> tuple[float, float, float, float]:
    """Return the quaternion of ``R_ned_body`` with w >= 0, in plain floats (rad)."""
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    w = cr * cp * cy + sr * sp * sy
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


class Builders:
    """One method per message, from a snapshot; None when the message has nothing to say yet."""

    def __init__(self, origin: Origin) -> None:
        """Remember where ``ned`` lies on the Earth."""
        self._origin = origin
        self.by_id: dict[int, Callable[[Snapshot], Message | None]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
            dialect.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
            dialect.MAVLINK_MSG_ID_ATTITUDE: attitude,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
            dialect.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            dialect.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            dialect.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            dialect.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
            dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
        }

    def _global_position_int(self, s: Snapshot) -> Message | None:
        if s.p_ned_m is None:
            return None
        vn, ve, vd = s.sample.v_ned_m_s
        latitude, longitude, altitude_mm = self._origin.geodetic(s.p_ned_m)
        return dialect.MAVLink_global_position_int_message(
            boot_ms(s.sample.t_ns), latitude, longitude, altitude_mm, clamp32(-1e3 * s.p_ned_m[2]),
            clamp16(100.0 * vn), clamp16(100.0 * ve), clamp16(100.0 * vd), heading_cdeg(s.sample.euler_rad[0]),
        )

    def _gps_raw_int(self, s: Snapshot) -> Message:
        if s.fix is None:
            return dialect.MAVLink_gps_raw_int_message(
                s.sample.t_ns // 1000, dialect.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0
            )
        vn, ve, _ = s.sample.v_ned_m_s
        latitude, longitude, altitude_mm = self._origin.geodetic(s.fix.p_ned_m)
        speed_cm_s = min(0xFFFE, round(100.0 * math.hypot(vn, ve)))
        return dialect.MAVLink_gps_raw_int_message(
            s.fix.t_ns // 1000, dialect.GPS_FIX_TYPE_3D_FIX, latitude, longitude, altitude_mm, 0xFFFF, 0xFFFF,
            speed_cm_s, heading_cdeg(math.atan2(ve, vn)), 12,
        )

    def _vfr_hud(self, s: Snapshot) -> Message:
        """Build VFR_HUD; its airspeed is the true one, as nothing here flies on a calibrated one."""
        vn, ve, vd = s.sample.v_ned_m_s
        altitude_m = self._origin.altitude_m - (s.p_ned_m[2] if s.p_ned_m else 0.0)
        return dialect.MAVLink_vfr_hud_message(
            s.sample.airspeed_m_s, math.hypot(vn, ve), round(math.degrees(s.sample.euler_rad[0])) % 360,
            round(100.0 * max(0.0, min(1.0, s.throttle))), altitude_m, -vd,
        )

    def _home_position(self, s: Snapshot) -> Message:
        latitude, longitude, altitude_mm = self._origin.geodetic((0.0, 0.0, 0.0))
        return dialect.MAVLink_home_position_message(
            latitude, longitude, altitude_mm, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, s.sample.t_ns // 1000
        )


def heading_cdeg(yaw_rad: float) -> int:
    """Return a heading in 0..35999 hundredths of a degree."""
    return round(math.degrees(yaw_rad) * 100.0) % 36000


def heartbeat(s: Snapshot) -> Message:
    """Build HEARTBEAT of a fixed wing with a generic autopilot."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_GENERIC, s.base_mode, s.custom_mode, s.system_status, 3
    )


def system_time(s: Snapshot) -> Message:
    """Build SYSTEM_TIME; the simulated world has no calendar, which MAVLink writes as 0."""
    return dialect.MAVLink_system_time_message(0, boot_ms(s.sample.t_ns))


def sys_status(s: Snapshot) -> Message:
    """Build SYS_STATUS; the geofence bit says healthy, because ground stations take its absence for a breach."""
    healthy = SENSORS if s.fix else SENSORS & ~dialect.MAV_SYS_STATUS_SENSOR_GPS
    return dialect.MAVLink_sys_status_message(
        SENSORS, SENSORS, healthy | dialect.MAV_SYS_STATUS_GEOFENCE, 0, 0xFFFF, -1, -1, 0, 0, 0, 0, 0, 0
    )


def estimator_status(s: Snapshot) -> Message:
    """Build ESTIMATOR_STATUS, sent on request: position absolute with GPS, relative by dead reckoning."""
    flags = dialect.ESTIMATOR_ATTITUDE | dialect.ESTIMATOR_VELOCITY_HORIZ | dialect.ESTIMATOR_VELOCITY_VERT
    if s.fix is not None:
        flags |= dialect.ESTIMATOR_POS_HORIZ_ABS | dialect.ESTIMATOR_PRED_POS_HORIZ_ABS | dialect.ESTIMATOR_POS_VERT_ABS
    elif s.p_ned_m is not None:
        flags |= dialect.ESTIMATOR_POS_HORIZ_REL | dialect.ESTIMATOR_PRED_POS_HORIZ_REL
    unknown = math.nan  # the ratios and accuracies of a filter that is not there
    return dialect.MAVLink_estimator_status_message(s.sample.t_ns // 1000, flags, *(unknown,) * 8)


def attitude_quaternion(s: Snapshot) -> Message:
    """Build ATTITUDE_QUATERNION."""
    p, q, r = s.sample.omega_rad_s
    return dialect.MAVLink_attitude_quaternion_message(
        boot_ms(s.sample.t_ns), *quaternion_wxyz(*s.sample.euler_rad), p, q, r
    )


def attitude(s: Snapshot) -> Message:
    """Build ATTITUDE, for ground stations; sent on request."""
    yaw, pitch, roll = s.sample.euler_rad
    return dialect.MAVLink_attitude_message(boot_ms(s.sample.t_ns), roll, pitch, yaw, *s.sample.omega_rad_s)


def local_position_ned(s: Snapshot) -> Message | None:
    """Build LOCAL_POSITION_NED, valid at its stamp."""
    if s.p_ned_m is None:
        return None
    return dialect.MAVLink_local_position_ned_message(boot_ms(s.sample.t_ns), *s.p_ned_m, *s.sample.v_ned_m_s)


def highres_imu(s: Snapshot) -> Message:
    """Build HIGHRES_IMU with specific force and rates."""
    return dialect.MAVLink_highres_imu_message(
        s.sample.t_ns // 1000, *s.sample.specific_force_m_s2, *s.sample.omega_rad_s,
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, IMU_FIELDS_UPDATED,
    )


def autopilot_version(s: Snapshot) -> Message:  # the same at all times, whatever the snapshot
    """Build AUTOPILOT_VERSION with the setpoints that are obeyed."""
    capabilities = (
        dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | dialect.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    )
    return dialect.MAVLink_autopilot_version_message(capabilities, 1, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)


class Timetable:
    """Which streams are due: one interval and one next instant a message id."""

    def __init__(self, rates_hz: dict[int, float]) -> None:
        """Start with the given rates; every stream is due at once."""
        self._interval_ns = {message_id: round(NS_PER_S / rate) for message_id, rate in rates_hz.items()}
        self._default_ns = dict(self._interval_ns)
        self._next_ns = dict.fromkeys(self._interval_ns, 0)
        self._earliest_ns = 0

    def due(self, t_ns: int) -> list[int]:
        """Return the ids that are due at ``t_ns`` and book their next instants; late streams do not catch up."""
        if t_ns < self._earliest_ns:
            return []
        ids = [message_id for message_id, due_ns in self._next_ns.items() if due_ns <= t_ns]
        for message_id in ids:
            interval = self._interval_ns[message_id]
            booked = self._next_ns[message_id] + interval
            self._next_ns[message_id] = booked if booked > t_ns else t_ns + interval
        self._earliest_ns = min(self._next_ns.values(), default=t_ns)
        return ids

    def set_interval(self, message_id: int, interval_us: float, t_ns: int) -> bool:
        """Change one stream: microseconds between messages, 0 for the default, -1 for none; False when refused."""
        if not math.isfinite(interval_us):
            return False
        if interval_us < 0:
            self._next_ns.pop(message_id, None)
            self._interval_ns.pop(message_id, None)
            return True
        interval_ns = round(interval_us * 1000) if interval_us > 0 else self._default_ns.get(message_id, 0)
        if interval_us > 0 and interval_ns < NS_PER_S / MAX_RATE_HZ:
            return False
        if interval_ns == 0:  # the default of a message that is only sent on request
            return self.set_interval(message_id, -1, t_ns)
        self._interval_ns[message_id] = interval_ns
        self._next_ns[message_id] = self._earliest_ns = t_ns
        return True
