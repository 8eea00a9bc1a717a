"""``sim-bridge consistency``, ``accuracy`` and ``integrity``: many flights, a table, a picture."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from companion.config import ConfigError
from sim_bridge.runs import accuracy, consistency, integrity
from sim_bridge.runs.many import Crashed, fly_many
from sim_bridge.runs.plots import draw_consistency, draw_stanford
from sim_bridge.runs.record import Record


def run(a: argparse.Namespace) -> tuple[str, bool]:
    """Fly, write what ``--out`` asks for; return the table, and whether no flight crashed or went wrong.

    Bad options are a ConfigError before the flights.
    """
    for name, least in (("flights", 1), ("processes", 1), ("first_seed", 0)):
        value = getattr(a, name, least)
        if value < least:
            msg = f"--{name.replace('_', '-')} {value}: must be at least {least}"
            raise ConfigError(msg)
    out = None if a.out is None else _folder(Path(a.out))
    text, right = WORK[a.command](a, out)
    if out is not None:
        (out / f"{a.command}.md").write_text(text + "\n", encoding="utf-8")
    return text, right


def _folder(path: Path) -> Path:
    """Return a folder that can be written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        (path / ".probe").touch()
        (path / ".probe").unlink()
    except OSError as error:
        msg = f"--out {path}: {error.strerror}"
        raise ConfigError(msg) from None
    return path


def tell(line: str) -> None:
    """Say how far it has come."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def consist(a: argparse.Namespace, out: Path | None) -> tuple[str, bool]:
    """Fly for consistency; return the tables."""
    jobs = consistency.jobs(a.flights, a.turbulence, a.fusion, a.first_seed)
    found = fly_many(jobs, consistency.observe, processes=a.processes, tell=tell)
    groups: dict[str, list[Record]] = {}
    for record in found:
        if isinstance(record, Record):
            groups.setdefault(f"from {record.label.partition(' ')[0]}", []).append(record)
    if groups and out is not None:
        draw_consistency(groups, out / "consistency.png")
    parts = [f"Flights {label}:\n\n{consistency.tables(records)}" for label, records in groups.items()]
    crashed = _crashed(found)
    return "\n\n".join([*parts, *crashed]), not crashed


def measure(a: argparse.Namespace, out: Path | None) -> tuple[str, bool]:
    """Fly for accuracy; return the table."""
    del out  # a table, no picture
    return accuracy.measure(accuracy.cases(a.quick, a.first_seed), processes=a.processes, tell=tell), True


def trust(a: argparse.Namespace, out: Path | None) -> tuple[str, bool]:
    """Fly for integrity; return the table, and whether nothing in it is worth a look."""
    jobs = [integrity.draw(a.first_seed + k) for k in range(a.flights)]
    found = fly_many(jobs, integrity.observe, processes=a.processes, tell=tell)
    judged = [o.judged for o in found if not isinstance(o, Crashed)]
    if judged and out is not None:
        draw_stanford(judged, jobs[0].setup.tanker.window.desired_m, out / "integrity.png")
    return integrity.table(found), not integrity.worth_a_look(found)


def _crashed(found: list[Any]) -> list[str]:
    return [f"{c.label}: crashed, {c.why}" for c in found if isinstance(c, Crashed)]


WORK = {"consistency": consist, "accuracy": measure, "integrity": trust}
