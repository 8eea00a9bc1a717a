"""Section 7.1: how many floating-point operations the solvers take, counted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.geometry import SE3, Mat, R_cam_crf, Vec, euler_from_rotation
from companion.vision import glsdc_kernel, lhm_kernel
from companion.vision.glsdc import ALL_ALIKE
from companion.vision.lhm import METHODS, solve_lhm
from sim_bridge.study import listing, thesis_numbers
from sim_bridge.study.axes import xyz
from sim_bridge.study.counting import Lapack, Tally, Textbook, counted, source_of
from sim_bridge.study.recording import MODES, Recording
from sim_bridge.study.section import Cell, Section, Study, Table
from sim_bridge.study.solvers import GLSDC_STEPS

RUN_S = 40.0
LHM_TOL, LHM_EPSILON = 1e-5, 1e-8


@dataclass(frozen=True, slots=True)
class Count:
    """Operations of one solver over a run: in all, and the iterations that they were spent on."""

    operations: int
    calls: int
    iterations: int

    def per_call(self) -> float:
        """Return the operations of one call."""
        return self.operations / self.calls


Counts = dict[tuple[str, str, str], Count]
"""By solver, mode, and listing or kernel."""


def crf_state(T_cam_tanker: SE3) -> Vec:
    """Return the listing's X = [x y z psi theta phi] of a pose, R_crf_tanker = Rz Ry Rx."""
    return np.concatenate([xyz(T_cam_tanker.t), euler_from_rotation(R_cam_crf.T @ T_cam_tanker.R)])


def tally_glsdc_listing(points: Mat, uv: Mat, T_start: SE3, steps: int) -> Tally:
    """Count one call of the listing's GLSDC."""
    tally = Tally()
    state, seen = counted(crf_state(T_start), tally), counted(uv.ravel(), tally)
    listing.glsdc(state, seen, counted(points, tally), steps, Textbook(tally))
    return tally


def tally_glsdc_kernel(points: Mat, uv: Mat, T_start: SE3, steps: int) -> Tally:
    """Count one call of the kernel that flies."""
    tally = Tally()
    arrays = [counted(a, tally) for a in (points, uv, T_start.R, T_start.t)]
    R, t = counted(np.zeros((3, 3)), tally), counted(np.zeros(3), tally)
    source_of(glsdc_kernel.correct, tally)(*arrays, steps, ALL_ALIKE, 3, R, t)
    return tally


def tally_lhm_listing(points: Mat, uv: Mat, R_start: Mat) -> tuple[Tally, int]:
    """Count one call of the listing's LHM; return the iterations too."""
    tally = Tally()
    arrays = (counted(points, tally), counted(uv, tally), counted(R_start, tally))
    _, _, iterations = listing.lhm(*arrays, Textbook(tally), LHM_TOL, LHM_EPSILON)
    return tally, iterations


def tally_lhm_kernel(points: Mat, uv: Mat, R_start: Mat) -> tuple[Tally, int]:
    """Count one call of the kernel that flies; return the iterations too."""
    tally = Tally()
    arrays = [counted(a, tally) for a in (points, uv, R_start)]
    R, t = counted(np.zeros((3, 3)), tally), counted(np.zeros(3), tally)
    answer = source_of(lhm_kernel.solve_from, tally)(*arrays, LHM_TOL, LHM_EPSILON, METHODS["svd"], R, t)
    return tally, int(answer[1])


def count_glsdc(recording: Recording, frames: int, steps: int) -> dict[str, Count]:
    """Count a run of GLSDC: its operations depend on the number of markers alone, each of which is counted once."""
    known: dict[tuple[str, int], int] = {}
    totals = {"listing": 0, "kernel": 0}
    for k in range(frames):
        seen = np.isfinite(recording.uv[k, :, 0])
        n = int(seen.sum())
        if n < 3:
            continue
        for name, tally in (("listing", tally_glsdc_listing), ("kernel", tally_glsdc_kernel)):
            if (name, n) not in known:
                arguments = recording.markers[seen], recording.uv[k][seen], recording.T_prior[k], steps
                known[name, n] = tally(*arguments).total()
            totals[name] += known[name, n]
    return {name: Count(total, frames, frames * steps) for name, total in totals.items()}


def count_lhm(recording: Recording, frames: int, every: int) -> dict[str, Count]:
    """Count a run of LHM from its own last rotation.

    The listing's operations depend on markers and iterations alone, so each pair is counted once. The kernel's root
    finding takes more or fewer steps: every frame is counted, or one in ``every`` and scaled.
    """
    known: dict[tuple[int, int], int] = {}
    listed, listed_iterations, kernel, kernel_iterations, sampled = 0, 0, 0, 0, 0
    R = recording.T_prior[0].R
    for k in range(frames):
        seen = np.isfinite(recording.uv[k, :, 0])
        points, uv = recording.markers[seen], recording.uv[k][seen]
        _, _, iterations = listing.lhm(points, uv, R, Lapack(), LHM_TOL, LHM_EPSILON)
        if (len(points), iterations) not in known:
            known[len(points), iterations] = tally_lhm_listing(points, uv, R)[0].total()
        listed += known[len(points), iterations]
        listed_iterations += iterations
        if k % every == 0:
            tally, done = tally_lhm_kernel(points, uv, R)
            kernel, kernel_iterations, sampled = kernel + tally.total(), kernel_iterations + done, sampled + 1
        R = solve_lhm(points, uv, R).T_cam_tanker.R
    scale = frames / sampled
    return {
        "listing": Count(listed, frames, listed_iterations),
        "kernel": Count(round(kernel * scale), frames, round(kernel_iterations * scale)),
    }


