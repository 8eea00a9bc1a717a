from __future__ import annotations

import copy
import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.aero import wake_plots
from sim_bridge.aero.planforms import ICE
from sim_bridge.aero.vortex_lattice import derivatives, fly
from sim_bridge.aero.wake_table import TRIM_CL, ReceiverInWake, grid, main, receiver_lattice, write
from sim_bridge.plant.wake import TABLE, WEIGHT_OVER_RHO_V2_M2, Wake, load_table

LATTICE = receiver_lattice()
WAKE = Wake(WEIGHT_OVER_RHO_V2_M2, 1.0, 1.0)


@pytest.fixture(scope="module")
def receiver() -> ReceiverInWake:
    return ReceiverInWake()


def table(positions: np.ndarray) -> np.ndarray:
    return np.array([WAKE.increments(*p) for p in positions.tolist()])


def test_table_is_what_the_vortex_model_gives(receiver: ReceiverInWake) -> None:
    # Fails when a planform or the model has changed since: python -m sim_bridge.aero.wake_table --write
    positions = grid()[np.random.default_rng(5).choice(len(grid()), 24, replace=False)]
    np.testing.assert_allclose(table(positions), receiver.increments(positions), atol=1.5e-6)


@pytest.mark.slow
def test_table_written_again_is_the_same(tmp_path: Path) -> None:
    write(tmp_path / "wake.csv")
    for ours, theirs in zip(load_table(tmp_path / "wake.csv"), load_table(TABLE), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1.5e-6)


@pytest.mark.parametrize(
    ("low", "high", "share"),
    [
        ((-33.0, -4.0, 4.0), (-25.0, 4.0, 14.0), 0.005),  # the box
        ((-60.0, -25.0, 3.0), (-22.0, 25.0, 35.0), 0.02),  # the way to it
        ((-120.0, -40.0, -10.0), (-12.0, 40.0, 50.0), 0.06),  # everywhere, through the tips' vortices
    ],
)
def test_between_its_points_the_table_is_near(
    receiver: ReceiverInWake, low: tuple[float, ...], high: tuple[float, ...], share: float
) -> None:
    positions = np.random.default_rng(6).uniform(low, high, (30, 3))
    direct = receiver.increments(positions)
    error = np.abs(table(positions) - direct).max(axis=0)
    largest = np.array([0.004, 0.06, 0.005, 0.008, 0.002, 0.006])  # of each increment anywhere near the tanker
    assert np.all(error < share * largest)


class Uniform:
    """Air that moves the same everywhere."""

    def __init__(self, velocity: tuple[float, float, float]) -> None:
        self._velocity = np.array(velocity)

    def velocity(self, points_m: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self._velocity, points_m.shape).copy()


def in_uniform(receiver: ReceiverInWake, velocity: tuple[float, float, float]) -> np.ndarray:
    there = copy.copy(receiver)
    there.wake = Uniform(velocity)
    return there.increments(np.array([[-30.0, 0.0, 5.0]]))[0]


def test_uniform_downwash_is_less_incidence_and_lift_tilted_back(receiver: ReceiverInWake) -> None:
    angle = 0.02
    dCD, dCL, dCm, *aside = in_uniform(receiver, (1.0 - math.cos(angle), 0.0, math.sin(angle)))
    d = derivatives(LATTICE, ICE, 0.06)["alpha"]
    assert dCL == pytest.approx(-d.CL * angle, rel=0.02)
    assert dCm == pytest.approx(-d.Cm * angle, abs=2e-4)
    # At the same lift the induced drag is the same; what is left is that lift, tilted.
    assert dCD == pytest.approx(TRIM_CL * math.sin(angle), rel=0.02)
    np.testing.assert_allclose(aside, 0.0, atol=1e-12)


def test_polar_of_the_whole_lift_and_the_increment_are_the_drag(receiver: ReceiverInWake) -> None:
    # The plant computes polar(CL + dCL) + dCD; the lattice flies the same thing whole.
    angle = 0.02
    dCD, dCL, *_ = in_uniform(receiver, (1.0 - math.cos(angle), 0.0, math.sin(angle)))
    alpha = receiver.alpha_rad + angle
    clean, met = fly(LATTICE, ICE, alpha), fly(LATTICE, ICE, alpha - angle)
    polar = met.CD / met.CL**2
    whole = met.CD * math.cos(angle) + met.CL * math.sin(angle)
    assert polar * (clean.CL + dCL) ** 2 + dCD == pytest.approx(whole, rel=0.02)


def test_uniform_sidewash_is_sideslip(receiver: ReceiverInWake) -> None:
    angle = 0.02
    _, _, _, dCl, dCn, dCY = in_uniform(receiver, (1.0 - math.cos(angle), -math.sin(angle), 0.0))
    # Air that moves to the left meets the aircraft from the right, as in positive sideslip.
    d = derivatives(LATTICE, ICE, 0.0622)["beta"]
    assert dCl == pytest.approx(d.Cl * angle, rel=0.06)
    assert dCn == pytest.approx(d.Cn * angle, abs=1e-5)
    assert dCY == pytest.approx(d.CY * angle, abs=2e-5)


def test_command_prints_the_increments_at_the_box(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert f"dCL {WAKE.increments(-29.0, 0.0, 9.0)[1]:+.4f}" in capsys.readouterr().out


def test_picture_is_drawn(tmp_path: Path) -> None:
    assert wake_plots.main(["--out", str(tmp_path / "new")]) == 0
    assert (tmp_path / "new" / "wake.png").read_bytes().startswith(b"\x89PNG")
