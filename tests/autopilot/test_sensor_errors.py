"""Errors beyond the thesis' white noise, and the thesis' noise in its spectrum: levels, growth, outages, and nothing
else than what was asked for.
"""

import math

import msgspec
import numpy as np
import pytest
from level_flight import STEP_NS, Quiet, state_at
from scipy.signal import welch

from sim_bridge.sensor_conditions import GpsErrors, InsErrors, Outage
from sim_bridge.sensor_errors import SETTLE_S, GpsBias, InsDrift
from sim_bridge.sensors import GPS_PERIOD_NS, INERTIAL_PERIOD_NS, GpsSensor, InertialSensor

S = 1_000_000_000
PERIOD_S = 0.05


def test_spectrum_of_the_held_noise_is_flat_at_the_stated_power_and_falls_with_the_hold() -> None:
    """Thesis 3.2: the two-sided density has the height n_p; holding for T shapes it by sinc^2(f T)."""
    sensor, truth = InertialSensor(np.random.default_rng(3)), state_at(0)
    samples = [sensor.sample(msgspec.structs.replace(truth, t_ns=k * 10_000_000)) for k in range(200_000)]
    channels = {
        1e-9: [s.euler_rad[1] for s in samples], 1e-8: [s.omega_rad_s[0] for s in samples],
        1e-7: [s.speed_m_s for s in samples],
    }
    for n_p, values in channels.items():
        f_hz, one_sided = welch(np.array(values), fs=100.0, nperseg=2000)
        shape = np.sinc(f_hz * PERIOD_S) ** 2
        for low, high in ((0.1, 2.1), (4.0, 6.0), (9.0, 11.0)):
            band = (f_hz > low) & (f_hz < high)  # a mean over it deviates by 2 %
            assert 0.5 * one_sided[band].mean() == pytest.approx(n_p * shape[band].mean(), rel=0.08)


def test_held_noise_is_correlated_for_its_sample_time_and_no_longer() -> None:
    sensor, truth = InertialSensor(np.random.default_rng(3)), state_at(0)
    samples = [sensor.sample(msgspec.structs.replace(truth, t_ns=k * STEP_NS)) for k in range(100_000)]
    p = np.array([s.omega_rad_s[0] for s in samples]) - 0.01
    for lag in (0, 3, 5, 8, 10, 15):
        wanted = max(0.0, 1.0 - lag * STEP_NS / INERTIAL_PERIOD_NS) * 1e-8 / PERIOD_S
        assert np.mean(p[lag:] * p[: len(p) - lag]) == pytest.approx(wanted, abs=0.03 * 1e-8 / PERIOD_S)


