"""What can follow on what was before, for both aircraft, by what ``Aircraft`` keeps and says."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import FusionConfig
from companion.estimation.aircraft import Aircraft
from companion.estimation.plausibility import BELIEVED_NS, FROZEN_NS, Repetition
from companion.geometry import SE3, exp_so3, rotation_from_euler
from companion.messages import OwnAttitude, OwnPosition, TankerState, TimeStep

MS = 1_000_000
S = 1_000 * MS
V0 = np.array([206.0, 3.0, -1.0])
TURN = np.array([0.0, 0.01, 0.02])


class Flown:
    """A gentle turn with the noise of the thesis' sensors, told to an ``Aircraft`` with something done to it."""

    def __init__(self, seed=1, aircraft=None):
        self.rng = np.random.default_rng(seed)
        self.aircraft = aircraft or Aircraft(FusionConfig(), SE3(np.eye(3), np.zeros(3)))
        self.told = Counter()

    def sample(self, t_ns):
        t, noise = t_ns / S, self.rng.normal(size=(4, 3))
        v = V0 + np.array([0.0, 2.0, 0.3]) * t
        p = V0 * t + 0.5 * np.array([0.0, 2.0, 0.3]) * t * t
        R = rotation_from_euler(0.3, 0.05, 0.2) @ exp_so3(TURN * t + 1e-4 * noise[2])
        return p + 0.1 * noise[0], v + 0.04 * noise[1], R, TURN + 4e-4 * noise[3]

    def position(self, t_ns, change=lambda p, v: (p, v)):
        p, v, _, _ = self.sample(t_ns)
        return self._note(self.aircraft.own_position_event(OwnPosition(t_ns, *change(p, v))))

    def attitude(self, t_ns, change=lambda R, w: (R, w)):
        _, _, R, w = self.sample(t_ns)
        return self._note(self.aircraft.own_attitude_event(OwnAttitude(t_ns, *change(R, w))))

    def tanker(self, t_ns, change=lambda *x: x):
        return self._note(self.aircraft.tanker_event(TankerState(t_ns, *change(*self.sample(t_ns)))))

    def _note(self, reject):
        reason = "" if reject is None else reject.reason
        self.told[reason] += 1
        return reason

    def until(self, tell, end_ns, *, start_ns=0, every_ms=20, **change):
        for t_ns in range(start_ns, end_ns, every_ms * MS):
            tell(t_ns, **change)


def error_m(flown, history, t_ns):
    truth = V0 * (t_ns / S) + 0.5 * np.array([0.0, 2.0, 0.3]) * (t_ns / S) ** 2
    return float(np.linalg.norm(history.at(t_ns).p_ned_m - truth))


@settings(max_examples=25)
@given(st.integers(0, 1000), st.sampled_from([10, 20, 40, 100, 200, 1000]))
def test_what_flies_is_believed_at_any_rate(seed, every_ms):
    f = Flown(seed)
    for tell in (f.position, f.attitude, f.tanker):
        f.until(tell, 3 * S, every_ms=every_ms)
    assert set(f.told) == {""}


@pytest.mark.parametrize("kind", ["position", "attitude", "tanker"])
@pytest.mark.parametrize("every_ms", [20, 40])
def test_frozen_content_with_new_stamps_is_refused_after_a_fifth_of_a_second(kind, every_ms):
    f = Flown()
    tell, kept = getattr(f, kind), []
    f.until(tell, S, every_ms=every_ms)
    f.told.clear()

    def stuck(*content):
        kept.append(content)
        return kept[0]

    f.until(tell, 3 * S, start_ns=S, every_ms=every_ms, change=stuck)
    newest_ns = getattr(f.aircraft, f"{kind}_ns")
    assert newest_ns < S + FROZEN_NS
    assert f.told["frozen"] == (2 * S - FROZEN_NS) // (every_ms * MS)
    assert set(f.told) <= {"", "frozen", "position_jump"}
    assert tell(3 * S) in ("", "jump_believed", "position_jump")  # it lives again


def test_a_position_that_stands_still_is_found_with_the_second_sample():
    f = Flown()
    f.until(f.position, S)
    stood = f.sample(S)[0]
    f.told.clear()
    f.until(f.position, 3 * S, start_ns=S, change=lambda p, v: (stood, v))
    assert f.told[""] <= 2
    assert "jump_believed" not in f.told
    assert error_m(f, f.aircraft.own_motion, 2 * S) < 8.0  # carried on by the velocities
    assert f.aircraft.position_ns >= 3 * S - 100 * MS


@given(st.integers(0, 1000), st.floats(-4.0, 4.0))
def test_a_fix_after_an_outage_may_step_by_metres(seed, step_m):
    f = Flown(seed)
    f.until(f.position, S)
    f.until(f.position, 2 * S, start_ns=S, change=lambda p, v: (p + np.array([0.0, step_m, 0.0]), v))
    assert set(f.told) == {""}


