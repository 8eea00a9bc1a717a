"""The tanker's datalink: the thesis' frame of 55 bytes over a serial line (thesis 3.2).

====== ========= =====================================================================================
bytes  content   meaning
====== ========= =====================================================================================
1      header    0xA5
4      V         inertial speed, m/s
8      α β       inertial flow angles, rad: velocity in tanker axes is V (cos α cos β, sin β, sin α cos β)
12     p q r     body rates, rad/s
12     ψ θ φ     yaw, pitch, roll, rad
8      x y       north and east of the local origin, m
4      H         height, m; ``z_ned = altitude0_m - H`` with the local origin at ``altitude0_m``
4      time      GPS time of validity modulo 256 s, so that a float32 still tells 15 us
2      CRC-16    ``binascii.crc_hqx`` from 0xFFFF over header and values
====== ========= =====================================================================================

Values are little-endian float32, the checksum is little-endian. The thesis gives three bytes to header and checksum
and leaves them open; one and two is the split that lets no damaged frame of 20 000 through.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields
from operator import attrgetter

import numpy as np

from companion.config import ConfigError
from companion.geometry import euler_from_rotation, rotation_from_euler
from companion.io.arrival import ArrivalBounds
from companion.io.serial_port import Port, explain_port, open_port, parse_spec
from companion.io.timesync import nearest_wrapped
from companion.messages import Event, Reject, TankerState
from companion.ports import Clock

HEADER = 0xA5
LAYOUT = struct.Struct("<B13f")
CHECKSUM = struct.Struct("<H")
FRAME_SIZE = LAYOUT.size + CHECKSUM.size
TIME_PERIOD_NS = 256_000_000_000
MAX_AGE_NS = 2_000_000_000
BAUD = 19_600
SOURCE = "datalink"

_ANGLE = math.pi + 1e-6  # a float32 rounds pi up
LIMITS = (
    (0.0, 1000.0),
    *((-_ANGLE, _ANGLE),) * 2,
    *((-10.0, 10.0),) * 3,
    *((-_ANGLE, _ANGLE),) * 3,
    *((-1e6, 1e6),) * 2,
    (-1000.0, 30000.0),
    (0.0, 256.0),
)
"""Range of each value on the wire; what lies outside is no aircraft."""


@dataclass(frozen=True, slots=True)
class TankerFrame:
    """The 13 values of one frame, as they were on the wire: SI units and rad."""

    speed_m_s: float
    alpha_rad: float
    beta_rad: float
    p_rad_s: float
    q_rad_s: float
    r_rad_s: float
    psi_rad: float
    theta_rad: float
    phi_rad: float
    x_m: float
    y_m: float
    height_m: float
    time_s: float

    def to_state(self, now_ns: int, altitude0_m: float) -> TankerState:
        """Return the tanker's state, stamped on the clock of ``now_ns`` (GPS time) within 128 s of it.

        ``altitude0_m`` is the height of the local origin.
        """
        t_ns = nearest_wrapped(round(self.time_s * 1e9), TIME_PERIOD_NS, now_ns)
        R_ned_tanker = rotation_from_euler(self.psi_rad, self.theta_rad, self.phi_rad)
        cos_beta = math.cos(self.beta_rad)
        v_tanker_m_s = self.speed_m_s * np.array(
            [math.cos(self.alpha_rad) * cos_beta, math.sin(self.beta_rad), math.sin(self.alpha_rad) * cos_beta]
        )
        return TankerState(
            t_ns=t_ns,
            p_ned_m=np.array([self.x_m, self.y_m, altitude0_m - self.height_m]),
            v_ned_m_s=R_ned_tanker @ v_tanker_m_s,
            R_ned_tanker=R_ned_tanker,
            omega_tanker_rad_s=np.array([self.p_rad_s, self.q_rad_s, self.r_rad_s]),
        )


values_of = attrgetter(*(field.name for field in fields(TankerFrame)))
"""The 13 values of a frame in their order."""


def frame_of(state: TankerState, altitude0_m: float = 0.0) -> TankerFrame:
    """Return the values that tell ``state``, stamped on GPS time, with the local origin at ``altitude0_m``."""
    u, v, w = (float(c) for c in state.R_ned_tanker.T @ state.v_ned_m_s)
    speed = math.sqrt(u * u + v * v + w * w)
    x, y, z = (float(c) for c in state.p_ned_m)
    p, q, r = (float(c) for c in state.omega_tanker_rad_s)
    return TankerFrame(
        speed,
        math.atan2(w, u),
        math.atan2(v, math.hypot(u, w)),
        p, q, r,
        *euler_from_rotation(state.R_ned_tanker),
        x, y, altitude0_m - z,
        state.t_ns % TIME_PERIOD_NS * 1e-9,
    )  # fmt: skip


def encode_frame(state: TankerState, altitude0_m: float = 0.0) -> bytes:
    """Return the 55 bytes that tell ``state`` (``t_ns`` in GPS time); ``altitude0_m`` is the local origin's height.

    Raises ValueError when a value is not finite or out of range.
    """
    values: tuple[float, ...] = values_of(frame_of(state, altitude0_m))
    fault = fault_of(values)
    if fault:
        msg = f"tanker state cannot be sent: {fault}"
        raise ValueError(msg)
    body = LAYOUT.pack(HEADER, *values)
    return body + CHECKSUM.pack(crc_hqx(body, 0xFFFF))


def fault_of(values: tuple[float, ...]) -> str:
    """Return ``not_finite``, ``out_of_range`` or an empty string for 13 values of a frame."""
    if not all(map(math.isfinite, values)):
        return "not_finite"
    inside = all(low <= value <= high for value, (low, high) in zip(values, LIMITS, strict=True))
    return "" if inside else "out_of_range"


class FrameParser:
    """Frames from bytes that come cut anywhere and damaged.

    After anything wrong the search goes on one byte further. ``rejects`` counts ``garbage`` (runs of bytes that are no
    frame), ``checksum``, ``not_finite`` and ``out_of_range``.
    """

    def __init__(self) -> None:
        self.rejects: Counter[str] = Counter()
        self._buffer = bytearray()

    def restart(self) -> None:
        """Forget a frame that has begun: the line was opened anew."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[TankerFrame]:
        """Take received bytes; return the frames that they complete."""
        self._buffer += data
        buffer = bytes(self._buffer)
        frames: list[TankerFrame] = []
        at = 0
        while at < len(buffer):
            start = buffer.find(HEADER, at)
            if start != at:
                self.rejects["garbage"] += 1
                at = start if start >= 0 else len(buffer)
            elif at + FRAME_SIZE > len(buffer):
                break
            elif not self._checksum_holds(buffer, at):
                at += 1
            else:
                self._take(LAYOUT.unpack_from(buffer, at)[1:], frames)
                at += FRAME_SIZE
        del self._buffer[:at]
        return frames

    def _checksum_holds(self, buffer: bytes, at: int) -> bool:
        end = at + LAYOUT.size
        holds: bool = crc_hqx(buffer[at:end], 0xFFFF) == CHECKSUM.unpack_from(buffer, end)[0]
        if not holds:
            self.rejects["checksum"] += 1
        return holds

    def _take(self, values: tuple[float, ...], frames: list[TankerFrame]) -> None:
        fault = fault_of(values)
        if fault:
            self.rejects[fault] += 1
        else:
            frames.append(TankerFrame(*values))


