"""Valid arguments of scenes, meshes, instances, trees and built-in scenes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import wrt
from support.call_objects import Call, area, cloth, folder, fuzzy, instances, mesh, scene, skeleton, trimesh_rays

MESH_FILE = {"materials": False, "outside": False}
"""Options of `TriangleMesh.load`."""


def scene_calls() -> Iterator[Call]:
    frames, faces = cloth().frames, cloth().faces
    weights = np.ones((mesh().vertex_count, 1))
    yield Call("Scene", threads_of(lambda **o: wrt.Scene(mesh(), **o)), {"num_threads": 2})
    yield Call("Scene.load", threads_of(lambda **o: wrt.Scene.load(folder() / "scene.npz", **o)), {"num_threads": 2})
    yield Call("Scene.handle", lambda **o: instances().handle(**o) is not None, {"mask": 2, "environment": 1})
    yield Call("Scene.filtered", lambda **o: wrt.Scene(mesh(), device="cpu").filtered(**o).bounds, {"alpha": True})
    yield Call("Scene.update", updated, {"mask": 2, "environment": 1})
    yield Call("Scene.updating", updated_beside, {"threads": 1})
    yield Call("FanScene", threads_of(lambda **o: wrt.classics.FanScene(mesh(), **o)), {"num_threads": 2})
    yield Call("GroupedScene", threads_of(lambda **o: wrt.moving.GroupedScene([mesh()], **o)), {"num_threads": 2})
    yield Call(
        "InstancedScene", threads_of(lambda **o: wrt.moving.InstancedScene([wrt.Instance(mesh())], **o)), {"num_threads": 2}
    )
    yield Call("Instance", lambda **o: pair(wrt.Instance(mesh(), **o)), {"mask": 2, "environment": 1})
    options = {"clusters": 1, "rest": 1, "num_threads": 2}
    yield Call("FuzzyScene", lambda **o: labels(wrt.moving.FuzzyScene(frames, faces, device="cpu", **o)), options)
    yield Call("FuzzyScene.show", shown, {"frame": 1})
    yield Call(
        "SkinnedScene",
        lambda **o: labels(wrt.moving.SkinnedScene(mesh().vertices, mesh().faces, weights, skeleton(), device="cpu", **o)),
        {"samples": 2, "seed": 1, "num_threads": 2},
    )
    yield Call("Skeleton.sample", lambda **o: skeleton().sample(**o), {"count": 4, "seed": 1})
    options = {"part_triangles": 64, "store_records": True, "memory": 1 << 26, "num_threads": 2, "progress": False}
    yield Call("PartitionedScene.build", built, options)
    yield Call(
        "PartitionedScene",
        threads_of(lambda **o: wrt.disk.PartitionedScene(folder() / "parts", **o)),
        {"memory": 1 << 26, "num_threads": 2},
    )
    yield Call("TriangleMesh.load", lambda **o: wrt.TriangleMesh.load(folder() / "mesh.ply", **o).faces, MESH_FILE)
    yield Call(
        "TriangleMesh.from_trimesh",
        lambda **o: wrt.TriangleMesh.from_trimesh(trimesh_rays().mesh, **o).faces,
        {"materials": False},
    )
    yield Call("UpdatePolicy", wrt.moving.UpdatePolicy, {"tolerance": 2.0, "subtrees": False})


def threads_of(make: Callable[..., Any]) -> Callable[..., int | None]:
    """The number of threads of a scene that `make` makes."""
    return lambda **options: make(device="cpu", **options).num_threads


def updated(**options: Any) -> list[tuple[int, int]]:
    moved = instances().__copy__()
    moved.update(0, **options)
    return [(one.mask, one.environment) for one in moved.instances]


def updated_beside(threads: Any) -> np.ndarray:
    moved = scene().__copy__()
    with moved.updating(0, vertices=mesh().vertices + 1, threads=threads):
        pass
    return moved.bounds


def shown(frame: Any) -> int:
    fuzzy().show(frame)
    return fuzzy().frame


def built(**options: Any) -> int:
    with tempfile.TemporaryDirectory() as path:
        return wrt.disk.PartitionedScene.build(cloth().mesh(0), Path(path) / "scene", device="cpu", **options).triangle_count


def pair(instance: wrt.Instance) -> tuple[Any, Any]:
    return instance.mask, instance.environment


def labels(made: Any) -> tuple[Any, Any]:
    return made.labels, made.num_threads


def tree_calls() -> Iterator[Call]:
    costs = {"width": 8, "traversal_cost": 1.0, "block_cost": 0.5}
    bvh = {**costs, "bins": 16, "max_leaf_triangles": 8, "reinsertion": 1, "subset": 0.5}
    yield Call("Bvh", wrt.Bvh, bvh)
    kdtree = {**costs, "empty_factor": 0.5, "max_depth": 8, "bad_splits": 1, "leaf_triangles": 2, "least_size": 0.25}
    flags = {"mailbox": False, "split_clipping": False, "resamplings": 1, "median_levels": 0}
    yield Call("KdTree", wrt.KdTree, {**kdtree, **flags})
    projected = {**costs, "others": 0.5, "bins": 16, "max_leaf_triangles": 8, "leaf_cost": 0.5, "leaf_area": 0.5}
    projected |= {
        "leaf_probability": 0.5,
        "max_depth": 8,
        "aware_depth": 4,
        "subset": 1.0,
        "spatial_splits": 1.0,
        "shares": (1.0,),
    }
    yield Call("ProjectedBvh", lambda **o: wrt.known_rays.ProjectedBvh(areas=area(), **o), projected)
    yield Call("ProjectedBvh", lambda **o: wrt.known_rays.ProjectedBvh(areas=area(), **o), {"triangle_cost": 0.5})
    yield Call("RayAwareBvh", lambda **o: wrt.known_rays.RayAwareBvh(areas=[area()], **o), {"tolerance": 1.0, "depth": 4})


def built_in_calls() -> Iterator[Call]:
    scenes = wrt.scenes
    yield Call("atrium", lambda **o: built_in(scenes.atrium(**o)), {"bays": (1, 1), "storeys": 1, "detail": 1})
    yield Call("cornell_box", lambda **o: built_in(scenes.cornell_box(**o)), {"blocks": False, "cells": 1})
    yield Call("random_triangles", lambda **o: built_in(scenes.random_triangles(**o)), {"count": 4, "size": 0.5, "seed": 1})
    yield Call("teapot", lambda **o: built_in(scenes.teapot(**o)), {"level": 2, "ground": False, "closed": True})
    yield Call("teapot_in_stadium", lambda **o: built_in(scenes.teapot_in_stadium(**o)), {"level": 1, "rows": 1, "segments": 8})
    yield Call("walking_figure", lambda **o: scenes.walking_figure(**o).frames, {"frames": 1, "detail": 3})
    yield Call("waving_cloth", lambda **o: scenes.waving_cloth(**o).frames, {"frames": 1, "cells": 1})
    yield Call("wood", lambda **o: built_in(scenes.wood(**o)), {"trees": 1, "leaves": 1, "seed": 1})
    yield Call("Animation.mesh", lambda **o: built_in(cloth().mesh(**o)), {"frame": 1})
    yield Call("Animation.moved", lambda **o: cloth().moved(**o).frames, {"offset": (1.0, 0.0, 0.0)})


def built_in(made: wrt.TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    return made.vertices, made.faces