@pytest.mark.parametrize("step_m", [8.0, 50.0, -1000.0])
@pytest.mark.parametrize("kind", ["position", "tanker"])
def test_a_position_that_jumps_and_stays_is_carried_and_then_believed_and_counted(kind, step_m):
    f = Flown()
    tell, motion = getattr(f, kind), f.aircraft.own_motion if kind == "position" else f.aircraft.tanker_motion
    f.until(tell, S, every_ms=40)
    f.told.clear()

    def jumped(p, v, *rest):
        return (p + np.array([0.0, 0.0, step_m]), v, *rest)

    for t_ns in range(S, 2 * S, 40 * MS):
        tell(t_ns, jumped)
        if t_ns < S + BELIEVED_NS:
            assert error_m(f, motion, t_ns) < 1.0
            assert getattr(f.aircraft, f"{kind}_ns") >= t_ns - 40 * MS
    assert f.told["jump_believed"] == 1
    assert f.told["position_jump"] == pytest.approx(BELIEVED_NS // (40 * MS), abs=2)
    assert error_m(f, motion, 2 * S) == pytest.approx(abs(step_m), abs=1.0)


def test_what_is_forged_between_the_real_samples_is_never_believed():
    f = Flown()
    f.until(f.position, S)
    f.told.clear()
    for t_ns in range(S, 6 * S, 20 * MS):
        assert f.position(t_ns - MS, lambda p, v: (p + 100.0, v)) == "position_jump"
        assert f.position(t_ns) == ""
    assert error_m(f, f.aircraft.own_motion, 6 * S) < 0.5


def test_garbage_that_never_agrees_with_itself_is_never_believed():
    f, rng = Flown(), np.random.default_rng(3)
    f.until(f.position, S)
    f.told.clear()
    for t_ns in range(S, 6 * S, 20 * MS):
        f.position(t_ns, lambda p, v: (p + rng.normal(size=3) * 500.0, v))
    assert f.told[""] + f.told["jump_believed"] <= 2
    assert error_m(f, f.aircraft.own_motion, 6 * S) < 6.0  # 5 s on velocities alone


@given(st.floats(8.0, 300.0), st.integers(0, 100))
def test_no_aircraft_changes_its_velocity_at_once(jump_m_s, seed):
    f = Flown(seed)
    f.until(f.position, S)
    before = f.aircraft.own_motion.newest_ns
    assert f.position(S, lambda p, v: (p, v + np.array([0.0, 0.0, jump_m_s]))) == "velocity_jump"
    assert f.aircraft.own_motion.newest_ns == before
    assert f.position(S + 20 * MS) == ""


@pytest.mark.parametrize("jump_m_s", [2.0, 3.0, 5.0, -12.0])
def test_a_tanker_that_tells_another_speed_is_never_believed_by_waiting(jump_m_s):
    """The bound grows with a silence, not while what contradicts goes on: 5 m/s were believed with the third report."""
    f = Flown()
    f.until(f.tanker, S, every_ms=40)
    for t_ns in range(S, S + BELIEVED_NS, 40 * MS):
        assert f.tanker(t_ns, lambda p, v, *rest: (p, v + np.array([jump_m_s, 0.0, 0.0]), *rest)) == "velocity_jump"
    assert f.aircraft.tanker_ns == S - 40 * MS


@pytest.mark.parametrize("angle_rad", [0.01, 0.03, 0.052])
@pytest.mark.parametrize("kind", ["attitude", "tanker"])
def test_half_a_degree_at_once_is_no_attitude_that_follows(kind, angle_rad):
    """On the box's lever of 27 m it is a quarter of a metre, before any picture can say so."""
    f = Flown()
    tell, at, every = getattr(f, kind), 0 if kind == "attitude" else 2, 20 if kind == "attitude" else 40
    f.until(tell, S, every_ms=every)

    def turned(*content):
        return tuple(c @ exp_so3(np.array([0.0, angle_rad, 0.0])) if k == at else c for k, c in enumerate(content))

    f.told.clear()
    f.until(tell, S + BELIEVED_NS, start_ns=S, every_ms=every, change=turned)
    assert set(f.told) == {"attitude_jump"}


def test_body_rates_that_no_tanker_has_are_refused():
    f = Flown()
    f.until(f.tanker, S, every_ms=40)
    assert f.tanker(S, lambda p, v, R, w: (p, v, R, w + np.array([0.0, 0.15, 0.0]))) == "rate_jump"
    assert f.tanker(S + 40 * MS) == ""


def test_three_g_are_believed():
    f = Flown()
    f.until(f.position, S)
    for k in range(50):
        t = 0.02 * k
        pull = np.array([0.0, 0.0, -29.0])
        assert f.position(S + k * 20 * MS, lambda p, v, t=t, a=pull: (p + 0.5 * a * t * t, v + a * t)) == ""


@given(st.floats(0.2, 3.1), st.integers(0, 100))
def test_no_attitude_jumps_against_its_rates(angle, seed):
    f = Flown(seed)
    f.until(f.attitude, S)
    axis = f.rng.normal(size=3)
    turn = exp_so3(angle * axis / np.linalg.norm(axis))
    assert f.attitude(S, lambda R, w: (R @ turn, w)) == "attitude_jump"
    assert f.attitude(S + 20 * MS, lambda R, w: (R, w + np.array([0.0, 4.0, 0.0]))) == "rate_jump"
    assert f.attitude(S + 40 * MS) == ""


def test_an_attitude_that_is_set_anew_and_stays_is_believed_and_counted():
    f = Flown()
    f.until(f.attitude, S)
    f.told.clear()
    yawed = rotation_from_euler(1.0, 0.0, 0.0)
    f.until(f.attitude, 2 * S, start_ns=S, change=lambda R, w: (yawed @ R, w))
    assert f.told["jump_believed"] == 1
    assert f.told["attitude_jump"] == BELIEVED_NS // (20 * MS)


def test_hard_rolling_is_no_jump():
    f = Flown()
    f.until(f.attitude, S)
    R0, rate, roll = f.aircraft.own_attitude.at(S).R_ned_body, 0.0, 0.0
    for k in range(100):
        rate += 0.02 * 3.0 * math.cos(0.1 * k)  # 3 rad/s^2
        roll += 0.02 * rate
        w = np.array([rate, 0.0, 1e-6 * k])
        assert f.attitude(S + k * 20 * MS, lambda R, _, x=roll, w=w: (R0 @ exp_so3(np.array([x, 0.0, 0.0])), w)) == ""


@pytest.mark.parametrize("kind", ["position", "attitude", "tanker"])
def test_nan_that_gets_in_is_refused(kind):
    """Adapters let none through; were one to come, it would poison every estimate after it."""
    f = Flown()
    tell = getattr(f, kind)
    f.until(tell, S)
    assert tell(S, lambda *content: tuple(c * math.nan for c in content)) != ""
    assert getattr(f.aircraft, f"{kind}_ns") == S - 20 * MS


def test_order_duplicates_and_time_that_runs_backwards():
    f = Flown()
    f.until(f.position, 4 * S, every_ms=40)
    assert f.position(4 * S - 40 * MS) == "duplicate"
    assert f.position(4 * S - 60 * MS) == ""  # late, and in between
    assert f.position(4 * S - 60 * MS) == "duplicate"
    assert f.position(4 * S - 100 * MS, lambda p, v: (p + 50.0, v)) == "position_jump"  # late, and wrong
    assert f.position(S // 2) == "time_not_forward"
    assert [f.position(t_ns) for t_ns in range(S // 2, 0, -20 * MS)] == ["time_not_forward"] * 25
    assert f.aircraft.position_ns == 4 * S - 40 * MS


@given(st.permutations(range(10)))
def test_samples_out_of_order_are_all_taken(order):
    f = Flown()
    f.until(f.tanker, S, every_ms=40)
    for k in order:
        assert f.tanker(S + k * 40 * MS) == ""
    assert f.aircraft.tanker_ns == S + 9 * 40 * MS
    assert error_m(f, f.aircraft.tanker_motion, f.aircraft.tanker_ns) < 0.6


def test_a_step_of_time_begins_anew_and_remembers_how_new_the_newest_was():
    f = Flown()
    for tell in (f.position, f.attitude, f.tanker):
        f.until(tell, S)
    f.aircraft.time_step_event(TimeStep(S, "mavlink", -5 * S))
    assert f.aircraft.align(S) is None
    assert (f.aircraft.position_ns, f.aircraft.attitude_ns, f.aircraft.tanker_ns) == (S - 20 * MS,) * 3
    assert f.position(S - 5 * S) == ""
    assert f.aircraft.position_ns == -4 * S


@pytest.mark.parametrize("kind", ["position", "attitude", "tanker"])
def test_the_first_sample_after_a_continuous_step_is_judged_like_any_other(kind):
    f, step_ns = Flown(), 3 * S
    tell = getattr(f, kind)
    f.until(tell, S)
    f.aircraft.time_step_event(TimeStep(S, "mavlink", step_ns, continuous=True))
    sample = f.sample
    f.sample = lambda t_ns: sample(t_ns - step_ns)
    wild = {"position": lambda p, v: (p, v + 20.0), "attitude": lambda R, w: (R @ exp_so3(np.full(3, 0.2)), w),
            "tanker": lambda p, v, R, w: (p + 900.0, v, R, w)}[kind]
    assert tell(S + step_ns, wild) in ("velocity_jump", "attitude_jump", "position_jump")
    assert tell(S + step_ns + 20 * MS) == ""


@given(st.lists(st.tuples(st.integers(0, 3), st.booleans()), min_size=1, max_size=30))
def test_repetition_lasts_from_its_first_stamp(steps):
    repetition, t_ns, since_ns, last = Repetition(), 0, 0, None
    for k, (jump, same) in enumerate(steps):
        t_ns += (1 + jump) * 50 * MS
        content = last if same and last is not None else k
        if content != last:
            last, since_ns = content, t_ns
        assert repetition.lasts(t_ns, np.full(3, float(content))) == (t_ns - since_ns >= FROZEN_NS)
