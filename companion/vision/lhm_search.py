"""Search for the minima of the object-space error over all rotations, compiled: LHM without a start.

Rules
-----
* On rotations E(R) = r.(Omega r) with Omega = diag(S, S, S) - H and S the scatter of the points (``lhm_kernel``). Were
  r any nine numbers, the eigenvectors of Omega with the smallest eigenvalues would be where E is small, up to their
  sign: the proper rotations nearest to them are the starts, the idea of SQPnP (Terzakis, Lourakis 2020).
* The eigenvectors are taken in axes in which the points have unit scatter. Else turning a flat cloud's normal, which
  costs little, hides the pose among the eigenvectors.
* A flat cloud looks nearly alike from its pose and from the one mirrored at its plane and at the plane across the line
  of sight (Schweighofer, Pinz 2006): the mirror image of each minimum is a start too.
* From a start Newton steps on SO(3) go down. The way is not that of the listing; the minima are, and each is settled by
  the listing's iteration and stopping rule at the end.
* Three eigenvectors find the pose nearly always, and one is enough for data that fit well. The others, and mirrors at
  all principal planes, are tried when the error found leaves room for something better: for data that fit badly, and
  for four markers and fewer.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from companion.geometry import Mat, Vec
from companion.vision.absolute_orientation import LARGEST_ROOT, Nine
from companion.vision.lhm_descent import descend
from companion.vision.lhm_kernel import (
    OK,
    Three,
    dot,
    fold,
    image_error,
    moved,
    rotation_step,
    settle,
    translation,
    write_pose,
)

MAX_MINIMA = 16
"""Minima and saddles that are remembered at most."""

SAME = 0.02
"""Two minima less than this apart, in rad, are one."""

CLEAR = 1e-2
"""Share of what a pose without part in the first eigenvector costs, below which only that one is tried for the best."""

POOR = 1e-3
"""Squared error by the squared size of the cloud above which a fit is not trusted: a thirtieth of the size."""

ROW = 18
"""Numbers of a minimum: R (9), t (3), iterations, RMS object error, RMS image error, settled, ahead, a minimum."""


@njit(cache=True, nogil=True, error_model="numpy")
def cholesky_of_scatter(p: Mat) -> tuple[Mat, Mat]:
    """Return the scatter S (3, 3) of centred points and L (3, 3), L L^T = S and a millionth of its trace."""
    S, L = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(p.shape[0]):
        for j in range(3):
            for k in range(3):
                S[j, k] += p[i, j] * p[i, k]
    ridge = 1e-6 * (S[0, 0] + S[1, 1] + S[2, 2])
    for j in range(3):
        for k in range(j + 1):
            total = S[j, k] + (ridge if j == k else 0.0)
            for i in range(k):
                total -= L[j, i] * L[k, i]
            L[j, k] = np.sqrt(total) if j == k else total / L[k, k]
    return S, L


@njit(cache=True, nogil=True, error_model="numpy")
def whiten(L: Mat, B: Mat, row: int, column: int) -> None:
    """Turn the (3, 3) block of B there into L^-1 block L^-T."""
    for k in range(3):
        for j in range(3):
            for i in range(j):
                B[row + j, column + k] -= L[j, i] * B[row + i, column + k]
            B[row + j, column + k] /= L[j, j]
    for k in range(3):
        for j in range(3):
            for i in range(j):
                B[row + k, column + j] -= L[j, i] * B[row + k, column + i]
            B[row + k, column + j] /= L[j, j]


@njit(cache=True, nogil=True, error_model="numpy")
def white_omega(A: Mat, S: Mat, L: Mat) -> Mat:
    """Return Omega (9, 9) for points of unit scatter.

    A direction in which the points do not extend keeps no scatter; what is missing to one is put on the diagonal, or
    the directions that cannot be seen would be eigenvectors of zero.
    """
    B, W = np.empty((9, 9)), S.copy()
    whiten(L, W, 0, 0)
    for i in range(0, 9, 3):
        for k in range(0, 9, 3):
            for j in range(3):
                for m in range(3):
                    B[i + j, k + m] = (S[j, m] if i == k else 0.0) - A[i + j, k + m]
            whiten(L, B, i, k)
        for j in range(3):
            for m in range(3):
                B[i + j, i + m] += (1.0 if j == m else 0.0) - W[j, m]
    return B


@njit(cache=True, nogil=True)
def start_from(L: Mat, axis: Vec, sign: float) -> Nine:
    """Return the rotation R for which R L is nearest to plus or minus an eigenvector (9,)."""
    M = np.zeros(9)
    for i in range(3):
        for j in range(3):
            for k in range(j + 1):
                M[3 * i + j] += sign * L[j, k] * axis[3 * i + k]
    return rotation_step(nine(M), 0, LARGEST_ROOT)[0]


@njit(cache=True, nogil=True, forceinline=True)
def nine(row: Vec) -> Nine:
    """Return the first nine numbers of a row."""
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8]


@njit(cache=True, nogil=True, error_model="numpy")
def mirrored(A: Mat, r: Nine, normal: Vec) -> Nine:
    """Return (I - 2 d d^T) R (I - 2 n n^T), d the direction to the points: what a plane of normal n is mistaken for."""
    x, y, z = translation(A, r)
    w = 2.0 / (x * x + y * y + z * z)
    M = np.empty(9)
    for j in range(3):
        along = w * (x * r[j] + y * r[3 + j] + z * r[6 + j])
        M[j], M[3 + j], M[6 + j] = r[j] - along * x, r[3 + j] - along * y, r[6 + j] - along * z
    for i in range(0, 9, 3):
        along = 2.0 * (normal[0] * M[i] + normal[1] * M[i + 1] + normal[2] * M[i + 2])
        for j in range(3):
            M[i + j] -= along * normal[j]
    return nine(M)


@njit(cache=True, nogil=True)
def visit(A: Mat, S2: float, p: Mat, start: Nine, found: Mat, count: int) -> int:
    """Go down from a start and add a minimum that is new to found (MAX_MINIMA, 13). Return how many there are.

    Its row is r, squared error, steps, 1 when all points are before the camera, 1 when it is known to be a minimum.
    """
    r, error, steps, minimum = descend(A, S2, start)
    if count == MAX_MINIMA:
        return count
    for i in range(count):
        if dot(nine(found[i]), r) > 3.0 - SAME * SAME:  # 1 + 2 cos of the angle between them
            return count
    ahead, t = True, translation(A, r)
    for i in range(p.shape[0]):
        ahead = ahead and moved(p, i, r, t)[2] > 0.0
    row = found[count]
    row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8] = r
    row[9], row[10], row[11], row[12] = error, steps, 1.0 if ahead else 0.0, 1.0 if minimum else 0.0
    return count + 1


@njit(cache=True, nogil=True)
def best_of(found: Mat, first: int, count: int) -> int:
    """Return the row from first on with the least error, those before the camera first."""
    best = first
    for k in range(first + 1, count):
        if found[k, 11] > found[best, 11] or (found[k, 11] == found[best, 11] and found[k, 9] < found[best, 9]):
            best = k
    return best


@njit(cache=True, nogil=True)
def enough(found: Mat, count: int, error: float) -> bool:
    """Say whether a minimum before the camera has at most this squared error."""
    best = best_of(found, 0, count)
    return found[best, 11] > 0.0 and found[best, 9] <= error


@njit(cache=True, nogil=True)
def explore(A: Mat, S2: float, p: Mat, found: Mat, thorough: bool) -> int:
    """Write minima into found (MAX_MINIMA, 13) and return how many: all that can be reached, or the best at least.

    The numbers of a rotation, in axes of unit scatter, have the squared length S2: with no part in the first k
    eigenvectors its error is at least S2 times the next eigenvalue. An error far below that leaves no room elsewhere.
    """
    S, L = cholesky_of_scatter(p)
    values, vectors = np.linalg.eigh(white_omega(A, S, L))
    count, i = 0, 0
    for k in range(6):
        if k == 2 and not thorough and enough(found, count, CLEAR * values[1] * S2):
            return count
        count = visit(A, S2, p, start_from(L, vectors[:, k // 2], 1.0 - 2.0 * (k % 2)), found, count)
    planes = np.linalg.eigh(S)[1]
    while i < count:
        count = visit(A, S2, p, mirrored(A, nine(found[i]), planes[:, 0]), found, count)
        i += 1
    if enough(found, count, min(values[3], POOR) * S2):
        return count
    for k in range(6, 18):
        count = visit(A, S2, p, start_from(L, vectors[:, k // 2], 1.0 - 2.0 * (k % 2)), found, count)
    i = 0
    while i < count:
        for k in range(3):
            count = visit(A, S2, p, mirrored(A, nine(found[i]), planes[:, k]), found, count)
        i += 1
    return count


@njit(cache=True, nogil=True)
def search(points: Mat, uv: Mat, tol: float, epsilon: float, method: int, table: Mat) -> tuple[int, int]:
    """Write the minima into table (k, ROW), those ahead first, then by their error: (status, rows written)."""
    status, A, p, mean, S2 = fold(points, uv)
    if status != OK:
        return status, 0
    found = np.empty((MAX_MINIMA, 13))
    count = explore(A, S2, p, found, table.shape[0] > 1)
    rows = min(count, table.shape[0])
    for i in range(rows):
        best = best_of(found, i, count)
        for k in range(13):
            found[i, k], found[best, k] = found[best, k], found[i, k]
        write_row(A, S2, p, uv, mean, found[i], tol, epsilon, method, table[i])
    return status, rows


@njit(cache=True, nogil=True, error_model="numpy")
def write_row(
    A: Mat, S2: float, p: Mat, uv: Mat, mean: Three, known: Vec, tol: float, epsilon: float, method: int, row: Vec
) -> None:
    """Settle a minimum by the listing's iteration and write it into row (ROW,)."""
    r, iterations, error, settled = settle(A, S2, p, uv, nine(known), tol, epsilon, method)
    shift = translation(A, r)
    squared, ahead = image_error(p, uv, r, shift)
    write_pose(r, shift, mean, row[:9].reshape(3, 3), row[9:12])
    n = p.shape[0]
    row[12], row[13], row[14] = known[10] + iterations, np.sqrt(error / n), np.sqrt(squared / n)
    row[15], row[16], row[17] = 1.0 if settled else 0.0, 1.0 if ahead else 0.0, known[12]
