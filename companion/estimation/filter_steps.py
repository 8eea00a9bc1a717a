"""One measurement into one estimate: pure functions, so that measurements can be taken again in another order.

Rules
-----
* A measurement is gated by its normalised innovation squared; markers one by one as well.
* The start: three differences of positions that agree, or five poses. Never one alone.
* A source that goes on being refused, and agrees with itself, is believed again (``refused_s``): GPS has another bias
  then, and the position stays, unless it is hardly better known than GPS knows it (``WORTH_KEEPING``); labelled lights,
  near the tanker, put the position anew. Lights that are refused with no pose to judge them by say that the filter is
  too sure: its covariance is widened, the more the longer that lasts. The reason says which. What was refused longer
  ago than twice ``refused_s`` is forgotten.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from companion.config import FilterConfig
from companion.estimation.filter_association import associate
from companion.estimation.filter_kernel import predict, take_linear
from companion.estimation.filter_measurements import GpsDifference, MarkerPixels, Measurement, PixelFrame
from companion.estimation.filter_noise import Gaps, path_axes, turned
from companion.estimation.filter_pixels import ALL_TAKEN, UNUSABLE, take_pixels
from companion.estimation.filter_state import (
    BORESIGHT,
    GPS_BIAS,
    LAG,
    SIZE,
    THETA,
    Estimate,
    Offset,
    P,
    V,
    initial_sigma,
    process_noise,
    unknown,
)
from companion.geometry import Mat, Vec
from companion.messages import NS, FilterUpdate

GPS_START, POSES_START = 3, 5
FEWEST_TO_RETURN = 5
AGREED_GPS_M, AGREED_POSES_M = 1.0, 0.5
"""Spread per axis, root mean square, of offsets that agree: ten times the noise of GPS, poses at 40 m."""

WIDER_M, WIDER_M_S, WIDER_RAD = 0.3, 0.1, 0.002
"""What is added to the standard deviations of a filter that has been too sure for ``refused_s``."""
WIDEST = 5.0
"""How many times that is added at most."""

MOST_OFFSETS = 40
"""So many offsets, spread over twice ``refused_s``, stand for all, at whatever rate they come."""

WORTH_KEEPING = 0.5
"""A position whose standard deviation is this part of that of GPS' bias, or less, outlives a GPS that contradicts."""

OFFSET_LASTS_S = 1.0
"""For so long a difference of positions says what the bias of GPS is at a position that is put anew."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of a measurement: for the record, and which markers were told apart."""

    updates: tuple[FilterUpdate, ...]
    taken: bool
    pixels: MarkerPixels | None = None


