"""Named faults in lockstep flights; what has to happen is in each docstring.

Most happen while the receiver holds its station in JOIN, 3 m from the box, 1 s after joining. In JOIN a source that is
lost is waited for; what has to happen in the approach and in the hold is in ``test_fault_matrix``.
"""

import math
from binascii import crc_hqx
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from lockstep import TO_HOLD, S, during, fly_with, near, with_guidance, without

from companion.io.datalink import CHECKSUM, HEADER, LAYOUT
from companion.io.mavlink_codec import MavlinkCodec, dialect
from companion.messages import AttitudeSetpoint, FusedPose, Phase, PhaseChange, Reject, RelativeState, VisionOutput

NAN = math.nan
NOT_FINITE = "mavlink.not_finite"
STALE_S, LOST_S, LIFE_S = 0.3, 1.0, 0.5
FAR_M = (-48.0, -2.0, 18.0)
"""20 m behind the box: nearer than 15 m the guard watches the join as closely as a hold."""


def fly_join(folder, fault=None, *, back=None, seed=220, until_s=6.0, settle_s=99.0, fusion=None):
    """Fly in JOIN until ``until_s``; check what holds whatever the fault."""
    scenario, setup = near(seed, hold_s=1.0, timeout_s=until_s, fusion=fusion, start_tanker_m=FAR_M)
    setup = with_guidance(setup, join_settle_s=settle_s)
    return sane(fly_with(folder, scenario, setup, fault or (lambda a, f: a), back or (lambda d, f: d)), setup)


def sane(flight, setup):
    """Every setpoint is finite, inside the envelope and, but in a breakaway, from a fresh estimate of the same instant;
    every reject is in the summary.
    """
    assert flight.failure is None
    guidance, trim = setup.config.guidance, setup.airframe.trim
    state, phase = None, Phase.STANDBY
    for o in flight.outputs:
        if isinstance(o, RelativeState):
            state = o
        if isinstance(o, PhaseChange):
            phase = o.new
        if isinstance(o, AttitudeSetpoint):
            assert abs(o.roll_rad) <= guidance.max_roll_rad  # all of these are false for NaN
            assert abs(o.pitch_rad - trim.alpha_rad) <= guidance.max_pitch_offset_rad + 1e-12
            assert abs(o.yaw_rad) <= math.pi
            assert 0.0 <= o.thrust <= 1.0
            if phase is Phase.BREAKAWAY:
                continue
            assert state is not None
            assert state.t_ns == o.t_ns
            assert (o.t_ns - state.estimate_t_ns) / S <= STALE_S + 1e-9
    told = [o.reject for o in flight.of(VisionOutput) if o.reject] + flight.of(Reject)
    assert flight.summary["rejects"] == dict(Counter(f"{r.source}.{r.reason}" for r in told))
    return flight


def fault_s(flight):
    """Return when what is wrong from 1 s after joining begins."""
    return round(flight.entered_s(Phase.JOIN), 2) + 1.0


def goes_on(flight, start_s=1.0, end_s=math.inf):
    """Tell whether setpoints never paused between two instants."""
    sent = flight.setpoints_s(start_s, min(end_s, flight.t_s[-1]))
    return len(sent) > 25 and np.allclose(np.diff(sent), 0.02, atol=1e-6)


def rewritten(kind, make, *, keep):
    """Return a fault that puts what ``make(message)`` gives in place of frames of a kind; ``keep`` leaves them too."""
    reader, writer = MavlinkCodec(9, 9), MavlinkCodec(1, 1)

    def fault(arrivals, flight):
        out = b""
        for message, frame in reader.feed(arrivals.mavlink):
            if message.get_type() != kind:
                out += frame
                continue
            wrong = make(message)
            out += (b"" if wrong is None else writer.pack(wrong)) + (frame if keep else b"")
        return replace(arrivals, mavlink=out)

    return fault


def nan_attitude(m):
    return dialect.MAVLink_attitude_quaternion_message(m.time_boot_ms, m.q1, NAN, m.q3, m.q4, 0.0, 0.0, 0.0)


def nan_position(m):
    return dialect.MAVLink_local_position_ned_message(m.time_boot_ms, m.x, m.y, m.z, m.vx, NAN, m.vz)


def noisy(seed, field, share):
    """Return a fault that puts junk before, and flips a bit in, a share of what arrives on a link."""
    rng = np.random.default_rng(seed)

    def fault(arrivals, flight):
        data = bytearray(getattr(arrivals, field))
        if rng.random() < share:
            data = bytearray(rng.integers(0, 256, 30, dtype=np.uint8).tobytes()) + data
        if data and rng.random() < share:
            data[rng.integers(len(data))] ^= 0x40
        return replace(arrivals, **{field: bytes(data)})

    return fault


