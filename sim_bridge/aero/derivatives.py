"""Derivatives of both aircraft by the vortex lattice, beside what their XML files hold (``sim-bridge aero``).

A coefficient whose source is ``[vlm]`` is the lattice's at Mach 0.65, ``[vlm x K]`` that times K, rounded as it is
printed there; the others are shown for comparison. Names: ``CLa`` is CL over incidence (rad), b over sideslip, p, q, r
over the rates p b / 2V, q c / 2V, r b / 2V; ``CL_tef`` over a deflection (rad), of one side where there are two: the
right one's, for rolling moments the left one's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from sim_bridge.aero import planforms
from sim_bridge.aero.vortex_lattice import Coefficients, Lattice, derivatives
from sim_bridge.plant.aircraft_data import AIRCRAFT, Coefficient, read_aircraft

MACH = 0.65
NAME = re.compile(r"(?P<coefficient>C[LDYmln])(?P<cause>[abpqr]|_\w+)$")
CAUSES = {"a": "alpha", "b": "beta", "p": "p", "q": "q", "r": "r"}
SOURCE = re.compile(r"vlm(?: x (?P<factor>[\d.]+))?$")

Derivatives = Mapping[str, Coefficients]


@dataclass(frozen=True, slots=True)
class Row:
    """One coefficient as the XML has it, and what the lattice finds (per rad) at Mach 0.65 and 0; None: nothing."""

    given: Coefficient
    lattice: float | None
    incompressible: float | None

    @property
    def factor(self) -> float | None:
        """What the lattice's value is multiplied by in the XML; None when the value is not from the lattice."""
        found = SOURCE.match(self.given.source)
        return float(found["factor"] or 1.0) if found else None

    @property
    def agrees(self) -> bool:
        """Whether the XML's value is this run's within half a unit of its last digit (true when it is not from it)."""
        if self.factor is None:
            return True
        digits = len(self.given.text.partition(".")[2])
        return self.lattice is not None and abs(self.factor * self.lattice - self.given.value) <= 0.5001 * 10.0**-digits


@cache
def run(name: str, mach: float) -> Derivatives:
    """Return the lattice's derivatives of aircraft ``name`` at the incidence of its trim; takes a second."""
    surfaces, reference, alpha = {
        "ice101": (planforms.ice101, planforms.ICE, planforms.ICE_ALPHA_RAD),
        "kc135r": (planforms.kc135r, planforms.KC135R, planforms.KC135R_ALPHA_RAD),
    }[name]
    return derivatives(Lattice(surfaces(), mach), reference, alpha)


def lattice_value(found: Derivatives, name: str) -> float | None:
    """Return the coefficient ``name`` out of ``found``; None when the lattice has no such derivative."""
    parts = NAME.match(name)
    if parts is None:
        return None
    coefficient, cause = parts["coefficient"], parts["cause"]
    control = cause.removeprefix("_")
    side = "l" if coefficient == "Cl" else "r"
    for key in (CAUSES.get(cause, control), f"{control}_{side}"):
        if key in found:
            return float(getattr(found[key], coefficient))
    return None


def compare(name: str) -> list[Row]:
    """Return a row for each coefficient of aircraft ``name``; raises PlantError when its file is not complete."""
    data = read_aircraft(name)
    at_mach, at_rest = run(name, MACH), run(name, 0.0)
    return [Row(c, lattice_value(at_mach, n), lattice_value(at_rest, n)) for n, c in data.coefficients.items()]


def report() -> str:
    """Return the tables of both aircraft as text for people."""
    lines = []
    for name in AIRCRAFT:
        lines += [
            f"{name}: vortex lattice at Mach {MACH} and, without compressibility, at 0, beside {name}.xml (per rad)",
            f"{'coefficient':16}{'XML':>10}{'lattice':>10}{'Mach 0':>10}   source",
        ]
        for row in compare(name):
            if row.lattice is None or row.incompressible is None:
                continue
            told = "" if row.agrees else "   differs: put this run's value there"
            lines.append(f"{row.given.name:16}{row.given.text:>10}{row.lattice:10.4f}{row.incompressible:10.4f}   "
                         f"[{row.given.source}] {row.given.note}{told}")
        lines.append("")
    return "\n".join(lines)
