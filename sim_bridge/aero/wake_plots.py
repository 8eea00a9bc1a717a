"""Picture of the wake's increments: ``python -m sim_bridge.aero.wake_plots --out docs`` writes ``wake.png``."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from companion.geometry import Mat, Vec
from sim_bridge.aero.planforms import KC135R
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.wake import WEIGHT_OVER_RHO_V2_M2, Wake

NAMES = ("ΔCD", "ΔCL", "ΔCm", "ΔCl", "ΔCn", "ΔCY")
AT_BOX_M = (-29.0, 0.0, 9.0)
"""The receiver's centre of mass with its receptacle in the box."""
START_M = (-50.0, -20.0, 30.0)
SCALE = 1e3


def draw_wake(png: Path) -> None:
    """Draw the six increments across the flight path at the box and along it; raises PlantError without a table."""
    wake = Wake(WEIGHT_OVER_RHO_V2_M2, 1.0, 1.0)
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(3, 3, figsize=(12.0, 7.6), height_ratios=[1.0, 1.0, 0.9], constrained_layout=True)
    y, z = np.linspace(-40.0, 40.0, 161), np.linspace(-10.0, 35.0, 91)
    across = np.array([[wake.increments(AT_BOX_M[0], a, b) for a in y] for b in z])
    for k, ax in enumerate(axes[:2].ravel()):
        _contours(ax, y, z, SCALE * across[..., k], NAMES[k])
    for ax in axes[:2, 0]:
        ax.set_ylabel("down of the tanker, m")
    for ax in axes[1]:
        ax.set_xlabel("right of the tanker, m")
    figure.suptitle(f"Increments of the receiver's coefficients, thousandths, {-AT_BOX_M[0]:.0f} m behind the tanker "
                    "(cross: receptacle in the box; bar: the tanker's wing)")
    _along(axes[2], wake)
    figure.savefig(png, dpi=110)
    plt.close(figure)


def _contours(ax: Axes, y: Vec, z: Vec, values: Mat, name: str) -> None:
    span = float(np.abs(values).max())
    step = next(s for s in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0) if span / s <= 6.0)
    count = math.ceil(span / step)
    levels = step * (np.arange(-count, count + 2) - 0.5)  # the middle one, about nought, is white
    filled = ax.contourf(y, z, values, levels, cmap="RdBu_r", vmin=levels[0], vmax=levels[-1])
    ax.contour(y, z, values, levels, colors="#444444", linewidths=0.4, linestyles="solid")
    ax.plot(AT_BOX_M[1], AT_BOX_M[2], "k+", ms=8)
    half = 0.5 * KC135R.span_m
    ax.plot([-half, 0.0, half], [-1.6, 0.6, -1.6], color="#222222", lw=2)
    ax.set_title(name)
    ax.set_aspect("equal")
    ax.set_ylim(z[-1], z[0])
    every = 2 if count > 3 else 1
    ticks = step * np.arange(-(count // every) * every, count + 1, every)
    ax.figure.colorbar(filled, ax=ax, shrink=0.75, ticks=ticks)


def _along(axes: Sequence[Axes], wake: Wake) -> None:
    x = np.linspace(-120.0, -12.0, 217)
    on_axis = SCALE * np.array([wake.increments(a, AT_BOX_M[1], AT_BOX_M[2]) for a in x])
    share = np.linspace(0.0, 1.0, 201)[:, None]
    way = np.array(START_M) + share * (np.array(AT_BOX_M) - START_M)
    met = SCALE * np.array([wake.increments(*p) for p in way.tolist()])
    for ax, chosen in zip(axes, ((1,), (0, 2), (3, 4, 5)), strict=True):
        for k in chosen:
            if k < 3:
                ax.plot(x, on_axis[:, k], label=NAMES[k])
            else:
                ax.plot(100.0 * share[:, 0], met[:, k], label=NAMES[k])
        ax.legend(frameon=False)
    for ax in axes[:2]:
        ax.axvline(AT_BOX_M[0], color="#2e9e5b", lw=0.8, ls="--")
        ax.set_xlabel("forward of the tanker, m (dashed: the box)")
        ax.set_title(f"in the middle, {AT_BOX_M[2]:.0f} m down")
    axes[0].set_ylim(-60.0, 0.0)
    axes[0].set_ylabel("thousandths")
    axes[2].set_title("straight from [" + ", ".join(f"{v:.0f}" for v in START_M) + "] m to the box")
    axes[2].set_xlabel("share of the way, %")


def main(argv: Sequence[str] | None = None) -> int:
    """Draw and say where."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--out", default="docs", help="folder for the picture")
    out = Path(p.parse_args(argv).out)
    out.mkdir(parents=True, exist_ok=True)
    try:
        draw_wake(out / "wake.png")
    except PlantError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"written: {out / 'wake.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
