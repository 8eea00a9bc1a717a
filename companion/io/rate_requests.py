"""Asking the autopilot for telemetry at a rate that guidance can fly on; the autopilots' default is 1 Hz."""

from __future__ import annotations

from companion.io.mavlink_codec import Message, dialect

REQUEST_NS = 1_000_000_000
REQUEST_TRIES = 5
TELEMETRY_RATE_HZ = 50
LOWEST_RATE_HZ = 10
GPS_RATE_HZ = 5
GPS_SILENT_NS = 3_000_000_000
"""Autopilots send GPS_RAW_INT unasked; one that has not for so long is asked."""
REFUSED = (dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_FAILED)


class RateRequests:
    """Asks for messages of the ids ``kinds`` when an autopilot appears, and for less when that is too much."""

    def __init__(self, kinds: tuple[int, ...]) -> None:
        self._kinds = kinds
        self._tries = 0
        self._rate_hz = TELEMETRY_RATE_HZ
        self._next_ns = 0
        self._lowered = False

    def start(self, now_ns: int) -> None:
        """Begin anew: an autopilot has appeared."""
        self._tries, self._rate_hz, self._next_ns = REQUEST_TRIES, TELEMETRY_RATE_HZ, now_ns

    def answered(self, result: int, now_ns: int) -> None:
        """Take the result of a request: done, or half the rate at once (ArduPlane denies more than 40 Hz).

        An answer does not say which message it is about, so one refusal lowers the rate for the whole round.
        """
        if self._lowered:
            return
        if result in REFUSED and self._rate_hz // 2 >= LOWEST_RATE_HZ:
            self._rate_hz //= 2
            self._tries, self._next_ns, self._lowered = REQUEST_TRIES, now_ns, True
        else:
            self._tries = 0

    def due(self, now_ns: int, target: tuple[int, int]) -> list[Message]:
        """Return the requests that are due now."""
        if not self._tries or now_ns < self._next_ns:
            return []
        self._tries -= 1
        self._lowered = False
        self._next_ns = now_ns + REQUEST_NS
        interval_us = 1_000_000 // self._rate_hz
        return [
            dialect.MAVLink_command_long_message(
                *target, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, kind, interval_us, 0, 0, 0, 0, 0
            )
            for kind in self._kinds
        ]


class GpsRateRequest:
    """Asks for GPS_RAW_INT where it does not come by itself."""

    def __init__(self) -> None:
        self._next_ns: int | None = None
        self._tries = 0
        self._waiting = False

    def start(self, now_ns: int) -> None:
        """Begin anew: an autopilot has appeared."""
        self._tries, self._waiting, self._next_ns = REQUEST_TRIES, False, now_ns + GPS_SILENT_NS

    def heard(self, now_ns: int) -> None:
        """Note that the stream is there."""
        self._waiting, self._next_ns = False, now_ns + GPS_SILENT_NS

    def answered(self) -> bool:
        """Take the answer to a request of a rate; True when it was ours: an answer does not say what it is about."""
        ours, self._waiting = self._waiting, False
        return ours

    def due(self, now_ns: int, target: tuple[int, int]) -> list[Message]:
        """Return the request when it is due now."""
        if not self._tries or self._next_ns is None or now_ns < self._next_ns:
            return []
        self._tries, self._waiting, self._next_ns = self._tries - 1, True, now_ns + REQUEST_NS
        return [
            dialect.MAVLink_command_long_message(
                *target, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
                1_000_000 // GPS_RATE_HZ, 0, 0, 0, 0, 0,
            )
        ]