class TankerReceiver:
    """Bytes of the datalink to events: the same for the serial line and for lockstep.

    ``altitude0_m``: height of the local origin; ``baud`` of the line. Frames whose stamps contradict their arrival
    (``bounds``) or are older than 2 s are rejected, and so is everything while the GPS clock's offset is unknown. Order
    is the histories' business.
    """

    def __init__(self, altitude0_m: float, baud: int = BAUD) -> None:
        self.parser = FrameParser()
        self.bounds = ArrivalBounds(baud)
        self._altitude0_m = altitude0_m

    def receive(
        self, data: bytes, now_ns: int, offset_ns: int | None, uncertain_ns: int | None = None
    ) -> list[Event]:
        """Take bytes at ``now_ns`` (companion's base); ``offset_ns`` is GPS clock minus companion's clock.

        ``uncertain_ns``: by how much that may be wrong, None when that is not known.
        """
        since_ns = self.bounds.read(now_ns)
        before = dict(self.parser.rejects)
        frames = self.parser.feed(data)
        events: list[Event] = []
        if before != dict(self.parser.rejects):
            lost = self.parser.rejects - Counter(before)
            events += [Reject(now_ns, SOURCE, reason, f"{n} in {len(data)} bytes") for reason, n in lost.items()]
        events += [self._event(frame, since_ns, now_ns, offset_ns, uncertain_ns) for frame in frames]
        return events

    def _event(
        self, frame: TankerFrame, since_ns: int, now_ns: int, offset_ns: int | None, uncertain_ns: int | None
    ) -> Event:
        if offset_ns is None:
            return Reject(now_ns, SOURCE, "no_timesync", "the offset of the GPS clock is not known yet")
        gps = frame.to_state(now_ns + offset_ns, self._altitude0_m)
        t_ns = gps.t_ns - offset_ns
        reason = self.bounds.fault(t_ns, FRAME_SIZE, since_ns, now_ns, uncertain_ns)
        if not reason and t_ns < now_ns - MAX_AGE_NS:
            reason = "stale_stamp"
        if reason:
            return Reject(now_ns, SOURCE, reason, f"stamp {(t_ns - now_ns) * 1e-9:+.3f} s from now")
        return TankerState(t_ns, gps.p_ned_m, gps.v_ned_m_s, gps.R_ned_tanker, gps.omega_tanker_rad_s)


