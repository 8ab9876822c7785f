"""States of scenes of one level: placing meshes, finding or building their tree, and moving it with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import resolve_accelerator
from wrt.accelerators.cuda_trees import for_device
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.builders.bvh import small_mesh_build
from wrt.engine.facts.query_cache import QueryCache
from wrt.engine.facts.scene_settings import Settings
from wrt.engine.facts.scene_state import SceneState
from wrt.engine.launch.expected_kernels import expect_build
from wrt.engine.memory import memory_for
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import (
    as_meshes,
    check_index,
    find_bounds,
    hierarchy_of,
    lay_out_few,
    moved_meshes,
    nested,
    place_meshes,
    relative_bounds,
)
from wrt.meshes.repeated_surfaces import without_repeated
from wrt.scene.device_vertices import move_on_device, vertices_on
from wrt.scene.storage import find_tree
from wrt.scene.updates import ALWAYS, NEVER, MovedTriangles, TreeRecipe, UpdatePolicy, can_move, move_tree, typical_motion

if TYPE_CHECKING:
    from pathlib import Path

    from wrt.builders.bvh.bvh_config import BvhConfig
    from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree
    from wrt.meshes.placement import PlacedMeshes
    from wrt.scene.storage import TreeSource
    from wrt.scene.updates import UpdateReport


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshState(SceneState):
    """The state of a scene of meshes.

    Attributes:
        last_update: what the last update did to the tree; None if there was none, or trees of this kind are always built again.
        hierarchy: how the meshes are nested (`wrt.meshes.placement.hierarchy_of`), if their tree is built from that; else None.
    """

    is_plain: ClassVar[bool] = True

    last_update: UpdateReport | None = None
    hierarchy: Any = None

    @property
    def geometry(self) -> Any:
        """What the scene was made of."""
        return self.meshes if self.hierarchy is None else nested(self.hierarchy, self.meshes)

    def find_distinct(self) -> MeshState:
        """The state without triangles that repeat an earlier one, with a tree of the same kind; this one, if there are none.

        What is left has the bounds of all, so it has the same centre, and vertices are rounded as before.
        """
        meshes = without_repeated(self.meshes)
        if meshes is None:
            return self
        tree = self.accelerator if self.is_plain and type(self.accelerator) in (Bvh, KdTree) else self.accelerator.kind
        with use_threads(self.num_threads):
            return build_state(meshes, replace(self.settings, accelerator=resolve_accelerator(tree)), None)

    def updated(
        self,
        index: Any,
        vertices: Any,
        transform: Any,
        mask: int | None,
        policy: UpdatePolicy,
        environment: int | None = None,
    ) -> SceneState:
        """The state after a mesh's vertices have moved; arguments and errors as in `wrt.Scene.update`."""
        self.require("update")
        if transform is not None or mask is not None or environment is not None:
            raise ValueError(
                "transform, mask and environment need instances, and this scene has none; make it from wrt.Instance(mesh)"
            )
        recipe = None if isinstance(index, Mapping) else self.recipe_on_device(policy)
        if recipe is not None:
            check_index(index, 1, "mesh")
            points = vertices_on(self.device, vertices, self.meshes[0].vertex_count)
            if points is not None:
                return self.moved_on_device(points, recipe, policy)
        return self.moved(moved_meshes(self.meshes, index, vertices), policy)

    def recipe_on_device(self, policy: UpdatePolicy) -> TreeRecipe | None:
        """How the tree around vertices that are on the scene's CUDA device is made there; None if they go through the host.

        With "auto" a tree that is built on the CPU gives way to one by "hploc": a build there takes less time than the copies
        (notebooks/records/2026-11-27-gpu-builds.md)."""
        if self.device.is_cpu or len(self.meshes) != 1 or type(self.accelerator) is not Bvh:
            return None
        recipe = recipe_of(self.settings, moves=True)
        tree = recipe.accelerator
        if policy.when == NEVER or recipe.build_device.is_cuda:
            return recipe
        if policy.when == ALWAYS or not isinstance(tree, Bvh) or tree.subset != 1.0:
            return None
        recipe = replace(recipe, accelerator=replace(tree, builder="hploc"))
        return recipe if recipe.build_device.is_cuda else None

    def moved_on_device(self, points: wp.array, recipe: TreeRecipe, policy: UpdatePolicy) -> SceneState:
        """The state with the mesh's vertices elsewhere; they are not copied to the host."""
        mesh, center, placed = move_on_device(self.meshes[0], points, self.device_mesh)
        find_bounds((mesh,))  # raises what a new scene would
        with memory_for(f"the tree of {mesh.triangle_count:,} triangles", 24 * len(points)):
            bounds = relative_bounds(mesh.bounds, center)
            triangles = MovedTriangles(placed.vertices, placed.faces, None, None, center, np.zeros(3), bounds)
            tree, report = move_tree(recipe, self.tree, triangles, policy)
        placed.low, placed.high = wp.vec3(*tree.low), wp.vec3(*tree.high)
        return replace(
            self,
            meshes=(mesh,),
            center=center,
            built_tree=tree,
            device_mesh=placed,
            last_update=report,
            cache=QueryCache(),
        )

    def moved(self, changed: dict[int, TriangleMesh], policy: UpdatePolicy) -> SceneState:
        """The state with some meshes elsewhere, by their index."""
        meshes = tuple(changed.get(number, mesh) for number, mesh in enumerate(self.meshes))
        with use_threads(self.num_threads):
            if not can_move(self.accelerator):
                state = build_state(meshes, self.settings, None, self.lazy_tree, self.hierarchy)
                return replace(state, mark=self.mark, hit_filter=self.hit_filter)
            with memory_for_tree(meshes):
                placed = place_meshes(meshes, self.device)
                shift = self.center - placed.center + typical_motion(self.meshes, meshes)
                recipe = recipe_of(self.settings, moves=True)
                tree, report = move_tree(recipe, self.tree, MovedTriangles.of(placed, shift), policy)
        return replace(
            self,
            meshes=meshes,
            center=placed.center,
            built_tree=tree,
            device_mesh=placed.fill_in(tree.low, tree.high),
            last_update=report,
            cache=self.cache.of_updated(),
        )


