"""The three laws on the reported seeds, light and moderate turbulence, real pictures: the README's table of laws."""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytestmark = pytest.mark.bench

SEEDS = range(1, 11)


def fly(out, scenario, law, seed):
    """Fly in a process of its own; return its summary."""
    folder = out / f"{law}{seed}"
    command = [sys.executable, "-m", "sim_bridge", "fly", scenario, "--law", law, "--seed", str(seed)]
    done = subprocess.run([*command, "--out", str(folder)], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 3), done.stderr
    (summary,) = folder.glob("*/summary.json")
    return json.loads(summary.read_text())


def table_row(scenario, law, flights):
    held = [f for f in flights if f["br_sigma_m"] is not None]
    worst_max = np.max([f["br_max_m"] for f in held], axis=0)
    return (
        f"| {scenario}, `{law}` | {sum(f['docked'] for f in flights)} of {len(flights)}"
        f" | {100 * np.mean([f['in_window_fraction'] for f in flights]):.1f} %,"
        f" {100 * min(f['in_window_fraction'] for f in flights):.1f} %"
        f" | {three(np.abs([f['br_mean_m'] for f in held]).max(axis=0))}"
        f" | {three(np.sqrt(np.mean(np.square([f['br_sigma_m'] for f in held]), axis=0)))}"
        f" | {three(np.max([f['br_sigma_m'] for f in held], axis=0))} | {three(worst_max)} |"
    )


def three(values):
    return ", ".join(f"{v:.3f}" for v in values)


@pytest.mark.parametrize("law", ["attitude", "velocity", "surfaces"])
@pytest.mark.parametrize("scenario", ["docking", "moderate"])
def test_laws(tmp_path, scenario, law):
    with ThreadPoolExecutor(2) as pool:
        flights = list(pool.map(lambda seed: fly(tmp_path, scenario, law, seed), SEEDS))
    print("\n| | docked | inside, mean, worst | abs mean, worst | sigma, RMS | sigma, worst | max, worst |")
    print(table_row(scenario, law, flights))
    assert all(f["plant_failure"] is None for f in flights)
