"""Group trees: each group of triangles that moves together has its own tree, and a frame updates only groups that moved.

**Idea (Kang et al. 2013).** A scene consists of groups, some of which never move. Each group gets a tree, and an upper tree
considers only the boxes of groups as split candidates, which are few for any number of triangles. A frame updates the trees
of the groups that moved, independently of each other and on several threads, and builds the upper tree.

**What we changed.** The trees are bounding volume hierarchies, whose upper levels may overlap as groups do, and rays are
not transformed: all trees are joined into one, so that packets and streams walk it like any other, and hits are the same
bit for bit. A group that moved keeps its nodes as long as `wrt.UpdatePolicy` accepts their cost. If the scene's centre
moves, to which positions are relative, the boxes of groups at rest are refitted; their nodes stay.

**Limits.** Builders limit the depth of a tree, but a deep group below an upper tree may exceed the limit. One tree over all
triangles is then built instead. This takes a chain of about sixty triangles, each twice as large as the previous one.

References:
    Y.-S. Kang, J.-H. Nah, W.-C. Park, S.-B. Yang: gkDtree: a group-based parallel update kd-tree for interactive ray
    tracing. Journal of Systems Architecture 59, 2013.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (an overview of trees for dynamic
    scenes).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import run_tasks, use_threads
from wrt.meshes.placement import as_meshes, check_index, moved_mesh, place_meshes
from wrt.scene.mesh_state import MeshState, recipe_of
from wrt.scene.scene import Scene
from wrt.scene.updates import MovedTriangles, UpdatePolicy, UpdateReport, as_policy, move_tree
from wrt.state.query_kinds import AUTO
from wrt.state.scene_settings import as_settings
from wrt.state.scene_state import Settings, new_mark

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.meshes.mesh import TriangleMesh
    from wrt.meshes.placement import PlacedMeshes


class GroupedScene(Scene):
    """A scene whose meshes are groups: each has its own tree, and moving one leaves the trees of the others as they are.

        scene = wrt.GroupedScene([building, curtain, figure])
        scene.move({1: curtain_vertices, 2: figure_vertices})

    Arguments as in `wrt.Scene`, except that there is no `cache`; queries and hits are the same.

    Attributes:
        group_updates: dict of `UpdateReport` by mesh index, for the meshes that the last update moved.

    Raises:
        TypeError, ValueError: as `wrt.Scene`; an accelerator that is not a `wrt.Bvh`; a cache.
    """

    def __init__(
        self,
        geometry: Any,
        accelerator: Any = AUTO,
        *,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        cache: None = None,
    ) -> None:
        settings = as_settings(accelerator, triangle_test, device, num_threads)
        if not isinstance(settings.accelerator, Bvh):
            raise TypeError(f"accelerator must be a wrt.Bvh, not {settings.accelerator!r}: the boxes of groups may overlap")
        if cache is not None:
            raise ValueError(
                "cache is not supported: the trees of groups are not stored in a folder; leave it out, or make a wrt.Scene"
            )
        with use_threads(settings.num_threads):
            self.state = build_groups(as_meshes(geometry), settings)

    @property
    def group_updates(self) -> Mapping[int, UpdateReport]:
        """What the last update did to the tree of each mesh that it moved, by the index of the mesh."""
        return self.state.reports

    def move(self, vertices: Mapping[int, Any], *, rebuild: str | UpdatePolicy = "auto") -> None:
        """Moves several groups at once; errors as in `update`.

        Args:
            vertices: new vertices (V, 3) by mesh index.
            rebuild: "auto", "always", "never", or a `wrt.UpdatePolicy`.
        """
        policy, meshes, changed = as_policy(rebuild), self.meshes, {}
        for index, points in vertices.items():
            number = check_index(index, len(meshes), "mesh")
            changed[number] = moved_mesh(meshes[number], points)
        self.state = self.state.moved(changed, policy)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the groups; unpickling rebuilds their trees."""
        options = {"triangle_test": self.triangle_test, "device": str(self.device), "num_threads": self.num_threads}
        return unpickle_groups, (self.meshes, self.accelerator, options, self.state.mark)

    def __repr__(self) -> str:
        return f"GroupedScene({self.triangle_count} triangles in {len(self.meshes)} groups, device={str(self.device)!r})"


