"""Group trees: each group of triangles that moves together has its own tree, and a frame updates only groups that moved.

**Idea (Kang et al. 2013).** A scene consists of groups, and groups of groups, some of which never move. Each group gets a tree,
and an upper tree considers only the boxes of its members as split candidates, which are few for any number of triangles. A
frame updates the trees of the groups that moved, independently of each other and on several threads, and builds the upper ones.

**What we changed.** Rays are not transformed. Bounding volume hierarchies, whose upper levels may overlap as groups do, are
joined into one, so that packets and streams walk it like any other. kd-trees are joined by links
(`wrt.kernels.traversal.two_level.linked_kdtrees`), for single rays. Hits are the same bit for bit. A group that moved keeps its
nodes as long as `wrt.moving.UpdatePolicy` accepts their cost. If the scene's centre moves, to which positions are relative, the
boxes of groups at rest are refitted, and the planes of their kd-trees are shifted; their nodes stay.

**Lists.** kd-trees may also be in a list that every ray goes through. Two groups, what rests and what moves, are then the two
trees of Bikker (2007). Trees of a single leaf are the moving objects of Parker et al. (1999), which rays test one by one.

**Limits.** Builders limit the depth of a tree, but a deep group below an upper tree may exceed the limit. One BVH over all
triangles is then built instead. This takes a chain of about sixty triangles, each twice as large as the previous one.

References: kang-2013; bikker-2007; parker-1999; rahikainen-2013 (an overview of trees for dynamic scenes).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.facts.scene_state import Settings, new_mark
from wrt.kernels.runtime.launch import get_num_threads, run_tasks, use_threads
from wrt.meshes.placement import as_meshes, nested, place_meshes
from wrt.moving.group_trees import TREE, GroupLayout
from wrt.scene.mesh_state import MeshState
from wrt.scene.scene import Scene
from wrt.scene.updates import MovedTriangles, UpdatePolicy, UpdateReport, can_move, move_tree, typical_motion

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Accelerator, AcceleratorName
    from wrt.array_types import ArrayLike
    from wrt.builders import tree as common
    from wrt.meshes.instance import Geometry
    from wrt.meshes.mesh import TriangleMesh
    from wrt.meshes.placement import PlacedMeshes
    from wrt.scene.updates import When


class GroupedScene(Scene):
    """A scene whose meshes are groups: each has its own tree, and moving one leaves the trees of the others as they are.

        scene = wrt.moving.GroupedScene([building, curtain, [torso, [left_arm, left_hand], [right_arm, right_hand]]])
        scene.update({1: curtain_vertices, 4: hand_vertices})

    Groups may consist of groups, as nested sequences; each level gets an upper tree. Queries and hits are those of a
    `wrt.Scene`; with kd-trees, rays are traced one at a time. Arguments as in `wrt.Scene`, without `cache`, and:

    Args:
        accelerator: of the groups' trees, a `wrt.Bvh` or `wrt.KdTree`.
        accelerators: other descriptions for some groups, by mesh index; of the same kind and width.
            `wrt.KdTree(max_depth=0)` is a single leaf, whose triangles are tested one by one.
        top: with kd-trees, what lies above those of groups: "tree" or "list" (`wrt.moving.group_trees.TOPS`).

    Attributes:
        group_updates: dict of `UpdateReport` by mesh index, for the meshes that the last update moved.

    Raises:
        TypeError, ValueError: as `wrt.Scene`; an accelerator that is neither a `wrt.Bvh` nor a `wrt.KdTree`, lazy, or of
            another kind or width than those of other groups; an unknown `top`, or "list" without kd-trees; a cache.
    """

    state: GroupedState

    def __init__(
        self,
        geometry: Geometry,
        accelerator: AcceleratorName | Accelerator = AUTO,
        *,
        accelerators: Mapping[int, AcceleratorName | Accelerator] | None = None,
        top: str = TREE,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        cache: None = None,
    ) -> None:
        settings = as_settings(accelerator, triangle_test, device, num_threads)
        if cache is not None:
            raise ValueError(
                "cache is not supported: the trees of groups are not stored in a folder; leave it out, or make a wrt.Scene"
            )
        meshes = as_meshes(geometry)
        layout = GroupLayout.of(geometry, len(meshes), settings, accelerators or {}, top)
        with use_threads(settings.num_threads):
            self.state = build_groups(meshes, settings, layout)

    @property
    def group_updates(self) -> Mapping[int, UpdateReport]:
        """What the last update did to the tree of each mesh that it moved, by the index of the mesh."""
        return self.state.reports

    def move(
        self,
        nodes: Mapping[str, ArrayLike] | None = None,
        *,
        vertices: Mapping[int, ArrayLike] | None = None,
        rebuild: When | UpdatePolicy = "auto",
    ) -> None:
        """As `Scene.move`, which a scene of groups refuses: its meshes hang on no nodes. `update` moves them.

        The old meaning still works, with a `DeprecationWarning`: new vertices by the index of the mesh.

        Args:
            nodes: as in `Scene.move`.
            vertices: deprecated, as `index` of `update`.
            rebuild: deprecated, as in `update`.

        Raises:
            ValueError: the scene has no nodes.
        """
        old: Any = nodes if vertices is None else vertices
        if not isinstance(old, Mapping) or any(isinstance(name, str) for name in old):
            super().move(old if nodes is None else nodes)
            return
        warnings.warn(
            "wrt.moving.GroupedScene.move(vertices) is now update(vertices), as in wrt.Scene; the old name goes with the next "
            "release",
            DeprecationWarning,
            stacklevel=2,
        )
        if old:
            self.update(old, rebuild=rebuild)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the groups; unpickling rebuilds their trees."""
        layout = self.state.layout
        options = {
            "accelerators": {index: recipe.accelerator for index, recipe in enumerate(layout.recipes)},
            "top": layout.top,
            "triangle_test": self.triangle_test,
            "device": str(self.device),
            "num_threads": self.num_threads,
        }
        return unpickle_groups, (nested(layout.hierarchy, self.meshes), self.accelerator, options, self.state.mark)

    def __repr__(self) -> str:
        return f"GroupedScene({self.triangle_count} triangles in {len(self.meshes)} groups, device={str(self.device)!r})"


