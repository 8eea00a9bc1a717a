"""The cells of the fault matrix: what goes wrong in each, and what has to come of it.

Rules
-----
* A cell ends held, in breakaway, in standby when a pilot seems to have taken over, or, with what is wrong from the
  start, in observation: not cleared any farther. Some may end in one of two ways, and say why.
* A breakaway begins within ``REACTION_S`` of its cause, and not before it. What the cause is, a cell says (``Since``):
  mostly the fault itself. A fault that harms nothing at first becomes a cause later, and for every cell there is a
  bound from the fault too (``within_s``).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from companion.config import Vec3

WATCH_S = 6.0
REACTION_S = 0.5
HEARTBEAT_LOST_S = 3.0
"""So long without a heartbeat is what makes an autopilot lost (``GuardConfig.heartbeat_lost_s``)."""
NEAR_M, FARTHER_M = (-33.0, -0.5, 10.7), (-42.0, -3.0, 18.0)
"""Where flights begin, in tanker axes: 4.4 m and 16 m from the box."""
HELD, BREAKAWAY, STANDBY = ("held",), ("breakaway",), ("standby",)
EITHER = (*HELD, *BREAKAWAY)
OBSERVATION = ("observation",)
"""Not cleared any farther."""
UNSEEN = ("sight lost", "integrity failed")
"""Why, when vision gives nothing that could be believed: no pose, or one that guarantees too little."""
BLIND = ("attitude stale", "sight lost")
"""Why, when there is no attitude: without one nothing is looked for in pictures either."""


class Since(StrEnum):
    """From when on a fault is a cause.

    ``fault``: at once, or ``at_s`` later, where nothing comes for so long and what is wrong comes then. ``heartbeat``:
    3 s after the last heartbeat that came. ``reason``: the estimate bears the fault for some time, which depends on
    gusts and noise, and may do so to the end: the cause begins with the last sample or estimate that was taken, or the
    last at which integrity had no fault and protection within its limits, whichever the breakaway's reason names; or,
    if that is earlier, when the estimate of BR is truly off by more than its alert limit.
    """

    FAULT = "fault"
    HEARTBEAT = "heartbeat"
    REASON = "reason"


@dataclass(frozen=True, slots=True)
class Cell:
    """A named flight: ``faults`` as the command line writes them, and how it may end, with the reason.

    ``causes``: how the reason for a breakaway may begin, any when there are none; ``rejects``: what has to be counted.
    ``within_s``: bound from the fault to a breakaway, where it is not ``at_s`` and ``REACTION_S``.
    """

    name: str
    faults: tuple[str, ...]
    ends: tuple[str, ...]
    why: str
    causes: tuple[str, ...] = ()
    since: Since = Since.FAULT
    at_s: float = 0.0
    within_s: float | None = None
    rejects: tuple[str, ...] = ()
    watch_s: float = WATCH_S
    start_tanker_m: Vec3 = NEAR_M

    @property
    def bound_s(self) -> float:
        """Return how long after its fault a breakaway may begin at most."""
        lasting_s = HEARTBEAT_LOST_S if self.since is Since.HEARTBEAT else self.at_s
        return lasting_s + REACTION_S if self.within_s is None else self.within_s


def _cell(fault: str, ends: tuple[str, ...], why: str, *causes: str, name: str = "", **more: Any) -> Cell:
    """Return the cell of one fault, 1 s into the hold unless it says when."""
    when = fault if "@" in fault else f"{fault}@hold+1"
    name = name or fault.partition("@")[0].replace(".", "-")
    return Cell(name, (when,), ends, why, causes, **more)


MATRIX: tuple[Cell, ...] = (
    _cell("camera.off", BREAKAWAY, "nothing is seen any more", "sight lost"),
    _cell("camera.stuck", BREAKAWAY, "a picture that repeats bit for bit is none", "sight lost",
          rejects=("camera.frozen",)),
    _cell("camera.garbage", BREAKAWAY, "no pose explains noise", *UNSEEN),
    _cell("camera.wrong", BREAKAWAY, "a mirrored tanker is none", *UNSEEN),
    _cell("camera.slow", BREAKAWAY, "one picture a second is too few to close in on", "sight lost"),
    _cell("camera.delayed", EITHER, "pictures are put where they belong in time, or what they protect is too old",
          *UNSEEN),
    _cell("camera.intermittent", HELD, "gaps of 0.3 s are bridged by inertial data"),
    _cell("datalink.off", BREAKAWAY, "where the tanker goes is not told any more", "datalink stale"),
    _cell("datalink.stuck", BREAKAWAY, "a tanker that flies does not stand still", "datalink stale"),
    _cell("datalink.garbage", BREAKAWAY, "no checksum holds", "datalink stale"),
    _cell("datalink.wrong", HELD, "vision carries the position"),
    _cell("datalink.slow", BREAKAWAY, "2.5 reports a second are too few", "datalink stale"),
    _cell("datalink.delayed", BREAKAWAY, "a stamp that old when its bytes come is not believed", "datalink stale"),
    _cell("datalink.intermittent", HELD, "gaps of 0.3 s are bridged"),
    _cell("gps.off", HELD, "vision carries the position, the INS the rest"),
    _cell("gps.stuck", HELD, "vision carries the position"),
    _cell("gps.garbage", HELD, "vision carries the position"),
    _cell("gps.wrong", HELD, "vision carries the position"),
    _cell("gps.slow", HELD, "vision carries the position"),
    _cell("gps.delayed", HELD, "vision carries the position"),
    _cell("gps.intermittent", HELD, "vision carries the position"),
    _cell("attitude.off", BREAKAWAY, "without attitude there is no estimate", *BLIND),
    _cell("attitude.stuck", BREAKAWAY, "an attitude that repeats bit for bit is none", *BLIND),
    _cell("attitude.garbage", BREAKAWAY, "no aircraft turns like that", *BLIND),
    _cell("attitude.wrong", BREAKAWAY, "vision and INS disagree about roll", "attitude stale", *UNSEEN),
    _cell("attitude.slow", EITHER, "5 a second are carried on by the body rates; where it turns too fast for that they "
          "are refused, or contradict vision", "attitude stale", *UNSEEN, since=Since.REASON, within_s=WATCH_S),
    _cell("attitude.delayed", BREAKAWAY, "too old to fly on", "estimate lost", *BLIND),
    _cell("attitude.intermittent", EITHER, "gaps of 0.3 s are bridged by the body rates until vision contradicts, when "
          "depends on gusts", *UNSEEN, since=Since.REASON, within_s=WATCH_S),
    _cell("heartbeat.off", BREAKAWAY, "three seconds without one", "autopilot lost", since=Since.HEARTBEAT),
    _cell("heartbeat.stuck", HELD, "it repeats what is true all the same: a fault that changes nothing"),
    _cell("heartbeat.garbage", BREAKAWAY, "no checksum holds", "autopilot lost", since=Since.HEARTBEAT),
    _cell("heartbeat.wrong", STANDBY, "MANUAL is a pilot's: hands off, silence"),
    _cell("heartbeat.slow", BREAKAWAY, "one in ten seconds is too few", "autopilot lost", since=Since.HEARTBEAT),
    _cell("heartbeat.delayed", HELD, "a heartbeat may be late"),
    _cell("heartbeat.intermittent", HELD, "never more than two seconds without one"),
)
"""{camera, datalink, gps, attitude, heartbeat} x {off, stuck, garbage, wrong, slow, delayed, intermittent}."""

MORE: tuple[Cell, ...] = (
    _cell("camera.late", BREAKAWAY, "pictures stamped 0.3 s too new contradict the INS", *UNSEEN, at_s=0.3),
    _cell("camera.shifted", BREAKAWAY, "all lights 10 px aside contradict the INS", *UNSEEN),
    _cell("camera.boresight", BREAKAWAY, "a mount that has turned by 1 degree contradicts the INS", *UNSEEN),
    _cell("camera.boom", HELD, "the boom hides the middle of the picture"),
    _cell("lights.one", HELD, "eight lights are enough"),
    _cell("lights.half", HELD, "four lights are enough to go on"),
    _cell("lights.all", BREAKAWAY, "nothing is seen any more", *UNSEEN),
    _cell("lights.moved", HELD, "a light out of its place is left out"),
    _cell("datalink.late", EITHER, "vision carries the position while the tanker flies evenly; where it does not, old "
          "states contradict vision", "estimate lost", *UNSEEN, since=Since.REASON, within_s=WATCH_S),
    _cell("datalink.height", HELD, "vision carries the position"),
    _cell("datalink.velocity", BREAKAWAY, "velocity, position and vision disagree", "integrity failed",
          "sight lost", "datalink stale"),
    _cell("datalink.turned", BREAKAWAY, "an attitude and a velocity that no tanker could have got so fast",
          "datalink stale"),
    _cell("datalink.nan", BREAKAWAY, "values that are none are refused", "datalink stale",
          rejects=("datalink.not_finite",)),
    _cell("gps.drag", HELD, "vision carries the position"),
    _cell("attitude.late", BREAKAWAY, "attitudes stamped 0.3 s too new contradict vision", *UNSEEN, at_s=0.3),
    _cell("attitude.nan", BREAKAWAY, "values that are none are refused", *BLIND,
          rejects=("mavlink.not_finite",)),
    _cell("position.off", BREAKAWAY, "where the receiver goes is not told any more", "position stale", "sight lost"),
    _cell("position.stuck", BREAKAWAY, "a receiver that flies does not stand still", "position stale", "sight lost"),
    _cell("position.garbage", BREAKAWAY, "no aircraft flies like that", "position stale", "sight lost"),
    _cell("position.wrong", HELD, "vision carries the position"),
    _cell("position.slow", HELD, "5 a second, carried on by the velocity"),
    _cell("position.delayed", BREAKAWAY, "too old to fly on", "estimate lost", "position stale", "sight lost"),
    _cell("position.intermittent", EITHER, "gaps of 0.3 s are bridged; where a gust comes in one, the swing that it "
          "makes is seen", *UNSEEN, since=Since.REASON, within_s=WATCH_S),
    _cell("position.late", BREAKAWAY, "velocities of 0.3 s ago make the estimate swing, at first by less than "
          "matters, until vision contradicts", *UNSEEN, "estimate lost", since=Since.REASON, within_s=2.5),
    _cell("position.nan", BREAKAWAY, "values that are none are refused", "position stale", "sight lost",
          rejects=("mavlink.not_finite",)),
    _cell("link.second_vehicle", HELD, "another system's telemetry and commands are not ours",
          rejects=("mavlink.foreign_source",)),
    _cell("link.forged", HELD, "attitudes that no aircraft could turn to are refused"),
    _cell("clock.backwards", BREAKAWAY, "stamps that go back are refused", *BLIND),
    _cell("clock.step", BREAKAWAY, "what was stamped before cannot be put beside what comes after", "estimate lost",
          "datalink stale"),
    _cell("camera.boresight@0", OBSERVATION, "a mount that is 1 degree off is seen before anybody closes in",
          name="mount-off-at-first", watch_s=15.0, start_tanker_m=FARTHER_M),
    _cell("lights.moved@0", EITHER, "a light that is not where the map has it is left out", *UNSEEN,
          name="map-wrong-at-first", watch_s=22.0, since=Since.REASON, within_s=22.0),
    _cell("datalink.height@0", OBSERVATION, "another height datum is seen before anybody closes in",
          name="height-datum-at-first", watch_s=15.0, start_tanker_m=FARTHER_M),
    _cell("camera.off@approach+1.5", BREAKAWAY, "nothing is seen any more", "sight lost", name="approach-camera-off"),
    _cell("datalink.off@approach+1.5", BREAKAWAY, "where the tanker goes is not told any more",
          "datalink stale", name="approach-datalink-off"),
    _cell("gps.wrong@approach+1.5", EITHER, "vision carries the position; a GPS that contradicts it for long, before "
          "the two have agreed for long, calls it off, since nobody knows which is wrong",
          "integrity failed", since=Since.REASON, within_s=2.5, name="approach-gps-wrong", watch_s=15.0),
    _cell("attitude.off@approach+1.5", BREAKAWAY, "without attitude there is no estimate", *BLIND,
          name="approach-attitude-off"),
)
"""What else goes wrong."""
