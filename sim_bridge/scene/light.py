"""Where light comes from and how strong it is, for a scenario's conditions.

Rules
-----
* Radiances are in full scales of the sensor times ``scale``: as much of the gain as sky and airframe bear without
  clipping is put into them before they are rounded to bytes, so that a night is not a staircase of four greys; the
  ``rest`` of the gain comes after the lights are laid over them.
* A lower sun is weaker and warmer by the Rayleigh scattering of the air above (optical depths: Hansen and Travis, Space
  Sci. Rev. 16, 1974, eq. 2.30; air mass: Kasten and Young, Appl. Opt. 28, 1989), each in proportion to the default sun.
* Sky and what lies below it get weaker with the sine of the sun's elevation, the sky only by two thirds of it
  (estimated: a clear sky's own light against that of a lit deck of cloud).
* In cloud there is no sun: light comes from everywhere, from above by a seventh more (estimated).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.geometry import Mat, Vec
from sim_bridge.scene.conditions import PictureConditions

SUNLIGHT = np.array([0.62, 0.62, 0.60])
FROM_ABOVE = np.array([0.38, 0.44, 0.52])
FROM_BELOW = np.array([0.60, 0.64, 0.70])
HAZE = np.array([0.74, 0.82, 0.90])
IN_CLOUD = np.array([0.78, 0.80, 0.82])
CLOUD_LIGHT = 0.96, 0.84
"""Light from above and from below in cloud, of ``IN_CLOUD``."""

WAVELENGTHS_UM = np.array([0.61, 0.55, 0.465])
PRESSURE = 0.466
"""At 6000 m, of that at sea level (standard atmosphere)."""

SKY_SHARE = 0.65
DARK = 1e-3
"""Less daylight than this bears any gain."""


@dataclass(frozen=True, slots=True, eq=False)
class Illumination:
    """Light of a scenario.

    ``sun_ned`` (3,) unit vector to the sun; ``lit_by`` (4, 3) that, sunlight, light from above and from below;
    ``sun`` (3,) the sun's colour, one for the default; ``sky`` and ``below`` factors on the clear sky and on what lies
    under it; ``scale`` and ``rest`` the two parts of the gain; ``daylight`` times ``scale`` is in ``lit_by`` and
    ``air`` (3,), the radiance of the air itself; ``kept`` the share that haze leaves; ``cloud_per_m`` extinction.
    """

    sun_ned: Vec
    lit_by: Mat
    sun: Vec
    sky: float
    below: float
    scale: float
    rest: float
    surroundings: float
    air: Vec
    kept: float
    cloud_per_m: float


def illumination(c: PictureConditions) -> Illumination:
    """Return the light under which pictures of these conditions are taken."""
    sun_ned = sun_direction(c)
    default = PictureConditions()
    high = math.sin(default.sun_elevation_rad)
    up = max(0.0, math.sin(c.sun_elevation_rad)) / high
    sky, below = 1.0 - SKY_SHARE * (1.0 - min(up, 1.0)), 0.1 + 0.9 * min(up, 1.0)
    sun = sun_through_air(c.sun_elevation_rad) / sun_through_air(default.sun_elevation_rad)
    scale = min(c.gain, 1.0 / max(c.daylight, DARK))
    surroundings = c.daylight * scale
    if c.cloud_per_m > 0.0:
        light = np.stack([np.zeros(3), CLOUD_LIGHT[0] * IN_CLOUD, CLOUD_LIGHT[1] * IN_CLOUD])
    else:
        light = np.stack([sun * SUNLIGHT, sky * FROM_ABOVE, below * FROM_BELOW])
    air = IN_CLOUD if c.cloud_per_m > 0.0 else sky * HAZE
    return Illumination(sun_ned, np.vstack([sun_ned, surroundings * light]), sun, sky, below, scale, c.gain / scale,
                        surroundings, surroundings * air, 1.0 - c.haze, c.cloud_per_m)


def sun_direction(c: PictureConditions) -> Vec:
    """Return the unit vector (3,) to the sun, north-east-down."""
    level = math.cos(c.sun_elevation_rad)
    return np.array([level * math.cos(c.sun_azimuth_rad), level * math.sin(c.sun_azimuth_rad),
                     -math.sin(c.sun_elevation_rad)])


def sun_through_air(elevation_rad: float) -> Vec:
    """Return the share (3,) of the sun's red, green and blue that reaches 6000 m; nothing from below the horizon."""
    degrees = math.degrees(elevation_rad)
    if degrees < 0.0:
        return np.zeros(3)
    mass = 1.0 / (math.sin(elevation_rad) + 0.50572 * (degrees + 6.07995) ** -1.6364)
    k = WAVELENGTHS_UM**-2
    return np.exp(-PRESSURE * mass * 0.008569 * k**2 * (1.0 + 0.0113 * k + 0.00013 * k**2))
