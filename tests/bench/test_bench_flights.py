"""Flights on the reported seeds: accuracy, speed, memory. Prints the table of the README; asserts the outcome only."""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytestmark = pytest.mark.bench

SEEDS = (1, 2, 3, 4, 5)


def fly(out, *arguments):
    """Fly in a process of its own, so that its peak memory is its own; return its summary."""
    command = [sys.executable, "-m", "sim_bridge", *arguments, "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 3), done.stderr
    (summary,) = out.glob("*/summary.json")
    return json.loads(summary.read_text())


def fly_all(out, scenario, *options):
    """Fly all seeds, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda s: fly(out / str(s), "fly", scenario, "--seed", str(s), *options), SEEDS))


def row(name, flights):
    sigma = np.mean([f["br_sigma_m"] for f in flights], axis=0)
    mean = np.mean(np.abs([f["br_mean_m"] for f in flights]), axis=0)
    return (
        f"{name:<16} docked {sum(f['docked'] for f in flights)}/{len(flights)}"
        f"  inside, worst {100 * min(f['in_window_fraction'] for f in flights):5.1f} %"
        f"  3D RMS, worst {max(f['br_rms_3d_m'] for f in flights):.3f} m"
        f"  |mean| {mean.round(3)}  sigma {sigma.round(3)} m"
        f"  {max(f['peak_memory_mb'] for f in flights)} MB"
    )


@pytest.mark.parametrize("pose", ["lhm", "glsdc"])
@pytest.mark.parametrize("scenario", ["docking", "thesis"])
def test_flights(tmp_path, scenario, pose):
    flights = fly_all(tmp_path, scenario, "--pose", pose)
    print("\n" + row(f"{scenario}, {pose}", flights))
    assert all(f["docked"] for f in flights)
    assert all(f["br_rms_3d_m"] < 0.369 for f in flights)


@pytest.mark.parametrize("scenario", ["clutter", "corners"])
def test_flights_that_see_badly(tmp_path, scenario):
    flights = fly_all(tmp_path, scenario)
    print("\n" + row(scenario, flights))
    assert all(f["docked"] for f in flights)


@pytest.mark.parametrize("scenario", ["docking", "thesis", "clutter", "corners"])
def test_speed_of_one_flight_alone(tmp_path, scenario):
    f = fly(tmp_path, "fly", scenario, "--seed", "1")
    print(f"\n{scenario}: {f['real_time_factor']:.1f}x real time on the clock, {f['peak_memory_mb']} MB")


def test_latency_on_the_wall_clock(tmp_path):
    f = fly(tmp_path, "sitl", "docking", "--seed", "1")
    print(f"\nsitl: docked {f['docked']}, deadline slips {f['deadline_slips']}, late simulator steps {f['late_steps']}")
    for stage, q in f["latency_ms"].items():
        print(f"  {stage:<22} p50 {q['p50']:7.2f}  p99 {q['p99']:7.2f}  max {q['max']:7.2f} ms")
    assert f["docked"]
