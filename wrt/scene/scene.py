"""A scene: meshes, a tree over their triangles, and the records of these that triangle tests read."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from contextlib import AbstractContextManager
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import Accelerator, resolve_accelerator
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.execution.plan import AUTO, Plan
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import as_device, check_num_threads, use_threads
from wrt.memory import memory_for
from wrt.meshes.instance import Instance, has_instances
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import as_meshes, check_index, moved_mesh, place_meshes
from wrt.query.api import Queries
from wrt.scene.updates import MovedTriangles, TreeRecipe, UpdatePolicy, as_policy, can_move, move_tree, typical_motion
from wrt.tables import lookup

if TYPE_CHECKING:
    from pathlib import Path

    from wrt.builders import tree as common
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree
    from wrt.execution.area_trees import LocalTrees
    from wrt.execution.few_rays import Desk
    from wrt.execution.ready import ReadyKernel
    from wrt.execution.recorded import Recording
    from wrt.execution.triangle_records import KnownRecords
    from wrt.execution.wide_trees import WideForm
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
    from wrt.scene.scene_statistics import SceneStatistics
    from wrt.scene.storage import TreeSource
    from wrt.scene.updates import UpdateReport


class Scene(Queries):
    """Triangle meshes that rays can be shot at.

    The tree is built at once, or as far as rays ask for it (`wrt.KdTree(builder="lazy")`). A scene may be used from several
    threads, as long as none of them calls `update`: that changes the scene in one step, at its end or not at all, but a query
    under way may see a part of it before and a part after. Results that were made before keep the geometry that they were made
    with.

    Args:
        geometry: a `TriangleMesh`, a trimesh.Trimesh or trimesh.Scene, a `wrt.Instance`, or a sequence of such. Each mesh of a
            sequence is a geometry of its own (`Hits.geometry_id`), in one tree with the others. With an instance or a
            trimesh.Scene in it, a `wrt.InstancedScene` is made, of two levels: each node of the graph is an instance.
        accelerator: "auto", "bvh", "kdtree", or a description such as `wrt.KdTree(builder="in_place")`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`: the test of all queries that ask for none of
            their own. Only the default one counts (`count`, `intersect_all`, `contains`) exactly, and stays in charge of that.
        device: a Warp device or its name, such as "cpu" or "cuda:0"; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.
        cache: path of a folder in which to look for the tree, by a hash of all that it depends on; one that is not there is
            built and written there. Trees of any number of scenes share a folder. None: no file is read or written.

    Raises:
        TypeError: `geometry`, `accelerator`, `num_threads` or `cache` is of a wrong type.
        ValueError: unknown names, no such device, an empty sequence, one that contains itself, a `cache` that is a file;
            triangles that spread over more than 6.9e10 (`wrt.meshes.placement.MAX_EXTENT`) or lie beyond 1.3e36, which float32
            cannot hold.
        MemoryError: there is too little memory for the tree.
        OSError: the folder of `cache` cannot be made. (A tree that cannot be written there is a warning.)
    """

    instances: tuple[Instance, ...] = ()
    """What a `wrt.InstancedScene` is made of; none in a scene of meshes."""

    only_single = False
    """Whether rays go one by one, whatever the traversal "auto" would choose."""

    def __new__(cls, geometry: Any = None, *args: Any, **options: Any) -> Scene:
        if cls is Scene and has_instances(geometry):
            from wrt.scene.instanced_scene import InstancedScene

            cls = InstancedScene
        return super().__new__(cls)

    def __init__(
        self,
        geometry: Any,
        accelerator: str | Accelerator = AUTO,
        *,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        cache: str | Path | TreeSource | None = None,
    ) -> None:
        self.accelerator = resolve_accelerator(accelerator)
        self.triangle_test = _as_test(triangle_test)
        self.device = as_device(device)
        self.num_threads = None if num_threads is None else check_num_threads(num_threads, "num_threads")
        with use_threads(self.num_threads):
            self._make(geometry, cache)

    def _make(self, geometry: Any, cache: Any) -> None:
        self._set(as_meshes(geometry), cache)

    def _set(self, meshes: tuple[TriangleMesh, ...], cache: Any, policy: UpdatePolicy | None = None) -> None:
        """Takes over the meshes; the tree is found or built, or with a policy the scene's own is moved, if that can be."""
        # What queries need is imported here: `wrt.kernels.traversal` and its parts import one another, and threads that enter
        # such a package from two ends at a time fail.
        import wrt.kernels.traversal  # noqa: F401
        from wrt.builders.triangle_boxes import triangle_boxes
        from wrt.execution.area_trees import build_local_trees
        from wrt.kernels.simd.lanes import native_width
        from wrt.scene.storage import find_tree

        recipe = TreeRecipe(self.accelerator, native_width(self.device), self.device)
        has_areas, growing, report = isinstance(self.accelerator, RayAwareBvh), None, None
        triangles = f"the tree of {sum(mesh.triangle_count for mesh in meshes):,} triangles"
        with memory_for(triangles, sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes)):
            placed = place_meshes(meshes, self.device)
            if policy is not None and can_move(self.accelerator):
                shift = self.center - placed.center + typical_motion(self.meshes, meshes)
                tree, report = move_tree(recipe, self._tree, MovedTriangles.of(placed, shift), policy)
            else:
                # Subtrees are built by one thread each, which suits cores: the tree is built on the CPU and copied.
                boxes = triangle_boxes(placed.vertices, placed.faces, placed.center)
                tree, growing = find_tree(recipe, boxes, placed, cache)
        self._take_over(meshes, placed.center, tree, placed.fill_in(tree.low, tree.high))
        self.growing, self.last_update = growing, report
        if has_areas:
            self.local_trees = build_local_trees(self, boxes)

    def _take_over(
        self, meshes: tuple[TriangleMesh, ...], center: np.ndarray, tree: common.KdTree | common.Bvh, mesh: SceneMesh
    ) -> None:
        """The only place where a scene gets its parts; nothing here can fail."""
        self.__dict__.setdefault("mark", uuid4().hex)  # by which hits know it: updates, copies and pickles keep it
        self.meshes = meshes
        self.growing: LazyKdTree | None = None
        """The tree that is built lazily; None if it is all there."""
        self._tree = tree
        self.local_trees: LocalTrees | None = None
        """The trees of influence areas, where there are any."""
        self.last_update: UpdateReport | None = None
        """What the last update did to the tree; None if there was none, or the tree is of a kind that is always built again."""
        self.center = center
        """(3,) float64; geometry is held in float32 relative to this point."""
        self.device_mesh = mesh
        """All triangles on the device, for kernels."""
        self.plans: dict[tuple[Any, ...], Plan] = {}
        """Those that were made for rays so far."""
        self.desks: dict[Hashable, deque[Desk | Recording | ReadyKernel]] = {}
        """What is kept ready and free, for each query: see `wrt.execution.few_rays`, `wrt.execution.recorded` and
        `wrt.execution.ready`."""
        self._blocks: KnownRecords = {}
        self.wide: WideForm | None = None
        """The wide form of a kd-tree, if there is one, and what the rays so far would have saved with it
        (`wrt.execution.wide_trees`)."""
        self.missed = 0.0
        self.__dict__.pop("is_closed", None)

    def update(
        self,
        index: int,
        *,
        vertices: Any = None,
        transform: Any = None,
        mask: int | None = None,
        rebuild: str | UpdatePolicy = "auto",
    ) -> None:
        """Moves the vertices of a mesh; its triangles stay the same.

        The tree keeps its nodes, which is faster than a build: a BVH is refitted, the leaves of a kd-tree are filled again. It
        answers more slowly the further triangles move. So it is built again, in parts or as a whole, once it has become too
        costly (`wrt.UpdatePolicy`); `last_update` tells what was done. Trees that are lazy, clip triangles or are made for
        influence areas are built again every time.

        Args:
            index: of the mesh (`Hits.geometry_id`).
            vertices: (V, 3), as many as the mesh has.
            transform, mask: for scenes of instances (`wrt.InstancedScene.update`).
            rebuild: "auto", "always", "never", or a `wrt.UpdatePolicy`.

        Raises:
            TypeError: a value is of a wrong type.
            ValueError: no such mesh, a wrong number of vertices, NaN or infinite ones, or triangles that spread too far (as of
                the class), a transform or a mask, an unknown name. The scene is then as before.
        """
        if transform is not None or mask is not None:
            raise ValueError("transform and mask go with instances, and this scene has none; make it of wrt.Instance(mesh)")
        index, policy = check_index(index, len(self.meshes), "mesh"), as_policy(rebuild)
        moved, changed = moved_mesh(self.meshes[index], vertices), copy(self)
        with use_threads(self.num_threads):
            changed._set((*self.meshes[:index], moved, *self.meshes[index + 1 :]), None, policy)
        self.__dict__ = changed.__dict__

    def updating(self, *args: Any, threads: int = 1, **options: Any) -> AbstractContextManager[None]:
        """Updates the scene while the `with` block goes on asking the old one.

            with scene.updating(0, vertices=next_frame):
                image = wrt.render(scene, camera)  # of this frame
            # the scene is now the next frame

        Args:
            args, options: as of `update`.
            threads: those of the CPU that build; queries of this scene get the others meanwhile, but at least one.

        Raises:
            TypeError, ValueError: as of `update`, at the end of the block. The scene is then as before.
        """
        from wrt.scene.background_update import updating

        return updating(self, threads, args, options)

    def over(self, tree: common.Bvh) -> Scene:
        """The same scene with another tree on its device, over some of its triangles; it has no areas."""
        other = copy(self)
        other.tree, other.local_trees, other._blocks = tree, None, {}
        return other

    @property
    def tree(self) -> common.KdTree | common.Bvh:
        """The tree; of one that is built lazily, what there is by now."""
        return self._tree if self.growing is None else self.growing.current.tree

    @tree.setter
    def tree(self, tree: common.KdTree | common.Bvh) -> None:
        self._tree, self.growing = tree, None

    def complete(self) -> None:
        """Builds what is left to build of a tree that is built lazily, before it is walked by what does not ask for more."""
        if self.growing is not None:
            with use_threads(self.num_threads):
                self.growing.finish()

    def save(self, path: str | Path) -> None:
        """Writes the meshes, the description of the tree, and the tree, to a file that `load` reads.

        The file is an .npz archive of plain arrays, whatever name `path` gives it. It takes the place of an earlier one only
        when it is complete; where `path` is a symbolic link, of the file that it points to.

        Raises:
            OSError: the file cannot be written.
            ValueError: the tree is built lazily, or for influence areas: such trees are not kept; `path` is a device, a pipe or
                a folder.
        """
        from wrt.scene.storage import save_scene

        save_scene(self, path)

    @classmethod
    def load(cls, path: str | Path, *, device: str | wp.Device | None = None, num_threads: int | None = None) -> Scene:
        """Reads a scene that was saved. Its answers are the same to the bit.

        The tree is built again if it is not the one that would be built here: another version of wrt wrote it, or for a
        device with vectors of another width. Nothing in a file is run, and no file leads a kernel out of its arrays. A checksum
        of all arrays tells damage. It is no signature: take files whose answers matter only from those whom you trust.

        Args:
            path: of the file.
            device, num_threads: as of the constructor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is no scene that wrt saved, or it is damaged; no such device.
        """
        from wrt.scene.storage import load_scene

        return load_scene(path, device, num_threads)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles take the tree along."""
        from wrt.scene.storage import reduce_scene

        return reduce_scene(self)

    def __copy__(self) -> Scene:
        """A scene of its own with the same meshes and tree, where they are."""
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__ | {"desks": {}, "plans": {}, "_blocks": dict(self._blocks)}
        return other

    def __repr__(self) -> str:
        return f"Scene({self.triangle_count} triangles, {self.accelerator}, device={str(self.device)!r})"

    @property
    def triangle_count(self) -> int:
        """Triangles of all meshes."""
        return self.device_mesh.faces.shape[0]

    @property
    def parts(self) -> tuple[Scene, ...]:
        """The scenes of one level that this one is made of: itself, or those of the meshes that instances share."""
        return (self,)

    @property
    def width(self) -> int:
        """Triangles tested at once."""
        return self.tree.width

    @property
    def depth(self) -> int:
        """Most inner nodes on a path of a BVH."""
        return self.tree.depth

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the box of all triangles."""
        return np.array([self.tree.low, self.tree.high], dtype=np.float64) + self.center

    @cached_property
    def is_closed(self) -> bool:
        """Whether every mesh is closed."""
        return all(mesh.is_closed for mesh in self.meshes)

    @property
    def exact_vertices(self) -> wp.array:
        """(V,) vec3d on the device: the vertices of all meshes as they were given, for answers in float64; made once."""
        made_for, array = self.__dict__.get("_exact", (None, None))
        if made_for is not self.meshes:
            vertices = np.concatenate([mesh.vertices for mesh in self.meshes])
            array = wp.array(vertices.astype(np.float64), dtype=wp.vec3d, device=self.device)
            self._exact = self.meshes, array
        return array

    @property
    def record_bytes(self) -> int:
        """Memory of the triangle records made so far: queries make those that their triangle test needs."""
        parts = (self._blocks,) if self.wide is None else (self._blocks, self.wide.records)
        return sum(blocks.records.capacity for known in parts for _, blocks in known.values())

    def flattened(self) -> TriangleMesh:
        """All meshes as one, triangles in the order in which the scene numbers them."""
        return TriangleMesh.concatenate(self.meshes)

    def statistics(self) -> SceneStatistics:
        """Counts, histograms, costs and times of the mesh, the tree and its build."""
        from wrt.scene.scene_statistics import scene_statistics

        return scene_statistics(self)

    def handle(self) -> Any:
        """The scene for kernels of your own: what the functions of `wrt.device` take.

        A struct that refers to the scene's arrays and keeps them alive; made in some 0.1 ms.
        """
        from wrt.device import handle_of

        return handle_of(self)

    def triangles(self, plan: Plan, rays: RayBatch | None) -> TriangleBlocks:
        """The triangles in the order of the tree's leaves ("none": of their ids), as the plan's triangle test stores them.

        Made once; records that depend on the rays' shared origin are made again when it has changed. Others need no rays. Those
        of a tree that has grown are made for what is new.
        """
        from wrt.execution.triangle_records import records_of

        return records_of(self, plan, rays)


def _as_test(name: str) -> str:
    if name == AUTO:
        return name
    from wrt.kernels.triangle import TRIANGLE_TESTS

    return lookup(TRIANGLE_TESTS, name, "triangle_test").name
