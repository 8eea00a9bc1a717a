"""What goes wrong in a flight: the faults of a scenario, and how the command line writes them.

Kinds that every source has; what they do is done on the way to the companion (``gps``: inside the autopilot, before its
navigation), and nothing but the companion's own reaction changes the flight:

============ ============================ ==================== ================= ================= =====================
kind         camera                       datalink             gps               attitude,         heartbeat
                                                                                 position
============ ============================ ==================== ================= ================= =====================
off          nothing comes                nothing              no fix            nothing           nothing
stuck        the same picture again,      the same state,      the same fix,     the same, with    as it was, whatever
             with new stamps              with new stamps      with new stamps   new stamps        the autopilot does
garbage      noise; false lights anywhere 55 random bytes      fixes anywhere    random values,    random bytes
                                                               within 1 km       right checksum
wrong        mirrored left to right       position SIZE (20 m) SIZE (30 m) north roll by SIZE      says MANUAL
                                          north and east off   off               (3 degrees);
                                                                                 SIZE (30 m) north
slow         one of SIZE (10) comes       one of SIZE (10)     one of SIZE (10)  one of SIZE (10)  one of SIZE (10)
delayed      SIZE (0.3 s) later, with     the same             SIZE (0.3 s)      with true stamps  SIZE (0.3 s) later
             true stamps                                       later, stamped
                                                               as new
intermittent 0.2 s there, 0.3 s not       the same             the same          the same          1.2 of each 2.1 s
============ ============================ ==================== ================= ================= =====================

And one by one:

========================= ==============================================================================================
fault                     meaning
========================= ==============================================================================================
camera.late               SIZE (0.3 s) later and stamped as new; so too datalink.late, attitude.late, position.late
camera.shifted            everything SIZE (10 px) to the right
camera.boresight          the camera turns by SIZE (1 degree) up on its mount, so that the companion's mount is wrong
camera.boom               the boom lies over the lens: SIZE (0.4) of the picture's width, in its middle, is grey
lights.one, half, all     the first of the tanker's lights is out, every second, all
lights.moved              the third light is SIZE (1 m) outboard of where the map has it, as when the map is wrong
datalink.height           the tanker tells its height SIZE (5 m) too high: another datum
datalink.velocity         the tanker tells a speed SIZE (5 m/s) too high
datalink.turned           the tanker tells SIZE (3 degrees) of pitch too much
datalink.nan              NaN for position, with a right checksum; so too attitude.nan, position.nan
gps.drag                  fixes are dragged off north at SIZE (0.5 m/s)
link.second_vehicle       another vehicle on the link: heartbeat, attitude, position, and it commands a breakaway
link.forged               somebody with the autopilot's ids sends attitudes too, SIZE (20 degrees) of roll off
clock.backwards           stamps of attitude and position run backwards
clock.step                the clock that stamps all but heartbeats, pictures and the tanker too, steps SIZE (5 s) back
========================= ==============================================================================================

Rules
-----
* A fault begins ``after_s`` seconds after ``phase`` was entered first, or ``from_s`` seconds into the flight, and lasts
  ``for_s``, or to the end.
* Each fault has a stream of chance of its own; a flight without faults keeps its bits.
* Two faults of one source work one after the other, in the order of the scenario.
"""

from __future__ import annotations

import math
import re
from typing import Literal

import msgspec

from companion.config import ConfigError, Struct
from companion.messages import Phase

Target = Literal["camera", "lights", "datalink", "gps", "attitude", "position", "heartbeat", "link", "clock"]

DEGREE = math.pi / 180.0

COMMON: dict[str, float] = {
    "off": 0.0, "stuck": 0.0, "garbage": 0.0, "wrong": 0.0, "slow": 10.0, "delayed": 0.3, "intermittent": 0.0,
}
"""Kinds that every source has, with their SIZE where they have one (0: none)."""

KINDS: dict[str, dict[str, float]] = {
    "camera": {**COMMON, "late": 0.3, "shifted": 10.0, "boresight": DEGREE, "boom": 0.4},
    "lights": {"one": 0.0, "half": 0.0, "all": 0.0, "moved": 1.0},
    "datalink": {**COMMON, "wrong": 20.0, "late": 0.3, "height": 5.0, "velocity": 5.0, "turned": 3.0 * DEGREE,
                 "nan": 0.0},
    "gps": {**COMMON, "wrong": 30.0, "drag": 0.5},
    "attitude": {**COMMON, "wrong": 3.0 * DEGREE, "late": 0.3, "nan": 0.0},
    "position": {**COMMON, "wrong": 30.0, "late": 0.3, "nan": 0.0},
    "heartbeat": COMMON,
    "link": {"second_vehicle": 0.0, "forged": 20.0 * DEGREE},
    "clock": {"backwards": 0.0, "step": 5.0},
}
"""What each target can suffer, and the default SIZE: m, m/s, s, rad, px or a share, as the table says."""

