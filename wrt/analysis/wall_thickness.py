"""How thick a body is at points of its surface: along the normal, and as the shape diameter function.

References: shapira-2008.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrt.analysis.analysis_arguments import check_surface, host
from wrt.kernels.validation import as_float, as_int

if TYPE_CHECKING:
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

BLOCK = 1 << 20
"""Rays that are traced at a time."""


def thickness(scene: Scene, surface: Hits) -> np.ndarray:
    """Distances straight through a body, from points of its surface against the normal to where the body ends.

        wall = wrt.analysis.thickness(scene, scene.points_on(np.arange(mesh.triangle_count)))

    Args:
        scene: a `wrt.Scene` whose triangles have their fronts outside.
        surface: points on its triangles: `scene.points_on`, `wrt.analysis.sample_surface`, or hits of rays.

    Returns:
        (...) float32, in the scene's units; inf where nothing is behind the surface, NaN for a miss and for a point on a
        triangle without area.

    Raises:
        TypeError: not a scene, or `surface` is not hits.
    """
    check_surface(scene, surface)
    inwards = -host(surface.normal)
    known = np.isfinite(inwards).all(axis=-1) & inwards.any(axis=-1)
    origins = host(surface.spawn(inwards.astype(np.float32)))
    found = host(scene.intersect(origins, inwards).t)
    return np.where(known, found, np.float32(np.nan))


def shape_diameter(scene: Scene, surface: Hits, *, rays: int = 30, opening: float = 120.0, seed: int = 0) -> np.ndarray:
    """The shape diameter function (Shapira et al. 2008): a mean distance through the body, in a cone against the normal.

    Rays within the cone are traced to the other side. Those that meet a triangle whose normal is within 90 degrees of the
    point's own are left out, as they have met no other side. Of the others, those within a standard deviation of the median
    count, each with 1 over its angle to the axis. Unlike the thickness along one ray, it changes little where a body bends.

    Args:
        scene, surface: as in `thickness`.
        rays: of each point, from 1 to 2^20.
        opening: angle of the cone in degrees, above 0 and less than 180.
        seed: of the directions, which are turned about the normal from point to point.

    Returns:
        (...) float32, in the scene's units; NaN where no ray counts.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: `rays` or `opening` is out of range.
    """
    check_surface(scene, surface)
    rays, rng = as_int("rays", rays, 1, BLOCK), np.random.default_rng(as_int("seed", seed, 0))
    opening = as_float("opening", opening)
    if not 0.0 < opening < 180.0:
        raise ValueError(f"opening must be between 0 and 180 degrees, not {opening}")
    axis = -host(surface.normal).astype(np.float64).reshape(-1, 3)
    # evenly by solid angle: 1 - cos is 2 sin^2 of half an angle, which small ones do not round to 0
    angles = 2.0 * np.arcsin(np.sqrt((np.arange(rays) + 0.5) / rays) * np.sin(np.radians(opening) / 4.0))
    around = np.arange(rays) * np.pi * (3.0 - np.sqrt(5.0))  # the golden angle
    turn = around[:, None] + rng.uniform(0.0, 2.0 * np.pi, len(axis))
    across, other = frame_of(axis)
    sines = np.sin(angles)[:, None, None]
    ways = np.cos(angles)[:, None, None] * axis + sines * (np.cos(turn)[..., None] * across + np.sin(turn)[..., None] * other)
    found = np.full((rays, len(axis)), np.nan)
    shape = (rays, *surface.shape)
    ways = ways.astype(np.float32).reshape(*shape, 3)
    for begin in range(0, rays, step := max(1, BLOCK // max(1, len(axis)))):
        part = ways[begin : begin + step]
        hits = scene.intersect(host(surface.spawn(part)), part)
        opposite = (host(hits.normal) * -host(surface.normal)).sum(axis=-1) > 0.0
        found[begin : begin + step] = np.where(host(hits.is_hit) & opposite, host(hits.t), np.nan).reshape(len(part), -1)
    return mean_near_median(found, angles[0] / angles).astype(np.float32).reshape(surface.shape)


def mean_near_median(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(N,) weighted means of the columns of (M, N) values, NaN left out, within a standard deviation of the median."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    filled = np.sort(np.where(known, values, np.inf), axis=0)
    columns = np.arange(values.shape[1])
    low, high = (filled[np.clip(place, 0, len(values) - 1), columns] for place in ((count - 1) // 2, count // 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        median = 0.5 * (low + high)
        mean = np.where(known, values, 0.0).sum(axis=0) / count
        deviation = np.sqrt(np.where(known, (values - mean) ** 2, 0.0).sum(axis=0) / count)
        kept = known & (np.abs(values - median) <= deviation * (1.0 + 1e-6) + 1e-6 * median)
        weighted = np.where(kept, values, 0.0) * weights[:, None]
        return np.where(count > 0, weighted.sum(axis=0) / (kept * weights[:, None]).sum(axis=0), np.nan)


def frame_of(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions (N, 3) at right angles to unit vectors and to each other; 0 for a zero vector."""
    smallest = np.eye(3)[np.abs(axis).argmin(axis=1)]
    across = np.cross(axis, smallest)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.where(length > 0.0, length, 1.0)
    return across, np.cross(axis, across)
