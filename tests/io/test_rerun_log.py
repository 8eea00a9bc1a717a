"""flight.rrd read back without a viewer: what is drawn is what was flown."""

import resource
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader
from synthetic_flight import ALERT_M, HEADING, Flight, messages, phase_at, record, synthetic_setup, truths

from companion.config import ConfigError
from companion.geometry import rotation_from_euler, rotation_from_quaternion
from companion.io.rerun_log import QUEUED_PICTURES, RerunLog, scene_poses
from companion.io.rerun_view import open_viewer, recordings
from companion.messages import CameraFrame, FilterState, FilterUpdate, FusedPose, Integrity, RelativeState
from companion.vision.camera import T_frd_cam
from sim_bridge.truth_log import TruthLog

SECONDS = 6.0
Columns = dict[str, dict[str, list[Any]]]


def read(path: Path) -> Columns:
    """Return {entity: {column: values}} of what changes with time, in the order of sim_time."""
    table: Columns = defaultdict(lambda: defaultdict(list))
    chunks = [c for c in RrdReader(path).stream().to_chunks() if "sim_time" in c.timeline_names]
    batches = [(c.to_record_batch(), str(c.entity_path)) for c in chunks]
    for batch, entity in sorted(batches, key=lambda b: b[0].column("sim_time")[0].as_py()):
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            table[entity][name.rsplit(":", 1)[-1]] += column.to_pylist()
    return table


def seconds(entity: dict[str, list[Any]]) -> list[float]:
    return [t.total_seconds() for t in entity["sim_time"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("20260101T000000Z-synthetic")
    setup = synthetic_setup()
    log = RerunLog(folder / "flight.rrd", setup)
    with TruthLog(folder, setup) as truth_log:
        record(log, setup, SECONDS)
        for truth, br in truths(setup, SECONDS):
            truth_log.append(truth, br)
    log.close()
    log.close()
    truth_log.close()
    return folder


@pytest.fixture(scope="module")
def drawn(folder: Path) -> Columns:
    return read(folder / "flight.rrd")


def test_br_is_drawn_at_full_rate_and_in_full(drawn: Columns) -> None:
    states = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, RelativeState)]
    for k, axis in enumerate("xyz"):
        line = drawn[f"/plots/br/{axis}/estimate"]
        np.testing.assert_array_equal(np.ravel(line["scalars"]), [s.p_mrf_br_m[k] for s in states])
        np.testing.assert_allclose(seconds(line), [s.t_ns / 1e9 for s in states], atol=1e-6)


def test_the_window_is_drawn_from_the_first_to_the_last_instant(drawn: Columns) -> None:
    window = synthetic_setup().tanker.window
    for k, axis in enumerate("xyz"):
        for name, half in (("desired", window.desired_m[k]), ("limit", window.limit_m[k])):
            line = drawn[f"/plots/br/{axis}/{name}"]
            assert all(pair == [half, -half] for pair in line["scalars"])
            assert (min(seconds(line)), max(seconds(line))) == pytest.approx((0.0, SECONDS - 0.02))


def test_a_switch_of_the_vision_is_in_the_log(drawn: Columns) -> None:
    assert (drawn["/log/vision"]["text"], seconds(drawn["/log/vision"])) == ([["vision sv"]], [0.5])


def test_the_receiver_is_drawn_where_it_is_from_the_tanker(drawn: Columns) -> None:
    flight = Flight(synthetic_setup())
    R_mrf_ned = rotation_from_euler(HEADING, 0.0, 0.0).T
    uav = drawn["/world/uav"]
    for t, position, quaternion in zip(seconds(uav), uav["translation"], uav["quaternion"], strict=True):
        truth = flight.uav(t)
        np.testing.assert_allclose(position[0], R_mrf_ned @ (truth.t - flight.tanker(t).t), atol=1e-4)
        x, y, z, w = quaternion[0]
        np.testing.assert_allclose(rotation_from_quaternion(np.array([w, x, y, z])), R_mrf_ned @ truth.R, atol=1e-5)


def test_the_scene_keeps_the_tanker_upright_whatever_the_heading() -> None:
    setup = synthetic_setup()
    flight, camera = Flight(setup), T_frd_cam(setup.camera)
    states = [m for _, m in messages(setup, 1.0, pictures=False) if isinstance(m, RelativeState)]
    _, R_mrf_tanker, _ = scene_poses(states, camera.R, camera.t)
    R_mrf_ned = rotation_from_euler(HEADING, 0.0, 0.0).T
    for state, R in zip(states, R_mrf_tanker, strict=True):
        np.testing.assert_allclose(R, R_mrf_ned @ flight.tanker(state.t_ns / 1e9).R, atol=1e-9)


