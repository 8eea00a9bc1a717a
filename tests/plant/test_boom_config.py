"""Booms that cannot be built are one line that names the field."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from companion.config import FIRMWARE_CONFIGS, BoomConfig, TankerConfig, load
from companion.config.boom import boom_rules

SHIPPED = load(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig).boom


def wrong(boom: BoomConfig) -> list[str]:
    return [text for holds, text in boom_rules(boom) if not holds]


def test_shipped_boom_and_one_with_only_a_pivot_can_be_built() -> None:
    assert wrong(SHIPPED) == []
    assert wrong(BoomConfig(pivot_tanker_m=(-16.5, 0.0, 2.0))) == []


@pytest.mark.parametrize(
    ("part", "change", "named"),
    [
        ("tubes", {"outer_mass_kg": 0.0}, "outer_mass_kg"),
        ("tubes", {"inner_mass_kg": -250.0}, "inner_mass_kg"),
        ("tubes", {"outer_com_m": 9.0}, "outer_com_m"),
        ("tubes", {"inner_diameter_m": 580.0}, "inner_diameter_m"),
        ("tubes", {"inner_length_m": 6.0}, "inner_length_m"),
        ("tubes", {"cross_drag": -0.1}, "drag"),
        ("ruddevators", {"at_m": 12.0}, "at_m"),
        ("ruddevators", {"area_m2": 0.0}, "area_m2"),
        ("ruddevators", {"dihedral_rad": 42.0}, "radians, not degrees"),
        ("ruddevators", {"lag_s": 0.0}, "lag_s"),
        ("drive", {"force_n": 0.0}, "force_n"),
        ("envelope", {"elevation_rad": (0.7, 0.3)}, "elevation_rad"),
        ("envelope", {"azimuth_rad": 10.0}, "radians, not degrees"),
        ("envelope", {"extension_m": (5.5, 1.8)}, "extension_m"),
        ("envelope", {"stop_extension_m": 9.0}, "falls out"),
        ("nozzle", {"stiffness_n_m": 1e8}, "stiffness_n_m"),
        ("nozzle", {"capture_m": 0.0}, "capture_m"),
        ("", {"ready_length_m": 20.0}, "ready_length_m"),
        ("", {"elevation_rad": 30.0}, "radians, not degrees"),
    ],
)
def test_a_boom_that_cannot_be_built_is_named(part: str, change: dict[str, Any], named: str) -> None:
    if part:
        change = {part: msgspec.structs.replace(getattr(SHIPPED, part), **change)}
    told = wrong(msgspec.structs.replace(SHIPPED, **change))
    assert any(named in text for text in told), told
    assert all(text.startswith("boom") for text in told)
