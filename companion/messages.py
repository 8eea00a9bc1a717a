"""What flows through the pipeline: frozen events in, frozen outputs out.

Rules
-----
* Every message carries ``t_ns``: integer nanoseconds on the companion's time base, the instant at which its content
  was true (mid-exposure, time of fix), never the instant of arrival.
* SI units and radians. Frames are in the names (see ``companion.geometry``).
* A message is valid once built: adapters check finite values and ranges first, and send a ``Reject`` instead of a
  message that does not hold.
* What was not measured is absent (None), never zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from companion.geometry import SE3, Mat, Vec

NS = 1e-9
"""Seconds in a nanosecond."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """One picture. ``image`` (h, w, 3) uint8 RGB; ``t_ns`` mid-exposure."""

    t_ns: int
    sequence: int
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Marker candidates of one frame.

    Centroids ``uv_px`` (m, 2), x right, y down, pixel centres at integers; ``area_px`` (m,) lit; ``sigma_px`` (m,)
    standard deviation per axis; ``flags`` (m,) what is odd about them (``companion.vision.detection.Flag``).
    """

    t_ns: int
    uv_px: Mat
    area_px: Vec
    sigma_px: Vec
    flags: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class MarkerFrame:
    """What a camera saw that hands over its detections instead of a picture; ``t_ns`` mid-exposure."""

    t_ns: int
    sequence: int
    detections: Detections


@dataclass(frozen=True, slots=True, eq=False)
class OwnAttitude:
    """Receiver's attitude from its INS: ``R_ned_frd`` (3, 3), body rates ``omega_frd_rad_s`` (3,)."""

    t_ns: int
    R_ned_frd: Mat
    omega_frd_rad_s: Vec


@dataclass(frozen=True, slots=True, eq=False)
class OwnPosition:
    """Receiver's GPS/INS position and inertial velocity of its centre of mass, in ``ned``."""

    t_ns: int
    p_ned_m: Vec
    v_ned_m_s: Vec


@dataclass(frozen=True, slots=True, eq=False)
class TankerState:
    """What the tanker tells of itself over the datalink: the 12 states of thesis 3.2 as one rigid-body state."""

    t_ns: int
    p_ned_m: Vec
    v_ned_m_s: Vec
    R_ned_tanker: Mat
    omega_tanker_rad_s: Vec


@dataclass(frozen=True, slots=True)
class GpsStatus:
    """What the receiver's GPS says of itself (GPS_RAW_INT): whether it has a three-dimensional fix."""

    t_ns: int
    has_fix: bool


@dataclass(frozen=True, slots=True)
class TimeStep:
    """The clock that stamps ``source`` has stepped against ours: stamps come ``step_ns`` later than they did before.

    ``continuous``: its own stamps follow on one another all the while, so that it is ours that has gone on without the
    world (a machine held up): what was stamped before moves by ``step_ns``, and stays true. Else (a reboot) nothing
    that was stamped before can be put beside what comes now.
    """

    t_ns: int
    source: str
    step_ns: int
    continuous: bool = False


class AutopilotMode(StrEnum):
    """What the autopilot says it does with setpoints."""

    UNKNOWN = "unknown"
    MANUAL = "manual"
    GUIDED = "guided"


@dataclass(frozen=True, slots=True)
class AutopilotStatus:
    """Content of the autopilot's HEARTBEAT that guidance needs."""

    t_ns: int
    mode: AutopilotMode
    armed: bool


class Command(StrEnum):
    """What an operator can ask for; ``pre_contact`` and ``contact`` clear the receiver to go there."""

    ENGAGE = "engage"
    PRE_CONTACT = "pre_contact"
    CONTACT = "contact"
    DISCONNECT = "disconnect"
    BREAKAWAY = "breakaway"
    CLEAR = "clear"
    REAL_VISION = "real_vision"
    SIMULATED_VISION = "simulated_vision"


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """An operator's command, from MAVLink or the command line."""

    t_ns: int
    command: Command


@dataclass(frozen=True, slots=True)
class Tick:
    """A guidance step is due at ``t_ns``."""

    t_ns: int


