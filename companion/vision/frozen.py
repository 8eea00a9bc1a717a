"""Frozen results, built in half the time: fields are set through the slots, without a look-up for each.

A solver takes two microseconds; the constructors that ``dataclass`` writes for its two frozen results take one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from companion.geometry import SE3, Mat, Vec

blank = object.__new__


def slots_of(kind: type[Any]) -> tuple[Callable[[Any, Any], None], ...]:
    """Return what sets each field of a dataclass with slots, in their order."""
    return tuple(kind.__dict__[field.name].__set__ for field in fields(kind))


put_rotation, put_translation = slots_of(SE3)


def rigid(R: Mat, t: Vec) -> SE3:
    """Return ``SE3(R, t)``."""
    T = blank(SE3)
    put_rotation(T, R)
    put_translation(T, t)
    return T
