"""The framing against pymavlink's own parser and checksum, and against damage."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.io.mavlink_codec import MavlinkCodec, Message, checksum, dialect

HEARTBEAT = dialect.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)


def attitude(t_ms: int) -> object:
    return dialect.MAVLink_attitude_quaternion_message(t_ms, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3)


def stream(count: int) -> bytes:
    sender = MavlinkCodec(1, 1)
    return b"".join(sender.pack(HEARTBEAT if i % 3 else attitude(i)) for i in range(count))


@given(st.binary(max_size=300), st.integers(0, 255))
def test_checksum_is_pymavlinks(data: bytes, extra: int):
    assert checksum(data, extra) == dialect.x25crc(data + bytes([extra])).crc


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(width=32, allow_nan=False), min_size=7, max_size=7))
def test_what_is_packed_comes_back_bit_for_bit(t_ms: int, values: list[float]):
    packed = MavlinkCodec(7, 9).pack(dialect.MAVLink_attitude_quaternion_message(t_ms, *values))
    [(message, raw)] = MavlinkCodec(1, 191).feed(packed)
    assert raw == packed
    assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 9)
    assert [message.time_boot_ms, message.q1, message.q4, message.yawspeed] == [t_ms, values[0], values[3], values[6]]


@given(st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_cuts_do_not_matter(cuts: list[int]):
    data = stream(12)
    codec, at, got = MavlinkCodec(1, 191), 0, []
    for cut in [*cuts, len(data)]:
        got += codec.feed(data[at : at + cut])
        at += cut
    assert b"".join(raw for _, raw in got) == data
    assert not codec.rejects


def test_byte_by_byte():
    data = stream(20)
    codec = MavlinkCodec(1, 191)
    assert sum(len(codec.feed(bytes([byte]))) for byte in data) == 20
    assert not codec.rejects


@pytest.mark.parametrize(
    "stray", [b"abc", b"\xfd\x09\x00", b"\xfd\xff\x00", b"\xfd\xfd\xfd", b"\xfe\x09\x00", b"\x00\x00\xfd"]
)
def test_three_stray_bytes_before_twenty_heartbeats_cost_none(stray: bytes):
    sender, codec = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
    got = codec.feed(stray + b"".join(sender.pack(HEARTBEAT) for _ in range(20)))
    assert len(got) == 20
    assert codec.rejects.total() >= 1


@given(st.binary(max_size=120), st.integers(0, 19))
def test_garbage_between_frames_costs_no_frame(garbage: bytes, where: int):
    sender, codec = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
    frames = [sender.pack(HEARTBEAT) for _ in range(20)]
    tail = bytes(300)  # whatever the garbage seems to announce, it can be judged now
    got = [raw for _, raw in codec.feed(b"".join([*frames[:where], garbage, *frames[where:], tail]))]
    assert [raw for raw in got if raw in frames] == frames


def test_one_damaged_frame_costs_one_frame():
    rng = random.Random(4)
    sender = MavlinkCodec(1, 1)
    frames = [sender.pack(attitude(i)) for i in range(200)]
    for damaged in range(0, 200, 10):
        frame = bytearray(frames[damaged])
        frame[rng.randrange(10, len(frame))] ^= 1 << rng.randrange(8)
        frames[damaged] = bytes(frame)
    codec = MavlinkCodec(1, 191)
    got = codec.feed(b"".join(frames) + bytes(300))
    assert len(got) == 180
    assert codec.rejects["bad_checksum"] >= 20


def test_an_unknown_id_is_counted_and_dropped():
    frame = bytearray(MavlinkCodec(1, 1).pack(HEARTBEAT))
    frame[7:10] = (60000).to_bytes(3, "little")
    codec = MavlinkCodec(1, 191)
    assert codec.feed(bytes(frame) + stream(3))[-3:]
    assert codec.rejects["unknown_id"] == 1


@pytest.mark.parametrize("message_id", sorted(dialect.mavlink_map))
def test_every_message_reads_and_writes_as_with_pymavlinks_own_code(message_id: int):
    kind, rng = dialect.mavlink_map[message_id], random.Random(message_id)
    for noise in (rng.randbytes(255), rng.randbytes(5) + bytes(250), bytes(255)):
        payload = noise[: kind.unpacker.size].rstrip(b"\0") or b"\0"
        body = bytes([len(payload), 0, 0, rng.randrange(256), 3, 4]) + message_id.to_bytes(3, "little") + payload
        frame = b"\xfd" + body + checksum(body, kind.crc_extra).to_bytes(2, "little")
        wanted, codec = dialect.MAVLink(None, srcSystem=3, srcComponent=4).decode(bytearray(frame)), MavlinkCodec(3, 4)
        [(message, raw)] = codec.feed(frame)
        assert raw == frame
        assert type(message) is type(wanted)
        assert repr(message.to_dict()) == repr(wanted.to_dict())  # NaN is not equal to itself
        assert about(message) == about(wanted)
        assert codec.pack(message) == bytes(wanted.pack(dialect.MAVLink(None, srcSystem=3, srcComponent=4)))


def about(message: Message) -> tuple[int | bytes, ...]:
    numbers = (message.get_msgId(), message.get_seq(), message.get_srcSystem(), message.get_srcComponent())
    return *numbers, message.get_crc(), bytes(message.get_msgbuf())


def test_signed_frames_are_read():
    signer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    signer.signing.secret_key, signer.signing.sign_outgoing, signer.signing.link_id = bytes(32), True, 1
    frame = bytes(HEARTBEAT.pack(signer))
    [(message, raw)] = MavlinkCodec(1, 191).feed(frame)
    assert message.get_type() == "HEARTBEAT"
    assert raw == frame


def test_restart_forgets_a_begun_frame():
    data = stream(2)
    codec = MavlinkCodec(1, 191)
    codec.feed(data[:10])
    codec.restart()
    assert b"".join(raw for _, raw in codec.feed(data)) == data
    assert not codec.rejects


def test_what_does_not_fit_is_a_value_error():
    codec = MavlinkCodec(1, 1)
    with pytest.raises(ValueError, match="ATTITUDE_QUATERNION"):
        codec.pack(attitude(2**32))
    with pytest.raises(ValueError, match="cannot be packed"):
        codec.pack(dialect.MAVLink_attitude_quaternion_message(0, 1e300, 0, 0, 0, 0, 0, 0))
    [(message, _)] = MavlinkCodec(1, 191).feed(codec.pack(attitude(1)))
    assert message.get_seq() == 0  # what was refused has used no number


def test_nan_passes_the_wire_so_that_the_link_has_to_look():
    frame = MavlinkCodec(1, 1).pack(dialect.MAVLink_attitude_quaternion_message(0, math.nan, 0, 0, 0, 0, 0, 0))
    [(message, _)] = MavlinkCodec(1, 191).feed(frame)
    assert math.isnan(message.q1)
