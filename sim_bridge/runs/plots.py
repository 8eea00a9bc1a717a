"""Pictures of many flights: consistency of the estimate, and Stanford plots of its integrity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from sim_bridge.runs.consistency import QUANTITIES, Curve, nees_curve, nis_curve, sources
from sim_bridge.runs.record import Record
from sim_bridge.runs.stanford import EDGES, Judged

STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 9,
              "legend.frameon": False, "legend.fontsize": 8}
DPI = 110
BLUE, RED, GREEN, GREY = "#3d7ebf", "#d1495b", "#2e9e5b", "#888888"
AXES = ("x (forward)", "y (right)", "z (down)")
NEES_SPAN, NIS_SPAN = 10.0, 3.0
"""Means are drawn within this factor of what is right; what lies beyond is at the edge."""


def draw_consistency(groups: Mapping[str, Sequence[Record]], png: Path) -> None:
    """Draw mean NEES of each quantity and mean NIS of each source over time with the band, a colour for each group."""
    everything = [r for records in groups.values() for r in records]
    names = sources(everything)
    rows = -(-(len(QUANTITIES) + len(names)) // 2)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 2.1 * rows + 0.4), layout="constrained")
        panels = figure.subplots(rows, 2, squeeze=False).ravel()
        for ax, (quantity, (name, *_)) in zip(panels, QUANTITIES.items(), strict=False):
            curves = {label: nees_curve(records, quantity) for label, records in groups.items()}
            _curves(ax, curves, 3.0, NEES_SPAN, f"NEES of {name}")
        for ax, source in zip(panels[len(QUANTITIES):], names, strict=False):
            curves = {label: nis_curve(records, source) for label, records in groups.items()}
            _curves(ax, curves, 1.0, NIS_SPAN, f"NIS of {source} / degrees of freedom")
        for ax in panels[len(QUANTITIES) + len(names):]:
            ax.set_visible(False)
        for ax in panels[max(0, len(QUANTITIES) + len(names) - 2):]:
            ax.set_xlabel("time since the start, s")
        _legend(figure, groups)
        figure.savefig(png, dpi=DPI)


def _curves(ax: Axes, curves: dict[str, Curve], right: float, span: float, title: str) -> None:
    ax.axhline(right, color=GREY, lw=0.6)
    for curve, colour in zip(curves.values(), (BLUE, RED), strict=False):
        shown = np.clip(curve.mean, right / span, right * span)
        ax.fill_between(curve.t_s, curve.low, curve.high, color=colour, alpha=0.18, lw=0)
        ax.plot(curve.t_s, shown, color=colour, lw=0.9)
    ax.set_yscale("log")
    ax.set_ylim(right / span, right * span)
    ticks = [right * span**power for power in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    ax.set_yticks(ticks, [f"{t:.2g}" for t in ticks])
    ax.minorticks_off()
    shares = ", ".join(f"{label} {100 * c.share_inside():.0f} %" for label, c in curves.items())
    ax.set_title(f"{title}; in the band {shares}", loc="left")


def _legend(figure: Figure, groups: Mapping[str, Sequence[Record]]) -> None:
    handles: list[Any] = []
    for (label, records), colour in zip(groups.items(), (BLUE, RED), strict=False):
        handles.append(Line2D([], [], color=colour, lw=1.5, label=f"mean of {len(records)} flights {label}"))
        handles.append(Patch(color=colour, alpha=0.18, label="95 % of consistent estimates"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)


def draw_stanford(judged: Sequence[Judged], alert_m: Sequence[float], png: Path) -> None:
    """Draw protection against error of each axis, both in alert limits, with the regions named and counted.

    ``alert_m`` (3,) is the alert limit at the box, for the labels.
    """
    allowed, refused = (np.sum([getattr(j, name) for j in judged], axis=0) for name in ("allowed", "refused"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.6, 4.9), layout="constrained")
        for k, ax in enumerate(figure.subplots(1, 3, sharey=True)):
            _stanford(ax, allowed[k], refused[k])
            _regions(ax, judged, k)
            ax.set_title(f"BR {AXES[k]}: alert limit {alert_m[k]:.2f} m at the box")
            ax.set_xlabel("error / alert limit")
            if k == 0:
                ax.set_ylabel("protection level / alert limit")
        shades = [Patch(color=c, label=text) for c, text in ((BLUE, "docking allowed"), (GREY, "held back"))]
        figure.legend(handles=shades, loc="outside upper center", ncols=2)
        figure.savefig(png, dpi=DPI)


def _stanford(ax: Axes, allowed: Any, refused: Any) -> None:
    ax.fill_between([EDGES[0], 1.0], [EDGES[0], 1.0], EDGES[0], color="#f4c95d", alpha=0.35, lw=0)
    ax.fill_between([1.0, EDGES[-1]], 1.0, EDGES[0], color=RED, alpha=0.25, lw=0)
    for counts, dark in ((refused, "#333333"), (allowed, "#0b3c6f")):
        light = "#dddddd" if counts is refused else "#bcd7f0"
        shades = LinearSegmentedColormap.from_list("shades", [light, dark])
        shown = np.ma.masked_equal(counts.T, 0)
        if shown.count():
            ax.pcolormesh(EDGES, EDGES, shown, cmap=shades, norm=LogNorm(1, max(10, counts.max())), rasterized=True)
    ax.plot(EDGES[[0, -1]], EDGES[[0, -1]], color="#222222", lw=0.8)
    ax.axhline(1.0, color=RED, lw=0.8, ls="--")
    ax.axvline(1.0, color=RED, lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlim=EDGES[[0, -1]], ylim=(1e-2, EDGES[-1]))
    ax.set_aspect("auto")


def _regions(ax: Axes, judged: Sequence[Judged], axis: int) -> None:
    count = {name: int(sum(getattr(j, name)[axis] for j in judged)) for name in ("nominal", "misleading", "hazardous")}
    back = sum(j.held_back for j in judged)
    behind = {"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 2.0}
    places = ((0.14, 0.04), (0.52, 0.04), (0.84, 0.04), (0.14, 0.84))
    told = (*count.items(), ("held back", back))
    for (x, y), (name, number) in zip(places, told, strict=True):
        ax.text(x, y, f"{name}\n{number}", transform=ax.transAxes, ha="center", va="bottom", fontsize=9, bbox=behind)
