"""Reflectances 0..1, red green blue, of what the aircraft are painted with: none of it is red."""

from __future__ import annotations

GREY = (0.60, 0.63, 0.67)
LIGHT = (0.70, 0.73, 0.76)
DARK = (0.20, 0.22, 0.25)
BLACK = (0.05, 0.06, 0.07)
METAL = (0.45, 0.47, 0.50)
YELLOW = (0.72, 0.68, 0.16)
GREEN = (0.20, 0.55, 0.30)
WHITE = (0.86, 0.87, 0.88)
STEALTH = (0.34, 0.37, 0.41)
