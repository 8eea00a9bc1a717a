"""The autopilot's MAVLink 2 link."""

from __future__ import annotations

from companion.io.mavlink_codec import MavlinkCodec, Message, dialect

__all__ = ["MavlinkCodec", "Message", "dialect"]