def build_state(
    meshes: tuple[TriangleMesh, ...],
    settings: Settings,
    cache: str | Path | TreeSource | None,
    previous: LazyKdTree | None = None,
    hierarchy: Any = None,
) -> MeshState:
    """The state of a scene of meshes: their tree is found in `cache`, or built.

    previous: the lazy tree of the last frame. hierarchy: as in `MeshState`.

    Raises:
        ValueError, MemoryError, OSError: as `wrt.Scene`.
    """
    if cache is None and builds_few(meshes, settings):
        return build_few_state(meshes, settings)
    if cache is None:
        triangles = sum(mesh.triangle_count for mesh in meshes)
        expect_build(settings.accelerator, settings.device, meshes[0].vertices.dtype.type, triangles)
    with memory_for_tree(meshes):
        placed = place_meshes(meshes, settings.device)
        recipe = recipe_of(settings)
        boxes = placed.boxes(recipe.build_device)
        clusters = settings.accelerator.kind == "kdtree"  # a BVH needs none, and no module of kd-trees
        own = boxes_of_meshes(meshes, placed, hierarchy) if clusters else None
        tree, lazy_tree = find_tree(recipe, boxes, placed, cache, own, previous)
    state = MeshState(
        settings=settings,
        meshes=meshes,
        center=placed.center,
        built_tree=tree,
        device_mesh=placed.fill_in(tree.low, tree.high),
        lazy_tree=lazy_tree,
        hierarchy=hierarchy,
    )
    if not isinstance(settings.accelerator, RayAwareBvh):
        return state
    from wrt.engine.launch.area_trees import build_area_trees

    return replace(state, area_trees=build_area_trees(state, boxes))


def state_of_meshes(geometry: Any, settings: Settings, cache: str | Path | TreeSource | None) -> MeshState:
    """The state of a scene of one level, of what `wrt.Scene` was given; arguments and errors as there."""
    tree = settings.accelerator
    nests = type(tree) is KdTree and tree.takes_groups
    return build_state(as_meshes(geometry), settings, cache, hierarchy=hierarchy_of(geometry) if nests else None)


def boxes_of_meshes(meshes: tuple[TriangleMesh, ...], placed: PlacedMeshes, hierarchy: Any) -> MeshBoxes:
    """The box of each mesh relative to the scene's centre, rounded as its vertices, which keeps their order."""
    from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes

    corners = (np.array([mesh.bounds for mesh in meshes]) - placed.center).astype(np.float32)
    return MeshBoxes(placed.first, corners[:, 0], corners[:, 1], hierarchy)


def builds_few(meshes: tuple[TriangleMesh, ...], settings: Settings) -> bool:
    """Whether the tree is one that `wrt.builders.bvh.small_mesh_build` builds."""
    tree, device = settings.accelerator, settings.device
    if not isinstance(tree, Bvh) or not tree.may_be_few or not device.is_cpu or device.is_capturing:
        return False
    return sum([mesh.triangle_count for mesh in meshes]) <= small_mesh_build.MAX_TRIANGLES


def build_few_state(meshes: tuple[TriangleMesh, ...], settings: Settings) -> MeshState:
    """The state of a scene of few triangles."""
    try:
        center, vertices, mesh = lay_out_few(meshes)
        config = few_config(settings.accelerator, native_width(settings.device))
        tree = small_mesh_build.build_small_mesh(config, mesh.center, vertices, mesh.faces, mesh.low, mesh.high, mesh.vertices)
    except (MemoryError, RuntimeError):
        with memory_for_tree(meshes):  # entered only on failure: it would dominate the build of a tiny mesh
            raise
    return MeshState(settings=settings, meshes=meshes, center=center, built_tree=tree, device_mesh=mesh)


@lru_cache
def few_config(accelerator: Bvh, width: int) -> BvhConfig:
    """The builder's configuration: checking it takes as long as some rays."""
    return accelerator.config(width)


def memory_for_tree(meshes: tuple[TriangleMesh, ...]) -> Any:
    """Makes failures to get memory for the tree of meshes say what it was for."""
    triangles = f"the tree of {sum(mesh.triangle_count for mesh in meshes):,} triangles"
    return memory_for(triangles, sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes))


def recipe_of(settings: Settings, moves: bool = False) -> TreeRecipe:
    """How the tree of a scene is made; moves: by an update."""
    device = settings.device
    return TreeRecipe(for_device(settings.accelerator, device, moves), native_width(device), device)
