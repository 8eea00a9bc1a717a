"""Camera pictures from a ZeroMQ socket: one message per picture.

The sender binds a PUB socket, the companion connects a SUB socket that keeps only the newest picture: a late picture
is worth nothing once there is a newer one. A message is a little-endian head and the raw RGB bytes, row by row:

====== ========== ==========================================================
bytes  content    meaning
====== ========== ==========================================================
4      ``RCFM``   magic
2      version    1
2 2    size       width, height in pixels
6      0          reserved
4      sequence   counts pictures; a gap tells of lost ones
8      t_ns       mid-exposure on the autopilot's (GPS) clock, signed
w h 3  picture    RGB, 8 bits each
====== ========== ==========================================================
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

import numpy as np
import zmq

from companion.config import CameraConfig, ConfigError
from companion.messages import CameraFrame, Event, Reject
from companion.ports import Clock, EventSource

HEAD = struct.Struct("<4sHHH6xIq")
ENDPOINT = re.compile(r"tcp://[^:/\s]+:(?P<port>\d{1,5})")
MAGIC = b"RCFM"
SEQUENCES = 1 << 32
VERSION = 1
SOURCE = "camera"
MAX_AGE_NS = 2_000_000_000
MAX_AHEAD_NS = 50_000_000


def encode_frame_message(frame: CameraFrame) -> bytes:
    """Return the message of a picture (h, w, 3) uint8 whose ``t_ns`` is on the autopilot's clock.

    Raises ValueError when the picture is not of that shape and type.
    """
    image = frame.image
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        msg = f"a picture is (h, w, 3) uint8, not {image.shape} {image.dtype}"
        raise ValueError(msg)
    height, width = image.shape[:2]
    return HEAD.pack(MAGIC, VERSION, width, height, frame.sequence % SEQUENCES, frame.t_ns) + image.tobytes()


def decode_frame_message(data: bytes, config: CameraConfig, now_ns: int) -> CameraFrame | Reject:
    """Return the picture of a message, ``t_ns`` on the autopilot's clock, or a Reject stamped ``now_ns``.

    Reasons: ``bad_magic``, ``bad_version``, ``bad_length`` (bytes and head disagree), ``wrong_size`` (not the
    configured camera's). The picture is a read-only view of ``data``.
    """
    if len(data) < HEAD.size:
        return Reject(now_ns, SOURCE, "bad_length", f"{len(data)} bytes are no picture")
    magic, version, width, height, sequence, t_ns = HEAD.unpack_from(data)
    if magic != MAGIC:
        return Reject(now_ns, SOURCE, "bad_magic", f"{magic!r} instead of {MAGIC!r}")
    if version != VERSION:
        return Reject(now_ns, SOURCE, "bad_version", f"version {version} instead of {VERSION}")
    if len(data) != HEAD.size + 3 * width * height:
        return Reject(now_ns, SOURCE, "bad_length", f"{len(data)} bytes for {width}x{height}")
    if (width, height) != (config.width_px, config.height_px):
        expected = f"{config.width_px}x{config.height_px} of camera '{config.name}'"
        return Reject(now_ns, SOURCE, "wrong_size", f"{width}x{height} instead of {expected}")
    image = np.frombuffer(data, np.uint8, offset=HEAD.size).reshape(height, width, 3)
    return CameraFrame(t_ns, sequence, image)


class CameraReceiver:
    """Messages of the camera to events on the companion's base: the same for the socket and for lockstep.

    ``missed`` counts pictures that the gaps in the sequence tell of.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.missed = 0
        self._config = config
        self._last_sequence: int | None = None

    def receive(self, data: bytes, now_ns: int, offset_ns: int | None) -> CameraFrame | Reject:
        """Take one message; ``offset_ns`` is the autopilot's clock minus the companion's, None while unknown."""
        frame = decode_frame_message(data, self._config, now_ns)
        if isinstance(frame, Reject):
            return frame
        if self._last_sequence is not None:
            ahead = (frame.sequence - self._last_sequence) % SEQUENCES
            self.missed += ahead - 1 if 0 < ahead < SEQUENCES // 2 else 0
        self._last_sequence = frame.sequence
        if offset_ns is None:
            return Reject(now_ns, SOURCE, "no_timesync", "the camera's clock is not known yet")
        t_ns = frame.t_ns - offset_ns
        if not now_ns - MAX_AGE_NS <= t_ns <= now_ns + MAX_AHEAD_NS:
            reason = "future_stamp" if t_ns > now_ns else "stale_stamp"
            return Reject(now_ns, SOURCE, reason, f"{(t_ns - now_ns) * 1e-9:+.3f} s from now")
        return CameraFrame(t_ns, frame.sequence, frame.image)


class ZmqCamera:
    """Pictures from ``tcp://HOST:PORT``: an event source.

    A sender that is not there yet is no error, it is waited for; the pipeline tells when pictures stay away.
    """

    def __init__(
        self, endpoint: str, config: CameraConfig, clock: Clock, offset_ns: Callable[[], int | None]
    ) -> None:
        """Connect; raises ConfigError for an endpoint that cannot be."""
        check_endpoint(endpoint)
        self.receiver = CameraReceiver(config)
        self._clock = clock
        self._offset_ns = offset_ns
        self._context = zmq.Context(io_threads=1)
        self._socket = self._context.socket(zmq.SUB)
        self._socket.set(zmq.CONFLATE, 1)
        self._socket.set(zmq.LINGER, 0)
        self._socket.set(zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            msg = f"camera '{endpoint}': cannot be connected ({error.strerror}); use tcp://HOST:PORT"
            raise ConfigError(msg) from None

    def poll(self) -> list[Event]:
        """Return the newest picture, if one has come since the last call, without waiting."""
        if self._socket.closed:
            return []
        try:
            data = self._socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return []
        return [self.receiver.receive(data, self._clock.now_ns(), self._offset_ns())]

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        self._socket.close()
        self._context.term()


class ZmqFrameSender:
    """The camera's end: pictures out on a bound socket; who does not keep up misses pictures."""

    def __init__(self, endpoint: str) -> None:
        """Bind; raises ConfigError when the port is busy or the endpoint cannot be."""
        check_endpoint(endpoint)
        self._context = zmq.Context(io_threads=1)
        self._socket = self._context.socket(zmq.PUB)
        self._socket.set(zmq.SNDHWM, 2)
        self._socket.set(zmq.LINGER, 0)
        try:
            self._socket.bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            reason = "the port is in use" if error.errno == zmq.EADDRINUSE else f"cannot be bound ({error.strerror})"
            msg = f"camera '{endpoint}': {reason}; stop the other program or choose another tcp://HOST:PORT"
            raise ConfigError(msg) from None

    def send(self, frame: CameraFrame) -> None:
        """Send one picture without waiting; ``frame.t_ns`` on the autopilot's (GPS) clock."""
        self._socket.send(encode_frame_message(frame), zmq.NOBLOCK)

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        self._socket.close()
        self._context.term()


def open_camera(
    spec: str, config: CameraConfig, clock: Clock, offset_ns: Callable[[], int | None]
) -> EventSource:
    """Return the source that ``spec`` names (``tcp://HOST:PORT``); raises ConfigError for what is not known."""
    if spec.startswith("tcp://"):
        return ZmqCamera(spec, config, clock, offset_ns)
    msg = f"camera '{spec}': unknown source; use tcp://HOST:PORT, as in tcp://127.0.0.1:5600"
    raise ConfigError(msg)


def check_endpoint(endpoint: str) -> None:
    """Raise ConfigError for what is no ``tcp://HOST:PORT``: the library would wait there for ever."""
    match = ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match["port"]) < 65536:
        msg = f"camera '{endpoint}': not tcp://HOST:PORT, as in tcp://127.0.0.1:5600"
        raise ConfigError(msg)
