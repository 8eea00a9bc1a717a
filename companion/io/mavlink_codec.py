"""MAVLink 2 frames from bytes and back, without input or output of its own.

Rules
-----
* The messages are pymavlink's generated ones; the framing is ours, because the generated parser loses good frames
  behind damage: after a bad frame the search goes on one byte further, never one frame further.
* Fields are packed and unpacked here, by the layout that the generated class carries, which takes a third of the time.
* A frame is only believed with a known id and a right checksum. Unknown ids carry no checksum that could be verified,
  so they are counted and dropped.
* MAVLink 2 only. Signatures are carried but not verified.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter, itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

__all__ = ["MavlinkCodec", "Message", "checksum", "dialect"]

Message = Any
"""A generated ``MAVLink_*_message``; pymavlink has no types that mypy could follow."""

Values = tuple[Any, ...]
Way = tuple[Callable[[Message], Iterable[Any]], Callable[[Values], Iterable[Any]]]

MARKER = 0xFD
HEADER_SIZE = 10
CHECKSUM_SIZE = 2
SIGNATURE_SIZE = 13
FLAG_SIGNED = 0x01

HEADER = struct.Struct("<BBBBBBBHB")
"""Marker, length, two bytes of flags, sequence, system, component, id in three bytes."""

MIRRORED_BITS = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def checksum(data: bytes, crc_extra: int) -> int:
    """Return the MAVLink checksum (CRC-16/MCRF4XX) of a frame without its marker, seeded with the message's extra.

    It is the bit-mirrored form of the polynomial that ``crc_hqx`` computes, hence the mirrored bytes.
    """
    crc = crc_hqx(data.translate(MIRRORED_BITS) + MIRRORED_BITS[crc_extra : crc_extra + 1], 0xFFFF)
    return MIRRORED_BITS[crc >> 8] | MIRRORED_BITS[crc & 0xFF] << 8


@dataclass(frozen=True, slots=True)
class Layout:
    """How the payload of a message is written: in ``wire`` order, which differs from that of its fields."""

    kind: Callable[..., Message]
    wire: struct.Struct
    crc_extra: int
    of_message: Callable[[Message], Iterable[Any]]
    of_wire: Callable[[Values], Iterable[Any]]


@lru_cache(maxsize=512)
def layout_of(message_id: int) -> Layout:
    """Return the layout of a known message."""
    kind = dialect.mavlink_map[message_id]
    of_message, of_wire = plain(kind) if not any(kind.array_lengths) and len(kind.orders) > 1 else with_arrays(kind)
    return Layout(kind, kind.unpacker, kind.crc_extra, of_message, of_wire)


def plain(kind: Any) -> Way:
    """Return the ways between wire and fields for a message of numbers only."""
    return attrgetter(*kind.ordered_fieldnames), itemgetter(*kind.orders)


def with_arrays(kind: Any) -> Way:
    """Return the ways between wire and fields for any message: arrays are lists, strings bytes without their zeros.

    A string is one value, as for struct; its bytes are the generated class's ``_NAME_raw``, the field itself is text.
    """
    starts = [sum(kind.lengths[:k]) for k in kind.orders]
    places = [start if kind.lengths[k] == 1 else slice(start, start + kind.lengths[k])
              for start, k in zip(starts, kind.orders, strict=True)]
    names = [f"_{name}_raw" if form == ord("c") else name
             for name, form in zip(kind.ordered_fieldnames, kind.native_format[1:], strict=True)]

    def of_message(message: Message) -> Iterable[Any]:
        for name, length in zip(names, kind.lengths, strict=True):
            value = getattr(message, name)
            if length == 1:
                yield value
            else:
                yield from value[:length]

    def of_wire(values: Values) -> Iterable[Any]:
        for place in places:
            value = values[place]
            if isinstance(value, tuple):
                yield list(value)
            else:
                yield value.rstrip(b"\0") if isinstance(value, bytes) else value

    return of_message, of_wire


class MavlinkCodec:
    """One end of a MAVLink stream: ``feed`` bytes to get messages, ``pack`` messages to get bytes.

    ``rejects`` counts what was dropped: ``garbage`` (runs of bytes that are no frame), ``bad_flags``, ``unknown_id``,
    ``bad_checksum``.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.rejects: Counter[str] = Counter()
        self._source = (system_id, component_id)
        self._sequence = 0
        self._buffer = bytearray()

    def restart(self) -> None:
        """Forget a frame that has begun, because the bytes that follow come from somewhere else."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[tuple[Message, bytes]]:
        """Take received bytes, cut anywhere; return the messages completed by them, each with its raw frame."""
        self._buffer += data
        buffer = bytes(self._buffer)
        found: list[tuple[Message, bytes]] = []
        at = 0
        while True:
            start = buffer.find(MARKER, at)
            if start != at and at < len(buffer):
                self.rejects["garbage"] += 1
            if start < 0:
                at = len(buffer)
                break
            at = start
            size = self._frame_size(buffer, at)
            if size is None:
                at += 1
                continue
            if size == 0 or at + size > len(buffer):
                break
            frame = buffer[at : at + size]
            message = self._decode(frame)
            if message is None:
                at += 1
            else:
                found.append((message, frame))
                at += size
        del self._buffer[:at]
        return found

    def _frame_size(self, buffer: bytes, at: int) -> int | None:
        """Return the size of the frame whose marker is at ``at``; 0 while unknown, None when it cannot be a frame."""
        if len(buffer) < at + HEADER_SIZE:
            return 0
        flags = buffer[at + 2]
        if flags & ~FLAG_SIGNED:
            self.rejects["bad_flags"] += 1
            return None
        if int.from_bytes(buffer[at + 7 : at + 10], "little") not in dialect.mavlink_map:
            self.rejects["unknown_id"] += 1
            return None
        signature = SIGNATURE_SIZE if flags & FLAG_SIGNED else 0
        return HEADER_SIZE + buffer[at + 1] + CHECKSUM_SIZE + signature

    def _decode(self, frame: bytes) -> Message | None:
        """Verify the checksum of one whole frame and unpack it; None when it does not hold."""
        end = HEADER_SIZE + frame[1]
        message_id = int.from_bytes(frame[7:10], "little")
        crc = frame[end] | frame[end + 1] << 8
        if checksum(frame[1:end], dialect.mavlink_map[message_id].crc_extra) != crc:
            self.rejects["bad_checksum"] += 1
            return None
        return decoded(frame, message_id, crc)

    def pack(self, message: Message) -> bytes:
        """Return the frame of a message with the next sequence number.

        Raises ValueError when a field does not fit its wire type.
        """
        message_id = message.get_msgId()
        layout = layout_of(message_id)
        try:
            whole = layout.wire.pack(*layout.of_message(message))
        except (struct.error, TypeError, OverflowError) as error:
            text = f"{message.get_type()} cannot be packed: {error}"
            raise ValueError(text) from error
        payload = whole.rstrip(b"\0") or whole[:1]  # zeros at the end are not sent
        head = HEADER.pack(MARKER, len(payload), 0, 0, self._sequence, *self._source, message_id & 0xFFFF,
                           message_id >> 16)
        self._sequence = (self._sequence + 1) % 256
        frame = head + payload
        return frame + checksum(frame[1:], layout.crc_extra).to_bytes(2, "little")


def decoded(frame: bytes, message_id: int, crc: int) -> Message:
    """Return the message of a frame that holds, with what pymavlink's own decoder would tell about its source."""
    layout = layout_of(message_id)
    _, length, incompatible, compatible, sequence, system, component, _, _ = HEADER.unpack_from(frame)
    size = layout.wire.size
    payload = frame[HEADER_SIZE : HEADER_SIZE + min(length, size)].ljust(size, b"\0")
    message = layout.kind(*layout.of_wire(layout.wire.unpack(payload)))
    message._header = dialect.MAVLink_header(
        message_id, incompatible, compatible, length, sequence, system, component
    )
    message._msgbuf, message._crc = bytearray(frame), crc
    return message
