from __future__ import annotations

import importlib
import math
import warnings
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_bridge.aero.vortex_lattice import (
    Control,
    Lattice,
    Reference,
    Trapezoid,
    coefficients,
    derivatives,
    fly,
    moving,
    uniform,
)


def wing(
    span: float, root: float, tip: float, tip_aft: float, n_span: int, n_chord: int, **more: Any
) -> list[Trapezoid]:
    right = Trapezoid((0.0, 0.0, 0.0), (-tip_aft, span / 2, 0.0), root, tip, n_span, n_chord, **more)
    return [right.mirrored(), right]


def elliptic(aspect: float, n: int) -> tuple[list[Trapezoid], Reference]:
    """Wing of span 1 with a straight quarter-chord line and chords c0 sqrt(1 - (2y)^2), closed by a pointed tip."""
    c0 = 4.0 / (math.pi * aspect)
    y = 0.5 * np.sin(np.linspace(0.0, math.pi / 2, n + 1))
    c = c0 * np.sqrt(np.maximum(1.0 - 4.0 * y * y, 0.0))
    right = [
        Trapezoid((c[i] / 4, y[i], 0.0), (c[i + 1] / 4, y[i + 1], 0.0), c[i], c[i + 1], 1, 1) for i in range(n)
    ]
    area = 2 * sum(0.5 * (c[i] + c[i + 1]) * (y[i + 1] - y[i]) for i in range(n))
    return [t.mirrored() for t in right] + right, Reference(area, 1.0, c0)


@pytest.fixture(scope="module")
def asb() -> ModuleType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module("aerosandbox")  # slow to import: only where it is the oracle


def test_swept_wing_of_the_text_book() -> None:
    # Bertin & Smith, Aerodynamics for Engineers: aspect ratio 5, 45 degrees of sweep, four panels a side: 3.443/rad.
    lattice = Lattice(wing(1.0, 0.2, 0.2, 0.5, 4, 1))
    slope = derivatives(lattice, Reference(0.2, 1.0, 0.2), 0.0)["alpha"].CL
    assert slope == pytest.approx(3.443, abs=0.002)


@settings(max_examples=8, deadline=None)
@given(
    st.tuples(st.floats(0.2, 1.0), st.floats(0.0, 6.0), st.floats(-1.0, 1.0)),
    st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)
def test_forces_are_those_of_aerosandbox(
    asb: ModuleType, shape: tuple[float, ...], angles: tuple[float, float], rates: tuple[float, float, float]
) -> None:
    taper, aft, drop = shape
    alpha, beta = angles
    airfoil = asb.Airfoil(coordinates=np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), name="plate")
    ends = [asb.WingXSec([0, 0, 0], 3.0, airfoil=airfoil), asb.WingXSec([aft, 5, -drop], 3.0 * taper, airfoil=airfoil)]
    airplane = asb.Airplane(
        xyz_ref=[0, 0, 0], wings=[asb.Wing(symmetric=True, xsecs=ends)], s_ref=20, b_ref=10, c_ref=2
    )
    point = asb.OperatingPoint(
        velocity=10, alpha=math.degrees(alpha), beta=math.degrees(beta), **dict(zip("pqr", rates, strict=True))
    )
    theirs = asb.VortexLatticeMethod(
        airplane, point, spanwise_resolution=6, chordwise_resolution=3, spanwise_spacing_function=np.linspace,
        chordwise_spacing_function=np.linspace,
    ).run()
    right = Trapezoid((0.0, 0.0, 0.0), (-aft, 5.0, drop), 3.0, 3.0 * taper, 6, 3)
    lattice = Lattice([right.mirrored(), right], legs_bear_load=False)
    solution = lattice.solve_in(moving(10.0, alpha, beta, rates))
    density = point.atmosphere.density()
    np.testing.assert_allclose(density * solution.force, theirs["F_b"], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(density * solution.moment, theirs["M_b"], rtol=1e-6, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.1, 0.1), st.floats(-0.2, 0.2), st.tuples(*[st.floats(-0.1, 0.1)] * 3), st.floats(-0.3, 0.3))