def forged_datalink(values):
    """Return a fault that sends a whole frame with a right checksum and such values behind each frame that ends."""
    body = LAYOUT.pack(HEADER, *values)
    forged = body + CHECKSUM.pack(crc_hqx(body, 0xFFFF))
    passed = [0]

    def fault(arrivals, flight):
        ends = (passed[0] + len(arrivals.datalink)) // 55 > passed[0] // 55
        split = 55 - passed[0] % 55
        passed[0] += len(arrivals.datalink)
        data = arrivals.datalink
        return replace(arrivals, datalink=data[:split] + forged + data[split:]) if ends else arrivals

    return fault


def frozen_picture():
    kept = []

    def fault(arrivals, flight):
        kept.extend(f.image for f in arrivals.frames if not kept)
        return replace(arrivals, frames=[replace(f, image=kept[0]) for f in arrivals.frames])

    return fault


def repeated_message():
    kept = []

    def fault(arrivals, flight):
        kept.extend(f for f in arrivals.frames if not kept)
        return replace(arrivals, frames=[kept[0] for _ in arrivals.frames])

    return fault


def cropped(arrivals, flight):
    return replace(arrivals, frames=[replace(f, image=f.image[:-1]) for f in arrivals.frames])


def from_ground_station(message, at_s):
    """Return a tamperer of what goes to the autopilot that adds one message of a ground station."""
    codec, sent = MavlinkCodec(255, 190), []

    def back(data, flight):
        if sent or flight.t_s[-1] < at_s:
            return data
        sent.append(at_s)
        return data + codec.pack(message)

    return back


def to_companion(*messages_at_s):
    """Return a fault that adds a ground station's commands to what arrives: (instant, MAV_CMD)."""
    codec, left = MavlinkCodec(255, 190), list(messages_at_s)

    def fault(arrivals, flight):
        if not left or arrivals.t_ns / S < left[0][0]:
            return arrivals
        command = dialect.MAVLink_command_long_message(1, 191, left.pop(0)[1], 0, 0, 0, 0, 0, 0, 0, 0)
        return replace(arrivals, mavlink=arrivals.mavlink + codec.pack(command))

    return fault


@pytest.mark.parametrize(
    ("fault", "reject"),
    [
        pytest.param(without("datalink"), None, id="datalink-off"),
        pytest.param(without("mavlink"), None, id="telemetry-off"),
        pytest.param(rewritten("ATTITUDE_QUATERNION", nan_attitude, keep=False), NOT_FINITE, id="attitude-nan"),
        pytest.param(rewritten("LOCAL_POSITION_NED", nan_position, keep=False), NOT_FINITE, id="position-nan"),
        pytest.param(rewritten("LOCAL_POSITION_NED", lambda m: None, keep=False), None, id="position-off"),
    ],
)
def test_source_lost_for_three_seconds(tmp_path, fault, reject):
    """Setpoints stop within 0.3 s; the autopilot holds by itself 0.5 s later; after 1 s the companion breaks away, on
    setpoints that need no estimate: level, nose down, little thrust, the heading last known. It stays so when the
    source comes back.
    """
    flight = fly_join(tmp_path, during(Phase.JOIN, 1.0, 3.0, fault))
    lost_s, away_s = fault_s(flight), flight.entered_s(Phase.BREAKAWAY)
    last = flight.setpoints_s(lost_s, away_s)
    assert 0.2 < last[-1] - lost_s <= STALE_S
    assert np.allclose(np.diff(last), 0.02, atol=1e-6)
    assert flight.following_at(last[-1] + LIFE_S - 0.02)
    assert not flight.following_at(last[-1] + LIFE_S + 0.02)
    assert flight.phases == [Phase.JOIN, Phase.BREAKAWAY]
    assert flight.reason(Phase.BREAKAWAY) == "estimate lost"
    assert LOST_S - 0.1 < away_s - lost_s < LOST_S + 0.05
    assert goes_on(flight, away_s)
    assert flight.setpoints_s(away_s)[0] == pytest.approx(away_s)
    asked = [o for o in flight.of(AttitudeSetpoint) if o.t_ns / S > away_s + 0.5]
    assert {(o.roll_rad, o.thrust) for o in asked} == {(0.0, 0.05)}
    assert np.abs([o.yaw_rad for o in asked]).max() < 0.05
    assert flight.following_at(away_s + 0.03)
    assert flight.following_at(flight.t_s[-1])
    if reject:
        assert flight.summary["rejects"][reject] > 100


