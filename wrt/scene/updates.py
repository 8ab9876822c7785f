"""Trees of moving triangles: refitted, rebuilt in parts, or rebuilt.

A BVH is updated by refitting its boxes, a kd-tree by refilling the leaves between its old planes. Both are correct for any
motion, but traversal becomes slower the further the triangles move. `wrt.builders.rebuild_heuristic` finds the subtrees that
have become too costly.

References: yang-2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np
import warp as wp

from wrt.kernels.validation import convert_fields
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Accelerator
    from wrt.builders.bvh.update.bvh_update import RefittedBvh
    from wrt.builders.kdtree.update.kdtree_update import RefilledKdTree
    from wrt.builders.tree import Bvh, KdTree
    from wrt.builders.triangle_boxes import TriangleBoxes
    from wrt.meshes.mesh import TriangleMesh
    from wrt.meshes.placement import PlacedMeshes

NAN = float("nan")
AUTO: Final = "auto"
ALWAYS: Final = "always"
NEVER: Final = "never"

When: TypeAlias = Literal["auto", "always", "never"]

SAMPLES = 4096
"""Triangles sampled for the typical motion of a scene."""

REBUILD_ALL_SHARE = 0.5
"""Share of all triangles from which a new tree is built in place of the costly subtrees."""

MIN_SUBTREE_TRIANGLES = 256
"""Smallest number of triangles for which a subtree is rebuilt separately."""


@dataclass(frozen=True, kw_only=True)
class UpdatePolicy:
    """When `Scene.update` rebuilds a tree. Its argument `rebuild` takes a policy, or a name for `when`.

    Attributes:
        when: "auto": when the tree has become too costly (a `wrt.known_rays.ProjectedBvh`: never); "always"; or "never" (except
            for kd-trees whose old planes would cut triangles into more than 64 pieces on average).
        tolerance: for "auto", largest ratio of the cost of a tree or subtree, by the surface area heuristic, to its cost
            when it was built; at least 1.
        subtrees: for "auto", whether subtrees may be rebuilt separately.

    Raises:
        ValueError: an unknown name, or a tolerance below 1.
    """

    when: When = AUTO
    tolerance: float = 1.3
    subtrees: bool = True

    def __post_init__(self) -> None:
        convert_fields(self)
        one_of((AUTO, ALWAYS, NEVER), self.when, "rebuild")
        if not self.tolerance >= 1.0:
            raise ValueError(f"tolerance is {self.tolerance}; it must be at least 1")


@dataclass(frozen=True)
class UpdateReport:
    """What an update did to a tree (`Scene.last_update`).

    Attributes:
        action: "kept": the nodes were kept; "subtrees": nodes were kept and some subtrees rebuilt; "built": the tree was
            rebuilt.
        cost_built: expected cost of a ray when the tree was built; NaN if it was not computed.
        cost_kept: expected cost with the old nodes and the moved triangles; NaN likewise.
        cost: expected cost of the updated tree; NaN likewise.
        rebuilt_triangles: number of triangles in rebuilt trees and subtrees.
        seconds: wall time, including building and measuring.
    """

    action: str
    cost_built: float
    cost_kept: float
    cost: float
    rebuilt_triangles: int
    seconds: float


def as_policy(rebuild: Any) -> UpdatePolicy:
    """The policy of that name, or the given policy.

    Raises:
        TypeError: neither.
        ValueError: an unknown name.
    """
    if isinstance(rebuild, UpdatePolicy):
        return rebuild
    if not isinstance(rebuild, str):
        raise TypeError(f"rebuild must be 'auto', 'always', 'never' or a wrt.moving.UpdatePolicy, not {type(rebuild).__name__}")
    return named_policy(rebuild)


@lru_cache(maxsize=8)
def named_policy(name: str) -> UpdatePolicy:
    """The policy of a name; errors as `UpdatePolicy`."""
    return UpdatePolicy(when=name)  # type: ignore[arg-type]  # which it checks


@dataclass(frozen=True)
class MovedTriangles:
    """Triangles in their new places.

    Attributes:
        vertices, faces: on the scene's device.
        host_vertices, host_faces: on the CPU; None for triangles that stay on the device.
        center: (3,) float64, the point that vertices are relative to.
        shift: (3,) float64, typical motion of the triangles relative to the centre.
        bounds: (3,) float32 each, corners of the box of all triangles, relative to the centre; None if they are not known.
    """

    vertices: wp.array
    faces: wp.array
    host_vertices: wp.array | None
    host_faces: wp.array | None
    center: np.ndarray
    shift: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def of(cls, placed: PlacedMeshes, shift: np.ndarray, first: int = 0, end: int | None = None) -> MovedTriangles:
        """The triangles first to end - 1 of a scene; shift: as in the class."""
        own = slice(first, end)
        mesh = placed.mesh
        return cls(mesh.vertices, mesh.faces[own], placed.vertices, placed.faces[own], placed.center, shift)

    def boxes(self, device: wp.Device | None = None) -> TriangleBoxes:
        """The bounding boxes of the triangles, on the CPU or on the scene's device."""
        from wrt.builders.triangle_boxes import triangle_boxes

        if device is not None and device == self.vertices.device:
            return triangle_boxes(self.vertices, self.faces, self.center, self.bounds)
        assert self.host_vertices is not None
        assert self.host_faces is not None
        return triangle_boxes(self.host_vertices, self.host_faces, self.center)


