"""What surfaces see of the sun and of the sky.

References: gonzalez-2010 (a lattice on the sphere); zhukov-1998.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import check_surface, host
from wrt.analysis.wall_thickness import BLOCK, frame_of
from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.shading.surface import Surface
from wrt.kernels.validation import as_bool, as_direction, as_float, as_int, as_numbers

if TYPE_CHECKING:
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

POINTS = 1 << 16
"""Points whose ambient rays are traced at a time."""


def sky_directions(count: int, *, up: Any = (0, 0, 1)) -> np.ndarray:
    """(count, 3) float32 unit vectors above the horizon, evenly by solid angle: a Fibonacci lattice.

    Args:
        count: number of directions, at least 1.
        up: upward direction, of any length.

    Raises:
        TypeError: wrong types.
        ValueError: `count` is less than 1, or `up` is 0.
    """
    count, axis = as_int("count", count, 1), as_direction("up", up)
    height = (np.arange(count) + 0.5) / count
    turn, flat = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - height**2)
    across, other = (vectors[0] for vectors in frame_of(axis[None]))
    found = height[:, None] * axis + (flat * np.cos(turn))[:, None] * across + (flat * np.sin(turn))[:, None] * other
    return found.astype(np.float32)


def exposure(scene: Scene, surface: Hits, directions: Any, *, weights: Any = None, cosine: bool = False) -> np.ndarray:
    """How much of given directions, to the sun or the sky, the front of a surface sees.

    The sum of the weights of those that are in front of it and not hidden.

        hours = wrt.analysis.exposure(scene, floor, sun, weights=np.full(len(sun), 0.25))    # a quarter of an hour each
        sky = wrt.analysis.sky_directions(256)
        openness = wrt.analysis.exposure(scene, floor, sky)                                 # share of the sky, 0 to 1
        factor = wrt.analysis.exposure(scene, floor, sky, weights=np.full(256, 2 / 256), cosine=True)   # sky view factor

    What is below the horizon must not be among the directions, or be hidden by the mesh.

    Args:
        scene: a `wrt.Scene` whose triangles have their fronts where light comes from.
        surface: points on its triangles: `scene.points_on`, `wrt.analysis.sample_surface`, or hits of rays.
        directions: (D, 3) from the surface to the light, of any length but 0.
        weights: (D,) at least 0; None: 1 / D each.
        cosine: whether each weight is multiplied with the cosine to the normal, as energy is.

    Returns:
        (...) float64; 0 for a miss.

    Raises:
        TypeError: wrong types.
        ValueError: wrong shapes, a direction that is 0 or not finite, or a negative weight.
    """
    check_surface(scene, surface)
    ways, cosine = as_numbers("directions", directions, (None, 3)), as_bool("cosine", cosine)
    if not len(ways) or not ways.any(axis=1).all():
        zero = f", and number {int((~ways.any(axis=1)).argmax())} is" if len(ways) else ""
        raise ValueError(f"directions must be at least one, none of them 0{zero}")
    ways /= np.abs(ways).max(axis=1, keepdims=True)  # squares of the rest neither overflow nor vanish
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shares = np.full(len(ways), 1.0 / len(ways)) if weights is None else as_numbers("weights", weights, (len(ways),))
    if (shares < 0.0).any():
        raise ValueError(f"weights must be 0 or more, and the least is {shares.min()}")
    found, normal = np.zeros(surface.shape), host(surface.normal).astype(np.float64)
    size = max(1, int(np.prod(surface.shape)))
    for begin in range(0, len(ways), step := max(1, BLOCK // size)):
        part = ways[begin : begin + step].astype(np.float32).reshape(-1, *(1,) * len(surface.shape), 3)
        part = np.broadcast_to(part, (len(part), *surface.shape, 3))
        seen = host(surface.faces(part)) & ~host(scene.occluded(host(surface.spawn(part)), part))
        share = shares[begin : begin + step].reshape(-1, *(1,) * len(surface.shape))
        found += (seen * share * (np.maximum((part * normal).sum(axis=-1), 0.0) if cosine else 1.0)).sum(axis=0)
    return found


def ambient_occlusion(
    scene: Scene, surface: Hits, *, rays: int = 64, max_distance: float = float("inf"), seed: int = 0
) -> np.ndarray:
    """The share of an even light from all sides that reaches the front of a surface: 1 where nothing hides it, 0 inside a body.

    The share of the rays of each point that hit nothing. Their directions are drawn with a density proportional to the cosine
    to the normal (Zhukov et al. 1998), by a sequence of low discrepancy.

        light = wrt.analysis.ambient_occlusion(scene, scene.points_on(np.arange(mesh.triangle_count)))

    Args:
        scene: a `wrt.Scene` whose triangles have their fronts where light comes from.
        surface: points on its triangles: `scene.points_on`, `wrt.analysis.sample_surface`, or hits of rays.
        rays: of each point, at least 1.
        max_distance: length of the rays, in the scene's units, at least 0.
        seed: of the directions, from 0 to 2^32 - 1.

    Returns:
        (...) float32; NaN for a miss and for a point on a triangle without area.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: a number out of range.
    """
    from wrt.imaging.ambient_rays import AmbientRays

    check_surface(scene, surface)
    rays, seed = as_int("rays", rays, 1), as_int("seed", seed, 0, (1 << 32) - 1)
    if not (max_distance := as_float("max_distance", max_distance)) >= 0.0:
        raise ValueError(f"max_distance must be 0 or more, not {max_distance}")
    normal = host(surface.normal).astype(np.float32)
    known = np.isfinite(normal).all(axis=-1) & normal.any(axis=-1)
    origins = host(surface.spawn(normal, side="front")).reshape(-1, 3)
    normals, found = normal.reshape(-1, 3), np.full(known.size, np.nan, dtype=np.float32)
    places = np.flatnonzero(known)
    query = {"traversal": AUTO, "triangle_test": AUTO}
    with use_threads(scene.num_threads):
        for begin in range(0, len(places), POINTS):
            part = places[begin : begin + POINTS]
            points, device = Surface(), scene.device
            points.origin = wp.array(origins[part].astype(np.float64), dtype=wp.vec3d, device=device)
            points.face_normal = points.normal = wp.array(normals[part], dtype=wp.vec3, device=device)
            ambient = AmbientRays(scene, len(part), rays, max_distance, seed, query)
            met = wp.zeros(len(part), dtype=int, device=device)  # all of them are hits
            found[part] = ambient.count_open(points, met, begin, 0).numpy() / rays
    return found.reshape(surface.shape)
