"""Whole dockings in lockstep: seen through the companion's own outputs and against the truth.

The quick ones begin 3 m from the box, where the blend flies on vision alone (thesis eq. 3.9: d < d2), with the thesis'
camera.
"""

import json
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from lockstep import REFUELLING, TO_HOLD, S, fly_with, near, recording_in, with_guidance

from companion.messages import FusedPose, Integrity, Phase, RelativeState, VisionOutput
from sim_bridge.flight import fly
from sim_bridge.scenario import load_scenario

HOLD_S = 8.0


def assert_docked_well(flight, window):
    """Into the window and stays, with a setpoint every 20 ms, on an estimate that is right and never jumps."""
    assert flight.failure is None
    assert flight.phases == TO_HOLD
    hold_s = flight.entered_s(Phase.HOLD)
    br = np.array(flight.truth_br)[np.array(flight.t_s) >= hold_s]
    assert len(br) * 0.005 == pytest.approx(HOLD_S, abs=0.03)
    assert (np.abs(br) < window.desired_m).all()
    assert np.allclose(np.diff(flight.setpoints_s()), 0.02, atol=1e-6)
    assert flight.setpoints_s()[0] == pytest.approx(flight.entered_s(Phase.JOIN))
    errors = flight.estimate_errors(flight.entered_s(Phase.APPROACH), np.inf)
    assert np.abs(errors).max() < 0.05
    assert biggest_jump_m(flight, flight.entered_s(Phase.APPROACH)) < 0.05
    seen = flight.of(VisionOutput)
    assert all(o.pose is not None for o in seen)
    assert flight.summary["frames_with_pose"] == len(seen)
    assert flight.summary["frames"] - len(seen) == flight.summary["rejects"]["vision.no_prior"] <= 2


def biggest_jump_m(flight, start_s):
    """Return the largest step of the estimated BR that the estimated velocity does not explain."""
    states = [o for o in flight.of(RelativeState) if o.t_ns / S >= start_s]
    p, v = np.array([o.p_mrf_br_m for o in states]), np.array([o.v_mrf_br_m_s for o in states])
    dt = np.diff([o.t_ns for o in states])[:, None] / S
    return np.linalg.norm(np.diff(p, axis=0) - v[:-1] * dt, axis=1).max()


@pytest.mark.parametrize(("solver", "fusion"), [("lhm", "filter"), ("lhm", "blend"), ("glsdc", "blend")])
def test_docks_on_vision(tmp_path, solver, fusion):
    scenario, setup = near(201, hold_s=HOLD_S, fusion=fusion)
    config = setup.config
    vision = msgspec.structs.replace(config.vision, solver=solver)
    setup = msgspec.structs.replace(setup, config=msgspec.structs.replace(config, vision=vision))
    flight = fly_with(tmp_path, scenario, setup)
    assert_docked_well(flight, setup.tanker.window)
    if fusion == "blend":
        assert {o.vision_weight for o in flight.of(FusedPose)} == {1.0}
    else:
        assert flight.summary["filter"]["pixels"]["accepted_fraction"] > 0.95
    assert (flight.summary["pose_solver"], flight.summary["fusion"]) == (solver, fusion)
    assert flight.summary["integrity"]["may_dock_fraction"] == 1.0
    assert [phase for _, phase, _ in flight.summary["phases"]] == [p.value for p in TO_HOLD]


