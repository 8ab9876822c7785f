"""One state for many times: instances that move are in it once for each time slice.

Time slices are environments (`wrt.builders.bvh.instance_forest`): the instances at rest are shared by all slices, and the
moving ones are in the environment of each slice with their transforms at its time. One upper level is then built for all
slices, and one query traces all their rays, each in the environment of its slice.

**Numbers.** A moving instance keeps its number in all slices, and so do its triangles. The table of placements has all
instances for each slice, one slice after the other; `slice_mesh` is the part from which the hits of a slice are described.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from wrt.engine.facts.query_cache import QueryCache
from wrt.instances.instance_boxes import InstanceBoxes, build_upper, on_device, write_maps
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.meshes.instance import check_extent, check_transforms
from wrt.scene.instanced_state import InstancedState


def sliced(state: InstancedState, chosen: list[int], transforms: np.ndarray) -> InstancedState:
    """The state whose environment s shows the moving instances as they are in slice s.

    Args:
        state: of instances without environments.
        chosen: (M,) the instances that move.
        transforms: (S, M, 4, 4).

    Raises:
        ValueError: as `wrt.Scene.update`.
    """
    state = state.on_host()
    slices, moving, count = len(transforms), np.array(chosen), len(state.instances)
    matrices = check_transforms(transforms.reshape(-1, 4, 4), slices * len(chosen))
    numbers = np.tile(np.array(state.geometry_ids)[moving], slices)
    moved, inverses = InstanceBoxes.of(matrices, numbers, state.covers)
    still = np.setdiff1d(np.arange(count), moving)
    boxes = joined(state.boxes, still, moved)
    if not boxes.are_resolved:
        for one in matrices.reshape(transforms.shape):
            placed = state.instances.moved(moving, one, None, None)
            check_extent(placed.transforms, placed.masks, state.geometry_ids, [part.meshes[0] for part in state.mesh_states])
    rows = (np.arange(slices)[:, None] * count + moving).ravel()
    table, center = np.tile(state.table, slices), np.array(boxes.frame[0])
    table["origin"] = np.tile(state.boxes.origin - center, (slices, 1))
    write_maps(table, rows, matrices, inverses)
    table["origin"][rows] = moved.origin - center
    environments = np.concatenate([np.full(len(still), -1), np.repeat(np.arange(slices), len(chosen))]).astype(np.int32)
    old, device = state.tree, state.device
    tree = build_upper(boxes.rounded(), environments, old.width, old.parts_depth, device, np.concatenate([still, rows]))
    mesh = SceneMesh()
    mesh.geometry_first, mesh.geometries = state.device_mesh.geometry_first, state.device_mesh.geometries
    mesh.center, mesh.low, mesh.high = wp.vec3d(*center.tolist()), tree.low, tree.high
    mesh.placements = on_device(table, Placement, device)
    result = replace(state, center=center, built_tree=tree, device_mesh=mesh, boxes=boxes, table=table, cache=QueryCache())
    result.cache.tables.update(state.cache.tables)
    return result


def joined(one: InstanceBoxes, rows: np.ndarray, other: InstanceBoxes) -> InstanceBoxes:
    """Some of the boxes, and the others after them."""
    box = np.concatenate([one.box[:, rows], other.box], axis=1)
    return InstanceBoxes(np.concatenate([one.origin[rows], other.origin]), box, np.concatenate([one.norms[rows], other.norms]))


def slice_mesh(state: InstancedState, number: int) -> SceneMesh:
    """The triangles as they are in a slice of a state of slices."""
    count, whole, mesh = len(state.instances), state.device_mesh, SceneMesh()
    mesh.geometry_first, mesh.geometries, mesh.center = whole.geometry_first, whole.geometries, whole.center
    mesh.low, mesh.high = whole.low, whole.high
    mesh.placements = whole.placements[number * count : (number + 1) * count]
    return mesh
