"""MAVLink 2 frames from bytes and back, without input or output of its own.

Rules
-----
* The messages and their packing are pymavlink's generated ones; the framing is ours, because the generated parser
  loses good frames behind damage: after a bad frame the search goes on one byte further, never one frame further.
* A frame is only believed with a known id and a right checksum. Unknown ids carry no checksum that could be verified,
  so they are counted and dropped.
* MAVLink 2 only. Signatures are carried but not verified.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

__all__ = ["MavlinkCodec", "Message", "checksum", "dialect"]

Message = Any
"""A generated ``MAVLink_*_message``; pymavlink has no types that mypy could follow."""

MARKER = 0xFD
HEADER_SIZE = 10
CHECKSUM_SIZE = 2
SIGNATURE_SIZE = 13
FLAG_SIGNED = 0x01

MIRRORED_BITS = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def checksum(data: bytes, crc_extra: int) -> int:
    """Return the MAVLink checksum (CRC-16/MCRF4XX) of a frame without its marker, seeded with the message's extra.

    It is the bit-mirrored form of the polynomial that ``crc_hqx`` computes, hence the mirrored bytes.
    """
    crc = crc_hqx(data.translate(MIRRORED_BITS) + MIRRORED_BITS[crc_extra : crc_extra + 1], 0xFFFF)
    return MIRRORED_BITS[crc >> 8] | MIRRORED_BITS[crc & 0xFF] << 8


class MavlinkCodec:
    """One end of a MAVLink stream: ``feed`` bytes to get messages, ``pack`` messages to get bytes.

    ``rejects`` counts what was dropped: ``garbage`` (runs of bytes that are no frame), ``bad_flags``, ``unknown_id``,
    ``bad_checksum``, ``bad_payload``.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.rejects: Counter[str] = Counter()
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
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
            message = self._decode(buffer[at : at + size])
            if message is None:
                at += 1
            else:
                found.append((message, buffer[at : at + size]))
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
        kind = dialect.mavlink_map[int.from_bytes(frame[7:10], "little")]
        if checksum(frame[1:end], kind.crc_extra) != frame[end] | frame[end + 1] << 8:
            self.rejects["bad_checksum"] += 1
            return None
        try:
            return self._mav.decode(bytearray(frame))
        except dialect.MAVError:
            self.rejects["bad_payload"] += 1
            return None

    def pack(self, message: Message) -> bytes:
        """Return the frame of a message with the next sequence number.

        Raises ValueError when a field does not fit its wire type.
        """
        try:
            frame = bytes(message.pack(self._mav))
        except (struct.error, TypeError, OverflowError) as error:
            text = f"{message.get_type()} cannot be packed: {error}"
            raise ValueError(text) from error
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
