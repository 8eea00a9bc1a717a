"""What all configuration structures are made of."""

from __future__ import annotations

import msgspec


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all configuration: frozen, and a misspelt key is an error."""


Vec3 = tuple[float, float, float]

Rules = list[tuple[bool, str]]
"""What has to hold of values that are of the right type, and what to say when it does not."""