@dataclass(frozen=True, slots=True)
class Reject:
    """Bad input that was dropped: counted by (source, reason); ``detail`` is for people."""

    t_ns: int
    source: str
    reason: str
    detail: str = ""


Event = (
    CameraFrame | MarkerFrame | OwnAttitude | OwnPosition | GpsStatus | TankerState | TimeStep | AutopilotStatus
    | OperatorCommand | Tick | Reject
)


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """Pose of the tanker in the camera from one frame (thesis ^C T_T).

    ``labels`` (n,) index into the frame's detections for each marker of the map, -1 where unlabelled;
    ``object_error_m`` RMS object-space error; ``image_error`` RMS on the plane z = 1. ``cov`` (6, 6) of (translation in
    m, rotation in rad), camera axes: R_true = exp(rotation) R, t_true = t + translation.
    ``alternative`` is a second pose that fits nearly as well, where there is one and no prior told them apart.
    """

    t_ns: int
    T_cam_tanker: SE3
    labels: NDArray[np.int64]
    markers_used: int
    iterations: int
    object_error_m: float
    image_error: float
    cov: Mat
    alternative: SE3 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class VisionOutput:
    """Everything that the vision chain found in one frame; ``pose`` is None when ``reject`` says why not.

    ``labels`` (n,) as of ``PoseMeasurement``, verified: also there when they were too few for a pose.
    """

    t_ns: int
    sequence: int
    detections: Detections
    predicted_uv_px: Mat
    labels: NDArray[np.int64]
    pose: PoseMeasurement | None
    reject: Reject | None


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """Blend of GPS and vision at the instant of an exposure (thesis eq. 3.9): the next frame's prior."""

    t_ns: int
    T_cam_tanker: SE3
    T_cam_tanker_gps: SE3
    vision_weight: float
    markers_used: int


