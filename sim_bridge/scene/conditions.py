"""Under what light and with how much clutter a picture is taken; all of it is off unless a scenario asks.

Rules
-----
* ``gain`` multiplies everything, as a longer exposure does, before the sensor clips; its noise stays as it is.
* ``daylight`` multiplies sun and sky and leaves the lights as they are: 0.05 is dusk.
* ``haze`` is the share of everything's radiance, the lights' too, that the air takes on the way and replaces with its
  own grey; nothing is nearer in it, which is right for a tanker that fills the picture and hard for its distance.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.config import Struct
from companion.geometry import Vec
from sim_bridge.scene.sky import HAZE

Clutter = Literal["navigation", "glint", "stripe"]


class PictureConditions(Struct, frozen=True, kw_only=True):
    """Light and clutter of a scenario's pictures.

    ``clutter``: ``navigation`` red, green and white lights of the tanker; ``glint`` of the sun on its skin, orange and
    white; ``stripe`` red paint on its belly, a line and letters. ``hot_pixels``: how many of the sensor's pixels always
    are at the end of their red scale.
    """

    gain: float = 1.0
    daylight: float = 1.0
    haze: float = 0.0
    clutter: tuple[Clutter, ...] = ()
    hot_pixels: int = 0

    def plain(self) -> bool:
        """Return whether surroundings look as they do by day in clear air at a gain of one."""
        return self.gain == 1.0 and self.daylight == 1.0 and self.haze == 0.0

    def radiance_of_light(self, light: Vec) -> Vec:
        """Return what is left of the radiance (3,) of a light, in full scales before the gain."""
        return (1.0 - self.haze) * light + self.haze * self.daylight * HAZE

    def surroundings_table(self) -> NDArray[np.uint8]:
        """Return the table (1, 256, 3) from surroundings by day in clear air to these, before the gain."""
        day = np.arange(256.0)[:, None]
        seen = self.daylight * ((1.0 - self.haze) * day + self.haze * 255.0 * HAZE)
        return to_bytes(seen)[None]

    def gain_table(self) -> NDArray[np.uint8]:
        """Return the table (1, 256) of the gain."""
        return to_bytes(self.gain * np.arange(256.0))[None]


def to_bytes(values: Vec) -> NDArray[np.uint8]:
    """Round and clip to 0..255."""
    return np.clip(values + 0.5, 0.0, 255.0).astype(np.uint8)


def condition_rules(c: PictureConditions) -> list[tuple[bool, str]]:
    """Return what has to hold of conditions whose types are right, and what to say when it does not."""
    return [
        (0.01 <= c.gain <= 100, "picture.gain: must be in 0.01..100"),
        (0 <= c.daylight <= 1, "picture.daylight: must be in 0..1"),
        (0 <= c.haze < 1, "picture.haze: must be in 0..1, and less than 1"),
        (len(set(c.clutter)) == len(c.clutter), "picture.clutter: names something twice"),
        (0 <= c.hot_pixels <= 10000, "picture.hot_pixels: must be in 0..10000"),
    ]
