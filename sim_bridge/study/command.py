"""``sim-bridge study``: fly, run the parts, write the report."""

from __future__ import annotations

import multiprocessing
import os
import platform
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from companion.config import ConfigError
from sim_bridge.study import report
from sim_bridge.study.accuracy import accuracy, delay
from sim_bridge.study.convergence import convergence
from sim_bridge.study.flops import flops
from sim_bridge.study.label_swap import label_swap
from sim_bridge.study.noise import after_labeling, before_labeling
from sim_bridge.study.propagation import propagation
from sim_bridge.study.recording import DURATION_S, MODES, Recording, record
from sim_bridge.study.section import Section, Study
from sim_bridge.study.timing import timing

PARTS: dict[str, Callable[[Study], Section]] = {
    "flops": flops,
    "timing": timing,
    "delay": delay,
    "accuracy": accuracy,
    "noise": after_labeling,
    "swap": label_swap,
    "labeling": before_labeling,
    "convergence": convergence,
    "propagation": propagation,
}
"""Parts by the name that ``--only`` takes, in the order of the thesis."""


QUICK_S = 24.0
"""Length of a quick study's flights: past the swap of 7.5.2."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line asks for; no ``only`` means all parts, no ``out`` a new folder in runs/."""

    seed: int = 1
    out: str | None = None
    quick: bool = False
    only: str | None = None


def chosen(only: str | None) -> list[str]:
    """Return the parts to run; raises ConfigError naming them all when one is unknown."""
    if only is None:
        return list(PARTS)
    names = [name.strip() for name in only.split(",")]
    for name in names:
        if name not in PARTS:
            msg = f"--only {name or only!r}: no such part; there are {', '.join(PARTS)}"
            raise ConfigError(msg)
    return [name for name in PARTS if name in names]


def folder_for(out: str | None) -> Path:
    """Make and return the report's folder; raises ConfigError when that cannot be."""
    folder = Path(out) if out is not None else Path("runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-study"
    try:
        (folder / "pictures").mkdir(parents=True, exist_ok=True)
        (folder / "numbers.json").touch()
    except OSError as error:
        msg = f"--out {folder}: cannot be written ({error.strerror}); give a folder that can"
        raise ConfigError(msg) from None
    return folder


def processors() -> int:
    """Return how many processors may be used."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fly(seed: int, duration_s: float, executor: Executor | None) -> tuple[Recording, Recording]:
    """Fly once with simulated and once with real vision; side by side when there is a second processor."""
    if executor is None:
        return record("sv", seed, duration_s), record("rv", seed, duration_s)
    sv, rv = (executor.submit(record, mode, seed, duration_s) for mode in MODES)
    return sv.result(), rv.result()


def study(options: Options, workers: int | None = None) -> Path:
    """Run the study and return the report. Raises ConfigError for bad input before anything is flown."""
    if options.seed < 0:
        msg = f"--seed {options.seed}: must not be negative"
        raise ConfigError(msg)
    names, folder = chosen(options.only), folder_for(options.out)
    start = time.monotonic()
    count = processors() if workers is None else workers
    # Not forked: numba and OpenCV have threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context) if count > 1 else nullcontext() as executor:
        sections = run_parts(names, options, folder, executor)
    seconds = time.monotonic() - start
    return report.write(folder, sections, about(options, seconds, count))


def run_parts(names: Sequence[str], options: Options, folder: Path, executor: Executor | None) -> list[Section]:
    """Fly and run the parts, saying in a terminal what is going on."""
    console = Console(stderr=True)
    sections = []
    with console.status("flying: simulated and real vision") if console.is_terminal else nullcontext() as status:
        sv, rv = fly(options.seed, QUICK_S if options.quick else DURATION_S, executor)
        material = Study(sv, rv, options.seed, options.quick, folder / "pictures", executor)
        for i, name in enumerate(names):
            if status is not None:
                status.update(f"part {i + 1} of {len(names)}: {name}")
            sections.append(PARTS[name](material))
    return sections


def about(options: Options, seconds: float, workers: int) -> list[tuple[str, str]]:
    """Return what the report says of itself."""
    command = f"sim-bridge study --seed {options.seed}" + (" --quick" if options.quick else "")
    facts = [
        ("command", command + (f" --only {options.only}" if options.only else "")),
        ("flights", "scenario thesis (320x200, 10 Hz), one with simulated and one with real vision; time counts from "
         "the start of the approach"),
        ("took", f"{seconds:.0f} s with {workers} processes, Python {platform.python_version()}"),
    ]
    if options.quick:
        facts.append(("quick", f"{QUICK_S:.0f} s of flight where the thesis has 40 or 50, few seeds, coarse scans"))
    return facts
