"""Recesses are darker: light from all around reaches every vertex by as much as the mesh itself leaves free."""

from __future__ import annotations

import numpy as np

from companion.geometry import Mat, Vec
from sim_bridge.scene import rasterizer as kernels
from sim_bridge.scene.meshing import Mesh

DIRECTIONS = 64
SIZE_PX = 512
FAR_M = 2000.0
LIFT_M = 0.12
"""Vertices are lifted off their own face by this, along the normal, before asking what is in front of them."""

DARKEST = 0.40


def shade_recesses(mesh: Mesh) -> Mesh:
    """Return the mesh with each colour darkened by the share of the sky that its vertex does not see.

    The share is counted over DIRECTIONS evenly spread pictures from far away, weighted with the cosine to the normal.
    """
    lifted = mesh.vertices + LIFT_M * mesh.normals
    free, total = np.zeros(len(lifted)), np.full(len(lifted), 1e-9)
    for direction in sphere_points(DIRECTIONS):
        weight = np.maximum(mesh.normals @ direction, 0.0)
        total += weight
        free += weight * sees(mesh, lifted, direction)
    shade = DARKEST + (1.0 - DARKEST) * free / total
    return Mesh(mesh.vertices, mesh.triangles, mesh.colours * shade[:, None], mesh.normals)


def sees(mesh: Mesh, points: Mat, direction: Vec) -> Vec:
    """Return 1.0 for each of ``points`` (n, 3) from which nothing of the mesh is in the given direction, else 0.0."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    right = np.cross(helper, direction)
    right /= np.sqrt(right @ right)
    R_cam = np.stack([right, np.cross(-direction, right), -direction])
    centre = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    radius = float(np.sqrt(np.max(np.sum((mesh.vertices - centre) ** 2, axis=1))))
    lens = np.array([0.49 * SIZE_PX / radius * FAR_M] * 2 + [0.5 * (SIZE_PX - 1)] * 2)
    xyz, seen = ((p - centre) @ R_cam.T + [0.0, 0.0, FAR_M] for p in (mesh.vertices, points))
    table = np.empty((len(mesh.triangles), kernels.COLUMNS))
    box = np.empty((len(mesh.triangles), 4), np.int32)
    depth = kernels.draw_depth(xyz, mesh.triangles, lens, np.array([SIZE_PX, SIZE_PX], np.int32), table, box)
    u, v = (np.clip(np.round(lens[k] * seen[:, k] / seen[:, 2] + lens[2 + k]), 0, SIZE_PX - 1) for k in (0, 1))
    return (1.0 / seen[:, 2] >= depth[v.astype(int), u.astype(int)]).astype(np.float64)


def sphere_points(count: int) -> Mat:
    """Return unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, k * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
