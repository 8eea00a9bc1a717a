"""The pictures of the README, from one flight: ``make figures``. The viewer needs a Vulkan driver."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.config import ConfigError, Setup, Vec3
from companion.geometry import SE3
from companion.io.recorder import read_records
from companion.io.rerun_view import screenshot
from sim_bridge.aero.wake_plots import draw_wake
from sim_bridge.flight import fly
from sim_bridge.plant.gust_spectra import draw_spectra
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.scene.conditions import PictureConditions
from sim_bridge.scene.operator_view import OperatorView
from sim_bridge.simulation import Simulation
from sim_bridge.truth import BoomState

AXES = ("x (forward)", "y (right)", "z (down)")
CONTACT_TANKER_M = (-29.0, 0.0, 9.0)
COMING_NEAR_M = 7.0
GAP_PX = 8


def main(argv: Sequence[str] | None = None) -> int:
    """Fly, draw, and say what was written."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--out", default="docs", help="folder for the pictures")
    p.add_argument("--seed", type=int, default=1)
    a = p.parse_args(argv)
    out = Path(a.out)
    out.mkdir(parents=True, exist_ok=True)
    scenario = msgspec.structs.replace(load_scenario("docking"), seed=a.seed)
    setup = scenario.setup()
    flown = fly(scenario, setup)
    draw_br(flown.folder, setup, out / "br.png")
    draw_cameras(scenario, out / "cameras.jpg")
    draw_conditions(scenario, out / "conditions.jpg")
    draw_operator(flown.folder, setup, out / "operator.jpg")
    draw_wake(out / "wake.png")
    draw_spectra().savefig(out / "gusts.png", dpi=100)
    try:
        screenshot(flown.folder, out / "viewer.png")
    except ConfigError as error:
        print(f"viewer.png left as it was: {error}", file=sys.stderr)
    print(f"pictures of {flown.folder} are in {out}")
    return 0


def draw_br(folder: Path, setup: Setup, png: Path) -> None:
    """Draw BR over time, truth and estimate, against the window (thesis Fig. 1.6 to 1.8)."""
    truth = np.load(folder / "truth.npz")
    records = [r for r in read_records(folder / "events.jsonl") if r["kind"] in ("RelativeState", "PhaseChange")]
    states = [r for r in records if r["kind"] == "RelativeState"]
    t_est = np.array([r["t_ns"] for r in states]) * 1e-9
    br_est = np.array([r["p_mrf_br_m"] for r in states])
    window = setup.tanker.window
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(3, 2, figsize=(10, 6), sharex="col", width_ratios=[1, 1], constrained_layout=True)
    hold_s = next(r["t_ns"] * 1e-9 for r in records if r["kind"] == "PhaseChange" and r["new"] == "hold")
    for k in range(3):
        for column, ax in enumerate(axes[k]):
            ax.axhspan(-window.desired_m[k], window.desired_m[k], color="#2e9e5b", alpha=0.15, lw=0)
            for side in (-1, 1):
                ax.axhline(side * window.limit_m[k], color="#d1495b", lw=0.8, ls="--")
            ax.plot(t_est, br_est[:, k], color="#3d7ebf", lw=0.8, label="estimate")
            ax.plot(truth["t_ns"] * 1e-9, truth["p_mrf_br_m"][:, k], color="#222222", lw=0.9, label="truth")
            ax.set_xlim((0, hold_s) if column == 0 else (hold_s, truth["t_ns"][-1] * 1e-9))
            if column == 1:
                ax.set_ylim(-1.25 * window.limit_m[k], 1.25 * window.limit_m[k])
        axes[k][0].set_ylabel(f"BR {AXES[k]}, m")
    axes[0][0].set_title("join and approach")
    axes[0][1].set_title("hold: desired window green, limit dashed")
    axes[0][0].legend(frameon=False, loc="lower right")
    for ax in axes[2]:
        ax.set_xlabel("time, s")
    figure.savefig(png, dpi=110)
    plt.close(figure)


