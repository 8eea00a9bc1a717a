"""From TOML files to configuration: a wrong file is answered with one line that names file, field and unit.

Files named inside a file (``camera``, ``tanker``, ``airframe``, ``calibration``) are relative to that file.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from companion.config.calibration import CALIBRATION_KEYS, SUFFIXES, with_calibration
from companion.config.errors import ConfigError, read_text
from companion.config.guidance import thrust_rule
from companion.config.rules import (
    airframe_rules,
    camera_rules,
    companion_rules,
    enough_detections,
    enough_markers,
    tanker_rules,
)
from companion.config.structures import AirframeConfig, CameraConfig, CompanionConfig, Setup, TankerConfig

UNITS = {
    "_m": "metres",
    "_m_s": "metres per second",
    "_m_s2": "metres per second squared",
    "_rad": "radians",
    "_rad_s": "radians per second",
    "_hz": "hertz",
    "_s": "seconds",
    "_px": "pixels",
    "_ns": "nanoseconds",
    "_kg": "kilograms",
    "_n": "newtons",
    "_baud": "bits per second",
}


T = TypeVar("T")


def load(path: Path | str, kind: type[T]) -> T:
    """Load one TOML file as ``kind``; raises ConfigError with one line that says what to mend."""
    path = Path(path)
    if kind is CameraConfig and path.suffix in SUFFIXES:
        msg = (f"{path}: a calibration knows neither mount nor rate; name a camera TOML in which calibration = "
               f'"{path.name}" stands (`companion camera {path}` prints one)')
        raise ConfigError(msg)
    try:
        raw = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        msg = f"{path}: not valid TOML: {error}"
        raise ConfigError(msg) from None
    return convert(with_calibration(raw, path) if kind is CameraConfig else raw, kind, str(path))


def convert(raw: dict[str, Any], kind: type[T], name: str) -> T:
    """Check a dictionary against ``kind``; ``name`` is what errors call it."""
    try:
        value = msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(explain(str(error), kind, name)) from None
    bad = first_not_finite(raw, "")
    if bad:
        msg = f"{name}: {bad} is not a finite number"
        raise ConfigError(msg)
    return value


def explain(error: str, kind: type, name: str) -> str:
    """Turn msgspec's message into one line with file, field, unit and the nearest right key."""
    where = re.search(r"at `\$(.*?)`", error)
    field = where.group(1).lstrip(".") if where else ""
    unknown = re.search(r"unknown field `(.*?)`", error)
    if unknown:
        key = unknown.group(1)
        names = [*all_field_names(kind), *(CALIBRATION_KEYS if kind is CameraConfig else ())]
        near = difflib.get_close_matches(key, names, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        return f"{name}: unknown key '{f'{field}.' if field else ''}{key}'{hint}"
    what = error.split(" - at ", maxsplit=1)[0]
    unit = unit_of(field)
    return f"{name}: {field or 'file'}: {what}{f' ({unit})' if unit else ''}"


def unit_of(field: str) -> str:
    """Return the unit that a field's name ends in, or an empty string."""
    leaf = re.sub(r"\[.*?\]", "", field).rsplit(".", maxsplit=1)[-1]
    for suffix in sorted(UNITS, key=len, reverse=True):
        if leaf.endswith(suffix):
            return UNITS[suffix]
    return ""


def all_field_names(kind: Any) -> list[str]:
    """Collect the field names of a structure and of the structures inside it."""
    names: list[str] = []
    for f in msgspec.structs.fields(kind):
        names.append(f.encode_name)
        if isinstance(f.type, type) and issubclass(f.type, msgspec.Struct):
            names.extend(all_field_names(f.type))
    return names


def first_not_finite(value: Any, where: str) -> str:
    """Return the path of the first number that is NaN or infinite, or an empty string."""
    if isinstance(value, float) and not math.isfinite(value):
        return where
    children: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        children = [(f"{where}.{k}" if where else k, v) for k, v in value.items()]
    elif isinstance(value, list):
        children = [(f"{where}[{i}]", v) for i, v in enumerate(value)]
    return next((bad for w, v in children if (bad := first_not_finite(v, w))), "")


def load_setup(path: Path | str) -> Setup:
    """Load a companion configuration and the camera, tanker and airframe files that it names."""
    path = Path(path)
    config = load(path, CompanionConfig)
    return assemble(config, path)


def assemble(config: CompanionConfig, path: Path) -> Setup:
    """Load the files that ``config``, from the file ``path``, names relative to itself; check what types do not."""
    folder = path.parent
    setup = Setup(
        config=config,
        camera=load(folder / config.camera, CameraConfig),
        tanker=load(folder / config.tanker, TankerConfig),
        airframe=load(folder / config.airframe, AirframeConfig),
    )
    for file, rules in (
        (path, [*companion_rules(config), enough_detections(config, setup.tanker),
                thrust_rule(config.guidance, setup.airframe.trim.throttle)]),
        (folder / config.camera, camera_rules(setup.camera)),
        (folder / config.tanker, [*tanker_rules(setup.tanker), enough_markers(config, setup.tanker)]),
        (folder / config.airframe, airframe_rules(setup.airframe)),
    ):
        for holds, text in rules:
            if not holds:
                msg = f"{file}: {text}"
                raise ConfigError(msg)
    return setup
