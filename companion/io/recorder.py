"""The run folder: everything that came in and went out, on disk while the flight goes on.

========================= ==========================================================================================
``events.jsonl``          one message per line: ``kind``, ``dir`` (in, out), then the message's fields; arrays as
                          lists, NaN and infinity as null, floats in full; of a picture only sequence and size, of
                          a FilterState ``x`` and ``sigma`` (its covariance would be 256 numbers 20 times a second)
``telemetry.tlog``        raw MAVLink frames, each behind its instant in us as big-endian uint64
``flight.rrd``            the same for eyes (``companion.io.rerun_log``)
``config.toml``           the effective configuration with its files: what ``load(path, Setup)`` reads back
``versions.json``         Python, packages, platform, revision
``summary.json``          the result (``companion.io.tally``, and what the driver adds)
========================= ==========================================================================================

Rules
-----
* Nothing here may stop a flight: an unusable folder is a ``ConfigError`` before it starts; a failing disk later is
  counted, what could not be written is kept up to a bound and tried again.
* Records reach the operating system at least every ``FLUSH_S`` while records come, so a killed process loses no more.
"""

from __future__ import annotations

import json
import platform
import re
import subprocess
import time
from array import array
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
import numpy as np
import tomli_w

from companion.config import ConfigError, Setup
from companion.io.rerun_log import RerunLog
from companion.io.tally import Tally
from companion.messages import CameraFrame, Event, FilterState, Output

FLUSH_S = 0.2
CHUNK_BYTES = 1 << 16
KEPT_BYTES = 8 << 20
"""What a file that cannot be written holds back before records are dropped, in bytes."""

DISTRIBUTION = "refuel-companion"

PLAIN = (np.ndarray, np.generic)
"""What has a list or a number of Python in it; a tuple, because this is asked for every array of every record."""


class Appender:
    """An append-only file with its own buffer, that outlives a full disk."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab", buffering=0)
        self._buffer = bytearray()
        self._due = time.monotonic() + FLUSH_S
        self.failures = 0
        self.dropped = 0

    def append(self, record: bytes) -> None:
        """Add one record; it is dropped and counted only when the disk has refused ``KEPT_BYTES``."""
        if len(self._buffer) > KEPT_BYTES:
            self.dropped += 1
        else:
            self._buffer += record
        if len(self._buffer) > CHUNK_BYTES or time.monotonic() > self._due:
            self.flush()

    def flush(self) -> None:
        """Hand everything to the operating system, or count that it did not take it."""
        self._due = time.monotonic() + FLUSH_S
        try:
            while self._buffer:
                written = self._file.write(self._buffer)
                del self._buffer[: written or 0]
        except OSError:
            self.failures += 1

    def close(self) -> None:
        """Flush and close; safe to call twice."""
        if not self._file.closed:
            self.flush()
            self._file.close()


def create_run_folder(out: Path | str, name: str) -> Path:
    """Create ``out/<UTC stamp>-<name>``; raises ConfigError naming the folder when that cannot be.

    A second flight within the same second gets a number behind the name.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    for suffix in ("", *(f"-{n}" for n in range(2, 100))):
        folder = Path(out) / f"{stamp}-{name}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            if Path(out).is_dir():
                continue
            msg = f"{out}: is a file; give a folder for recordings with --out"
            raise ConfigError(msg) from None
        except OSError as error:
            msg = f"{folder}: cannot be created ({error.strerror}); give a writable folder with --out"
            raise ConfigError(msg) from None
        return folder
    msg = f"{out}: a hundred recordings in one second"
    raise ConfigError(msg)


def newest_run(out: Path | str) -> Path:
    """Return the newest run folder below ``out``; raises ConfigError when there is none."""
    runs = sorted(folder.parent for folder in Path(out).glob("*/events.jsonl"))
    if not runs:
        msg = f"{out}: no recording here; fly one first (make fly)"
        raise ConfigError(msg)
    return runs[-1]


