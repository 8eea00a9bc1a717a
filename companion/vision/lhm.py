"""Pose of the tanker by orthogonal iteration: Lu, Hager and Mjolsness 2000 (thesis ch. 6, listing 10.3.2).

Rules
-----
* The error is the distance in metres of each marker from its line of sight, in object space (thesis eq. 6.16-6.18).
* Frames: tanker axes in, optical camera axes (right, down, forward) out, where the thesis' listing takes a left-handed
  frame with y up; the iteration is the same.
* Everything is linear in r = vec(R), row by row, once the points are centred. So the points are summed once, into a
  (9, 9) matrix H, and an iteration costs the same for any number of markers: M(R) = H r (thesis eq. 6.23) and
  E(R) = S2 - r.(H r) (thesis eq. 6.22), with S2 the sum of |p|^2. The iterates are those of the listing.
* The rotation step cannot answer with a reflection, as the listing's can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from companion.geometry import SE3, Mat, Vec
from companion.vision.absolute_orientation import rotation_closed_form, rotation_quaternion, rotation_svd

MAX_ITERATIONS = 1000
"""The listing has no limit. Warm solves take tens of iterations; whoever needs more than this is not converging."""

METHODS = {"svd": 0, "quaternion": 1}

OK, NOT_FINITE, ON_A_LINE, ONE_RAY, NOT_A_ROTATION = range(5)
COMPLAINTS = {
    NOT_FINITE: "points_tanker, uv and R_init must be finite numbers",
    ON_A_LINE: "points_tanker lie on one line: they do not fix a pose",
    ONE_RAY: "uv are all the same point: they do not fix a pose",
    NOT_A_ROTATION: "R_init must be a rotation matrix (3, 3)",
}

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Place of element (i, j) of a symmetric 3x3 matrix in the list of its six."""


@dataclass(frozen=True, slots=True, eq=False)
class LhmResult:
    """Outcome of ``solve_lhm``.

    ``object_error`` RMS distance of the markers from their lines of sight in m; ``image_error`` RMS distance on the
    plane z = 1; ``converged`` says that the stopping rule was met and that all markers are before the camera.
    """

    T_cam_tanker: SE3
    iterations: int
    object_error: float
    image_error: float
    converged: bool


def solve_lhm(
    points_tanker: Mat,
    uv: Mat,
    R_init: Mat | None = None,
    tol: float = 1e-5,
    epsilon: float = 1e-8,
    method: Literal["svd", "quaternion"] = "svd",
) -> LhmResult:
    """Return the pose that brings markers (n, 3), m, tanker axes, nearest to their lines of sight (thesis eq. 6.18).

    ``uv`` (n, 2) are the markers seen on the plane z = 1, undistorted; n >= 3, though the thesis asks for 5 (6.3).
    ``R_init`` is where R_cam_tanker starts, usually the last frame's; None starts from several rotations and keeps the
    best (``cold``). Iterates until the sum of squared errors is at most ``epsilon`` m^2
    or changes by a fraction of at most ``tol`` (thesis 6.3). ``method`` svd takes the rotation of the guarded SVD, by
    its closed form; quaternion takes Horn's.

    Raises ValueError for wrong shapes, numbers that are not finite, points on one line, rays that coincide.
    """
    points = np.ascontiguousarray(points_tanker, dtype=np.float64)
    rays = np.ascontiguousarray(uv, dtype=np.float64)
    check_points(points, rays)
    if method not in METHODS:
        msg = f"method must be 'svd' or 'quaternion', not {method!r}"
        raise ValueError(msg)
    if R_init is None:
        return cold(points, rays, tol, epsilon, METHODS[method])
    R0 = np.ascontiguousarray(R_init, dtype=np.float64)
    if R0.shape != (3, 3):
        raise ValueError(COMPLAINTS[NOT_A_ROTATION])
    return unpack(len(points), iterate(points, rays, R0, tol, epsilon, METHODS[method]))


