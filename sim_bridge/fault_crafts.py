"""How pictures, detections, the tanker's frames, MAVLink frames and GPS fixes are stamped anew and made wrong."""

from __future__ import annotations

import math
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from companion.geometry import quaternion_from_rotation, rotation_from_euler, rotation_from_quaternion
from companion.io.datalink import CHECKSUM, FRAME_SIZE, LAYOUT, TIME_PERIOD_NS
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from companion.io.timesync import WRAP_MS
from companion.messages import NS, CameraFrame, Detections, MarkerFrame
from sim_bridge.faults import Fault
from sim_bridge.sensors import GpsFix

Frame = CameraFrame | MarkerFrame
NAN = math.nan
FALSE_LIGHTS = 9
GREY = 70
"""Of the boom's tube, out of focus before the lens."""
NOISE_STEPS = 6
"""So much a sensor's noise makes of an even grey: no two pictures are alike."""
ANYWHERE_M = 1000.0

SPEED, PITCH, X, Y, HEIGHT, TIME = 0, 7, 9, 10, 11, 12
"""Places of values in the tanker's frame (``companion.io.datalink``)."""
TOLD = {"height": HEIGHT, "velocity": SPEED, "turned": PITCH}

ATTITUDE, POSITION = dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED
HEARTBEAT = dialect.MAVLINK_MSG_ID_HEARTBEAT


FRAME_KINDS = ("garbage", "wrong", "shifted", "boom")


def _unknown(fault: Fault) -> ValueError:
    """Return the error of a kind that nothing here knows to make."""
    return ValueError(f"nothing knows how to make {fault.target}.{fault.kind}")