def test_mirrored_flow_gives_the_mirrored_force(
    alpha: float, beta: float, rates: tuple[float, float, float], flap: float
) -> None:
    lattice = Lattice(
        wing(8.0, 2.0, 1.0, 1.5, 5, 3, controls=(Control("flap_r", (0.6, 0.8)),), right_incidence_rad=-0.05)
    )
    reference = Reference(12.0, 8.0, 1.5, (-1.0, 0.0, 0.2))
    p, q, r = rates
    one = fly(lattice, reference, alpha, beta, (p, q, r), {"flap_r": flap})
    other = fly(lattice, reference, alpha, -beta, (-p, q, -r), {"flap_l": flap})
    np.testing.assert_allclose(one[:3], other[:3], atol=1e-12)
    np.testing.assert_allclose(one[3:], [-v for v in other[3:]], atol=1e-12)


def test_slender_delta_is_that_of_jones() -> None:
    # Jones, NACA TR 835: CLalpha = pi A / 2, Clp = -pi A / 32, lift at 2/3 of the root chord, as A goes to nought.
    found = []
    for aspect in (0.4, 0.2, 0.1):
        root = 2.0 / aspect
        lattice = Lattice(wing(1.0, root, 0.0, root, 10, 10))
        d = derivatives(lattice, Reference(root / 2, 1.0, root, (-2 * root / 3, 0.0, 0.0)), 0.0)
        found.append((d["alpha"].CL / (math.pi * aspect / 2), d["p"].Cl / (-math.pi * aspect / 32), d["alpha"].Cm))
    lift, roll, pitch = np.array(found).T
    assert np.all(np.diff(lift) > 0)
    assert lift[-1] == pytest.approx(1.0, abs=0.03)
    assert roll[-1] == pytest.approx(1.0, abs=0.04)
    assert abs(pitch[-1]) < 0.01 * math.pi * 0.1 / 2


def test_elliptic_wing_is_that_of_prandtl() -> None:
    surfaces, reference = elliptic(40.0, 40)
    c = fly(Lattice(surfaces), reference, 0.05)
    aspect = 1.0 / reference.area_m2
    assert c.CL / math.sin(0.05) == pytest.approx(2 * math.pi / (1 + 2 / aspect), rel=0.01)
    assert math.pi * aspect * c.CD / c.CL**2 == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("alpha", [0.03, 0.15])
def test_drag_is_that_of_the_far_wake(alpha: float) -> None:
    # Munk's stagger theorem: the drag is what the trailing vortices say far behind, in two dimensions. In a rectangular
    # lattice it holds panel by panel.
    lattice = Lattice(wing(8.0, 2.0, 2.0, 0.0, 7, 4, right_incidence_rad=-0.1))
    solution = lattice.solve_in(lambda p: np.broadcast_to(uniform(1.0, alpha), p.shape))
    y = 0.5 * (lattice.left + lattice.right)[:, 1]
    width = (lattice.right - lattice.left)[:, 1]
    shed_y = np.concatenate((lattice.left[:, 1], lattice.right[:, 1]))
    shed = np.concatenate((-solution.gamma, solution.gamma))
    down = (shed / (2 * math.pi * (shed_y - y[:, None]))).sum(axis=1)
    far = 0.5 * (solution.gamma * down * width).sum() * math.cos(alpha)
    drag = coefficients(solution, Reference(2.0, 1.0, 1.0), 1.0, alpha)[0]
    np.testing.assert_allclose(drag, far, rtol=1e-9)


@pytest.mark.parametrize("mach", [0.4, 0.65, 0.9])
def test_compressible_wing_is_a_longer_one_in_incompressible_flow(mach: float) -> None:
    # Prandtl-Glauert similarity: beta CLalpha(Mach; A, tan sweep) = CLalpha(0; beta A, tan sweep / beta).
    beta = math.sqrt(1 - mach**2)
    reference = Reference(8.0, 8.0, 1.0)
    fast = derivatives(Lattice(wing(8.0, 1.2, 0.8, 3.0, 6, 3), mach), reference, 0.0)
    slow = derivatives(Lattice(wing(8.0 * beta, 1.2, 0.8, 3.0, 6, 3)), Reference(8.0 * beta, 8 * beta, 1.0), 0.0)
    assert beta * fast["alpha"].CL == pytest.approx(slow["alpha"].CL, rel=1e-9)
    assert beta * fast["p"].Cl == pytest.approx(slow["p"].Cl, rel=1e-9)


