"""Two scenes like those that Falcone 2024 takes from elsewhere: a low-poly head (Suzanne), and a furnished court (Sponza)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import build
from wrt.scenes.shapes import copies, lathe, sheets, without_collapsed


def ellipsoid(center: Sequence[float], radii: Sequence[float], rings: int, segments: int, tilt: float = 0.0) -> TriangleMesh:
    """A closed ellipsoid.

    Args:
        center: (3,).
        radii: (3,) along x, y and z.
        rings: of faces from pole to pole, at least 2.
        segments: of faces around z, at least 3.
        tilt: turn about y, in radians.
    """
    angles = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    profile[[0, -1], 0] = 0.0
    ball = without_collapsed(lathe(profile, segments))
    turn = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    return TriangleMesh(ball.vertices * np.array(radii) @ turn.T + np.array(center), ball.faces)


def head() -> TriangleMesh:
    """An ape's head of about 1,000 triangles that looks along -y: skull, brow, muzzle, eyes and ears, all smooth."""
    parts = [
        ellipsoid((0.0, 0.0, 0.15), (0.75, 0.8, 0.8), 12, 16),
        ellipsoid((0.0, -0.62, 0.32), (0.5, 0.2, 0.16), 6, 12),
        ellipsoid((0.0, -0.62, -0.28), (0.42, 0.38, 0.36), 8, 12),
        ellipsoid((0.0, -0.98, -0.18), (0.1, 0.06, 0.06), 4, 8),
    ]
    for side in (-1.0, 1.0):
        parts.append(ellipsoid((0.27 * side, -0.7, 0.12), (0.14, 0.12, 0.14), 6, 8))
        parts.append(ellipsoid((1.0 * side, 0.12, 0.15), (0.4, 0.1, 0.42), 6, 12, 0.4 * side))
    return TriangleMesh.concatenate(parts, name="head")


def palace(urns: int = 18, seed: int = 0) -> TriangleMesh:
    """The court of the atrium, furnished: drapes between columns, urns on the floor, lamps on chains, and a carved relief.

    Args:
        urns: how many, at least 1.
        seed: the same seed gives the same places.
    """
    court = build("atrium", bays=(5, 3), storeys=2, detail=2)
    (low, high), random = court.bounds, np.random.default_rng(seed)
    size = high - low
    middle, storey = (low + high) / 2, 0.45 * size[2]
    drop, along = np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 25)
    drapes = []
    for number, place in enumerate(np.linspace(0.2, 0.8, 4)):
        folds = 0.01 * size[1] * np.sin(8.0 * np.pi * along)[None, :] * (0.4 + drop[:, None])
        x = low[0] + size[0] * place + 0.06 * size[0] * (along - 0.5)[None, :] * np.ones((9, 1))
        y = np.where(number % 2, high[1] - 0.3 * size[1], low[1] + 0.3 * size[1]) + folds
        z = low[2] + storey * (1.0 - 0.55 * drop)[:, None] * np.ones((1, 25))
        drapes.append(sheets(np.stack([x, y, z], axis=-1)))
    bow = np.array([(0.0, 0.0), (0.5, 0.0), (0.6, 0.1), (0.25, 0.25), (0.9, 0.9), (1.0, 1.4), (0.5, 1.9), (0.7, 2.1)])
    ground = np.stack([*(random.uniform(low[a] + 0.3 * size[a], high[a] - 0.3 * size[a], urns) for a in (0, 1))], axis=1)
    stands = np.c_[ground, np.full(urns, low[2] + 0.01 * size[2])]
    urn = without_collapsed(lathe(0.02 * size[2] * bow, 12))
    lamp = without_collapsed(
        lathe(0.012 * size[2] * np.array([(0.0, 0.0), (1.0, 0.5), (0.9, 1.5), (0.1, 2.0), (0.05, 12.0)]), 10)
    )
    hooks = [(middle[0] + share * size[0], middle[1], low[2] + 0.6 * storey) for share in (-0.2, 0.0, 0.2)]
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 29), np.linspace(-1.0, 1.0, 29), indexing="xy")
    depth = 0.012 * size[0] * (np.cos(3.0 * u) * np.cos(4.0 * v) + 0.3 * np.sin(11.0 * u + 7.0 * v * v))
    relief = np.stack(
        [low[0] + 0.24 * size[0] + depth, middle[1] + 0.1 * size[1] * u, low[2] + storey * (0.5 + 0.3 * v)], axis=-1
    )
    parts = [court, *drapes, copies(urn, stands), copies(lamp, hooks), sheets(relief)]
    return TriangleMesh.concatenate([TriangleMesh(part.vertices, part.faces) for part in parts], name="palace")