class SerialDatalink:
    """The datalink on a serial device: an event source.

    ``spec`` is ``DEVICE,BAUD``; ``offset_ns`` tells GPS clock minus companion's clock, None while unknown, and
    ``uncertain_ns`` by how much that may be wrong. The device
    has to be there at the start, else ConfigError; when it goes away later it is opened again as soon as it is back.
    """

    FIRST_BACK_OFF_NS = 100_000_000
    LONGEST_BACK_OFF_NS = 5_000_000_000

    def __init__(
        self, spec: str, clock: Clock, altitude0_m: float, offset_ns: Callable[[], int | None],
        uncertain_ns: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._device, self._baud = parse_spec("datalink", spec)
        self.receiver = TankerReceiver(altitude0_m, self._baud)
        self._clock = clock
        self._offset_ns, self._uncertain_ns = offset_ns, uncertain_ns
        self._back_off_ns = self.FIRST_BACK_OFF_NS
        self._next_try_ns = 0
        self._closed = False
        try:
            self._port: Port | None = open_port(self._device, self._baud)
        except OSError as error:
            raise ConfigError(f"datalink {explain_port(self._device, error)}") from None

    def poll(self) -> list[Event]:
        """Return what the bytes received since the last call tell, without waiting."""
        now_ns = self._clock.now_ns()
        if self._port is None:
            self._reopen(now_ns)
        if self._port is None:
            return []
        try:
            data = self._port.read(4096)
        except OSError as error:
            return [self._lost(now_ns, error)]
        # Read behind the device: what has come while the process was held up in between has not come in the future.
        return self.receiver.receive(data, self._clock.now_ns(), self._offset_ns(), self._uncertain_ns())

    def _lost(self, now_ns: int, error: OSError) -> Reject:
        self._let_go()
        self._back_off_ns = self.FIRST_BACK_OFF_NS
        self._next_try_ns = now_ns + self._back_off_ns
        return Reject(now_ns, SOURCE, "device_lost", f"{self._device}: {error}")

    def _reopen(self, now_ns: int) -> None:
        if self._closed or now_ns < self._next_try_ns:
            return
        try:
            self._port = open_port(self._device, self._baud)
        except OSError:
            self._back_off_ns = min(2 * self._back_off_ns, self.LONGEST_BACK_OFF_NS)
            self._next_try_ns = now_ns + self._back_off_ns
        else:
            self.receiver.parser.restart()

    def _let_go(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def close(self) -> None:
        """Let go of the device; safe to call twice."""
        self._closed = True
        self._let_go()