def test_flap_and_camber_are_those_of_thin_aerofoils() -> None:
    # Glauert: with cos(theta) = 1 - 2 x_hinge, all behind the hinge has the lift of 1 - (theta - sin(theta)) / pi of an
    # incidence, all before it that of the rest; a parabola of height h has no lift at an incidence of -2 h.
    reference = Reference(400.0, 400.0, 1.0)

    def ahead(x: float) -> float:
        theta = math.acos(1 - 2 * x)
        return (theta - math.sin(theta)) / math.pi

    controls = (Control("flap_r", (0.75, 0.75)), Control("lef_r", (0.0, 0.0), (0.2, 0.2), -1.0))
    d = derivatives(Lattice(wing(400.0, 1.0, 1.0, 0.0, 4, 40, controls=controls)), reference, 0.0)
    both = {name: (d[f"{name}_r"].CL + d[f"{name}_l"].CL) / d["alpha"].CL for name in ("flap", "lef")}
    # Forty panels along the chord are right to a hundredth, and the more the nearer.
    assert both["flap"] == pytest.approx(1 - ahead(0.75), abs=0.01)
    assert both["lef"] == pytest.approx(-ahead(0.2), abs=0.0025)
    assert d["flap_l"].Cl > 0 > d["flap_r"].Cl
    cambered = Lattice(wing(400.0, 1.0, 1.0, 0.0, 4, 40, camber=0.02))
    assert abs(fly(cambered, reference, -2 * 0.02).CL) < 1e-3


def test_signs_are_those_of_flight_dynamics() -> None:
    swept = Lattice([*wing(10.0, 2.0, 1.0, 4.0, 8, 3), Trapezoid((-6.0, 0, 0), (-7.0, 0.0, -2.0), 1.5, 1.0, 5, 3)])
    d = derivatives(swept, Reference(15.0, 10.0, 1.5, (-1.5, 0.0, 0.0)), 0.1)
    assert d["alpha"].CL > 0 > d["alpha"].Cm  # the lift is behind the reference point
    assert d["p"].Cl < 0
    assert d["q"].Cm < 0
    assert d["r"].Cn < 0  # the fin
    assert d["r"].Cl > 0  # the advancing wing lifts more
    assert d["beta"].Cl < 0  # sweep and fin
    assert d["beta"].Cn > 0 > d["beta"].CY


def test_more_panels_converge() -> None:
    reference = Reference(0.2, 1.0, 0.2)
    slopes = [
        derivatives(Lattice(wing(1.0, 0.2, 0.2, 0.5, n, n // 4)), reference, 0.0)["alpha"].CL for n in (4, 8, 16, 24)
    ]
    steps = np.abs(np.diff(slopes))
    assert np.all(steps[1:] < 0.75 * steps[:-1])
    assert steps[-1] < 0.01 * slopes[-1]


def test_many_flows_at_once_are_the_same_as_one_by_one() -> None:
    lattice = Lattice(wing(8.0, 2.0, 1.0, 1.5, 4, 2))
    rng = np.random.default_rng(0)
    at_c, at_f = rng.normal(size=(3, lattice.n, 3)), rng.normal(size=(3, len(lattice.force_points), 3))
    together = lattice.solve(at_c, at_f)
    for k in range(3):
        alone = lattice.solve(at_c[k], at_f[k])
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_allclose(a[k], b, rtol=1e-9, atol=1e-12)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="at least one surface and 0 <= Mach < 1, not 0 and 0"):
        Lattice([])
    with pytest.raises(ValueError, match=r"not 2 and 1\.0"):
        Lattice(wing(8.0, 2.0, 1.0, 1.5, 4, 2), mach=1.0)
    with pytest.raises(ValueError, match="has no span"):
        Lattice([Trapezoid((0, 0, 0), (0, 0, 0), 1.0, 1.0, 2, 2)])
    with pytest.raises(ValueError, match="no control 'rudder'; there are none"):
        fly(Lattice(wing(8.0, 2.0, 1.0, 1.5, 4, 2)), Reference(1, 1, 1), 0.0, deflections={"rudder": 0.1})
