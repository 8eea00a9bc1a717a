"""What an airframe near trim gives for incidence and thrust, read from its linear model."""

from __future__ import annotations

from dataclasses import dataclass

from companion.config import AirframeConfig


@dataclass(frozen=True, slots=True)
class Slopes:
    """Accelerations: lift and drag (forward) in m/s2 per rad of incidence, thrust in m/s2 per unit of throttle."""

    lift_m_s2_rad: float
    drag_m_s2_rad: float
    thrust_m_s2: float


def slopes_of(airframe: AirframeConfig) -> Slopes:
    """Return -V0 A[alpha, alpha], A[V, alpha] + A[V, theta] and B[V, throttle] of ``sim-bridge linearize``.

    theta is in the drag's because pitch turns gravity too: what is left at a fixed path is the incidence's part.
    """
    A, B = airframe.A, airframe.B
    return Slopes(-A[1][1] * airframe.trim.airspeed_m_s, A[0][1] + A[0][7], B[0][0])
