"""Which marker a detection is, when the labeling could not say and the filter knows where they have to be.

A detection is a marker when it lies within the gate of that one, nothing else lies near, and it lies near no other: so
that a lone light is enough to keep the track, and a doubtful one is left out.
"""

from __future__ import annotations

import numpy as np

from companion.estimation.filter_measurements import Geometry, MarkerPixels
from companion.estimation.filter_pixels import expected_pixels
from companion.geometry import Mat, Vec

GATE = 13.8
"""Squared distance within which a marker is in 999 cases of 1000 (chi2 of two)."""

NEAR = 5.0
"""How many times farther than the gate a rival is looked for."""

WIDEST = 0.01
"""Largest standard deviation, on z = 1, of a marker's expected place: 4.6 px at f = 457 px. A clutter light falls into
a larger gate too easily."""


def associate(x: Vec, P: Mat, geometry: Geometry, markers: Mat, uv: Mat, sigma: Vec) -> MarkerPixels | None:
    """Return the markers (n, 3) that are told apart among detections uv (m, 2) with sigma (m,) on z = 1, or None."""
    n = len(markers)
    expected, S = np.empty((n, 2)), np.empty((n, 3))
    if not expected_pixels(x, P, geometry.table, markers, geometry.noise, expected, S):
        return None
    if np.sqrt(max(S[:, 0].max(), S[:, 2].max())) > WIDEST:
        return None
    u, v = uv[None, :, 0] - expected[:, None, 0], uv[None, :, 1] - expected[:, None, 1]
    uu, vv = S[:, None, 0] + sigma[None] ** 2, S[:, None, 2] + sigma[None] ** 2
    cc = S[:, None, 1]
    squared = (vv * u * u - 2.0 * cc * u * v + uu * v * v) / (uu * vv - cc * cc)
    near = squared <= NEAR**2 * GATE
    sole = near & (near.sum(axis=0) == 1)[None] & (near.sum(axis=1) == 1)[:, None] & (squared <= GATE)
    ids, at = np.nonzero(sole)
    if len(ids) == 0:
        return None
    return MarkerPixels(tuple(ids.tolist()), markers[ids], np.ascontiguousarray(uv[at]), sigma[at])
