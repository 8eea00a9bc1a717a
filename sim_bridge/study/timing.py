"""Section 7.2: how long a call takes on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from companion.geometry import Mat
from sim_bridge.study import listing, thesis_numbers
from sim_bridge.study.counting import Lapack
from sim_bridge.study.flops import RUN_S, crf_state
from sim_bridge.study.listing import ListedLhm
from sim_bridge.study.recording import MODES, Recording
from sim_bridge.study.section import Cell, Section, Study, Table
from sim_bridge.study.solvers import GLSDC_STEPS, NAMES, tracker

WARM_CALLS = 20
LISTED = ("GLSDC as listed", "LHM as listed")
Call = Callable[[int], object]


def calls(name: str, recording: Recording, frames: int) -> Call:
    """Return a function that solves frame k, with the memory that the solver has by then."""
    points, priors = recording.markers, recording.T_prior
    sets: list[tuple[Mat, Mat]] = []
    for uv in recording.uv[:frames]:
        seen = np.isfinite(uv[:, 0])
        sets.append((points, uv) if bool(seen.all()) else (points[seen], uv[seen]))
    if name == "GLSDC as listed":
        return lambda k: listing.glsdc(crf_state(priors[k]), sets[k][1].ravel(), sets[k][0], GLSDC_STEPS, Lapack())
    solver = ListedLhm(priors[0]) if name == "LHM as listed" else tracker(name, recording.setup, priors[0])
    return lambda k: solver.step(*sets[k], priors[k])


def medians_us(by_name: dict[str, Call], frames: int, rounds: int) -> dict[str, float]:
    """Return the median time of each call in us, over all frames and rounds, after a few to warm up.

    All are called for a frame before the next one comes, so that a slow moment of the machine slows them alike.
    """
    spent: dict[str, list[int]] = {name: [] for name in by_name}
    for call in by_name.values():
        for k in range(min(WARM_CALLS, frames)):
            call(k)
    for _ in range(rounds):
        for k in range(frames):
            for name, call in by_name.items():
                start = time.perf_counter_ns()
                call(k)
                spent[name].append(time.perf_counter_ns() - start)
    return {name: float(np.median(times)) / 1e3 for name, times in spent.items()}


def timing(study: Study) -> Section:
    """Time every solver on the frames of both flights."""
    figures: dict[tuple[str, str], float] = {}
    for mode in MODES:
        recording = study.recording(mode)
        frames = recording.until(RUN_S)
        for names, rounds in ((NAMES, 2 if study.quick else 10), (LISTED, 1)):
            by_name = {name: calls(name, recording, frames) for name in names}
            figures |= {(name, mode): us for name, us in medians_us(by_name, frames, rounds).items()}
    rows: list[tuple[Cell, ...]] = [
        (name, *_row(figures[name, "sv"], figures[name, "rv"], figures["LHM", "sv"], figures["LHM", "rv"]))
        for name in (*NAMES, *LISTED)
    ]
    theirs = {key: seconds * 1e6 for key, seconds in thesis_numbers.SECONDS_PER_CALL.items()}
    rows += [
        (f"thesis, {name}", *_row(theirs[name, "sv"], theirs[name, "rv"], theirs["LHM", "sv"], theirs["LHM", "rv"]))
        for name in ("GLSDC", "LHM")
    ]
    ratio = figures["LHM as listed", "sv"] / figures["GLSDC as listed", "sv"]
    ours = figures["LHM", "sv"] / figures["GLSDC", "sv"]
    return Section(
        "7.2", "Speed",
        "Median time of one call, over the 401 frames of the first 40 s. Solvers are called as the public functions "
        "that fly; 'as listed' is the thesis' listing in plain numpy, nearest to what its Matlab did.",
        (Table("Time of one call, us, and in units of LHM (Tab. 7.2)",
               ("", "SV, us", "RV, us", "SV / LHM", "RV / LHM"), tuple(rows), (len(rows) - 2, len(rows) - 1)),),
        (), (
            f"As listed, LHM takes {ratio:.2f} times as long as GLSDC in SV (thesis 2.93), though it has fewer "
            "operations (7.1): in an interpreter statements count, not operations. Folded and compiled the ratio is "
            f"{ours:.2f}.",
            "Absolute times are of another machine, twenty years and a compiler apart.",
        ),
    )


def _row(sv: float, rv: float, lhm_sv: float, lhm_rv: float) -> tuple[float, ...]:
    return round(sv, 2), round(rv, 2), round(sv / lhm_sv, 3), round(rv / lhm_rv, 3)