class RunRecorder:
    """``companion.ports.Recorder`` on a run folder; also a context manager.

    ``t0_ns`` is where the Rerun timeline ``sim_time`` has its zero; ``versions.json`` keeps it.
    """

    def __init__(self, folder: Path, setup: Setup, *, t0_ns: int = 0) -> None:
        self.folder = folder
        self.setup = setup
        self._encode = msgspec.json.Encoder(enc_hook=_plain).encode
        self._heads: dict[tuple[str, str], bytes] = {}
        self._latency: dict[str, array[int]] = {}
        self._tally = Tally(t0_ns)
        self._closed = False
        try:
            self._write_headers({**versions(), "t0_ns": t0_ns})
            self._events = Appender(folder / "events.jsonl")
            self._tlog = Appender(folder / "telemetry.tlog")
            self._rerun = RerunLog(folder / "flight.rrd", setup, t0_ns=t0_ns)
        except OSError as error:
            msg = f"{folder}: cannot be written ({error.strerror}); give another folder with --out"
            raise ConfigError(msg) from None

    def _write_headers(self, about: dict[str, Any]) -> None:
        (self.folder / "versions.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        with (self.folder / "config.toml").open("wb") as file:
            tomli_w.dump(msgspec.to_builtins(self.setup), file)

    def event(self, event: Event) -> None:
        """Record an input."""
        self._tally.event(event)
        if isinstance(event, CameraFrame):
            height, width = event.image.shape[:2]
            size = {"t_ns": event.t_ns, "sequence": event.sequence, "width_px": width, "height_px": height}
            self._append("CameraFrame", "in", size)
        else:
            self._append(type(event).__name__, "in", event)
        self._rerun.event(event)

    def output(self, output: Output) -> None:
        """Record an output."""
        self._tally.output(output)
        what: Any = output
        if isinstance(output, FilterState):
            what = {"t_ns": output.t_ns, "x": output.x, "sigma": output.sigma}
        self._append(type(output).__name__, "out", what)
        self._rerun.output(output)

    def mavlink(self, t_ns: int, data: bytes) -> None:
        """Record one raw MAVLink frame, in or out."""
        self._tlog.append((t_ns // 1000).to_bytes(8, "big") + data)

    def latency(self, t_ns: int, stage: str, duration_ns: int) -> None:
        """Record how long a stage took; kept out of ``events.jsonl``, which is the same for the same seed."""
        durations = self._latency.get(stage)
        if durations is None:
            durations = self._latency[stage] = array("q")
        durations.append(duration_ns)
        self._rerun.latency(t_ns, stage, duration_ns)

    def _append(self, kind: str, direction: str, message: Any) -> None:
        head = self._heads.get((kind, direction))
        if head is None:
            head = self._heads[kind, direction] = b'{"kind":"%b","dir":"%b",' % (kind.encode(), direction.encode())
        self._events.append(head + self._encode(message)[1:] + b"\n")

    def latency_ms(self) -> dict[str, dict[str, float]]:
        """Return {stage: {p50, p99, max}} in milliseconds."""
        return {stage: quantiles_ms(durations) for stage, durations in sorted(self._latency.items())}

    def figures(self) -> dict[str, Any]:
        """Return the part of ``summary.json`` that the companion itself knows."""
        config = self.setup.config
        return {
            **self._tally.figures(),
            "latency_ms": self.latency_ms(),
            "law": config.guidance.law,
            "pose_solver": config.vision.solver,
            "detector": config.vision.detector,
            "labeling": config.vision.labeling.method,
            "fusion": config.fusion.method,
            "recorder": {
                "write_failures": self._events.failures + self._tlog.failures,
                "records_dropped": self._events.dropped + self._tlog.dropped,
                "pictures_dropped": self._rerun.pictures_dropped,
                "messages_dropped": self._rerun.messages_dropped,
            },
        }

    def write_summary(self, summary: dict[str, Any]) -> dict[str, Any]:
        """Write ``summary.json`` of ``figures`` and ``summary`` (which wins), and return what was written."""
        whole = {**self.figures(), **summary}
        text = json.dumps(whole, indent=2, default=_plain) + "\n"
        part = self.folder / "summary.json.part"
        try:
            part.write_text(text, encoding="utf-8")
            part.replace(self.folder / "summary.json")
        except OSError:
            self._events.failures += 1
        return whole

    def close(self) -> None:
        """Flush and close; safe to call twice."""
        if not self._closed:
            self._closed = True
            self._events.close()
            self._tlog.close()
            self._rerun.close()

    def __enter__(self) -> RunRecorder:
        """Return the recorder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close, whatever happened."""
        self.close()


def read_records(path: Path | str) -> Iterator[dict[str, Any]]:
    """Yield the records of an ``events.jsonl``; a last line cut short by a crash is left out."""
    with Path(path).open("rb") as file:
        for line in file:
            if line.endswith(b"\n"):
                yield msgspec.json.decode(line)


def quantiles_ms(durations_ns: array[int]) -> dict[str, float]:
    """Return p50, p99 and max in ms of durations in ns."""
    ms = np.frombuffer(durations_ns, dtype=np.int64) / 1e6
    p50, p99 = np.percentile(ms, [50, 99])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(ms.max()), 4)}


def versions() -> dict[str, Any]:
    """Return Python, platform, the versions of the packages that the project names, and the revision of the source."""
    return {
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.release()} {platform.machine()}",
        "packages": _packages(),
        "revision": _revision(),
    }


def _packages() -> dict[str, str]:
    installed = {d.metadata["Name"].lower(): d.version for d in metadata.distributions()}
    required = metadata.requires(DISTRIBUTION) or [] if DISTRIBUTION in installed else []
    names = {re.split(r"[^A-Za-z0-9._-]", line)[0].lower() for line in required if "extra ==" not in line}
    return {name: installed[name] for name in sorted(names | {DISTRIBUTION}) if name in installed}


def _revision() -> str | None:
    folder = Path(__file__).resolve().parent
    git = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40", "--match="]
    try:
        answer = subprocess.run(git, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None


def _plain(value: Any) -> Any:
    if isinstance(value, PLAIN):
        return value.tolist()
    msg = f"{type(value).__name__} has no place in a record"
    raise TypeError(msg)
