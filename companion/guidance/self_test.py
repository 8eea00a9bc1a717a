"""The engage self-test: the autopilot follows a small doublet in roll, or the receiver does not engage.

Setpoints are never acknowledged (MAVLink), and an autopilot that flies a gain, a sign or a delay of its own is found
out here and not under the tanker. The doublet is banked ``AMPLITUDE_RAD`` to either side of the bank that was there,
then back; it moves the receiver some 0.2 m sideways. What is seen is fitted, for each delay of a grid::

    roll(t) = gain h(t - delay) + a + b t

with h what was sent of the doublet, through the airframe's second-order roll response (``AirframeConfig.response``),
its own delay left to the fit; a and b take what gusts and trim do. The delay with the least residual counts.

Rules
-----
* It passes when the gain is within ``GAIN``, the delay below ``DELAY_MAX_S`` and what the model leaves of the roll is
  at most ``RESIDUAL_MAX`` of what the doublet asked for (RMS against RMS).
* Samples that are missing for ``GAP_S`` fail it: nothing can be said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from companion.config import AttitudeResponse
from companion.geometry import Mat, Vec, euler_from_rotation
from companion.messages import NS, AttitudeSetpoint, Reject, Setpoint

AMPLITUDE_RAD = math.radians(3.0)
SIDE_S = 0.6
WATCH_S = 1.0
"""After the doublet: a delay of ``DELAY_MAX_S`` has to show, and the response behind it."""
DURATION_S = 2.0 * SIDE_S + WATCH_S

GAIN = (0.5, 1.5)
DELAY_MAX_S = 0.5
RESIDUAL_MAX = 0.35
"""Measured: 0.02 to 0.05 in lockstep in moderate turbulence, 0.04 on the wall clock; a machine that stalls adds jitter.
What does not follow fails by gain and delay, whatever the residual."""
GAP_S = 0.3

STEP_S = 0.01
"""Of the grid of time and delays."""


@dataclass(frozen=True, slots=True)
class Follows:
    """How the measured roll follows: see the head of the file. ``fault`` is empty when that is well."""

    gain: float
    delay_s: float
    residual: float
    fault: str

    def __str__(self) -> str:
        """Return what was seen, for people."""
        return f"gain {self.gain:.2f}, delay {self.delay_s:.2f} s, residual {100.0 * self.residual:.0f} %"


def doublet_rad(t_s: float) -> float:
    """Return the roll to ask for beyond the bank that was there, ``t_s`` after the start."""
    if not 0.0 <= t_s < 2.0 * SIDE_S:
        return 0.0
    return AMPLITUDE_RAD if t_s < SIDE_S else -AMPLITUDE_RAD


def modelled(response: AttitudeResponse, sent_s: Vec, sent_rad: Vec) -> Vec:
    """Return the roll (n,) that setpoints (m,) sent at ``sent_s`` (m,) give without delay, every ``STEP_S``."""
    w, damping = response.roll_rad_s, response.roll_damping
    block = np.zeros((3, 3))  # roll, its rate, and the command, held over a step
    block[0, 1] = 1.0
    block[1] = [-w * w, -2.0 * damping * w, w * w]
    step = expm(block * STEP_S)[:2]
    grid_s = np.arange(round(DURATION_S / STEP_S) + 1) * STEP_S
    asked = sent_rad[np.clip(np.searchsorted(sent_s, grid_s + 1e-6, side="right") - 1, 0, None)]
    x, rolls = np.zeros(2), []
    for command in asked:
        rolls.append(x[0])
        x = step @ np.array([*x, command])
    return np.array(rolls)


def fit(t_s: Vec, roll_rad: Vec, model: Vec) -> Follows:
    """Return how the roll (n,) at ``t_s`` (n,) after the start follows ``model`` (``modelled``)."""
    grid_s = np.arange(len(model)) * STEP_S
    drift = np.column_stack([np.ones_like(t_s), t_s])
    best = (math.inf, 0.0, 0.0)
    for delay_s in np.arange(0.0, WATCH_S, STEP_S).tolist():
        basis: Mat = np.column_stack([np.interp(t_s - delay_s, grid_s, model, left=0.0), drift])
        solution = np.linalg.lstsq(basis, roll_rad, rcond=None)[0]
        left = roll_rad - basis @ solution
        best = min(best, (float(left @ left), float(solution[0]), delay_s))
    rms = math.sqrt(best[0] / len(t_s)) / max(math.sqrt(float(model @ model) / len(model)), 1e-9)
    return Follows(best[1], best[2], rms, _fault(best[1], best[2], rms))


def _fault(gain: float, delay_s: float, residual: float) -> str:
    if residual > RESIDUAL_MAX:
        return "not_as_modelled"
    if gain <= -GAIN[0]:
        return "reversed"
    if gain < GAIN[0]:
        return "too_little"
    if gain > GAIN[1]:
        return "too_much"
    return "too_late" if delay_s >= DELAY_MAX_S else ""


class SelfTest:
    """One doublet: ``begin``; then in every step ``setpoint`` and ``sent``; ``result`` when it is over."""

    def __init__(self, response: AttitudeResponse) -> None:
        self._response = response
        self._start_ns: int | None = None

    def begin(self, t_ns: int, R_ned_frd: Mat) -> None:
        """Start about the attitude (3, 3) that is there; its heading does not count."""
        self._start_ns = self._last_ns = t_ns
        _, self._pitch_rad, self._bank_rad = euler_from_rotation(R_ned_frd)
        self._seen: list[tuple[float, float]] = []
        self._sent: list[tuple[float, float]] = []
        self._gap = False
        self._result: Follows | None = None

    def setpoint(self, t_ns: int, R_ned_frd: Mat, thrust: float) -> AttitudeSetpoint:
        """Take the attitude (3, 3) at an instant, return what to ask for."""
        yaw_rad, _, roll_rad = euler_from_rotation(R_ned_frd)
        t_s = self._after_s(t_ns)
        self._gap = self._gap or (t_ns - self._last_ns) * NS > GAP_S
        self._last_ns = t_ns
        self._seen.append((t_s, roll_rad - self._bank_rad))
        return AttitudeSetpoint(t_ns, self._bank_rad + doublet_rad(t_s), self._pitch_rad, yaw_rad, thrust)

    def sent(self, sent: Setpoint | Reject) -> None:
        """Take what the guard let through: the response to that is what is looked for."""
        if isinstance(sent, AttitudeSetpoint):
            self._sent.append((self._after_s(sent.t_ns), sent.roll_rad - self._bank_rad))

    def _after_s(self, t_ns: int) -> float:
        return 0.0 if self._start_ns is None else (t_ns - self._start_ns) * NS

    def result(self, t_ns: int) -> Follows | None:
        """Return how the autopilot follows, None while that is not known yet."""
        if self._start_ns is None or self._after_s(t_ns) < DURATION_S:
            return None
        if self._result is None:
            self._result = self._judged(t_ns)
        return self._result

    def _judged(self, t_ns: int) -> Follows:
        if self._gap or (t_ns - self._last_ns) * NS > GAP_S or not self._sent:
            return Follows(0.0, 0.0, 1.0, "unseen")
        seen, sent = np.array(self._seen), np.array(self._sent)
        return fit(seen[:, 0], seen[:, 1], modelled(self._response, sent[:, 0], sent[:, 1]))
