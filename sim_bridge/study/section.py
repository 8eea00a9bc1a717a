"""What a part of the study hands over: sentences, tables, pictures, and what it was given to work on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_bridge.study.recording import Mode, Recording

Cell = float | int | str


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a head. ``thesis`` are the rows (by number) that the thesis printed, to set them off."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    thesis: tuple[int, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"title": self.title, "columns": self.columns, "rows": self.rows, "thesis_rows": self.thesis}


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the report's folder, and what it shows."""

    file: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the report. ``differences`` say where ours differ from the thesis, and why."""

    number: str
    title: str
    method: str
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...] = ()
    differences: tuple[str, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)

    def as_data(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "title": f"{self.number} {self.title}",
            "tables": [table.as_data() for table in self.tables],
            "differences": self.differences,
            **self.numbers,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """What every part is given: the two flights, the seed, where pictures go, and a second processor."""

    sv: Recording
    rv: Recording
    seed: int
    quick: bool
    pictures: Path
    executor: Executor | None = None

    def recording(self, mode: Mode) -> Recording:
        """Return the flight with simulated or real vision."""
        return self.sv if mode == "sv" else self.rv

    def spread(self, work: Callable[..., Any], items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Call ``work`` with each of the items, over all processors, and yield the results in order."""
        if self.executor is None:
            return (work(*item) for item in items)
        futures = [self.executor.submit(work, *item) for item in items]
        return (future.result() for future in futures)
