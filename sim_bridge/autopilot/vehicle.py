"""The stand-in autopilot's MAVLink 2 vehicle: bytes in, a command for the inner loops and bytes out. It has no I/O.

Rules
-----
* Setpoints are obeyed in GUIDED only, addressed to this vehicle only, and valid only (``setpoints``); what is not is
  counted in ``rejects`` and changes nothing.
* A setpoint lives ``SETPOINT_LIFE_NS``. Then the vehicle holds wings level and speed, says so (STATUSTEXT, HEARTBEAT
  critical) and follows again as soon as a valid setpoint comes.
* Without a fix for ``GPS_LOST_NS`` it goes on by dead reckoning and says so: GPS_RAW_INT without a fix, the bit of
  SYS_STATUS, ESTIMATOR_STATUS for who asks, and a STATUSTEXT when it begins and ends.
* In MANUAL it holds as well: there is no stick in the simulation.
* Every COMMAND_LONG and COMMAND_INT addressed to it is acknowledged; what it does not know is UNSUPPORTED.
* Messages to others, and its own echoes, are left alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from companion.config import AirframeConfig
from companion.io.mavlink_codec import MavlinkCodec, Message, dialect
from sim_bridge.autopilot.setpoints import (
    AttitudeCommand,
    OffsetCommand,
    SetpointError,
    VelocityCommand,
    attitude_command,
    position_target_command,
)
from sim_bridge.autopilot.telemetry import DEFAULT_RATES_HZ, Builders, Origin, Snapshot, Timetable
from sim_bridge.autopilot.velocity_loop import VelocityLoop
from sim_bridge.sensors import GpsFix, InertialSample, Triple

SETPOINT_LIFE_NS = 500_000_000

GPS_LOST_NS = 500_000_000
"""A fix is 0.1 to 0.2 s old while they come."""

MODES = {"MANUAL": 0, "GUIDED": 15}
"""custom_mode by name; the numbers are ArduPlane's, which ground stations know."""

MODE_NAMES = {number: name for name, number in MODES.items()}

BASE_MODE = {
    "MANUAL": dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    | dialect.MAV_MODE_FLAG_SAFETY_ARMED,
    "GUIDED": dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED | dialect.MAV_MODE_FLAG_SAFETY_ARMED,
}


