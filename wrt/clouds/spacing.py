"""How far the points of a cloud are from their neighbours."""

from __future__ import annotations

import numpy as np

from wrt.accelerators.tree_descriptions import Bvh
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

NEIGHBOUR = 4
"""Spheres that reach the fourth neighbour close a surface of a square grid of points. Of one of random points they leave out
e^-4, as a disc of that radius holds four of them on average."""

SAMPLE = 2000
"""Points whose neighbours are looked for."""


def spacing(points: np.ndarray, device: str | None = None, num_threads: int | None = None) -> float:
    """The median distance of a point from its fourth neighbour, or from the last one if there are fewer.

    Args:
        points: (N, 3) float64, finite, N >= 1. Where most points are at the places of others, each place counts once.
        device, num_threads: as in `wrt.Scene`.

    Returns:
        A distance in the units of the points; 0 if all are at the same place.
    """
    return _spacing(points, device, num_threads) or _spacing(np.unique(points, axis=0), device, num_threads)


def _spacing(points: np.ndarray, device: str | None, num_threads: int | None) -> float:
    """The same of points that all count."""
    number = np.arange(len(points))
    mesh = TriangleMesh(points, np.repeat(number[:, None], 3, axis=1))
    scene = Scene(mesh, Bvh(), device=device, num_threads=num_threads)
    chosen = number if len(number) <= SAMPLE else np.random.default_rng(0).choice(number, SAMPLE, replace=False)
    near = scene.closest_point(points[chosen], k=min(NEIGHBOUR + 1, len(points)))
    return float(np.median(near.distance[:, -1]))
