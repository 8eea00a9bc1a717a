"""Increments of the receiver's coefficients in the tanker's wake (thesis 3.4), and the table that the plant flies with.

The receiver's lattice, level behind the tanker, is put into the air of ``tanker_wake``: every panel meets the wake's
velocity where it is, so the mean over the planform is the flow's own. Forces are those of the body, resolved along and
across the undisturbed stream as JSBSim does with CD and CL; lift that downwash tilts back is drag, once.

At each place the receiver has the incidence that carries its weight there. dCL, dCm, dCl, dCn and dCY are differences
to clean air at that incidence. dCD is the difference to clean air at that lift, because the plant's drag polar takes
the lift with the wake's part in it: polar(CL + dCL) + dCD is then the drag in the wake.

The wind-tunnel increments that the thesis interpolates are not public, and no other numbers for a KC-135 were at hand.
In kind it is what Landry (University of British Columbia, 1997, abstract) found for a CF-18 in a wing-tip vortex: calm
far inboard of the tip and below it, worst about level with it, there just outboard of the tip, here a metre inboard.

``python -m sim_bridge.aero.wake_table --write`` computes the table again.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from companion.geometry import GRAVITY_M_S2, Mat, Vec
from sim_bridge.aero.planforms import ICE, ice101
from sim_bridge.aero.tanker_wake import MACH, TankerWake, trimmed_wake
from sim_bridge.aero.vortex_lattice import Lattice, coefficients, derivatives
from sim_bridge.plant.wake import RHO_V2_PA, TABLE, WEIGHT_OVER_RHO_V2_M2

TRIM_CL = 14855.15 * GRAVITY_M_S2 / (0.5 * RHO_V2_PA * ICE.area_m2)
"""Of the receiver in trim: 0.139."""
X_M = (-120.0, -100.0, -85.0, -70.0, -60.0, -52.0, -46.0, -41.0, -37.0, -34.0, -31.0, -28.0, -25.0, -22.0, -18.0, -14.0,
       -10.0)
Y_M = (0.0, 1.5, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0, 17.0, 19.0, 21.0, 23.0, 25.0, 27.5, 31.0, 35.0, 40.0)
Z_M = (-10.0, -8.0, -6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 17.0, 20.0, 25.0, 30.0, 40.0, 50.0)
HEADER = """\
# Increments of the receiver's coefficients in the tanker's wake over position (forward, right, down of the tanker, m).
# Computed by: python -m sim_bridge.aero.wake_table --write
x_m,y_m,z_m,dCD,dCL,dCm,dCl,dCn,dCY
"""
AT_ONCE = 40
CHORDWISE = 6
"""Panels along a chord; ten change no increment near the box by more than 1 %."""


def receiver_lattice() -> Lattice:
    """Return the receiver as it is put into the wake."""
    return Lattice([replace(s, n_chord=CHORDWISE) for s in ice101()], MACH)


class ReceiverInWake:
    """The receiver's lattice behind one tanker."""

    def __init__(self, wake: TankerWake | None = None) -> None:
        """Make lattice and wake."""
        self.wake = wake or trimmed_wake()
        self._lattice = receiver_lattice()
        self._points = np.concatenate((self._lattice.collocation, self._lattice.force_points))
        self._slope = derivatives(self._lattice, ICE, 0.0)["alpha"].CL
        self.alpha_rad = TRIM_CL / self._slope
        c, s = math.cos(self.alpha_rad), math.sin(self.alpha_rad)
        self._R_level_frd = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def increments(self, positions_m: Mat) -> Mat:
        """Return (k, 6), ordered as ``Coefficients``, for receivers with their centres of mass at ``positions_m``."""
        parts = np.array_split(positions_m, math.ceil(len(positions_m) / AT_ONCE))
        return np.concatenate([self._few(p) for p in parts])

    def _few(self, positions_m: Mat) -> Mat:
        points = positions_m[:, None] + self._points @ self._R_level_frd.T
        wake = self.wake.velocity(points) @ self._R_level_frd
        clean = self._coefficients(np.zeros_like(wake[:1]), np.array([self.alpha_rad]))
        short = clean[:, 1] - self._coefficients(wake, np.full(len(wake), self.alpha_rad))[:, 1]
        alpha = self.alpha_rad + short / self._slope
        there = self._coefficients(wake, alpha)
        increments = there - self._coefficients(np.zeros_like(wake), alpha)
        increments[:, 0] = there[:, 0] - clean[:, 0]
        return increments

    def _coefficients(self, wake: Mat, alpha: Vec) -> Mat:
        onset = wake - np.column_stack((np.cos(alpha), np.zeros_like(alpha), np.sin(alpha)))[:, None]
        n = self._lattice.n
        return coefficients(self._lattice.solve(onset[:, :n], onset[:, n:]), ICE, 1.0, alpha)


def grid() -> Mat:
    """Return the positions (k, 3) of the table, z the fastest; the left side is the right's mirror image."""
    return np.stack(np.meshgrid(X_M, Y_M, Z_M, indexing="ij"), axis=-1).reshape(-1, 3)


def write(path: Path) -> None:
    """Compute the table and write it."""
    positions = grid()
    rows = np.column_stack((positions, ReceiverInWake().increments(positions)))
    lines = (f"{x:g},{y:g},{z:g}," + ",".join(f"{v:.6f}" for v in c) for x, y, z, *c in rows.tolist())
    path.write_text(HEADER + "\n".join(lines).replace("-0.000000", "0.000000") + "\n", encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Write the table, or say what the increments are at the box."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--write", action="store_true", help=f"write {TABLE.name}")
    if p.parse_args(argv).write:
        write(TABLE)
        print(f"written: {TABLE} (weight / (rho V^2) = {WEIGHT_OVER_RHO_V2_M2:.2f} m2)")
    else:
        names = HEADER.splitlines()[-1].split(",")[3:]
        at_box = ReceiverInWake().increments(np.array([[-29.0, 0.0, 9.0]]))[0]
        print("with the receptacle in the box:", ", ".join(f"{n} {v:+.5f}" for n, v in zip(names, at_box, strict=True)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
