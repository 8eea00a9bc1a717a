"""Whether a sample can follow on those before it: what no aircraft does is refused, and counted by reason.

Rules
-----
* ``frozen``: content that is the same bit for bit for ``FROZEN_NS``, with new stamps. A sensor's noise never repeats.
* ``velocity_jump``: the velocity changes by more than ``MAX_LOAD_M_S2`` can do, and ``VELOCITY_M_S`` (an INS that gets
  its GPS back corrects itself by a metre per second or two).
* ``position_jump``: the position leaves the one that the velocities carry on by more than ``POSITION_M``. A fix after
  an outage steps by a metre; an estimate that gates does the finer work. While positions jump for longer than
  ``CARRIED_NS``, the velocities are still taken, and the position is carried on by them (``Verdict.carried``).
* ``attitude_jump``, ``rate_jump``: the attitude contradicts the body rates, or the rates change beyond what moments of
  any control do.
* What contradicts, but has agreed with itself for ``BELIEVED_NS``, is how things are now: it is taken again
  (``Verdict.taken``) and counted once as ``jump_believed``. Anything good in between begins that time anew, so what is
  forged between the samples of the real vehicle is never believed.
* After ``ATTITUDE_GAP_S``, ``MOTION_GAP_S`` without any sample there is nothing to contradict. A sample that comes late
  is held against the history about it, and never begins to be believed.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from companion.estimation.alignment import AttitudeHistory, MotionHistory
from companion.geometry import Mat, Vec
from companion.messages import NS

FROZEN_NS = 80_000_000
"""Four attitudes of 50 Hz, the second repeat of a 25 Hz datalink: with the guard's 0.4 s it is within half a second."""
BELIEVED_NS = 500_000_000
CARRIED_NS = 60_000_000
ATTITUDE_GAP_S, MOTION_GAP_S = 0.3, 1.0
"""Body rates carry an attitude on for less long than velocities carry a position: 62 m in 0.3 s is no gust."""
REACH_S = 0.15
"""Bounds grow with the time since the last good sample, but no longer than this: a jump must not pass by waiting."""
MAX_LOAD_M_S2 = 30.0
"""Three g: no tanker or receiver of this mass does more beside the other."""
VELOCITY_M_S = 2.0
POSITION_M = 5.0
OFFSET_TIME_S = 1.0
"""Within this time the position that velocities carry follows the one that is told: a step of a metre is forgotten, a
position that stands still, 4 m in 20 ms, is found with the second sample."""
MAX_TURN_RAD_S2 = 5.0
"""Several times what gusts and controls do to either aircraft."""
RATE_RAD_S = 1.0
ANGLE_RAD = 0.05


class Verdict(msgspec.Struct, frozen=True):
    """``reason`` why a sample is odd (empty: it is not); ``taken``: it counts all the same.

    ``carried``: its velocity counts, at the position that the history carries on.
    """

    reason: str = ""
    taken: bool = True
    carried: bool = False


GOOD = Verdict()
BELIEVED = Verdict("jump_believed")


def refused(reason: str) -> Verdict:
    """Return the verdict on a sample that does not count."""
    return Verdict(reason, taken=False)


class Repetition:
    """Content that comes again and again."""

    def __init__(self) -> None:
        self._content = b""
        self._t_ns = self._since_ns = 0

    def lasts(self, t_ns: int, *content: Vec | Mat) -> bool:
        """Tell whether the content has been the same for ``FROZEN_NS``; stamps that do not rise change nothing."""
        if t_ns <= self._t_ns and self._content:
            return False
        told, self._t_ns = b"".join(array.tobytes() for array in content), t_ns
        if told != self._content:
            self._content, self._since_ns = told, t_ns
        return t_ns - self._since_ns >= FROZEN_NS


class Persistence:
    """How long something that contradicts has agreed with itself: with ``value`` (n,) as it was at first."""

    def __init__(self, within: float) -> None:
        self._within = within
        self._value: Vec | None = None
        self._since_ns = self._t_ns = 0

    def end(self) -> None:
        """Something good has come."""
        self._value = None

    def believed(self, t_ns: int, value: Vec) -> bool:
        """Take the next value that contradicts; True when they have agreed for ``BELIEVED_NS``, and it is over."""
        first = self._value
        goes_on = first is not None and t_ns - self._t_ns <= BELIEVED_NS and size(value - first) <= self._within
        self._t_ns = t_ns
        if not goes_on:
            self._value, self._since_ns = value, t_ns
            return False
        if t_ns - self._since_ns < BELIEVED_NS:
            return False
        self._value = None
        return True


