"""Points on surfaces: at random, or with a least distance from each other.

**Problem.** Points at random lie in heaps, and leave holes.

**Idea.** Points are thrown at random, and one is kept if no earlier one is kept within the radius (Cook 1986). Which ones these
are depends on the order only, so that a kernel finds all of them in a few rounds: a point is kept when all earlier ones near it
are left out, and left out when one is kept. The first points are settled before others are looked at.

References: cook-1986.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.kernels.fields.disc_samples import KEPT, OPEN, settle
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.validation import as_float, as_int
from wrt.meshes.mesh_measures import normals_and_areas

if TYPE_CHECKING:
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

THROWN = 12.0
"""Points that are thrown for each area of radius x radius; some 0.6 are kept."""

MAX_POINTS = 1 << 26
"""Largest number of points."""

MIN_PART = 4096
"""Points that are settled at a time, at least."""

GRID = 128
"""Cells of the hash grid along an axis."""


def sample_surface(scene: Scene, count: int | None = None, *, radius: float | None = None, seed: int = 0) -> Hits:
    """Points on the triangles of a scene, evenly by area.

        somewhere = wrt.analysis.sample_surface(scene, 10_000)              # independent of each other
        apart = wrt.analysis.sample_surface(scene, radius=0.02)             # blue noise: none nearer than 0.02 to another

    Args:
        scene: a `wrt.Scene` of meshes or instances.
        count: number of points, at least 1, each at random; or
        radius: least distance of two points, in the scene's units; there are about 0.6 areas over radius² of them.
        seed: of the random numbers, at least 0; the same arguments give the same points.

    Returns:
        Hits, as `scene.points_on` makes them: `position` (N, 3) float64, `normal`, `primitive_id`, `spawn` ...

    Raises:
        TypeError: neither count nor radius, or both; or wrong types.
        ValueError: a value out of range, triangles without any area, or a radius for which more than 2^26 points are thrown.
    """
    state = state_of(scene)
    if (count is None) == (radius is None):
        raise TypeError("pass either count, a number of points, or radius, their least distance")
    rng, mesh = np.random.default_rng(as_int("seed", seed, 0)), scene.flattened()
    areas = normals_and_areas(mesh.vertices, mesh.faces)[1]
    ends = np.cumsum(areas)
    if not ends[-1] > 0.0:
        raise ValueError("the scene's triangles have no area, so that no point is on them")
    if radius is None:
        thrown = as_int("count", count, 1, MAX_POINTS)
    elif not (radius := as_float("radius", radius, finite=True)) > 0.0:
        raise ValueError(f"radius must be above 0, not {radius}")
    elif (wanted := THROWN * float(ends[-1]) / max(radius * radius, 1e-300)) > MAX_POINTS:
        raise ValueError(f"radius {radius} is too small for an area of {ends[-1]:.4g}: {wanted:.4g} points would be thrown")
    else:
        thrown = int(np.ceil(wanted)) + 16
    number = np.minimum(np.searchsorted(ends, rng.random(thrown) * ends[-1], side="right"), len(areas) - 1)
    root, along = np.sqrt(rng.random(thrown)), rng.random(thrown)
    uv = np.stack([root * (1.0 - along), root * along], axis=1)
    if radius is not None:
        corners = mesh.vertices[mesh.faces[number]].astype(np.float64) - scene.center
        places = corners[:, 0] + uv[:, :1] * (corners[:, 1] - corners[:, 0]) + uv[:, 1:] * (corners[:, 2] - corners[:, 0])
        kept = kept_apart(scene, places.astype(np.float32), radius)
        number, uv = number[kept], uv[kept]
    first = state.device_mesh.geometry_first.numpy().astype(np.int64)
    instance = np.searchsorted(first, number, side="right") - 1
    return scene.points_on(number - first[instance], uv, instance_id=instance)


def kept_apart(scene: Scene, places: np.ndarray, radius: float) -> np.ndarray:
    """(M,) numbers of the points (N, 3) that are kept, none within the radius of another.

    A part of the points is settled at a time, beside those that are kept: few points are then near each other.
    """
    device, size = scene.device, max(int(len(places) / THROWN), MIN_PART)
    grid, kept = wp.HashGrid(GRID, GRID, GRID, device=device), np.zeros(0, np.int64)
    with use_threads(scene.state.num_threads):
        for first in range(0, len(places), size):
            numbers = np.concatenate([kept, np.arange(first, min(first + size, len(places)))])
            points = wp.array(places[numbers], dtype=wp.vec3, device=device)
            grid.build(points, radius)
            known = np.where(np.arange(len(numbers)) < len(kept), int(KEPT), int(OPEN)).astype(np.int32)
            before, after = wp.array(known, dtype=int, device=device), wp.empty(len(numbers), dtype=int, device=device)
            while (known == int(OPEN)).any():
                launch(settle, len(numbers), [grid.id, points, radius, before, after], device=device, chunk=256)
                before, after = after, before
                known = before.numpy()
            kept = numbers[known == int(KEPT)]
    return kept