def check_points(points: Mat, uv: Mat) -> None:
    """Raise ValueError unless points are (n, 3) and uv (n, 2) with n >= 3."""
    if points.ndim != 2 or points.shape[1] != 3 or uv.shape != (points.shape[0], 2):
        msg = f"points_tanker must be (n, 3) and uv (n, 2), not {points.shape} and {uv.shape}"
        raise ValueError(msg)
    if points.shape[0] < 3:
        msg = f"a pose needs at least 3 points, not {points.shape[0]}"
        raise ValueError(msg)


Iterated = tuple[int, Mat, Vec, int, float, float, bool, bool]


def unpack(n: int, iterated: Iterated) -> LhmResult:
    """Turn what ``iterate`` returns into a result or into a ValueError."""
    status, R, t, iterations, squared_object, squared_image, settled, ahead = iterated
    if status != OK:
        raise ValueError(COMPLAINTS[status])
    errors = (squared_object / n) ** 0.5, (squared_image / n) ** 0.5
    return LhmResult(SE3(R, t), iterations, *errors, settled and ahead)


def cold(points: Mat, uv: Mat, tol: float, epsilon: float, method: int) -> LhmResult:
    """Iterate from several starts and return the lowest error, poses with all markers before the camera first.

    E = r^T Omega r for any r, with Omega = diag(S, S, S) - H and S the scatter matrix of the points. Starts are the
    proper rotations nearest to plus and minus an eigenvector of Omega, smallest eigenvalue first: the idea of SQPnP
    (Terzakis, Lourakis 2020). Three eigenvectors are always tried, further ones while the best error is above what
    theirs could be, 3 times the eigenvalue.
    """
    status, H, _, _, _, p, _ = fold(points, uv)
    if status != OK:
        raise ValueError(COMPLAINTS[status])
    values, vectors = np.linalg.eigh(np.kron(np.eye(3), p.T @ p) - 0.5 * (H + H.T))
    best: Iterated | None = None
    for k in range(9):
        if k >= 3 and best is not None and best[7] and best[4] <= 3.0 * values[k]:
            break
        axis = np.ascontiguousarray(vectors[:, k]).reshape(3, 3)
        tries = [iterate(points, uv, rotation_svd(sign * axis), tol, epsilon, method) for sign in (1.0, -1.0)]
        best = min(tries if best is None else [best, *tries], key=lambda it: (not it[7], it[4]))
    assert best is not None
    return unpack(len(points), best)


def weak_perspective_rotation(points_tanker: Mat, uv: Mat) -> Mat:
    """Return the thesis' cold start R (3, 3): image points as if they were the scene (thesis 6.2.5), never reflected.

    Good for far and shallow scenes only; ``solve_lhm`` without ``R_init`` has a better one.
    """
    q = np.column_stack([uv, np.ones(len(uv))])
    return rotation_svd(np.ascontiguousarray((q - q.mean(axis=0)).T @ (points_tanker - points_tanker.mean(axis=0))))


def rms_object_error(points: Mat, uv: Mat, T_cam_tanker: SE3) -> float:
    """Return the RMS distance in m of points (n, 3) from their lines of sight uv (n, 2) (thesis eq. 6.18)."""
    q = T_cam_tanker.transform(points)
    rays = np.column_stack([uv, np.ones(len(uv))])
    off = np.cross(rays, q) / np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
    return float(np.sqrt(np.einsum("ij,ij->", off, off) / len(points)))


