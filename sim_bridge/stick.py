"""The boom operator's joystick: MANUAL_CONTROL of a ground station or any program, over UDP.

Axes as ground stations send them: x back is up, y right is right, z (0..1000, at rest in its middle) telescopes out.
What is out of range or cut is dropped and counted; a stick that falls silent for ``SILENT_NS`` is at rest.
"""

from __future__ import annotations

from collections import Counter

from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from companion.io.transport import Address, UdpTransport

SILENT_NS = 500_000_000
AXIS = 1000
UNUSED = 32767
Stick = tuple[float, float, float]
AT_REST: Stick = (0.0, 0.0, 0.0)


def stick_of(message: Message) -> Stick | None:
    """Return (up, right, extend), each -1..1, of a MANUAL_CONTROL; None when an axis is out of range."""
    x, y, z = (0 if v == UNUSED else v for v in (message.x, message.y, message.z))
    if message.z == UNUSED:
        z = AXIS // 2
    if max(abs(x), abs(y), abs(z)) > AXIS:
        return None
    return -x / AXIS, y / AXIS, max(-1.0, (2 * z - AXIS) / AXIS)


class StickPort:
    """Listens for MANUAL_CONTROL; ``poll`` tells where the stick is."""

    def __init__(self, url: str) -> None:
        """Open ``url`` (``udpin:HOST:PORT``); raises ConfigError."""
        self._transport = UdpTransport("stick", url)
        self._codec = MavlinkCodec(255, dialect.MAV_COMP_ID_MISSIONPLANNER)
        self._stick = AT_REST
        self._heard_ns: int | None = None
        self.rejects: Counter[str] = Counter()

    @property
    def local(self) -> Address | None:
        """Return the address that it listens at, None once closed."""
        return self._transport.local

    def poll(self, now_ns: int) -> Stick:
        """Take what has come; return where the stick is at ``now_ns``."""
        for data, _ in self._transport.poll():
            for message, _ in self._codec.feed(data):
                self._take(message, now_ns)
        silent = self._heard_ns is None or now_ns - self._heard_ns > SILENT_NS
        return AT_REST if silent else self._stick

    def _take(self, message: Message, now_ns: int) -> None:
        if message.get_type() != "MANUAL_CONTROL":
            return
        stick = stick_of(message)
        if stick is None:
            self.rejects["stick_out_of_range"] += 1
            return
        self._stick, self._heard_ns = stick, now_ns

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        self._transport.close()
