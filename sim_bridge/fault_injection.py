"""All faults of one flight, put where they work: what ``Simulation`` passes everything through.

Without faults everything passes as it is, and nothing is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from companion.config import LinksConfig, Setup
from companion.geometry import SE3, Mat, exp_so3
from companion.io.mavlink_codec import MavlinkCodec, dialect
from companion.messages import NS, Phase
from companion.vision.camera import T_frd_cam
from sim_bridge.autopilot.telemetry import boot_ms
from sim_bridge.fault_crafts import ATTITUDE, HEARTBEAT, POSITION, DatalinkCraft, FrameCraft, GpsCraft, MavlinkCraft
from sim_bridge.fault_streams import Tamper, Window
from sim_bridge.faults import Fault
from sim_bridge.sensors import GpsFix
from sim_bridge.truth import BodyState

TELEMETRY: dict[str, frozenset[int]] = {
    "attitude": frozenset((ATTITUDE,)),
    "position": frozenset((POSITION,)),
    "heartbeat": frozenset((HEARTBEAT,)),
    "link": frozenset((ATTITUDE,)),
    "clock": frozenset((ATTITUDE, POSITION)),
}
"""Which messages of the autopilot a fault of a target changes."""

CLOCKED = frozenset((
    ATTITUDE, POSITION, dialect.MAVLINK_MSG_ID_TIMESYNC, dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT, dialect.MAVLINK_MSG_ID_HIGHRES_IMU, dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
))
"""Messages that carry the autopilot's clock."""

OUT_OF_SIGHT_M = (-1000.0, 0.0, 0.0)
"""Where a light that is out is put: behind the receiver."""
MOVED_LIGHT = 2

PHASE_TEXT = "phase "
"""How the companion's STATUSTEXT on a change of phase begins."""


