"""An analytic flight for the recorder's tests: a cubic approach and a hold with small motion, no solver, no noise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from companion.config import (
    FIRMWARE_CONFIGS,
    AirframeConfig,
    AttitudeResponse,
    CameraConfig,
    CompanionConfig,
    Setup,
    TankerConfig,
    TrimConfig,
    load,
)
from companion.geometry import SE3, Mat, Vec, exp_so3, rotation_from_euler
from companion.messages import (
    AttitudeSetpoint,
    CameraFrame,
    Detections,
    Event,
    FilterState,
    FilterUpdate,
    FusedPose,
    GpsStatus,
    GuidanceOutput,
    Health,
    InputLatency,
    Integrity,
    Output,
    OwnAttitude,
    OwnPosition,
    Phase,
    PhaseChange,
    PoseMeasurement,
    Reject,
    RelativeState,
    StageHealth,
    TankerState,
    Tick,
    TimeStep,
    VisionMode,
    VisionModeChange,
    VisionOutput,
)
from companion.vision.camera import T_frd_cam, project
from sim_bridge.plant.boom import nominal_boom
from sim_bridge.truth import BodyState, Truth

HEADING = 0.4
SPEED_M_S = 206.0
JOINED_S, ARRIVED_S, HOLD_FROM_S = 3.0, 28.0, 30.0
START_MRF_M = np.array([-25.0, -20.0, 22.0])
PHASES = (
    (0.5, Phase.SELF_TEST), (1.0, Phase.JOIN), (JOINED_S, Phase.OBSERVATION), (3.5, Phase.PRE_CONTACT),
    (4.0, Phase.APPROACH), (ARRIVED_S, Phase.CONTACT), (HOLD_FROM_S, Phase.HOLD),
)
"""When each phase is entered, in s."""
GPS_BIAS_M = np.array([0.8, -0.5, 1.6])
ALERT_M = np.array([0.4, 0.5, 0.5])


def synthetic_setup() -> Setup:
    """The shipped camera and tanker with a receiver of plain numbers."""
    airframe = AirframeConfig(
        name="synthetic", receptacle_frd_m=(1.0, 0.0, -0.9), mass_kg=16000.0,
        trim=TrimConfig(airspeed_m_s=SPEED_M_S, altitude_m=6000.0, alpha_rad=0.05, throttle=0.3, effectors=(0.3,) * 10),
        response=AttitudeResponse(roll_rad_s=2.0, roll_damping=0.8, pitch_rad_s=2.0, pitch_damping=0.8,
                                  thrust_lag_s=1.0, delay_s=0.05),
        A=((0.0,) * 9,) * 9, B=((0.0,) * 10,) * 9,
    )  # fmt: skip
    return Setup(
        config=CompanionConfig(camera="c.toml", tanker="t.toml", airframe="a.toml"),
        camera=load(FIRMWARE_CONFIGS / "cameras/default.toml", CameraConfig),
        tanker=load(FIRMWARE_CONFIGS / "tankers/kc135r.toml", TankerConfig),
        airframe=airframe,
    )


class Flight:
    """Poses of both aircraft as functions of time."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.R_ned_mrf = rotation_from_euler(HEADING, 0.0, 0.0)
        self.box = np.array(setup.tanker.box_tanker_m)
        self.receptacle = np.array(setup.airframe.receptacle_frd_m)
        self.T_frd_cam = T_frd_cam(setup.camera)

    def reference(self, t: float) -> Vec:
        """Path (3,) in mrf from the start to B."""
        s = np.clip((t - JOINED_S) / (ARRIVED_S - JOINED_S), 0.0, 1.0)
        return START_MRF_M * (1.0 - s * s * (3.0 - 2.0 * s))

    def br(self, t: float) -> Vec:
        """BR (3,) in mrf."""
        sway = np.array([0.25 * np.sin(0.9 * t), 0.3 * np.sin(0.5 * t + 1.0), 0.2 * np.sin(0.7 * t)])
        return self.reference(t) + sway

    def tanker(self, t: float) -> SE3:
        """T_ned_tanker."""
        p_mrf = np.array([SPEED_M_S * t, 0.0, -6000.0])
        R_mrf_tanker = rotation_from_euler(0.0, 0.03 + 0.004 * np.sin(0.4 * t), 0.01 * np.sin(0.6 * t))
        return SE3(self.R_ned_mrf @ R_mrf_tanker, self.R_ned_mrf @ p_mrf)

    def uav(self, t: float) -> SE3:
        """T_ned_frd, such that the receptacle is at B + BR."""
        T_ned_tanker = self.tanker(t)
        R_ned_frd = self.R_ned_mrf @ rotation_from_euler(0.0, 0.05 + 0.01 * np.sin(0.8 * t), 0.05 * np.sin(0.5 * t))
        receptacle = T_ned_tanker.transform(self.box) + self.R_ned_mrf @ self.br(t)
        return SE3(R_ned_frd, receptacle - R_ned_frd @ self.receptacle)

    def T_cam_tanker(self, t: float) -> SE3:
        """Pose of the tanker in the camera."""
        return (self.uav(t) @ self.T_frd_cam).inverse() @ self.tanker(t)

    def seen(self, t: float) -> tuple[Mat, np.ndarray]:
        """Where markers are in the picture (n, 2), and which they are (n,)."""
        c = self.setup.camera
        uv = project(c, self.T_cam_tanker(t), np.array([m.p_tanker_m for m in self.setup.tanker.markers]))
        inside = np.flatnonzero(((uv > 2) & (uv < [c.width_px - 3, c.height_px - 3])).all(axis=1))
        return uv[inside], inside

    def picture(self, t: float) -> np.ndarray:
        """Sky with red discs."""
        c = self.setup.camera
        sky = np.linspace(0.0, 1.0, c.height_px)[:, None, None] * np.array([40, 50, 30]) + np.array([110, 140, 190])
        image = np.ascontiguousarray(np.broadcast_to(sky, (c.height_px, c.width_px, 3)).astype(np.uint8))
        for u, v in self.seen(t)[0]:
            cv2.circle(image, (round(16 * u), round(16 * v)), 16 * 2, (230, 30, 30), -1, cv2.LINE_AA, 4)
        return image


