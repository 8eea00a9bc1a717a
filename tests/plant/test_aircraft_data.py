from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from companion.geometry import GRAVITY_M_S2
from sim_bridge.__main__ import main
from sim_bridge.aero import planforms
from sim_bridge.aero.derivatives import Row, compare
from sim_bridge.aero.vortex_lattice import Trapezoid
from sim_bridge.linearize import Condition, linearize
from sim_bridge.plant.aircraft_data import AIRCRAFT, SLUG_FT2, Coefficient, read_aircraft
from sim_bridge.plant.fdm import LBF, ROOT, Fdm, InitialCondition, PlantError
from sim_bridge.plant.tanker import INPUTS as TANKER_INPUTS
from sim_bridge.plant.world import ALTITUDE_M, UAV_INPUTS

SOURCES = {"ice101": r"recalled|vlm( x 0\.8)?|est|modes", "kc135r": r"fact|dc8|c880|est"}


@pytest.fixture(scope="module", params=AIRCRAFT)
def rows(request: pytest.FixtureRequest) -> list[Row]:
    return compare(request.param)


def test_values_from_the_lattice_are_what_the_lattice_gives(rows: list[Row]) -> None:
    assert [r.given.name for r in rows if not r.agrees] == []
    assert all(r.lattice is not None for r in rows if r.factor is not None)


def test_compressibility_raises_lift_by_less_than_in_two_dimensions(rows: list[Row]) -> None:
    slope = next(r for r in rows if r.given.name == "CLa")
    assert slope.lattice is not None
    assert slope.incompressible is not None
    assert 1.0 < slope.lattice / slope.incompressible < 1.0 / np.sqrt(1.0 - 0.65**2)


def test_receiver_rests_on_the_lattice() -> None:
    by_source = [c.source.split(" ")[0] for c in read_aircraft("ice101").coefficients.values()]
    assert by_source.count("vlm") >= 18


def test_a_value_off_by_one_in_its_last_digit_disagrees() -> None:
    given = Coefficient("CLa", 2.18, "2.18", "vlm", "")
    assert Row(given, 2.1849, 2.0).agrees
    assert not Row(given, 2.1851, 2.0).agrees
    assert not Row(given, None, None).agrees


TANKER_OVER_LATTICE = {
    # Wing, and fin: little else takes part.
    "CLa": (0.838, "thickness and the wing's part inside the body against bare plates, and Mach 0.8 brought to 0.65"),
    "CLq": (0.991, "agrees; but the Convair's includes 2.7 for the rate of change of incidence"),
    "Clb": (0.790, "dihedral and wing height of another aircraft; the lattice has no body under or over the wing"),
    "Clr": (1.082, "agrees: lift of the wing over the span"),
    "Cnb": (0.989, "agrees by chance: a larger fin there, less what the body takes off; here the fin alone"),
    "Cnr": (1.100, "agrees: fin and its arm"),
    # Centre of mass and tailplane of the lattice's aircraft are guessed, and it has no body.
    "Cma": (0.336, "the body moves the neutral point forward and the tail sees more downwash; centre of mass unknown"),
    "Cmq": (0.445, "tailplane and its arm, squared, as for Cma: those of another aircraft"),
    "CL_elevator": (0.369, "tailplane of another aircraft; elevator over all of its span, without gap and friction"),
    "Cm_elevator": (0.353, "the same: the ratio to CL_elevator, the arm, agrees within 5 %"),
    # Thin rigid plates in perfect flow, and a fin on no body.
    "Clp": (0.644, "a thin rigid wing damps more; not accounted for in full, CLa has but a quarter of it"),
    "CY_rudder": (0.718, "rudder without gap and friction"),
    "Cl_rudder": (0.640, "the same"),
    "Cn_rudder": (0.634, "the same"),
    "CYb": (2.173, "body, nacelles and wing carry more side force than the fin, which is all that the lattice has"),
    "Cnp": (0.173, "the wing's part and the fin's nearly cancel: a small difference of two figures"),
}
"""XML over lattice, and what the two do not share; how much each reason makes of it was not taken apart."""


def test_how_far_the_tanker_is_from_the_lattice_is_known() -> None:
    found = {r.given.name: r.given.value / r.lattice for r in compare("kc135r") if r.lattice}
    assert found.keys() == TANKER_OVER_LATTICE.keys()
    for name, (ratio, _) in TANKER_OVER_LATTICE.items():
        assert found[name] == pytest.approx(ratio, rel=0.05), name


