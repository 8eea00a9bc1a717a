"""The autopilot's MAVLink 2 link: ``AutopilotLink`` without input or output, ``MavlinkUdp`` on a socket.

Rules
-----
* Telemetry counts only from ``links.system_id``/``links.autopilot_component_id``; commands from the vehicle's own
  system or ``links.gcs_system_id``, addressed to our component: MAV_CMD_USER_1 with 0 engage, 1 pre-contact, 2 contact,
  3 disconnect, USER_2 breakaway, USER_3 clear, USER_4 real vision, USER_5 simulated vision (``telemetry.COMMANDS``);
  one that the phase has no use for (``modes.OBEYED``) is answered as temporarily rejected and goes no farther. Every
  command addressed to us is acknowledged; what is addressed elsewhere is left alone.
* Stamps of the autopilot's clock (milliseconds since boot) are brought to the companion's base with the offset that
  TIMESYNC gives; before that, telemetry with a stamp is rejected as ``no_timesync``. Where the autopilot's clock steps
  against ours, a ``TimeStep`` comes before anything that is stamped the new way.
* A setpoint that is not finite or not in range never leaves.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from companion.config import LinksConfig
from companion.guidance.modes import OBEYED
from companion.io import telemetry
from companion.io.autopilot_clock import NS_PER_MS, AutopilotClock
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from companion.io.rate_requests import GpsRateRequest, RateRequests
from companion.io.status import HealthReport, status_text
from companion.io.telemetry import SOURCE
from companion.io.timesync import WRAP_MS
from companion.io.transport import Address, UdpTransport
from companion.messages import Event, Health, OperatorCommand, Phase, Reject, Setpoint
from companion.ports import Clock

__all__ = ["AutopilotLink", "MavlinkCodec", "MavlinkUdp", "Message", "dialect"]

OnBytes = Callable[[int, bytes], None]

SILENCE_NS = 3_000_000_000

STAMPED = {
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: telemetry.own_attitude,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: telemetry.own_position,
}


class AutopilotLink:
    """Bytes of the autopilot to events, setpoints to bytes; time comes in with every call.

    ``on_bytes(t_ns, frame)`` sees every valid frame, in and out. ``health`` says how the companion is: its heartbeat
    leaves only while all is well (``status``).
    """

    def __init__(self, config: LinksConfig, on_bytes: OnBytes | None = None) -> None:
        self.codec = MavlinkCodec(config.system_id, config.component_id)
        self.clock = AutopilotClock()
        self._health = HealthReport()
        self._phase = Phase.STANDBY
        self.last_heard_ns: int | None = None
        self._us = (config.system_id, config.component_id)
        self._autopilot = (config.system_id, config.autopilot_component_id)
        self._operators = {config.system_id, config.gcs_system_id}
        self._on_bytes = on_bytes
        self._replies: list[bytes] = []
        self._refused: list[Event] = []
        self._rates = RateRequests(tuple(STAMPED))
        self._gps_rate = GpsRateRequest()

    @property
    def offset_ns(self) -> int | None:
        """Autopilot's (GPS) clock minus companion's clock; None before the first TIMESYNC answer."""
        return self.clock.offset.offset_ns

    @property
    def uncertain_ns(self) -> int | None:
        """By how much ``offset_ns`` may be wrong, None when that is not known."""
        return self.clock.offset.uncertain_ns

    def to_companion_ns(self, autopilot_ns: int) -> int:
        """Return an instant of the autopilot's clock on ours; raises ValueError before the first TIMESYNC answer."""
        return self.clock.offset.to_ours_ns(autopilot_ns)

    def to_autopilot_ns(self, companion_ns: int) -> int:
        """Return an instant of ours on the autopilot's clock; raises ValueError before the first TIMESYNC answer."""
        return self.clock.offset.to_other_ns(companion_ns)

    def receive(self, data: bytes, now_ns: int, from_autopilot: bool = True) -> list[Event]:
        """Take bytes that arrived at ``now_ns``, cut anywhere; return what they tell.

        ``from_autopilot`` False: the bytes came another way than the autopilot's do, so no telemetry is believed.
        """
        self.clock.offset.slew(now_ns)
        before = dict(self.codec.rejects)
        frames = self.codec.feed(data)
        events, self._refused = self._refused, []
        if before != dict(self.codec.rejects):
            lost = self.codec.rejects - Counter(before)
            events.extend(Reject(now_ns, SOURCE, reason, f"{count} in one read") for reason, count in lost.items())
        for message, frame in frames:
            if self._on_bytes is not None:
                self._on_bytes(now_ns, frame)
            event = self._event(message, now_ns, from_autopilot)
            if event is not None:
                events.append(event)
        return events

    def _event(self, message: Message, now_ns: int, from_autopilot: bool) -> Event | None:
        kind = message.get_msgId()
        if kind in (dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_COMMAND_INT):
            return self._command(message, now_ns)
        if kind == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            self._reply(dialect.MAVLink_timesync_message(now_ns or 1, message.ts1), now_ns)  # 0 would be a request
            return None
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source != self._autopilot or not from_autopilot:
            return foreign(message, now_ns)
        self._heard(now_ns)
        return self._telemetry(message, kind, now_ns)

    def _telemetry(self, message: Message, kind: int, now_ns: int) -> Event | None:
        if kind in STAMPED:
            t_ns = self.clock.stamp(message.time_boot_ms, now_ns)
            return t_ns if isinstance(t_ns, Reject) else STAMPED[kind](message, t_ns)
        if kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return telemetry.autopilot_status(message, now_ns)
        if kind == dialect.MAVLINK_MSG_ID_GPS_RAW_INT:
            self._gps_rate.heard(now_ns)
            return telemetry.gps_status(message, self.clock.gps_stamp(message.time_usec, now_ns))
        if kind == dialect.MAVLINK_MSG_ID_TIMESYNC:
            return self.clock.answer(message.ts1, message.tc1, now_ns)
        if kind == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            to_us = message.target_component in (0, self._us[1])
            interval = to_us and message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL
            if interval and not self._gps_rate.answered():
                self._rates.answered(message.result, now_ns)
        return None

    def is_silent(self, now_ns: int) -> bool:
        """Tell whether the autopilot has not been heard for 3 s, or never."""
        return self.last_heard_ns is None or now_ns - self.last_heard_ns > SILENCE_NS

    def _heard(self, now_ns: int) -> None:
        if self.is_silent(now_ns):
            self._rates.start(now_ns)
            self._gps_rate.start(now_ns)
            self.clock.hurry(now_ns)
        self.last_heard_ns = now_ns

    def _command(self, message: Message, now_ns: int) -> Event | None:
        if (message.target_system, message.target_component) != self._us:
            return None
        command, result = telemetry.operator_command(message)
        source = (message.get_srcSystem(), message.get_srcComponent())
        event: Event | None = None
        if source[0] not in self._operators:
            result = dialect.MAV_RESULT_DENIED
            event = Reject(now_ns, SOURCE, "foreign_source", f"command {message.command} from {source[0]}/{source[1]}")
        elif command is not None and self._phase not in OBEYED.get(command, {self._phase}):
            result = dialect.MAV_RESULT_TEMPORARILY_REJECTED
            event = Reject(now_ns, "operator", f"{command}_not_now", f"phase {self._phase}")
        elif command is not None:
            event = OperatorCommand(now_ns, command)
        self._reply(dialect.MAVLink_command_ack_message(message.command, result, 0, 0, *source), now_ns)
        return event

    def _pack(self, message: Message, now_ns: int) -> bytes:
        frame = self.codec.pack(message)
        if self._on_bytes is not None:
            self._on_bytes(now_ns, frame)
        return frame

    def _reply(self, message: Message, now_ns: int) -> None:
        self._replies.append(self._pack(message, now_ns))

    def replies(self) -> bytes:
        """Return the answers to what was received, to go back where it came from."""
        frames, self._replies = self._replies, []
        return b"".join(frames)

    def outgoing(self, now_ns: int) -> bytes:
        """Return the answers that nobody has taken yet, and the periodic messages that are due."""
        messages = self._rates.due(now_ns, self._autopilot) + self._gps_rate.due(now_ns, self._autopilot)
        messages += self._health.due(now_ns)
        if self.clock.due(now_ns):
            messages.append(dialect.MAVLink_timesync_message(0, self.clock.offset.request(now_ns)))
        return self.replies() + b"".join(self._pack(message, now_ns) for message in messages)

    def health(self, health: Health) -> None:
        """Take how all stages are: what follows leaves with ``outgoing``."""
        self._health.take(health)

    def phase(self, phase: Phase) -> None:
        """Take the phase that has begun; it is standby at first."""
        self._phase = phase

    def encode_setpoint(self, setpoint: Setpoint, now_ns: int) -> bytes | None:
        """Return the setpoint's message, or None when the setpoint must not leave; the next ``receive`` tells why."""
        boot_ms = 0 if self.offset_ns is None else self.to_autopilot_ns(setpoint.t_ns) // NS_PER_MS % WRAP_MS
        message = telemetry.setpoint_message(setpoint, boot_ms, self._autopilot)
        if isinstance(message, Reject):
            self._refused.append(message)
            return None
        return self._pack(message, now_ns)

    def encode_text(self, text: str, now_ns: int, severity: int = dialect.MAV_SEVERITY_INFO) -> bytes:
        """Return a STATUSTEXT; what is longer than its 50 bytes is cut."""
        return self._pack(status_text(text, severity), now_ns)