class Vehicle:
    """One MAVLink vehicle in flight, armed and in GUIDED from the start."""

    def __init__(
        self,
        airframe: AirframeConfig,
        *,
        dt_s: float = 0.005,
        system_id: int = 1,
        component_id: int = 1,
        origin: Origin | None = None,
    ) -> None:
        """Build the vehicle of ``airframe``, stepped every ``dt_s``."""
        self.mode = "GUIDED"
        self.throttle = airframe.trim.throttle
        self._rejects: Counter[str] = Counter()
        self._codec = MavlinkCodec(system_id, component_id)
        self._id = (system_id, component_id)
        self._loop = VelocityLoop(airframe, dt_s)
        self._builders = Builders(origin or Origin())
        self._timetable = Timetable(DEFAULT_RATES_HZ)
        self._replies: list[Message] = []
        self._setpoint: AttitudeCommand | VelocityCommand | OffsetCommand | None = None
        self._setpoint_ns = 0
        self._lost = False
        self._gps_lost = False
        self._seen: tuple[InertialSample, Triple | None, GpsFix | None] | None = None
        self._handlers: dict[str, Callable[[Message, int], None]] = {
            "SET_ATTITUDE_TARGET": lambda m, t_ns: self._take_setpoint(attitude_command, m, t_ns),
            "SET_POSITION_TARGET_LOCAL_NED": lambda m, t_ns: self._take_setpoint(
                lambda m: position_target_command(m, t_ns), m, t_ns),
            "COMMAND_LONG": self._take_command,
            "COMMAND_INT": self._refuse_command,
            "TIMESYNC": self._take_timesync,
        }
        self._commands: dict[int, Callable[[Message, int], int]] = {
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            dialect.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
        }

    @property
    def rejects(self) -> Counter[str]:
        """What was dropped, by reason: bytes, frames and setpoints."""
        return self._rejects + self._codec.rejects

    @property
    def following(self) -> bool:
        """Whether a setpoint is alive that the vehicle obeys."""
        return self._setpoint is not None

    def feed(self, data: bytes, t_ns: int) -> None:
        """Take bytes that arrived at ``t_ns``, cut anywhere."""
        for message, _ in self._codec.feed(data):
            handler = self._handlers.get(message.get_type())
            source = (message.get_srcSystem(), message.get_srcComponent())
            if handler is not None and source != self._id and self._is_for_me(message):
                handler(message, t_ns)

    def step(
        self, sample: InertialSample, p_ned_m: Triple | None, fix: GpsFix | None = None
    ) -> AttitudeCommand | OffsetCommand | None:
        """Take what is measured now; return what inner loops or regulator shall fly, None to hold wings and speed."""
        self._seen = (sample, p_ned_m, self._fix_in_use(fix, sample.t_ns))
        if self._setpoint is not None and sample.t_ns - self._setpoint_ns > SETPOINT_LIFE_NS:
            self._setpoint = None
            self._lost = True
            self._say(dialect.MAV_SEVERITY_WARNING, "setpoints lost: holding wings level and speed")
        if isinstance(self._setpoint, VelocityCommand):
            return self._loop.step(self._setpoint, sample, p_ned_m)
        return self._setpoint

    def _fix_in_use(self, fix: GpsFix | None, t_ns: int) -> GpsFix | None:
        """Return the newest fix while it is fresh; None before the first and when they have stopped coming."""
        if fix is not None:
            if self._gps_lost:
                self._gps_lost = False
                self._say(dialect.MAV_SEVERITY_NOTICE, "GPS is back")
            return fix
        last = None if self._seen is None else self._seen[2]
        if last is None or t_ns - last.t_ns <= GPS_LOST_NS:
            return last
        self._gps_lost = True
        self._say(dialect.MAV_SEVERITY_WARNING, "GPS lost: dead reckoning")
        return None

    def outgoing(self, t_ns: int) -> bytes:
        """Return the frames that are due at ``t_ns``: answers, and streams once that instant has been measured."""
        measured = self._seen is not None and self._seen[0].t_ns >= t_ns
        due = self._timetable.due(t_ns) if measured else []
        if not due and not self._replies:
            return b""
        messages, self._replies = self._replies, []
        snapshot = self._snapshot()
        if snapshot is not None:
            built = [self._builders.by_id[message_id](snapshot) for message_id in due]
            messages += [message for message in built if message is not None]
        return b"".join([self._codec.pack(message) for message in messages])

    def _snapshot(self) -> Snapshot | None:
        if self._seen is None:
            return None
        status = dialect.MAV_STATE_CRITICAL if self._lost else dialect.MAV_STATE_ACTIVE
        return Snapshot(*self._seen, self.throttle, BASE_MODE[self.mode], MODES[self.mode], status)

    def _is_for_me(self, message: Message) -> bool:
        """Tell whether a message is addressed to this vehicle; one without an address is for all."""
        system = getattr(message, "target_system", self._id[0])
        component = getattr(message, "target_component", self._id[1])
        broadcast = message.get_type() == "TIMESYNC" and system == 0
        return broadcast or (system == self._id[0] and component in (0, self._id[1]))

    def _say(self, severity: int, text: str) -> None:
        self._replies.append(dialect.MAVLink_statustext_message(severity, text.encode("ascii")))

    def _take_setpoint(
        self,
        read: Callable[[Message], AttitudeCommand | VelocityCommand | OffsetCommand],
        message: Message,
        t_ns: int,
    ) -> None:
        """Obey a setpoint from now on, or count why not."""
        try:
            if self.mode != "GUIDED":
                raise SetpointError("not_guided")
            setpoint = read(message)
        except SetpointError as error:
            self._rejects[str(error)] += 1
            return
        if self._setpoint is None:
            self._say(dialect.MAV_SEVERITY_INFO, "following setpoints")
        if not isinstance(self._setpoint, VelocityCommand):
            self._loop.reset()
        self._setpoint, self._setpoint_ns, self._lost = setpoint, t_ns, False

    def _take_timesync(self, message: Message, t_ns: int) -> None:
        """Answer a request with the instant of its arrival; leave answers alone."""
        if message.tc1 == 0:
            self._replies.append(dialect.MAVLink_timesync_message(t_ns or 1, message.ts1))  # 0 would be a request

    def _take_command(self, message: Message, t_ns: int) -> None:
        """Do a COMMAND_LONG and acknowledge it."""
        command = self._commands.get(message.command)
        result = dialect.MAV_RESULT_UNSUPPORTED if command is None else command(message, t_ns)
        self._acknowledge(message, result)

    def _refuse_command(self, message: Message, t_ns: int) -> None:
        """Acknowledge a COMMAND_INT: none of them is known, whenever it comes."""
        del t_ns
        self._acknowledge(message, dialect.MAV_RESULT_UNSUPPORTED)

    def _acknowledge(self, message: Message, result: int) -> None:
        self._replies.append(
            dialect.MAVLink_command_ack_message(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
        )

    def _set_message_interval(self, message: Message, t_ns: int) -> int:
        message_id = whole(message.param1)
        if message_id not in self._builders.by_id or message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return dialect.MAV_RESULT_DENIED
        accepted = self._timetable.set_interval(message_id, message.param2, t_ns)
        return dialect.MAV_RESULT_ACCEPTED if accepted else dialect.MAV_RESULT_DENIED

    def _request_message(self, message: Message, t_ns: int) -> int:
        del t_ns
        builder = self._builders.by_id.get(whole(message.param1))
        snapshot = self._snapshot()
        if builder is None:
            return dialect.MAV_RESULT_UNSUPPORTED
        built = builder(snapshot) if snapshot is not None else None
        if built is None:
            return dialect.MAV_RESULT_TEMPORARILY_REJECTED
        self._replies.append(built)
        return dialect.MAV_RESULT_ACCEPTED

    def _do_set_mode(self, message: Message, t_ns: int) -> int:
        del t_ns
        flags = whole(message.param1)
        custom = flags >= 0 and flags & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        name = MODE_NAMES.get(whole(message.param2))
        if not custom or name is None:
            return dialect.MAV_RESULT_DENIED
        if name != self.mode:
            self.mode, self._setpoint, self._lost = name, None, False
            self._say(dialect.MAV_SEVERITY_NOTICE, f"mode {name}")
        return dialect.MAV_RESULT_ACCEPTED

    def _arm_disarm(self, message: Message, t_ns: int) -> int:
        """Accept to stay armed; nobody disarms an aircraft in flight."""
        del t_ns
        return dialect.MAV_RESULT_ACCEPTED if message.param1 == 1.0 else dialect.MAV_RESULT_DENIED


def whole(value: float) -> int:
    """Return a command's parameter as a whole number; -1 for what is none, NaN included."""
    return int(value) if math.isfinite(value) and value == int(value) and value >= 0 else -1
