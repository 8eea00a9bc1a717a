"""The boom in figures: speed of a step, and what nozzle and loops do over gusts; `make bench` prints them."""

from __future__ import annotations

import math
import time

import boom_bench as bench
import numpy as np
import pytest

from sim_bridge.plant.boom import AirAtBoom, Receptacle
from sim_bridge.plant.bow_wave import bow_wave_m_s
from sim_bridge.plant.conditions import BoomConditions

pytestmark = pytest.mark.bench

STEPS = 20_000


@pytest.mark.parametrize("bow", [False, True])
def test_speed_of_a_step(bow: bool) -> None:
    b = bench.Bench(BoomConditions(contact_after_s=1.0, fuel_kg=4000.0), bench.still)
    b.run(5.0)
    assert b.boom.contact
    n, e, d = b.rest_ned.tolist()
    receiver = Receptacle((n, e, d), (b.speed_m_s, 0.0, 0.0), *((0.0, 0.0, 0.0),) * 2, bench.RECEPTACLE_M)
    air = AirAtBoom(bench.DENSITY, (1.0, 0.5, 0.2), bow_wave_m_s if bow else None)
    start = time.process_time()
    for _ in range(STEPS):
        b.boom.step(b.tanker, receiver, air)
    each_s = (time.process_time() - start) / STEPS
    what = "with" if bow else "without"
    print(f"\nboom step with its operator, in contact, {what} bow wave: {1e6 * each_s:.1f} us, "
          f"{bench.DT_S / each_s:.0f} times real time")


@pytest.mark.parametrize("turbulence", ["none", "light", "moderate"])
@pytest.mark.parametrize("speed_m_s", [190.0, 205.7, 220.0])
def test_refuelling_over_seeds(turbulence: str, speed_m_s: float) -> None:
    """Ten seeds of gusts on the boom, the receptacle swaying by 0.1 m."""
    rows, held, done = [], [], 0
    for seed in range(1, 11):
        b = bench.Bench(BoomConditions(contact_after_s=5.0, fuel_kg=200.0), turbulence=turbulence, seed=seed,
                        speed_m_s=speed_m_s)
        while not b.boom.contact and b.t_s < 40.0:
            b.step()
            if b.t_s < 5.0:
                held.append((b.boom.seen.elevation - math.radians(30.0), b.boom.seen.azimuth))
        contact_s = b.t_s
        loads = []
        while b.boom.contact:
            b.step()
            loads.append(np.linalg.norm(b.boom.force_on_receptacle_ned_n))
        done += b.boom.disconnects == {"fuel given": 1}
        rows.append((contact_s - 5.0, np.mean(loads), b.boom.peak_load_n))
    reach, mean, peak = np.array(rows).T
    sway = np.degrees(np.std(held, axis=0))
    print(f"\n{turbulence}, {speed_m_s} m/s: {done} of 10 refuelled; contact {reach.mean():.1f} s after reaching out"
          f" (at most {reach.max():.1f}); load mean {mean.mean():.0f} N, peak {peak.max():.0f} N;"
          f" nominal held to {sway[0]:.2f}, {sway[1]:.2f} degrees (elevation, azimuth, 1 sigma)")
