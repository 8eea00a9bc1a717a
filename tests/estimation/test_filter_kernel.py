import filter_scene as fs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from companion.config import FilterConfig
from companion.estimation.filter_kernel import predict, take_linear, take_scalar
from companion.estimation.filter_pixels import ALL_TAKEN, NOTHING_TAKEN, UNUSABLE, WIDE, marker_rows, take_pixels
from companion.estimation.filter_state import SIZE, initial_sigma, process_noise

C = FilterConfig()
PLACE = np.array([-30.0, -3.0, 12.0])


def spread(seed, n=SIZE):
    A = np.random.default_rng(seed).standard_normal((n, n))
    return A @ A.T + 0.1 * np.eye(n)


def test_rows_are_the_derivatives_of_where_transforms_put_the_markers():
    geometry = fs.geometry(PLACE, C)
    uv, H = np.empty((9, 2)), np.empty((18, WIDE))
    assert marker_rows(np.zeros(WIDE), geometry.table, fs.MARKERS, uv, H)
    assert np.allclose(uv, fs.on_plane(PLACE, np.zeros(3), np.zeros(3)), atol=1e-14)

    def seen(x):
        r = PLACE + x[0:3] + x[22:25]
        return fs.on_plane(r, x[6:9], x[12:15], x[15], x[16:19], x[19:22]).ravel()

    step = 1e-6 * np.eye(WIDE)
    numeric = np.array([(seen(step[k]) - seen(-step[k])) / 2e-6 for k in range(WIDE)]).T
    assert np.allclose(H, numeric, atol=1e-8)


def test_rows_far_from_zero_are_where_the_transforms_put_the_markers():
    x = np.zeros(WIDE)
    x[:SIZE] = 0.02 * np.random.default_rng(1).standard_normal(SIZE)
    uv, H = np.empty((9, 2)), np.empty((18, WIDE))
    assert marker_rows(x, fs.geometry(PLACE, C).table, fs.MARKERS, uv, H)
    assert np.allclose(uv, fs.on_plane(PLACE + x[:3], x[6:9], x[12:15], x[15]), atol=1e-6)


def test_prediction_is_the_matrix_exponential_of_its_process():
    noise, dt, P = process_noise(C), 0.37, spread(2)
    A, Q = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    A[0:3, 3:6] = np.eye(3)
    along = fs.V_TANKER / np.linalg.norm(fs.V_TANKER)
    A[9:12, 9:12] = -np.eye(3) / C.gps_bias_s
    Q[range(SIZE), range(SIZE)] = [*[noise[0]] * 3, *[noise[1]] * 3, *[noise[2]] * 3,
                                   *[2 * C.gps_bias_sigma_m**2 / C.gps_bias_s] * 3, *[noise[5]] * 3, noise[6]]
    Q[0:3, 0:3] += (noise[7] - noise[0]) * np.outer(along, along)
    van_loan = expm(np.block([[-A, Q], [np.zeros((SIZE, SIZE)), A.T]]) * dt)  # Van Loan 1978
    F = van_loan[SIZE:, SIZE:].T
    x = np.arange(SIZE) * 0.1
    x_new, P_new = x.copy(), P.copy()
    predict(x_new, P_new, dt, noise, fs.V_TANKER)
    assert np.allclose(x_new, F @ x, atol=1e-12)
    assert np.allclose(P_new, F @ P @ F.T + F @ van_loan[:SIZE, SIZE:], atol=1e-12)


@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.integers(0, 2**31))
def test_two_steps_are_one_long_one(a, b, seed):
    noise = process_noise(C)
    x = np.random.default_rng(seed).standard_normal(SIZE)
    once, twice = (x.copy(), spread(seed)), (x.copy(), spread(seed))
    predict(*once, a + b, noise, fs.V_TANKER)
    predict(*twice, a, noise, fs.V_TANKER)
    predict(*twice, b, noise, fs.V_TANKER)
    assert np.allclose(once[0], twice[0], rtol=1e-9, atol=1e-9)
    assert np.allclose(once[1], twice[1], rtol=1e-9, atol=1e-9)


def test_scalars_one_by_one_are_the_textbook_update_with_all_at_once():
    rng = np.random.default_rng(3)
    P, x, H, z = spread(4), rng.standard_normal(SIZE), rng.standard_normal((3, SIZE)), rng.standard_normal(3)
    S = H @ P @ H.T + 0.3 * np.eye(3)
    K = P @ H.T @ np.linalg.inv(S)
    x_new, P_new = x.copy(), P.copy()
    nis = take_linear(x_new, P_new, H, z, 0.3, np.inf)
    assert nis == pytest.approx((z - H @ x) @ np.linalg.solve(S, z - H @ x))
    assert np.allclose(x_new, x + K @ (z - H @ x))
    assert np.allclose(P_new, (np.eye(SIZE) - K @ H) @ P)


