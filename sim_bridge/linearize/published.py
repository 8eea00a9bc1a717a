"""Modes of published aircraft from their published derivatives, to put the tanker's beside.

Small disturbances of level flight in stability axes (Nelson, Flight Stability and Automatic Control, ch. 4 and 5;
equations recalled), with the rates of change of incidence and the product of inertia kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.geometry import GRAVITY_M_S2, Mat
from sim_bridge.linearize.model import Mode, lateral_modes, longitudinal_modes
from sim_bridge.plant.fdm import FT, LBF, SLUG_FT3

SLUG_FT2 = LBF * FT
LB = 0.45359237


@dataclass(frozen=True, slots=True)
class Derivatives:
    """An aircraft in level flight: SI units; derivatives per rad in stability axes, ``u`` per V, rates over 2V."""

    name: str
    source: str
    area_m2: float
    span_m: float
    chord_m: float
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float, float]
    speed_m_s: float
    density_kg_m3: float
    CL: float
    CD: float
    CLa: float
    CDa: float
    Cma: float
    CLq: float
    Cmq: float
    CYb: float
    Clb: float
    Cnb: float
    Clp: float
    Cnp: float
    Clr: float
    Cnr: float
    CLa_dot: float = 0.0
    Cma_dot: float = 0.0
    CLu: float = 0.0
    Cmu: float = 0.0

    def longitudinal(self) -> Mat:
        """Return A (4, 4) over u, w, q, theta."""
        V, S, c, Iyy = self.speed_m_s, self.area_m2, self.chord_m, self.inertia_kg_m2[1]
        force = 0.5 * self.density_kg_m3 * V * S / self.mass_kg  # of a coefficient's derivative, over the speed
        turn = 0.5 * self.density_kg_m3 * V * S * c / Iyy
        late = c / (2.0 * V)
        w_dot = np.array([-force * (self.CLu + 2.0 * self.CL), -force * (self.CLa + self.CD), 0.0, 0.0])
        w_dot[2] = V - force * V * self.CLq * late
        w_dot /= 1.0 + force * self.CLa_dot * late
        q_dot = turn * np.array([self.Cmu, self.Cma, V * self.Cmq * late, 0.0]) + turn * self.Cma_dot * late * w_dot
        u_dot = np.array([-2.0 * force * self.CD, -force * (self.CDa - self.CL), 0.0, -GRAVITY_M_S2])
        return np.array([u_dot, w_dot, q_dot, [0.0, 0.0, 1.0, 0.0]])

    def lateral(self) -> Mat:
        """Return A (4, 4) over beta, p, r, phi."""
        V, b = self.speed_m_s, self.span_m
        Ixx, _, Izz, Ixz = self.inertia_kg_m2
        pressure = 0.5 * self.density_kg_m3 * V * V * self.area_m2
        late = b / (2.0 * V)
        moments = pressure * b * np.array(
            [[self.Clb, self.Clp * late, self.Clr * late, 0.0], [self.Cnb, self.Cnp * late, self.Cnr * late, 0.0]]
        )
        p_dot, r_dot = np.linalg.solve(np.array([[Ixx, -Ixz], [-Ixz, Izz]]), moments)
        side = [pressure * self.CYb / (self.mass_kg * V), 0.0, -1.0, GRAVITY_M_S2 / V]
        return np.array([side, p_dot, r_dot, [0.0, 1.0, 0.0, 0.0]])

    def modes(self) -> tuple[Mode, ...]:
        """Return the modes of both planes."""
        return longitudinal_modes(self.longitudinal()) + lateral_modes(self.lateral())


CONVAIR_880 = Derivatives(
    name="Convair 880, Mach 0.8, 35,000 ft",
    source="NASA CR-2144, also Nelson's appendix, by public transcriptions; Ixx printed as 0.115e6, taken as 1.15e6 "
    "slug ft2; its weight and its CL do not belong together: 0.347 would carry 155,000 lb",
    area_m2=2000.0 * FT**2, span_m=120.0 * FT, chord_m=18.94 * FT, mass_kg=126000.0 * LB,
    inertia_kg_m2=(1.15e6 * SLUG_FT2, 2.45e6 * SLUG_FT2, 4.07e6 * SLUG_FT2, 0.0),
    speed_m_s=0.8 * 973.14 * FT, density_kg_m3=7.382e-4 * SLUG_FT3,
    CL=0.347, CD=0.024, CLa=4.8, CDa=0.15, Cma=-0.65, CLq=7.5, Cmq=-4.5, CLa_dot=2.7, Cma_dot=-4.5,
    CYb=-0.812, Clb=-0.177, Cnb=0.129, Clp=-0.312, Cnp=-0.011, Clr=0.153, Cnr=-0.165,
)  # fmt: skip
BOEING_747 = Derivatives(
    name="Boeing 747-200, Mach 0.65, 20,000 ft",
    source="Roskam, Airplane Flight Dynamics and Automatic Flight Controls I (2001), by a public transcription; "
    "CL from its weight, CD and CDa from its drag polar",
    area_m2=5500.0 * FT**2, span_m=196.0 * FT, chord_m=27.3 * FT, mass_kg=636636.0 * LB,
    inertia_kg_m2=(18.2e6 * SLUG_FT2, 33.1e6 * SLUG_FT2, 49.7e6 * SLUG_FT2, 0.97e6 * SLUG_FT2),
    speed_m_s=399.0 * 1852.0 / 3600.0, density_kg_m3=0.6527,
    CL=0.403, CD=0.0252, CLa=4.4, CDa=0.20, Cma=-1.00, CLq=6.6, Cmq=-20.5, CLa_dot=7.0, Cma_dot=-4.0, CLu=0.13,
    Cmu=0.013, CYb=-0.90, Clb=-0.160, Cnb=0.160, Clp=-0.340, Cnp=-0.026, Clr=0.130, Cnr=-0.280,
)  # fmt: skip
PUBLISHED = (CONVAIR_880, BOEING_747)
