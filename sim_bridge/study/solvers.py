"""The solvers that are compared, each with its own memory, fed one frame after another.

Rules
-----
* As in the thesis: GLSDC starts from its own last X (eq. 5.51 ff.), LHM from its own last rotation (6.3), and both keep
  the last estimate when fewer than 4 or 5 markers are seen. Nothing watches over them: what diverges stays diverged.
* SQPNP and EPNP of OpenCV have no memory beside the estimate that they keep with fewer than 5 markers.
* ``chain`` is what this project flies: LHM from the attitude that the INS tell, refined by maximum likelihood with that
  attitude as one more measurement, judged by its residuals, and refused rather than wrong. Its labels are verified.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.config import Setup
from companion.geometry import SE3, Mat
from companion.messages import Detections, PoseMeasurement
from companion.vision.chain import VisionChain
from companion.vision.glsdc import solve_glsdc
from companion.vision.lhm import solve_lhm
from companion.vision.pose import PoseEstimator
from sim_bridge.study.recording import Recording

GLSDC_STEPS = 4
GLSDC_MIN_MARKERS = 4
LHM_MIN_MARKERS = 5
"""Thesis 7.1, 5.3 and 6.3."""

OPENCV = {"SQPNP": cv2.SOLVEPNP_SQPNP, "EPNP": cv2.SOLVEPNP_EPNP}
COLOURS = {"GLSDC": "#d1495b", "LHM": "#3d7ebf", "SQPNP": "#7a7a7a", "EPNP": "#c9a227", "chain": "#2e9e5b"}
NAMES = tuple(COLOURS)
"""Names of all solvers, the thesis' two first, and the colour of each in every picture."""


class Tracker(Protocol):
    """A solver with a memory."""

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3 | None:
        """Return the pose of one frame's markers (n, 3) seen at uv (n, 2); None when there is no new one.

        ``prior`` is what GPS, INS and the last fused pose make the chain expect; the others do not look at it.
        """


class Glsdc:
    """Gauss-Newton from its own last answer."""

    def __init__(self, T_start: SE3) -> None:
        self.T = T_start

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3 | None:
        """See ``Tracker``."""
        if len(points) < GLSDC_MIN_MARKERS:
            return None
        self.T = solve_glsdc(points, uv, self.T, GLSDC_STEPS).T_cam_tanker
        return self.T


class Lhm:
    """Orthogonal iteration from its own last rotation."""

    def __init__(self, T_start: SE3) -> None:
        self.R = T_start.R

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3 | None:
        """See ``Tracker``."""
        if len(points) < LHM_MIN_MARKERS:
            return None
        T = solve_lhm(points, uv, self.R).T_cam_tanker
        self.R = T.R
        return T


class OpenCv:
    """One of OpenCV's solvers, from nothing each time."""

    def __init__(self, flag: int) -> None:
        self._flag = flag
        self._K = np.eye(3)

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3 | None:
        """See ``Tracker``."""
        if len(points) < LHM_MIN_MARKERS:
            return None
        found, rotation, t = cv2.solvePnP(points, uv, self._K, None, flags=self._flag)
        if not found or not np.isfinite(t).all():
            return None
        return SE3(cv2.Rodrigues(rotation)[0], t.ravel())


class Chain:
    """What this project flies on labelled markers (``companion.vision.pose``), told how noisy they are.

    Nothing is remembered: the start and the attitude are those of the prior, or there is none. ``verified``: the labels
    come from the robust labeling, or are right by the test's own doing.
    """

    def __init__(self, setup: Setup, noise: float, *, verified: bool = True, knows_prior: bool = True) -> None:
        vision = setup.config.vision
        markers = len(setup.tanker.markers)
        self._estimator = PoseEstimator(setup.camera, vision, markers)
        scale = float(np.sqrt(setup.camera.fx_px * setup.camera.fy_px))
        self._sigma = np.full(markers, np.hypot(vision.sigma_px / scale, noise))
        self._verified, self._knows_prior = verified, knows_prior

    def step(self, points: Mat, uv: Mat, prior: SE3) -> SE3 | None:
        """See ``Tracker``."""
        expected = prior if self._knows_prior else None
        found = self._estimator.measure(points, uv, self._sigma[: len(points)], expected, verified=self._verified)
        return None if isinstance(found, tuple) else found.T_cam_tanker


def whole_chain(setup: Setup) -> VisionChain:
    """Return the chain as it flies, with its robust labeling, looking at the picture."""
    vision = setup.config.vision
    labeling = msgspec.structs.replace(vision.labeling, method="robust")
    return VisionChain(setup.camera, setup.tanker, msgspec.structs.replace(vision, mode="rv", labeling=labeling))


def look(chain: VisionChain, px: Mat, prior: SE3, noise_px: float) -> PoseMeasurement | None:
    """Return what the chain makes of detections (m, 2) px that are as noisy as it is told; None when it refuses."""
    m = len(px)
    sigma_px = np.full(m, noise_px)
    return chain.measure(0, Detections(0, px, np.ones(m), sigma_px, np.zeros(m, dtype=np.uint8)), prior).pose


def tracker(name: str, setup: Setup, T_start: SE3, noise: float = 0.0, *, verified: bool = True) -> Tracker:
    """Return a solver with its memory at ``T_start``.

    The chain alone is told the ``noise`` on the plane z = 1, and whether its labels have been verified.
    """
    if name == "chain":
        return Chain(setup, noise, verified=verified)
    if name in OPENCV:
        return OpenCv(OPENCV[name])
    return Glsdc(T_start) if name == "GLSDC" else Lhm(T_start)


def track(
    name: str, recording: Recording, uv: Mat, T_start: SE3, noise: float = 0.0, *, verified: bool = True
) -> tuple[Mat, Mat, NDArray[np.bool_]]:
    """Run one solver over frames ``uv`` (k, n, 2), NaN for a marker not seen, of a recording's first frames.

    Returns the translations (k, 3) and rotations (k, 3, 3) that there are after each frame, and whether they are new
    (k,). Without a new estimate the thesis' solvers and OpenCV's go on saying the last one; a frame that the chain
    refuses leaves the flight with GPS and INS, so their pose is counted.
    """
    solver = tracker(name, recording.setup, T_start, noise, verified=verified)
    T, points = T_start, recording.markers
    t, R, fresh = np.empty((len(uv), 3)), np.empty((len(uv), 3, 3)), np.zeros(len(uv), dtype=bool)
    seen = np.isfinite(uv[:, :, 0])
    every = [bool(s.all()) for s in seen]
    for k, frame in enumerate(uv):
        prior = recording.T_prior[k]
        try:
            answer = (
                solver.step(points, frame, prior)
                if every[k]
                else solver.step(points[seen[k]], frame[seen[k]], prior)
            )
        except ValueError:  # what a solver says of markers, or of its own last answer, that fix no pose
            answer = None
        if answer is not None:
            T, fresh[k] = answer, True
        elif name == "chain":
            T = recording.T_gps[k]
        t[k], R[k] = T.t, T.R
    return t, R, fresh