@dataclass(frozen=True, eq=False, kw_only=True)
class GroupedState(MeshState):
    """The state of a scene of groups.

    Attributes:
        layout: how they are arranged.
        trees: of each group; each counts triangles from its own first.
        reports: what the last update did to the trees of those that moved.
    """

    is_plain: ClassVar[bool] = False

    layout: GroupLayout
    trees: tuple[common.Bvh | common.KdTree, ...] = ()
    reports: Mapping[int, UpdateReport] = field(default_factory=dict)

    def moved(self, changed: dict[int, TriangleMesh], policy: UpdatePolicy) -> GroupedState:
        """The state with some groups elsewhere, by their index: their trees are updated, and the upper ones built."""
        meshes = tuple(changed.get(number, mesh) for number, mesh in enumerate(self.meshes))
        with use_threads(self.num_threads):
            placed = place_meshes(meshes, self.device)
            trees, reports = list(self.trees), {}
            shift = self.center - placed.center

            def work(number: int) -> None:
                recipe, first, end = self.layout.recipes[number], placed.first[number], placed.first[number + 1]
                if number in changed:
                    way = shift + typical_motion(self.meshes[number : number + 1], meshes[number : number + 1])
                    group = MovedTriangles.of(placed, way, first, end)
                    own = policy if can_move(recipe.accelerator) else ALWAYS
                    trees[number], reports[number] = move_tree(recipe, trees[number], group, own)
                elif shift.any():
                    group = MovedTriangles.of(placed, shift, first, end)
                    own = AT_REST if can_move(recipe.accelerator) else ALWAYS
                    trees[number], _ = move_tree(recipe, trees[number], group, own)

            busy = [len(mesh.faces) if number in changed or shift.any() else 0 for number, mesh in enumerate(meshes)]
            run_shared(work, busy)
            return state_of_groups(meshes, placed, self.settings, self.layout, trees, reports, self.mark)


AT_REST, ALWAYS = UpdatePolicy(when="never"), UpdatePolicy(when="always")


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkedState(GroupedState):
    """The state of a scene of groups with kd-trees."""

    refused: ClassVar[dict[str, str]] = {
        "statistics": "a scene of groups has several kd-trees; use wrt.Scene(scene.meshes, 'kdtree').statistics()",
        "float64 vertices": "precise=True and gradients need a scene with a single tree; use wrt.Scene(scene.meshes)",
        "save": "linked kd-trees cannot be saved; save the meshes, or a wrt.moving.GroupedScene with BVHs",
        "handle": "kernels need the handle of a single tree; use wrt.Scene(scene.meshes).handle()",
    }


def run_shared(work: Callable[[int], None], triangles: Sequence[int]) -> None:
    """Calls `work` for each group, on several threads, which share the CPU threads by the triangles that they have to do with.

    Without that, the tree of every group would be built with all threads, and these would wait for each other.
    """
    threads, total = get_num_threads(), max(1, sum(triangles))

    def task(number: int) -> None:
        with use_threads(max(1, threads * triangles[number] // total)):
            work(number)

    run_tasks(task, len(triangles))


def build_groups(meshes: tuple[TriangleMesh, ...], settings: Settings, layout: GroupLayout) -> GroupedState:
    """The state of a scene of groups: a tree for each, and those above."""
    placed = place_meshes(meshes, settings.device)
    groups = [MovedTriangles.of(placed, np.zeros(3), first, end) for first, end in pairwise(placed.first)]
    trees: list[Any] = [None] * len(groups)

    def work(number: int) -> None:
        trees[number] = layout.recipes[number].build(groups[number])

    run_shared(work, [len(mesh.faces) for mesh in meshes])
    return state_of_groups(meshes, placed, settings, layout, trees, {}, new_mark())


def state_of_groups(
    meshes: tuple[TriangleMesh, ...],
    placed: PlacedMeshes,
    settings: Settings,
    layout: GroupLayout,
    trees: list[common.Bvh | common.KdTree],
    reports: Mapping[int, UpdateReport],
    mark: str,
) -> GroupedState:
    """The state of groups with these trees: puts them together."""
    tree = layout.join(trees, placed, settings.device)
    return (LinkedState if layout.is_linked else GroupedState)(
        settings=settings,
        meshes=meshes,
        center=placed.center,
        built_tree=tree,
        device_mesh=placed.fill_in(tree.low, tree.high),
        only_single=layout.is_linked,
        mark=mark,
        layout=layout,
        trees=tuple(trees),
        reports=reports,
    )


def unpickle_groups(geometry: Any, accelerator: Any, options: dict[str, Any], mark: str) -> GroupedScene:
    """The scene of a pickle."""
    scene = GroupedScene(geometry, accelerator, **options)
    scene.state = replace(scene.state, mark=mark)
    return scene