@njit(cache=True, nogil=True, error_model="numpy")
def fold(points: Mat, uv: Mat) -> tuple[int, Mat, Mat, Vec, float, Mat, Mat]:
    """Sum the points into matrices: (status, H (9, 9), T (3, 9), mean (3,), S2, centred points, unit rays (n, 3)).

    ``T`` gives the best translation of a rotation, t = T vec(R) (thesis eq. 6.19).
    """
    n = points.shape[0]
    mean, p, v = centred(points, uv)
    F, f = np.zeros(6), np.empty(6)
    Fp, Fpp, pp = np.zeros((6, 3)), np.zeros((6, 6)), np.zeros(6)
    for i in range(n):
        for j in range(3):
            for k in range(j, 3):
                f[SYMMETRIC[j, k]] = v[i, j] * v[i, k]
                pp[SYMMETRIC[j, k]] += p[i, j] * p[i, k]
        for s in range(6):
            F[s] += f[s]
            for j in range(3):
                Fp[s, j] += f[s] * p[i, j]
                for k in range(j, 3):
                    Fpp[s, SYMMETRIC[j, k]] += f[s] * p[i, j] * p[i, k]
    S2 = pp[0] + pp[3] + pp[5]
    H, T = np.zeros((9, 9)), np.zeros((3, 9))
    status = judge(n, F, pp, S2)
    if status == OK:
        fill(n, F, Fp, Fpp, H, T)
    return status, H, T, mean, S2, p, v


@njit(cache=True, nogil=True, error_model="numpy")
def centred(points: Mat, uv: Mat) -> tuple[Vec, Mat, Mat]:
    """Return the mean (3,) of the points, the points about it, and the unit rays of uv, both (n, 3)."""
    n = points.shape[0]
    mean, p, v = np.zeros(3), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for j in range(3):
            mean[j] += points[i, j] / n
    for i in range(n):
        x, y = uv[i, 0], uv[i, 1]
        norm = np.sqrt(x * x + y * y + 1.0)
        v[i, 0], v[i, 1], v[i, 2] = x / norm, y / norm, 1.0 / norm
        for j in range(3):
            p[i, j] = points[i, j] - mean[j]
    return mean, p, v


@njit(cache=True, nogil=True)
def judge(n: int, F: Vec, pp: Vec, S2: float) -> int:
    """Say whether the sums of ``fold`` can fix a pose."""
    if not (np.isfinite(S2) and np.isfinite(F[0] + F[1] + F[2] + F[3] + F[4] + F[5])):
        return NOT_FINITE
    # Sum of the products of two eigenvalues of the scatter matrix: zero when only one differs from zero.
    minors = pp[0] * pp[3] - pp[1] ** 2 + pp[0] * pp[5] - pp[2] ** 2 + pp[3] * pp[5] - pp[4] ** 2
    if not minors > 1e-12 * S2 * S2:
        return ON_A_LINE
    # n - |sum v v^T| vanishes when all rays are one.
    spread = n * n - (F[0] ** 2 + F[3] ** 2 + F[5] ** 2 + 2 * (F[1] ** 2 + F[2] ** 2 + F[4] ** 2))
    return OK if spread > 1e-14 * n * n else ONE_RAY


@njit(cache=True, nogil=True, error_model="numpy")
def fill(n: int, F: Vec, Fp: Mat, Fpp: Mat, H: Mat, T: Mat) -> None:
    """Write H and T from the sums over the points: T = (n I - F)^-1 Fp, H = Fpp + Fp^T T, reordered."""
    a, b, c, d, e, f = n - F[0], -F[1], -F[2], n - F[3], -F[4], n - F[5]
    inverse = np.empty(6)
    inverse[0], inverse[1], inverse[2] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[3], inverse[4], inverse[5] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * inverse[0] + b * inverse[1] + c * inverse[2]
    for i in range(3):
        for k in range(3):
            g = inverse[SYMMETRIC[i, k]] / determinant
            for u in range(3):
                for j in range(3):
                    T[i, 3 * u + j] += g * Fp[SYMMETRIC[k, u], j]
    for i in range(3):
        for m in range(3):
            for u in range(3):
                for j in range(3):
                    total = Fpp[SYMMETRIC[i, u], SYMMETRIC[m, j]]
                    for k in range(3):
                        total += Fp[SYMMETRIC[i, k], m] * T[k, 3 * u + j]
                    H[3 * i + m, 3 * u + j] = total


