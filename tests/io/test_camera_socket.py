"""Pictures over a real socket on the loopback, and messages that are none."""

import socket
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from companion.config import CameraConfig, ConfigError
from companion.io.camera import (
    CameraReceiver,
    ZmqCamera,
    ZmqFrameSender,
    decode_frame_message,
    encode_frame_message,
    open_camera,
)
from companion.io.clock import SimulatedClock
from companion.messages import CameraFrame, Event, Reject

S = 1_000_000_000


def camera_of(width: int = 32, height: int = 20) -> CameraConfig:
    return CameraConfig(
        name="small", width_px=width, height_px=height, rate_hz=20.0, fx_px=20.0, fy_px=20.0, cx_px=15.5, cy_px=9.5,
        p_frd_cam_m=(5.0, 0.0, -0.3),
    )  # fmt: skip


def picture(sequence: int, t_ns: int = 0, width: int = 32, height: int = 20) -> CameraFrame:
    image = np.random.default_rng(sequence).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return CameraFrame(t_ns, sequence, image)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


images = arrays.arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3)))


@given(images, st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**32 - 1))
def test_a_picture_comes_back_bit_for_bit(image: np.ndarray, t_ns: int, sequence: int):
    data = encode_frame_message(CameraFrame(t_ns, sequence, image))
    back = decode_frame_message(data, camera_of(image.shape[1], image.shape[0]), 0)
    assert isinstance(back, CameraFrame)
    assert (back.t_ns, back.sequence) == (t_ns, sequence)
    assert np.array_equal(back.image, image)
    assert not back.image.flags.writeable


GOOD = encode_frame_message(picture(1))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "bad_length"),
        (GOOD[:20], "bad_length"),
        (GOOD[:-1], "bad_length"),
        (GOOD + b"\x00", "bad_length"),
        (b"JFIF" + GOOD[4:], "bad_magic"),
        (GOOD[:4] + struct.pack("<H", 2) + GOOD[6:], "bad_version"),
        (encode_frame_message(picture(1, 0, 16, 20)), "wrong_size"),
        (encode_frame_message(picture(1, 0, 20, 32)), "wrong_size"),
    ],
)
def test_a_message_that_is_no_picture_of_this_camera_is_rejected(data: bytes, reason: str):
    reject = decode_frame_message(data, camera_of(), 7)
    assert isinstance(reject, Reject)
    assert (reject.t_ns, reject.source, reject.reason) == (7, "camera", reason)


@given(st.binary(max_size=100))
def test_any_bytes_are_a_picture_or_a_reject(data: bytes):
    assert isinstance(decode_frame_message(data, camera_of(), 0), Reject)


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 3))])
def test_only_pictures_can_be_sent(image: np.ndarray):
    with pytest.raises(ValueError, match="uint8"):
        encode_frame_message(CameraFrame(0, 0, image))


def test_stamps_are_brought_to_the_companions_base_and_have_to_be_timely():
    receiver, now_ns, ahead_ns = CameraReceiver(camera_of()), 100 * S, 5000 * S

    def receive(age_ns: int, offset_ns: int | None) -> CameraFrame | Reject:
        return receiver.receive(encode_frame_message(picture(1, now_ns + ahead_ns - age_ns)), now_ns, offset_ns)

    frame = receive(S // 50, ahead_ns)
    assert isinstance(frame, CameraFrame)
    assert frame.t_ns == now_ns - S // 50
    cases = ((0, None, "no_timesync"), (3 * S, ahead_ns, "stale_stamp"), (-S, ahead_ns, "future_stamp"))
    for age_ns, offset_ns, reason in cases:
        reject = receive(age_ns, offset_ns)
        assert isinstance(reject, Reject)
        assert reject.reason == reason


def test_gaps_in_the_sequence_are_counted():
    receiver = CameraReceiver(camera_of())
    for sequence in (1, 2, 5, 6, 0, 1):  # the camera starts again at 0
        receiver.receive(encode_frame_message(picture(sequence)), 0, 0)
    assert receiver.missed == 2


def until(
    poll: Callable[[], list[Event]], enough: Callable[[list[Event]], bool], also: Callable[[], None]
) -> list[Event]:
    got: list[Event] = []
    end = time.monotonic() + 3.0
    while not enough(got) and time.monotonic() < end:
        also()
        got += poll()
        time.sleep(0.002)
    return got


def test_pictures_cross_a_socket_and_wrong_ones_are_counted():
    endpoint, clock = free_endpoint(), SimulatedClock(50 * S)
    camera = open_camera(endpoint, camera_of(), clock, lambda: 3 * S)  # before there is anybody: no error
    assert list(camera.poll()) == []
    sender = ZmqFrameSender(endpoint)
    sent = {i: picture(i, 53 * S) for i in range(5)}
    got = until(lambda: list(camera.poll()), lambda g: len(g) >= 3, lambda: sender.send(sent[2]))
    assert all(isinstance(event, CameraFrame) for event in got)
    assert np.array_equal(got[0].image, sent[2].image)
    assert got[0].t_ns == 50 * S
    big = picture(9, 53 * S, 64, 40)
    got = until(lambda: list(camera.poll()), lambda g: any(isinstance(e, Reject) for e in g), lambda: sender.send(big))
    assert got[-1].reason == "wrong_size"
    for end in (camera, sender, camera, sender):
        end.close()
    assert list(camera.poll()) == []


def test_a_slow_companion_gets_the_newest_picture():
    endpoint, clock = free_endpoint(), SimulatedClock(0)
    sender = ZmqFrameSender(endpoint)
    camera = ZmqCamera(endpoint, camera_of(), clock, lambda: 0)
    until(camera.poll, bool, lambda: sender.send(picture(1)))
    time.sleep(0.02)
    camera.poll()
    for sequence in range(2, 12):
        sender.send(picture(sequence))
        time.sleep(0.005)
    time.sleep(0.05)
    events = [*camera.poll(), *camera.poll()]
    assert [event.sequence for event in events if isinstance(event, CameraFrame)] == [11]
    camera.close()
    sender.close()


@pytest.mark.parametrize("spec", ["", "webcam", "/dev/video0", "udp://127.0.0.1:5600", "tcp:127.0.0.1:5600"])
def test_an_unknown_source_is_one_clear_line(spec: str):
    with pytest.raises(ConfigError, match=f"camera '{spec}': unknown source; use tcp://"):
        open_camera(spec, camera_of(), SimulatedClock(), lambda: 0)


@pytest.mark.parametrize("spec", ["tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:no", "tcp://127.0.0.1:70000"])
def test_an_endpoint_that_cannot_be_is_one_clear_line(spec: str):
    with pytest.raises(ConfigError, match=f"camera '{spec}': not tcp://HOST:PORT"):
        open_camera(spec, camera_of(), SimulatedClock(), lambda: 0)
    with pytest.raises(ConfigError, match=f"camera '{spec}': not tcp://HOST:PORT"):
        ZmqFrameSender(spec)


def test_an_address_of_another_machine_cannot_be_bound():
    with pytest.raises(ConfigError, match=r"camera 'tcp://192\.0\.2\.1:5600': cannot be bound"):
        ZmqFrameSender("tcp://192.0.2.1:5600")


def test_a_busy_port_names_the_remedy():
    endpoint = free_endpoint()
    first = ZmqFrameSender(endpoint)
    with pytest.raises(ConfigError, match=f"camera '{endpoint}': the port is in use; stop the other program"):
        ZmqFrameSender(endpoint)
    first.close()
