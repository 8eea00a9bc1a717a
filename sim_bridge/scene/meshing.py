"""Triangle meshes and the few shapes that aircraft are made of.

Rules
-----
* Axes are the body's: forward, right, down, in metres. Triangles wind so that ``(v1 - v0) x (v2 - v0)`` points out.
* Every part is a closed surface, so its signed volume is positive and the far side can be culled.
* Colours are reflectances 0..1, red green blue, in the linear units of the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import Mat, Vec

Colour = tuple[float, float, float]
Paint = Colour | Callable[[Mat], Mat]
"""One colour, or a function of vertices (n, 3) in m to colours (n, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangle mesh: ``vertices`` (n, 3) m, ``triangles`` (m, 3) int32, ``colours`` and ``normals`` (n, 3)."""

    vertices: Mat
    triangles: NDArray[np.int32]
    colours: Mat
    normals: Mat

    def volume_m3(self) -> float:
        """Return the signed volume enclosed; positive when the triangles wind outwards."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    def mirrored(self) -> Mesh:
        """Return the mirror image in the plane of symmetry y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        return Mesh(self.vertices * flip, self.triangles[:, ::-1].copy(), self.colours, self.normals * flip)


def merge(parts: Sequence[Mesh]) -> Mesh:
    """Return all parts as one mesh."""
    starts = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return Mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.triangles + s for p, s in zip(parts, starts, strict=True)]).astype(np.int32),
        np.concatenate([p.colours for p in parts]),
        np.concatenate([p.normals for p in parts]),
    )


def loft(sections: Mat, paint: Paint, crease_rad: float = 0.7) -> Mesh:
    """Return the closed skin over closed loops ``sections`` (s, k, 3), ends capped with fans.

    Faces that meet at more than ``crease_rad`` keep an edge; flatter ones are shaded smoothly across.
    """
    s, k, _ = sections.shape
    vertices = np.concatenate([sections.reshape(-1, 3), sections[[0, -1]].mean(axis=1)])
    i = np.arange(s - 1)[:, None] * k
    j = np.arange(k)[None, :]
    a, b = (i + j).ravel(), (i + (j + 1) % k).ravel()
    side = np.concatenate([np.stack([a, b, a + k], 1), np.stack([b, b + k, a + k], 1)])
    first, last, nxt = np.arange(k), np.arange(k) + (s - 1) * k, (np.arange(k) + 1) % k
    caps = np.concatenate(
        [
            np.stack([nxt, first, np.full(k, s * k)], 1),
            np.stack([last, nxt + (s - 1) * k, np.full(k, s * k + 1)], 1),
        ]
    )
    return finish(vertices, np.concatenate([side, caps]), paint, crease_rad)


def finish(vertices: Mat, triangles: NDArray[np.int64], paint: Paint, crease_rad: float) -> Mesh:
    """Drop empty triangles, wind them outwards, and give every vertex a normal and a colour."""
    a, b, c = (vertices[triangles[:, n]] for n in range(3))
    cross = np.cross(b - a, c - a)
    keep = np.sqrt(np.einsum("ij,ij->i", cross, cross)) > 1e-7
    triangles, cross = triangles[keep], cross[keep]
    if np.einsum("ij,ij->", a[keep], np.cross(b[keep], c[keep])) < 0:
        triangles, cross = triangles[:, ::-1], -cross
    corner_normals = creased_normals(triangles, cross, crease_rad)
    keys = np.column_stack([triangles.reshape(-1), np.round(corner_normals, 6)])
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    points = vertices[unique[:, 0].astype(np.int64)]
    colours = paint(points) if callable(paint) else np.tile(np.array(paint), (len(points), 1))
    return Mesh(points, inverse.reshape(-1, 3).astype(np.int32), colours, unique[:, 1:].copy())


def creased_normals(triangles: NDArray[np.int64], cross: Mat, crease_rad: float) -> Mat:
    """Return unit normals (3m, 3) per corner: area-weighted over the faces at its vertex within the crease angle."""
    unit = cross / np.sqrt(np.einsum("ij,ij->i", cross, cross))[:, None]
    corner_vertex = triangles.reshape(-1)
    corner_face = np.repeat(np.arange(len(triangles)), 3)
    order = np.argsort(corner_vertex, kind="stable")
    starts = np.flatnonzero(np.diff(corner_vertex[order], prepend=-1))
    normals = np.zeros((len(corner_vertex), 3))
    for group in np.split(order, starts[1:]):
        faces = corner_face[group]
        near = unit[faces] @ unit[faces].T > np.cos(crease_rad)
        normals[group] = near @ cross[faces]
    return normals / np.sqrt(np.einsum("ij,ij->i", normals, normals))[:, None]


def ring(centre: Vec, half_y: float, half_up: float, half_down: float, count: int, power: float = 2.0) -> Mat:
    """Return a superellipse loop (count, 3) across x; ``power`` 2 is an ellipse, larger is boxier."""
    t = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    y = np.sign(np.cos(t)) * np.abs(np.cos(t)) ** (2.0 / power)
    z = np.sign(np.sin(t)) * np.abs(np.sin(t)) ** (2.0 / power)
    loop = np.column_stack([np.zeros(count), half_y * y, np.where(z > 0, half_down, half_up) * z])
    return loop + centre


def aerofoil(leading_edge: Vec, chord: float, thickness: float, camber: float = 0.0, across: Vec | None = None) -> Mat:
    """Return a closed section (13, 3) in the plane of x and ``across`` (default down), NACA 4-digit thickness.

    ``thickness`` and ``camber`` are fractions of the chord; ``across`` is the unit vector towards the lower side.
    """
    c = np.array([1.0, 0.72, 0.45, 0.25, 0.12, 0.04, 0.0])
    half = 5.0 * thickness * (0.2969 * np.sqrt(c) - 0.1260 * c - 0.3516 * c**2 + 0.2843 * c**3 - 0.1015 * c**4)
    mean = -4.0 * camber * c * (1.0 - c)
    x = np.concatenate([c, c[-2::-1]])
    z = np.concatenate([mean + half, (mean - half)[-2::-1]])
    down = np.array([0.0, 0.0, 1.0]) if across is None else across
    return leading_edge + np.column_stack([-chord * x, np.zeros(len(x)), np.zeros(len(x))]) + chord * z[:, None] * down


def revolution(x: Sequence[float], radius: Sequence[float], centre_yz: tuple[float, float], count: int, paint: Paint,
               crease_rad: float = 0.7) -> Mesh:
    """Return a body of revolution about a line along x through ``centre_yz``."""
    y, z = centre_yz
    rings = [ring(np.array([a, y, z]), r, r, r, count) for a, r in zip(x, radius, strict=True)]
    return loft(np.stack(rings), paint, crease_rad)
