from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.config import AirframeConfig, ConfigError, load
from sim_bridge.__main__ import main
from sim_bridge.linearize import (
    AIRFRAME_FILE,
    Condition,
    Linearization,
    TankerModel,
    coupling,
    linearize,
    linearize_tanker,
    report,
    structure,
    tanker_report,
    write_airframe,
)
from sim_bridge.linearize.published import BOEING_747, CONVAIR_880
from sim_bridge.plant.actuators import default_channels
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.response import STEP_RAD, second_order_step, step_response


@pytest.fixture(scope="module")
def result() -> Linearization:
    return linearize()


@pytest.fixture(scope="module")
def tanker_model() -> TankerModel:
    return linearize_tanker()


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
    assert all(holds for _, _, holds in structure(result.modes))


def test_planes_are_decoupled_and_sides_mirror(result: Linearization) -> None:
    A, B = np.array(result.airframe.A), np.array(result.airframe.B)
    longitudinal, lateral = [0, 1, 4, 7], [2, 3, 5, 6, 8]
    assert np.abs(A[np.ix_(longitudinal, lateral)]).max() < 1e-6
    assert np.abs(A[np.ix_(lateral, longitudinal)]).max() < 1e-6
    assert coupling(A)[0] < 1e-6
    sign = np.array([1, 1, -1, -1, 1, -1, -1, 1, -1])
    for right, left in ((1, 2), (3, 4), (5, 6), (8, 9)):
        np.testing.assert_allclose(B[:, right], sign * B[:, left], atol=1e-6)


def test_coupling_is_found_and_named() -> None:
    A = np.eye(9)
    A[4, 2] = -0.25  # q' over beta
    assert coupling(A) == (0.25, "q' over beta")


def test_structure_tells_what_does_not_hold() -> None:
    steady = linearize(Condition(factors={"Cnb": -1.0}))  # a fin: dutch roll instead of two unstable real modes
    assert {m.name for m in steady.modes} >= {"dutch roll", "roll", "spiral"}
    assert [holds for _, _, holds in structure(steady.modes)] == [True, True, False, False, False, False]
    assert "FAILS" in report(steady)


def test_tanker_trims_and_flies_as_an_airliner(tanker_model: TankerModel) -> None:
    assert tanker_model.trim.residual < 1e-6
    assert [m.name for m in tanker_model.modes] == ["short period", "phugoid", "dutch roll", "roll", "spiral"]
    assert all(m.eigenvalue.real < 0 for m in tanker_model.modes)
    assert coupling(tanker_model.A)[0] < 1e-6
    # Within a factor of two of the two published aircraft of its kind, but for the slow spiral.
    for aircraft in (CONVAIR_880, BOEING_747):
        for ours, theirs in zip(tanker_model.modes[:4], aircraft.modes()[:4], strict=True):
            assert 0.5 < abs(ours.eigenvalue) / abs(theirs.eigenvalue) < 2.0, ours.name


def test_tanker_has_the_modes_of_the_textbook(tanker_model: TankerModel) -> None:
    # Two ways from the same coefficients: differences of JSBSim's accelerations, and the small-disturbance equations.
    for ours, theirs in zip(tanker_model.modes, tanker_model.textbook.modes(), strict=True):
        assert abs(ours.eigenvalue - theirs.eigenvalue) < 2e-3 * max(abs(ours.eigenvalue), 1.0), ours.name


def test_tanker_report_puts_published_modes_beside(tanker_model: TankerModel) -> None:
    text = tanker_report(tanker_model)
    for word in ("Convair 880", "Boeing 747", "dutch roll", "residual", "A (columns", "B (columns"):
        assert word in text


def test_phugoid_is_slower_the_faster_it_flies() -> None:
    # Lanchester: frequency sqrt(2) g / V, so it falls with speed.
    slow, fast = (
        next(abs(m.eigenvalue) for m in linearize_tanker(Condition(mach=mach)).modes if m.name == "phugoid")
        for mach in (0.58, 0.72)
    )
    assert slow / fast == pytest.approx(0.72 / 0.58, rel=0.05)


@pytest.mark.parametrize("model", [linearize, linearize_tanker])
@pytest.mark.parametrize(
    ("condition", "error", "text"),
    [
        (Condition(mach=0.9), ConfigError, r"^--mach 0\.9: .* hold for Mach 0\.55 to 0\.75$"),
        (Condition(mach=math.nan), ConfigError, r"^--mach nan: "),
        (Condition(altitude_m=12000.0), ConfigError, r"^--altitude 12000: .* hold for 3000 to 9000 m$"),
        (Condition(factors={"Cxx": 2.0}), ConfigError, r"^--scale Cxx: .* no such coefficient; there are .*CLa"),
        (Condition(factors={"CLa": 0.0}), PlantError, r"does not trim at Mach 0\.65, 6000 m: "),
    ],
)
def test_what_cannot_be_trimmed_is_told_in_one_line(
    model: Callable[[Condition], object], condition: Condition, error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text) as told:
        model(condition)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--scale", "Cnb"], "--scale Cnb: must be NAME=FACTOR, e.g. Cnb=0.5"),
        (["--scale", "Cnb=nan"], "--scale Cnb=nan: must be NAME=FACTOR, e.g. Cnb=0.5"),
        (["--write", "--mach", "0.6"], "--write: the companion's airframe is the receiver at Mach 0.65"),
        (["--aircraft", "kc135r", "--write"], "--write: the companion's airframe is the receiver at Mach 0.65"),
    ],
)
def test_bad_options_end_in_one_line(options: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["linearize", *options]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert text in told.err
    assert told.err.count("\n") == 1


def test_command_prints_the_tanker(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["linearize", "--aircraft", "kc135r", "--altitude", "5000", "--scale", "Cnb=0.8"]) == 0
    out = capsys.readouterr().out
    assert "5000 m" in out.splitlines()[0]
    assert "with Cnb x 0.8" in out


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