def draw_cameras(scenario: Scenario, jpg: Path) -> None:
    """Draw what both cameras see at the start and at contact, side by side."""
    rows = []
    for start_m in (scenario.start_tanker_m, CONTACT_TANKER_M):
        images = [taken(scenario, start_m, name) for name in ("docking", "thesis")]
        scales = [480 / image.shape[0] for image in images]
        rows.append([cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
                     for image, scale in zip(images, scales, strict=True)])
    write_sheet(rows, jpg)


def draw_conditions(scenario: Scenario, jpg: Path) -> None:
    """Draw what the default camera sees half way and at contact by day, by night, into a low sun and in cloud."""
    x, y, z = (0.5 * (a + b) for a, b in zip(scenario.start_tanker_m, CONTACT_TANKER_M, strict=True))
    rows = []
    for start_m in ((x, y, z), CONTACT_TANKER_M):
        images = [taken(scenario, start_m, name) for name in ("docking", "night", "low_sun", "cloud")]
        rows.append([cv2.resize(image, (480, 360), interpolation=cv2.INTER_AREA) for image in images])
    for image, name in zip(rows[0], ("day", "night", "low sun", "cloud"), strict=True):
        cv2.putText(image, name, (10, 345), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 1, cv2.LINE_AA)
    write_sheet(rows, jpg)


def taken(scenario: Scenario, start_m: Vec3, name: str) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) that the camera of the shipped scenario ``name``, in its light, takes at a place."""
    shown = load_scenario(name)
    setup = shown.setup()
    # The start of the flight is checked against the tanker's extent; a picture may be taken anywhere.
    truth = Simulation(msgspec.structs.replace(scenario, start_tanker_m=start_m, turbulence="none"), setup).truth
    chance = np.random.default_rng(scenario.seed)
    camera = CameraPicture(setup.camera, setup.tanker, chance, conditions=shown.picture)
    return camera.expose(truth.tanker, truth.uav, truth.boom)


def draw_operator(folder: Path, setup: Setup, jpg: Path) -> None:
    """Draw what the boom operator sees of a flight: the receiver coming near, in contact, at the end (thesis Fig. 2.6).

    A flight without contact shows the middle of its hold in its place.
    """
    truth = np.load(folder / "truth.npz")
    near = np.sqrt(np.sum(truth["p_mrf_br_m"] ** 2, axis=1)) < COMING_NEAR_M
    coming = int(np.argmax(near))
    touching = np.flatnonzero(truth["boom"][:, 3] > 0)
    middle = int(touching[len(touching) // 2]) if len(touching) else (coming + len(near)) // 2
    view = OperatorView(PictureConditions(), np.random.default_rng(1))
    images = []
    for k in (coming, middle):
        elevation, azimuth, length, contact, right, left = (float(v) for v in truth["boom"][k])
        boom = BoomState(np.array(setup.tanker.boom.pivot_tanker_m), elevation, azimuth, length, contact > 0,
                         ruddevators_rad=(right, left))
        images.append(view.render(SE3(truth["R_ned_tanker"][k], truth["p_ned_tanker_m"][k]),
                                  SE3(truth["R_ned_frd"][k], truth["p_ned_uav_m"][k]), boom))
    write_sheet([images], jpg)


def write_sheet(rows: list[list[NDArray[np.uint8]]], jpg: Path) -> None:
    """Write rows of pictures of one height to a file, with white lines between."""
    sheets = []
    for row in rows:
        line = np.full((row[0].shape[0], GAP_PX, 3), 255, np.uint8)
        sheets.append(np.hstack([part for image in row for part in (image, line)][:-1]))
    line = np.full((GAP_PX, sheets[0].shape[1], 3), 255, np.uint8)
    picture = np.vstack([part for sheet in sheets for part in (sheet, line)][:-1])
    cv2.imwrite(str(jpg), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    sys.exit(main())