@dataclass(frozen=True, slots=True)
class FilterUpdate:
    """One measurement before the filter: normalised innovation squared, its degrees of freedom, and what came of it.

    ``source``: ``gps``, ``pixels``, ``pose_attitude``, ...; ``reason`` is empty when it was taken.
    """

    t_ns: int
    source: str
    nis: float
    dof: int
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The filter's estimate at one instant, for integrity and for the record.

    ``x`` and ``sigma`` (16,), in the order of ``companion.estimation.filter_state.NAMES``: corrections that the filter
    adds to what the sensors say, and their standard deviations; ``cov`` (16, 16).
    """

    t_ns: int
    x: Vec
    sigma: Vec
    cov: Mat


@dataclass(frozen=True, slots=True)
class Sources:
    """Instant of the newest valid sample of each source, None when there has been none; ``sight``: a pose or labels
    that fusion took."""

    attitude_ns: int | None = None
    position_ns: int | None = None
    tanker_ns: int | None = None
    sight_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RelativeState:
    """Where the receiver is relative to the box, at one instant; what guidance flies on.

    ``p_mrf_br_m`` (3,) vector from box B to receptacle R; ``v_mrf_br_m_s`` (3,) velocity of the receiver's centre of
    mass against the box, as seen in the turning frame. ``v_ned_box_m_s``, ``a_ned_box_m_s2`` (3,) inertial velocity and
    acceleration of the box; ``heading0_rad`` nominal heading of the tanker (the frame's), ``turn_rate_rad_s`` its rate.
    ``range_m`` camera to tanker origin. ``estimate_t_ns`` instant of the oldest sample that the estimate rests on.
    ``cov_mrf_br_m2`` (3, 3) covariance of ``p_mrf_br_m``, as far as the fusion knows it.
    """

    t_ns: int
    estimate_t_ns: int
    p_mrf_br_m: Vec
    v_mrf_br_m_s: Vec
    v_ned_box_m_s: Vec
    a_ned_box_m_s2: Vec
    R_ned_frd: Mat
    omega_frd_rad_s: Vec
    heading0_rad: float
    turn_rate_rad_s: float
    T_cam_tanker: SE3
    range_m: float
    vision_weight: float
    markers_used: int
    cov_mrf_br_m2: Mat


@dataclass(frozen=True, slots=True, eq=False)
class Integrity:
    """How far the estimate can be trusted, at one instant.

    ``protection_mrf_m`` (3,): BR is within so much of the estimate per axis of ``mrf``, but for the risk of the
    configuration; ``alert_mrf_m`` (3,): what it may be at most. ``may_dock``: it is inside, and no test fails.
    ``faults``: the tests that fail, by name, none when all is well: any of them takes ``may_dock`` away. ``notes``:
    what is not as it should be and does not; but with ``unseen``, no sight to judge by, ``stale <source>``, and
    ``unsettled``, neither of them long ago or a frame that the filter refused, ``may_dock`` is false.
    """

    t_ns: int
    protection_mrf_m: Vec
    alert_mrf_m: Vec
    may_dock: bool
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StageHealth:
    """One stage: there at all, used in the present phase, and doing what it should; ``detail`` for people."""

    name: str
    present: bool
    enabled: bool
    healthy: bool
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Health:
    """All stages; told when one changes."""

    t_ns: int
    stages: tuple[StageHealth, ...]

    @property
    def well(self) -> bool:
        """Whether every stage that is used does what it should."""
        return all(stage.healthy for stage in self.stages if stage.enabled)


@dataclass(frozen=True, slots=True)
class InputLatency:
    """How late an input's content is when it arrives, running: mean, spread, worst of the last seconds.

    ``cost_m``: how far the receiver moves in the mean latency, what ignoring it would cost.
    """

    t_ns: int
    source: str
    mean_s: float
    jitter_s: float
    worst_s: float
    cost_m: float


class Phase(StrEnum):
    """Phases of a refuelling approach; rules in ``companion.guidance.modes``."""

    STANDBY = "standby"
    SELF_TEST = "self_test"
    JOIN = "join"
    OBSERVATION = "observation"
    PRE_CONTACT = "pre_contact"
    APPROACH = "approach"
    CONTACT = "contact"
    HOLD = "hold"
    DISCONNECT = "disconnect"
    BREAKAWAY = "breakaway"


@dataclass(frozen=True, slots=True)
class PhaseChange:
    """The phase machine moved."""

    t_ns: int
    old: Phase
    new: Phase
    reason: str


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """Attitude and thrust for the autopilot: roll, pitch, yaw in rad (``ned`` to body), thrust 0..1."""

    t_ns: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    thrust: float


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """Inertial velocity (3,) in ``ned`` for the autopilot's own velocity loop, and the heading to point at.

    ``a_ned_m_s2`` (3,) is how that velocity changes: what to fly before any error shows.
    """

    t_ns: int
    v_ned_m_s: tuple[float, float, float]
    yaw_rad: float
    a_ned_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class OffsetSetpoint:
    """Where to be as seen from where the receiver is, for an autopilot that closes the position loop itself.

    ``offset_ned_m`` (3,) from the receptacle to where it should be now; ``v_ned_m_s`` (3,) the inertial velocity of
    that place; ``yaw_rad`` the nominal heading of the formation, the psi frame's.
    """

    t_ns: int
    offset_ned_m: tuple[float, float, float]
    v_ned_m_s: tuple[float, float, float]
    yaw_rad: float


Setpoint = AttitudeSetpoint | VelocitySetpoint | OffsetSetpoint
"""What laws ``attitude``, ``velocity`` and ``surfaces`` send."""


@dataclass(frozen=True, slots=True, eq=False)
class GuidanceOutput:
    """One guidance step: the reference of the path and the error against it, for the record."""

    t_ns: int
    phase: Phase
    reference_mrf_m: Vec
    error_mrf_m: Vec
    integral_mrf_m_s: Vec
    setpoint: Setpoint | None


class VisionMode(StrEnum):
    """Where labelled markers come from (thesis 4.2.5): the picture, or the projection of what GPS and INU say."""

    REAL = "rv"
    SIMULATED = "sv"


@dataclass(frozen=True, slots=True)
class VisionModeChange:
    """An operator switched between real and simulated vision."""

    t_ns: int
    mode: VisionMode


Output = (
    VisionOutput | FusedPose | FilterUpdate | FilterState | RelativeState | Integrity | PhaseChange | GuidanceOutput
    | Setpoint | Health | InputLatency | VisionModeChange | Reject
)