def test_datalink_off_for_800_ms(tmp_path):
    """Setpoints pause for longer than the autopilot waits: it holds, then follows again; no breakaway."""
    flight = fly_join(tmp_path, during(Phase.JOIN, 1.0, 0.8, without("datalink")), until_s=4.0)
    gaps = np.diff(flight.setpoints_s())
    assert (gaps > 0.021).sum() == 1
    assert 0.5 < gaps.max() < 0.65
    assert flight.phases == [Phase.JOIN]
    assert flight.following.count(False) > 2
    assert flight.following_at(flight.t_s[-1])
    assert flight.summary["rejects"]["guard.estimate_stale"] > 20


@pytest.mark.parametrize(
    ("fault", "reject"),
    [
        pytest.param(without("frames"), None, id="off"),
        pytest.param(frozen_picture(), "camera.frozen", id="frozen"),
        pytest.param(repeated_message(), "camera.time_not_forward", id="same-message"),
        pytest.param(cropped, "vision.frame_size", id="wrong-size"),
    ],
)
def test_camera_lost_for_two_seconds(tmp_path, fault, reject):
    """The last blend is carried on for 0.3 s, then GPS alone is flown on without a pause; vision comes back at once."""
    flight = fly_join(tmp_path, during(Phase.JOIN, 1.0, 2.0, fault), until_s=5.0, fusion="blend")
    assert goes_on(flight)
    assert flight.phases == [Phase.JOIN]
    lost_s = fault_s(flight)
    weight = {round(o.t_ns / S, 2): o.vision_weight for o in flight.of(RelativeState)}
    assert min(weight[round(lost_s + 0.02 * k, 2)] for k in range(11)) > 0.4  # at this range, thesis eq. 3.9
    assert {weight[round(lost_s + 0.44 + 0.02 * k, 2)] for k in range(78)} == {0.0}
    assert min(w for t, w in weight.items() if t > lost_s + 2.2) > 0.4
    assert np.abs(flight.estimate_errors(lost_s, lost_s + 2.0)).max() < 1.0  # GPS: 0.14 m per axis, one sigma
    assert np.abs(flight.estimate_errors(lost_s + 2.2, 99.0)).max() < 0.5
    if reject:
        assert 18 <= flight.summary["rejects"][reject] <= 20


def test_the_filter_coasts_while_the_camera_is_lost(tmp_path):
    """Inertial data carry the estimate over two seconds: a tenth of what GPS alone would scatter."""
    flight = fly_join(tmp_path, during(Phase.JOIN, 4.0, 2.0, without("frames")), until_s=8.0, fusion="filter")
    assert goes_on(flight)
    assert flight.phases == [Phase.JOIN]
    lost_s = fault_s(flight) + 3.0
    assert np.abs(flight.estimate_errors(lost_s, lost_s + 2.0)).max() < 0.1
    assert np.abs(flight.estimate_errors(lost_s + 2.2, 99.0)).max() < 0.05


def test_heartbeat_lost(tmp_path):
    """Three seconds after the last heartbeat nothing says GUIDED: standby, no setpoints; later it joins anew."""
    off = during(Phase.JOIN, 0.5, 4.5, rewritten("HEARTBEAT", lambda m: None, keep=False))
    flight = fly_join(tmp_path, off, until_s=7.0)
    assert flight.phases == [Phase.JOIN, Phase.STANDBY, Phase.JOIN]
    left_s = flight.entered_s(Phase.STANDBY)
    assert 3.0 <= left_s <= 4.0
    assert flight.setpoints_s(left_s, left_s + 1.5) == []
    assert not flight.following_at(left_s + LIFE_S + 0.02)
    assert flight.following_at(flight.t_s[-1])


def test_pilot_takes_over(tmp_path):
    """MANUAL from a ground station: within a heartbeat the companion is in standby, and silent."""
    manual = dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_DO_SET_MODE, 0, 1, 0, 0, 0, 0, 0, 0)
    flight = fly_join(tmp_path, back=from_ground_station(manual, 2.0), until_s=4.0)
    assert flight.phases == [Phase.JOIN, Phase.STANDBY]
    assert flight.reason(Phase.STANDBY) == "pilot took over"
    assert max(flight.setpoints_s()) < flight.entered_s(Phase.STANDBY) <= 3.05
    assert not any(flight.following[int(2.05 / 0.005):])
    assert flight.simulation.autopilot.rejects["not_guided"] > 0