class FrameCraft:
    """Pictures and detections of a camera that is ``width_px`` by ``height_px``."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._size = (width_px, height_px)

    def with_stamp_of(self, kept: Frame, like: Frame) -> Frame:
        """Return the frame with the stamp and the number of another."""
        return replace(_stamped(kept, like.t_ns), sequence=like.sequence)

    def stamped_later(self, sample: Frame, by_ns: int) -> Frame:
        """Return the frame as if exposed later."""
        return _stamped(sample, sample.t_ns + by_ns)

    def wrong(self, sample: Frame, fault: Fault, elapsed_s: float, rng: np.random.Generator) -> list[Frame]:
        """Make noise of it, mirror it, shift it, lay the boom over it, or stamp it by a clock that has stepped."""
        if fault.kind == "step":
            return [_stamped(sample, sample.t_ns - round(fault.amount / NS))]
        if fault.kind not in FRAME_KINDS:
            raise _unknown(fault)
        if isinstance(sample, CameraFrame):
            return [replace(sample, image=self._picture(sample.image, fault, rng))]
        return [replace(sample, detections=self._detections(sample.detections, fault, rng))]

    def _picture(self, image: np.ndarray, fault: Fault, rng: np.random.Generator) -> np.ndarray:
        if fault.kind == "garbage":
            return rng.integers(0, 256, image.shape, dtype=np.uint8)
        if fault.kind == "wrong":
            return np.ascontiguousarray(image[:, ::-1])
        if fault.kind == "shifted":
            return np.roll(image, round(fault.amount), axis=1)
        left, right = self._band(fault)
        covered = image.copy()
        band = covered[:, math.ceil(left) : math.floor(right) + 1]
        band[:] = GREY + rng.integers(0, NOISE_STEPS, band.shape, dtype=np.uint8)
        return covered

    def _detections(self, seen: Detections, fault: Fault, rng: np.random.Generator) -> Detections:
        width, height = self._size
        if fault.kind == "garbage":
            uv_px = rng.uniform((-0.5, -0.5), (width - 0.5, height - 0.5), (FALSE_LIGHTS, 2))
            area_px = np.round(rng.uniform(2.0, 40.0, FALSE_LIGHTS))
            return Detections(seen.t_ns, uv_px, area_px, np.full(FALSE_LIGHTS, 0.1), np.zeros(FALSE_LIGHTS, np.uint8))
        uv_px = seen.uv_px.copy()
        if fault.kind == "wrong":
            uv_px[:, 0] = width - 1.0 - uv_px[:, 0]
        elif fault.kind == "shifted":
            uv_px[:, 0] += fault.amount
        kept = (uv_px[:, 0] > -0.5) & (uv_px[:, 0] < width - 0.5)
        if fault.kind == "boom":
            left, right = self._band(fault)
            kept &= (uv_px[:, 0] < left) | (uv_px[:, 0] > right)
        return Detections(seen.t_ns, uv_px[kept], seen.area_px[kept], seen.sigma_px[kept], seen.flags[kept])

    def _band(self, fault: Fault) -> tuple[float, float]:
        """Return the first and last column of pixels that the boom hides."""
        middle, half = 0.5 * (self._size[0] - 1.0), 0.5 * fault.amount * self._size[0]
        return middle - half, middle + half


def _stamped(frame: Frame, t_ns: int) -> Frame:
    if isinstance(frame, CameraFrame):
        return replace(frame, t_ns=t_ns)
    return replace(frame, t_ns=t_ns, detections=replace(frame.detections, t_ns=t_ns))


class DatalinkCraft:
    """The tanker's frames of 55 bytes, whole, before they go on the line."""

    def with_stamp_of(self, kept: bytes, like: bytes) -> bytes:
        """Return the frame with the time of another."""
        return _with_values(kept, lambda v: v.__setitem__(TIME, _values(like)[TIME]))

    def stamped_later(self, sample: bytes, by_ns: int) -> bytes:
        """Return the frame with a later time."""
        def later(v: list[float]) -> None:
            v[TIME] = (v[TIME] + by_ns * NS) % (TIME_PERIOD_NS * NS)

        return _with_values(sample, later)

    def wrong(self, sample: bytes, fault: Fault, elapsed_s: float, rng: np.random.Generator) -> list[bytes]:
        """Change what the tanker tells; the checksum is right but for garbage."""
        if fault.kind == "garbage":
            return [rng.integers(0, 256, FRAME_SIZE, dtype=np.uint8).tobytes()]

        def change(v: list[float]) -> None:
            if fault.kind == "wrong":
                v[X], v[Y] = v[X] + fault.amount, v[Y] + fault.amount
            elif fault.kind == "nan":
                v[X] = v[Y] = v[HEIGHT] = NAN
            elif fault.kind == "step":
                v[TIME] = (v[TIME] - fault.amount) % (TIME_PERIOD_NS * NS)
            elif fault.kind in TOLD:
                v[TOLD[fault.kind]] += fault.amount
            else:
                raise _unknown(fault)

        return [_with_values(sample, change)]


def _values(frame: bytes) -> list[float]:
    return list(LAYOUT.unpack_from(frame)[1:])


def _with_values(frame: bytes, change: Callable[[list[float]], None]) -> bytes:
    values = _values(frame)
    change(values)
    body = LAYOUT.pack(frame[0], *values)
    return body + CHECKSUM.pack(crc_hqx(body, 0xFFFF))


TELEMETRY_KINDS = {
    "attitude": ("garbage", "wrong", "nan"), "position": ("garbage", "wrong", "nan"), "heartbeat": ("garbage", "wrong"),
    "link": ("forged",), "clock": ("backwards", "step"),
}


