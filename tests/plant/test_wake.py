from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.wake import FADE_M, TABLE, WEIGHT_OVER_RHO_V2_M2, Wake, load_table, weights

WEIGHT, DENSITY, SPEED = 110e3 * 9.80665, 0.66012, 205.7
TRIM_CL = 0.139
places = st.tuples(st.floats(-200, 30), st.floats(-80, 80), st.floats(-50, 90))
WAKE = Wake(WEIGHT, DENSITY, SPEED)


@given(places)
def test_left_is_the_mirror_image_of_right(place: tuple[float, float, float]) -> None:
    x, y, z = place
    right, left = WAKE.increments(x, y, z), WAKE.increments(x, -y, z)
    assert right[:3] == left[:3]
    assert right[3:] == tuple(-v for v in left[3:])


@given(places)
def test_nothing_pulls_aside_in_the_middle(place: tuple[float, float, float]) -> None:
    assert WAKE.increments(place[0], 0.0, place[2])[3:] == (0.0, 0.0, 0.0)


@given(places, st.floats(0.3, 3.0))
def test_increments_go_with_weight_over_density_and_speed_squared(
    place: tuple[float, float, float], factor: float
) -> None:
    once = np.array(WAKE.increments(*place))
    near = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-300)  # numbers without a whole mantissa are rounded
    near(Wake(factor * WEIGHT, DENSITY, SPEED).increments(*place), factor * once)
    near(Wake(WEIGHT, factor * DENSITY, SPEED).increments(*place), once / factor)
    near(Wake(WEIGHT, DENSITY, factor * SPEED).increments(*place), once / factor**2)


@given(places, st.tuples(*[st.floats(-1, 1)] * 3))
def test_increments_are_continuous(place: tuple[float, float, float], way: tuple[float, float, float]) -> None:
    # Knots, the mirror plane, the edges of the grid and the end of the fade lie on the way as well as anywhere.
    there = np.array(place) + 1e-6 * np.array(way)
    assert np.abs(np.subtract(WAKE.increments(*place), WAKE.increments(*there))).max() < 1e-7


def test_slopes_are_continuous_over_the_knots() -> None:
    x, y, z, _ = load_table(TABLE)
    step = 1e-4
    for knot in (x[5], x[9]):
        slopes = [
            (np.array(WAKE.increments(knot + side + step, 3.3, 7.7)) - WAKE.increments(knot + side - step, 3.3, 7.7))
            / (2 * step)
            for side in (-2 * step, 2 * step)
        ]
        np.testing.assert_allclose(slopes[0], slopes[1], atol=1e-6)
    assert y[0] == -y[-1]
    assert len(z) > 10


@given(st.floats(-120, -10))
def test_weights_reproduce_parabolas(at: float) -> None:
    knots = load_table(TABLE)[0]
    k, *w = weights(knots, at)
    if 0 < k < len(knots) - 2:
        near = knots[k - 1 : k + 3]
        for power in range(3):
            assert (w * near**power).sum() == pytest.approx(at**power, rel=1e-9)
    assert sum(w) == pytest.approx(1.0)


def test_table_is_met_at_its_points() -> None:
    x, y, z, values = load_table(TABLE)
    for i, j, k in ((0, 0, 0), (3, 20, 4), (len(x) - 1, len(y) - 1, len(z) - 1), (8, 17, 9)):
        np.testing.assert_allclose(WAKE.increments(x[i], y[j], z[k]), values[i, j, k], atol=1e-5)


def test_wake_ends_aside_and_goes_on_aft() -> None:
    assert WAKE.increments(-60.0, 40.0 + FADE_M, 0.0) == (0.0,) * 6
    assert WAKE.increments(-60.0, 0.0, 50.0 + FADE_M) == (0.0,) * 6
    assert WAKE.increments(-10.0 + FADE_M, 0.0, 5.0) == (0.0,) * 6
    assert WAKE.increments(-500.0, 5.0, 5.0) == WAKE.increments(-120.0, 5.0, 5.0)
    # What is left at the edge of the grid to fade out is little.
    edge = [WAKE.increments(x, 40.0, z) for x in (-100.0, -50.0, -20.0) for z in (-5.0, 10.0, 40.0)]
    assert np.abs(np.array(edge)[:, 1]).max() < 0.012


def test_at_the_box_the_receiver_flies_in_downwash() -> None:
    dCD, dCL, dCm, *aside = WAKE.increments(-29.0, 0.0, 9.0)
    downwash = dCD / TRIM_CL  # the lift that carries the weight is tilted back by it
    assert np.radians(0.8) < downwash < np.radians(2.0)
    assert -2.5 * downwash < dCL < -1.9 * downwash  # about CLalpha, 2.2 to 2.3 per rad
    assert abs(dCm) < 0.005
    assert aside == [0.0, 0.0, 0.0]


def test_rolling_moment_is_worst_near_the_tip_vortices() -> None:
    _, y, z, values = load_table(TABLE)
    at = np.abs(values[9, :, :, 3])  # x = -34 m
    j, k = np.unravel_index(at.argmax(), at.shape)
    assert 15.0 <= abs(y[j]) <= 23.0
    assert -8.0 <= z[k] <= 4.0
    assert at.max() > 20 * np.abs(values[9, np.abs(y) <= 2.0, :, 3])[:, z >= 6.0].max()
    # In the middle of the right tip's vortex the right wing meets upwash and the left wing downwash.
    assert WAKE.increments(-34.0, 19.0, -2.0)[3] < -0.005
    # Beyond it the upwash is strongest on the left wing.
    assert WAKE.increments(-34.0, 28.0, -2.0)[3] > 0.001
    # Outside the tips it is upwash.
    assert WAKE.increments(-34.0, 30.0, 0.0)[1] > 0.005


def test_no_wake_without_lift() -> None:
    assert Wake(0.0, DENSITY, SPEED).increments(-30.0, 3.0, 8.0) == (0.0,) * 6


def test_strength_of_the_table_is_that_of_its_tanker() -> None:
    assert abs(WEIGHT / (DENSITY * SPEED**2) / WEIGHT_OVER_RHO_V2_M2 - 1.0) < 1e-9


def test_other_process_finds_the_same_bits() -> None:
    place = (-33.3, 4.4, 7.7)
    code = f"from sim_bridge.plant.wake import Wake; print(Wake({WEIGHT}, {DENSITY}, {SPEED}).increments(*{place}))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == str(WAKE.increments(*place))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: None, "cannot be read"),
        (lambda text: text[: len(text) // 2], "cannot be read|not a grid"),
        (lambda text: text.replace("-28,0,8,", "-28,0,8.5,"), "not a grid with y from 0"),
        (lambda text: text.replace("-28,0,8,", "-28,0,8,nan", 1), "cannot be read|finite"),
        (lambda _: "1,2,3\n4,5,6\n", "not nine columns"),
    ],
)
def test_table_that_is_not_whole_is_one_clear_line(
    tmp_path: Path, damage: Callable[[str], str | None], message: str
) -> None:
    path = tmp_path / "wake.csv"
    text = damage(TABLE.read_text(encoding="utf-8"))
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(PlantError, match=message) as error:
        Wake(WEIGHT, DENSITY, SPEED, path)
    assert "\n" not in str(error.value)
    assert "wake_table --write" in str(error.value)