def messages(setup: Setup, duration_s: float, *, pictures: bool = True) -> Iterator[tuple[str, Event | Output]]:
    """Yield ("in" or "out", message) of a whole flight in the order of time, at the rates of the real one."""
    flight = Flight(setup)
    phase = Phase.STANDBY
    for k in range(round(duration_s * 100)):
        t, t_ns = k * 0.01, k * 10_000_000
        yield "in", OwnAttitude(t_ns, flight.uav(t).R, np.zeros(3))
        if k % 2 == 0:
            due = phase_at(t)
            if due is not phase:
                yield "out", PhaseChange(t_ns, phase, due, "by the clock")
                phase = due
            yield from guidance_step(flight, t_ns, phase)
        if k % 5 == 0:
            yield "in", OwnPosition(t_ns, flight.uav(t).t, flight.R_ned_mrf @ [SPEED_M_S, 0.0, 0.0])
            if pictures:
                yield "in", CameraFrame(t_ns, k // 5, flight.picture(t))
            yield from camera_step(flight, t_ns, k // 5)
        if k % 4 == 0:
            T = flight.tanker(t)
            yield "in", TankerState(t_ns, T.t, flight.R_ned_mrf @ [SPEED_M_S, 0.0, 0.0], T.R, np.zeros(3))
            yield "out", FilterUpdate(t_ns, "gps", 3.0 + 2.0 * np.sin(37.0 * t), 3, "gate" if k % 200 == 96 else "")
        if k == 50:
            yield "in", TimeStep(t_ns, "autopilot", 20_000_000)
            yield "out", VisionModeChange(t_ns, VisionMode.SIMULATED)
        if k % 100 == 0:
            yield from once_a_second(t_ns)
        if k % 310 == 0:
            yield "out", Reject(t_ns, "datalink", "checksum", "frame of 55 bytes")


def phase_at(t: float) -> Phase:
    """The phases of the flight."""
    return next((phase for entered_s, phase in reversed(PHASES) if t >= entered_s), Phase.STANDBY)


def once_a_second(t_ns: int) -> Iterator[tuple[str, Event | Output]]:
    """What the GPS says, how late inputs come, and, when it changes, how all stages are."""
    t = t_ns / 1e9
    yield "in", GpsStatus(t_ns, has_fix=True)
    for source, mean_s in (("attitude", 0.004), ("camera", 0.021), ("datalink", 0.034)):
        yield "out", InputLatency(t_ns, source, mean_s, 0.001, 2.0 * mean_s, SPEED_M_S * mean_s)
    if t in (0.0, 3.0, 5.0):
        yield "out", health(t_ns)


def health(t_ns: int) -> Health:
    """All well from the first second on, but for the datalink from the third to the fifth."""
    ill = t_ns == 3_000_000_000
    datalink = StageHealth("datalink", present=True, enabled=True, healthy=not ill, detail="stale for 0.5 s" * ill)
    return Health(t_ns, (
        StageHealth("camera", present=True, enabled=t_ns > 0, healthy=True), datalink,
        StageHealth("gps", present=t_ns > 0, enabled=False, healthy=t_ns > 0),
    ))  # fmt: skip


def integrity(t_ns: int) -> Integrity:
    """Protection that comes down as the receiver closes in, with a test that fails now and then at first."""
    protection = np.array([0.30, 0.14, 0.20]) * (1.0 + 4.0 * np.exp(-t_ns / 8e9))
    if t_ns == 0:
        return Integrity(t_ns, np.full(3, np.inf), ALERT_M, may_dock=False, faults=("unseen",))
    faults = ("gps_vision",) if 6e9 < t_ns < 7e9 else ()
    inside = bool((protection < ALERT_M).all())
    return Integrity(t_ns, protection, ALERT_M, may_dock=inside and not faults, faults=faults)


def filter_state(t_ns: int) -> FilterState:
    """Biases that are found within seconds."""
    found = 1.0 - np.exp(-t_ns / 5e9)
    x = np.concatenate([np.zeros(9), found * GPS_BIAS_M, found * np.array([0.002, -0.004, 0.001]), [0.012 * found]])
    loose = np.repeat([0.1, 0.05, 0.002, 1.0, 0.01], 3)
    sigma = np.append(loose, 0.02) * (0.05 + np.exp(-t_ns / 5e9))
    return FilterState(t_ns, x, sigma, np.diag(sigma**2))


def guidance_step(flight: Flight, t_ns: int, phase: Phase) -> Iterator[tuple[str, Event | Output]]:
    """A tick, the estimate, what guidance made of it."""
    t = t_ns / 1e9
    T_cam_tanker, heading = flight.T_cam_tanker(t), HEADING
    yield "in", Tick(t_ns)
    yield "out", RelativeState(
        t_ns, t_ns, flight.br(t) + 0.04 * np.sin(np.array([3.0, 4.0, 5.0]) * t), np.zeros(3), np.zeros(3),
        np.zeros(3), flight.uav(t).R, np.zeros(3), heading, 0.0, T_cam_tanker,
        float(np.linalg.norm(T_cam_tanker.t)), weight(t), 8, 0.01 * np.eye(3),
    )  # fmt: skip
    yield "out", integrity(t_ns)
    setpoint = AttitudeSetpoint(t_ns, 0.05 * np.sin(0.5 * t), 0.05 + 0.01 * np.sin(0.8 * t), HEADING, 0.3)
    reference = flight.reference(t)
    yield "out", GuidanceOutput(t_ns, phase, reference, flight.br(t) - reference, np.zeros(3), setpoint)
    yield "out", setpoint


def camera_step(flight: Flight, t_ns: int, sequence: int) -> Iterator[tuple[str, Event | Output]]:
    """What vision made of a picture; now and then one without a pose."""
    t = t_ns / 1e9
    uv, marker = flight.seen(t)
    T = flight.T_cam_tanker(t)
    markers = flight.setup.tanker.markers
    labels = np.full(len(markers), -1)
    labels[marker] = np.arange(len(marker))
    pose = None if sequence % 50 == 49 else PoseMeasurement(t_ns, T, labels, len(marker), 5, 0.02, 1e-4, np.eye(6))
    reject = Reject(t_ns, "vision", "too_few_markers", "4 of 5") if pose is None else None
    off = SE3(exp_so3(np.array([0.0, 0.003, 0.0])) @ T.R, T.t)
    predicted = project(flight.setup.camera, off, np.array([m.p_tanker_m for m in markers]))
    m = len(uv)
    detections = Detections(t_ns, uv, np.full(m, 12.0), np.full(m, 0.1), np.zeros(m, np.uint8))
    yield "out", VisionOutput(t_ns, sequence, detections, predicted, labels, pose, reject)
    yield "out", FusedPose(t_ns, T, T, weight(t), len(marker))
    yield "out", FilterUpdate(t_ns, "pixels", 2.0 * m + 3.0 * np.sin(11.0 * t), 2 * m)
    yield "out", filter_state(t_ns)


def weight(t: float) -> float:
    """Share of vision in the blend."""
    return float(np.clip((t - 8.0) / 8.0, 0.0, 1.0))


def record(recorder: object, setup: Setup, duration_s: float) -> None:
    """Feed a whole flight to a recorder."""
    for direction, message in messages(setup, duration_s):
        (recorder.event if direction == "in" else recorder.output)(message)  # type: ignore[attr-defined]


def truths(setup: Setup, duration_s: float) -> Iterator[tuple[Truth, Vec]]:
    """Yield what really happened and BR, at 50 Hz."""
    flight = Flight(setup)
    boom = nominal_boom(setup.tanker.boom)
    for k in range(round(duration_s * 50)):
        t = k * 0.02
        yield Truth(k * 20_000_000, body(flight.uav(t), k), body(flight.tanker(t), k), boom, np.zeros(10)), flight.br(t)


def body(T: SE3, k: int) -> BodyState:
    """A body at a pose, on the tanker's course."""
    v = rotation_from_euler(HEADING, 0.0, 0.0) @ [SPEED_M_S, 0.0, 0.0]
    return BodyState(k * 20_000_000, T.t, v, T.R, np.zeros(3), np.zeros(3), np.zeros(3))


if __name__ == "__main__":
    import sys

    from companion.io.recorder import RunRecorder
    from sim_bridge.truth_log import TruthLog

    folder = Path(sys.argv[1])
    folder.mkdir(parents=True)
    with RunRecorder(folder, synthetic_setup()) as recorder, TruthLog(folder, synthetic_setup()) as truth_log:
        record(recorder, synthetic_setup(), 110.0)
        for truth, br in truths(synthetic_setup(), 110.0):
            truth_log.append(truth, br)
