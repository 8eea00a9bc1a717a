"""Faults as parts of a scenario: written, refused, and what each does to a stream of samples."""

import math
import re
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import ConfigError
from companion.io.datalink import FrameParser, encode_frame
from companion.io.mavlink_codec import MavlinkCodec, dialect
from companion.messages import CameraFrame, Detections, MarkerFrame, Phase, TankerState
from sim_bridge import faults as faults_module
from sim_bridge.__main__ import main
from sim_bridge.fault_cells import BREAKAWAY, EITHER, HELD, MATRIX, MORE, OBSERVATION, STANDBY
from sim_bridge.fault_crafts import DatalinkCraft, FrameCraft, GpsCraft, MavlinkCraft
from sim_bridge.fault_injection import OUT_OF_SIGHT_M, Faults
from sim_bridge.fault_streams import Tamper, Window
from sim_bridge.faults import COMMON, KINDS, Fault, parse_fault
from sim_bridge.scenario import load_scenario
from sim_bridge.sensors import GpsFix
from sim_bridge.simulation import Simulation

S = 1_000_000_000
STEP_NS = 5_000_000
SCENARIO = msgspec.structs.replace(load_scenario("thesis"), vision_input="detections")
SETUP = SCENARIO.setup()

ALL = [(target, kind) for target, kinds in KINDS.items() for kind in kinds]


def written(folder: Path, text: str) -> Path:
    file = folder / "flight.toml"
    file.write_text(f'name = "flight"\ncompanion = "{SCENARIO.companion}"\n{text}', encoding="utf-8")
    return file


# ---- how faults are written ------------------------------------------------------------------------------------------


@given(
    st.sampled_from(ALL), st.none() | st.sampled_from(list(Phase)), st.integers(0, 500), st.none() | st.integers(1, 99),
    st.none() | st.floats(1.0, 999.0).map(lambda x: round(x, 1)),
)
def test_what_a_fault_says_of_itself_is_read_back(which, phase, when, length, size):
    target, kind = which
    if KINDS[target][kind] == 0.0 or kind == "boom":
        size = None
    begin = {"from_s": float(when)} if phase is None else {"phase": phase, "after_s": float(when)}
    fault = Fault(target=target, kind=kind, for_s=length, size=size, **begin)
    assert parse_fault(str(fault)) == fault