class MavlinkCraft:
    """Frames of the autopilot's telemetry."""

    def __init__(self, system_id: int, component_id: int) -> None:
        """Write frames in the name of the autopilot."""
        self._reader, self._writer = MavlinkCodec(255, 1), MavlinkCodec(system_id, component_id)

    def with_stamp_of(self, kept: bytes, like: bytes) -> bytes:
        """Return the frame with the stamp of another; a heartbeat has none."""
        message, other = self._read(kept), self._read(like)
        if hasattr(message, "time_boot_ms"):
            message.time_boot_ms = other.time_boot_ms
        return self._writer.pack(message)

    def stamped_later(self, sample: bytes, by_ns: int) -> bytes:
        """Return the frame with a later stamp, in every way in which messages are stamped."""
        message = self._read(sample)
        if hasattr(message, "time_boot_ms"):
            message.time_boot_ms = (message.time_boot_ms + by_ns // 1_000_000) % WRAP_MS
        if hasattr(message, "time_usec"):
            message.time_usec = max(0, message.time_usec + by_ns // 1000)
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 != 0:
            message.tc1 += by_ns
        return self._writer.pack(message)

    def wrong(self, sample: bytes, fault: Fault, elapsed_s: float, rng: np.random.Generator) -> list[bytes]:
        """Change what the autopilot tells; the checksum is right but for garbage of the heartbeat."""
        if fault.kind not in TELEMETRY_KINDS.get(fault.target, ()):
            raise _unknown(fault)
        if fault.target == "clock":
            back_s = 2.0 * elapsed_s if fault.kind == "backwards" else fault.amount
            return [self.stamped_later(sample, -round(back_s * 1000.0) * 1_000_000)]
        message = self._read(sample)
        if fault.target == "heartbeat":
            return [self._heartbeat(message, sample, fault, rng)]
        if fault.target == "position":
            return [self._writer.pack(_moved(message, fault, rng))]
        if fault.kind == "forged":
            message.time_boot_ms += 1  # past the good one, so that this one is taken and the next good one still is
            return [sample, self._writer.pack(_rolled(message, fault.amount))]
        return [self._writer.pack(_turned(message, fault, rng))]

    def _heartbeat(self, message: Message, sample: bytes, fault: Fault, rng: np.random.Generator) -> bytes:
        if fault.kind == "garbage":
            return rng.integers(0, 256, len(sample), dtype=np.uint8).tobytes()
        message.base_mode = (dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
                             | dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        message.custom_mode = 0
        return self._writer.pack(message)

    def _read(self, frame: bytes) -> Message:
        return self._reader.feed(frame)[0][0]


def _moved(message: Message, fault: Fault, rng: np.random.Generator) -> Message:
    if fault.kind == "garbage":
        message.x, message.y, message.z = rng.uniform(-1e5, 1e5, 3).tolist()
        message.vx, message.vy, message.vz = rng.uniform(-900.0, 900.0, 3).tolist()
    elif fault.kind == "nan":
        message.x = message.y = message.z = NAN
    else:
        message.x += fault.amount
    return message


def _turned(message: Message, fault: Fault, rng: np.random.Generator) -> Message:
    if fault.kind == "garbage":
        q = rng.standard_normal(4)
        message.q1, message.q2, message.q3, message.q4 = (q / np.linalg.norm(q)).tolist()
        message.rollspeed, message.pitchspeed, message.yawspeed = rng.uniform(-10.0, 10.0, 3).tolist()
        return message
    if fault.kind == "nan":
        message.q2 = NAN
        return message
    return _rolled(message, fault.amount)


def _rolled(message: Message, by_rad: float) -> Message:
    R_ned_frd = rotation_from_quaternion(np.array((message.q1, message.q2, message.q3, message.q4)))
    q = quaternion_from_rotation(R_ned_frd @ rotation_from_euler(0.0, 0.0, by_rad))
    message.q1, message.q2, message.q3, message.q4 = q.tolist()
    return message


class GpsCraft:
    """Fixes of the receiver's GPS, before its navigation takes them."""

    def with_stamp_of(self, kept: GpsFix, like: GpsFix) -> GpsFix:
        """Return the place of one fix at the time of another."""
        return replace(kept, t_ns=like.t_ns)

    def stamped_later(self, sample: GpsFix, by_ns: int) -> GpsFix:
        """Return the fix as if it were of later."""
        return replace(sample, t_ns=sample.t_ns + by_ns)

    def wrong(self, sample: GpsFix, fault: Fault, elapsed_s: float, rng: np.random.Generator) -> list[GpsFix]:
        """Move the fix: anywhere, north by so much, or ever farther."""
        x, y, z = sample.p_ned_m
        if fault.kind == "garbage":
            north, east, down = rng.uniform(-ANYWHERE_M, ANYWHERE_M, 3).tolist()
            return [replace(sample, p_ned_m=(x + north, y + east, z + down))]
        if fault.kind not in ("wrong", "drag"):
            raise _unknown(fault)
        away_m = fault.amount * (elapsed_s if fault.kind == "drag" else 1.0)
        return [replace(sample, p_ned_m=(x + away_m, y, z))]
