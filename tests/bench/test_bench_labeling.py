"""The two labelings on the same frames: wrong labels of both, and the time of a usual frame. Figures, not limits."""

import importlib
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from companion.vision.camera import project
from companion.vision.labeling import label_mutual_nearest
from companion.vision.reacquisition import reacquire
from companion.vision.robust_labeling import label_robust
from sim_bridge.label_score import LabelScore

pytestmark = pytest.mark.bench


@pytest.fixture(scope="module")
def scenes():
    """Return the module with the frames of the vision tests."""
    sys.path.append(str(Path(__file__).parent.parent / "vision"))
    return importlib.import_module("label_frames")


def microseconds(function, rounds):
    """Median of one call, after a few to warm up."""
    for _ in range(5):
        function()
    spent = []
    for _ in range(rounds):
        start = time.perf_counter_ns()
        function()
        spent.append(time.perf_counter_ns() - start)
    return float(np.median(spent)) / 1e3


@pytest.mark.parametrize("trouble", ["none", "every"])
def test_wrong_labels_of_both(scenes, trouble):
    """2000 frames; a false point where a missing light would be, within the noise, counts as wrong too."""
    kind = scenes.Trouble() if trouble == "every" else scenes.Trouble(0, 0, split=0.0, merged=0.0, gross=0.0)
    rng, nearest, robust, passed = np.random.default_rng(5), LabelScore(9), scenes.Tally(), 0
    for _ in range(2000):
        f = scenes.frame(rng, kind)
        predicted = project(scenes.CAMERA, f.prior, scenes.MARKERS)
        labels = label_mutual_nearest(predicted, f.uv_px, scenes.CONFIG.max_distance_px)
        nearest.add(labels, f.truth, f.pure)
        passed += np.count_nonzero(labels >= 0) >= 5
        robust.add(f, label_robust(scenes.MARKERS, f.uv, f.sigma, f.prior, f.cov_prior, scenes.CONFIG))
    print(f"\n{trouble} trouble, mutual nearest, {passed} frames with five labels or more\n{nearest.table()}")
    print(f"{trouble} trouble, robust\n{robust.text()}")
    assert robust.score.swapped == 0


def test_time(scenes):
    """Nine lights; then one hidden and three false points with a prior 4 m off; then no prior, 12 detections."""
    rng = np.random.default_rng(6)
    usual = scenes.frame(rng, scenes.Trouble(0, 0, split=0.0, merged=0.0, gross=0.0))
    while usual.whole < 9:
        usual = scenes.frame(rng, scenes.Trouble(0, 0, split=0.0, merged=0.0, gross=0.0))
    rare = scenes.frame(rng, scenes.Trouble())
    while not (rare.whole == 8 and len(rare.truth) == 11 and rare.gross_m > 3.5):
        rare = scenes.frame(rng, scenes.Trouble())
    markers, config = scenes.MARKERS, scenes.CONFIG
    predicted = project(scenes.CAMERA, usual.prior, markers)
    uv, other = usual.uv, rare.uv
    blind = np.vstack([other, rng.uniform(-0.4, 0.4, (1, 2))])
    rows = {
        "mutual nearest, usual frame": (lambda: label_mutual_nearest(predicted, usual.uv_px, 40.0), 2000),
        "robust, usual frame": (
            lambda: label_robust(markers, uv, usual.sigma, usual.prior, usual.cov_prior, config), 2000),
        "robust, prior 4 m off, 3 false points": (
            lambda: label_robust(markers, other, rare.sigma, rare.prior, rare.cov_prior, config), 500),
        "no position": (lambda: reacquire(markers, other, rare.sigma, config, rare.prior.R), 300),
        "nothing known, 12 detections": (lambda: reacquire(markers, blind, np.full(12, rare.sigma[0]), config), 20),
    }
    print()
    for name, (function, rounds) in rows.items():
        print(f"  {name:<42} {microseconds(function, rounds):10.1f} us")
