"""What the companion tells of its health over MAVLink: HEARTBEAT or none, STATUSTEXT on changes, SYS_STATUS at 1 Hz.

Rules
-----
* HEARTBEAT leaves only while every stage in use is well; nothing has said so before the first ``Health``.
* A stage that fails or is well again is one STATUSTEXT, at most ``TEXTS_HZ`` of them a second: what has not been told
  when its stage changes again is told as it is then. In the first ``START_NS`` nothing is: everything has to begin.
* SYS_STATUS has the bits that MAVLink has a name for (``BITS``): vision position is the sight of the tanker, camera and
  vision together. Datalink, fusion and integrity have none and are told by STATUSTEXT only. Nothing in it is about
  batteries or loads: their fields say unknown.
"""

from __future__ import annotations

from collections.abc import Sequence

from companion.io.health_text import stage_line
from companion.io.mavlink_codec import Message, dialect
from companion.messages import Health, StageHealth

TEXTS_HZ = 4
TEXT_NS = 1_000_000_000 // TEXTS_HZ
START_NS = 2_000_000_000
STATUS_NS = 1_000_000_000
HEARTBEAT_NS = 1_000_000_000

BITS: dict[int, tuple[str, ...]] = {
    dialect.MAV_SYS_STATUS_SENSOR_VISION_POSITION: ("camera", "vision"),
    dialect.MAV_SYS_STATUS_AHRS: ("attitude",),
    dialect.MAV_SYS_STATUS_SENSOR_GPS: ("position",),
    dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL: ("guidance",),
    dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL: ("guidance",),
}
"""Bits of MAV_SYS_STATUS_SENSOR, and the stages that all have to be so for a bit to be set."""

UNKNOWN_MV = 2**16 - 1
UNKNOWN = -1


class HealthReport:
    """Keeps the last ``Health`` and says what is due."""

    def __init__(self) -> None:
        self.healthy = False
        self._stages: dict[str, StageHealth] = {}
        self._told: dict[str, StageHealth] = {}
        self._heartbeat_ns = self._text_ns = self._status_ns = 0

    def take(self, health: Health) -> None:
        """Take how all stages are now."""
        if not self._stages:
            self._text_ns = health.t_ns + START_NS
        self.healthy = health.well
        self._stages = {stage.name: stage for stage in health.stages}

    def due(self, now_ns: int) -> list[Message]:
        """Return the messages that are due now."""
        messages = []
        if self.healthy and now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
            messages.append(heartbeat())
        if self._stages and now_ns >= self._status_ns:
            self._status_ns = now_ns + STATUS_NS
            messages.append(sys_status(tuple(self._stages.values())))
        if now_ns >= self._text_ns:
            text = self._next_text()
            if text is not None:
                self._text_ns = now_ns + TEXT_NS
                messages.append(text)
        return messages

    def _next_text(self) -> Message | None:
        """Return what has to be told next, stages in their order; None when all has been told."""
        for name, stage in self._stages.items():
            line = stage_line(self._told.get(name), stage)
            self._told[name] = stage
            if line:
                severity = dialect.MAV_SEVERITY_INFO if stage.healthy else dialect.MAV_SEVERITY_WARNING
                return status_text(line, severity)
        return None


def heartbeat() -> Message:
    """Return the heartbeat of an onboard computer."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def status_text(text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> Message:
    """Return a STATUSTEXT; what is longer than its 50 bytes is cut."""
    return dialect.MAVLink_statustext_message(severity, text.encode("ascii", errors="replace")[:50])


def sys_status(stages: Sequence[StageHealth]) -> Message:
    """Return the SYS_STATUS of stages."""
    by_name = {stage.name: stage for stage in stages}
    present = enabled = healthy = 0
    for bit, names in BITS.items():
        of_bit = [by_name[name] for name in names if name in by_name]
        if not of_bit:
            continue
        present |= bit * all(stage.present for stage in of_bit)
        enabled |= bit * all(stage.enabled for stage in of_bit)
        healthy |= bit * all(stage.present and stage.healthy for stage in of_bit)
    return dialect.MAVLink_sys_status_message(
        present, enabled, healthy, 0, UNKNOWN_MV, UNKNOWN, UNKNOWN, 0, 0, 0, 0, 0, 0
    )