class Steps:
    """Applies measurements to estimates, with one configuration."""

    def __init__(self, c: FilterConfig, all_markers: Mat, ids: tuple[int, ...] = ()) -> None:
        """``ids`` of the markers by which they are told of; their rows without."""
        self._c = c
        self._markers = np.ascontiguousarray(all_markers, dtype=np.float64)
        self._ids = ids or tuple(range(len(all_markers)))
        self._noise = process_noise(c)
        self._initial = initial_sigma(c)
        self._gps_gate = float(chdtri(3, c.gate_probability))
        self._marker_gate = float(chdtri(2, c.gate_probability))

    def unknown(self, t_ns: int) -> Estimate:
        """Return what is known before any measurement."""
        return unknown(t_ns, self._c)

    def carried(self, e: Estimate, t_ns: int, gaps: Gaps) -> tuple[Vec, Mat]:
        """Return state and covariance, copies, at an instant at or after that of the estimate, with ``gaps`` by then.
        """
        x, cov = e.x.copy(), e.cov.copy()
        if t_ns > e.t_ns and e.ready:
            predict(x, cov, (t_ns - e.t_ns) * NS, self._noise, e.v_ned_tanker_m_s)
        if gaps != e.gaps:
            cov[P, P] += turned(path_axes(e.v_ned_tanker_m_s), np.maximum(np.subtract(gaps, e.gaps), 0.0))
        return x, cov

    def take(self, e: Estimate, m: Measurement) -> tuple[Estimate, Outcome]:
        """Return the estimate at the instant of ``m``, which is not before that of ``e``, and what came of it."""
        x, cov = self.carried(e, m.t_ns, m.gaps)
        e = replace(e, t_ns=m.t_ns, x=x, cov=cov, gaps=m.gaps, v_ned_tanker_m_s=m.v_ned_tanker_m_s)
        if isinstance(m, GpsDifference):
            return self._gps(e, m) if e.ready else self._gps_start(e, m)
        return self._frame(e, m) if e.ready else self._pose_start(e, m)

    def _gps_start(self, e: Estimate, m: GpsDifference) -> tuple[Estimate, Outcome]:
        here = Offset(m.t_ns, m.offset_m)
        kept = (*e.gps_offsets, here)[-GPS_START:]
        e = replace(e, gps_offset=here, gps_offsets=kept)
        if len(kept) < GPS_START or not agreed(kept, AGREED_GPS_M):
            return e, told(m, "gps", 0.0, 0, "start")
        return self._at_gps(e, m, kept), told(m, "gps", 0.0, 0, "start", taken=True)

    def _at_gps(self, e: Estimate, m: GpsDifference, kept: tuple[Offset, ...]) -> Estimate:
        """Return the estimate that begins where positions put it."""
        x, cov = self._anew(middle(kept), self._initial[P])
        # The position is known as well as the bias, and errs with it and with the lag.
        lag = self._c.lag_initial_s**2 * m.v_ned_tanker_m_s
        gps = 2.0 * self._c.gps_sigma_m**2 / GPS_START
        cov[P, P] = np.diag(self._initial[GPS_BIAS] ** 2 + gps) + np.outer(lag, m.v_ned_tanker_m_s)
        cov[P, GPS_BIAS] = cov[GPS_BIAS, P] = -np.diag(self._initial[GPS_BIAS] ** 2)
        cov[P, LAG] = cov[LAG, P] = -lag
        return replace(e, x=x, cov=cov, ready=True, gps_ns=m.t_ns, gps_offsets=(), pixel_offsets=(),
                       pixels_refused_ns=None)

    def _pose_start(self, e: Estimate, m: PixelFrame) -> tuple[Estimate, Outcome]:
        if m.offset is None or m.imagined:
            return e, told(m, "pixels", 0.0, 0, "start")
        kept = (*e.pixel_offsets, m.offset)[-POSES_START:]
        e = replace(e, pixel_offsets=kept)
        if len(kept) < POSES_START or not agreed(kept, AGREED_POSES_M):
            return e, told(m, "pixels", 0.0, 0, "start")
        x, cov = self._anew(middle(kept), np.full(3, AGREED_POSES_M))
        return self._frame(replace(e, x=x, cov=cov, ready=True, pixel_offsets=()), m)

    def _anew(self, offset_m: Vec, sigma_m: Vec) -> tuple[Vec, Mat]:
        x, sigma = np.zeros(SIZE), self._initial.copy()
        x[P], sigma[P] = offset_m, sigma_m
        return x, np.diag(sigma**2)

    def _gps(self, e: Estimate, m: GpsDifference) -> tuple[Estimate, Outcome]:
        here = Offset(m.t_ns, m.offset_m)
        H = np.zeros((3, SIZE))
        H[:, P] = H[:, GPS_BIAS] = np.eye(3)
        H[:, LAG] = m.v_ned_tanker_m_s
        nis = take_linear(e.x, e.cov, H, m.offset_m, 2.0 * self._c.gps_sigma_m**2, self._gps_gate)
        if nis <= self._gps_gate:
            return replace(e, gps_ns=m.t_ns, gps_offset=here, gps_offsets=()), told(m, "gps", nis, 3, taken=True)
        kept = self._lately((*e.gps_offsets, here), m.t_ns)
        e = replace(e, gps_offset=here, gps_offsets=kept)
        if not self._insists(kept, AGREED_GPS_M):
            return e, told(m, "gps", nis, 3, "gate")
        if not self._worth_keeping(e):
            return self._at_gps(e, m, kept[-GPS_START:]), told(m, "gps", nis, 3, "position_anew")
        bias = middle(kept) - e.x[P] - m.v_ned_tanker_m_s * e.x[LAG]
        return replace(self._with_bias(e, bias), gps_ns=m.t_ns, gps_offsets=()), told(m, "gps", nis, 3, "bias_anew")

    def _worth_keeping(self, e: Estimate) -> bool:
        """Tell whether vision, and what has carried its position on, still knows more than GPS does."""
        most_m = WORTH_KEEPING * np.sqrt(3.0) * self._c.gps_bias_sigma_m
        return e.sight_ns is not None and bool(e.position_sigma_m <= most_m)

    def _lately(self, offsets: tuple[Offset, ...], t_ns: int) -> tuple[Offset, ...]:
        """Return the offsets of the last moments, thinned out; the newest is among them."""
        longest_ns = 2.0 * self._c.refused_s / NS
        kept = tuple(o for o in offsets if t_ns - o.t_ns <= longest_ns)
        if len(kept) >= 3 and kept[-2].t_ns - kept[-3].t_ns < longest_ns / MOST_OFFSETS:
            return (*kept[:-2], kept[-1])
        return kept

    def _insists(self, kept: tuple[Offset, ...], spread_m: float) -> bool:
        long_enough = len(kept) >= FEWEST_TO_RETURN and (kept[-1].t_ns - kept[0].t_ns) * NS >= self._c.refused_s
        return long_enough and agreed(kept, spread_m)

    def _with_bias(self, e: Estimate, bias_m: Vec) -> Estimate:
        """Return the estimate with another bias, of which nothing more is known than at the start."""
        x, cov = e.x.copy(), e.cov.copy()
        x[GPS_BIAS] = bias_m
        forget(cov, GPS_BIAS, self._initial[GPS_BIAS])
        return replace(e, x=x, cov=cov)

    def _frame(self, e: Estimate, m: PixelFrame) -> tuple[Estimate, Outcome]:
        if m.imagined:
            seen = 0 if m.labelled is None else len(m.labelled.ids)
            return replace(e, sight_ns=m.t_ns, markers_used=seen), told(m, "pixels", 0.0, 0, "imagined", taken=True)
        pixels = m.labelled or self._told_apart(e, m)
        if pixels is None:
            return e, told(m, "pixels", 0.0, 0, "no_labels")
        after, outcome = self._pixels(e, m, pixels)
        if outcome.taken or not after.ready:
            return after, outcome
        return self._refused(after, m, pixels, outcome)

    def _told_apart(self, e: Estimate, m: PixelFrame) -> MarkerPixels | None:
        if m.loose is None or e.sight_ns is None or (m.t_ns - e.sight_ns) * NS > self._c.sight_lasts_s:
            return None
        return associate(e.x, e.cov, m.geometry, self._markers, *m.loose)

    def _pixels(self, e: Estimate, m: PixelFrame, pixels: MarkerPixels) -> tuple[Estimate, Outcome]:
        n = len(pixels.ids)
        alone, nis = np.empty(n), np.empty(n)
        x, cov, g = e.x.copy(), e.cov.copy(), m.geometry
        status, total = take_pixels(x, cov, g.table, pixels.markers, pixels.uv, pixels.sigma, g.noise,
                                    self._marker_gate, alone, nis)
        if status == UNUSABLE:
            return e, told(m, "pixels", 0.0, 0, "geometry")
        if status != ALL_TAKEN:
            return e, told(m, "pixels", total, 2 * n, "gate")
        out = np.flatnonzero(nis < 0.0).tolist()
        used = n - len(out)
        updates = [FilterUpdate(m.t_ns, "pixels", total, 2 * used)]
        updates += [FilterUpdate(m.t_ns, f"marker {self._ids[pixels.ids[k]]}", -nis[k], 2, "gate") for k in out]
        after = replace(e, x=x, cov=cov, sight_ns=m.t_ns, markers_used=used, pixel_offsets=(), pixels_refused_ns=None)
        return after, Outcome(tuple(updates), True, pixels)

    def _refused(
        self, e: Estimate, m: PixelFrame, pixels: MarkerPixels, outcome: Outcome
    ) -> tuple[Estimate, Outcome]:
        since_ns = m.t_ns if e.pixels_refused_ns is None else e.pixels_refused_ns
        kept = self._lately(e.pixel_offsets if m.offset is None else (*e.pixel_offsets, m.offset), m.t_ns)
        e = replace(e, pixels_refused_ns=since_ns, pixel_offsets=kept)
        refused = outcome.updates[0]
        times = (m.t_ns - since_ns) * NS / self._c.refused_s
        if times < 1.0:
            return e, outcome
        near = m.range_m <= self._c.vision_leads_m
        if near and self._insists(kept, AGREED_POSES_M):
            after, again = self._pixels(self._at_pose(e, middle(kept)), m, pixels)
            reason = "position_anew"
        elif len(kept) == 0:
            after, again = self._pixels(widened_estimate(e, min(times, WIDEST)), m, pixels)
            reason = "wider"
        else:
            return e, outcome
        if not again.taken:
            return e, outcome
        return after, replace(again, updates=(replace(refused, reason=reason), *again.updates[1:]))

    def _at_pose(self, e: Estimate, offset_m: Vec) -> Estimate:
        """Return the estimate with the position where vision puts it, and GPS with a bias that explains it."""
        moved_m = offset_m - e.x[P]
        x, cov = e.x.copy(), e.cov.copy()
        x[P] = offset_m
        x[V] = x[THETA] = x[BORESIGHT] = 0.0
        for part in (P, V, THETA, BORESIGHT):
            forget(cov, part, self._initial[part])
        cov[P, P] = np.eye(3) * AGREED_POSES_M**2
        bias = e.x[GPS_BIAS] - moved_m
        if e.gps_offset is not None and (e.t_ns - e.gps_offset.t_ns) * NS <= OFFSET_LASTS_S:
            bias = e.gps_offset.offset_m - offset_m - e.v_ned_tanker_m_s * e.x[LAG]
        return self._with_bias(replace(e, x=x, cov=cov), bias)


