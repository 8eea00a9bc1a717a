"""For how long something has been so."""

from __future__ import annotations

from companion.messages import NS


class Lasting:
    """Conditions by name, each with the instant since when it has held without a break.

    Time that runs backwards begins anew what it would have made last from the future.
    """

    def __init__(self) -> None:
        self._since_ns: dict[str, int] = {}

    def keep(self, name: str, holds: bool, t_ns: int) -> None:
        """Say whether a condition holds at an instant."""
        if holds:
            self._since_ns[name] = min(t_ns, self._since_ns.get(name, t_ns))
        else:
            self._since_ns.pop(name, None)

    def holds(self, name: str) -> bool:
        """Return whether it held when that was last said."""
        return name in self._since_ns

    def since(self, name: str, t_ns: int) -> float:
        """Return for how many seconds it has held; 0.0 when it does not."""
        return (t_ns - self._since_ns.get(name, t_ns)) * NS

    def lasts(self, name: str, holds: bool, t_ns: int, for_s: float) -> bool:
        """Say whether a condition holds at an instant; return whether it has held for so long, from 0 s on."""
        self.keep(name, holds, t_ns)
        return holds and self.since(name, t_ns) >= for_s

    def forget(self) -> None:
        """Count everything anew from the next ``keep`` on."""
        self._since_ns.clear()
