"""Many flights in worker processes.

Rules
-----
* A worker is a process that starts from nothing (spawn) and flies one flight after the other. What comes of a flight
  depends on its scenario, its seed and nothing else, so neither the number of workers nor their order matters.
* A flight that kills its worker, by an error or by a signal, is a ``Crashed`` in its place; the rest goes on in a new
  worker. Its traceback is on stderr.
* Ctrl-C ends the workers at once and comes through.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from companion.config import Setup
from sim_bridge.runs.options import PROCESSES
from sim_bridge.scenario import Scenario

R = TypeVar("R")
Tell = Callable[[str], None]

END_S = 5.0


@dataclass(frozen=True, slots=True)
class Job:
    """One flight to be flown; ``label`` names it in progress and among the crashed.

    ``setup`` is what the companion believes; ``world`` what is true where that differs.
    """

    label: str
    scenario: Scenario
    setup: Setup
    world: Setup | None = None


@dataclass(frozen=True, slots=True)
class Crashed:
    """A flight that ended its worker, and what the worker ended with."""

    label: str
    why: str


@dataclass(slots=True)
class Worker(Generic[R]):
    """A process, our end of its pipe, and which job it has."""

    process: BaseProcess
    pipe: Connection
    job: int | None = None


def fly_many(
    jobs: Sequence[Job], work: Callable[[Job], R], *, processes: int = PROCESSES, tell: Tell = lambda line: None
) -> list[R | Crashed]:
    """Do ``work``, a function of a module, for each job; return what it gave in the order of the jobs.

    ``tell`` hears a line after each.
    """
    done: dict[int, R | Crashed] = {}
    left = list(range(len(jobs)))[::-1]
    workers: list[Worker[R]] = []
    try:
        workers = [_start(work) for _ in range(min(processes, len(jobs)))]
        while len(done) < len(jobs):
            for worker in workers:
                if worker.job is None and left:
                    worker.job = left.pop()
                    worker.pipe.send(jobs[worker.job])
            busy = {worker.pipe: worker for worker in workers if worker.job is not None}
            for pipe in wait(list(busy)):
                worker = busy[pipe]  # type: ignore[index]  # wait gives back what it was given
                number = _taken(worker)
                done[number] = found = _result(worker, jobs[number].label)
                if isinstance(found, Crashed):
                    workers[workers.index(worker)] = _start(work)
                tell(_progress(len(done), len(jobs), jobs[number].label, found))
    finally:
        _end(workers)
    return [done[k] for k in range(len(jobs))]


def _taken(worker: Worker[R]) -> int:
    number, worker.job = worker.job, None
    if number is None:
        msg = "an idle worker has spoken"
        raise RuntimeError(msg)
    return number


def _result(worker: Worker[R], label: str) -> R | Crashed:
    try:
        found: R = worker.pipe.recv()
    except EOFError:
        worker.pipe.close()
        worker.process.join(END_S)
        code = worker.process.exitcode
        return Crashed(label, f"signal {-code}" if code is not None and code < 0 else f"exit code {code}")
    return found


def _progress(done: int, of: int, label: str, found: object) -> str:
    text = f"{done}/{of} {label}"
    return f"{text}: crashed, {found.why}" if isinstance(found, Crashed) else text


def _start(work: Callable[[Job], R]) -> Worker[R]:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, work), daemon=True)
    process.start()
    theirs.close()  # so that the end of the process is the end of the pipe
    return Worker(process, ours)


def _end(workers: Sequence[Worker[Any]]) -> None:
    for worker in workers:
        worker.pipe.close()
        worker.process.terminate()
    for worker in workers:
        worker.process.join(END_S)


def _serve(pipe: Connection, work: Callable[[Job], R]) -> None:
    """Do the work of jobs until the pipe ends. Ctrl-C is for the parent, which ends this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    while True:
        try:
            job: Job = pipe.recv()
        except EOFError:
            return
        pipe.send(work(job))