class Silence:
    """How long nothing has come at all, good or bad."""

    def __init__(self, gap_s: float) -> None:
        self._gap_s = gap_s
        self._newest_ns: int | None = None

    def broken(self, t_ns: int) -> bool:
        """Take a stamp; tell whether it is the first one, or the first after a gap without any."""
        last_ns = self._newest_ns
        self._newest_ns = t_ns if last_ns is None else max(t_ns, last_ns)
        return last_ns is None or (t_ns - last_ns) * NS > self._gap_s


class MotionWatch:
    """Judges positions and velocities of one aircraft against its history."""

    def __init__(self) -> None:
        self._silence = Silence(MOTION_GAP_S)
        self._offset_m: Vec | None = None  # position less travel, smoothed: constant while the two agree
        self._position = Persistence(POSITION_M)
        self._velocity = Persistence(VELOCITY_M_S + MAX_LOAD_M_S2 * REACH_S)

    def judge(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec, history: MotionHistory) -> Verdict:
        """Return what is thought of a sample whose stamp has no fault."""
        newest_ns = history.newest_ns or 0
        expected = history.at(t_ns)
        if self._silence.broken(t_ns):
            self._offset_m = None
            return GOOD
        if expected is None:
            return GOOD
        dt_s = min(abs(t_ns - newest_ns) * NS, REACH_S)
        if not size(v_ned_m_s - expected.v_ned_m_s) <= VELOCITY_M_S + MAX_LOAD_M_S2 * dt_s:
            return self._beyond(self._velocity, t_ns, newest_ns, v_ned_m_s, "velocity_jump")
        self._velocity.end()
        offset_m = p_ned_m - expected.travel_m
        known_m = expected.p_ned_m - expected.travel_m if self._offset_m is None else self._offset_m
        if not size(offset_m - known_m) <= POSITION_M + 0.5 * MAX_LOAD_M_S2 * dt_s * dt_s:
            verdict = self._beyond(self._position, t_ns, newest_ns, offset_m, "position_jump")
            if verdict.taken:
                self._offset_m = offset_m
            return verdict if verdict.taken or t_ns - newest_ns <= CARRIED_NS else Verdict(verdict.reason, False, True)
        if t_ns > newest_ns:
            self._position.end()
            self._offset_m = known_m + (1.0 - math.exp(-dt_s / OFFSET_TIME_S)) * (offset_m - known_m)
        return GOOD

    def _beyond(self, persistence: Persistence, t_ns: int, newest_ns: int, value: Vec, reason: str) -> Verdict:
        return BELIEVED if t_ns > newest_ns and persistence.believed(t_ns, value) else refused(reason)


class AttitudeWatch:
    """Judges attitudes and body rates of one aircraft against its history."""

    def __init__(self) -> None:
        self._silence = Silence(ATTITUDE_GAP_S)
        self._turned = Persistence(2.0 * math.sin(0.5 * ANGLE_RAD) * math.sqrt(2.0))
        self._rates = Persistence(RATE_RAD_S)

    def judge(self, t_ns: int, R_ned_body: Mat, omega_body_rad_s: Vec, history: AttitudeHistory) -> Verdict:
        """Return what is thought of a sample whose stamp has no fault."""
        newest_ns = history.newest_ns or 0
        expected = history.at(t_ns)
        if self._silence.broken(t_ns) or expected is None:
            return GOOD
        dt_s = min(abs(t_ns - newest_ns) * NS, REACH_S)
        if not size(omega_body_rad_s - expected.omega_body_rad_s) <= RATE_RAD_S + MAX_TURN_RAD_S2 * dt_s:
            believed = t_ns > newest_ns and self._rates.believed(t_ns, omega_body_rad_s)
            return BELIEVED if believed else refused("rate_jump")
        self._rates.end()
        if not angle_rad(expected.R_ned_body, R_ned_body) <= ANGLE_RAD + 0.5 * MAX_TURN_RAD_S2 * dt_s * dt_s:
            error = (expected.R_ned_body.T @ R_ned_body).ravel()  # constant while rates and attitude agree
            believed = t_ns > newest_ns and self._turned.believed(t_ns, error)
            return BELIEVED if believed else refused("attitude_jump")
        if t_ns > newest_ns:
            self._turned.end()
        return GOOD


def size(a: Vec) -> float:
    """Return the length of a vector."""
    return float(np.sqrt(a @ a))


def angle_rad(Ra: Mat, Rb: Mat) -> float:
    """Return the angle between two rotations (3, 3)."""
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.sum(Ra * Rb)) - 1.0))))
