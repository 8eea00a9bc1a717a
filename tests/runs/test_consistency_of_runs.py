"""NEES and NIS over flights whose errors are drawn: a consistent estimate lies in the band, another does not."""

import numpy as np
import pytest
from made_records import record_of, rows_of
from scipy.stats import chi2

from sim_bridge.runs.consistency import band, hold_of, jobs, nees_curve, nis_curve, tables
from sim_bridge.runs.record import nees

SIGMA = np.array([0.1, 0.2, 0.4])
FLIGHTS, ROWS = 40, 200


def drawn(scale, rng, n=ROWS, **fields):
    """Return a record whose errors are ``scale`` times what it says of them."""
    error = scale * SIGMA * rng.standard_normal((n, 3))
    squared = np.sum((error / SIGMA) ** 2, axis=1)[:, None]
    nis = np.column_stack([0.1 * np.arange(n), scale**2 * rng.chisquare(18, n), np.full(n, 18.0)])
    parts = {f"{q}_nees": squared for q in ("p", "v", "turn", "br")}
    rows = rows_of(n, p_error_m=error, p_sigma_m=SIGMA, v_error_m_s=error, v_sigma_m_s=SIGMA, turn_error_rad=error,
                   turn_sigma_rad=SIGMA, br_m=error, br_true_m=0.0, br_sigma_m=SIGMA, **parts)
    return record_of(rows, nis={"pixels": nis}, **fields)


def flights(scale, seed=1001):
    rng = np.random.default_rng(seed)
    return [drawn(scale, rng) for _ in range(FLIGHTS)]


def test_a_consistent_estimate_is_inside_the_band_95_times_of_100():
    records = flights(1.0)
    for curve, right in ((nees_curve(records, "p"), 3.0), (nis_curve(records, "pixels"), 1.0)):
        assert curve.mean.mean() == pytest.approx(right, rel=0.03)
        assert 0.85 <= curve.share_inside() <= 1.0
        assert (curve.low < right).all()
        assert (right < curve.high).all()


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_an_estimate_that_claims_too_much_or_too_little_is_outside(scale):
    records = flights(scale)
    for curve, right in ((nees_curve(records, "br"), 3.0), (nis_curve(records, "pixels"), 1.0)):
        assert curve.share_inside() < 0.05
        assert (curve.mean.mean() > right) == (scale > 1.0)


def test_the_band_is_that_of_chi_squared():
    low, high = band(np.array([3.0]), np.array([1.0]))
    assert (low[0], high[0]) == (pytest.approx(0.2158, abs=1e-4), pytest.approx(9.3484, abs=1e-4))
    low, high = band(np.array([300.0]), np.array([100.0]))
    assert chi2.cdf(100 * high[0], 300) - chi2.cdf(100 * low[0], 300) == pytest.approx(0.95)


def test_flights_that_end_early_count_while_they_last_and_instants_while_half_of_them_do():
    rng = np.random.default_rng(1002)
    records = [drawn(1.0, rng, n=100) for _ in range(6)] + [drawn(1.0, rng, n=150) for _ in range(2)]
    curve = nees_curve(records, "p")
    assert len(curve.t_s) == 100
    missing = drawn(1.0, rng, n=100)
    missing.rows[:50] = np.nan  # no estimate yet: the band is wider there
    curve = nees_curve([missing, drawn(1.0, rng, n=100)], "p")
    width = curve.high - curve.low
    assert width[0] > 1.2 * width[-1]


def test_nees_is_of_the_whole_covariance():
    cov = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    along, across = np.array([1.0, 1.0, 0.0]), np.array([1.0, -1.0, 0.0])
    assert nees(along, cov) == pytest.approx(2 / 1.9)
    assert nees(across, cov) == pytest.approx(2 / 0.1)
    assert np.isnan(nees(along, np.zeros((3, 3))))


def test_tables_say_what_was_drawn():
    text = tables([*flights(1.6), drawn(1.6, np.random.default_rng(7), refused={"pixels: gate": 3, "gps: gate": 5})])
    position = next(line for line in text.splitlines() if line.startswith("| relative position, m; whole flight"))
    ratios = [float(x) for x in position.split("|")[4].split(",")]
    assert ratios == pytest.approx([1.6**2] * 3, rel=0.1)
    sigmas = [float(x) for x in position.split("|")[6].split(",")]
    assert sigmas == pytest.approx(SIGMA.tolist())
    pixels = next(line for line in text.splitlines() if line.startswith("| pixels"))
    assert pixels.endswith("| 3 gate |")


def test_the_hold_counts_from_its_begin():
    record = record_of(rows_of(100), changes=((0.0, "standby"), (1.0, "approach"), (4.0, "hold"), (8.0, "breakaway")))
    hold = hold_of(record).of("t_s")
    assert len(hold) == 40
    assert (hold[0], hold[-1]) == (0.0, pytest.approx(3.9))


def test_seeds_follow_each_other_and_the_last_flights_come_from_far():
    made = jobs(20, "moderate", "blend", first_seed=1000)
    assert [job.scenario.seed for job in made] == list(range(1000, 1020))
    assert [job.label.split()[0] for job in made] == ["near"] * 18 + ["far"] * 2
    assert {job.scenario.turbulence for job in made} == {"moderate"}
    assert {job.setup.config.fusion.method for job in made} == {"blend"}
    assert made[0].scenario.start_tanker_m != made[-1].scenario.start_tanker_m


def test_mounts_and_gps_are_drawn_anew_for_each_seed_and_only_in_the_world():
    made = jobs(200, "light", "filter", first_seed=1000)
    angles = np.array([[getattr(job.world.camera, f"mount_{name}_rad") - getattr(job.setup.camera, f"mount_{name}_rad")
                        for name in ("yaw", "pitch", "roll")] for job in made])
    expected = made[0].setup.config.fusion.filter
    np.testing.assert_allclose(angles.std(axis=0), expected.boresight_initial_rad, rtol=0.2)
    assert np.abs(angles.mean(axis=0)).max() < 0.25 * expected.boresight_initial_rad
    assert made[0].setup.camera == made[1].setup.camera
    again = jobs(1, "light", "filter", first_seed=1000)[0]
    assert again.world.camera == made[0].world.camera
    for aircraft in (made[0].scenario.sensors.receiver, made[0].scenario.sensors.tanker):
        assert aircraft.gps.slow_sigma_m == pytest.approx(expected.gps_bias_sigma_m / np.sqrt(2))