@pytest.mark.parametrize(
    ("surfaces", "area_m2", "span_m"),
    [(planforms.ice101(), 75.1, 11.43), (planforms.kc135r()[:2], 226.0, 39.88)],
    ids=AIRCRAFT,
)
def test_planforms_have_the_area_and_span_of_the_aircraft(
    surfaces: tuple[Trapezoid, ...], area_m2: float, span_m: float
) -> None:
    area = sum(0.5 * (s.left_chord_m + s.right_chord_m) * (s.right_frd_m[1] - s.left_frd_m[1]) for s in surfaces)
    reach = [p[1] for s in surfaces for p in (s.left_frd_m, s.right_frd_m)]
    assert area == pytest.approx(area_m2, rel=0.005)
    assert max(reach) - min(reach) == pytest.approx(span_m, abs=1e-9)


@pytest.mark.parametrize("name", AIRCRAFT)
def test_every_number_of_the_file_has_a_source(name: str) -> None:
    text = (ROOT / "aircraft" / name / f"{name}.xml").read_text()
    for c in read_aircraft(name).coefficients.values():
        assert re.fullmatch(SOURCES[name], c.source), c
    for block in ("wingarea", "wingspan", "chord"):
        line = next(s for s in text.splitlines() if f"<{block} " in s)
        assert re.search(r"<!-- \[\w+\]", line), line
    for block in ("mass_balance", "external_reactions"):  # one comment above tells the whole block
        before = text[: text.index(f"<{block}")]
        assert re.search(SOURCES[name], before[before.rindex("<!--") :])
    head = text[: text.index("<fdm_config")]
    assert all(f"[{tag}" in head for tag in {c.source for c in read_aircraft(name).coefficients.values()})


@pytest.mark.parametrize(
    ("was", "becomes", "told"),
    [
        ('<property value="-0.0755"> coef/Clb', '<property value="nan"> coef/Clb', "coef/Clb must be a finite number"),
        ('<property value="-0.0755"> coef/Clb', '<property value=""> coef/Clb', "coef/Clb must be a finite number"),
        ("[est] body alone:", "body alone:", "coef/Cnr has no source"),
        ("<p> coef/Clb </p>", "<p> coef/Clbb </p>", "coef/Clb is given but not used"),
        ("<p> coef/Clb </p>", "<p> coef/Clb </p> <p> coef/new </p>", "coef/new is used but not given"),
        ('<wingspan unit="M"> 11.43', '<wingspan unit="M"> ', "<metrics/wingspan> must be given as a number"),
        ('<wingspan unit="M">', '<wingspan unit="MILE">', "<metrics/wingspan> must be given as a number with a unit"),
        ('<emptywt unit="LBS"> 32750', '<emptywt unit="LBS"> -1', "mass and moments of inertia must be positive"),
        ("78451", "784510", "no body has these moments of inertia"),
        ("</fdm_config>", "", "not an XML file"),
        ("coef/CLq </property>", "coef/CLa </property>", "coef/CLa is given twice"),
    ],
)
def test_incomplete_or_impossible_files_are_refused(tmp_path: Path, was: str, becomes: str, told: str) -> None:
    shutil.copytree(ROOT, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "aircraft" / "ice101" / "ice101.xml"
    text = path.read_text()
    assert text.count(was) == 1
    path.write_text(text.replace(was, becomes))
    with pytest.raises(PlantError, match=rf"ice101\.xml: .*{re.escape(told)}") as error:
        read_aircraft("ice101", tmp_path)
    assert "\n" not in str(error.value)


def test_an_aircraft_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=r"b52\.xml: cannot be read \(No such file or directory\)$"):
        read_aircraft("b52", tmp_path)


def test_effectiveness_scales_what_every_effector_does_and_nothing_else() -> None:
    plain, strong = linearize(Condition()), linearize(Condition(factors={"effectiveness": 1.2}))
    A, B = np.array(plain.airframe.A), np.array(plain.airframe.B)
    np.testing.assert_allclose(np.array(strong.airframe.A)[:, 2:], A[:, 2:], atol=5e-3)
    moments = np.ix_([3, 4, 5], range(1, 10))
    np.testing.assert_allclose(np.array(strong.airframe.B)[moments], 1.2 * B[moments], atol=2e-3)
    assert strong.airframe.B[0][0] == pytest.approx(B[0, 0], rel=1e-3)  # thrust is no effector


@pytest.mark.parametrize(
    ("name", "row", "column"),
    [("Clb", 3, 2), ("Clp", 3, 3), ("Cnb", 5, 2), ("Cma", 4, 1), ("Cmq", 4, 4), ("CYb", 2, 2)],
)
def test_each_coefficient_changes_its_own_derivative(name: str, row: int, column: int) -> None:
    plain, less = (linearize(Condition(factors={name: f})).airframe.A for f in (1.0, 0.5))
    # The rest is drag over mass, products of inertia and gravity: little.
    assert less[row][column] == pytest.approx(0.5 * plain[row][column], abs=0.02 * abs(plain[row][column]) + 0.02)