@pytest.mark.parametrize(("text", "words"), [
    ("camera", "not like camera.off@hold+5"),
    ("camera.off@hold+5:", "not like"),
    ("camera.off @hold", "not like"),
    ("kamera.off", "no target 'kamera'; there are camera, lights"),
    ("camera.of", "camera has no kind 'of'; it has off, stuck"),
    ("camera.off@hald+5", "no phase 'hald'; there are standby"),
    ("camera.off=3", "camera.off has no size"),
    ("camera.boom=1.5", "0..1"),
    ("camera.slow=0", "one of how many"),
    ("camera.delayed=-1", "must be positive"),
    ("gps.wrong=99999", "within 10000"),
    ("camera.off@hold:0", "for_s must be in 0..3600 seconds"),
    ("camera.off@hold+4000", "0..3600 seconds"),
])
def test_a_fault_that_cannot_be_is_refused_in_one_line(text, words, capsys):
    assert main(["fly", "thesis", "--fault", text]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"sim-bridge: --fault {text}: ")
    assert words in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(("text", "words"), [
    ('[[faults]]\ntarget = "camera"\nkind = "drag"', "faults[0]: camera has no kind 'drag'"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\nphase = "hold"\nfrom_s = 3.0', "faults[0]: either phase"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\nafter_s = 3.0', "faults[0]: after_s counts from a phase"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\n[[faults]]\ntarget = "gps"\nkind = "off"\nfor_s = -1.0', "faults[1]"),
    ('[[faults]]\ntarget = "radar"\nkind = "off"', "faults[0].target"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\nphase = "holding"', "faults[0].phase"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\nsize = nan', "faults[0].size"),
    ('[[faults]]\ntarget = "gps"\nkind = "off"\nfro_s = 1.0', "unknown key 'faults[0].fro_s'"),
])
def test_a_scenario_with_a_fault_that_cannot_be_is_refused_naming_it(tmp_path, text, words):
    with pytest.raises(ConfigError) as caught:
        load_scenario(written(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scenario_has_the_faults_that_its_file_names(tmp_path):
    text = '[[faults]]\ntarget = "camera"\nkind = "off"\nphase = "hold"\nafter_s = 5.0\nfor_s = 2.0\n'
    assert load_scenario(written(tmp_path, text)).faults == (parse_fault("camera.off@hold+5:2"),)


def test_the_module_tells_of_every_kind():
    text = faults_module.__doc__
    for target, kinds in KINDS.items():
        for kind in set(kinds) - set(COMMON):
            assert re.search(rf"{target}\.[a-z_, .]*\b{kind}\b", text), f"{target}.{kind}"
    assert all(re.search(rf"^{kind} ", text, re.MULTILINE) for kind in COMMON)


def test_the_matrix_is_whole_and_its_names_are_its_own():
    names = [cell.name for cell in (*MATRIX, *MORE)]
    assert len(set(names)) == len(names)
    wanted = {f"{t}-{k}" for t in ("camera", "datalink", "gps", "attitude", "heartbeat") for k in COMMON}
    assert {cell.name for cell in MATRIX} == wanted
    assert {cell.ends for cell in (*MATRIX, *MORE)} <= {HELD, BREAKAWAY, STANDBY, EITHER, OBSERVATION}
    assert all(cell.why for cell in (*MATRIX, *MORE))
    assert all(cell.causes for cell in (*MATRIX, *MORE) if BREAKAWAY[0] in cell.ends)
    assert all(0.0 < cell.bound_s <= cell.watch_s for cell in (*MATRIX, *MORE))
    flown = [parse_fault(text) for cell in (*MATRIX, *MORE) for text in cell.faults]
    assert {(fault.target, fault.kind) for fault in flown} == set(ALL)


# ---- when they are on ------------------------------------------------------------------------------------------------


def test_a_fault_begins_with_the_first_time_of_its_phase_and_lasts_as_long_as_it_says():
    window = Window(parse_fault("camera.off@hold+5:2"))
    assert window.elapsed_s(100 * S) is None
    window.phase_entered(Phase.APPROACH, 10 * S)
    assert window.begin_ns is None
    window.phase_entered(Phase.HOLD, 20 * S)
    window.phase_entered(Phase.HOLD, 40 * S)
    assert window.begin_ns == 25 * S
    assert [window.elapsed_s(t * S) for t in (24, 25, 26, 27)] == [None, 0.0, 1.0, None]


def test_the_companions_status_text_tells_the_phase():
    faults = Faults((parse_fault("camera.off@hold+1"),), SETUP, np.random.SeedSequence(1))
    codec = MavlinkCodec(1, 191)
    for text in ("vision real", "phase approach: station held", "phase holdall: x"):
        faults.overhear(codec.pack(dialect.MAVLink_statustext_message(6, text.encode())), 3 * S)
    assert faults.began_ns is None
    frame = codec.pack(dialect.MAVLink_statustext_message(6, b"phase hold: inside the desired window"))
    faults.overhear(frame[:20], 4 * S)
    faults.overhear(frame[20:], 5 * S)
    assert faults.began_ns == 6 * S


# ---- what they do to a stream ----------------------------------------------------------------------------------------


def fixes_through(text, n=100, every_ns=100_000_000):
    """Return what arrives of one fix each 0.1 s, as (instant of arrival, fix)."""
    fault = parse_fault(text)
    tamper = Tamper(fault, Window(fault), GpsCraft(), np.random.default_rng(1))
    arrived = []
    for k in range(n * every_ns // STEP_NS):
        t_ns = k * STEP_NS
        due = [GpsFix(t_ns, (t_ns / S, 0.0, 0.0))] if t_ns % every_ns == 0 else []
        arrived += [(t_ns, fix) for fix in tamper.pass_on(due, t_ns)]
    return arrived


def test_off_and_intermittent_and_slow_let_pass_what_they_say():
    assert [t for t, _ in fixes_through("gps.off@2:3")] == [k * S // 10 for k in range(100) if not 20 <= k < 50]
    there = fixes_through("gps.intermittent@2")
    assert [t for t, _ in there] == [k * S // 10 for k in range(100) if k < 20 or (k - 20) % 5 < 2]
    assert len(fixes_through("gps.slow@0")) == 10
    assert len(fixes_through("gps.slow=4@0")) == 25


def test_stuck_repeats_the_last_good_one_with_new_stamps():
    arrived = fixes_through("gps.stuck@2:3")
    assert all(fix.t_ns == t for t, fix in arrived)
    assert {fix.p_ned_m[0] for t, fix in arrived if 2 * S <= t < 5 * S} == {1.9}
    assert all(fix.p_ned_m[0] == t / S for t, fix in arrived if not 2 * S <= t < 5 * S)


def test_delayed_comes_later_and_gps_is_stamped_as_new():
    arrived = fixes_through("gps.delayed@0")
    assert [t - fix.t_ns for t, fix in arrived] == [0] * len(arrived)
    assert all(fix.p_ned_m[0] == pytest.approx(t / S - 0.3) for t, fix in arrived)
    assert len(arrived) == 97


def test_a_delay_that_ends_lets_what_waits_arrive_after_what_is_newer():
    arrived = fixes_through("gps.delayed@0:1", n=20)
    assert len(arrived) == 20
    assert [round(fix.p_ned_m[0], 6) for t, fix in arrived if S <= t < 1.3 * S] == [0.7, 1.0, 0.8, 1.1, 0.9, 1.2]


@given(st.integers(0, 199), st.integers(5, 20))
def test_heartbeats_that_come_and_go_leave_no_gap_of_more_than_two_seconds(steps, seconds):
    """Whenever between two heartbeats the fault begins: one at a time is missing, and never two."""
    fault = parse_fault(f"heartbeat.intermittent@{10.0 + 0.005 * steps:.3f}")
    tamper = Tamper(fault, Window(fault), GpsCraft(), np.random.default_rng(1))
    came = [t for t in range(10 + seconds) if tamper.pass_on([GpsFix(t * S, (0.0, 0.0, 0.0))], t * S)]
    gaps = set(np.diff(came).tolist())
    assert gaps <= {1, 2}
    assert tamper.touched == 10 + seconds - len(came)
    assert 2 in gaps or seconds < 7


def test_drag_grows_and_garbage_is_anywhere():
    off = [fix.p_ned_m[0] - t / S for t, fix in fixes_through("gps.drag@2")]
    assert off[:21] == pytest.approx([0.0] * 21)
    assert off[-1] == pytest.approx(0.5 * 7.9)
    anywhere = np.array([fix.p_ned_m for _, fix in fixes_through("gps.garbage@0")])
    assert (np.abs(anywhere - [[t, 0, 0] for t in np.arange(100) / 10]) <= 1000.0).all()
    assert anywhere.std(axis=0).min() > 300.0


@pytest.mark.parametrize(("target", "kind"), ALL)
def test_no_fault_is_drawn_upon_before_it_begins(target, kind):
    """What passes through a fault that has not begun is what came, byte for byte."""
    faults = Faults((Fault(target=target, kind=kind, from_s=99.0),), SETUP, np.random.SeedSequence(1))
    heartbeat = MavlinkCodec(1, 1).pack(dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 0, 3))
    frame = encode_frame(tanker_state(0), 6000.0)
    assert faults.mavlink(heartbeat, 0) == heartbeat
    assert faults.datalink(frame, 0) == [frame]
    assert faults.frames([marker_frame()], 0)[0].detections.uv_px.tolist() == marker_frame().detections.uv_px.tolist()
    assert faults.fix(GpsFix(0, (1.0, 2.0, 3.0)), 0) == GpsFix(0, (1.0, 2.0, 3.0))
    assert faults.lights(0) is None


# ---- how samples are made wrong --------------------------------------------------------------------------------------


def tanker_state(t_ns):
    return TankerState(t_ns, np.array([10.0, 20.0, -30.0]), np.array([206.0, 0.0, 0.0]), np.eye(3), np.zeros(3))


def marker_frame(t_ns=7, sequence=3):
    uv = np.array([[10.0, 20.0], [159.5, 100.0], [300.0, 30.0]])
    return MarkerFrame(t_ns, sequence, Detections(t_ns, uv, np.ones(3), np.full(3, 0.1), np.zeros(3, np.uint8)))


def one(craft, sample, text, elapsed_s=0.0):
    (wrong,) = craft.wrong(sample, parse_fault(text), elapsed_s, np.random.default_rng(1))
    return wrong


@pytest.mark.parametrize(("text", "field", "by"), [
    ("datalink.wrong", "x_m", 20.0), ("datalink.wrong=5", "y_m", 5.0), ("datalink.height", "height_m", 5.0),
    ("datalink.velocity", "speed_m_s", 5.0), ("datalink.turned", "theta_rad", math.radians(3.0)),
    ("clock.step", "time_s", -5.0),
])
def test_the_tankers_frames_lie_with_a_right_checksum(text, field, by):
    frame = encode_frame(tanker_state(20 * S), 6000.0)
    (before,), (after,) = FrameParser().feed(frame), FrameParser().feed(one(DatalinkCraft(), frame, text))
    assert getattr(after, field) - getattr(before, field) == pytest.approx(by, abs=1e-3)


def test_the_tankers_garbage_and_nan_are_refused_by_the_parser():
    frame = encode_frame(tanker_state(0), 6000.0)
    parser = FrameParser()
    assert parser.feed(one(DatalinkCraft(), frame, "datalink.nan")) == []
    assert parser.rejects == {"not_finite": 1}
    assert FrameParser().feed(one(DatalinkCraft(), frame, "datalink.garbage")) == []


def test_a_frame_of_the_tanker_is_stamped_anew():
    craft, old, new = DatalinkCraft(), encode_frame(tanker_state(S), 0.0), encode_frame(tanker_state(9 * S), 0.0)
    (kept,) = FrameParser().feed(craft.with_stamp_of(old, new))
    (later,) = FrameParser().feed(craft.stamped_later(old, 3 * S))
    assert (kept.time_s, later.time_s) == (9.0, 4.0)


def test_pictures_and_detections_are_spoilt_alike():
    """What is done to a picture and to its detections is the same, where that can be told."""
    craft = FrameCraft(320, 200)
    image = np.zeros((200, 320, 3), np.uint8)
    lit = marker_frame().detections.uv_px
    for u, v in lit:
        image[int(v), int(u), 0] = 255
    picture = CameraFrame(7, 3, image)
    for text in ("camera.wrong", "camera.shifted=5", "camera.boom=0.1"):
        seen = one(craft, marker_frame(), text).detections.uv_px
        rows, columns = np.nonzero(one(craft, picture, text).image[:, :, 0] == 255)
        found = sorted(zip(columns.tolist(), rows.tolist(), strict=True))
        assert found == sorted((math.floor(u) if text != "camera.wrong" else math.ceil(u), int(v)) for u, v in seen)
    assert image.sum() == 3 * 255  # the picture itself is left as it was


def test_the_boom_hides_what_lies_behind_it_and_no_two_pictures_of_it_are_alike():
    craft, fault, rng = FrameCraft(320, 200), parse_fault("camera.boom=0.5"), np.random.default_rng(1)
    picture = CameraFrame(0, 0, np.full((200, 320, 3), 200, np.uint8))
    (a,), (b,) = (craft.wrong(picture, fault, 0.0, rng) for _ in range(2))
    assert (a.image != 200).any(axis=(0, 2)).sum() == pytest.approx(160, abs=1)
    assert not np.array_equal(a.image, b.image)
    assert one(craft, marker_frame(), "camera.boom=0.5").detections.uv_px.tolist() == [[10.0, 20.0], [300.0, 30.0]]


def test_a_clock_that_steps_stamps_pictures_and_detections_too():
    craft, picture = FrameCraft(320, 200), CameraFrame(20 * S, 3, np.zeros((200, 320, 3), np.uint8))
    stepped = one(craft, picture, "clock.step")
    assert (stepped.t_ns, stepped.sequence, stepped.image is picture.image) == (15 * S, 3, True)
    stepped = one(craft, marker_frame(20 * S), "clock.step=2")
    assert (stepped.t_ns, stepped.detections.t_ns) == (18 * S, 18 * S)
    assert stepped.detections.uv_px.tolist() == marker_frame().detections.uv_px.tolist()


@pytest.mark.parametrize(("craft", "sample"), [
    (FrameCraft(320, 200), CameraFrame(0, 0, np.zeros((200, 320, 3), np.uint8))),
    (FrameCraft(320, 200), marker_frame()),
    (DatalinkCraft(), encode_frame(tanker_state(0), 0.0)),
    (GpsCraft(), GpsFix(0, (0.0, 0.0, 0.0))),
    (MavlinkCraft(1, 1), MavlinkCodec(1, 1).pack(dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 0, 3))),
])
def test_a_kind_that_nothing_can_make_is_no_other_kind(craft, sample):
    with pytest.raises(ValueError, match=r"nothing knows how to make lights\.half"):
        one(craft, sample, "lights.half")


def telemetry(message):
    return MavlinkCodec(1, 1).pack(message)


def read(frame):
    return MavlinkCodec(1, 191).feed(frame)[0][0]


ATTITUDE = dialect.MAVLink_attitude_quaternion_message(5000, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3)
POSITION = dialect.MAVLink_local_position_ned_message(5000, 1.0, 2.0, 3.0, 206.0, 0.0, 0.0)
HEARTBEAT = dialect.MAVLink_heartbeat_message(1, 0, 0xFF, 15, 4, 3)


def test_telemetry_lies_with_a_right_checksum():
    craft = MavlinkCraft(1, 1)
    rolled = read(one(craft, telemetry(ATTITUDE), "attitude.wrong"))
    assert 2.0 * math.atan2(rolled.q2, rolled.q1) == pytest.approx(math.radians(3.0))
    assert (rolled.q3, rolled.q4, rolled.time_boot_ms) == (0.0, 0.0, 5000)
    wild = read(one(craft, telemetry(ATTITUDE), "attitude.garbage"))
    assert math.hypot(wild.q1, wild.q2, wild.q3, wild.q4) == pytest.approx(1.0, abs=1e-6)
    assert math.isnan(read(one(craft, telemetry(ATTITUDE), "attitude.nan")).q2)
    assert read(one(craft, telemetry(POSITION), "position.wrong")).x == 31.0
    assert math.isnan(read(one(craft, telemetry(POSITION), "position.nan")).z)
    manual = read(one(craft, telemetry(HEARTBEAT), "heartbeat.wrong"))
    assert not manual.base_mode & dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    assert MavlinkCodec(1, 191).feed(one(craft, telemetry(HEARTBEAT), "heartbeat.garbage")) == []


def test_clocks_run_backwards_and_step():
    craft = MavlinkCraft(1, 1)
    for elapsed_ms in (0, 20, 1000):
        sent = telemetry(dialect.MAVLink_attitude_quaternion_message(5000 + elapsed_ms, 1.0, 0.0, 0.0, 0.0, 0, 0, 0))
        assert read(one(craft, sent, "clock.backwards", elapsed_ms / 1000)).time_boot_ms == 5000 - elapsed_ms
    assert read(one(craft, telemetry(POSITION), "clock.step")).time_boot_ms == 0
    answer = telemetry(dialect.MAVLink_timesync_message(20 * S, 17))
    assert (read(one(craft, answer, "clock.step")).tc1, read(one(craft, answer, "clock.step")).ts1) == (15 * S, 17)
    request = telemetry(dialect.MAVLink_timesync_message(0, 17))
    assert read(one(craft, request, "clock.step")).tc1 == 0


def test_a_forger_has_the_autopilots_ids_and_a_second_vehicle_its_own():
    forged = Faults((parse_fault("link.forged"),), SETUP, np.random.SeedSequence(1))
    seen = MavlinkCodec(1, 191).feed(forged.mavlink(telemetry(ATTITUDE), 0))
    assert [(m.get_srcSystem(), m.get_srcComponent(), m.time_boot_ms) for m, _ in seen] == [(1, 1, 5000), (1, 1, 5001)]
    other = Faults((parse_fault("link.second_vehicle"),), SETUP, np.random.SeedSequence(1))
    codec, kinds = MavlinkCodec(1, 191), Counter()
    for k in range(400):
        for message, _ in codec.feed(other.mavlink(b"", k * STEP_NS)):
            assert message.get_srcSystem() == 2
            kinds[message.get_type()] += 1
    assert kinds == {"ATTITUDE_QUATERNION": 100, "LOCAL_POSITION_NED": 100, "HEARTBEAT": 2, "COMMAND_LONG": 2}


def test_what_a_fault_has_changed_is_counted():
    """Frames of the camera and of the tanker and telemetry, all by one clock; nought for a fault that never begins."""
    faults = Faults((parse_fault("clock.step@0"), parse_fault("lights.all@1"), parse_fault("camera.off@9"),
                     parse_fault("link.second_vehicle@0")), SETUP, np.random.SeedSequence(1))
    for k in range(4):
        faults.frames([marker_frame(k * S)], k * S)
        faults.datalink(encode_frame(tanker_state(k * S), 0.0), k * S)
        faults.mavlink(telemetry(ATTITUDE) + telemetry(POSITION), k * S)
        faults.lights(k * S)
    assert faults.touched == (16, 3, 0, 4)


def test_lights_go_out_or_move():
    places = np.array([m.p_tanker_m for m in SETUP.tanker.markers])

    def lights(text):
        return Faults((parse_fault(text),), SETUP, np.random.SeedSequence(1)).lights(0)

    out = np.array(OUT_OF_SIGHT_M)
    for text, gone in (("lights.one", [0]), ("lights.half", [0, 2, 4, 6, 8]), ("lights.all", range(9))):
        assert np.flatnonzero((lights(text) == out).all(axis=1)).tolist() == list(gone)
    away = lights("lights.moved=0.7") - places
    assert np.abs(away).sum() == pytest.approx(0.7)
    assert abs(lights("lights.moved=0.7")[2, 1]) > abs(places[2, 1])


# ---- in the simulation -----------------------------------------------------------------------------------------------


def first_seconds(faults=(), seconds=1.0, **fields):
    """Return what arrives in the first seconds of a flight that nobody flies."""
    scenario = msgspec.structs.replace(SCENARIO, faults=tuple(map(parse_fault, faults)), **fields)
    simulation = Simulation(scenario, SETUP)
    return simulation, [simulation.step() for _ in range(round(seconds / 0.005))]


def bits(arrivals):
    """Return everything that arrives as one value that compares."""
    return [
        (a.t_ns, a.mavlink, a.datalink, [(f.t_ns, f.detections.uv_px.tobytes()) for f in a.frames]) for a in arrivals
    ]


def test_a_flight_keeps_its_bits_until_its_fault_begins_and_other_sources_after():
    _, clean = first_seconds()
    _, spoilt = first_seconds(["camera.garbage@0.5", "datalink.garbage@0.6"])
    assert bits(clean[:100]) == bits(spoilt[:100])
    assert [a.mavlink for a in clean] == [a.mavlink for a in spoilt]
    assert bits(clean) != bits(spoilt)


def test_the_same_seed_gives_the_same_garbage_and_another_fault_does_not_change_it():
    _, a = first_seconds(["camera.garbage", "attitude.garbage"])
    _, b = first_seconds(["camera.garbage", "attitude.garbage"])
    _, c = first_seconds(["camera.garbage", "heartbeat.off"])
    assert bits(a) == bits(b)
    assert [x[3] for x in bits(a)] == [x[3] for x in bits(c)]


def test_gps_faults_reach_what_the_autopilot_tells_of_its_position():
    def north(faults):
        codec = MavlinkCodec(1, 191)
        frames = b"".join(a.mavlink for a in first_seconds(faults)[1])
        return [m.x for m, _ in codec.feed(frames) if m.get_type() == "LOCAL_POSITION_NED"]

    clean, wrong = np.array(north([])), np.array(north(["gps.wrong@0.5"]))
    assert wrong[0] == clean[0]
    assert wrong[-1] - clean[-1] == pytest.approx(30.0, abs=1e-3)
    assert north(["gps.off"]) == []


def test_pictures_show_lights_out_and_a_camera_that_has_turned():
    """The picture changes where the lights are, and by a shift of the focal length times the angle."""
    def red(faults):
        (_, arrivals) = first_seconds(faults, 0.2, vision_input="pictures", start_tanker_m=(-33.0, -2.0, 12.0))
        image = next(f for a in arrivals for f in a.frames).image.astype(int)
        return (image[:, :, 0] > 200) & (image[:, :, 1] < 120)

    lit, out, turned = red([]), red(["lights.all"]), red(["camera.boresight"])
    assert lit.sum() > 30
    assert out.sum() < 0.1 * lit.sum()
    rows = [np.nonzero(mask)[0].mean() for mask in (lit, turned)]
    assert rows[1] - rows[0] == pytest.approx(SETUP.camera.fy_px * math.radians(1.0), abs=1.5)


def test_a_turned_camera_sees_what_a_camera_mounted_so_sees():
    """Detections of the boresight fault are those of a mount that is turned; the receiver's own truth stays."""
    (faulty, arrivals) = first_seconds(["camera.boresight"], 0.2)
    pitch = SETUP.camera.mount_pitch_rad + math.radians(1.0)
    mounted = msgspec.structs.replace(SETUP, camera=msgspec.structs.replace(SETUP.camera, mount_pitch_rad=pitch))
    simulation = Simulation(SCENARIO, mounted)
    truly = [simulation.step() for _ in range(40)]
    seen, wanted = (np.concatenate([f.detections.uv_px for a in x for f in a.frames]) for x in (arrivals, truly))
    np.testing.assert_allclose(seen, wanted, atol=1e-6)
    assert np.array_equal(faulty.truth.uav.R_ned_body, simulation.truth.uav.R_ned_body)
