"""What one labelled marker does to the pose, in closed form from the weighted least squares at it.

With J the Jacobian of a marker's place on z = 1 by the move of the pose, s2 its variance, P the covariance of the pose
that it is in, H = J P J^T / s2 its part of the hat matrix and r its residual (Belsley, Kuh, Welsch 1980, ch. 2; Cook
1977):

* the deleted residual e = (I - H)^-1 r, with covariance s2 (I - H)^-1, is how far off the place lies that all others
  foretell: were the marker wrong by b and the rest right, b would be its mean;
* the sensitivity S = P J^T / s2 is what the pose moves by for an error of the marker, so that S e is the separation of
  the solution with it from the one without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import SE3, Mat, Vec, skew

UNTESTED = 1e-3
"""Share of a marker's own variance in its residual below which the others say nothing of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Labelled markers of one frame at a pose: ``which`` (k,) of the map, depth (k,), residuals (k, 2), J (k, 2, 6)."""

    which: NDArray[np.int64]
    depth_m: Vec
    residual: Mat
    J: NDArray[np.float64]
    variance: Vec


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Deleted residuals (k, 2) on z = 1, ``spread`` (k, 2, 2) = (I - H)^-1, S (k, 6, 2); ``tested`` (k,) or untold."""

    deleted: Mat
    spread: NDArray[np.float64]
    sensitivity: NDArray[np.float64]
    tested: NDArray[np.bool_]


def linearised(which: NDArray[np.int64], points: Mat, uv: Mat, variance: Vec, T_cam_tanker: SE3) -> Seen | None:
    """Return residuals and Jacobians of markers (k, 3) seen at uv (k, 2) on z = 1; None when one is behind the camera.

    The pose is moved from the left: t + d[:3] and exp(d[3:]) R, camera axes.
    """
    a = points @ T_cam_tanker.R.T
    q = a + T_cam_tanker.t
    z = q[:, 2]
    if not (z > 0.0).all() or not np.isfinite(uv).all():
        return None
    i = 1.0 / z
    h = q[:, :2] * i[:, None]
    J = np.zeros((len(q), 2, 6))
    J[:, 0, 0] = J[:, 1, 1] = i
    J[:, :, 2] = -h * i[:, None]
    u, v = h[:, 0], h[:, 1]
    J[:, 0, 3], J[:, 0, 4], J[:, 0, 5] = -a[:, 1] * u * i, (a[:, 2] + a[:, 0] * u) * i, -a[:, 1] * i
    J[:, 1, 3], J[:, 1, 4], J[:, 1, 5] = -(a[:, 2] + a[:, 1] * v) * i, a[:, 0] * v * i, a[:, 0] * i
    return Seen(which, z, uv - h, J, variance)


def covariance(seen: Seen, prior_information: Mat) -> Mat | None:
    """Return the covariance (6, 6) of the pose from markers and what was known before; None when they fix none."""
    J = seen.J.reshape(-1, 6)
    N = (J / np.repeat(seen.variance, 2)[:, None]).T @ J + prior_information
    try:
        np.linalg.cholesky(N)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(np.linalg.inv(N), dtype=np.float64)


def leave_out(seen: Seen, P: Mat) -> LeftOut:
    """Return what leaving out each marker does to the pose whose covariance (6, 6) with all of them is P."""
    PJ = P @ seen.J.transpose(0, 2, 1)  # (k, 6, 2)
    s2 = seen.variance
    H = (seen.J @ PJ) / s2[:, None, None]
    a, b, c = 1.0 - H[:, 0, 0], -H[:, 0, 1], 1.0 - H[:, 1, 1]
    least = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    tested = least > UNTESTED
    det = np.where(tested, a * c - b * b, 1.0)
    spread: NDArray[np.float64] = np.empty(H.shape)
    spread[:, 0, 0], spread[:, 1, 1] = c / det, a / det
    spread[:, 0, 1] = spread[:, 1, 0] = -b / det
    deleted = (spread @ seen.residual[:, :, None])[:, :, 0]
    return LeftOut(deleted, spread, PJ / s2[:, None, None], tested)


def moves(t_cam_m: Vec, pose_move: NDArray[np.float64], *, turns: bool) -> NDArray[np.float64]:
    """Return what moves (..., 6, k) of the pose do to the camera's place against the tanker (..., 3, k), camera axes.

    Attitudes from the INS turn the place (the blend), or, ``turns``, the camera's mount takes up the rotation as well:
    t' = t + dt is turned back by the rotation that was too much, which adds t x d_rotation.
    """
    moved: NDArray[np.float64] = pose_move[..., :3, :]
    return np.asarray(moved + skew(t_cam_m) @ pose_move[..., 3:, :]) if turns else moved