def test_a_whole_refuelling(tmp_path):
    """From behind the pre-contact point, every gate passed by itself: slow at the end, and never before it may."""
    start = {"start_tanker_m": (-49.0, -2.0, 17.0), "timeout_s": 120.0}
    scenario, setup = near(209, hold_s=4.0, vision_input="detections", **start)
    setup = with_guidance(setup, procedure="refuelling", self_test=True)
    flight = fly_with(tmp_path, scenario, setup)
    assert flight.phases == REFUELLING
    t, br = np.array(flight.t_s), np.array(flight.truth_br)
    approach_s, contact_s = flight.entered_s(Phase.APPROACH), flight.entered_s(Phase.CONTACT)
    held = br[(t > approach_s - 3.0) & (t < approach_s)]
    assert np.linalg.norm(held - setup.config.guidance.pre_contact_m, axis=1).max() < 1.0
    last = (t > approach_s) & (t < contact_s) & (np.linalg.norm(br, axis=1) < 2.0)
    assert br[last][0, 0] < -1.5
    closure_m_s = (np.linalg.norm(br[last][0]) - np.linalg.norm(br[last][-1])) / np.ptp(t[last])
    assert closure_m_s <= 0.3
    assert (np.abs(br[t >= flight.entered_s(Phase.HOLD)]) < setup.tanker.window.desired_m).all()
    may = [(o.t_ns / S, o.may_dock) for o in flight.of(Integrity)]
    assert all(ok for t_s, ok in may if t_s > approach_s - setup.config.guidance.may_dock_s)


def test_heading_does_not_matter(tmp_path):
    """Everything is flown in the psi frame (thesis 1.1): only rounding and the sensors' noise tell one from another."""
    tracks = []
    for k, heading_rad in enumerate((0.0, 1.0)):
        (tmp_path / str(k)).mkdir()
        scenario, setup = near(202, hold_s=2.0, heading_rad=heading_rad, start_tanker_m=(-30.5, -1.0, 10.0))
        flight = fly_with(tmp_path / str(k), scenario, setup)
        assert flight.phases == TO_HOLD
        start = int(np.searchsorted(flight.t_s, flight.entered_s(Phase.APPROACH)))
        tracks.append(np.array(flight.truth_br)[start : start + 1400])
        assert len(tracks[k]) == 1400
    assert np.abs(tracks[1] - tracks[0]).max() < 0.1


def fly_in_a_fresh_process(folder, seed):
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); from test_docking import fly_briefly; "
        "print(fly_briefly(sys.argv[2], int(sys.argv[3])))"
    )
    command = [sys.executable, "-c", program, str(__file__).rpartition("/")[0], str(folder), str(seed)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def fly_briefly(out, seed, **scenario_fields):
    scenario, setup = near(seed, hold_s=0.5, start_tanker_m=(-30.5, -1.0, 10.0), **scenario_fields)
    return fly(scenario, recording_in(setup, out)).folder


def test_same_seed_same_bytes_and_another_seed_others(tmp_path):
    first, second = fly_briefly(tmp_path, 203), fly_briefly(tmp_path, 203)
    other = fly_briefly(tmp_path, 204, timeout_s=3.0)
    fresh = fly_in_a_fresh_process(tmp_path, 203)
    assert json.loads((first / "summary.json").read_text())["docked"]
    for name in ("events.jsonl", "telemetry.tlog"):
        recorded = (first / name).read_bytes()
        assert len(recorded) > 100_000
        assert recorded == (second / name).read_bytes()
        assert recorded == (first.parent / fresh / name).read_bytes()
        assert recorded[:50_000] != (other / name).read_bytes()[:50_000]


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["thesis", "docking"])
@pytest.mark.parametrize("seed", [205, 206])
def test_docks_from_the_thesis_start(tmp_path, camera, seed):
    """From [-50, -20, 30] m through every phase of a refuelling."""
    scenario = msgspec.structs.replace(load_scenario(camera), seed=seed, hold_s=HOLD_S)
    setup = scenario.setup()
    flight = fly_with(tmp_path, scenario, setup)
    weights = [o.vision_weight for o in flight.of(FusedPose)]
    assert min(weights) < 0.1
    assert weights[-1] == 1.0
    whole = next(o.t_ns for o in flight.of(FusedPose) if o.vision_weight == 1.0) / S + 0.5
    assert flight.phases == REFUELLING
    assert np.abs(flight.estimate_errors(whole, np.inf)).max() < 0.10
    assert np.abs(flight.estimate_errors(flight.entered_s(Phase.HOLD), np.inf)).max() < 0.05
    br = np.array(flight.truth_br)[np.array(flight.t_s) >= flight.entered_s(Phase.HOLD)]
    assert (np.abs(br) < setup.tanker.window.desired_m).all()
    assert np.allclose(np.diff(flight.setpoints_s()), 0.02, atol=1e-6)