def count(recording: Recording, every: int) -> dict[tuple[str, str], Count]:
    """Count both solvers, as listed and as they fly, over the first 40 s of a recording."""
    frames = recording.until(RUN_S)
    found = {("GLSDC", name): c for name, c in count_glsdc(recording, frames, GLSDC_STEPS).items()}
    found["GLSDC", "3 steps"] = count_glsdc(recording, frames, 3)["listing"]
    return found | {("LHM", name): c for name, c in count_lhm(recording, frames, every).items()}


def flops(study: Study) -> Section:
    """Count both solvers in both modes over the first 40 s."""
    every = 20 if study.quick else 1
    counts: Counts = {}
    for mode, found in zip(MODES, study.spread(count, [(study.recording(mode), every) for mode in MODES]), strict=True):
        counts |= {(solver, mode, name): c for (solver, name), c in found.items()}
    per_step = counts["GLSDC", "sv", "listing"].per_call() / GLSDC_STEPS
    steps_in_thesis = thesis_numbers.FLOPS["GLSDC", "sv"] / thesis_numbers.CALLS / per_step
    return Section(
        "7.1", "Number of floating-point operations",
        "The same source is run on numbers that count each addition, multiplication, division, root and trigonometric "
        "function. 'Listing' is the thesis' algorithm as plainly as its listing, with 21 n^3 for an SVD and 2 n^3 for "
        "an inverse (Golub and Van Loan); 'kernel' is what flies, which needs no decomposition.",
        (_totals(counts), _per_call(counts)), (), _differences(counts, per_step, steps_in_thesis),
        {"glsdc_operations_per_step": per_step, "glsdc_steps_that_explain_the_thesis": steps_in_thesis},
    )


def _totals(counts: Counts) -> Table:
    columns = ("", "GLSDC, SV", "LHM, SV", "GLSDC, RV", "LHM, RV")
    keys = [(solver, mode) for mode in MODES for solver in ("GLSDC", "LHM")]
    rows: list[tuple[Cell, ...]] = [("thesis, Matlab 5.3", *(thesis_numbers.FLOPS[key] for key in keys))]
    rows += [
        (f"ours, {name}", *(counts[*key, name].operations for key in keys)) for name in ("listing", "kernel")
    ]
    three = ["" if solver == "LHM" else counts[solver, mode, "3 steps"].operations for solver, mode in keys]
    rows.insert(2, ("ours, listing with 3 steps", *three))
    calls = counts["GLSDC", "sv", "listing"].calls
    theirs = "" if calls == thesis_numbers.CALLS else f", where it is {thesis_numbers.CALLS}"
    return Table(f"Operations in {calls} calls (Tab. 7.1{theirs})", columns, tuple(rows), (0,))


def _per_call(counts: Counts) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for solver in ("GLSDC", "LHM"):
        for mode in MODES:
            listed, kernel = counts[solver, mode, "listing"], counts[solver, mode, "kernel"]
            theirs = thesis_numbers.FLOPS[solver, mode] / thesis_numbers.CALLS
            rows.append((
                f"{solver}, {mode.upper()}", round(theirs), round(listed.per_call()), round(kernel.per_call()),
                round(listed.per_call() / kernel.per_call(), 2), round(listed.iterations / listed.calls, 2),
            ))
    columns = ("", "thesis / 401", "ours, listing", "ours, kernel", "listing / kernel", "iterations")
    return Table("Operations in one call", columns, tuple(rows))


def _differences(counts: Counts, per_step: float, steps: float) -> tuple[str, ...]:
    listed, real = counts["LHM", "sv", "listing"], counts["LHM", "rv", "listing"]
    one = listed.operations / listed.iterations
    theirs = [thesis_numbers.FLOPS["LHM", mode] / thesis_numbers.CALLS / one for mode in MODES]
    return (
        f"A step of the listing's GLSDC with nine markers is counted at {per_step:.0f}; the thesis' total in SV over "
        f"its 401 calls is {steps:.2f} such steps, so its Tab. 7.1 fits the 3 steps of its section 5.3, not the 4 of "
        "7.1.",
        f"The thesis' LHM total in SV is {theirs[0]:.1f} of our iterations a call; ours takes "
        f"{listed.iterations / listed.calls:.1f}. In RV theirs is {theirs[1]:.1f} and ours "
        f"{real.iterations / real.calls:.1f}: "
        "the noisier the picture, the further a solution is from the last one, and our centroids are less noisy.",
        "GLSDC costs the same in SV and RV here because our camera sees all nine markers in nearly every frame; the "
        "thesis' loses some, which made its RV cheaper.",
    )
