"""What a fusion of GPS and vision is, whatever its method: the thesis' blend or the filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from companion.estimation.aircraft import Aligned
from companion.geometry import SE3, Mat, Vec
from companion.messages import Output, VisionOutput


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Predicted ``T_cam_tanker`` at an exposure; ``tracked`` when it rests on a vision just passed."""

    T_cam_tanker: SE3
    tracked: bool


@dataclass(frozen=True, slots=True, eq=False)
class Relative:
    """The fused estimate at one instant, in ``ned`` axes.

    ``p_ned_m`` (3,) from the tanker's centre of mass to the receiver's; ``dv_ned_m_s`` (3,) what to add to the
    receiver's velocity less the tanker's as the two INS tell them; ``R_correction`` (3, 3) turns the tanker's attitude
    as it is told to what it is against the receiver's INS: R_ned_tanker = R_correction R_told. ``T_frd_cam`` with the
    boresight as it is found. ``cov`` (12, 12) of position, velocity, the tanker's attitude against the receiver's INS
    as both are told at this instant, and the noise of the latter (left-hand rotations, ned axes).
    """

    aligned: Aligned
    p_ned_m: Vec
    dv_ned_m_s: Vec
    R_correction: Mat
    T_frd_cam: SE3
    cov: Mat
    estimate_ns: int
    sight_ns: int | None
    vision_weight: float
    markers_used: int


class Fusion(Protocol):
    """Reads an ``Aircraft`` (events have reached it before) and vision; gives priors and estimates. No clock."""

    @property
    def sight_ns(self) -> int | None:
        """Return the exposure of the newest frame from which vision was taken, None before the first."""

    def positions(self) -> list[Output]:
        """Take note that either aircraft has told a new position; return what follows for the record."""

    def prior(self, t_ns: int) -> Prior | None:
        """Return what is known of the tanker's pose at an exposure; None when the aircraft cannot be aligned."""

    def vision(self, seen: VisionOutput) -> list[Output]:
        """Take what was seen in one frame, with or without a pose; a FusedPose is among what is returned if it can."""

    def at(self, t_ns: int) -> Relative | None:
        """Return the estimate at an instant, or None when a source is missing or stale."""

    def restart(self) -> None:
        """Forget everything: time has stepped."""

    def shift(self, step_ns: int) -> None:
        """Move all instants: our clock has stepped, and the samples of the aircraft with it."""