_NUMBER = r"\d+(?:\.\d+)?"
_WRITTEN = re.compile(
    rf"(?P<target>[a-z_]+)\.(?P<kind>[a-z_]+)(?:=(?P<size>-?{_NUMBER}))?"
    rf"(?:@(?:(?P<phase>[a-z_]+)(?:\+(?P<after>{_NUMBER}))?|(?P<start>{_NUMBER})))?(?::(?P<length>{_NUMBER}))?"
)


class Fault(Struct, frozen=True, kw_only=True):
    """One thing that goes wrong, when, and for how long; see the module's tables for ``kind`` and ``size``."""

    target: Target
    kind: str
    phase: Phase | None = None
    after_s: float = 0.0
    from_s: float = 0.0
    for_s: float | None = None
    size: float | None = None

    @property
    def amount(self) -> float:
        """Return ``size``, or the default of the kind."""
        return KINDS[self.target][self.kind] if self.size is None else self.size

    def __str__(self) -> str:
        """Return the fault as the command line writes it."""
        size = "" if self.size is None else f"={self.size:g}"
        begin = f"{self.from_s:g}" if self.phase is None else f"{self.phase}+{self.after_s:g}"
        return f"{self.target}.{self.kind}{size}@{begin}" + ("" if self.for_s is None else f":{self.for_s:g}")


def parse_fault(text: str) -> Fault:
    """Return the fault of ``TARGET.KIND[=SIZE][@PHASE[+SECONDS] | @SECONDS][:SECONDS]``; raises ConfigError."""
    match = _WRITTEN.fullmatch(text)
    if match is None:
        msg = (f"--fault {text}: not like camera.off@hold+5, camera.off@approach+3:2 (for 2 s), gps.wrong=50@40 "
               "(of 50 m, 40 s into the flight)")
        raise ConfigError(msg)
    target, phase = match["target"], match["phase"]
    if target not in KINDS:
        msg = f"--fault {text}: no target '{target}'; there are {', '.join(KINDS)}"
        raise ConfigError(msg)
    if phase is not None and phase not in list(Phase):
        msg = f"--fault {text}: no phase '{phase}'; there are {', '.join(Phase)}"
        raise ConfigError(msg)
    numbers = {"after_s": "after", "from_s": "start", "for_s": "length", "size": "size"}
    given = {name: float(match[group]) for name, group in numbers.items() if match[group] is not None}
    fault = msgspec.convert({"target": target, "kind": match["kind"], "phase": phase, **given}, Fault)
    for holds, rule in fault_rules((fault,)):
        if not holds:
            msg = f"--fault {text}: {rule.partition(': ')[2]}"
            raise ConfigError(msg)
    return fault


def fault_rules(faults: tuple[Fault, ...]) -> list[tuple[bool, str]]:
    """Return what must hold of the faults of a scenario, each with the text for when it does not."""
    return [rule for k, fault in enumerate(faults) for rule in _rules(fault, f"faults[{k}]")]


def _rules(f: Fault, where: str) -> list[tuple[bool, str]]:
    kinds = KINDS[f.target]
    sized = f.kind in kinds and kinds[f.kind] != 0.0
    return [
        (f.kind in kinds, f"{where}: {f.target} has no kind '{f.kind}'; it has {', '.join(kinds)}"),
        (f.size is None or sized, f"{where}: {f.target}.{f.kind} has no size"),
        (f.size is None or abs(f.size) <= 1e4, f"{where}: size must be within 10000"),
        (f.size is None or f.kind not in ("delayed", "late", "boom") or f.size > 0.0,
         f"{where}: size of {f.target}.{f.kind} must be positive"),
        (f.size is None or f.kind != "slow" or f.size >= 1.0, f"{where}: size of {f.target}.slow is one of how many"),
        (f.size is None or f.kind != "boom" or f.size <= 1.0,
         f"{where}: size of camera.boom is a share of the width and must be in 0..1"),
        (f.phase is None or f.from_s == 0.0, f"{where}: either phase with after_s, or from_s, not both"),
        (f.phase is not None or f.after_s == 0.0, f"{where}: after_s counts from a phase; name one, or use from_s"),
        (0.0 <= f.after_s <= 3600.0 and 0.0 <= f.from_s <= 3600.0,
         f"{where}: after_s and from_s must be in 0..3600 seconds"),
        (f.for_s is None or 0.0 < f.for_s <= 3600.0, f"{where}: for_s must be in 0..3600 seconds"),
    ]
