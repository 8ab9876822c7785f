"""A town of any number of triangles: houses of random heights on a grid of streets, and points on the ground between them."""

from __future__ import annotations

import numpy as np

from wrt.meshes.mesh import TriangleMesh

LOT = 30.0
"""Width of a lot, in metres."""


def town(triangles: int, detail: int = 7, seed: int = 0) -> TriangleMesh:
    """Boxes of sides of detail x detail squares, without floors, on a flat ground; about this many triangles, z up, metres."""
    side = max(1, round((triangles / (10 * detail * detail)) ** 0.5))
    rng = np.random.default_rng(seed)
    u, v = (one.reshape(-1) for one in np.meshgrid(np.linspace(0, 1, detail + 1), np.linspace(0, 1, detail + 1)))
    zero, one = np.zeros_like(u), np.ones_like(u)
    sides = np.stack([(u, zero, v), (u, one, v), (zero, u, v), (one, u, v), (u, v, one)]).transpose(0, 2, 1)
    first = (np.arange(detail)[:, None] * (detail + 1) + np.arange(detail)).reshape(-1, 1)
    square = np.concatenate([first + np.int64([0, 1, detail + 2]), first + np.int64([0, detail + 2, detail + 1])])
    faces = np.concatenate([square + number * u.size for number in range(5)])
    corner = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) * LOT
    low = np.concatenate([corner + rng.uniform(4.0, 8.0, corner.shape), np.zeros((len(corner), 1))], axis=1)
    size = np.column_stack([rng.uniform(10.0, 18.0, corner.shape), rng.gamma(4.0, 4.0, len(corner)) + 4.0])
    boxes = low[:, None] + sides.reshape(1, -1, 3) * size[:, None]
    all_faces = faces + (np.arange(len(corner)) * boxes.shape[1])[:, None, None]
    ground = np.float64([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * side * LOT
    vertices = np.concatenate([boxes.reshape(-1, 3), ground])
    last = len(vertices) - 4
    everything = np.concatenate([all_faces.reshape(-1, 3), [[last, last + 1, last + 2], [last, last + 2, last + 3]]])
    return TriangleMesh(vertices, everything, name="town")


def ground_points(mesh: TriangleMesh, count: int, seed: int = 1) -> np.ndarray:
    """(N, 3) points 1.5 m above the ground of a town, in rows from south to north, so that neighbours see like things."""
    low, high = mesh.bounds
    points = np.random.default_rng(seed).uniform(low, high, (count, 3))
    points[:, 2] = 1.5
    return points[np.lexsort((points[:, 0], points[:, 1] // (2 * LOT)))]


def sun_directions(count: int, latitude: float = 48.0) -> np.ndarray:
    """(M, 3) unit vectors to the sun, x to the east, y to the north: through the days of a year, as far as it has risen."""
    day, hour = (one.reshape(-1) for one in np.meshgrid(np.arange(0, 365, 3), np.arange(0.0, 24.0, 0.1), indexing="ij"))
    declination, turn = np.radians(23.45) * np.sin(2 * np.pi * (284 + day) / 365), np.radians(15.0 * (hour - 12.0))
    phi = np.radians(latitude)
    east = -np.cos(declination) * np.sin(turn)
    north = np.cos(phi) * np.sin(declination) - np.sin(phi) * np.cos(declination) * np.cos(turn)
    up = np.sin(phi) * np.sin(declination) + np.cos(phi) * np.cos(declination) * np.cos(turn)
    risen = np.stack([east, north, up], axis=-1)[up > 0.02]
    return risen[np.linspace(0, len(risen) - 1, count).astype(np.int64)]
