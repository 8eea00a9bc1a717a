"""The operator's side of the link: commands to a companion and its answers."""

from __future__ import annotations

import time

from companion.config import ConfigError, LinksConfig
from companion.io.mavlink_codec import MavlinkCodec, dialect
from companion.io.telemetry import COMMANDS
from companion.io.transport import UdpTransport
from companion.messages import Command

GCS_COMPONENT_ID = 190
"""MAV_COMP_ID_MISSIONPLANNER, what ground stations call themselves."""

TRIES, ANSWER_S, POLL_S = 5, 0.4, 0.01

RESULTS = {
    dialect.MAV_RESULT_ACCEPTED: "accepted",
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "refused, the present phase has no use for it",
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unsupported",
}


class Operator:
    """Packs commands as a ground station does, and reads what is answered; no input or output."""

    def __init__(self, links: LinksConfig) -> None:
        self._codec = MavlinkCodec(links.gcs_system_id, GCS_COMPONENT_ID)
        self._target = (links.system_id, links.component_id)

    def frame(self, command: Command) -> bytes:
        """Return COMMAND_LONG for the companion."""
        number, param1 = COMMANDS[command]
        parameters = (param1 or 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return self._codec.pack(dialect.MAVLink_command_long_message(*self._target, number, 0, *parameters))

    def result(self, data: bytes, command: Command) -> str | None:
        """Return what the companion said of ``command``, None when ``data`` does not tell."""
        for message, _ in self._codec.feed(data):
            source = (message.get_srcSystem(), message.get_srcComponent())
            answers = message.get_type() == "COMMAND_ACK" and message.command == COMMANDS[command][0]
            if answers and source == self._target:
                return RESULTS.get(message.result, f"refused with result {message.result}")
        return None


def send_command(url: str, command: Command, links: LinksConfig) -> str:
    """Send ``command`` to the companion that listens at ``url`` until it answers; return what it said.

    Raises ConfigError for a link that cannot be opened, and when nobody answers.
    """
    transport, operator = UdpTransport("mavlink", url), Operator(links)
    try:
        for _ in range(TRIES):
            transport.send(operator.frame(command))
            end = time.monotonic() + ANSWER_S
            while time.monotonic() < end:
                for data, _ in transport.poll():
                    result = operator.result(data, command)
                    if result is not None:
                        return result
                time.sleep(POLL_S)
    finally:
        transport.close()
    msg = f"mavlink '{url}': no answer to {command}; is a companion running, and does it listen there?"
    raise ConfigError(msg)