def foreign(message: Message, now_ns: int) -> Reject | None:
    """Return a Reject for telemetry that we would have used from the autopilot; other traffic is nobody's fault."""
    kind = message.get_msgId()
    is_autopilot = kind == dialect.MAVLINK_MSG_ID_HEARTBEAT and message.autopilot != dialect.MAV_AUTOPILOT_INVALID
    if kind not in STAMPED and kind != dialect.MAVLINK_MSG_ID_GPS_RAW_INT and not is_autopilot:
        return None
    who = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
    return Reject(now_ns, SOURCE, "foreign_source", f"{message.get_type()} from {who} is not our autopilot's")


class MavlinkUdp:
    """The autopilot on a UDP socket: event source and setpoint sink.

    Answers go back to whoever asked; everything else goes to the address from which the autopilot speaks, and nothing
    leaves before it has spoken (a ``udpout`` link speaks first). A second
    address that claims to be the autopilot is not believed until the first has been silent for 3 s.
    """

    def __init__(self, config: LinksConfig, clock: Clock, on_bytes: OnBytes | None = None) -> None:
        """Open ``config.mavlink``; raises ConfigError."""
        self.link = AutopilotLink(config, on_bytes)
        self._transport = UdpTransport("mavlink", config.mavlink)
        self._clock = clock
        self._last_sender: Address | None = None

    def offset_ns(self) -> int | None:
        """Return autopilot's (GPS) clock minus companion's clock, None while unknown."""
        return self.link.offset_ns

    def uncertain_ns(self) -> int | None:
        """Return by how much that offset may be wrong, None when that is not known."""
        return self.link.uncertain_ns

    def poll(self) -> list[Event]:
        """Return the events received since the last call, without waiting; send what is due."""
        datagrams = self._transport.poll()
        # Read behind the socket: a process that is held up in between must not stamp an arrival before it happened,
        # or an answer of TIMESYNC binds the clock to where it never was.
        now_ns = self._clock.now_ns()
        events = self.link.receive(b"", now_ns)  # what has been refused since, even when nothing comes in
        for data, sender in datagrams:
            events.extend(self._datagram(data, sender, now_ns))
        if self._transport.peer is not None:
            self._transport.send(self.link.outgoing(now_ns))
        return events

    def _datagram(self, data: bytes, sender: Address, now_ns: int) -> list[Event]:
        if sender != self._last_sender:
            self.link.codec.restart()
            self._last_sender = sender
        trusted = self.link.is_silent(now_ns) or sender == self._transport.peer
        events = self.link.receive(data, now_ns, trusted)
        if trusted and self.link.last_heard_ns == now_ns:
            self._transport.peer = sender
        self._transport.send(self.link.replies(), sender)
        return events

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint; one that must not leave comes back as a Reject with the next ``poll``."""
        if self._transport.peer is None:
            return
        frame = self.link.encode_setpoint(setpoint, self._clock.now_ns())
        if frame is not None:
            self._transport.send(frame)

    def health(self, health: Health) -> None:
        """Take how all stages are; the autopilot and its ground station are told with the next ``poll``."""
        self.link.health(health)

    def phase(self, phase: Phase) -> None:
        """Take the phase that has begun: commands are answered by it."""
        self.link.phase(phase)

    def say(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Send a STATUSTEXT for the operator."""
        if self._transport.peer is None:
            return
        self._transport.send(self.link.encode_text(text, self._clock.now_ns(), severity))

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        self._transport.close()
