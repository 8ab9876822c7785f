"""Group trees: what moves together has a tree of its own, and only the groups that have moved are touched.

**Idea (Kang et al. 2013).** A scene of groups, some of which never move, gets a tree for each group and an upper tree whose
candidates for splits are the boxes of groups: few, whatever the number of triangles. A frame needs the trees of the groups
that have moved, which do not depend on each other and are dealt out to the threads, and the upper one.

**What we changed.** Trees are bounding volume hierarchies, whose upper levels may overlap as groups do, and rays are not
transformed: the trees are put together to one, so that packets and streams walk it as any other, and hits are the same to the
bit. A group that has moved keeps its nodes as long as `wrt.UpdatePolicy` finds them good enough. If the centre of the scene
moves, which positions are relative to, the boxes of groups at rest are fitted again; their nodes stay. A builder keeps to the
greatest depth of a tree, but a deep group below an upper tree may come to lie beyond it; a tree over all triangles is then
built instead. It takes a chain of some sixty triangles, each twice as large as the last.

References:
    Y.-S. Kang, J.-H. Nah, W.-C. Park, S.-B. Yang: gkDtree: a group-based parallel update kd-tree for interactive ray tracing.
        Journal of Systems Architecture 59, 2013.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import Bvh
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import run_tasks, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.placement import check_index, moved_mesh, place_meshes
from wrt.scene.scene import Scene
from wrt.scene.updates import MovedTriangles, TreeRecipe, UpdatePolicy, UpdateReport, as_policy, move_tree

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.meshes.mesh import TriangleMesh


class GroupedScene(Scene):
    """A scene whose meshes are groups: each has a tree of its own, and one that moves leaves the others alone.

        scene = wrt.GroupedScene([building, curtain, figure])
        scene.move({1: curtain_vertices, 2: figure_vertices})

    Arguments as in `wrt.Scene`, but for `cache`: trees of groups are not kept in a folder. So are queries and hits.

    Attributes:
        group_updates: dict of `UpdateReport` by the index of each mesh that the last update moved.

    Raises:
        TypeError, ValueError: as `wrt.Scene`; an accelerator that is no `wrt.Bvh`; a cache.
    """

    group_updates: Mapping[int, UpdateReport]

    def _set(self, meshes: tuple[TriangleMesh, ...], cache: Any, policy: UpdatePolicy | None = None) -> None:
        if not isinstance(self.accelerator, Bvh):
            raise TypeError(f"accelerator must be a wrt.Bvh, not {self.accelerator!r}: the boxes of groups may overlap")
        if cache is not None:
            raise ValueError("cache goes with wrt.Scene: the trees of groups are not kept in a folder; leave it out")
        placed = place_meshes(meshes, self.device)
        groups = [MovedTriangles.of(placed, np.zeros(3), first, end) for first, end in pairwise(placed.first)]
        recipe = TreeRecipe(self.accelerator, native_width(self.device), self.device)
        trees, reports = self._trees_of(recipe, meshes, groups, placed.center, policy)
        tree = join_groups(trees, placed.first, self.device)
        if tree.depth > MAX_WIDE_DEPTH:
            tree = recipe.build(MovedTriangles.of(placed, np.zeros(3)))
        self._take_over(meshes, placed.center, tree, placed.fill_in(tree.low, tree.high))
        self._trees, self.group_updates = trees, reports

    def _trees_of(
        self,
        recipe: TreeRecipe,
        meshes: tuple[TriangleMesh, ...],
        groups: list[MovedTriangles],
        center: np.ndarray,
        policy: UpdatePolicy | None,
    ) -> tuple[list[common.Bvh], dict[int, UpdateReport]]:
        """A tree for each group, and what was done to those that have moved; without a policy, all are built."""
        from wrt.builders.bvh.update.refit import refit

        trees: list[common.Bvh] = [None] * len(groups) if policy is None else list(self._trees)
        reports: dict[int, UpdateReport] = {}
        has_shifted = policy is not None and (center != self.center).any()

        def work(number: int) -> None:
            group = groups[number]
            if policy is None:
                trees[number] = recipe.build(group)
            elif meshes[number] is not self.meshes[number]:
                trees[number], reports[number] = move_tree(recipe, trees[number], group, policy)
            elif has_shifted:
                trees[number] = refit(trees[number], group.vertices, group.faces)

        run_tasks(work, len(groups))
        return trees, reports

    def move(self, vertices: Mapping[int, Any], *, rebuild: str | UpdatePolicy = "auto") -> None:
        """Moves several groups at once; arguments and errors as of `update`.

        Args:
            vertices: (V, 3) new vertices by the index of the mesh.
            rebuild: "auto", "always", "never", or a `wrt.UpdatePolicy`.
        """
        policy, meshes, changed = as_policy(rebuild), list(self.meshes), copy(self)
        for index, points in vertices.items():
            number = check_index(index, len(meshes), "mesh")
            meshes[number] = moved_mesh(meshes[number], points)
        with use_threads(self.num_threads):
            changed._set(tuple(meshes), None, policy)
        self.__dict__ = changed.__dict__

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the groups; their trees are built again."""
        options = {"triangle_test": self.triangle_test, "device": str(self.device), "num_threads": self.num_threads}
        return partial(GroupedScene, list(self.meshes), self.accelerator, **options), (), {"mark": self.mark}

    def __repr__(self) -> str:
        return f"GroupedScene({self.triangle_count} triangles in {len(self.meshes)} groups, device={str(self.device)!r})"


def join_groups(trees: list[common.Bvh], first: np.ndarray, device: wp.Device) -> common.Bvh:
    """One tree of the groups' trees, however deep.

    Args:
        trees: on the device; each counts triangles from its own first.
        first: (groups + 1,) the first triangle of each group.
        device: where the tree goes.
    """
    from wrt.builders.bvh.update.bvh_grafting import plant
    from wrt.builders.triangle_boxes import boxes_of

    if len(trees) == 1:
        return trees[0]
    width = trees[0].width
    boxes = boxes_of(np.array([tree.low for tree in trees]), np.array([tree.high for tree in trees]))
    top = Bvh(width=width, max_leaf_triangles=1).build(boxes, width).to(device)
    return plant(top, trees, [np.arange(a, b) for a, b in pairwise(first)])
