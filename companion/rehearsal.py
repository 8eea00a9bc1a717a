"""A second of flight before the flight, so that nothing of the whole chain is compiled while somebody waits.

Level behind the tanker, lights seen as detections: all, a few, one, one that is out of place, none.
"""

from __future__ import annotations

import numpy as np

from companion.config import Setup
from companion.geometry import SE3, Vec, rotation_from_euler
from companion.messages import Detections, Event, GpsStatus, MarkerFrame, OwnAttitude, OwnPosition, TankerState, Tick
from companion.pipeline import Pipeline
from companion.vision.camera import T_frd_cam, project

STEP_NS = 20_000_000
STEPS = 80
FIRST_FEW = 50
"""Steps after which fewer lights are seen."""
BEHIND_M = np.array([-5.0, 0.0, 2.0])
"""BR of the rehearsal."""


def rehearse_flight(setup: Setup) -> None:
    """Run a pipeline of its own through it; raises ConfigError for a configuration that none can be built of."""
    pipeline = Pipeline(setup)
    R_ned_frd = rotation_from_euler(0.0, setup.airframe.trim.alpha_rad, 0.0)
    box_m, receptacle_m = np.array(setup.tanker.box_tanker_m), np.array(setup.airframe.receptacle_frd_m)
    T_tanker_frd = SE3(R_ned_frd, box_m + BEHIND_M - R_ned_frd @ receptacle_m)
    T_cam_tanker = (T_tanker_frd @ T_frd_cam(setup.camera)).inverse()
    uv_px = project(setup.camera, T_cam_tanker, pipeline.vision.markers)
    seen = np.flatnonzero(np.isfinite(uv_px).all(axis=1))
    v_ned_m_s = np.array([setup.airframe.trim.airspeed_m_s, 0.0, 0.0])
    for k in range(STEPS):
        for event in telemetry(k, T_tanker_frd, v_ned_m_s):
            pipeline.handle(event)
        if k % 3 == 0:
            few = seen if k < FIRST_FEW else seen[: (STEPS - k) // 6]
            pipeline.handle(frame(k, uv_px[few], 20.0 if k % 4 == 0 and k >= FIRST_FEW else 0.0))
        pipeline.handle(Tick(k * STEP_NS))


def telemetry(k: int, T_tanker_frd: SE3, v_ned_m_s: Vec) -> list[Event]:
    """Return what both aircraft tell at step ``k``; the rates differ from step to step, or that would be frozen."""
    t_ns = k * STEP_NS
    way_m = v_ned_m_s * (t_ns * 1e-9)
    rates = np.array([1e-6 * (k % 7), 0.0, 0.0])
    return [
        GpsStatus(t_ns, has_fix=True),
        OwnAttitude(t_ns, T_tanker_frd.R, rates),
        OwnPosition(t_ns, way_m + T_tanker_frd.t, v_ned_m_s),
        TankerState(t_ns, way_m, v_ned_m_s, np.eye(3), rates),
    ]


def frame(k: int, uv_px: Vec, off_px: float) -> MarkerFrame:
    """Return a frame of lights, the last of them so far out of place."""
    uv_px = uv_px + 0.01 * (k % 5)
    uv_px[-1:] += off_px
    m = len(uv_px)
    detections = Detections(k * STEP_NS, uv_px, np.full(m, 9.0), np.full(m, 0.05), np.zeros(m, dtype=np.uint8))
    return MarkerFrame(k * STEP_NS, k, detections)
