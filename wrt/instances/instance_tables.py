"""What traversals read of scenes of instances: the upper level, and tables of the meshes that instances share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.launch.triangle_records import records_of, vertex_blocks
from wrt.engine.memory import keep_alive
from wrt.kernels.layout.instance_maps import Geometry
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import kept

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.instances.instance_boxes import UpperTree
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.traversal.two_level.instance_single import InstanceTree


MAX_TRIANGLES = (1 << 31) - 1
"""Largest number of triangles of all instances together: each has its own number of 32 bits."""


def first_triangles(states: Sequence[SceneState], numbers: Sequence[int]) -> np.ndarray:
    """(N + 1,) number of each instance's first triangle, and of all triangles; numbers: the mesh of each instance.

    Raises:
        ValueError: more than `MAX_TRIANGLES` triangles.
    """
    first = np.cumsum([0, *np.array([state.triangle_count for state in states])[np.array(numbers)].tolist()])
    if first[-1] > MAX_TRIANGLES:
        raise ValueError(
            f"the instances have {int(first[-1]):,} triangles together, and a scene can number "
            f"{MAX_TRIANGLES:,}; make several scenes"
        )
    return first


def upper_struct(tree: UpperTree, mesh: SceneMesh, slack_scale: float) -> InstanceTree:
    """The upper level; slack_scale: by what the slack of its boxes grows."""
    from wrt.kernels.traversal.two_level.instance_single import InstanceTree

    top = InstanceTree()
    top.tree, top.order = tree.struct(), tree.primitive
    top.placements, top.slack_scale = mesh.placements, slack_scale
    top.environments, top.roots, top.lists = tree.environments, tree.roots, tree.lists
    if tree.extent is not None:
        top.extent = tree.extent
    top.root, top.shared_root = tree.forest.root, tree.forest.shared_root
    return top


def part_table(states: Sequence[SceneState], plan: Plan, rays: RayBatch | None, device: wp.Device) -> wp.array:
    """The trees of meshes and their records for a plan's triangle test."""
    from wrt.kernels.traversal.two_level.instance_single import PARTS

    kind: Any = PARTS[plan.accelerator]
    table, used = [], []
    for mesh in states:
        part, blocks = kind(), records_of(mesh, plan, rays)
        part.tree, part.triangles = mesh.tree.struct(), blocks
        table.append(part)
        used.append((mesh.tree, blocks))
    with kept(device):
        return keep_alive(wp.array(table, dtype=kind, device=device), used)


def vertex_parts(scene: SceneState) -> wp.array:
    """The trees of a scene's meshes and the vertices of their triangles, for searches of points; cached."""
    from wrt.kernels.traversal.two_level.instance_single import PARTS

    scene.require_opaque("a query of points")
    key, tables = (scene.accelerator.kind, "points"), scene.cache.tables
    if key not in tables:
        kind: Any = PARTS["kdtree" if scene.accelerator.kind == "kdtree" else "bvh"]
        table, used = [], []
        for mesh in scene.parts:
            part, blocks = kind(), vertex_blocks(mesh)
            part.tree, part.triangles = mesh.tree.struct(), blocks
            table.append(part)
            used.append((mesh.tree, blocks))
        with kept(scene.device):
            tables[key] = keep_alive(wp.array(table, dtype=kind, device=scene.device), used)
    return tables[key]


def geometry_table(states: Sequence[SceneState], device: wp.Device) -> wp.array:
    """The table of meshes, as kernels read it."""
    table, used, first = [], [], 0
    for state in states:
        geometry = Geometry()
        geometry.vertices, geometry.faces = state.device_mesh.vertices, state.device_mesh.faces
        geometry.first_face = first
        table.append(geometry)
        used.append(state.device_mesh)
        first += state.triangle_count
    return keep_alive(wp.array(table, dtype=Geometry, device=device), used)
