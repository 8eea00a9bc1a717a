"""The doublet against autopilots that follow it, and against those that do not, in gusts."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FIRMWARE_CONFIGS, AttitudeResponse, load_setup
from companion.geometry import euler_from_rotation, rotation_from_euler
from companion.guidance.self_test import AMPLITUDE_RAD, DURATION_S, SelfTest, doublet_rad
from companion.messages import AttitudeSetpoint, Reject

DT_NS = 20_000_000
FINE_S = 0.002
GUST_RAD, GUST_S = 0.004, 0.5
"""Roll that gusts leave beside what the autopilot does, and how long it lasts: some three times what was measured on
the stand-in autopilot in moderate turbulence (residuals of 0.02 to 0.05 of a doublet whose response is 0.035 RMS)."""


@cache
def response() -> AttitudeResponse:
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "docking.toml").airframe.response


class Autopilot:
    """Roll of second order with gain and delay, on top of it gusts; ``level``: it ignores what it is told."""

    def __init__(self, *, gain=1.0, delay_s=0.04, stiffness=1.0, level=False, bank_rad=0.0, seed=0, gust_rad=0.0):
        self._gain, self._delay, self._level, self._bank = gain, round(delay_s / FINE_S), level, bank_rad
        self._w = response().roll_rad_s * stiffness
        self._roll, self._rate, self._gust = bank_rad, 0.0, 0.0
        self._told = [bank_rad] * (self._delay + 1)
        self._rng = np.random.default_rng(seed)
        self._gust_rad = gust_rad

    def fly(self, setpoint):
        """Fly one guidance period; return the attitude then."""
        for _ in range(round(DT_NS * 1e-9 / FINE_S)):
            told = self._bank if setpoint is None else self._bank + self._gain * (setpoint.roll_rad - self._bank)
            self._told.append(told)
            wanted = self._bank if self._level else self._told.pop(0)
            acceleration = self._w**2 * (wanted - self._roll) - 2.0 * response().roll_damping * self._w * self._rate
            self._rate += FINE_S * acceleration
            self._roll += FINE_S * self._rate
            fade = math.exp(-FINE_S / GUST_S)
            self._gust = fade * self._gust + self._gust_rad * math.sqrt(1.0 - fade**2) * self._rng.standard_normal()
        return rotation_from_euler(0.3, 0.05, self._roll + self._gust)


def judged(autopilot, passes=lambda setpoint: setpoint, missing=range(0)):
    """Run the test to its end; ``passes`` is the guard, ``missing`` the steps without an attitude."""
    test, t_ns = SelfTest(response()), 5_000_000_000
    R = autopilot.fly(None)
    test.begin(t_ns, R)
    for k in range(200):
        result = test.result(t_ns)
        if result is not None:
            assert (t_ns - 5_000_000_000) * 1e-9 == pytest.approx(DURATION_S, abs=0.021)
            return result
        sent = None
        if k not in missing:
            sent = passes(test.setpoint(t_ns, R, 0.4))
            test.sent(sent)
        R = autopilot.fly(sent if isinstance(sent, AttitudeSetpoint) else None)
        t_ns += DT_NS
    raise AssertionError


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.7, 1.3), st.floats(0.0, 0.35), st.floats(-0.25, 0.25))
def test_an_autopilot_that_follows_passes_in_gusts(seed, gain, delay_s, bank_rad):
    seen = judged(Autopilot(gain=gain, delay_s=delay_s, bank_rad=bank_rad, seed=seed, gust_rad=GUST_RAD))
    assert seen.fault == ""
    assert seen.gain == pytest.approx(gain, abs=0.25)
    assert seen.delay_s == pytest.approx(delay_s, abs=0.1)


def test_without_gusts_gain_and_delay_are_what_they_are():
    seen = judged(Autopilot(gain=0.8, delay_s=0.2))
    assert seen.gain == pytest.approx(0.8, abs=0.02)
    assert seen.delay_s == pytest.approx(0.2, abs=0.02)
    assert seen.residual < 0.02
    assert str(seen) == f"gain {seen.gain:.2f}, delay {seen.delay_s:.2f} s, residual {100 * seen.residual:.0f} %"


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0 * GUST_RAD), st.floats(-0.25, 0.25))
def test_gusts_alone_never_pass_for_an_autopilot(seed, gust_rad, bank_rad):
    """Dead means wings level, or whatever bank it likes: the setpoints do nothing."""
    assert judged(Autopilot(level=True, bank_rad=bank_rad, seed=seed, gust_rad=gust_rad)).fault != ""


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("what", "fault"), [
    ({"level": True}, "too_little"),
    ({"gain": -1.0}, "reversed"),
    ({"gain": 0.4}, "too_little"),
    ({"gain": 1.7}, "too_much"),
    ({"delay_s": 0.6}, "too_late"),
    ({"delay_s": 0.7}, "too_late"),
    ({"delay_s": 0.8}, "too_late"),
    ({"stiffness": 0.25}, "too_little"),
])
def test_what_is_wrong_is_told(what, fault, seed):
    assert judged(Autopilot(seed=seed, gust_rad=0.3 * GUST_RAD, **what)).fault == fault


@pytest.mark.parametrize("seed", range(5))
def test_in_a_roll_that_is_not_the_doublets_nothing_can_be_seen(seed):
    assert judged(Autopilot(seed=seed, gust_rad=0.08)).fault == "not_as_modelled"


@pytest.mark.parametrize("seed", range(20))
def test_a_machine_that_stalls_is_not_the_autopilots_fault(seed):
    """In gusts, and from one step in twenty on it holds the last setpoint for up to 0.2 s."""
    rng, held = np.random.default_rng(seed), [None, 0]

    def stalls(setpoint):
        if held[1] == 0 and rng.random() < 0.05:
            held[1] = int(rng.integers(2, 11))
        held[1] = max(0, held[1] - 1)
        held[0] = setpoint if held[1] == 0 or held[0] is None else held[0]
        return setpoint

    class Stalled(Autopilot):
        def fly(self, setpoint):
            return super().fly(held[0] if setpoint is not None else None)

    assert judged(Stalled(seed=seed, gust_rad=GUST_RAD), stalls).fault == ""


def test_half_the_gain_is_too_little():
    assert judged(Autopilot(gain=0.45)).fault == "too_little"


def test_what_the_guard_cuts_is_not_held_against_the_autopilot():
    """The response to what was sent is what counts."""

    def cut(setpoint):
        half = AMPLITUDE_RAD / 2.0
        return AttitudeSetpoint(setpoint.t_ns, max(-half, min(half, setpoint.roll_rad)), setpoint.pitch_rad, 0.0, 0.4)

    assert judged(Autopilot(), cut).gain == pytest.approx(1.0, abs=0.05)


def test_an_attitude_that_is_missing_for_long_tells_nothing():
    assert judged(Autopilot(), missing=range(30, 40)).fault == ""
    assert judged(Autopilot(), missing=range(30, 50)).fault == "unseen"
    assert judged(Autopilot(), missing=range(90, 200)).fault == "unseen"
    assert judged(Autopilot(), lambda s: Reject(s.t_ns, "guard", "none")).fault == "unseen"


@given(st.floats(-1.0, 5.0))
def test_the_doublet_is_small_and_ends_where_it_began(t_s):
    assert abs(doublet_rad(t_s)) in (0.0, AMPLITUDE_RAD)
    if not 0.0 <= t_s < 1.2:
        assert doublet_rad(t_s) == 0.0


def test_the_doublet_moves_the_receiver_little():
    """Sideways by g times the roll, twice integrated: a few decimetres, and no speed that stays."""
    autopilot, test = Autopilot(), SelfTest(response())
    R, t_ns, v, y = autopilot.fly(None), 0, 0.0, 0.0
    test.begin(0, R)
    while test.result(t_ns) is None:
        setpoint = test.setpoint(t_ns, R, 0.4)
        test.sent(setpoint)
        R = autopilot.fly(setpoint)
        v += 9.81 * euler_from_rotation(R)[2] * DT_NS * 1e-9
        y += v * DT_NS * 1e-9
        t_ns += DT_NS
    assert abs(y) < 0.3
    assert abs(v) < 0.05
