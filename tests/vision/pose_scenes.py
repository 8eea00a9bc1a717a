"""Random scenes for the pose solvers, and the thesis' LHM listing in plain numpy to hold them to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from companion.geometry import SE3, Mat
from companion.vision.lhm import solve_lhm

FOCAL_PX = 550.0
APART_RAD = 0.05


@dataclass(frozen=True)
class Scene:
    """Points in tanker axes, their noisy picture on z = 1, and where they are."""

    T: SE3
    points: Mat
    uv: Mat


def scene(rng: np.random.Generator, n: int | None = None, thick_m: float | None = None, near: bool = False) -> Scene:
    """Draw 5 to 10 points in a box, a slab or a plane, at any attitude, 14 to 80 m away, with 0 to 3 px of noise."""
    n = int(rng.integers(5, 11)) if n is None else n
    thick = rng.choice([0.0, rng.uniform(0.02, 0.5), rng.uniform(1.0, 6.0)]) if thick_m is None else thick_m
    points = rng.uniform(-1, 1, (n, 3)) * [10.0, 12.0, thick] @ Rotation.random(rng=rng).as_matrix()
    z = rng.uniform(14, 30) if near or rng.random() < 0.5 else rng.uniform(30, 80)
    while True:
        T = SE3(Rotation.random(rng=rng).as_matrix(), np.array([*rng.uniform(-0.25, 0.25, 2) * z, z]))
        q = T.transform(points)
        if q[:, 2].min() > 2.0:
            break
    noise = rng.choice([0.0, 0.3, 1.0, 3.0]) / FOCAL_PX
    return Scene(T, points, q[:, :2] / q[:, 2:] + rng.normal(0.0, noise, (n, 2)))


def ahead(T: SE3, points: Mat) -> bool:
    """Say whether all points are before the camera."""
    return bool((T.transform(points)[:, 2] > 0.0).all())


def angle_rad(Ra: Mat, Rb: Mat) -> float:
    """Return the angle between two rotations."""
    return float(np.linalg.norm(Rotation.from_matrix(Ra @ Rb.T).as_rotvec()))


def minima_from_everywhere(s: Scene, rng: np.random.Generator, starts: int = 60) -> tuple[float, Mat, float]:
    """Iterate from the truth and from random rotations: the least error in m, its rotation, the next one's by it.

    Only minima with all points before the camera count, and those more than ``APART_RAD`` from the best are others.
    """
    rotations = [s.T.R, *Rotation.random(starts, rng=rng).as_matrix()]
    found = [solve_lhm(s.points, s.uv, R, tol=1e-9, epsilon=1e-14) for R in rotations]
    found = sorted((f for f in found if ahead(f.T_cam_tanker, s.points)), key=lambda f: f.object_error)
    best = found[0]
    others = [f for f in found if angle_rad(f.T_cam_tanker.R, best.T_cam_tanker.R) > APART_RAD]
    ratio = others[0].object_error / max(best.object_error, 1e-6) if others else np.inf
    return best.object_error, best.T_cam_tanker.R, ratio


class Listing:
    """Thesis 10.3.2 and ch. 6 in plain numpy, point by point, in a right-handed camera frame."""

    def __init__(self, points: Mat, uv: Mat, *, quaternion: bool = False, guarded: bool = True) -> None:
        self.n, self.mean = len(points), points.mean(axis=0)
        self.p, self.v = points - self.mean, np.column_stack([uv, np.ones(len(uv))])
        self.F = np.array([np.outer(v, v) / (v @ v) for v in self.v])
        self.factor = np.linalg.inv(np.eye(3) - self.F.sum(axis=0) / self.n) / self.n
        self.quaternion, self.guarded = quaternion, guarded

    def place(self, R: Mat) -> tuple[Mat, Mat, float]:
        """Return the best translation of R, the points placed by it, and the sum of squared errors."""
        t = self.factor @ sum((self.F[i] - np.eye(3)) @ R @ self.p[i] for i in range(self.n))
        q = self.p @ R.T + t
        return t, q, sum(float(np.sum(((np.eye(3) - self.F[i]) @ q[i]) ** 2)) for i in range(self.n))

    def rotation(self, q: Mat) -> Mat:
        """Return the rotation from the points to the shadows of q on the lines of sight."""
        q = np.array([self.F[i] @ q[i] for i in range(self.n)])
        q = q - q.mean(axis=0)
        if self.quaternion:
            return Rotation.align_vectors(q, self.p)[0].as_matrix()
        U, _, Vt = np.linalg.svd(self.p.T @ q)
        sign = np.linalg.det(Vt.T @ U.T) if self.guarded else 1.0
        return Vt.T @ np.diag([1.0, 1.0, sign]) @ U.T

    def solve(self, R: Mat | None, tol: float = 1e-5, epsilon: float = 1e-8) -> tuple[Mat, Mat, int, float]:
        """Return R, t, iterations and RMS object error; None starts from the image points themselves."""
        iterations = 0
        if R is None:
            R, iterations = self.rotation(self.v), 1
        _, q, old = self.place(R)
        while True:
            R = self.rotation(q)
            t, q, new = self.place(R)
            iterations += 1
            if not (abs((old - new) / old) > tol and new > epsilon):
                break
            old = new
        if t[2] < 0.0 and not self.guarded:
            R, t = -R, -t
        return R, t - R @ self.mean, iterations, float(np.sqrt(new / self.n))
