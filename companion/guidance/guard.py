"""The guard: what every setpoint passes last. When to break away, it asks ``causes``.

Rules
-----
* A setpoint leaves only when it is finite, of this step, newer than the last one, and rests on an estimate at most
  ``estimate_stale_s`` old. In a breakaway none is needed: its setpoints are absolute (``breakaway``), and one that
  climbs or has more thrust than level flight is cut to that.
* What is merely large is cut, which keeps a saturated law flying: to the envelope, to the closure that is allowed at
  this range, to the rates of change against the last setpoint of its kind: an attitude's and its thrust's, a
  velocity's, also of one that goes with a place to be at. The place itself may jump: what the autopilot makes of it is
  bounded by that velocity and by how far in it may be. What is beyond all sense is refused.
* A setpoint of attitude does not say what closure it asks for: the measured one decides. While the receiver comes
  forward too fast, no more thrust leaves than level flight takes.
* In standby nothing leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from companion.config import AirframeConfig, GuardConfig, GuidanceConfig, WindowConfig
from companion.guidance.causes import CAUSES, Near, View, Watch, allowed_closure_m_s, near_of
from companion.messages import (
    NS,
    AttitudeSetpoint,
    OffsetSetpoint,
    Phase,
    Reject,
    RelativeState,
    Setpoint,
    VelocitySetpoint,
)

__all__ = ["CAUSES", "Envelope", "Guard", "View", "envelope_of"]

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Envelope:
    """What may be asked of the autopilot: |roll|, pitch about ``pitch_trim_rad``, thrust 0..1, age of estimate.

    ``max_speed_m_s``, ``max_acceleration_m_s2`` and ``max_offset_m`` bound velocity and offset setpoints, in length.
    ``trim_thrust``: what level flight takes.
    """

    max_roll_rad: float
    pitch_trim_rad: float
    max_pitch_offset_rad: float
    estimate_stale_s: float
    max_speed_m_s: float = 350.0
    max_offset_m: float = 150.0
    max_acceleration_m_s2: float = 20.0
    trim_thrust: float = 1.0


def envelope_of(config: GuidanceConfig, airframe: AirframeConfig) -> Envelope:
    """Return the envelope of a configuration."""
    return Envelope(
        config.max_roll_rad, airframe.trim.alpha_rad, config.max_pitch_offset_rad, config.estimate_stale_s,
        trim_thrust=airframe.trim.throttle,
    )


def clip(value: float, low: float, high: float) -> float:
    """Return the value inside low..high."""
    return min(high, max(low, value))


class Guard:
    """``cause`` once per guidance step, in every phase; ``passes`` for the setpoint of the step, if there is one."""

    def __init__(self, config: GuardConfig, envelope: Envelope, window: WindowConfig) -> None:
        self._config, self._envelope = config, envelope
        self._watch = Watch(config, window, envelope.pitch_trim_rad)
        self._last: Setpoint | None = None
        self._seen: tuple[RelativeState | None, Near | None] = (None, None)

    def reset(self) -> None:
        """Forget the last setpoint, and since when anything has been wrong: a flight begins.

        Not for a ``TimeStep``: setpoints and causes are timed by our own clock, and clocks that step again and again
        would put every cause off.
        """
        self._watch.reset()
        self._last = None

    def cause(self, view: View) -> str | None:
        """Return why to break away now, one of ``CAUSES`` (and what fails, behind a colon); None without a reason."""
        return self._watch.cause(view, self._near(view.state))

    def _near(self, state: RelativeState | None) -> Near | None:
        """Return ``near_of`` a state, worked out once for all who ask in one step; None without a state."""
        if state is not self._seen[0]:
            self._seen = (state, None if state is None else near_of(state))
        return self._seen[1]

    def passes(self, setpoint: Setpoint, view: View) -> Setpoint | Reject:
        """Return what may leave of a setpoint, or a Reject that says why nothing may."""
        reason = self._refusal(setpoint, view) or ("" if view.phase is Phase.BREAKAWAY else self._blind(view))
        if reason:
            return Reject(view.t_ns, "guard", reason)
        cut = self._cut(setpoint, view)
        if not isinstance(cut, AttitudeSetpoint) and self._refuses(cut):  # by what the estimate says of box and frame
            return Reject(view.t_ns, "guard", "estimate_not_finite")
        self._last = cut
        return cut

    def _refusal(self, setpoint: Setpoint, view: View) -> str:
        """Return why a setpoint must not leave, whatever is known of where we are; empty when it may."""
        if view.phase is Phase.STANDBY:
            return "standby"
        if setpoint.t_ns != view.t_ns:
            return "setpoint_of_another_step"
        if self._last is not None and view.t_ns <= self._last.t_ns:
            return "time_not_forward"
        if view.phase is Phase.BREAKAWAY and not isinstance(setpoint, AttitudeSetpoint):
            return "no_breakaway_setpoint"
        return self._refuses(setpoint)

    def _blind(self, view: View) -> str:
        """Return why the estimate bears no setpoint; empty when it does."""
        state = view.state
        if state is None or not abs(view.t_ns - state.estimate_t_ns) * NS <= self._envelope.estimate_stale_s:
            return "estimate_stale"
        return "estimate_not_finite" if self._near(state) is None else ""

    def _cut(self, setpoint: Setpoint, view: View) -> Setpoint:
        """Return a setpoint that may leave, cut to what it may ask for."""
        e, state = self._envelope, view.state
        near = self._near(state)
        allowed_m_s = 0.0 if near is None else allowed_closure_m_s(self._config, near.range_m)
        if isinstance(setpoint, AttitudeSetpoint):
            if view.phase is Phase.BREAKAWAY:
                level = min(setpoint.pitch_rad, e.pitch_trim_rad)
                return self._attitude(replace(setpoint, pitch_rad=level), e.trim_thrust)
            fast = near is not None and near.forward_m_s > allowed_m_s
            return self._attitude(setpoint, e.trim_thrust if fast else 1.0)
        assert state is not None  # _blind has seen to that
        assert near is not None
        frame = Frame(state, near, allowed_m_s)
        if isinstance(setpoint, VelocitySetpoint):
            return self._velocity(setpoint, frame)
        return self._offset(setpoint, frame)

    def _attitude(self, setpoint: AttitudeSetpoint, max_thrust: float) -> AttitudeSetpoint:
        """Return an attitude inside the envelope, and not farther from the last one than the rates allow."""
        e, c = self._envelope, self._config
        low, high = e.pitch_trim_rad - e.max_pitch_offset_rad, e.pitch_trim_rad + e.max_pitch_offset_rad
        roll = clip(setpoint.roll_rad, -e.max_roll_rad, e.max_roll_rad)
        pitch = clip(setpoint.pitch_rad, low, high)
        thrust = clip(setpoint.thrust, 0.0, max_thrust)
        last = self._last
        if isinstance(last, AttitudeSetpoint):
            dt_s = (setpoint.t_ns - last.t_ns) * NS
            roll = toward(last.roll_rad, roll, c.roll_rate_rad_s * dt_s)
            pitch = toward(last.pitch_rad, pitch, c.pitch_rate_rad_s * dt_s)
            thrust = toward(last.thrust, thrust, c.thrust_rate_per_s * dt_s)
        return AttitudeSetpoint(setpoint.t_ns, roll, pitch, math.remainder(setpoint.yaw_rad, 2.0 * math.pi), thrust)

    def _refuses(self, setpoint: Setpoint) -> str:
        """Return what is wrong with the numbers of a setpoint; empty when they are finite and of a sensible size.

        Angles and thrust have no size that would be senseless: they are cut.
        """
        if not all(map(math.isfinite, _numbers(setpoint))):
            return "setpoint_not_finite"
        e = self._envelope
        if isinstance(setpoint, AttitudeSetpoint):
            return ""
        if isinstance(setpoint, VelocitySetpoint):
            size, largest = math.hypot(*setpoint.a_ned_m_s2), e.max_acceleration_m_s2
        else:
            size, largest = math.hypot(*setpoint.offset_ned_m), e.max_offset_m
        fast = math.hypot(*setpoint.v_ned_m_s) > e.max_speed_m_s
        return "setpoint_outside_envelope" if fast or size > largest else ""

    def _velocity(self, setpoint: VelocitySetpoint, frame: Frame) -> VelocitySetpoint:
        """Return a velocity that changes and closes in no faster than it may; where both cannot be, closure counts."""
        v = self._followed(setpoint)
        slowed = frame.slowed(v)
        return replace(setpoint, v_ned_m_s=slowed) if slowed is v else replace(
            setpoint, v_ned_m_s=slowed, a_ned_m_s2=(0.0, 0.0, 0.0)  # nor does it speed up again
        )

    def _followed(self, setpoint: VelocitySetpoint | OffsetSetpoint) -> Triple:
        """Return a velocity, not farther from the last one of its kind than ``max_acceleration_m_s2`` allows."""
        last = self._last
        if isinstance(last, AttitudeSetpoint) or type(last) is not type(setpoint):
            return setpoint.v_ned_m_s
        step = self._envelope.max_acceleration_m_s2 * (setpoint.t_ns - last.t_ns) * NS
        return within(setpoint.v_ned_m_s, last.v_ned_m_s, step)

    def _offset(self, setpoint: OffsetSetpoint, frame: Frame) -> OffsetSetpoint:
        """Return a place to be at that neither comes too fast nor is farther in than a few seconds of closure."""
        v = frame.slowed(self._followed(setpoint))
        return replace(
            setpoint, v_ned_m_s=v, offset_ned_m=frame.shortened(setpoint.offset_ned_m, self._config.offset_horizon_s)
        )


class Frame:
    """The psi frame at one step, to cut vectors in ``ned`` to the closure that is allowed.

    Closing in is along the way to the box, and forward (``causes.Near``).
    """

    def __init__(self, state: RelativeState, near: Near, allowed_m_s: float) -> None:
        self._c, self._s = math.cos(state.heading0_rad), math.sin(state.heading0_rad)
        self._near, self._allowed_m_s = near, allowed_m_s
        v_n, v_e, v_d = state.v_ned_box_m_s.tolist()
        x, y, _ = near.p_m
        turn = state.turn_rate_rad_s
        across_n, across_e = self._ned(-y * turn, x * turn)
        self._v_frame = (v_n + across_n, v_e + across_e, v_d)  # of what stands still in the frame where R is

    def _ned(self, x: float, y: float) -> tuple[float, float]:
        return self._c * x - self._s * y, self._s * x + self._c * y

    def slowed(self, v_ned_m_s: Triple) -> Triple:
        """Return a velocity without what it closes in too fast."""
        f = self._v_frame
        relative = (v_ned_m_s[0] - f[0], v_ned_m_s[1] - f[1], v_ned_m_s[2] - f[2])
        cut = self._cut(relative, self._allowed_m_s)
        return v_ned_m_s if cut is relative else (cut[0] + f[0], cut[1] + f[1], cut[2] + f[2])

    def shortened(self, offset_ned_m: Triple, horizon_s: float) -> Triple:
        """Return an offset without what is farther in than the allowed closure takes it in so many seconds."""
        return self._cut(offset_ned_m, self._allowed_m_s * horizon_s)

    def _cut(self, ned: Triple, largest: float) -> Triple:
        """Return a vector whose parts along the way, and forward, are at most so large; itself when they are."""
        n, e, d = ned
        x, y = self._c * n + self._s * e, self._c * e - self._s * n
        way = self._near.way
        excess = x * way[0] + y * way[1] + d * way[2] - largest
        if excess <= 0.0 and x <= largest:
            return ned
        if excess > 0.0:
            x, y, d = x - excess * way[0], y - excess * way[1], d - excess * way[2]
        x = min(x, largest)  # the way never leads backwards, so this only slows what is along it
        return (*self._ned(x, y), d)


def toward(last: float, wanted: float, step: float) -> float:
    """Return what is wanted, at most a step away from the last."""
    return clip(wanted, last - step, last + step)


def within(v: Triple, last: Triple, step: float) -> Triple:
    """Return a vector, at most a step in length away from the last."""
    d = (v[0] - last[0], v[1] - last[1], v[2] - last[2])
    length = math.hypot(*d)
    if length <= step:
        return v
    share = step / length
    return (last[0] + share * d[0], last[1] + share * d[1], last[2] + share * d[2])


def _numbers(setpoint: Setpoint) -> tuple[float, ...]:
    if isinstance(setpoint, AttitudeSetpoint):
        return (setpoint.roll_rad, setpoint.pitch_rad, setpoint.yaw_rad, setpoint.thrust)
    more = setpoint.a_ned_m_s2 if isinstance(setpoint, VelocitySetpoint) else setpoint.offset_ned_m
    return (*setpoint.v_ned_m_s, *more, setpoint.yaw_rad)
