"""What surfaces see of the sun and of the sky.

References: gonzalez-2010 (a lattice on the sphere).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.analysis.analysis_arguments import check_surface, host
from wrt.analysis.wall_thickness import BLOCK, frame_of
from wrt.kernels.validation import as_bool, as_direction, as_int, as_numbers, first_bad

if TYPE_CHECKING:
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene


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
    if not len(ways):
        raise ValueError("directions has the shape (0, 3); pass at least one")
    if bad := first_bad(~ways.any(axis=1), ways):
        raise ValueError(f"directions{bad}; pass directions other than zero")
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