def test_effector_by_name_changes_its_own_column() -> None:
    plain, less = (np.array(linearize(Condition(factors={"Cl_tef": f})).airframe.B) for f in (1.0, 0.5))
    np.testing.assert_allclose(less[3, 3:5], 0.5 * plain[3, 3:5], rtol=0.02)
    np.testing.assert_allclose(np.delete(less[3], [3, 4]), np.delete(plain[3], [3, 4]), atol=1e-9)


@pytest.mark.parametrize(
    ("model", "inputs", "full", "rated_n"),
    [("ice101", UAV_INPUTS, (1.0, *(0.0,) * 15), 79.2e3), ("kc135r", TANKER_INPUTS, (1e6, 0.0, 0.0, 0.0), 4 * 96.2e3)],
)
def test_thrust_lapses_with_height_and_speed(
    model: str, inputs: tuple[str, ...], full: tuple[float, ...], rated_n: float
) -> None:
    def thrust_n(mach: float, altitude_m: float) -> float:
        fdm = Fdm(model, inputs, 0.005, altitude_m)
        start = InitialCondition((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        fdm.reset(start)
        speed = mach * fdm.speed_of_sound_m_s()
        forward = []
        for values in (full, (0.0,) * len(full)):
            fdm.set_inputs(values)
            fdm.reset(InitialCondition((0.0, 0.0, 0.0), (speed, 0.0, 0.0), (0.0, 0.0, 0.0)))
            forward.append(fdm.accelerations()[0][0])
        return (forward[0] - forward[1]) * fdm.mass_kg

    assert thrust_n(1e-3, 0.0) == pytest.approx(rated_n, rel=0.01)
    assert thrust_n(0.65, 9000.0) < thrust_n(0.65, 6000.0) < thrust_n(0.65, 3000.0) < thrust_n(1e-3, 0.0)
    cruise = {"ice101": 45.3e3, "kc135r": 162e3}[model]
    assert thrust_n(0.65, ALTITUDE_M) == pytest.approx(cruise, rel=0.01)


def test_tanker_gets_the_thrust_it_asks_for_up_to_what_there_is() -> None:
    fdm = Fdm("kc135r", TANKER_INPUTS, 0.005, ALTITUDE_M)
    forward = []
    for ask_n in (0.0, 80e3, 200e3, 300e3):
        fdm.set_inputs((ask_n / LBF, 0.0, 0.0, 0.0))
        fdm.reset(InitialCondition((0.0, 0.0, 0.0), (205.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        forward.append(fdm.accelerations()[0][0] * fdm.mass_kg)
    assert forward[1] - forward[0] == pytest.approx(80e3, rel=1e-6)
    assert forward[3] == forward[2]
    assert forward[2] - forward[0] < 200e3


def test_transferred_fuel_adds_mass_and_inertia_of_its_cylinder() -> None:
    fdm = Fdm("ice101", UAV_INPUTS, 0.005, ALTITUDE_M)

    def inertia() -> tuple[float, ...]:
        """Return Ixx, Iyy, Izz (kg m2) as JSBSim has them by now."""
        return tuple(float(fdm._exec[f"inertia/i{a}{a}-slugs_ft2"]) * SLUG_FT2 for a in "xyz")

    fdm.reset(InitialCondition((0.0, 0.0, 0.0), (200.0, 0.0, 10.0), (0.0, 0.0, 0.0)))
    empty, mass_kg = inertia(), fdm.mass_kg
    for fuel_kg in (600.0, -400.0, 0.0):
        fdm.set_transferred(fuel_kg)
        fdm.step()
        # Cylinder of radius 1 m, length 3 m along x: m r^2 / 2, m (3 r^2 + l^2) / 12.
        more = fuel_kg * np.array([0.5, 1.0, 1.0])
        np.testing.assert_allclose(np.array(inertia()) - empty, more, atol=0.01)
        assert fdm.mass_kg == pytest.approx(mass_kg + fuel_kg)
        force_z = fdm.state(0).specific_force_body_m_s2[2]
        w_dot = fdm.accelerations()[0][2]
        expected = force_z + GRAVITY_M_S2 * np.cos(fdm.pitch) * np.cos(fdm.roll) + _turning(fdm)
        assert w_dot == pytest.approx(expected, abs=1e-3)  # a tenth of a kilogram would be seen


def _turning(fdm: Fdm) -> float:
    """Return q u - p v, what turning axes take off w'."""
    u, v, _ = fdm.rotation().T @ (fdm.v_n, fdm.v_e, fdm.v_d)
    return float(fdm.q * u - fdm.p * v)


def test_aero_prints_both_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["aero"]) == 0
    out = capsys.readouterr().out
    for word in ("ice101", "kc135r", "CL_tef", "[vlm x 0.8]", "[c880]"):
        assert word in out
    assert "differs" not in out