@dataclass(frozen=True, eq=False, kw_only=True)
class GroupedState(MeshState):
    """The state of a scene of groups.

    Attributes:
        trees: of each group; each counts triangles from its own first.
        reports: what the last update did to the trees of those that moved.
    """

    trees: tuple[common.Bvh, ...] = ()
    reports: Mapping[int, UpdateReport] = field(default_factory=dict)

    def moved(self, changed: dict[int, TriangleMesh], policy: UpdatePolicy) -> GroupedState:
        """The state with some groups elsewhere, by their index: their trees are refitted or built again, and the upper one."""
        from wrt.builders.bvh.update.refit import refit

        meshes = tuple(changed.get(number, mesh) for number, mesh in enumerate(self.meshes))
        with use_threads(self.num_threads):
            placed = place_meshes(meshes, self.device)
            groups, recipe = groups_of(placed), recipe_of(self.settings)
            trees, reports = list(self.trees), {}
            has_shifted = (placed.center != self.center).any()

            def work(number: int) -> None:
                group = groups[number]
                if number in changed:
                    trees[number], reports[number] = move_tree(recipe, trees[number], group, policy)
                elif has_shifted:
                    trees[number] = refit(trees[number], group.vertices, group.faces)

            run_tasks(work, len(groups))
            return state_of_groups(meshes, placed, self.settings, trees, reports, self.mark)


def build_groups(meshes: tuple[TriangleMesh, ...], settings: Settings) -> GroupedState:
    """The state of a scene of groups: a tree for each, and one over all."""
    placed, recipe = place_meshes(meshes, settings.device), recipe_of(settings)
    groups = groups_of(placed)
    trees: list[common.Bvh] = [None] * len(groups)

    def work(number: int) -> None:
        trees[number] = recipe.build(groups[number])

    run_tasks(work, len(groups))
    return state_of_groups(meshes, placed, settings, trees, {}, new_mark())


def groups_of(placed: PlacedMeshes) -> list[MovedTriangles]:
    """The triangles of each group."""
    return [MovedTriangles.of(placed, np.zeros(3), first, end) for first, end in pairwise(placed.first)]


def state_of_groups(
    meshes: tuple[TriangleMesh, ...],
    placed: PlacedMeshes,
    settings: Settings,
    trees: list[common.Bvh],
    reports: Mapping[int, UpdateReport],
    mark: str,
) -> GroupedState:
    """The state of groups with these trees: puts them together."""
    tree = join_groups(trees, placed.first, settings.device)
    if tree.depth > MAX_WIDE_DEPTH:
        tree = recipe_of(settings).build(MovedTriangles.of(placed, np.zeros(3)))
    return GroupedState(
        settings=settings,
        meshes=meshes,
        center=placed.center,
        built_tree=tree,
        device_mesh=placed.fill_in(tree.low, tree.high),
        mark=mark,
        trees=tuple(trees),
        reports=reports,
    )


def unpickle_groups(meshes: Any, accelerator: Bvh, options: dict[str, Any], mark: str) -> GroupedScene:
    """The scene of a pickle."""
    scene = GroupedScene(meshes, accelerator, **options)
    scene.state = replace(scene.state, mark=mark)
    return scene


def join_groups(trees: list[common.Bvh], first: np.ndarray, device: wp.Device) -> common.Bvh:
    """Joins the trees of groups into one, of any depth.

    Args:
        trees: on the device; each numbers triangles from the first of its group.
        first: (groups + 1,) the first triangle of each group.
        device: device of the result.
    """
    from wrt.builders.bvh.update.bvh_grafting import merge_below
    from wrt.builders.triangle_boxes import boxes_of

    if len(trees) == 1:
        return trees[0]
    width = trees[0].width
    boxes = boxes_of(np.array([tree.low for tree in trees]), np.array([tree.high for tree in trees]))
    top = Bvh(width=width, max_leaf_triangles=1).build(boxes, width).to(device)
    return merge_below(top, trees, [np.arange(a, b) for a, b in pairwise(first)])