def test_accelerations_have_no_noise_unless_asked_for_and_then_the_stated_one() -> None:
    def forces(errors: InsErrors) -> np.ndarray:
        sensor = InertialSensor(np.random.default_rng(1), errors)
        samples = [sensor.sample(msgspec.structs.replace(level, t_ns=k * STEP_NS)) for k in range(30_000)]
        return np.array([s.specific_force_m_s2 for s in samples]) - level.specific_force_body_m_s2

    level = state_at(0)
    assert not forces(InsErrors()).any()
    noisy = forces(InsErrors(accelerometer_noise_power=1e-4))
    np.testing.assert_allclose(noisy.var(axis=0), 1e-4 / PERIOD_S, rtol=0.1)
    held = noisy.reshape(-1, INERTIAL_PERIOD_NS // STEP_NS, 3)
    assert not np.ptp(held, axis=1).any()


def test_errors_are_added_to_the_same_noise_as_without_them() -> None:
    errors = InsErrors(attitude_drift_rad_s=(1e-4, -2e-4, 3e-4), gyro_bias_rad_s=(0.01, 0.02, -0.03))
    plain, drifting = (InertialSensor(np.random.default_rng(4), e) for e in (InsErrors(), errors))
    for k in range(2001):
        a, b = plain.sample(state_at(k * STEP_NS)), drifting.sample(state_at(k * STEP_NS))
    np.testing.assert_allclose(np.subtract(b.euler_rad, a.euler_rad), np.array([1e-4, -2e-4, 3e-4]) * 10.0, rtol=1e-6)
    np.testing.assert_allclose(np.subtract(b.omega_rad_s, a.omega_rad_s), [0.01, 0.02, -0.03], rtol=1e-9)
    assert (a.speed_m_s, a.alpha_rad, a.beta_rad) == (b.speed_m_s, b.alpha_rad, b.beta_rad)
    # The velocity that is told turns with the attitude that is told.
    turned = np.linalg.norm(np.subtract(b.v_ned_m_s, a.v_ned_m_s))
    assert turned == pytest.approx(a.speed_m_s * np.hypot(1e-3, 2e-3), rel=0.2)


def drift_of(errors: InsErrors, seed: int, seconds: float, out: bool) -> InsDrift:
    drift = InsDrift(errors, np.random.default_rng(seed), PERIOD_S)
    for k in range(round(seconds / PERIOD_S) + 1):
        drift.advance(k * INERTIAL_PERIOD_NS, out)
    return drift


@pytest.mark.parametrize("seconds", [10.0, 40.0])
def test_a_random_walk_spreads_with_the_root_of_time(seconds: float) -> None:
    errors = InsErrors(attitude_walk=1e-3, velocity_walk=0.1)
    ends = [drift_of(errors, seed, seconds, out=True) for seed in range(300)]
    root = math.sqrt(seconds)
    assert np.std([d.euler_rad for d in ends]) == pytest.approx(1e-3 * root, rel=0.08)
    assert np.std([d.v_ned_m_s for d in ends]) == pytest.approx(0.1 * root, rel=0.08)


def test_velocity_drifts_without_gps_only_and_settles_with_it() -> None:
    errors = InsErrors(velocity_drift_m_s2=(0.02, -0.01, 0.005))
    assert drift_of(errors, 1, 20.0, out=False).v_ned_m_s == (0.0, 0.0, 0.0)
    drift = drift_of(errors, 1, 20.0, out=True)
    np.testing.assert_allclose(drift.v_ned_m_s, (0.4, -0.2, 0.1), rtol=1e-9)
    for k in range(401, 401 + round(SETTLE_S / PERIOD_S)):
        drift.advance(k * INERTIAL_PERIOD_NS, gps_out=False)
    np.testing.assert_allclose(drift.v_ned_m_s, np.array([0.4, -0.2, 0.1]) / math.e, rtol=1e-9)


def test_slow_gps_error_has_its_spread_and_its_correlation_time() -> None:
    bias = GpsBias(GpsErrors(slow_sigma_m=2.0, slow_s=5.0), np.random.default_rng(2))
    x = np.array([bias.at(k * S // 2) for k in range(40_000)])
    assert x.std() == pytest.approx(2.0, rel=0.05)
    for lag in (2, 10, 40):
        wanted = 4.0 * math.exp(-lag * 0.5 / 5.0)
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(wanted, abs=0.25)


def test_both_aircraft_get_the_same_common_error_at_one_instant_and_own_ones_beside_it() -> None:
    common = GpsBias(GpsErrors(bias_ned_m=(5.0, 0.0, -3.0), slow_sigma_m=1.0), np.random.default_rng(2))
    own = GpsBias(GpsErrors(bias_ned_m=(0.0, 2.0, 0.0)), np.random.default_rng(3))
    receiver, tanker = GpsSensor(Quiet(), [common, own]), GpsSensor(Quiet(), [common])
    for k in range(100):
        truth = state_at(k * GPS_PERIOD_NS)
        a, b = receiver.sample(truth), tanker.sample(truth)
        if a is not None and b is not None:
            np.testing.assert_allclose(np.subtract(a.p_ned_m, b.p_ned_m), (0.0, 2.0, 0.0), atol=1e-12)
    assert a is not None
    error = a.p_ned_m - state_at(a.t_ns).p_ned_m
    assert np.abs(error - (5.0, 2.0, -3.0)).max() < 5.0
    assert np.abs(error - (5.0, 2.0, -3.0)).min() > 0.0


def test_no_fix_comes_in_an_outage_and_the_rest_is_as_without_it() -> None:
    plain, patchy = GpsSensor(np.random.default_rng(1)), GpsSensor(
        np.random.default_rng(1), outages=[Outage(from_s=2.0, until_s=4.0), Outage(from_s=5.0, until_s=5.05)])
    for k in range(1600):
        t_s = k * STEP_NS / S
        a, b = plain.sample(state_at(k * STEP_NS)), patchy.sample(state_at(k * STEP_NS))
        # Half open, and one sample more until the first fix after it has come through the delay.
        silent = 2.0 <= t_s < 4.1 or 5.0 <= t_s < 5.1 + 0.01
        assert b == (None if silent else a)
