"""The thesis' frame: both ways, cut anywhere, damaged, and what cannot be."""

import math
import random
import struct
from binascii import crc_hqx
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry import rotation_from_euler
from companion.io.datalink import FRAME_SIZE, FrameParser, TankerReceiver, encode_frame
from companion.messages import Event, Reject, TankerState

S = 1_000_000_000


def state_of(
    t_ns: int = 0, p: tuple[float, ...] = (0.0, 0.0, 0.0), v: tuple[float, ...] = (205.7, 0.0, 0.0),
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0), omega: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> TankerState:
    return TankerState(t_ns, np.array(p), np.array(v), rotation_from_euler(*euler), np.array(omega))


def raw_frame(values: list[float]) -> bytes:
    """Build a frame by the table in the thesis' order, independently of the encoder."""
    body = b"\xa5" + b"".join(struct.pack("<f", value) for value in values)
    return body + struct.pack("<H", crc_hqx(body, 0xFFFF))


def reasons(events: list[Event]) -> list[str]:
    return [event.reason for event in events if isinstance(event, Reject)]


def vector(limit: float) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[st.floats(-limit, limit)] * 3)


states = st.builds(
    state_of,
    st.integers(0, 10**15),
    st.tuples(st.floats(-20_000, 20_000), st.floats(-20_000, 20_000), st.floats(-5_000, 5_000)),
    vector(300.0),
    st.tuples(st.floats(-math.pi, math.pi), st.floats(-1.5, 1.5), st.floats(-math.pi, math.pi)),
    vector(2.0),
)


def test_a_frame_is_55_bytes_in_the_order_of_the_thesis():
    frame = encode_frame(state_of(3 * S, (10.0, 20.0, -30.0), euler=(0.0, 0.0, 0.0), omega=(0.1, 0.2, 0.3)), 6000.0)
    assert len(frame) == FRAME_SIZE == 55
    assert frame == raw_frame([205.7, 0, 0, 0.1, 0.2, 0.3, 0, 0, 0, 10, 20, 6030, 3])


@given(states)
def test_what_is_sent_arrives_within_float32(state: TankerState):
    [frame] = FrameParser().feed(encode_frame(state, 6000.0))
    back = frame.to_state(state.t_ns + S, 6000.0)
    assert abs(back.t_ns - state.t_ns) <= 8_000  # half of 15.3 us
    assert np.allclose(back.p_ned_m, state.p_ned_m, atol=2e-3)
    assert np.allclose(back.v_ned_m_s, state.v_ned_m_s, atol=3e-4)
    assert np.allclose(back.R_ned_tanker, state.R_ned_tanker, atol=1e-6)
    assert np.allclose(back.omega_tanker_rad_s, state.omega_tanker_rad_s, atol=1e-6)


def test_flow_angles_have_the_usual_signs():
    [down] = FrameParser().feed(encode_frame(state_of(v=(200.0, 0.0, 20.0))))
    [right] = FrameParser().feed(encode_frame(state_of(v=(200.0, 20.0, 0.0))))
    assert math.isclose(down.alpha_rad, math.atan2(20, 200), rel_tol=1e-6)
    assert math.isclose(right.beta_rad, math.asin(20 / math.hypot(200, 20)), rel_tol=1e-6)
    assert down.beta_rad == right.alpha_rad == 0.0


@given(st.integers(0, 10**16), st.integers(-120 * S, 120 * S))
def test_time_is_unwrapped_against_the_receivers_clock(t_ns: int, late_ns: int):
    [frame] = FrameParser().feed(encode_frame(state_of(t_ns)))
    assert abs(frame.to_state(t_ns + late_ns, 0.0).t_ns - t_ns) <= 8_000


@given(st.lists(states, min_size=1, max_size=6), st.lists(st.integers(1, 60), max_size=30), st.binary(max_size=80))
def test_cuts_and_leading_garbage_cost_no_frame(sent: list[TankerState], cuts: list[int], garbage: bytes):
    frames = [encode_frame(state, 6000.0) for state in sent]
    data = garbage + b"".join(frames) + bytes(FRAME_SIZE)  # behind it, whatever garbage has begun is complete
    parser, at, got = FrameParser(), 0, []
    for cut in [*cuts, len(data)]:
        got += parser.feed(data[at : at + cut])
        at += cut
    assert [raw_frame(list(astuple(frame))) for frame in got] == frames