def told(
    m: Measurement, source: str, nis: float, dof: int, reason: str = "", *, taken: bool = False
) -> Outcome:
    """Return the outcome of a measurement that is one update."""
    return Outcome((FilterUpdate(m.t_ns, source, nis, dof, reason),), taken)


def forget(cov: Mat, part: slice, sigma: Vec) -> None:
    """Make of a part of a covariance, in place, what is known of it at the start."""
    cov[part, :] = 0.0
    cov[:, part] = 0.0
    cov[part, part] = np.diag(sigma**2)


def widened_estimate(e: Estimate, times: float) -> Estimate:
    """Return the estimate less sure, ``times`` the usual, of position, velocity, attitude and boresight."""
    cov = e.cov.copy()
    for part, sigma in ((P, WIDER_M), (V, WIDER_M_S), (THETA, WIDER_RAD), (BORESIGHT, WIDER_RAD)):
        cov[part, part] += np.eye(3) * (times * sigma) ** 2
    return replace(e, cov=cov)


def agreed(offsets: tuple[Offset, ...], spread_m: float) -> bool:
    """Tell whether offsets lie together, on every axis."""
    table = np.array([o.offset_m for o in offsets])
    return bool((table.std(axis=0) <= spread_m).all())


def middle(offsets: tuple[Offset, ...]) -> Vec:
    """Return the median (3,) of offsets, axis by axis."""
    return np.median(np.array([o.offset_m for o in offsets]), axis=0)