def test_pictures_are_thinned_and_points_belong_to_them(drawn: Columns) -> None:
    image = drawn["/world/uav/camera/image"]
    assert np.diff(seconds(image)) == pytest.approx([0.2] * (len(image["frame"]) - 1))
    detected = drawn["/world/uav/camera/image/detected"]
    assert detected["frame"] == image["frame"]
    jpeg = np.frombuffer(bytes(image["blob"][0][0]), dtype=np.uint8)
    picture = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    blue, _, red = picture[0, 0].astype(int)
    assert picture.shape == (480, 640, 3)
    assert blue > red + 50  # the sky: colours are not swapped on their way
    flight = Flight(synthetic_setup())
    uv, marker = flight.seen(0.0)
    np.testing.assert_allclose(detected["centers"][0], uv + 0.5, atol=1e-4)
    ids = [str(flight.setup.tanker.markers[k].id) for k in marker]
    assert detected["labels"][0] == ids


def test_fusion_and_setpoints_are_drawn(drawn: Columns) -> None:
    fused = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, FusedPose)]
    weights = drawn["/plots/fusion/vision_weight"]["scalars"]
    assert np.ravel(weights).tolist() == [f.vision_weight for f in fused]
    assert np.ravel(drawn["/plots/fusion/markers"]["scalars"]).tolist() == [f.markers_used for f in fused]
    assert len(drawn["/plots/setpoint/pitch_deg"]["scalars"]) == round(SECONDS * 50)


def test_phases_and_rejects_are_told(drawn: Columns) -> None:
    band = drawn["/phase"]
    flown = ["standby", "self_test", "join", "observation", "pre_contact", "approach"]
    assert list(np.ravel(band["state"])) == flown
    assert [phase_at(t).value for t in seconds(band)] == flown
    assert "pre_contact -> approach: by the clock" in np.ravel(drawn["/log/phase"]["text"])
    rejects = drawn["/log/rejects"]
    assert list(np.ravel(rejects["text"])) == 2 * ["datalink: checksum frame of 55 bytes"]
    assert list(np.ravel(rejects["level"])) == ["WARN", "WARN"]


def test_trust_is_drawn_thinned_and_its_changes_in_full(drawn: Columns) -> None:
    told = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, Integrity)]
    states = drawn["/trust"]
    assert list(np.ravel(states["state"])) == ["test fails", "beyond alert"]  # nothing is seen at t = 0
    assert seconds(states) == pytest.approx([0.0, 0.02])
    for k, axis in enumerate("xyz"):
        line = drawn[f"/plots/trust/{axis}/protection"]
        due = [t for t in told if np.isfinite(t.protection_mrf_m).all()][::10]
        assert 0.0 < seconds(line)[0] <= 0.2
        assert np.diff(seconds(line)) == pytest.approx(0.2)
        assert set(np.ravel(line["scalars"])) <= {t.protection_mrf_m[k] for t in told}
        assert len(line["scalars"]) == pytest.approx(len(due), abs=1)
        assert {v[0] for v in drawn[f"/plots/trust/{axis}/alert"]["scalars"]} == {ALERT_M[k]}
    assert list(np.ravel(drawn["/log/trust"]["text"])) == ["integrity: unseen", "integrity: no test fails"]


def test_a_test_that_flickers_is_told_once_a_second(tmp_path: Path) -> None:
    log = RerunLog(tmp_path / "flight.rrd", synthetic_setup())
    for k in range(100):
        faults = ("residual",) if k % 2 else ()
        log.output(Integrity(k * 20_000_000, ALERT_M / 2, ALERT_M, may_dock=not faults, faults=faults))
    log.close()
    drawn = read(tmp_path / "flight.rrd")
    assert len(drawn["/trust"]["state"]) == 100
    told = np.ravel(drawn["/log/trust"]["text"]).tolist()
    assert sorted(told) == 2 * ["integrity: no test fails"] + 2 * ["integrity: residual"]


def test_the_filter_is_drawn_in_the_units_of_its_plots(drawn: Columns) -> None:
    states = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, FilterState)]
    every = {round(m.t_ns / 1e9, 6): m for m in states}
    for plot, names, first, unit in (
        ("gps_bias", ("north", "east", "down"), 9, 1.0), ("boresight", ("pitch", "yaw", "roll"), 12, 1e3),
        ("lag", ("datalink",), 15, 1e3),
    ):
        for k, name in enumerate(names):
            line, band = drawn[f"/plots/filter/{plot}/{name}"], drawn[f"/plots/filter/{plot}/{name}_sigma"]
            shown = [every[round(t, 6)] for t in seconds(line)]
            assert len(shown) == pytest.approx(SECONDS / 0.2, abs=1)
            np.testing.assert_allclose(np.ravel(line["scalars"]), [unit * m.x[first + k] for m in shown])
            for (low, high), m in zip(band["scalars"], shown, strict=True):
                assert high - low == pytest.approx(2 * unit * m.sigma[first + k])


def test_every_update_is_a_point_of_its_source_or_a_rejected_one(drawn: Columns) -> None:
    updates = [m for _, m in messages(synthetic_setup(), SECONDS, pictures=False) if isinstance(m, FilterUpdate)]
    for name in ("gps", "pixels", "rejected"):
        mine = [m.nis / m.dof for m in updates if ("rejected" if m.reason else m.source) == name]
        assert len(mine) >= 3
        assert np.ravel(drawn[f"/plots/nis/{name}"]["scalars"]).tolist() == mine


