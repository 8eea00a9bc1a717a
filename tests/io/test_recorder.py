"""The run folder: what goes in comes back, whatever happens to the process or the disk."""

import json
import resource
import struct
import subprocess
import sys
import time
from array import array
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega
from synthetic_flight import PHASES, health, integrity, messages, record, synthetic_setup

from companion.config import ConfigError, Setup, load
from companion.io.recorder import (
    KEPT_BYTES,
    Appender,
    RunRecorder,
    create_run_folder,
    newest_run,
    quantiles_ms,
    read_records,
)
from companion.messages import (
    CameraFrame,
    Detections,
    FilterState,
    OwnPosition,
    Phase,
    PhaseChange,
    RelativeState,
    Tick,
    VisionOutput,
)

SECONDS = 4.0
LAST_NS = 3_000_000_000
"""When health was last told."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = create_run_folder(tmp_path_factory.mktemp("runs"), "synthetic")
    with RunRecorder(folder, synthetic_setup()) as recorder:
        record(recorder, synthetic_setup(), SECONDS)
        recorder.latency(0, "vision", 2_000_000)
        summary = recorder.write_summary({"docked": np.bool_(True), "br_mean_m": np.array([0.1, 0.2, 0.3])})
    return folder, summary


def test_every_message_is_one_line_in_order(flown: tuple[Path, dict]) -> None:
    given_messages = [(d, type(m).__name__, m.t_ns) for d, m in messages(synthetic_setup(), SECONDS)]
    written = [(r["dir"], r["kind"], r["t_ns"]) for r in read_records(flown[0] / "events.jsonl")]
    assert written == given_messages


def test_numbers_come_back_bit_for_bit(flown: tuple[Path, dict]) -> None:
    states = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, RelativeState)]
    rows = [r for r in read_records(flown[0] / "events.jsonl") if r["kind"] == "RelativeState"]
    for state, row in zip(states, rows, strict=True):
        np.testing.assert_array_equal(row["p_mrf_br_m"], state.p_mrf_br_m)
        np.testing.assert_array_equal(row["T_cam_tanker"]["R"], state.T_cam_tanker.R)
        assert row["range_m"] == state.range_m


def test_pictures_stay_out_and_unseen_markers_are_null(flown: tuple[Path, dict]) -> None:
    rows = list(read_records(flown[0] / "events.jsonl"))
    frame = next(r for r in rows if r["kind"] == "CameraFrame")
    assert frame == {"kind": "CameraFrame", "dir": "in", "t_ns": 0, "sequence": 0, "width_px": 640, "height_px": 480}
    nothing = Detections(1, np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.uint8))
    vision = VisionOutput(1, 0, nothing, np.array([[1.5, np.nan]]), np.array([-1]), None, None)
    folder = flown[0] / "again"
    folder.mkdir()
    with RunRecorder(folder, synthetic_setup()) as recorder:
        recorder.output(vision)
    assert next(read_records(folder / "events.jsonl"))["predicted_uv_px"] == [[1.5, None]]


def test_a_filter_state_is_kept_without_its_covariance(flown: tuple[Path, dict]) -> None:
    states = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, FilterState)]
    rows = [r for r in read_records(flown[0] / "events.jsonl") if r["kind"] == "FilterState"]
    for state, row in zip(states, rows, strict=True):
        assert set(row) == {"kind", "dir", "t_ns", "x", "sigma"}
        np.testing.assert_array_equal(row["x"], state.x)
        np.testing.assert_array_equal(row["sigma"], state.sigma)


def test_what_nothing_bounds_is_null(flown: tuple[Path, dict]) -> None:
    rows = [r for r in read_records(flown[0] / "events.jsonl") if r["kind"] == "Integrity"]
    assert rows[0]["protection_mrf_m"] == [None] * 3
    assert rows[0]["faults"] == ["unseen"]


def test_the_configuration_flown_can_be_loaded_again(flown: tuple[Path, dict]) -> None:
    assert load(flown[0] / "config.toml", Setup) == synthetic_setup()


def test_versions_name_what_flew(flown: tuple[Path, dict]) -> None:
    about = json.loads((flown[0] / "versions.json").read_text())
    assert about["python"] == ".".join(map(str, sys.version_info[:3]))
    assert about["packages"]["numpy"] == np.__version__
    assert about["packages"]["msgspec"] == msgspec.__version__
    assert str(Path.home()) not in json.dumps(about)


def test_closing_twice_is_closing_once(tmp_path: Path) -> None:
    recorder = RunRecorder(tmp_path, synthetic_setup())
    recorder.event(Tick(7))
    recorder.close()
    recorder.close()
    assert len(list(read_records(tmp_path / "events.jsonl"))) == 1


def test_summary_counts_what_happened(flown: tuple[Path, dict]) -> None:
    folder, summary = flown
    assert json.loads((folder / "summary.json").read_text()) == summary | {"docked": True, "br_mean_m": [0.1, 0.2, 0.3]}
    kinds = Counter(type(m) for _, m in messages(synthetic_setup(), SECONDS))
    assert summary["frames"] == kinds[CameraFrame] == 80
    assert summary["frames_with_pose"] == 79
    assert summary["rejects"] == {"datalink.checksum": 2, "vision.too_few_markers": 1}
    assert summary["latency_ms"] == {"vision": {"p50": 2.0, "p99": 2.0, "max": 2.0}}
    assert (summary["pose_solver"], summary["law"], summary["fusion"]) == ("lhm", "attitude", "filter")
    assert not any(summary["recorder"].values())


def test_summary_tells_phases_health_updates_and_latencies(flown: tuple[Path, dict]) -> None:
    summary = json.loads((flown[0] / "summary.json").read_text())
    assert summary["phases"] == [[t_s, p.value, "by the clock"] for t_s, p in PHASES if t_s < SECONDS]
    assert summary["health"] == {
        s.name: {k: getattr(s, k) for k in ("present", "enabled", "healthy", "detail")} for s in health(LAST_NS).stages
    }
    assert summary["filter"] == {
        "gps": {"accepted": 98, "rejected": {"gate": 2}, "accepted_fraction": 0.98},
        "pixels": {"accepted": 80, "rejected": {}, "accepted_fraction": 1.0},
    }
    assert set(summary["input_latency"]) == {"attitude", "camera", "datalink"}
    assert summary["input_latency"]["camera"]["cost_m"] == pytest.approx(206.0 * 0.021)
    assert summary["integrity"] is None  # no hold yet, and never "may dock"


def test_trust_is_told_of_the_hold_alone(tmp_path: Path) -> None:
    told = [integrity(round(k * 1e9)) for k in (0, 6.5, 20, 21, 22, 6.6)]
    with RunRecorder(tmp_path, synthetic_setup(), t0_ns=1_000_000_000) as recorder:
        for n, message in enumerate(told):
            if n == 3:
                recorder.output(PhaseChange(message.t_ns, Phase.CONTACT, Phase.HOLD, "inside"))
            recorder.output(message)
        figures = recorder.write_summary({})["integrity"]
    hold = told[3:]
    assert figures == {
        "may_dock_s": 19.0,
        "may_dock_fraction": pytest.approx(2 / 3),
        "protection_max_m": np.max([m.protection_mrf_m for m in hold], axis=0).tolist(),
        "alert_m": hold[0].alert_mrf_m.tolist(),
        "faults": {"gps_vision": pytest.approx(1 / 3)},
    }


def test_no_bound_in_the_hold_is_no_number(tmp_path: Path) -> None:
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        recorder.output(PhaseChange(0, Phase.CONTACT, Phase.HOLD, "inside"))
        for message in (integrity(20_000_000_000), integrity(0), integrity(21_000_000_000)):
            recorder.output(message)
        recorder.write_summary({})
    figures = json.loads((tmp_path / "summary.json").read_text())["integrity"]
    assert figures["protection_max_m"] == [None] * 3
    assert figures["faults"] == {"unseen": pytest.approx(1 / 3)}


def test_same_messages_same_bytes(flown: tuple[Path, dict], tmp_path: Path) -> None:
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        record(recorder, synthetic_setup(), SECONDS)
        recorder.latency(0, "vision", time.perf_counter_ns())
    assert (tmp_path / "events.jsonl").read_bytes() == (flown[0] / "events.jsonl").read_bytes()


def test_tlog_is_instant_and_frame(tmp_path: Path) -> None:
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=191)
    frames = [link.heartbeat_encode(18, 8, 0, 0, 3).pack(link) for _ in range(3)]
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        for k, frame in enumerate(frames):
            recorder.mavlink(k * 1_000_000_999, frame)
    data = (tmp_path / "telemetry.tlog").read_bytes()
    reader = ardupilotmega.MAVLink(None)
    for k, frame in enumerate(frames):
        (t_us,) = struct.unpack(">Q", data[:8])
        assert t_us == k * 1_000_000_999 // 1000
        assert reader.parse_char(data[8 : 8 + len(frame)]).get_type() == "HEARTBEAT"
        data = data[8 + len(frame) :]
    assert not data


def test_an_exception_loses_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with RunRecorder(tmp_path, synthetic_setup()) as recorder:
            recorder.event(Tick(7))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [r["t_ns"] for r in read_records(tmp_path / "events.jsonl")] == [7]


KILLED = """
import sys, time
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from synthetic_flight import synthetic_setup
from companion.io.recorder import FLUSH_S, RunRecorder
from companion.messages import Tick
recorder = RunRecorder(Path(sys.argv[1]), synthetic_setup())
for t_ns in range(100):
    recorder.event(Tick(t_ns))
