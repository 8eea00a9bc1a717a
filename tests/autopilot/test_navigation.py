"""Dead reckoning: exact without noise, and no worse than the fix with it."""

import msgspec
import numpy as np
import pytest
from level_flight import STEP_NS, Quiet, state_at

from sim_bridge.autopilot.navigation import HISTORY_NS, DeadReckoner
from sim_bridge.sensors import GpsFix, GpsSensor, InertialSensor
from sim_bridge.truth import BodyState


def weaving_flight(steps: int) -> list[BodyState]:
    """Fly a weave whose position is the trapezoidal integral of its velocity, as the plant's is."""
    truth, p, v_old = [], np.array([5.0, -3.0, -100.0]), None
    for k in range(steps):
        t = k * STEP_NS * 1e-9
        v = np.array([205.0, 8.0 * np.sin(1.3 * t), 3.0 * np.cos(2.1 * t)])
        p = p if v_old is None else p + 0.5e-9 * STEP_NS * (v + v_old)
        truth.append(msgspec.structs.replace(state_at(k * STEP_NS), p_ned_m=p, v_ned_m_s=v))
        v_old = v
    return truth


def test_position_is_exact_at_its_stamp_without_noise() -> None:
    inertial, gps, navigation = InertialSensor(Quiet()), GpsSensor(Quiet()), DeadReckoner()
    known = 0
    for truth in weaving_flight(1000):
        p = navigation.update(inertial.sample(truth), gps.sample(truth))
        if p is not None:
            np.testing.assert_allclose(p, truth.p_ned_m, atol=1e-8)
            known += 1
    assert known == 1000 - 20  # all but the 0.1 s before the first fix arrives
    assert navigation.late_fixes == 0


def test_error_is_the_fixes_own_plus_little_from_the_velocity() -> None:
    truths = weaving_flight(6000)
    inertial, gps = InertialSensor(np.random.default_rng(1)), GpsSensor(np.random.default_rng(2))
    navigation, truth_at, errors, drift, fix_error = DeadReckoner(), {}, [], [], np.zeros(3)
    for truth in truths:
        truth_at[truth.t_ns] = truth.p_ned_m
        fix = gps.sample(truth)
        p = navigation.update(inertial.sample(truth), fix)
        if fix is not None:
            fix_error = np.array(fix.p_ned_m) - truth_at[fix.t_ns]
        if p is not None:
            errors.append(np.array(p) - truth.p_ned_m)
            drift.append(errors[-1] - fix_error)
    np.testing.assert_allclose(np.std(errors, axis=0), 0.1, rtol=0.2)
    assert np.abs(drift).max() < 0.03  # 0.2 s at some 0.04 m/s
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03


def test_no_position_before_the_first_fix() -> None:
    navigation, inertial = DeadReckoner(), InertialSensor(Quiet())
    assert all(navigation.update(inertial.sample(state_at(k * STEP_NS)), None) is None for k in range(50))


def test_fix_between_two_samples_is_taken_between_them() -> None:
    navigation, inertial = DeadReckoner(), InertialSensor(Quiet())
    for k in range(9):
        navigation.update(inertial.sample(state_at(k * STEP_NS)), None)
    between = 3 * STEP_NS + 1_234_567
    fix = GpsFix(between, tuple(state_at(between).p_ned_m.tolist()))
    now = state_at(9 * STEP_NS)
    np.testing.assert_allclose(navigation.update(inertial.sample(now), fix), now.p_ned_m, atol=1e-8)


@pytest.mark.parametrize("age_ns", [HISTORY_NS + 2 * STEP_NS, -STEP_NS])
def test_fix_from_outside_the_history_is_counted_and_not_used(age_ns: int) -> None:
    navigation, inertial = DeadReckoner(), InertialSensor(Quiet())
    for k in range(200):
        navigation.update(inertial.sample(state_at(k * STEP_NS)), None)
    now_ns = 200 * STEP_NS
    p = navigation.update(inertial.sample(state_at(now_ns)), GpsFix(now_ns - age_ns, (0.0, 0.0, 0.0)))
    assert p is None
    assert navigation.late_fixes == 1


def test_fix_at_the_far_end_of_the_needed_history_is_used() -> None:
    navigation, inertial = DeadReckoner(), InertialSensor(Quiet())
    for k in range(200):
        navigation.update(inertial.sample(state_at(k * STEP_NS)), None)
    now, then = state_at(200 * STEP_NS), state_at(200 * STEP_NS - 300_000_000)
    p = navigation.update(inertial.sample(now), GpsFix(then.t_ns, tuple(then.p_ned_m.tolist())))
    np.testing.assert_allclose(p, now.p_ned_m, atol=1e-8)