def test_stages_are_bands_and_what_fails_is_in_the_log(drawn: Columns) -> None:
    bands = {name: list(np.ravel(drawn[f"/health/{name}"]["state"])) for name in ("camera", "datalink", "gps")}
    assert bands == {"camera": ["not used", "well"], "datalink": ["well", "ill", "well"], "gps": ["absent", "not used"]}
    log = drawn["/log/health"]
    assert list(np.ravel(log["text"])) == ["datalink fails: stale for 0.5 s", "datalink is well again"]
    assert list(np.ravel(log["level"])) == ["WARN", "INFO"]
    assert seconds(log) == pytest.approx([3.0, 5.0])
    assert np.ravel(drawn["/plots/inputs/camera"]["scalars"]) == pytest.approx([21.0] * 6)


def test_both_files_of_a_run_are_one_recording(folder: Path) -> None:
    ids = {(e.application_id, e.recording_id) for f in recordings(folder) for e in RrdReader(f).recordings()}
    assert ids == {("refuel-companion", folder.name)}


def test_truth_is_drawn_and_kept(folder: Path) -> None:
    rows = list(truths(synthetic_setup(), SECONDS))
    drawn = read(folder / "truth.rrd")
    saved = np.load(folder / "truth.npz")
    np.testing.assert_array_equal(saved["t_ns"], [t.t_ns for t, _ in rows])
    np.testing.assert_array_equal(saved["p_mrf_br_m"], [br for _, br in rows])
    np.testing.assert_array_equal(saved["R_ned_tanker"], [t.tanker.R_ned_body for t, _ in rows])
    np.testing.assert_array_equal(np.ravel(drawn["/plots/br/z/truth"]["scalars"]), saved["p_mrf_br_m"][:, 2])
    assert len(drawn["/world/truth/uav"]["translation"]) == len(rows)


def test_no_truth_is_left_out_when_the_wall_clock_is_uneven(tmp_path: Path) -> None:
    setup = synthetic_setup()
    (truth, br), *_ = truths(setup, 0.02)
    stamps = [k * 20_000_000 + (-1) ** k * 10_000 for k in range(51)]  # 19.98 and 20.02 ms apart
    with TruthLog(tmp_path, setup) as log:
        for t_ns in stamps:
            log.append(msgspec.structs.replace(truth, t_ns=t_ns), br)
    kept, series = log.series()
    assert kept.tolist() == stamps
    assert series.shape == (51, 3)


def test_no_pictures_when_none_are_asked_for(tmp_path: Path) -> None:
    setup = synthetic_setup()
    quiet = msgspec.structs.replace(setup.config.recorder, image_rate_hz=0.0)
    setup = msgspec.structs.replace(setup, config=msgspec.structs.replace(setup.config, recorder=quiet))
    log = RerunLog(tmp_path / "flight.rrd", setup)
    record(log, setup, 0.3)
    log.close()
    drawn = read(tmp_path / "flight.rrd")
    assert "/world/uav/camera/image" not in drawn
    assert "/plots/range" in drawn


def test_time_starts_at_the_zero_that_is_given(tmp_path: Path) -> None:
    log = RerunLog(tmp_path / "flight.rrd", synthetic_setup(), t0_ns=-5_000_000_000)
    record(log, synthetic_setup(), 0.1)
    log.close()
    assert seconds(read(tmp_path / "flight.rrd")["/plots/range"])[0] == 5.0


def test_a_queue_that_is_full_drops_pictures_and_says_so(tmp_path: Path) -> None:
    log = RerunLog(tmp_path / "flight.rrd", synthetic_setup())
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    for k in range(2 * QUEUED_PICTURES):
        log.event(CameraFrame(k * 1_000_000_000, k, image))
    log.close()
    drawn = read(tmp_path / "flight.rrd")["/world/uav/camera/image"]["frame"]
    assert log.pictures_dropped > 0
    assert log.pictures_dropped + len(drawn) == 2 * QUEUED_PICTURES
    assert drawn[:QUEUED_PICTURES] == list(range(QUEUED_PICTURES))


def test_a_disk_that_fills_up_costs_the_end_of_the_recording_only(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    log = RerunLog(tmp_path / "flight.rrd", synthetic_setup())
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, hard))
        record(log, synthetic_setup(), 6.0)
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "flight.rrd").stat().st_size == 250_000


def test_a_disk_that_is_full_from_the_start_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "flight.rrd").symlink_to("/dev/full")
    with pytest.raises(ConfigError, match=r"cannot be written \(.*No space left on device.*--out"):
        RerunLog(tmp_path / "flight.rrd", synthetic_setup())


def test_bad_folders_and_no_display_are_one_clear_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=r"cannot be written .*--out"):
        RerunLog(tmp_path / "missing" / "flight.rrd", synthetic_setup())
    with pytest.raises(ConfigError, match="neither flight"):
        open_viewer(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ConfigError, match=r"no display .*rerun --bind 127.0.0.1 --web-viewer .*flight.rrd"):
        open_viewer(folder)
