"""What surfaces see of the sun and of the sky.

References: gonzalez-2010 (a lattice on the sphere); zhukov-1998.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import check_surface, host
from wrt.analysis.wall_thickness import BLOCK, frame_of
from wrt.engine.executor import answer_relative
from wrt.engine.facts.query_kinds import ANY, AUTO, QUERIES
from wrt.engine.memory import empty
from wrt.engine.rays.device_rays import relative_rays
from wrt.kernels.runtime.argument_packing import copied
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.shading.surface import Surface
from wrt.kernels.validation import as_bool, as_direction, as_float, as_int, as_numbers, first_bad
from wrt.meshes.mesh_measures import extremes

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers
    from wrt.kernels.fields.exposures import LitRays
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

POINTS = 1 << 16
"""Points whose ambient rays are traced at a time."""

CLOSE = float(np.cos(np.radians(4.0)))
"""Cosine of the angle between such directions."""


def sky_directions(count: int, *, up: ArrayLike = (0, 0, 1)) -> np.ndarray:
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


def exposure(
    scene: Scene, surface: Hits, directions: ArrayLike, *, weights: Numbers | None = None, cosine: bool = False
) -> np.ndarray:
    """How much of given directions, to the sun or the sky, the front of a surface sees.

    The sum of the weights of those that are in front of it and not hidden.

        hours = wrt.analysis.exposure(scene, floor, sun, weights=np.full(len(sun), 0.25))    # a quarter of an hour each
        months = wrt.analysis.exposure(scene, floor, sun, weights=0.25 * (month == np.arange(1, 13)[:, None]))   # (..., 12)
        sky = wrt.analysis.sky_directions(256)
        openness = wrt.analysis.exposure(scene, floor, sky)                                 # share of the sky, 0 to 1
        factor = wrt.analysis.exposure(scene, floor, sky, weights=np.full(256, 2 / 256), cosine=True)   # sky view factor

    What is below the horizon must not be among the directions, or be hidden by the mesh. Rays are traced once for all groups,
    and not at all towards what is behind a surface; neighbours are traced together, in whatever order points are given.

    Args:
        scene: a `wrt.Scene` whose triangles have their fronts where light comes from.
        surface: points on its triangles: `scene.points_on`, `wrt.analysis.sample_surface`, or hits of rays.
        directions: (D, 3) from the surface to the light, of any length but 0.
        weights: (D,) at least 0, or (G, D) for G sums, such as those of months; None: 1 / D each.
        cosine: whether each weight is multiplied with the cosine to the normal, as energy is.

    Returns:
        (...) float64, or (..., G); 0 for a miss.

    Raises:
        TypeError: wrong types.
        ValueError: wrong shapes, a direction that is 0 or not finite, a negative weight, or hits from a pickle.
    """
    check_surface(scene, surface)
    ways, cosine = as_numbers("directions", directions, (None, 3)), as_bool("cosine", cosine)
    if not len(ways):
        raise ValueError("directions has the shape (0, 3); pass at least one")
    if bad := first_bad(~ways.any(axis=1), ways):
        raise ValueError(f"directions{bad}; pass directions other than zero")
    ways /= np.abs(ways).max(axis=1, keepdims=True)  # squares of the rest neither overflow nor vanish
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shares, grouped = as_shares(weights, len(ways))
    if not surface.batch.count:
        found = np.zeros((0, len(shares)))
    else:
        with use_threads(scene.num_threads):
            found = LitSurface(scene, surface).add(ways.astype(np.float32), shares, cosine)
    return found.reshape(*surface.shape, *((len(shares),) if grouped else ()))


def as_shares(weights: Any, count: int) -> tuple[np.ndarray, bool]:
    """(G, D) weights of D directions, and whether the caller gave groups.

    Raises:
        TypeError: not real numbers.
        ValueError: another shape, or a negative weight.
    """
    if weights is None:
        return np.full((1, count), 1.0 / count), False
    grouped = np.ndim(weights) == 2
    shares = as_numbers("weights", weights, (None, count) if grouped else (count,))
    if (shares < 0.0).any():
        raise ValueError(f"weights must be 0 or more, and the least is {shares.min()}")
    if not len(shares):
        raise ValueError(f"weights has the shape {shares.shape}; pass at least one group")
    return (shares if grouped else shares[None]), grouped


def are_close(ways: np.ndarray) -> bool:
    """Whether unit vectors follow each other closely, as those to a sun do."""
    if len(ways) < 2:
        return False
    cosines = sorted((ways[1:] * ways[:-1]).sum(axis=1).tolist())  # `median` would take longer for so few
    return (cosines[(len(cosines) - 1) // 2] + cosines[len(cosines) // 2]) / 2 >= CLOSE


class LitSurface:
    """Points from whose fronts rays are traced to given directions.

    Args:
        scene: what hides directions.
        surface: the points, at least one.
    """

    def __init__(self, scene: Scene, surface: Hits) -> None:
        from wrt.kernels.fields.exposures import FLOATS, LANES, TILE, LitPoints, find_near, place_points
        from wrt.kernels.points.point_order import morton_order

        self._scene, self._tile, points = scene, int(TILE), LitPoints()
        points.mesh, points.primitive, points.uv = surface._surface
        self.device, self.count = points.primitive.device, surface.batch.count
        places = empty(self.count, wp.vec3, self.device)
        launch(find_near, self.count, [points, places], device=self.device, chunk=1024)
        low, high = extremes(places.numpy())
        points.order = morton_order(places, wp.vec3(*low), wp.vec3(*high))
        points.normal, points.origin = (empty(self.count, wp.vec3d, self.device) for _ in range(2))
        blocks = 0 if points.mesh.placements else -(-self.count // int(LANES))  # None without instances
        points.own = empty(blocks * int(FLOATS), wp.float32, self.device)
        launch(place_points, max(self.count, blocks * int(LANES)), [points], device=self.device, chunk=1024)
        self._points = points

    def add(self, ways: np.ndarray, shares: np.ndarray, cosine: bool) -> np.ndarray:
        """(P, G) float64 sums of the weights (G, D) of those of the directions (D, 3) that points see."""
        from wrt.kernels.fields.exposures import GROUP, LitSums, add_lit, spread_sums

        groups, device, tiles, rays = len(shares), self.device, -(-self.count // self._tile), self._rays_to(ways)
        lit, weights, weighted = LitSums(), *weights_on(device, shares)
        lit.sums, lit.cosine = empty(groups * self.count, wp.float64, device).reshape((groups, self.count)), cosine
        step, close = max(GROUP, BLOCK // self.count // GROUP * GROUP), are_close(ways)
        for begin in range(0, len(ways), step):
            rows = slice(begin, min(begin + step, len(ways)))
            lit.weights, lit.weighted, lit.is_first = weights[rows], weighted[rows], begin == 0
            own, each = copied(rays), max(1, BLOCK // (self._tile * step))
            own.direction, own.prepared = rays.direction[rows], rays.prepared[rows]
            own.groups = -(-len(own.direction) // GROUP) if close else len(own.direction)
            for first in range(0, tiles, each):
                own.first_tile, own.tiles = first, min(each, tiles - first)
                lit.dark = self._trace(own)
                launch(add_lit, own.tiles, [self._points, own, lit], device=device, chunk=4)
        found = empty(self.count * groups, wp.float64, device).reshape((self.count, groups))
        launch(spread_sums, self.count, [self._points, lit, found], device=device, chunk=1024)
        return found.numpy()

    def _rays_to(self, ways: np.ndarray) -> LitRays:
        """Rays to directions, as kernels see them, without a range of tiles."""
        from wrt.kernels.fields.exposures import LitRays, prepare_ways
        from wrt.kernels.triangle.watertight.woop import ShearedRay

        rays, device = LitRays(), self.device
        rays.direction, rays.center = wp.array(ways, dtype=wp.vec3, device=device), wp.vec3d(*self._scene.state.center.tolist())
        rays.prepared = wp.empty(len(ways), dtype=ShearedRay, device=device)
        launch(prepare_ways, len(ways), [rays.direction, rays.prepared], device=device)
        return rays

    def _trace(self, rays: LitRays) -> wp.array:
        """Whether each of the rays from a range of tiles to directions is hidden; gives `rays` their numbers."""
        from wrt.kernels.fields.exposures import count_lit, write_lit

        device, state, items = self.device, self._scene.state, rays.groups * rays.tiles
        counted = wp.empty(items, dtype=int, device=device)
        launch(count_lit, items, [self._points, rays, counted], device=device, chunk=64)
        begins = np.zeros(items + 1, dtype=np.int32)
        np.cumsum(counted.numpy(), out=begins[1:])
        rays.begin, count = wp.array(begins, dtype=int, device=device), int(begins[-1])
        if not count:
            return wp.empty(0, dtype=wp.bool, device=device)
        origins, directions = empty(count, wp.vec3, device), empty(count, wp.vec3, device)
        launch(write_lit, items, [self._points, rays, origins, directions], device=device, chunk=16)
        given = relative_rays(
            origins.to(state.device), directions.to(state.device), np.inf, (count,), state.device, state.center
        )
        return answer_relative(state, given, QUERIES[ANY]).occluded.to(device)


def weights_on(device: wp.Device, shares: np.ndarray) -> tuple[wp.array, wp.array]:
    """Weights (G, D) of directions as `LitSums` has them, and in which groups each has some."""
    own, groups = np.ascontiguousarray(shares.T), len(shares)
    some = own != 0.0
    ends = np.stack([some.argmax(axis=1), groups - some[:, ::-1].argmax(axis=1)], axis=1) * some.any(axis=1)[:, None]
    weighted = wp.array(ends.astype(np.int32), dtype=wp.vec2i, device=device)
    return wp.array(own, dtype=wp.float64, device=device), weighted


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
