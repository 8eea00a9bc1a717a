"""The operator of a simulated flight: sends a scenario's commands when their time has come."""

from __future__ import annotations

from companion.config import LinksConfig
from companion.io.operator import Operator
from companion.messages import Command
from sim_bridge.scenario import TimedCommand


class ScheduledOperator:
    """Commands when they are due, and as the bytes that a ground station would put on the link."""

    def __init__(self, links: LinksConfig, commands: tuple[TimedCommand, ...]) -> None:
        self._operator = Operator(links)
        self._pending = sorted(commands, key=lambda c: c.at_s)

    def due(self, t_ns: int) -> list[Command]:
        """Return what is due at ``t_ns`` and has not been given yet."""
        commands = []
        while self._pending and self._pending[0].at_s * 1e9 <= t_ns:
            commands.append(self._pending.pop(0).command)
        return commands

    def frame(self, command: Command) -> bytes:
        """Return a command as it goes out on the link."""
        return self._operator.frame(command)
