"""Hits of every traversal, query and triangle test; all engines that answer a query must give the same hash."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

import numpy as np
from support.algorithms import ENGINE_TESTS
from support.hits import mixed_rays
from support.meshes import STORED

import wrt
from wrt.engine.facts.query_kinds import ALL, ANY, CLOSEST, COUNT
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

from .digests import digest

SCENE_NAMES = ("teapot", "random_triangles", "atrium", "grid", "degenerate", "needles")
RAYS = 2000
TREES = {"kdtree": wrt.KdTree(), "bvh": wrt.Bvh()}


def closest(scene: wrt.Scene, rays: wrt.Rays, **options: str) -> str:
    """Hash of closest hits."""
    hits = scene.intersect(rays, **options)
    return digest(hits.t, hits.primitive_id, hits.uv)


def all_hits(scene: wrt.Scene, rays: wrt.Rays, **options: str) -> str:
    """Hash of all hits."""
    hits = scene.intersect_all(rays, **options)
    return digest(hits.offsets, hits.t, hits.primitive_id, hits.uv)


QUERY_HASHES: dict[str, Callable[..., str]] = {
    CLOSEST: closest,
    ANY: lambda scene, rays, **options: digest(scene.occluded(rays, **options)),
    COUNT: lambda scene, rays, **options: digest(scene.count(rays, **options)),
    ALL: all_hits,
}


def rays_of(mesh: wrt.TriangleMesh, share_origin: bool) -> wrt.Rays:
    """Rays of every kind with limits that cut between hits; from one point if a test or traversal demands it."""
    origins, directions = mixed_rays(mesh, RAYS)
    rng = np.random.default_rng(7)
    t_min = np.where(rng.random(RAYS) < 0.2, rng.random(RAYS), 0.0).astype(np.float32)
    t_max = np.where(rng.random(RAYS) < 0.2, t_min + rng.random(RAYS), np.inf).astype(np.float32)
    if share_origin:
        targets = np.where(np.isfinite(origins).all(1, keepdims=True), origins + directions, np.nan)
        origins = np.asarray(mesh.bounds[0] + (0.41, 0.57, 1.31) * np.ptp(mesh.bounds, axis=0), np.float32)
        directions = (targets - origins).astype(np.float32)
        t_min, t_max = 0.0, np.inf
    return wrt.Rays(origins, directions, t_min, t_max)


def tests_of(traversal: str, query: str) -> tuple[str, ...]:
    """Triangle tests with which a traversal answers a query here: all for closest hits of single rays, else a few."""
    names = tuple(TRIANGLE_TESTS) if (traversal, query) == ("single", CLOSEST) else ENGINE_TESTS
    return tuple(name for name in names if query in (CLOSEST, ANY) or name == ENGINE_TESTS[0])


def hit_hashes(
    scenes: Collection[str] = SCENE_NAMES,
    traversals: Collection[str] = tuple(TRAVERSALS),
    triangle_tests: Collection[str] = tuple(TRIANGLE_TESTS),
    queries: Collection[str] = tuple(QUERY_HASHES),
) -> Iterator[tuple[str, str, str]]:
    """(case, engine, hash) for every engine and case."""
    for scene_name in scenes:
        mesh = STORED[scene_name]()
        rays = {shared: rays_of(mesh, shared) for shared in (False, True)}
        for kind, accelerator in TREES.items():
            scene = wrt.Scene(mesh, accelerator, device="cpu")
            for traversal in traversals:
                way = TRAVERSALS[traversal]
                if kind not in way.trees or way.width not in (None, scene.state.width):
                    continue
                for query in (query for query in queries if way.supports(query, kind)):
                    for test in (name for name in tests_of(traversal, query) if name in triangle_tests):
                        own = way.needs_shared_origin or TRIANGLE_TESTS[test].needs_shared_origin
                        found = QUERY_HASHES[query](scene, rays[own], traversal=traversal, triangle_test=test)
                        origins = "one origin" if own else "own origins"
                        yield f"{scene_name} {query} {test} {origins}", f"{kind} {traversal}", found
