"""Sensors: the thesis' covariances n_p / T, hold times and delay, and nothing else between truth and measurement."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from level_flight import ALPHA_RAD, BETA_RAD, EULER_RAD, SPEED_M_S, STEP_NS, Quiet, state_at

from companion.geometry import rotation_from_euler
from sim_bridge.sensors import GPS_PERIOD_NS, INERTIAL_PERIOD_NS, GpsSensor, InertialSample, InertialSensor

DRAWS = 20_000  # the relative deviation of a variance from so many is 1 %
OMEGA_RAD_S = (0.01, -0.02, 0.03)


def channels(s: InertialSample) -> tuple[float, ...]:
    """Return what carries noise, less its truth."""
    measured = (*s.euler_rad, *s.omega_rad_s, s.alpha_rad, s.beta_rad, s.speed_m_s)
    truth = (*EULER_RAD, *OMEGA_RAD_S, ALPHA_RAD, BETA_RAD, SPEED_M_S)
    return tuple(m - t for m, t in zip(measured, truth, strict=True))


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """Return one row of inertial errors for each of many hold times."""
    sensor = InertialSensor(np.random.default_rng(7))
    truth = state_at(0)
    return np.array(
        [channels(sensor.sample(msgspec.structs.replace(truth, t_ns=k * INERTIAL_PERIOD_NS))) for k in range(DRAWS)]
    )


def test_inertial_covariance_is_noise_power_over_sample_time(errors: np.ndarray) -> None:
    wanted = np.array([1e-9] * 3 + [1e-8] * 3 + [1e-9] * 2 + [1e-7]) / 0.05
    np.testing.assert_allclose(errors.var(axis=0), wanted, rtol=0.05)
    assert np.all(np.abs(errors.mean(axis=0)) < 4 * np.sqrt(wanted / DRAWS))


def test_inertial_noise_is_white_and_its_channels_independent(errors: np.ndarray) -> None:
    correlation = np.corrcoef(errors.T)
    assert np.abs(correlation - np.eye(9)).max() < 0.04
    for channel in errors.T:
        assert abs(np.corrcoef(channel[1:], channel[:-1])[0, 1]) < 0.04


def test_inertial_noise_is_held_for_its_sample_time_while_the_signal_moves_on() -> None:
    sensor = InertialSensor(np.random.default_rng(7))
    rows = []
    for k in range(40):
        yaw = 0.4 + 0.001 * k
        s = sensor.sample(state_at(k * STEP_NS, (yaw, *EULER_RAD[1:])))
        rows.append((s.euler_rad[0] - yaw, *channels(s)[1:]))
    steps = INERTIAL_PERIOD_NS // STEP_NS
    blocks = np.array(rows).reshape(4, steps, 9)
    assert np.ptp(blocks, axis=1).max() < 1e-12
    assert np.abs(np.diff(blocks[:, 0], axis=0)).min() > 0


@given(
    st.floats(-3.0, 3.0), st.floats(-1.4, 1.4), st.floats(-3.0, 3.0),
    st.tuples(st.floats(50, 300), st.floats(-40, 40), st.floats(-40, 40)),
)  # fmt: skip
def test_without_noise_the_measurement_is_the_truth(
    yaw: float, pitch: float, roll: float, v_body: tuple[float, float, float]
) -> None:
    R = rotation_from_euler(yaw, pitch, roll)
    truth = msgspec.structs.replace(state_at(0), R_ned_body=R, v_ned_m_s=R @ np.array(v_body))
    s = InertialSensor(Quiet()).sample(truth)
    np.testing.assert_allclose(s.euler_rad, (yaw, pitch, roll), atol=1e-9)
    np.testing.assert_allclose(s.v_ned_m_s, truth.v_ned_m_s, atol=1e-9)
    np.testing.assert_allclose(s.omega_rad_s, truth.omega_body_rad_s, atol=0)
    np.testing.assert_allclose(s.specific_force_m_s2, truth.specific_force_body_m_s2, atol=0)
    assert s.airspeed_m_s == pytest.approx(np.linalg.norm(truth.v_air_body_m_s))
    assert s.alpha_rad == pytest.approx(math.atan2(v_body[2], v_body[0]))
    assert s.beta_rad == pytest.approx(math.asin(v_body[1] / np.linalg.norm(v_body)))


def test_a_gust_moves_the_airspeed_and_not_the_flow_angles() -> None:
    calm = InertialSensor(np.random.default_rng(3)).sample(state_at(0))
    gusty = InertialSensor(np.random.default_rng(3)).sample(
        msgspec.structs.replace(state_at(0), v_air_body_m_s=np.array([220.0, 5.0, 20.0]))
    )
    assert gusty.airspeed_m_s > calm.airspeed_m_s + 10
    assert msgspec.structs.replace(gusty, airspeed_m_s=calm.airspeed_m_s) == calm


def test_velocity_carries_the_noise_of_speed_flow_angles_and_attitude() -> None:
    sensor = InertialSensor(np.random.default_rng(5))
    truth = state_at(0, (0.0, ALPHA_RAD, 0.0))
    samples = [sensor.sample(msgspec.structs.replace(truth, t_ns=k * INERTIAL_PERIOD_NS)) for k in range(5000)]
    error = np.array([s.v_ned_m_s for s in samples]) - truth.v_ned_m_s
    across = SPEED_M_S * math.sqrt(2 * 1e-9 / 0.05)  # yaw and beta, pitch and alpha
    np.testing.assert_allclose(error[:, 1:].std(axis=0), [across, across], rtol=0.06)
    assert error[:, 0].std() == pytest.approx(math.sqrt(1e-7 / 0.05), rel=0.2)


def test_gps_covariance_is_noise_power_over_sample_time() -> None:
    sensor = GpsSensor(np.random.default_rng(11))
    truth = state_at(0)
    fixes = [sensor.sample(msgspec.structs.replace(truth, t_ns=k * GPS_PERIOD_NS)) for k in range(DRAWS)]
    error = np.array([fix.p_ned_m for fix in fixes if fix is not None]) - truth.p_ned_m
    np.testing.assert_allclose(error.var(axis=0), [1e-3 / 0.1] * 3, rtol=0.05)
    assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 0.04
    assert abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 0.04


def test_gps_delivers_ten_times_a_second_what_was_true_one_sample_ago() -> None:
    sensor = GpsSensor(Quiet())
    delivered = [(k * STEP_NS, sensor.sample(state_at(k * STEP_NS))) for k in range(201)]
    fixes = [(t_ns, fix) for t_ns, fix in delivered if fix is not None]
    assert [t_ns for t_ns, _ in fixes] == [k * GPS_PERIOD_NS for k in range(1, 11)]
    for t_ns, fix in fixes:
        assert fix.t_ns == t_ns - GPS_PERIOD_NS
        np.testing.assert_array_equal(fix.p_ned_m, state_at(fix.t_ns).p_ned_m)


def test_same_seed_is_the_same_and_another_is_not() -> None:
    def run(seed: int) -> list[object]:
        sensors = InertialSensor(np.random.default_rng(seed)), GpsSensor(np.random.default_rng(seed + 1))
        return [sensor.sample(state_at(k * STEP_NS)) for k in range(100) for sensor in sensors]

    assert run(1) == run(1)
    assert run(1) != run(2)
