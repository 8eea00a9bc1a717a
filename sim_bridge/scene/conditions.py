"""Under what light and with how much clutter a picture is taken; all of it is off unless a scenario asks.

Rules
-----
* ``gain`` multiplies everything, as a longer exposure does, before the sensor clips; its noise stays as it is.
* ``daylight`` multiplies sun and sky and leaves the lights as they are: 0.05 is dusk, 0.01 with some gain a night of
  moon and floodlights. Stars would have to be 1e5 times brighter to show beside lights that are exposed for.
* ``haze`` is the share of everything's radiance, the lights' too, that the air takes on the way and replaces with its
  own grey; nothing is nearer in it, which is right for a tanker that fills the picture and hard for its distance.
* ``cloud_per_m`` is the extinction of the cloud that both aircraft are in (0.01 is a visual range of 390 m): what is
  farther away is paler, denser and thinner wisps pass by, and light comes from all sides.
* What a low sun does to sun and sky is in ``light``, what it does in the lens (``glare``) in ``glare``.
"""

from __future__ import annotations

import math
from typing import Literal

from companion.config import Struct

Clutter = Literal["navigation", "glint", "stripe"]


class PictureConditions(Struct, frozen=True, kw_only=True):
    """Light, clutter and the camera's mount of a scenario's pictures.

    ``clutter``: ``navigation`` red, green and white lights of the tanker; ``glint`` of the sun on its skin, orange and
    white; ``stripe`` red paint on its belly, a line and letters. ``hot_pixels``: how many of the sensor's pixels always
    are at the end of their red scale. ``noise``: the sensor's, standard deviation in steps of 1/255.

    ``sun_azimuth_rad`` from north to the east, ``sun_elevation_rad`` above the horizontal; ``glare``: what the lens
    scatters of the sun over a place 10 degrees from it, in full scales. ``vibration_rad``: RMS angle per axis by which
    the camera shakes on its mount, about ``vibration_hz``. ``operator_view``: record what the boom operator sees.
    """

    gain: float = 1.0
    daylight: float = 1.0
    haze: float = 0.0
    clutter: tuple[Clutter, ...] = ()
    hot_pixels: int = 0
    noise: float = 1.2
    sun_azimuth_rad: float = 2.3036
    sun_elevation_rad: float = 0.8332
    glare: float = 0.0
    cloud_per_m: float = 0.0
    vibration_rad: float = 0.0
    vibration_hz: float = 30.0
    operator_view: bool = False


def condition_rules(c: PictureConditions) -> list[tuple[bool, str]]:
    """Return what has to hold of conditions whose types are right, and what to say when it does not."""
    return [
        (0.01 <= c.gain <= 100, "picture.gain: must be in 0.01..100"),
        (0 <= c.daylight <= 1, "picture.daylight: must be in 0..1"),
        (0 <= c.haze < 1, "picture.haze: must be in 0..1, and less than 1"),
        (len(set(c.clutter)) == len(c.clutter), "picture.clutter: names something twice"),
        (0 <= c.hot_pixels <= 10000, "picture.hot_pixels: must be in 0..10000"),
        (0 <= c.noise <= 20, "picture.noise: must be in 0..20 steps of 1/255"),
        (abs(c.sun_azimuth_rad) <= 2 * math.pi,
         "picture.sun_azimuth_rad: not within one turn (radians, not degrees)"),
        (abs(c.sun_elevation_rad) <= 0.5 * math.pi,
         "picture.sun_elevation_rad: not within a quarter turn (radians, not degrees)"),
        (0 <= c.glare <= 1, "picture.glare: must be in 0..1"),
        (0 <= c.cloud_per_m <= 0.1, "picture.cloud_per_m: must be in 0..0.1 per metre"),
        (0 <= c.vibration_rad <= 0.05, "picture.vibration_rad: must be in 0..0.05 (radians, not degrees)"),
        (0.1 <= c.vibration_hz <= 500, "picture.vibration_hz: must be in 0.1..500 hertz"),
    ]
