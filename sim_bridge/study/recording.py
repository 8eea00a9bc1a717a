"""A flight as the study needs it: what each picture gave, and where the tanker truly was.

It is flown as the thesis has it: straight to the box on one cubic of 50 s, with its blend of GPS and vision, and with
no guard that ends it for its closure (up to 1.8 m/s) or for pictures that show no pose: those are what is studied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.app import warm_up
from companion.config import ConfigError, Setup
from companion.geometry import SE3, Mat, Vec
from companion.messages import NS, FusedPose, Output, Phase, PhaseChange, VisionOutput
from companion.vision.camera import T_frd_cam, pixels_to_normalised
from companion.vision.labeling import label_mutual_nearest
from sim_bridge.flight import LockstepCompanion, Unrecorded
from sim_bridge.plant.fdm import PlantError
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.simulation import TRUTH_EVERY, Simulation
from sim_bridge.study.axes import xyz
from sim_bridge.truth import Truth

Mode = Literal["sv", "rv"]
MODES: tuple[Mode, Mode] = ("sv", "rv")
DURATION_S = 51.0
"""The thesis looks at 50 s at the most (Tab. 7.5); a second more leaves room for shifts in time (7.3)."""

TIMEOUT_S = 120.0


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One flight, a row for each picture from the start of the approach: ``t_s`` (n,) counts from there.

    ``T_true``, ``T_prior``, ``T_gps``: where the tanker truly was in the camera, what the chain expected, and what GPS
    and INS alone said. ``predicted_px`` (n, 9, 2) the expected markers, ``detected_px`` the (m, 2) centroids of each
    picture, ``labels`` (n, 9) into them by the thesis' labeling, -1 for none; ``uv`` (n, 9, 2) the labelled markers on
    the plane z = 1, NaN for none. ``track_s`` (k,) and ``track`` (k, 3) are the true position at 50 Hz, thesis axes.
    """

    setup: Setup
    mode: Mode
    markers: Mat
    t_s: Vec
    T_true: list[SE3]
    T_prior: list[SE3]
    T_gps: list[SE3]
    predicted_px: Mat
    detected_px: list[Mat]
    labels: NDArray[np.int64]
    uv: Mat
    track_s: Vec
    track: Mat

    def until(self, t_s: float) -> int:
        """Return how many pictures there are up to ``t_s``."""
        return int(np.searchsorted(self.t_s, t_s + 1e-6, side="right"))

    def at(self, t_s: float) -> int:
        """Return the picture nearest to ``t_s``."""
        return int(np.argmin(np.abs(self.t_s - t_s)))

    def scale_px(self) -> float:
        """Return the camera's focal length in pixels."""
        return float(np.sqrt(self.setup.camera.fx_px * self.setup.camera.fy_px))


def stamp_ms(t_ns: int) -> int:
    """Return an instant in ms: what is one instant may differ by 1 ns between the aircraft's clock and ours."""
    return round(t_ns * 1e-6)


class Notes:
    """What is written down while the flight goes on, by instant in ms."""

    def __init__(self) -> None:
        self.start_ns: int | None = None
        self.seen: dict[int, VisionOutput] = {}
        self.prior: dict[int, SE3] = {}
        self.gps: dict[int, SE3] = {}
        self.truth: dict[int, Truth] = {}

    def output(self, output: Output) -> None:
        """Keep what the chain saw and what GPS said, from the start of the approach."""
        if isinstance(output, PhaseChange) and output.new is Phase.APPROACH and self.start_ns is None:
            self.start_ns = output.t_ns
        elif isinstance(output, VisionOutput):
            self.seen[stamp_ms(output.t_ns)] = output
        elif isinstance(output, FusedPose):
            self.gps[stamp_ms(output.t_ns)] = output.T_cam_tanker_gps

    def over(self, t_ns: int, duration_s: float) -> bool:
        """Tell whether the part of the flight that is studied is over."""
        return (self.start_ns is not None and (t_ns - self.start_ns) * NS >= duration_s) or t_ns * NS >= TIMEOUT_S


def scenario_for(seed: int) -> Scenario:
    """Return the flight of the study: the docking with the thesis' camera, 320x200 at 10 Hz."""
    return msgspec.structs.replace(load_scenario("thesis"), seed=seed)


