"""What the filter takes: differences of the two positions, and frames of labelled markers, each with its instant.

A measurement carries all that is needed to take it again later, when an older one has come in after it: the aircraft
at its instant are in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from companion.config import CameraConfig, FilterConfig
from companion.estimation.aircraft import Aligned
from companion.estimation.filter_noise import NO_GAPS, Gaps
from companion.estimation.filter_state import Offset
from companion.geometry import SE3, Mat, Vec
from companion.messages import Detections, VisionOutput

FEW_FOR_OFFSET = 4
"""A pose of fewer markers does not speak for itself when the filter refuses what it rests on."""


@dataclass(frozen=True, slots=True, eq=False)
class GpsDifference:
    """Receiver's less tanker's position at one instant, less the difference of travels: ``offset_m`` (3,), ned."""

    t_ns: int
    offset_m: Vec
    v_ned_tanker_m_s: Vec
    gaps: Gaps = NO_GAPS

    @property
    def order(self) -> tuple[int, int]:
        """Return where it stands among the measurements of a flight."""
        return self.t_ns, 0

    def shifted(self, step_ns: int) -> GpsDifference:
        """Return the same at another instant."""
        return replace(self, t_ns=self.t_ns + step_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The aircraft about one exposure, as ``filter_pixels.marker_rows`` takes them; ``noise`` as ``widened`` does.

    ``R_ned_cam`` (3, 3) by the receiver's INS and the nominal mount, ``lever_ned_m`` (3,) the camera from the
    receiver's centre of mass.
    """

    table: Mat
    noise: Mat
    R_ned_cam: Mat
    lever_ned_m: Vec
    travel_m: Vec
    v_ned_tanker_m_s: Vec
    gaps: Gaps = NO_GAPS


@dataclass(frozen=True, slots=True, eq=False)
class MarkerPixels:
    """Markers of the map ``ids`` (k,), their places ``markers`` (k, 3), where they were seen on z = 1 and how well."""

    ids: tuple[int, ...]
    markers: Mat
    uv: Mat
    sigma: Vec


@dataclass(frozen=True, slots=True, eq=False)
class PixelFrame:
    """One frame. ``labelled`` is None when nothing has a label; ``loose`` all detections then: (uv (m, 2), sigma (m,)).

    ``offset``: where its pose alone puts the receiver, less the difference of travels; ``range_m`` to the tanker.
    ``imagined``: markers that were projected, not seen (simulated vision): they tell nothing that GPS does not.
    """

    t_ns: int
    geometry: Geometry
    labelled: MarkerPixels | None
    loose: tuple[Mat, Vec] | None = None
    offset: Offset | None = None
    range_m: float = np.inf
    imagined: bool = False

    @property
    def order(self) -> tuple[int, int]:
        """Return where it stands among the measurements of a flight."""
        return self.t_ns, 1

    def shifted(self, step_ns: int) -> PixelFrame:
        """Return the same at another instant."""
        offset = None if self.offset is None else self.offset.shifted(step_ns)
        return replace(self, t_ns=self.t_ns + step_ns, offset=offset)

    @property
    def v_ned_tanker_m_s(self) -> Vec:
        """Return the tanker's velocity (3,) as it was told of the exposure."""
        return self.geometry.v_ned_tanker_m_s

    @property
    def gaps(self) -> Gaps:
        """Return what gaps had done to the travels by the exposure."""
        return self.geometry.gaps


Measurement = GpsDifference | PixelFrame


def gps_difference(a: Aligned, gaps: Gaps) -> GpsDifference:
    """Return what the two positions say at the instant of ``a``."""
    return GpsDifference(a.t_ns, a.p_ned_gps_m - a.travel_difference_m, a.tanker.v_ned_m_s, gaps)


def geometry_of(a: Aligned, T_frd_cam: SE3, noise: Mat, gaps: Gaps) -> Geometry:
    """Return the aircraft about an exposure; ``noise`` (9, 3) and ``gaps`` of ``filter_noise.InsNoise``."""
    R_ned_cam = a.own_attitude.R_ned_body @ T_frd_cam.R
    table = np.empty((9, 3))
    table[0:3] = R_ned_cam.T
    table[3:6] = a.tanker_attitude.R_ned_body
    table[6] = T_frd_cam.R.T @ T_frd_cam.t
    table[7] = a.travel_difference_m
    table[8] = a.tanker_attitude.omega_body_rad_s
    lever_ned_m = a.own_attitude.R_ned_body @ T_frd_cam.t
    return Geometry(table, noise, R_ned_cam, lever_ned_m, a.travel_difference_m, a.tanker.v_ned_m_s, gaps)


class FrameReader:
    """Makes a ``PixelFrame`` of what the vision saw; ``to_plane`` brings pixels (n, 2) to z = 1."""

    def __init__(
        self, c: FilterConfig, camera: CameraConfig, markers: Mat, to_plane: Callable[[Mat], Mat]
    ) -> None:
        self._floor_px = c.pixel_sigma_px
        self._focal_px = float(np.sqrt(camera.fx_px * camera.fy_px))
        self._markers = np.ascontiguousarray(markers, dtype=np.float64)
        self._to_plane = to_plane

    def read(self, seen: VisionOutput, geometry: Geometry) -> PixelFrame:
        """Return the frame."""
        found = seen.detections
        ids = np.flatnonzero(seen.labels >= 0)
        if len(ids) == 0:
            return PixelFrame(seen.t_ns, geometry, None, self._loose(found))
        at = seen.labels[ids]
        uv, sigma = self._on_plane(found, at)
        good = np.isfinite(uv).all(axis=1) & np.isfinite(sigma)
        pixels = MarkerPixels(tuple(ids[good].tolist()), self._markers[ids[good]], uv[good], sigma[good])
        pose = seen.pose
        range_m, offset = np.inf, None
        if pose is not None:
            t = pose.T_cam_tanker.t
            range_m = float(np.sqrt(t @ t))
            if pose.markers_used >= FEW_FOR_OFFSET:
                r_ned_m = -(geometry.R_ned_cam @ t) - geometry.lever_ned_m
                offset = Offset(seen.t_ns, r_ned_m - geometry.travel_m)
        imagined = not found.sigma_px[at].any()
        return PixelFrame(seen.t_ns, geometry, pixels if len(pixels.ids) else None, None, offset, range_m, imagined)

    def _on_plane(self, found: Detections, at: np.ndarray) -> tuple[Mat, Vec]:
        uv = np.ascontiguousarray(self._to_plane(found.uv_px[at]), dtype=np.float64)
        return uv, np.hypot(found.sigma_px[at], self._floor_px) / self._focal_px

    def _loose(self, found: Detections) -> tuple[Mat, Vec] | None:
        if len(found.uv_px) == 0:
            return None
        uv, sigma = self._on_plane(found, np.arange(len(found.uv_px)))
        good = np.isfinite(uv).all(axis=1) & np.isfinite(sigma)
        return (uv[good], sigma[good]) if good.any() else None