@given(arrays(float, (12, SIZE), elements=st.floats(-1.0, 1.0)), st.floats(1e-9, 1e6), st.integers(0, 2**31))
def test_covariance_stays_symmetric_and_positive_whatever_is_measured(H, variance, seed):
    """Rows in units of what is known; a marker's pixel against a position known to 3 m has a ratio of 1e-7."""
    sigma = initial_sigma(C) * 10.0 ** np.random.default_rng(seed).uniform(-2, 2, SIZE)
    x, P, b, c = np.zeros(SIZE), np.diag(sigma**2), np.empty(SIZE), np.empty(SIZE)
    for h in H / sigma:
        take_scalar(x, P, h, 1.0, variance, b, c)
        assert (P == P.T).all()
        assert np.isfinite(x).all()
        now = np.sqrt(np.diag(P))  # warns, which fails the test, when one is negative
        assert np.linalg.eigvalsh(P / np.outer(now, now)).min() > -1e-6


def taken(uv, x=None, P=None, sigma=1e-4, gate=23.0):
    x = np.zeros(SIZE) if x is None else x.copy()
    P = np.diag(initial_sigma(C) ** 2) if P is None else P.copy()
    geometry = fs.geometry(PLACE, C, 0.002)
    alone, nis = np.empty(len(uv)), np.empty(len(uv))
    status, total = take_pixels(x, P, geometry.table, fs.MARKERS[: len(uv)], uv, np.full(len(uv), sigma),
                                geometry.noise, gate, alone, nis)
    return status, total, nis, x, P


@given(arrays(float, (9, 2), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_no_pixels_whatever_bring_a_nan_or_a_lopsided_covariance_in(uv):
    _, _, _, x, P = taken(uv)
    assert np.isfinite(x).all()
    assert np.isfinite(P).all()
    assert (P == P.T).all()


def test_a_frame_that_is_metres_off_is_taken_where_it_belongs():
    off = np.array([5.0, -4.0, 6.0])
    status, _, nis, x, _ = taken(fs.on_plane(PLACE + off, np.zeros(3), np.zeros(3)))
    assert status == ALL_TAKEN
    assert (nis >= 0).all()
    # Exact pixels: what is left is the pull of the prior on depth, far inside its standard deviation.
    assert np.linalg.norm(x[:3] - off) < 0.05


def test_a_wrong_marker_is_left_out_and_the_others_count():
    uv = fs.on_plane(PLACE, np.zeros(3), np.zeros(3))
    tight = np.diag(np.repeat([0.01, 0.01, 5e-4, 1.0, 5e-4, 1e-3], [3, 3, 3, 3, 3, 1]) ** 2)
    uv[4] += 0.01
    status, _, nis, x, P = taken(uv, P=tight)
    assert status == ALL_TAKEN
    assert np.flatnonzero(nis < 0).tolist() == [4]
    assert np.linalg.norm(x[:3]) < 0.003
    assert P[0, 0] < tight[0, 0]


def test_a_frame_most_of_which_is_wrong_changes_nothing():
    uv = fs.on_plane(PLACE, np.zeros(3), np.zeros(3))
    tight = np.diag(np.repeat([0.01, 0.01, 5e-4, 1.0, 5e-4, 1e-3], [3, 3, 3, 3, 3, 1]) ** 2)
    uv[:5] += 0.03
    status, _, _, x, P = taken(uv, P=tight)
    assert status == NOTHING_TAKEN
    assert (x == 0).all()
    assert (tight == P).all()


def test_a_marker_behind_the_camera_makes_a_frame_unusable():
    x = np.zeros(SIZE)
    x[0] = 60.0
    assert taken(np.zeros((9, 2)), x)[0] == UNUSABLE


@pytest.mark.parametrize(("sigma_m", "angle_rad"), [(0.1, 1e-4), (0.1, 5e-4), (0.3, 1e-3), (0.5, 1e-3)])
def test_a_wrong_marker_that_keeps_the_point_from_settling_is_never_taken_with_the_gate_open(sigma_m, angle_rad):
    """20 px off, far from where it is linear: left out, or nothing is taken; the estimate errs by what it says."""
    sigma = np.repeat([sigma_m, 0.01, angle_rad, 1.0, angle_rad, 1e-3], [3, 3, 3, 3, 3, 1])
    left_out = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth, wrong, angle = sigma_m * rng.standard_normal(3), rng.integers(9), rng.uniform(0.0, 2.0 * np.pi)
        uv = fs.on_plane(PLACE + truth, np.zeros(3), np.zeros(3)) + 1e-4 * rng.standard_normal((9, 2))
        uv[wrong] += 20.0 / fs.FOCAL_PX * np.array([np.cos(angle), np.sin(angle)])
        status, _, nis, x, P = taken(uv, P=np.diag(sigma**2))
        if status != ALL_TAKEN:
            continue
        error = x[:3] - truth
        assert nis[wrong] < 0.0
        assert error @ np.linalg.solve(P[:3, :3], error) < 30.0, "1e-6 of chi2 of three"
        left_out += 1
    assert left_out >= 20