def test_operator_breaks_away(tmp_path):
    """Breakaway at the next step, behind and below, never nearer; ENGAGE does nothing, CLEAR ends it."""
    commands = ((2.0, dialect.MAV_CMD_USER_2), (5.0, dialect.MAV_CMD_USER_1), (8.0, dialect.MAV_CMD_USER_3))
    flight = fly_join(tmp_path, to_companion(*commands), until_s=10.0)
    assert flight.phases == [Phase.JOIN, Phase.BREAKAWAY, Phase.STANDBY]
    assert flight.entered_s(Phase.BREAKAWAY) - 2.0 < 0.025
    assert flight.entered_s(Phase.STANDBY) - 8.0 < 0.025
    assert goes_on(flight, 0.2, 7.99)
    assert flight.setpoints_s(8.02) == []
    br = np.array(flight.truth_br)[400:]
    assert (br[:, 0] < br[0, 0] + 0.1).all()
    assert (br[:, 2] > br[0, 2] - 0.1).all()
    assert br[-1, 0] < br[0, 0] - 15.0
    assert br[-1, 2] > br[0, 2] + 30.0


def test_setpoints_lost_on_their_way(tmp_path):
    """The autopilot holds wings level and speed after 0.5 s, and follows again at once; the companion goes on."""
    flight = fly_join(tmp_path, back=during(Phase.JOIN, 1.0, 1.5, lambda data, flight: b""), until_s=5.0)
    assert goes_on(flight)
    assert flight.following_at(fault_s(flight) + LIFE_S - 0.03)
    assert not flight.following_at(fault_s(flight) + LIFE_S + 0.03)
    assert not flight.following_at(fault_s(flight) + 1.49)
    assert flight.following_at(fault_s(flight) + 1.53)
    assert flight.phases == [Phase.JOIN]


@pytest.mark.parametrize(
    ("fault", "reasons"),
    [
        pytest.param(noisy(1, "mavlink", 0.1), {"mavlink.garbage", "mavlink.bad_checksum"}, id="junk-on-mavlink"),
        pytest.param(noisy(2, "datalink", 0.01), {"datalink.garbage", "datalink.checksum"}, id="junk-on-datalink"),
        pytest.param(rewritten("ATTITUDE_QUATERNION", nan_attitude, keep=True), {NOT_FINITE},
                     id="nan-attitude-between-good-ones"),
        pytest.param(rewritten("LOCAL_POSITION_NED", nan_position, keep=True), {NOT_FINITE},
                     id="nan-position-between-good-ones"),
        pytest.param(forged_datalink([NAN] * 13), {"datalink.not_finite"}, id="nan-on-datalink"),
        pytest.param(forged_datalink([5000.0] * 13), {"datalink.out_of_range"}, id="nonsense-on-datalink"),
    ],
)
def test_nonsense_between_good_messages(tmp_path, fault, reasons):
    """It is counted by reason, and nobody notices: no pause, no phase, an estimate as good as ever."""
    flight = fly_join(tmp_path, fault, until_s=4.0)
    assert reasons <= set(flight.summary["rejects"])
    assert goes_on(flight)
    assert flight.phases == [Phase.JOIN]
    assert np.abs(flight.estimate_errors(1.0, 99.0)).max() < 0.05
    assert min(o.vision_weight for o in flight.of(FusedPose) if o.t_ns / S > 1.0) > 0.99


@pytest.mark.slow
def test_everything_a_little_broken(tmp_path):
    """Junk on both links, NaN between good telemetry, every third picture gone: it docks all the same."""
    lost = np.random.default_rng(3)
    faults = (
        noisy(1, "mavlink", 0.1), noisy(2, "datalink", 0.01), rewritten("ATTITUDE_QUATERNION", nan_attitude, keep=True),
        lambda a, f: replace(a, frames=[x for x in a.frames if lost.random() > 0.33]),
    )

    def all_of(arrivals, flight):
        for fault in faults:
            arrivals = fault(arrivals, flight)
        return arrivals

    scenario, setup = near(221)
    flight = sane(fly_with(tmp_path, scenario, setup, during(Phase.JOIN, 0.5, 999.0, all_of)), setup)
    assert flight.phases == TO_HOLD
    br = np.array(flight.truth_br)[np.array(flight.t_s) > flight.entered_s(Phase.HOLD)]
    assert (np.abs(br) < setup.tanker.window.desired_m).all()


@pytest.mark.slow
def test_datalink_mostly_junk(tmp_path):
    """Most frames of the tanker are lost: setpoints come and go, it holds or breaks away and never comes too near."""
    scenario, setup = near(210)
    junk = during(Phase.JOIN, 1.0, 999.0, noisy(2, "datalink", 0.2))
    flight = sane(fly_with(tmp_path, scenario, setup, junk), setup)
    assert flight.summary["rejects"]["datalink.checksum"] > 100
    assert flight.summary["rejects"]["guard.estimate_stale"] > 100
    assert np.array(flight.truth_br)[:, 0].max() < setup.tanker.window.limit_m[0]