class Faults:
    """The faults of a scenario in one flight."""

    def __init__(self, faults: Sequence[Fault], setup: Setup, seeds: np.random.SeedSequence) -> None:
        """Give each fault a stream of chance of its own."""
        self._faults = [(fault, Window(fault)) for fault in faults]
        rngs = [np.random.default_rng(s) for s in (seeds.spawn(len(faults)) if faults else [])]
        links, camera = setup.config.links, setup.camera
        crafts: dict[str, Any] = {
            "camera": FrameCraft(camera.width_px, camera.height_px), "datalink": DatalinkCraft(), "gps": GpsCraft(),
        }
        self._tampers: list[list[Tamper[Any]]] = [[] for _ in faults]
        self._seen = [0] * len(faults)
        self._mavlink: list[tuple[frozenset[int], Tamper[bytes]]] = []
        self._vehicles: list[tuple[int, Window, SecondVehicle]] = []
        self._streams: dict[str, list[Tamper[Any]]] = {"camera": [], "datalink": [], "gps": []}
        for k, ((fault, window), rng) in enumerate(zip(self._faults, rngs, strict=True)):
            if fault.kind == "second_vehicle":
                self._vehicles.append((k, window, SecondVehicle(links)))
            elif fault.target in TELEMETRY:
                craft = MavlinkCraft(links.system_id, links.autopilot_component_id)
                kinds = CLOCKED if fault.kind == "step" else TELEMETRY[fault.target]
                tamper: Tamper[Any] = Tamper(fault, window, craft, rng)
                self._mavlink.append((kinds, tamper))
                self._tampers[k].append(tamper)
            streams = [fault.target] if fault.target in crafts and fault.kind != "boresight" else []
            for name in ("camera", "datalink") if fault.kind == "step" else streams:
                self._streams[name].append(Tamper(fault, window, crafts[name], rng))
                self._tampers[k].append(self._streams[name][-1])
        self._reader = MavlinkCodec(255, 1)
        self._listener = MavlinkCodec(255, 1)
        self._T_frd_cam = T_frd_cam(camera)
        self._lights = np.array([m.p_tanker_m for m in setup.tanker.markers], dtype=np.float64)

    @property
    def began_ns(self) -> int | None:
        """Return when the first of the faults begins, once that is known; None without any."""
        known = [window.begin_ns for _, window in self._faults if window.begin_ns is not None]
        return min(known, default=None)

    @property
    def touched(self) -> tuple[int, ...]:
        """Return how many samples each fault has changed, held up or left out; instants for what the camera sees."""
        return tuple(seen + sum(tamper.touched for tamper in tampers)
                     for seen, tampers in zip(self._seen, self._tampers, strict=True))

    def phase_entered(self, phase: Phase, t_ns: int) -> None:
        """Take note that the companion is in a phase; the first time counts."""
        for _, window in self._faults:
            window.phase_entered(phase, t_ns)

    def overhear(self, data: bytes, t_ns: int) -> None:
        """Learn the companion's phase from its STATUSTEXT, as a ground station does."""
        if all(window.begin_ns is not None for _, window in self._faults):
            return
        for message, _ in self._listener.feed(data):
            text = message.text if message.get_type() == "STATUSTEXT" else ""
            name = text.removeprefix(PHASE_TEXT).partition(":")[0]
            if text.startswith(PHASE_TEXT) and name in list(Phase):
                self.phase_entered(Phase(name), t_ns)

    def mavlink(self, data: bytes, t_ns: int) -> bytes:
        """Return what of the autopilot's telemetry arrives, and what else does on that link."""
        others = b""
        for k, window, vehicle in self._vehicles:
            if window.elapsed_s(t_ns) is not None:
                sent = vehicle.outgoing(t_ns)
                self._seen[k] += sent != b""
                others += sent
        if not self._mavlink:
            return data + others
        frames = [frame for _, frame in self._reader.feed(data)]
        for kinds, tamper in self._mavlink:
            arriving = tamper.pass_on([], t_ns)
            for frame in frames:
                arriving += tamper.pass_on([frame], t_ns) if message_id(frame) in kinds else [frame]
            frames = arriving
        return b"".join(frames) + others

    def datalink(self, frame: bytes | None, t_ns: int) -> list[bytes]:
        """Return the frames that the tanker puts on its line in place of its own."""
        return self._passed("datalink", [] if frame is None else [frame], t_ns)

    def frames(self, frames: list[Any], t_ns: int) -> list[Any]:
        """Return the pictures or detections that arrive."""
        return self._passed("camera", frames, t_ns)

    def fix(self, fix: GpsFix | None, t_ns: int) -> GpsFix | None:
        """Return the fix that the autopilot's navigation gets, the newest when there are several."""
        fixes = self._passed("gps", [] if fix is None else [fix], t_ns)
        return fixes[-1] if fixes else None

    def _passed(self, name: str, samples: list[Any], t_ns: int) -> list[Any]:
        for tamper in self._streams[name]:
            samples = tamper.pass_on(samples, t_ns)
        return samples

    def lights(self, t_ns: int) -> Mat | None:
        """Return where the lights (n, 3) are in truth, tanker axes, m; None when they are where they belong."""
        places = None
        for k, (fault, window) in enumerate(self._faults):
            if fault.target != "lights" or window.elapsed_s(t_ns) is None:
                continue
            self._seen[k] += 1
            places = self._lights.copy() if places is None else places
            if fault.kind == "moved":
                places[MOVED_LIGHT, 1] += math.copysign(fault.amount, places[MOVED_LIGHT, 1])
            else:
                places[{"one": slice(1), "half": slice(None, None, 2), "all": slice(None)}[fault.kind]] = OUT_OF_SIGHT_M
        return places

    def camera_body(self, uav: BodyState) -> BodyState:
        """Return the receiver as the camera has it that has turned on its mount."""
        for k, (fault, window) in enumerate(self._faults):
            if fault.kind == "boresight" and window.elapsed_s(uav.t_ns) is not None:
                self._seen[k] += 1
                turned = self._T_frd_cam @ SE3(exp_so3(np.array([fault.amount, 0.0, 0.0])), np.zeros(3))
                T_frd_frd = turned @ self._T_frd_cam.inverse()
                T_ned_frd = uav.T_ned_body() @ T_frd_frd
                uav = msgspec.structs.replace(uav, p_ned_m=T_ned_frd.t, R_ned_body=T_ned_frd.R)
        return uav


def message_id(frame: bytes) -> int:
    """Return the id of a MAVLink 2 frame."""
    return int.from_bytes(frame[7:10], "little")


class SecondVehicle:
    """Another vehicle that has got on the link: a mile ahead, banked, in MANUAL, and it commands a breakaway."""

    SYSTEM_ID = 2
    ATTITUDE_NS, SECOND_NS = 20_000_000, 1_000_000_000
    BANK_RAD = 0.5

    def __init__(self, links: LinksConfig) -> None:
        self._codec = MavlinkCodec(self.SYSTEM_ID, 1)
        self._companion = (links.system_id, links.component_id)

    def outgoing(self, t_ns: int) -> bytes:
        """Return what it sends at an instant."""
        messages = []
        if t_ns % self.ATTITUDE_NS == 0:
            half = 0.5 * self.BANK_RAD
            messages.append(dialect.MAVLink_attitude_quaternion_message(
                boot_ms(t_ns), math.cos(half), math.sin(half), 0.0, 0.0, 0.0, 0.0, 0.0))
            messages.append(dialect.MAVLink_local_position_ned_message(
                boot_ms(t_ns), 206.0 * t_ns * NS + 1609.0, 0.0, 0.0, 206.0, 0.0, 0.0))
        if t_ns % self.SECOND_NS == 0:
            messages.append(dialect.MAVLink_heartbeat_message(
                dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_GENERIC, 0, 0, dialect.MAV_STATE_ACTIVE, 3))
            messages.append(dialect.MAVLink_command_long_message(
                *self._companion, dialect.MAV_CMD_USER_2, 0, 0, 0, 0, 0, 0, 0, 0))
        return b"".join(self._codec.pack(message) for message in messages)
