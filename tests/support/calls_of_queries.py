"""Valid arguments of queries of rays and of points, in wrt's own interface and in those of trimesh and Open3D."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import trimesh
import warp as wp

import wrt
from support.call_objects import Call, hits, instances, mesh, open3d, parts, rays, scene, seen, trimesh_rays

LEAST = {"t": "min"}


DISTANCES = {
    "compute_closest_points": {"nthreads": 2},
    "compute_distance": {"nthreads": 2},
    "compute_signed_distance": {"nthreads": 2, "nsamples": 3},
    "compute_occupancy": {"nthreads": 2, "nsamples": 3},
}
"""Queries of points in Open3D's interface."""


def query_calls() -> Iterator[Call]:
    bounds = {"t_min": 0.5, "t_max": 64.0}
    seen_by = {"mask": 1, "environment": 1}
    flags = {"cull_backfaces": False, "counters": False, "precise": False}
    yield Call("Queries.intersect", lambda **o: seen(scene().intersect(*rays(), **o)), {**bounds, **flags})
    yield Call(
        "Queries.occluded", lambda **o: instances().occluded(*rays(), **o), {**bounds, **seen_by, "cull_backfaces": False}
    )
    yield Call("Queries.count", lambda **o: scene().count(*rays(), **o), {**bounds, "cull_backfaces": False})
    yield Call("Queries.explain", lambda **o: scene().explain(*rays(), **o), {**bounds, "cull_backfaces": False})
    options = {**bounds, "cull_backfaces": False, "max_hits": 2}
    yield Call("Queries.intersect_all", lambda **o: seen(scene().intersect_all(*rays(), **o)), options)
    options = {**seen_by, "max_distance": 64.0}
    yield Call("PointQueries.closest_point", lambda **o: seen(instances().closest_point(rays()[0], **o)), {**options, "k": 2})
    yield Call("PointQueries.closest_point", lambda **o: counted(scene().closest_point(rays()[0], **o)), {"counters": True})
    yield Call("PointQueries.closest_point", lambda **o: seen(scene().closest_point(rays()[0], **o)), {"precise": True})
    options = {**seen_by, "radius": 64.0}
    yield Call("PointQueries.within", lambda **o: seen(instances().within(rays()[0], **o)), options)
    yield Call("PointQueries.verify", lambda **o: scene().verify(**o), {"samples": 4, "seed": 1})
    blocks = {**bounds, "memory": 1 << 16, "progress": False}
    nearest = {**blocks, "precise": False}
    yield Call(
        "BlockQueries.intersect_blocks", lambda **o: scene().intersect_blocks(*rays(), reduce=LEAST, **o).result(), nearest
    )
    yield Call("BlockQueries.occluded_blocks", lambda **o: scene().occluded_blocks(*rays(), **o).result(), blocks)
    yield Call("BlockQueries.count_blocks", lambda **o: scene().count_blocks(*rays(), **o).result(), blocks)
    for name in ("intersect_blocks", "occluded_blocks", "count_blocks", "closest_point_blocks"):
        yield Call(f"BlockQueries.{name}", lambda name=name, **o: reduced(name, o), {"axis": 0})
    options = {"max_distance": 64.0, "memory": 1 << 16, "progress": False, "precise": False}
    yield Call(
        "BlockQueries.closest_point_blocks",
        lambda **o: scene().closest_point_blocks(rays()[0], reduce=LEAST, **o).result(),
        options,
    )
    for name in ("intersect", "occluded", "count"):
        yield Call(f"PartQueries.{name}", lambda name=name, **o: of_parts(name, o), {**bounds, "cull_backfaces": False})
    yield Call("Hits.smooth_normal", lambda **o: hits().smooth_normal(**o), {"crease_angle": 32.0})
    yield Call("GeneratedRays", lambda **o: wrt.batches.GeneratedRays(len, **o), {"shape": 4, **bounds})
    yield Call("launch", launched, {"count": 4, "num_threads": 2, "chunk": 2})
    yield Call("Members.node_transform", lambda **o: graph().node_transform("part", **o), {"to_parent": False})
    options = {"multiple_hits": True, "max_hits": 2, "return_locations": False}
    yield Call(
        "RayMeshIntersector",
        lambda **o: wrt.compat.RayMeshIntersector(trimesh_rays().mesh, device="cpu", **o).scene.num_threads,
        {"num_threads": 2},
    )
    yield Call("RayMeshIntersector.intersects_id", lambda **o: trimesh_rays().intersects_id(*rays(), **o), options)
    options = {"multiple_hits": True, "max_hits": 2}
    yield Call("RayMeshIntersector.intersects_location", lambda **o: trimesh_rays().intersects_location(*rays(), **o), options)
    yield Call("RaycastingScene", lambda **o: vars(wrt.compat.RaycastingScene(**o)), {"nthreads": 2})
    six = np.concatenate(rays(), axis=1)
    for name in ("cast_rays", "count_intersections", "list_intersections"):
        yield Call(f"RaycastingScene.{name}", lambda name=name, **o: getattr(open3d(), name)(six, **o), {"nthreads": 2})
    for name, options in DISTANCES.items():
        query = getattr(open3d(), name)
        yield Call(f"DistanceQueries.{name}", lambda query=query, **o: query(rays()[0], **o), options)
    yield Call(
        "ProximityQuery",
        lambda **o: wrt.compat.ProximityQuery(trimesh_rays().mesh, device="cpu", **o).scene.num_threads,
        {"num_threads": 2},
    )
    yield Call("for_all_meshes", threads_for_all, {"num_threads": 2})
    options = {"tnear": 0.5, "tfar": 64.0, "nthreads": 2}
    yield Call("RaycastingScene.test_occlusions", lambda **o: open3d().test_occlusions(six, **o), options)
    options = {
        "fov_deg": 64.0,
        "center": [0.0, 0.0, 1.0],
        "eye": [0.0, -4.0, 2.0],
        "up": [0.0, 0.0, 1.0],
        "width_px": 4,
        "height_px": 3,
    }
    yield Call("RaycastingScene.create_rays_pinhole", wrt.compat.RaycastingScene.create_rays_pinhole, options)


@wrt.device.kernel
def count_up(first: int, out: wp.array(dtype=int)):
    """Writes the number of each item."""
    out[first + wp.tid()] = first + wp.tid() + 1


def launched(**options: Any) -> np.ndarray:
    out = wp.zeros(4, dtype=int, device="cpu")
    wrt.device.launch(count_up, inputs=[out], device="cpu", **options)
    return out.numpy()


def counted(found: wrt.Hits) -> tuple[Any, Any]:
    return seen(found), found.counters


def threads_for_all(**options: Any) -> int | None:
    with wrt.compat.for_all_meshes(device="cpu", **options):
        return trimesh.Trimesh(mesh().vertices, mesh().faces, process=False).nearest.scene.num_threads


@cache
def graph() -> wrt.Scene:
    made = trimesh.Scene()
    made.add_geometry(trimesh_rays().mesh, node_name="part")
    return wrt.Scene(made, device="cpu")


def reduced(name: str, options: dict[str, Any]) -> Any:
    """What blocks of a query have after a reduction along axes."""
    given = rays()[:1] if name == "closest_point_blocks" else rays()
    reduce = LEAST if name in ("intersect_blocks", "closest_point_blocks") else "sum"
    return getattr(scene(), name)(*given, reduce=reduce, **options).result()


def of_parts(name: str, options: dict[str, Any]) -> Any:
    found = getattr(parts(), name)(*rays(), **options)
    return seen(found) if name == "intersect" else found