@njit(cache=True, nogil=True)
def rotation_step(m: Vec, r: Vec, method: int) -> None:
    """Write the rotation that maximises tr(R^T M) into r; both (9,)."""
    if method == 0 and rotation_closed_form(m, r):
        return
    M = m.reshape(3, 3)
    R = rotation_quaternion(M) if method == 1 else rotation_svd(M)
    r[:] = R.reshape(9)


@njit(cache=True, nogil=True, error_model="numpy")
def object_error(H: Mat, T: Mat, S2: float, p: Mat, v: Mat, r: Vec, m: Vec) -> float:
    """Write M(R) = H r into m and return the sum of squared object-space errors of r.

    S2 - r.(H r) loses about 1e-15 S2 to cancellation; where that could matter the points are gone through instead.
    """
    product = 0.0
    for i in range(9):
        total = 0.0
        for j in range(9):
            total += H[i, j] * r[j]
        m[i] = total
        product += r[i] * total
    error = S2 - product
    if error > 1e-9 * S2:
        return error
    t = T @ r
    error = 0.0
    for i in range(p.shape[0]):
        x = r[0] * p[i, 0] + r[1] * p[i, 1] + r[2] * p[i, 2] + t[0]
        y = r[3] * p[i, 0] + r[4] * p[i, 1] + r[5] * p[i, 2] + t[1]
        z = r[6] * p[i, 0] + r[7] * p[i, 1] + r[8] * p[i, 2] + t[2]
        along = x * v[i, 0] + y * v[i, 1] + z * v[i, 2]
        error += (x - along * v[i, 0]) ** 2 + (y - along * v[i, 1]) ** 2 + (z - along * v[i, 2]) ** 2
    return error


@njit(cache=True, nogil=True)
def is_rotation(R: Mat) -> bool:
    """Say whether R (3, 3) is a rotation within a hundredth."""
    worst = 0.0
    for i in range(3):
        for j in range(3):
            product = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2] - (1.0 if i == j else 0.0)
            worst = max(worst, abs(product))
    triple = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        + R[0, 1] * (R[1, 2] * R[2, 0] - R[1, 0] * R[2, 2])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return worst < 1e-2 and triple > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def iterate(points: Mat, uv: Mat, R0: Mat, tol: float, epsilon: float, method: int) -> Iterated:
    """Iterate from R0: (status, R, t, iterations, squared object error, squared image error, settled, ahead)."""
    R, t = R0.copy(), np.zeros(3)
    status, H, T, mean, S2, p, v = fold(points, uv)
    if status == OK and not np.isfinite(R0.sum()):
        status = NOT_FINITE
    if status == OK and not is_rotation(R0):
        status = NOT_A_ROTATION
    if status != OK:
        return status, R, t, 0, np.nan, np.nan, False, False
    r, m = R.reshape(9), np.empty(9)
    old = object_error(H, T, S2, p, v, r, m)
    rotation_step(m, r, method)
    new = object_error(H, T, S2, p, v, r, m)
    iterations = 1
    while abs(old - new) > tol * old and new > epsilon and iterations < MAX_ITERATIONS:
        old = new
        rotation_step(m, r, method)
        new = object_error(H, T, S2, p, v, r, m)
        iterations += 1
    settled = not (abs(old - new) > tol * old and new > epsilon)
    t[:] = T @ r
    image, ahead = 0.0, True
    for i in range(p.shape[0]):
        x = r[0] * p[i, 0] + r[1] * p[i, 1] + r[2] * p[i, 2] + t[0]
        y = r[3] * p[i, 0] + r[4] * p[i, 1] + r[5] * p[i, 2] + t[1]
        z = r[6] * p[i, 0] + r[7] * p[i, 1] + r[8] * p[i, 2] + t[2]
        ahead = ahead and z > 0.0
        image += (x / z - uv[i, 0]) ** 2 + (y / z - uv[i, 1]) ** 2
    t -= R @ mean
    return status, R, t, iterations, new, image, settled, ahead
