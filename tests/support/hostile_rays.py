"""Rays that break traversals of boxes: at vertices and edges, along axes, in planes, of any length, from afar, and bad ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import wrt

Vectors = np.ndarray


class HostileRays:
    """Ten kinds of rays at a mesh, float32; each a method of its name in `KINDS`.

    Args:
        mesh: what they are aimed at.
        count: rays of a kind.
        seed: of all random numbers.
    """

    def __init__(self, mesh: wrt.TriangleMesh, count: int, seed: int = 5) -> None:
        self.rng, self.count = np.random.default_rng(seed), count
        vertices = np.asarray(mesh.vertices, np.float32)
        corners = vertices[mesh.faces[self.rng.integers(0, mesh.triangle_count, count)]]
        self.size = np.float32(np.linalg.norm(np.ptp(vertices, axis=0)))
        self.vertex = corners[np.arange(count), self.rng.integers(0, 3, count)]
        self.middle = (0.5 * (corners[:, 0] + corners[:, 1])).astype(np.float32)
        self.around = (vertices.mean(axis=0) + self.normal() * self.size).astype(np.float32)

    def normal(self) -> Vectors:
        """(count, 3) normally distributed numbers."""
        return self.rng.normal(size=(self.count, 3)).astype(np.float32)

    def axes(self) -> Vectors:
        """(count, 3) unit vectors along axes."""
        signs = self.rng.choice(np.array([-1, 1], np.float32), (self.count, 1))
        return np.eye(3, dtype=np.float32)[self.rng.integers(0, 3, self.count)] * signs

    def along_axes_through_vertices(self) -> tuple[Vectors, Vectors]:
        axes = self.axes()
        return self.vertex - axes * self.size, axes

    def along_axes_from_vertices(self) -> tuple[Vectors, Vectors]:
        return self.vertex, self.axes()

    def in_planes_of_axes(self) -> tuple[Vectors, Vectors]:
        directions = self.normal()
        directions[np.arange(self.count), self.rng.integers(0, 3, self.count)] = 0
        return self.vertex - directions * 4, directions

    def to_vertices(self) -> tuple[Vectors, Vectors]:
        return self.around, self.vertex - self.around

    def to_edges(self) -> tuple[Vectors, Vectors]:
        return self.around, self.middle - self.around

    def from_vertices(self) -> tuple[Vectors, Vectors]:
        return self.vertex, self.normal()

    def long(self) -> tuple[Vectors, Vectors]:
        powers = np.exp2(self.rng.choice([30.0, 60.0, 100.0, 120.0], (self.count, 1))).astype(np.float32)
        return self.around, (self.vertex - self.around) * powers / self.size

    def short(self) -> tuple[Vectors, Vectors]:
        powers = np.exp2(-self.rng.choice([30.0, 60.0, 100.0, 120.0, 126.0], (self.count, 1))).astype(np.float32)
        return self.around, (self.vertex - self.around) * powers / self.size

    def from_afar(self) -> tuple[Vectors, Vectors]:
        origins = self.vertex + self.normal() * self.size * np.float32(1e4)
        return origins, self.vertex - origins

    def bad(self) -> tuple[Vectors, Vectors]:
        origins, directions = self.around.copy(), self.vertex - self.around
        origins[::7, 1], origins[::17, 0] = np.nan, -np.inf
        directions[::11], directions[::13, 2], directions[::5, 0] = 0, np.inf, -0.0
        return origins, directions


KINDS: dict[str, Callable[[HostileRays], tuple[Vectors, Vectors]]] = {
    name.replace("_", " "): getattr(HostileRays, name)
    for name in (
        "along_axes_through_vertices",
        "along_axes_from_vertices",
        "in_planes_of_axes",
        "to_vertices",
        "to_edges",
        "from_vertices",
        "long",
        "short",
        "from_afar",
        "bad",
    )
}


def grid_mesh(cells: int, height: float) -> wrt.TriangleMesh:
    """A square of cells x cells x 2 triangles, flat or with hills of a height."""
    x, y = np.meshgrid(*[np.linspace(0, 10, cells + 1)] * 2, indexing="ij")
    z = height * (np.sin(x) * np.cos(1.3 * y) + 0.2 * np.sin(5 * x + 3 * y))
    at = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return wrt.TriangleMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)


def coincident_mesh(count: int) -> wrt.TriangleMesh:
    """The same triangle many times: every hit is a tie."""
    triangle = np.array([[0, 0, 0], [1, 0, 0.5], [0, 1, 0.25]])
    return wrt.TriangleMesh(np.tile(triangle, (count, 1)), np.arange(3 * count).reshape(-1, 3))


MESHES: dict[str, Callable[[], wrt.TriangleMesh]] = {
    "teapot": lambda: wrt.scenes.build("teapot", level=4),
    "flat": lambda: grid_mesh(20, 0.0),
    "hills": lambda: grid_mesh(20, 1.0),
    "coincident": lambda: coincident_mesh(300),
}
