from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import Vec
from sim_bridge.aero.planforms import KC135R
from sim_bridge.aero.tanker_wake import (
    BETA,
    LIFT_COEFFICIENT,
    STEP_M,
    TAIL_SHARE,
    TankerWake,
    bound_velocity,
    trimmed_wake,
)

WAKE = trimmed_wake()
places = st.tuples(st.floats(-110, -22), st.floats(-40, 40), st.floats(-10, 50))


def lift_coefficient(bound: np.ndarray) -> float:
    return 2.0 * 2.0 * float(bound[:, 6] @ (bound[:, 4] - bound[:, 1])) / KC135R.area_m2


def at_end(wake: TankerWake) -> tuple[Vec, Vec]:
    return wake.path[-1, :, 0], wake.path[-1, :, 1]


@given(places)
def test_air_is_the_mirror_image_of_itself(p: tuple[float, float, float]) -> None:
    right, left = WAKE.velocity(np.array([p, (p[0], -p[1], p[2])]))
    np.testing.assert_allclose(right, left * (1, -1, 1), atol=1e-14)


def test_vortices_carry_the_tanker() -> None:
    wing, tail = WAKE.bound[:24], WAKE.bound[24:]
    assert lift_coefficient(WAKE.bound) == pytest.approx(LIFT_COEFFICIENT, rel=1e-9)
    assert lift_coefficient(tail) == pytest.approx(TAIL_SHARE * LIFT_COEFFICIENT, rel=1e-9)
    # What wing and tail trail is what they carry in the middle (Helmholtz).
    assert WAKE.strength[:24].sum() == pytest.approx(wing[0, 6], rel=1e-12)
    assert WAKE.strength[24:].sum() == pytest.approx(tail[0, 6], rel=1e-12)


def segments(wake: TankerWake) -> tuple[np.ndarray, ...]:
    """Every filament as it bends, from its bound vortex to far aft: ends, strengths, squares of the core."""
    xs = wake.first_x_m - STEP_M * np.arange(len(wake.path))
    a, b, strength, core = [], [], [], []
    for f, begin in enumerate(wake.begin):
        behind = xs < begin
        line = np.vstack((
            [begin, *wake.path[0, f]], np.column_stack((xs, wake.path[:, f]))[behind], [-1e5, *wake.path[-1, f]]
        ))
        for side in (1.0, -1.0):
            points = line * (1.0 / BETA, side, 1.0)
            a.append(points[:-1])
            b.append(points[1:])
            strength.append(np.full(len(points) - 1, side * wake.strength[f]))
            core.append(np.append(wake.core2[0], wake.core2[behind]))
    return np.concatenate(a), np.concatenate(b), np.concatenate(strength), np.concatenate(core)


SEGMENTS = segments(WAKE)


@settings(max_examples=40, deadline=None)
@given(places)
def test_straight_filaments_act_as_the_bent_ones_do(place: tuple[float, float, float]) -> None:
    # Independent: Biot and Savart over every piece of every filament where it is.
    a, b, strength, core = SEGMENTS
    p = np.array(place) * (1.0 / BETA, 1.0, 1.0)
    ra, rb, along = p - a, p - b, b - a
    na, nb = np.linalg.norm(ra, axis=1), np.linalg.norm(rb, axis=1)
    normal = np.cross(ra, rb)
    size = (normal**2).sum(axis=1) + core * (along**2).sum(axis=1)
    k = strength / (4 * math.pi) * (along * (ra * nb[:, None] - rb * na[:, None])).sum(axis=1) / (size * na * nb)
    bent = (k[:, None] * normal).sum(axis=0) * (1.0 / BETA, 1.0, 1.0)
    bent += bound_velocity(*place, WAKE.bound, WAKE.core2[0])
    straight = WAKE.velocity(np.array([place]))[0]
    # 0.0003 of the airspeed is 0.02 degrees of downwash. Along x, what sloping filaments give is left out.
    np.testing.assert_allclose(straight[1:], bent[1:], atol=3e-4)
    assert abs(straight[0] - bent[0]) < 2e-3


def test_far_aft_it_is_a_plane_flow_of_what_is_trailed() -> None:
    y, z = at_end(WAKE)
    where = np.array([-600.0, 0.0, 4.0])
    dy, dz = where[1] - np.concatenate((y, -y)), where[2] - np.concatenate((z, z))
    gamma = np.concatenate((WAKE.strength, -WAKE.strength))
    down = (-gamma * dy / (2 * math.pi * (dy**2 + dz**2 + WAKE.core2[-1]))).sum()
    assert WAKE.velocity(where[None])[0, 2] == pytest.approx(down, rel=0.005)


def test_roll_up_keeps_the_impulse_of_each_side() -> None:
    # Without bound vortices, no force acts on the wake: the sum of strength times y stays; it changes only where wing
    # and tail still act, by a few per cent.
    y0, y1 = WAKE.path[0, :, 0], WAKE.path[-1, :, 0]
    assert WAKE.strength @ y1 == pytest.approx(WAKE.strength @ y0, rel=0.03)
    # Which puts the middle of what the wing trails where Prandtl has it, about pi / 8 of the span aside.
    assert WAKE.strength[:24] @ y1[:24] / WAKE.strength[:24].sum() == pytest.approx(
        math.pi / 8 * KC135R.span_m, rel=0.06
    )


def test_sheet_rolls_up_at_the_tips_and_sinks() -> None:
    # The tip's filament goes inboard over the sheet, those next to it go outboard under it.
    tip, next_in = WAKE.path[:, 23], WAKE.path[:, 20]
    assert tip[100, 0] < tip[0, 0] - 0.5
    assert next_in[100, 0] > next_in[0, 0]
    sunk = WAKE.strength @ (WAKE.path[100, :, 1] - WAKE.path[0, :, 1]) / WAKE.strength.sum()
    # A vortex pair of that strength sinks at Gamma / (2 pi b') over V, 0.7 degrees, so 1.3 m in 100 m.
    apart = 2 * WAKE.strength @ WAKE.path[0, :, 0] / WAKE.strength.sum()
    pair = WAKE.strength.sum() / (2 * math.pi * apart) * 100.0
    assert 0.7 * pair < sunk < 1.5 * pair


def test_downwash_at_the_box_and_upwash_outside() -> None:
    at_box, between, outside = WAKE.velocity(np.array([[-29.0, 0, 9.0], [-40.0, 0.0, 0.0], [-30.0, 27.0, -1.0]]))
    assert math.radians(0.8) < at_box[2] < between[2] < math.radians(2.0)
    assert outside[2] < -math.radians(0.3)
