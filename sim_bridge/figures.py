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

from companion.config import ConfigError, Setup
from companion.io.recorder import read_records
from companion.io.rerun_view import screenshot
from sim_bridge.flight import fly
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.scene.camera_picture import CameraPicture
from sim_bridge.simulation import Simulation

AXES = ("x (forward)", "y (right)", "z (down)")


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
    for start_m in (scenario.start_tanker_m, (-29.0, 0.0, 9.0)):
        row = []
        for name in ("docking", "thesis"):
            setup = load_scenario(name).setup()
            # The start of the flight is checked against the tanker's extent; a picture may be taken anywhere.
            at = msgspec.structs.replace(scenario, start_tanker_m=start_m, turbulence="none")
            truth = Simulation(at, setup).truth
            camera = CameraPicture(setup.camera, setup.tanker, np.random.default_rng(scenario.seed))
            image = camera.render(truth.tanker.T_ned_body(), truth.uav.T_ned_body(), truth.boom)
            scale = 480 / image.shape[0]
            row.append(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST))
        rows.append(np.hstack([row[0], np.full((480, 8, 3), 255, np.uint8), row[1]]))
    picture = np.vstack([rows[0], np.full((8, rows[0].shape[1], 3), 255, np.uint8), rows[1]])
    cv2.imwrite(str(jpg), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    sys.exit(main())
