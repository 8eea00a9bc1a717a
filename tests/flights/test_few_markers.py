"""Docking on while most lights are out: the INS attitude carries what two to four of them leave open."""

from dataclasses import replace

import numpy as np
import pytest
from lockstep import TO_HOLD, S, during, fly_with, near

from companion.messages import CameraFrame, Phase, VisionOutput
from companion.vision.camera import T_frd_cam, project

GREY = (150, 150, 150)


def put_out(setup, lit):
    """Return a fault that paints over every light but those in ``lit``, seen where they truly are."""
    markers = np.array([m.p_tanker_m for m in setup.tanker.markers])
    dark = [i for i in range(len(markers)) if i not in lit]
    reach = 7

    def paint(frame: CameraFrame, T_cam_tanker) -> CameraFrame:
        image = frame.image.copy()
        for u, v in project(setup.camera, T_cam_tanker, markers[dark]).round().astype(int):
            image[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1] = GREY
        return replace(frame, image=image)

    def fault(arrivals, flight):
        truth = flight.simulation.truth
        T = (truth.uav.T_ned_body() @ T_frd_cam(setup.camera)).inverse() @ truth.tanker.T_ned_body()
        return replace(arrivals, frames=[paint(f, T) for f in arrivals.frames])

    return fault


@pytest.mark.parametrize("lit", [(1, 2, 3, 7), (1, 2, 7)], ids=["four", "three"])
def test_a_hold_goes_on_with_few_lights(tmp_path, lit):
    scenario, setup = near(208, path_s=8.0, hold_s=8.0)
    flight = fly_with(tmp_path, scenario, setup, during(Phase.HOLD, 1.0, 5.0, put_out(setup, lit)))
    hold_s = flight.entered_s(Phase.HOLD)
    dimmed = [o for o in flight.of(VisionOutput) if hold_s + 1.1 < o.t_ns / S < hold_s + 5.9]
    with_pose = [o.pose for o in dimmed if o.pose is not None]
    assert len(dimmed) >= 47
    assert {p.markers_used for p in with_pose} <= set(range(2, len(lit) + 1))
    assert len(with_pose) >= 0.9 * len(dimmed)
    before = next(o.pose for o in flight.of(VisionOutput) if o.t_ns / S > hold_s)
    assert np.trace(with_pose[0].cov[:3, :3]) > np.trace(before.cov[:3, :3])
    assert np.abs(flight.estimate_errors(hold_s + 1.1, hold_s + 5.9)).max() < 0.25
    assert flight.phases == TO_HOLD
    br = np.array(flight.truth_br)[np.array(flight.t_s) >= hold_s]
    assert (np.abs(br) < setup.tanker.window.desired_m).all()
