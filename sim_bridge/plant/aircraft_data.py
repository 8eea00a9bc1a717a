"""The data of the aircraft as their XML files tell them: every coefficient with its source, mass and inertia.

Rules
-----
* A coefficient is one line: ``<property value="V"> coef/NAME </property> <!-- [source] note -->``. Without a source in
  square brackets, or without a finite value, the file is refused.
* Functions use no coefficient that is not given, and none is given twice or that no function uses.
* Masses, areas and moments of inertia are those of a body that can exist.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from sim_bridge.plant.fdm import FT, LBF, ROOT, PlantError, read_xml

AIRCRAFT = ("ice101", "kc135r")
LINE = re.compile(
    r'<property\s+value="(?P<value>[^"]*)">\s*coef/(?P<name>\w+)\s*</property>'
    r"[ \t]*(?:<!--\s*\[(?P<source>[^\]]+)\]\s*(?P<note>.*?)\s*-->)?"
)
SLUG_FT2 = LBF * FT
UNITS = {"M2": 1.0, "M": 1.0, "KG": 1.0, "KG*M2": 1.0, "LBS": 0.45359237, "SLUG*FT2": SLUG_FT2}
"""What one of each unit is in m2, m, kg or kg m2."""


@dataclass(frozen=True, slots=True)
class Coefficient:
    """``coef/NAME`` of an aircraft; ``text`` as it is printed there, ``source`` what stands in square brackets."""

    name: str
    value: float
    text: str
    source: str
    note: str


@dataclass(frozen=True, slots=True)
class AircraftData:
    """Reference area, span and chord (m2, m), mass (kg), Ixx, Iyy, Izz, Ixz (kg m2, Ixz the integral of x z dm)."""

    name: str
    area_m2: float
    span_m: float
    chord_m: float
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float, float]
    coefficients: dict[str, Coefficient]

    def values(self) -> dict[str, float]:
        """Return the coefficients by name."""
        return {name: c.value for name, c in self.coefficients.items()}


def read_aircraft(name: str, root: Path = ROOT) -> AircraftData:
    """Return the data of aircraft ``name``; raises PlantError, with the file's name, when they are not complete."""
    path = root / "aircraft" / name / f"{name}.xml"
    text, tree = read_xml(path)
    area, span, chord = (_number(tree, path, f"metrics/{k}") for k in ("wingarea", "wingspan", "chord"))
    balance = ("emptywt", "ixx", "iyy", "izz", "ixz")
    mass, ixx, iyy, izz, ixz = (_number(tree, path, f"mass_balance/{k}") for k in balance)
    if not (min(area, span, chord, mass, ixx, iyy, izz) > 0.0):
        msg = f"{path}: wing area, span, chord, mass and moments of inertia must be positive"
        raise PlantError(msg)
    if 2.0 * max(ixx, iyy, izz) > ixx + iyy + izz or ixz * ixz > ixx * izz:
        msg = f"{path}: no body has these moments of inertia: one exceeds the sum of the others, or ixz is too large"
        raise PlantError(msg)
    return AircraftData(name, area, span, chord, mass, (ixx, iyy, izz, ixz), _coefficients(text, path))


def _number(tree: ET.Element, path: Path, tag: str) -> float:
    element = tree.find(tag)
    unit = "" if element is None else element.get("unit", "")
    value = _finite("" if element is None else element.text)
    if value is None or unit not in UNITS:
        msg = f"{path}: <{tag}> must be given as a number with a unit of {', '.join(UNITS)}"
        raise PlantError(msg)
    return value * UNITS[unit]


def _coefficients(text: str, path: Path) -> dict[str, Coefficient]:
    found: dict[str, Coefficient] = {}
    for line in LINE.finditer(text):
        name, value = line["name"], _finite(line["value"])
        if value is None:
            msg = f"{path}: coef/{name} must be a finite number, not {line['value']!r}"
            raise PlantError(msg)
        if line["source"] is None:
            msg = f"{path}: coef/{name} has no source; add <!-- [source] --> behind it"
            raise PlantError(msg)
        if name in found:
            msg = f"{path}: coef/{name} is given twice; leave one of them"
            raise PlantError(msg)
        found[name] = Coefficient(name, value, line["value"], line["source"], line["note"])
    used = set(re.findall(r"<(?:p|property)>\s*coef/(\w+)\s*<", text))
    if used != set(found):
        name = min(used ^ set(found))
        msg = f"{path}: coef/{name} is {'used but not given' if name in used else 'given but not used'}"
        raise PlantError(msg)
    return found


def _finite(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
