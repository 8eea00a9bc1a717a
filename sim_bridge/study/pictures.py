"""The study's pictures. Matplotlib is used here and nowhere else; one colour for each solver in all of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.special import ndtr

from companion.geometry import Mat, Vec
from sim_bridge.study import axes as thesis_axes
from sim_bridge.study import thesis_numbers
from sim_bridge.study.section import Picture
from sim_bridge.study.solvers import COLOURS, NAMES

if TYPE_CHECKING:
    from sim_bridge.study.label_swap import Swap
    from sim_bridge.study.propagation import Propagated
    from sim_bridge.study.robustness import Outcome

P = ParamSpec("P")

STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 9,
         "legend.frameon": False, "legend.fontsize": 8}
DPI = 100
THESIS: Any = {"color": "black", "ls": "--", "lw": 0.9}
POWER_SHADES = ("#1b4f72", "#2e86c1", "#aed6f1")
SHOWN = ("GLSDC", "LHM", "chain")
WIDTHS = (2.2, 1.3, 0.6)
"""What is drawn first is drawn wider, so that lines on each other can be seen."""


def styled(draw: Callable[P, Picture]) -> Callable[P, Picture]:
    """Return a function that draws in the style of all pictures."""

    @wraps(draw)
    def within(*args: P.args, **kwargs: P.kwargs) -> Picture:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return within


def power_text(power: float) -> str:
    """Return a noise power as the thesis writes it, in units of 1e-9."""
    return f"{power * 1e9:g}e-9" if power else "0"


def sheet(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, Any]:
    """Return an empty figure and its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Figure, path: Path, caption: str) -> Picture:
    """Write a figure, in few colours to keep it small, and return what it is called in the report."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=DPI)
    with Image.open(buffer) as image:
        image.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
    return Picture(path.name, caption)


@styled
def differences(path: Path, t_s: Vec, found: dict[str, Mat], mode: str) -> Picture:
    """Draw the errors of x y z, roll pitch yaw over time (Fig. 7.2 to 7.17)."""
    figure, grid = sheet(3, 2, (9.5, 6.0), sharex=True)
    for k, name in enumerate(thesis_axes.NAMES):
        ax: Axes = grid[k % 3][k // 3]
        for solver, width in zip(SHOWN, WIDTHS, strict=True):
            ax.plot(t_s, found[solver][:, k], color=COLOURS[solver], lw=width, label=solver)
        ax.axhline(0.0, color="#999999", lw=0.5)
        ax.set_ylabel(f"{name} error, {'m' if k < 3 else 'rad'}")
    for ax in grid[2]:
        ax.set_xlabel("time from the start of the approach, s")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=len(SHOWN))
    what, where = ("simulated", "7.2 to 7.9") if mode == "sv" else ("real", "7.10 to 7.17")
    return save(figure, path, f"Estimated less true values in {what} vision (thesis Fig. {where}).")


@styled
def label_swap(path: Path, swaps: dict[str, Swap]) -> Picture:
    """Draw x around the swap (Fig. 7.27 and 7.28)."""
    figure, grid = sheet(1, 1, (7.5, 3.6))
    ax: Axes = grid[0][0]
    ax.plot(swaps["LHM"].t_s, swaps["LHM"].x_clean_m, color="#999999", lw=2.5, label="without the swap")
    for name in NAMES:
        ax.plot(swaps[name].t_s, swaps[name].x_m, "o-", color=COLOURS[name], ms=3, lw=1.1, label=name)
    for name in ("GLSDC", "LHM"):
        ax.axhline(thesis_numbers.SWAP_X_M[name], **THESIS)
        ax.annotate(f"thesis, {name}", (21.98, thesis_numbers.SWAP_X_M[name]), xytext=(0, 3),
                    textcoords="offset points", fontsize=8, ha="right")
    ax.axvspan(19.97, 20.13, color="#d1495b", alpha=0.12, lw=0)
    ax.set_xlim(19.0, 22.0)
    ax.set_xlabel("time from the start of the approach, s")
    ax.set_ylabel("x of the estimate, m")
    ax.set_title("markers 1 and 2 are swapped in the two shaded frames")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return save(figure, path, "Response to swapped labels (thesis Fig. 7.27 and 7.28; dashed: the x it fell to there).")


@styled
def noise(path: Path, cases: dict[str, dict[float, dict[str, list[Outcome]]]]) -> Picture:
    """Draw RMS and the share of wrong estimates over the noise power, a row for each case."""
    figure, grid = sheet(len(cases), 4, (11.0, 2.6 * len(cases)), sharex=True)
    for row, (label, by_power) in zip(grid, cases.items(), strict=True):
        powers = sorted(by_power)
        scale = np.array(powers) * 1e9
        for name in NAMES:
            rms = np.array([np.median([o.rms_m for o in by_power[p][name]], axis=0) for p in powers])
            wrong = [100.0 * np.mean([o.wrong for o in by_power[p][name]]) for p in powers]
            for ax, values in zip(row, (*rms.T, wrong), strict=True):
                ax.plot(scale, values, "o-", color=COLOURS[name], ms=3, lw=1.1, label=name)
        for ax, what in zip(row, ("RMS of x, m", "RMS of y, m", "RMS of z, m", "off by > 5 m, %"), strict=True):
            ax.set_ylabel(what)
            ax.set_title(label)
            ax.set_ylim(bottom=0.0)
    for ax in grid[-1]:
        ax.set_xlabel("noise power, 1e-9")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=len(NAMES))
    return save(figure, path, "Noise after labeling, with the thesis' drop-outs of markers: RMS of the median run, and "
                "how many estimates are wrong (7.5.1). Where the chain refuses, GPS and INS are counted.")


@styled
def noisy_run(path: Path, t_s: Vec, errors: dict[str, Mat], seen: NDArray[np.int64]) -> Picture:
    """Draw one run at the largest noise (Fig. 7.24 and 7.25)."""
    figure, grid = sheet(3, 1, (9.5, 5.4), sharex=True, height_ratios=[2, 2, 1])
    t = t_s[: len(seen)]
    for name, width in zip(SHOWN, (1.4, 1.0, 1.0), strict=True):
        off = np.linalg.norm(errors[name], axis=1)
        grid[0][0].semilogy(t, np.clip(off, 1e-2, 1e4), color=COLOURS[name], lw=width, label=name)
        grid[1][0].plot(t, errors[name][:, 0], color=COLOURS[name], lw=width)
    limit = 1.2 * np.quantile(np.abs(errors["LHM"][:, 0]), 0.995)
    grid[1][0].set_ylim(-limit, limit)
    grid[0][0].set_ylabel("distance from the truth, m")
    grid[1][0].set_ylabel("x error, m")
    grid[2][0].step(t, seen, color="#222222", lw=0.9, where="post")
    grid[2][0].set_ylabel("markers")
    grid[2][0].set_ylim(0, 9.9)
    grid[2][0].set_xlabel("time from the start of the approach, s")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=len(SHOWN))
    return save(figure, path, "One run with noise of power 5e-9 after labeling (f = 8 mm), and the markers seen "
                "(thesis Fig. 7.19, 7.20, 7.24, 7.25).")


@styled
def regions(path: Path, offset_m: Vec, offset_rad: Vec, maps: dict[str, NDArray[np.int64]], sample_s: float) -> Picture:
    """Draw from where the pose is found, and how fast."""
    figure, grid = sheet(1, len(maps), (9.5, 4.0), sharey=True)
    extent = (offset_m[0], offset_m[-1], offset_rad[0], offset_rad[-1])
    for ax, (name, frames) in zip(grid[0], maps.items(), strict=True):
        seconds = np.ma.masked_equal(frames, 0) * sample_s
        ax.set_facecolor("#3a3a3a")
        drawn = ax.imshow(seconds, origin="lower", extent=extent, aspect="auto", cmap="YlGn_r", vmin=0.1, vmax=1.0)
        ax.set_title(f"{name}: {100.0 * np.mean(frames > 0):.0f} % of this plane")
        ax.set_xlabel("offset on x, y and z, m")
    ax = grid[0][list(maps).index("GLSDC")]
    for value in thesis_numbers.CONVERGENCE_OFFSET_M["GLSDC"]:
        ax.plot([value, value], [-0.35, 0.35], **THESIS)
    for value in thesis_numbers.CONVERGENCE_YAW_RAD["GLSDC"]:
        ax.plot([-9.0, 9.0], [value, value], **THESIS)
    grid[0][0].set_ylabel("offset on psi, rad")
    figure.colorbar(drawn, ax=grid[0].tolist(), label="time to find the pose, s", extend="max")
    return save(figure, path, "Where a start leads to the pose within 2 s; dark: it does not (thesis Fig. 7.31 to "
                "7.36; dashed: its limits of Tab. 7.6 for GLSDC).")


def frequency(count: int) -> Vec:
    """Return normalised frequencies without zero, 1 being half the sampling rate, 5 Hz."""
    return np.arange(1, count + 1) / count


@styled
def input_noise(path: Path, noise_m: Vec, psd: Callable[[Mat], Mat]) -> Picture:
    """Draw PSD and cumulative distribution of the input (Fig. 7.37 and 7.38)."""
    figure, grid = sheet(1, 2, (9.5, 3.0))
    power = psd(noise_m[:, None])[1:, 0]
    grid[0][0].plot(frequency(len(power)), 10.0 * np.log10(power), color="#222222", lw=0.7)
    grid[0][0].set_xlabel("normalised frequency (1 is 5 Hz)")
    grid[0][0].set_ylabel("PSD, dB")
    ordered = np.sort(noise_m)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    grid[0][1].plot(ordered * 1e4, share, color="#222222", lw=1.2, label="empirical")
    x = np.linspace(ordered[0], ordered[-1], 200)
    grid[0][1].plot(x * 1e4, normal_cdf(x, noise_m.mean(), noise_m.std()), color=COLOURS["chain"], lw=1.0, ls="--",
                    label="normal")
    grid[0][1].set_xlabel("noise, 1e-4 m on the sensor")
    grid[0][1].set_ylabel("cumulative share")
    grid[0][1].legend(loc="upper left")
    return save(figure, path, "Input noise of power 1e-9: spectrum and distribution (thesis Fig. 7.37 and 7.38).")


def normal_cdf(x: Vec, mean: float, deviation: float) -> Vec:
    """Return the cumulative normal distribution."""
    return np.asarray(ndtr((x - mean) / deviation))


@styled
def linearity(path: Path, propagated: Propagated) -> Picture:
    """Draw |H|^2 of the three powers over each other (Fig. 7.41 to 7.46)."""
    figure, grid = sheet(2, 3, (11.0, 5.0), sharex=True)
    powers = list(propagated.noise_m)
    for row, name in enumerate(("GLSDC", "LHM")):
        for power, shade, width in zip(powers, POWER_SHADES, (2.4, 1.4, 0.7), strict=True):
            gain = 10.0 * np.log10(propagated.gain(name, power))
            for k in range(3):
                label = f"power {power_text(power)}"
                grid[row][k].plot(frequency(len(gain)), gain[:, k], color=shade, lw=width, label=label)
        for k, axis in enumerate("xyz"):
            grid[row][k].set_title(f"{name}, {axis}")
    for ax in grid[1]:
        ax.set_xlabel("normalised frequency (1 is 5 Hz)")
    for ax in grid[:, 0]:
        ax.set_ylabel("|H|², dB")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return save(figure, path, "|H|² for three noise powers: a linear system's lines lie on each other "
                "(thesis Fig. 7.41 to 7.46).")


@styled
def compared(path: Path, propagated: Propagated, power: float, psd: Callable[[Mat], Mat]) -> Picture:
    """Draw the outputs' spectra beside each other (Fig. 7.39, 7.40, 7.47 to 7.49)."""
    figure, grid = sheet(1, 3, (11.0, 3.2), sharex=True)
    for name, width in zip(SHOWN, WIDTHS, strict=True):  # where two are alike the thinner one lies on the thicker
        spectrum = 10.0 * np.log10(smoothed(psd(propagated.out_m[name, power])[1:]))
        for k in range(3):
            grid[0][k].plot(frequency(len(spectrum)), spectrum[:, k], color=COLOURS[name], lw=width, label=name)
    for k, axis in enumerate("xyz"):
        grid[0][k].set_title(f"output noise, {axis}")
        grid[0][k].set_xlabel("normalised frequency (1 is 5 Hz)")
    grid[0][0].set_ylabel("PSD, dB")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=len(SHOWN))
    return save(figure, path, f"Spectra of the output noise for input power {power_text(power)}, each the mean over "
                "nine neighbouring frequencies (thesis Fig. 7.39, 7.40, 7.47 to 7.49).")


def smoothed(power: Mat, width: int = 9) -> Mat:
    """Return the mean over so many neighbouring frequencies: a periodogram alone scatters by itself."""
    window = np.ones(width) / width
    padded = np.pad(power, ((width // 2, width // 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(padded[:, k], window, mode="valid") for k in range(power.shape[1])], axis=1)
