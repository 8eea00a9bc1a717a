"""Speed of the plant and of the lockstep loop: how many times real time on one core. Prints, asserts no time.

Time is that of the processor (all threads of this process), so that a busy machine says nearly the same as a quiet one.
"""

from __future__ import annotations

import time

import msgspec
import numpy as np
import pytest

from sim_bridge.autopilot.inner_loops import InnerLoops, perfect
from sim_bridge.flight import fly
from sim_bridge.plant.world import World
from sim_bridge.scenario import load_scenario
from sim_bridge.simulation import Simulation

SIMULATED_S = 30.0
STEPS = round(SIMULATED_S * 200)
SEED = 1005


@pytest.mark.bench
@pytest.mark.parametrize("turbulence", ["none", "light", "severe"])
def test_plant_with_inner_loops_at_200_hz(turbulence: str) -> None:
    scenario = msgspec.structs.replace(load_scenario("docking"), seed=SEED, turbulence=turbulence)
    setup = scenario.setup()
    trim = setup.airframe.trim
    best_s = np.inf
    for _ in range(3):
        world = World(
            setup.tanker, setup.airframe, np.array(scenario.start_tanker_m), turbulence, True,
            np.random.default_rng(SEED), conditions=scenario.plant,
        )
        loops = InnerLoops(setup.airframe)
        start_s = time.process_time()
        for _ in range(STEPS):
            world.step(loops.step(0.0, trim.alpha_rad, trim.throttle, perfect(world.truth.uav)))
        best_s = min(best_s, time.process_time() - start_s)
    assert np.isfinite(world.truth.uav.p_ned_m).all()
    print(f"\nplant and inner loops, {turbulence} turbulence: {SIMULATED_S / best_s:.0f}x real time "
          f"({1e6 * best_s / STEPS:.0f} us a step)")


@pytest.mark.bench
@pytest.mark.parametrize("name", ["docking", "thesis"])
@pytest.mark.parametrize("vision_input", ["pictures", "detections"])
def test_whole_flight(name: str, vision_input: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    scenario = msgspec.structs.replace(load_scenario(name), seed=SEED, vision_input=vision_input, hold_s=30.0)
    setup = scenario.setup()
    recorder = msgspec.structs.replace(setup.config.recorder, out=str(tmp_path))
    setup = msgspec.structs.replace(setup, config=msgspec.structs.replace(setup.config, recorder=recorder))
    Simulation(scenario, setup).step()
    start_s = time.process_time()
    summary = fly(scenario, setup).summary
    cpu_s = time.process_time() - start_s
    assert summary["docked"]
    print(f"\n{name}, {vision_input}: {summary['flown_s'] / cpu_s:.1f}x real time by processor time, start and report "
          f"included; {summary['real_time_factor']}x by the clock")
