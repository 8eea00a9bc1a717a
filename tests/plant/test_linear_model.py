from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.config import AirframeConfig, ConfigError, load
from sim_bridge.linearize import AIRFRAME_FILE, Linearization, linearize, report, write_airframe
from sim_bridge.plant.actuators import default_channels
from sim_bridge.plant.response import STEP_RAD, second_order_step, step_response


@pytest.fixture(scope="module")
def result() -> Linearization:
    return linearize()


def test_trim_is_balanced_and_inside_the_limits(result: Linearization) -> None:
    assert result.residual < 1e-9
    trim = result.airframe.trim
    # Speed of sound of the standard atmosphere at 6 km.
    assert trim.airspeed_m_s == pytest.approx(0.65 * 316.45, abs=0.05)
    for channel, value in zip(default_channels(), trim.effectors, strict=True):
        assert channel.low <= value <= channel.high
    assert 0.2 < trim.throttle < 0.8


def test_modes_are_those_of_the_thesis(result: Linearization) -> None:
    modes = {name: [m.eigenvalue for m in result.modes if m.name == name] for name in {m.name for m in result.modes}}
    assert set(modes) == {"short period", "phugoid", "lateral"}
    short, phugoid = modes["short period"][0], modes["phugoid"][0]
    assert short.imag > 0 > short.real  # thesis 3.7: two complex pairs, one fast and one slow
    assert phugoid.imag > 0 > phugoid.real
    assert abs(short) > 10 * abs(phugoid)
    lateral = modes["lateral"]
    assert len(lateral) == 4
    assert all(v.imag == 0 for v in lateral)
    assert sum(v.real > 0 for v in lateral) == 2  # thesis 3.8


def test_planes_are_decoupled_and_sides_mirror(result: Linearization) -> None:
    A, B = np.array(result.airframe.A), np.array(result.airframe.B)
    longitudinal, lateral = [0, 1, 4, 7], [2, 3, 5, 6, 8]
    assert np.abs(A[np.ix_(longitudinal, lateral)]).max() < 1e-6
    assert np.abs(A[np.ix_(lateral, longitudinal)]).max() < 1e-6
    sign = np.array([1, 1, -1, -1, 1, -1, -1, 1, -1])
    for right, left in ((1, 2), (3, 4), (5, 6), (8, 9)):
        np.testing.assert_allclose(B[:, right], sign * B[:, left], atol=1e-6)


def test_shipped_file_is_what_linearize_finds(result: Linearization) -> None:
    shipped, found = load(AIRFRAME_FILE, AirframeConfig), result.airframe
    np.testing.assert_allclose(shipped.A, found.A, atol=1e-6)
    np.testing.assert_allclose(shipped.B, found.B, atol=1e-6)
    np.testing.assert_allclose(shipped.trim.effectors, found.trim.effectors, atol=1e-9)
    assert shipped.response.pitch_rad_s == pytest.approx(found.response.pitch_rad_s, rel=1e-3)


def test_file_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "new" / "airframe.toml"
    written = write_airframe(path)
    assert load(path, AirframeConfig) == written.airframe


def test_a_file_that_cannot_be_written_is_told_with_the_option(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"^.*file/below\.toml: cannot be written \(.*\); .* with --write$"):
        write_airframe(tmp_path / "file" / "below.toml")


def test_report_tells_trim_modes_and_matrices(result: Linearization) -> None:
    text = report(result)
    for word in ("short period", "phugoid", "residual", "A (columns", "B (columns", "amt_r 8.00"):
        assert word in text


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_identified_response_is_the_response(axis: str, airframe: AirframeConfig) -> None:
    r = airframe.response
    w, z = (r.roll_rad_s, r.roll_damping) if axis == "roll" else (r.pitch_rad_s, r.pitch_damping)
    t, angle = step_response(airframe, axis, -STEP_RAD[axis]).T  # the other way than it was identified from
    np.testing.assert_allclose(angle / -STEP_RAD[axis], second_order_step(t - r.delay_s, w, z), atol=0.03)


def test_attitude_loops_are_fast_enough(airframe: AirframeConfig) -> None:
    r = airframe.response
    assert r.roll_rad_s >= 8.0  # what the outer loop of a docking needs
    assert r.pitch_rad_s >= 5.5
    assert r.delay_s < 0.06


@pytest.mark.parametrize("damping", [0.4, 0.999999999, 1.0, 1.7])
def test_second_order_step_solves_its_equation(damping: float) -> None:
    t = np.linspace(0.0, 2.0, 4001)
    w = 6.0
    y = second_order_step(t, w, damping)
    dy = np.gradient(y, t)
    ddy = np.gradient(dy, t)
    np.testing.assert_allclose((ddy + 2 * damping * w * dy + w * w * y)[5:-5], w * w, rtol=1e-3)
    assert y[0] == 0.0
