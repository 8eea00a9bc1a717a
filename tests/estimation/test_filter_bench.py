"""How long a frame of nine markers takes in the filter, beside the same update written with numpy's matrices."""

import timeit
from dataclasses import replace

import filter_scene as fs
import numpy as np
import pytest
from scipy.linalg import block_diag, solve

from companion.config import FilterConfig
from companion.estimation.filter_history import FilterHistory
from companion.estimation.filter_kernel import predict
from companion.estimation.filter_measurements import PixelFrame
from companion.estimation.filter_pixels import WIDE, marker_rows, take_pixels
from companion.estimation.filter_state import SIZE, process_noise
from companion.estimation.filter_steps import Steps

C = FilterConfig()


def material():
    """Return the estimate in a flight just before a frame, and the frame."""
    drawn = fs.draw(31, length_s=6.0)
    history = FilterHistory(Steps(C, fs.MARKERS), C.horizon_s)
    last = max(k for k, m in enumerate(drawn.measurements) if isinstance(m, PixelFrame))
    for m in drawn.measurements[:last]:
        history.take(m)
    return history.newest, drawn.measurements[last]


def with_numpy(x, P, m, dt):
    """Predict and update once with matrices: the reference."""
    noise = process_noise(C)
    F, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
    fade = np.exp(-dt / noise[4])
    F[0:3, 3:6], F[9:12, 9:12] = dt * np.eye(3), fade * np.eye(3)
    Q[range(SIZE), range(SIZE)] = [*[noise[0] * dt + noise[1] * dt**3 / 3] * 3, *[noise[1] * dt] * 3,
                                   *[noise[2] * dt] * 3, *[noise[3] ** 2 * (1 - fade**2)] * 3, *[noise[5] * dt] * 3,
                                   noise[6] * dt]
    along = fs.V_TANKER / np.linalg.norm(fs.V_TANKER)
    Q[0:3, 0:3] += (noise[7] - noise[0]) * dt * np.outer(along, along)
    Q[0:3, 3:6] = Q[3:6, 0:3] = 0.5 * noise[1] * dt**2 * np.eye(3)
    x, P = F @ x, F @ P @ F.T + Q
    wide, big = np.zeros(WIDE), np.zeros((WIDE, WIDE))
    wide[:SIZE], big[:SIZE, :SIZE] = x, P
    big[SIZE:, SIZE:] = block_diag(*m.geometry.noise.reshape(3, 3, 3))
    pixels = m.labelled
    expected, H = np.empty((9, 2)), np.empty((18, WIDE))
    marker_rows(wide, m.geometry.table, pixels.markers, expected, H)
    R = np.diag(np.repeat(pixels.sigma**2, 2))
    S = H @ big @ H.T + R
    K = solve(S, H @ big, assume_a="pos").T
    left = np.eye(WIDE) - K @ H
    return (wide + K @ (pixels.uv - expected).ravel())[:SIZE], (left @ big @ left.T + K @ R @ K.T)[:SIZE, :SIZE]


def with_kernels(x, P, m, dt):
    x, P, pixels = x.copy(), P.copy(), m.labelled
    predict(x, P, dt, process_noise(C), fs.V_TANKER)
    alone, nis = np.empty(9), np.empty(9)
    take_pixels(x, P, m.geometry.table, pixels.markers, pixels.uv, pixels.sigma, m.geometry.noise, 23.0, alone, nis)
    return x, P


def best_us(function, number=200):
    return min(timeit.repeat(function, number=number, repeat=7)) / number * 1e6


def test_the_kernels_do_what_the_matrices_do():
    e, m = material()
    dt = 1e-9 * (m.t_ns - e.t_ns)
    x, P = with_kernels(e.x, e.cov, m, dt)
    x_ref, P_ref = with_numpy(e.x, e.cov, m, dt)
    sigma = np.sqrt(np.diag(P_ref))
    assert np.abs((x - x_ref) / sigma).max() < 1e-4
    assert np.allclose(P / np.outer(sigma, sigma), P_ref / np.outer(sigma, sigma), atol=1e-6)


@pytest.mark.bench
def test_bench_filter_step():
    e, m = material()
    dt, steps = 1e-9 * (m.t_ns - e.t_ns), Steps(C, fs.MARKERS)
    ready = replace(e, ready=True)
    kernels = best_us(lambda: with_kernels(e.x, e.cov, m, dt))
    step = best_us(lambda: steps.take(ready, m))
    reference = best_us(lambda: with_numpy(e.x, e.cov, m, dt))
    print(f"\nfilter, a frame of nine markers (18 scalars), 16 + 9 states: step {1e-3 * step:.3f} ms, kernels alone "
          f"{1e-3 * kernels:.3f} ms; of the time of numpy's matrices ({1e-3 * reference:.3f} ms): step "
          f"{step / reference:.2f}, kernels {kernels / reference:.2f}; a measurement that comes 0.1 s late takes two "
          f"to four steps")