time.sleep(1.5 * FLUSH_S)
recorder.event(Tick(100))
print("ready", flush=True)
time.sleep(60)
"""


def test_a_killed_process_keeps_what_is_older_than_the_flush(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.kill()
    assert [r["t_ns"] for r in read_records(tmp_path / "events.jsonl")] == list(range(101))


def test_a_line_cut_short_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_bytes(b'{"kind":"Tick","t_ns":1}\n{"kind":"Ti')
    assert list(read_records(tmp_path / "events.jsonl")) == [{"kind": "Tick", "t_ns": 1}]


def test_a_disk_that_is_full_for_a_while_loses_nothing(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    file = Appender(tmp_path / "log")
    records = [b"%06d\n" % k for k in range(2000)]
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4099, hard))
        for line in records[:1500]:
            file.append(line)
        file.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert file.failures > 0
    assert (tmp_path / "log").stat().st_size == 4099
    for line in records[1500:]:
        file.append(line)
    file.close()
    assert (tmp_path / "log").read_bytes() == b"".join(records)
    assert file.dropped == 0


def test_a_disk_that_stays_full_costs_records_not_memory_and_not_the_flight() -> None:
    file = Appender(Path("/dev/full"))
    for _ in range(3 * KEPT_BYTES // 100_000):
        file.append(bytes(100_000))
    file.close()
    assert file.failures > 0
    assert file.dropped > KEPT_BYTES // 100_000


def test_a_flight_goes_on_when_no_file_can_be_written(tmp_path: Path) -> None:
    for name in ("events.jsonl", "telemetry.tlog", "summary.json.part"):
        (tmp_path / name).symlink_to("/dev/full")
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        record(recorder, synthetic_setup(), 0.5)
    assert recorder.write_summary({})["recorder"]["write_failures"] > 0
    assert not (tmp_path / "summary.json").exists()


def test_what_the_log_for_eyes_had_to_leave_out_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.io.rerun_log.QUEUE_LENGTH", 0)
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        for k in range(3):
            recorder.latency(k, "vision", 1)
    assert recorder.write_summary({})["recorder"]["messages_dropped"] == 3


def test_an_unusable_folder_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ConfigError, match=r"^.*file.*--out$"):
            create_run_folder(out, "x")
    with pytest.raises(ConfigError, match=r"missing: cannot be written .*--out$"):
        RunRecorder(tmp_path / "missing", synthetic_setup())


def test_runs_of_one_second_do_not_meet_and_the_newest_is_found(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no recording here"):
        newest_run(tmp_path)
    folders = [create_run_folder(tmp_path, "docking") for _ in range(3)]
    assert len(set(folders)) == 3
    for folder in folders:
        (folder / "events.jsonl").touch()
    assert newest_run(tmp_path) == folders[-1]


@given(st.lists(st.integers(0, 10**10), min_size=1))
def test_quantiles_are_ordered_and_in_range(durations: list[int]) -> None:
    q = quantiles_ms(array("q", durations))
    assert min(durations) / 1e6 - 1e-4 <= q["p50"] <= q["p99"] <= q["max"]
    assert q["max"] == pytest.approx(max(durations) / 1e6, abs=1e-4)


@pytest.mark.bench
def test_cost_of_a_record(tmp_path: Path) -> None:
    flight = list(messages(synthetic_setup(), 20.0))
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        start, cpu = time.perf_counter(), time.process_time()
        for direction, message in flight:
            (recorder.event if direction == "in" else recorder.output)(message)  # type: ignore[arg-type]
        each_us = 1e6 * (time.perf_counter() - start) / len(flight)
    share = (time.process_time() - cpu) / 20.0
    print(f"recorder: {each_us:.1f} us per record, {100 * share:.1f} % of a core in real time")


def test_own_position_survives_the_round_trip(tmp_path: Path) -> None:
    position = OwnPosition(5, np.array([1 / 3, -1e-300, 1e300]), np.array([206.0, 0.0, -0.0]))
    with RunRecorder(tmp_path, synthetic_setup()) as recorder:
        recorder.event(position)
    (row,) = read_records(tmp_path / "events.jsonl")
    np.testing.assert_array_equal(row["p_ned_m"], position.p_ned_m)
