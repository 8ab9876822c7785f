"""Closed convex bodies that are hard on a ray tracer: needles, slivers, poles, coincident vertices, any scale and place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import trimesh

import wrt


def graded_box(steps: int = 9) -> trimesh.Trimesh:
    """A box whose faces are cut into rectangles from 1 down to 1e-6 wide, without T-junctions: needles of up to 1e6."""
    ends = np.concatenate([[0.0], np.geomspace(1e-6, 0.5, steps)])
    lines = np.unique(np.concatenate([ends, 1.0 - ends]))
    n = len(lines)
    corner = np.arange((n - 1) * n).reshape(n - 1, n)[:, :-1].ravel()
    quads = np.stack([corner, corner + 1, corner + n + 1, corner + n], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    u, v = (x.ravel() for x in np.meshgrid(lines, lines, indexing="ij"))
    parts = []
    for axis in range(3):
        for side in (0.0, 1.0):
            points = np.insert(np.stack([u, v], axis=1), axis, side, axis=1)
            outwards = side == (0.0 if axis == 1 else 1.0)  # of u x v, the other two axes in order
            turned = faces if outwards else faces[:, ::-1]
            parts.append(trimesh.Trimesh(points, turned, process=False))
    mesh = trimesh.util.concatenate(parts)
    mesh.merge_vertices(digits_vertex=9)
    return mesh


def apart(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same triangles, each with vertices of its own."""
    corners = mesh.triangles.reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)


def scaled(mesh: trimesh.Trimesh, *factors: float) -> trimesh.Trimesh:
    """Stretched along the axes, then turned."""
    mesh = mesh.copy()
    mesh.apply_scale(factors)
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(len(factors)).random(3)))
    return mesh


SHAPES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "box": lambda: trimesh.creation.box(extents=(1, 2, 3)),
    "graded box": graded_box,
    "turned graded box": lambda: scaled(graded_box(), 1.0, 1.0, 1.0),
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=4),
    "vertices apart": lambda: apart(trimesh.creation.icosphere(subdivisions=3)),
    "poles": lambda: trimesh.creation.uv_sphere(count=(48, 96)),
    "lens": lambda: scaled(trimesh.creation.icosphere(subdivisions=3), 1.0, 1.0, 1e-3),
    "rod": lambda: scaled(trimesh.creation.uv_sphere(count=(24, 24)), 1e-3, 1e-3, 1.0),
    "slab": lambda: scaled(trimesh.creation.box(), 100.0, 100.0, 0.01),
    "fans": lambda: trimesh.creation.cylinder(radius=1.0, height=0.05, sections=512),
    "needle": lambda: scaled(trimesh.creation.box(), 1e-5, 1e-5, 1.0),
}
PLACES = {"here": (1.0, 0.0), "small": (1e-4, 0.0), "huge": (1e6, 0.0), "far off": (1.0, 1e4), "small, far off": (1e-3, 10.0)}
"""Scale, and distance from the origin."""


@dataclass
class Body:
    """A body in its place.

    Attributes:
        mesh: with float64 vertices, those that the scene rounds.
        points: (V, 3) float64, the vertices as the scene has them.
        edges: (E, 2) vertices of each edge.
    """

    name: str
    mesh: wrt.TriangleMesh
    points: np.ndarray
    edges: np.ndarray

    @property
    def farthest(self) -> float:
        """How far away rays may start, in sizes of the body: rounding then moves them by an eighth of its thickness at most."""
        corners = self.points[self.mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        middle = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        thickness = 2.0 * np.nanmin(np.abs(((corners[:, 0] - middle) * normal).sum(axis=1)))
        return thickness / 8.0 / (2.0**-23 * np.ptp(self.points, axis=0).max())

    def features(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, 3) vertices and points of edges, half and half."""
        ends = self.points[self.edges[rng.integers(0, len(self.edges), count)]]
        share = rng.choice([0.5, 1 / 3, 0.25], count) + np.where(rng.random(count) < 0.5, rng.random(count) * 0.25, 0.0)
        share[rng.random(count) < 0.5] = 0.0
        return ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])

    def inner_points(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, 3) points deep inside."""
        middle = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        return middle + 0.5 * rng.random((count, 1)) * (self.points[rng.integers(0, len(self.points), count)] - middle)


def bodies() -> Iterator[Body]:
    """Every shape in every place."""
    for shape, make in SHAPES.items():
        mesh = make()
        for place, (scale, offset) in PLACES.items():
            vertices = np.asarray(mesh.vertices, dtype=np.float64) * scale + offset * np.array([1.0, -0.7, 0.4])
            placed = wrt.TriangleMesh(vertices, np.asarray(mesh.faces))
            edges = np.sort(np.asarray(mesh.faces)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
            yield Body(f"{shape}, {place}", placed, np.asarray(placed.vertices, np.float64), np.unique(edges, axis=0))
