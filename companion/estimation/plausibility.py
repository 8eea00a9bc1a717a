"""Whether a sample can follow on those before it: what no aircraft does is refused, and counted by reason.

Rules
-----
* ``frozen``: content that is the same bit for bit for ``FROZEN_NS``, with new stamps. A sensor's noise never repeats.
* ``velocity_jump``: the velocity changes by more than ``MAX_LOAD_M_S2`` can do, and ``VELOCITY_M_S`` for the noise. An
  INS that corrects itself by more at once is believed like any jump: what has been flown by then is not known.
* ``position_jump``: the position leaves the one that the velocities carry on by more than ``POSITION_M``. A fix after
  an outage steps by a metre; an estimate that gates does the finer work. While positions jump for longer than
  ``CARRIED_NS``, the velocities are still taken, and the position is carried on by them (``Verdict.carried``).
* ``attitude_jump``, ``rate_jump``: the attitude contradicts the body rates, or the rates change beyond what gusts and
  controls do to this aircraft (``Agility``).
* What is let through is not seen to be wrong before the next picture: integrity counts with it (``LET_THROUGH_*``).
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
"""Bounds grow with the time since the last sample, good or bad, but no longer than this: nothing passes by waiting."""
MAX_LOAD_M_S2 = 15.0
"""One and a half g beyond the acceleration of the last moments: no tanker or receiver does more beside the other."""
VELOCITY_M_S = 0.6
"""In severe turbulence velocities with the thesis' noise leave the ones foretold by 0.3 m/s at most."""
POSITION_M = 5.0
OFFSET_TIME_S = 1.0
"""Within this time the position that velocities carry follows the one that is told: a step of a metre is forgotten, a
position that stands still, 4 m in 20 ms, is found with the second sample."""
ANGLE_RAD = 0.004
"""Attitudes leave the ones that body rates foretell by 0.001 rad at most, in severe turbulence too. On the box's lever
of 27 m this is 0.11 m."""
SAME_ANGLE_RAD, SAME_RATE_RAD_S, SAME_VELOCITY_M_S = 0.05, 1.0, 6.5
"""How well what contradicts has to agree with itself to be believed."""


class Agility(msgspec.Struct, frozen=True):
    """What an aircraft does: change of body rates from sample to sample, and per second of time."""

    rate_rad_s: float
    turn_rad_s2: float


RECEIVER = Agility(0.3, 5.0)
TANKER = Agility(0.05, 1.0)
"""Severe turbulence: 0.11 rad/s in 20 ms, the tanker 0.009 rad/s in 40 ms; several times that."""

REPORT_S = 0.04
LET_THROUGH_M_S = VELOCITY_M_S + MAX_LOAD_M_S2 * REPORT_S
LET_THROUGH_RAD = ANGLE_RAD + 0.5 * TANKER.turn_rad_s2 * REPORT_S**2
"""What the datalink's velocity and attitude may be off by at once without being seen here, at 25 reports a second."""


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

    def shift(self, step_ns: int) -> None:
        """Move what was noted in time."""
        self._t_ns, self._since_ns = self._t_ns + step_ns, self._since_ns + step_ns


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

    def shift(self, step_ns: int) -> None:
        """Move what was noted in time."""
        self._t_ns, self._since_ns = self._t_ns + step_ns, self._since_ns + step_ns


class Silence:
    """How long nothing has come at all, good or bad. ``age_s``: since the sample before the one that was taken last."""

    def __init__(self, gap_s: float) -> None:
        self._gap_s = gap_s
        self._newest_ns: int | None = None
        self.age_s = 0.0

    def broken(self, t_ns: int) -> bool:
        """Take a stamp; tell whether it is the first one, or the first after a gap without any."""
        last_ns = self._newest_ns
        self._newest_ns = t_ns if last_ns is None else max(t_ns, last_ns)
        self.age_s = 0.0 if last_ns is None else abs(t_ns - last_ns) * NS
        return last_ns is None or (t_ns - last_ns) * NS > self._gap_s

    def shift(self, step_ns: int) -> None:
        """Move what was noted in time."""
        self._newest_ns = None if self._newest_ns is None else self._newest_ns + step_ns


class MotionWatch:
    """Judges positions and velocities of one aircraft against its history."""

    def __init__(self) -> None:
        self._silence = Silence(MOTION_GAP_S)
        self._offset_m: Vec | None = None  # position less travel, smoothed: constant while the two agree
        self._position = Persistence(POSITION_M)
        self._velocity = Persistence(SAME_VELOCITY_M_S)

    def shift(self, step_ns: int) -> None:
        """Move what was noted in time, as its history is: the next sample is judged like any other."""
        for noted in (self._silence, self._position, self._velocity):
            noted.shift(step_ns)

    def judge(self, t_ns: int, p_ned_m: Vec, v_ned_m_s: Vec, history: MotionHistory) -> Verdict:
        """Return what is thought of a sample whose stamp has no fault."""
        newest_ns = history.newest_ns or 0
        expected = history.at(t_ns)
        if self._silence.broken(t_ns):
            self._offset_m = None
            return GOOD
        if expected is None:
            return GOOD
        dt_s = min(self._silence.age_s, REACH_S)
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

    def __init__(self, agility: Agility) -> None:
        self._agility = agility
        self._silence = Silence(ATTITUDE_GAP_S)
        self._turned = Persistence(2.0 * math.sin(0.5 * SAME_ANGLE_RAD) * math.sqrt(2.0))
        self._rates = Persistence(SAME_RATE_RAD_S)

    def shift(self, step_ns: int) -> None:
        """Move what was noted in time, as its history is: the next sample is judged like any other."""
        for noted in (self._silence, self._turned, self._rates):
            noted.shift(step_ns)

    def judge(self, t_ns: int, R_ned_body: Mat, omega_body_rad_s: Vec, history: AttitudeHistory) -> Verdict:
        """Return what is thought of a sample whose stamp has no fault."""
        newest_ns = history.newest_ns or 0
        expected = history.at(t_ns)
        if self._silence.broken(t_ns) or expected is None:
            return GOOD
        dt_s, turn = min(self._silence.age_s, REACH_S), self._agility.turn_rad_s2
        if not size(omega_body_rad_s - expected.omega_body_rad_s) <= self._agility.rate_rad_s + turn * dt_s:
            believed = t_ns > newest_ns and self._rates.believed(t_ns, omega_body_rad_s)
            return BELIEVED if believed else refused("rate_jump")
        self._rates.end()
        if not angle_rad(expected.R_ned_body, R_ned_body) <= ANGLE_RAD + 0.5 * turn * dt_s * dt_s:
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
