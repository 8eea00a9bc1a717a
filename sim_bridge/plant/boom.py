"""The boom as a body that hangs at its nominal angles under the tanker (thesis 2.2 without its dynamics)."""

from __future__ import annotations

import numpy as np

from companion.config import BoomConfig
from sim_bridge.truth import BoomState


def nominal_boom(config: BoomConfig) -> BoomState:
    """Return the boom at the elevation, azimuth and length of its configuration."""
    return BoomState(
        pivot_tanker_m=np.array(config.pivot_tanker_m),
        elevation_rad=config.elevation_rad,
        azimuth_rad=config.azimuth_rad,
        length_m=config.length_m,
    )
