"""The docking laws by name: what each is told, and what it asks of the autopilot."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from companion.config import AirframeConfig, GuidanceConfig
from companion.geometry import Vec, rotation_from_euler
from companion.guidance.feed_forward import place
from companion.guidance.law import DockingLaw
from companion.guidance.path import Reference
from companion.guidance.velocity_law import VelocityLaw
from companion.messages import OffsetSetpoint, RelativeState, Setpoint


class Law(Protocol):
    """Turns where the receiver is, against where it should be, into a setpoint, once per guidance period."""

    @property
    def integral_m_s(self) -> Vec:
        """Integral (3,) of the error in the psi frame, for the record."""

    def reset(self) -> None:
        """Forget everything: guidance starts afresh."""

    def step(self, state: RelativeState, reference: Reference) -> Setpoint:
        """Return the setpoint for a relative state and where BR should be."""


class OffsetLaw:
    """Law ``surfaces``: the regulator is in the autopilot (thesis 3.3); it is told where to be."""

    def __init__(self) -> None:
        self.integral_m_s = np.zeros(3)

    def reset(self) -> None:
        """Do nothing: there is no memory here."""

    def step(self, state: RelativeState, reference: Reference) -> OffsetSetpoint:
        """Return the way to go and the velocity of the place to be at; see ``Law.step``."""
        R_ned_mrf = rotation_from_euler(state.heading0_rad, 0.0, 0.0)
        offset = R_ned_mrf @ (reference.p_m - state.p_mrf_br_m)
        x, y, z = offset.tolist()
        v_n, v_e, v_d = place(state, reference).v_ned_m_s.tolist()
        return OffsetSetpoint(state.t_ns, (x, y, z), (v_n, v_e, v_d), state.heading0_rad)


def make_law(airframe: AirframeConfig, config: GuidanceConfig) -> Law:
    """Return the law that the configuration names."""
    if config.law == "surfaces":
        return OffsetLaw()
    if config.law == "velocity":
        return VelocityLaw(config)
    return DockingLaw(airframe, config)
