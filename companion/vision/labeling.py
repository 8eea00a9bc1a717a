"""Labeling: which detection is which marker (thesis 4.2.4, eq. 4.4, listing 10.3.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat


def label_mutual_nearest(
    predicted_uv: Mat,
    detected_uv: Mat,
    max_distance: float | None = None,
    screen: tuple[float, float, float, float] | None = None,
) -> NDArray[np.int64]:
    """Match predicted markers (n, 2) with detections (m, 2) that are each other's nearest.

    Returns (n,) indices into the detections, -1 where a marker has none. A detection j is taken when its smallest
    distance to a marker equals that marker's smallest distance to a detection (thesis eq. 4.4). Ties go as in the
    thesis' listing: of markers at equal distance the first, of detections at equal distance the last. A row with NaN
    is a marker that is not predicted or a detection that does not count. Pairs further apart than ``max_distance``,
    in the unit of the inputs, do not match; the listing has such a limit too, a squared distance below 1000. ``screen``
    is the listing's screen limit: u from, u to, v from, v to, edges included; a detection outside does not count.
    """
    n, m = len(predicted_uv), len(detected_uv)
    labels = np.full(n, -1, dtype=np.int64)
    if n == 0 or m == 0:
        return labels
    difference = predicted_uv[:, None, :] - detected_uv[None, :, :]
    squared = np.einsum("nmk,nmk->nm", difference, difference)
    limit = np.inf if max_distance is None else max_distance * max_distance
    squared[~(squared <= limit)] = np.inf
    if screen is not None:
        low, high = np.array(screen[::2]), np.array(screen[1::2])
        squared[:, ~((detected_uv >= low) & (detected_uv <= high)).all(axis=1)] = np.inf
    nearest_detection = squared.min(axis=1)
    nearest_marker = squared.min(axis=0)
    marker = squared.argmin(axis=0)
    taken = np.flatnonzero(np.isfinite(nearest_marker) & (nearest_marker == nearest_detection[marker]))
    labels[marker[taken]] = taken
    return labels