def can_move(accelerator: Accelerator) -> bool:
    """Whether nodes can be kept: not those of lazy trees, or of trees whose leaves list fewer triangles than their boxes
    meet, whose costs depend on the triangles, or whose nodes are in another order.
    """
    from wrt.accelerators.projected_bvh import ProjectedBvh
    from wrt.accelerators.tree_descriptions import Bvh, KdTree

    if isinstance(accelerator, KdTree):
        plain = accelerator.cell_tests == "none" and accelerator.layout == "depth_first"
        return plain and not (accelerator.is_lazy or accelerator.split_clipping or accelerator.ends_rays)
    return isinstance(accelerator, Bvh) or (isinstance(accelerator, ProjectedBvh) and accelerator.spatial_splits == 0.0)


def typical_motion(before: Sequence[TriangleMesh], after: Sequence[TriangleMesh]) -> np.ndarray:
    """(3,) float64: the median motion of a sample of triangle corners. The planes of a kd-tree are shifted by it, which
    follows a walking figure and leaves a scene at rest.
    """
    step, ways = -(-sum(mesh.triangle_count for mesh in after) // SAMPLES), []
    for old, new in zip(before, after, strict=True):
        corners = new.faces[::step, 0]
        ways.append(new.vertices[corners].astype(np.float64) - old.vertices[corners])
    return np.median(np.concatenate(ways), axis=0)


@dataclass(frozen=True)
class TreeRecipe:
    """How the tree of a scene is built.

    Attributes:
        accelerator: what to build.
        width: used if the description leaves it open.
        device: device of the tree.
    """

    accelerator: Accelerator
    width: int
    device: wp.Device

    @property
    def only_refits(self) -> bool:
        """Whether the surface area heuristic does not predict the cost of the tree's rays, so that trees are only refitted."""
        from wrt.accelerators.projected_bvh import ProjectedBvh

        return isinstance(self.accelerator, ProjectedBvh)

    @property
    def build_device(self) -> wp.Device:
        """Where the tree is built. Most builders have a thread build each subtree, which suits CPU cores: those trees are built
        on the CPU and copied."""
        from wrt.accelerators.cuda_trees import is_built_on

        return self.device if is_built_on(self.accelerator, self.device, self.width) else wp.get_device("cpu")

    def build(self, triangles: MovedTriangles) -> KdTree | Bvh:
        """Builds a new tree, on the scene's device."""
        return self.accelerator.build(triangles.boxes(self.build_device), self.width).to(self.device)

    def costs(self, tree: Any) -> np.ndarray:
        """(nodes,) cost of each subtree."""
        from wrt.builders.bvh.update.node_costs import node_costs
        from wrt.builders.kdtree import kdtree_statistics as statistics
        from wrt.builders.kdtree.update import refill

        cost = self.accelerator.config(self.width).cost
        is_bvh = self.accelerator.kind == "bvh"
        return node_costs(tree, cost) if is_bvh else refill.node_costs(statistics.unpack(tree), cost)

    def reuse_nodes(self, old: Any, triangles: MovedTriangles) -> RefittedBvh | RefilledKdTree:
        """The old nodes with the triangles in their new places."""
        from wrt.builders.bvh.update.bvh_update import RefittedBvh
        from wrt.builders.kdtree import KDTREE_BUILDERS
        from wrt.builders.kdtree.update.kdtree_update import RefilledKdTree

        config: Any = self.accelerator.config(self.width)
        if self.accelerator.kind == "bvh":
            cost = None if self.only_refits else config.cost
            build: Any = partial(self.accelerator.build, width=self.width)
            return RefittedBvh(old, triangles.vertices, triangles.faces, triangles.boxes, cost, build)
        host, build = old.to(wp.get_device("cpu")), KDTREE_BUILDERS[self.accelerator.builder].build
        return RefilledKdTree(host, triangles.boxes(), triangles.shift, config, build)


def move_tree(
    recipe: TreeRecipe, old: KdTree | Bvh, triangles: MovedTriangles, policy: UpdatePolicy
) -> tuple[KdTree | Bvh, UpdateReport]:
    """A tree of the triangles in their new places, and a report."""
    start = perf_counter()
    # a build on CUDA takes less time than a look at what a refit has made of the tree
    rebuilds = policy.when == ALWAYS or (policy.when == AUTO and recipe.build_device.is_cuda)
    moved = None if rebuilds else recipe.reuse_nodes(old, triangles)
    if moved is None or moved.tree is None:
        tree, action, costs, count = recipe.build(triangles), "built", (NAN, NAN, NAN), len(triangles.faces)
    elif policy.when == NEVER or recipe.only_refits:
        tree, action, costs, count = replace(moved.tree, built_costs=old.built_costs), "kept", (NAN, NAN, NAN), 0
    else:
        tree, action, costs, count = _rebuild_costly_parts(recipe, old, moved, triangles, policy)
    return tree.to(recipe.device), UpdateReport(action, *costs, count, perf_counter() - start)


def _rebuild_costly_parts(
    recipe: TreeRecipe,
    old: KdTree | Bvh,
    moved: RefittedBvh | RefilledKdTree,
    triangles: MovedTriangles,
    policy: UpdatePolicy,
) -> tuple[KdTree | Bvh, str, tuple[float, float, float], int]:
    """Rebuilds what is too costly. Returns the tree, the action and costs of `UpdateReport`, and the number of rebuilt
    triangles.
    """
    built = recipe.costs(old) if old.built_costs is None else old.built_costs
    before = float(built[0]), float(moved.costs[0])
    chosen = moved.parts(built, policy.tolerance)
    parts = {} if chosen == [(0,)] or not policy.subtrees else {part: moved.triangles(part) for part in chosen}
    parts = {part: ids for part, ids in parts.items() if len(ids) >= MIN_SUBTREE_TRIANGLES}
    count = sum(map(len, parts.values()))
    if not parts and before[1] <= policy.tolerance * before[0]:
        return replace(moved.tree, built_costs=built), "kept", (*before, before[1]), 0
    large = count > REBUILD_ALL_SHARE * len(triangles.faces)
    grafted = moved.with_rebuilt([*parts], [*parts.values()]) if parts and not large else None
    if grafted is None:
        tree = recipe.build(triangles)
        costs = recipe.costs(tree)
        return replace(tree, built_costs=costs), "built", (*before, float(costs[0])), len(triangles.faces)
    tree, origin = grafted
    costs = recipe.costs(tree)
    built = np.where(origin >= 0, built[origin], costs)
    return replace(tree, built_costs=built), "subtrees", (*before, float(costs[0])), count