def test_byte_by_byte():
    data = b"".join(encode_frame(state_of(i * S)) for i in range(10))
    parser = FrameParser()
    assert sum(len(parser.feed(bytes([byte]))) for byte in data) == 10
    assert not parser.rejects


def test_damaged_frames_are_found_out_and_cost_only_themselves():
    rng = random.Random(2)
    parser, taken = FrameParser(), 0
    count = 4000
    for i in range(count):
        frame = bytearray(encode_frame(state_of(i * S, omega=(rng.uniform(-1, 1), 0.0, 0.0))))
        if i % 2:  # two bits anywhere
            for bit in rng.sample(range(8 * FRAME_SIZE), 2):
                frame[bit // 8] ^= 1 << bit % 8
        else:  # a burst of five bytes
            at = rng.randrange(FRAME_SIZE - 4)
            frame[at : at + 5] = bytes(byte ^ rng.randrange(1, 256) for byte in frame[at : at + 5])
        taken += len(parser.feed(bytes(frame)))
    good = encode_frame(state_of())
    assert len(parser.feed(good * 3)) == 3
    assert taken == 0
    assert parser.rejects["checksum"] + parser.rejects["garbage"] >= count


@pytest.mark.parametrize("place", range(13))
@pytest.mark.parametrize(
    ("value", "reason"),
    [(math.nan, "not_finite"), (-math.inf, "not_finite"), (-2e6, "out_of_range"), (2e6, "out_of_range")],
)
def test_values_that_cannot_be_are_rejected(place: int, value: float, reason: str):
    values = [205.7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 6000, 3]
    parser = FrameParser()
    assert len(parser.feed(raw_frame(values))) == 1
    values[place] = value
    assert parser.feed(raw_frame(values)) == []
    assert parser.rejects == {reason: 1}


def test_the_encoder_sends_nothing_that_cannot_be():
    with pytest.raises(ValueError, match="not_finite"):
        encode_frame(state_of(p=(math.nan, 0.0, 0.0)))
    with pytest.raises(ValueError, match="out_of_range"):
        encode_frame(state_of(v=(2000.0, 0.0, 0.0)))


def test_a_standing_tanker_has_no_flow_angles():
    [frame] = FrameParser().feed(encode_frame(state_of(v=(0.0, 0.0, 0.0))))
    assert (frame.speed_m_s, frame.alpha_rad, frame.beta_rad) == (0.0, 0.0, 0.0)


def test_the_receiver_puts_states_on_the_companions_base():
    receiver, ahead_ns, now_ns = TankerReceiver(6000.0), 5000 * S, 300 * S
    frame = encode_frame(state_of(now_ns - S // 20 + ahead_ns, (1.0, 2.0, 3.0)), 6000.0)
    assert receiver.receive(frame[:20], now_ns, ahead_ns) == []
    [state] = receiver.receive(frame[20:], now_ns, ahead_ns)
    assert isinstance(state, TankerState)
    assert abs(state.t_ns - (now_ns - S // 20)) <= 8_000
    assert np.allclose(state.p_ned_m, [1.0, 2.0, 3.0], atol=1e-3)


def test_the_receiver_rejects_what_is_untimely():
    receiver, now_ns = TankerReceiver(0.0), 300 * S
    assert reasons(receiver.receive(encode_frame(state_of(now_ns)), now_ns, None)) == ["no_timesync"]
    assert reasons(receiver.receive(encode_frame(state_of(now_ns - 6 * S)), now_ns, 0)) == ["stale_stamp"]
    assert reasons(receiver.receive(encode_frame(state_of(now_ns + S)), now_ns, 0)) == ["future_stamp"]
    assert reasons(receiver.receive(encode_frame(state_of(now_ns - S)), now_ns, 0)) == ["stale_stamp"]
    assert reasons(receiver.receive(b"noise", now_ns, 0)) == ["garbage"]