def setup_for(scenario: Scenario, mode: Mode) -> Setup:
    """Return the companion's configuration with simulated or real vision (thesis 4.2.5)."""
    replace, setup = msgspec.structs.replace, scenario.setup()
    c = setup.config
    guard = replace(c.guidance.guard, closure_m_s=2.0 * c.guidance.max_closure_m_s, sight_lost_s=10.0)
    guidance = replace(
        c.guidance, procedure="direct", self_test=False, approach_closure_m_s=c.guidance.max_closure_m_s, guard=guard
    )
    config = replace(
        c, vision=replace(c.vision, mode=mode), fusion=replace(c.fusion, method="blend"), guidance=guidance
    )
    return replace(setup, config=config)


def record(mode: Mode, seed: int, duration_s: float = DURATION_S) -> Recording:
    """Fly in lockstep and return what the study needs of ``duration_s`` from the start of the approach.

    Raises ConfigError when this seed's flight never gets to an approach or its plant fails.
    """
    scenario = scenario_for(seed)
    setup = setup_for(scenario, mode)
    warm_up(setup)
    simulation, notes = Simulation(scenario, setup), Notes()
    companion = LockstepCompanion(setup, Unrecorded(), notes.output)
    pipeline, step = companion.service.pipeline, 0
    while not notes.over(simulation.truth.t_ns, duration_s):
        if step % TRUTH_EVERY == 0:
            notes.truth[stamp_ms(simulation.truth.t_ns)] = simulation.truth
        try:
            arrivals = simulation.step()
        except PlantError as error:
            msg = f"--seed {seed}: the plant failed ({error}); take another seed"
            raise ConfigError(msg) from None
        if arrivals.frames:  # asked before the frame changes the fusion: what the chain is about to be given
            exposed_ns = arrivals.frames[0].t_ns
            known = pipeline.fusion.prior(exposed_ns)
            by_gps = pipeline.aircraft.gps_prior(exposed_ns)
            prior = by_gps if mode == "sv" else None if known is None else known.T_cam_tanker
            if prior is not None:
                notes.prior[stamp_ms(exposed_ns)] = prior
        companion.hear(simulation.feed_mavlink(companion.arrive(arrivals), arrivals.t_ns))
        step += 1
    if notes.start_ns is None:
        msg = f"--seed {seed}: the flight never began its approach; take another seed"
        raise ConfigError(msg)
    return _recording(setup, mode, notes, notes.start_ns, duration_s)


def _recording(setup: Setup, mode: Mode, notes: Notes, start_ns: int, duration_s: float) -> Recording:
    """Put the notes in order of time."""
    start_ms = stamp_ms(start_ns)
    end_ms = start_ms + round(duration_s * 1e3)
    known = notes.truth.keys() & notes.prior.keys() & notes.gps.keys() & notes.seen.keys()
    stamps = sorted(t for t in known if start_ms <= t <= end_ms)
    first = stamps[0]
    seen = [notes.seen[t] for t in stamps]
    predicted = np.array([s.predicted_uv_px for s in seen])
    detected = [s.detections.uv_px for s in seen]
    labels = np.array([_labels(setup, mode, p, d) for p, d in zip(predicted, detected, strict=True)])
    track_ms = sorted(t for t in notes.truth if first - 1000 <= t <= end_ms)
    T_cam_frd = T_frd_cam(setup.camera).inverse()
    T_true = {t: _T_cam_tanker(T_cam_frd, notes.truth[t]) for t in track_ms}
    return Recording(
        setup, mode, np.array([m.p_tanker_m for m in setup.tanker.markers]),
        (np.array(stamps) - first) * 1e-3,
        [T_true[t] for t in stamps], [notes.prior[t] for t in stamps], [notes.gps[t] for t in stamps],
        predicted, detected, labels, np.array([labelled(setup, d, k) for d, k in zip(detected, labels, strict=True)]),
        (np.array(track_ms) - first) * 1e-3, xyz(np.array([T_true[t].t for t in track_ms])),
    )


def _labels(setup: Setup, mode: Mode, predicted: Mat, detected: Mat) -> NDArray[np.int64]:
    """Return the thesis' labels; simulated vision has every marker, in order, whatever the size of the picture."""
    limit = 1e-6 if mode == "sv" else setup.config.vision.labeling.max_distance_px
    return label_mutual_nearest(predicted, detected, limit)


def labelled(setup: Setup, detected_px: Mat, labels: NDArray[np.int64]) -> Mat:
    """Return the labelled markers (9, 2) on the plane z = 1, NaN where there is none."""
    uv = np.full((len(labels), 2), np.nan)
    found = np.flatnonzero(labels >= 0)
    uv[found] = pixels_to_normalised(setup.camera, detected_px[labels[found]])
    return uv


def _T_cam_tanker(T_cam_frd: SE3, truth: Truth) -> SE3:
    return T_cam_frd @ truth.uav.T_ned_body().inverse() @ truth.tanker.T_ned_body()
