"""The state of a scene: all that a query reads, and nothing that changes.

A query takes the state once, at its beginning, and reads nothing else of the scene. An update makes a new state and replaces
the scene's in one assignment, so that a query under way in another thread sees one of the two, and never a mixture.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.engine.facts.facts import SceneFacts
from wrt.engine.facts.hit_filter import HitFilter, alpha_masks, has_masks, shown_triangles
from wrt.engine.facts.query_cache import QueryCache
from wrt.engine.facts.query_kinds import few_rays
from wrt.engine.facts.scene_settings import Settings
from wrt.kernels.runtime.launch import get_num_threads, use_threads
from wrt.meshes.mesh import TriangleMesh

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Accelerator
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree
    from wrt.builders.tree import Bvh
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.query.hit_attributes import SceneMesh
    from wrt.meshes.instance import Instance
    from wrt.meshes.node_graph import NodeGraph


def new_mark() -> str:
    """A name by which hits know their scene; updates, copies and pickles of the scene keep it."""
    return os.urandom(16).hex()


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneState:
    """Triangle meshes with one tree, at rest.

    Attributes:
        settings: what the caller chose.
        meshes: the meshes, in the order of their geometry ids.
        center: (3,) float64; geometry is held in float32 relative to this point.
        built_tree: a `wrt.builders.tree`; if it is built lazily, its initial part (`tree` is the part that exists so far).
        device_mesh: all triangles on the device, for kernels.
        lazy_tree: the tree that is built while rays are traced; None if it is complete.
        area_trees: the trees of influence areas; None if there are none (`wrt.engine.launch.area_trees`).
        instances: what a scene of two levels is made of, a `wrt.instances.instance_list.InstanceList`; () in others.
        only_single: whether rays go one by one, whatever traversal "auto" would choose.
        hit_filter: what rays pass through; None for nothing.
        mark: by which hits know their scene.
        cache: what queries learn about this state.
    """

    refused: ClassVar[Mapping[str, str]] = {}
    """What scenes of this kind cannot do, each with a message that says what to do instead."""

    is_plain: ClassVar[bool] = False
    """Whether rays meet the triangles of the meshes in one tree, and nothing else."""

    tangents: ClassVar[Any] = None
    """Makes the triangles in which hits are, if what rays meet are no triangles of `device_mesh`: (hits) -> (mesh, the triangle
    of each hit, -1 for a miss, and its weights)."""

    settings: Settings
    meshes: tuple[TriangleMesh, ...]
    center: np.ndarray
    built_tree: Any
    device_mesh: SceneMesh
    lazy_tree: LazyKdTree | None = None
    area_trees: Any = None
    instances: Any = ()
    only_single: bool = False
    hit_filter: HitFilter | None = None
    mark: str = field(default_factory=new_mark)
    cache: QueryCache = field(default_factory=QueryCache)

    def changed(self, **values: Any) -> Any:
        """The state with other values of some fields: as `dataclasses.replace`, without its checks, for updates of moving
        instances."""
        made = object.__new__(type(self))
        made.__dict__.update(
            {name: self.__dict__[name] for name in self.__dataclass_fields__ if name in self.__dict__}, **values
        )
        return made

    if TYPE_CHECKING:  # of some kinds of scenes, whose callers know which they have

        @property
        def last_update(self) -> Any: ...
        @property
        def boxes(self) -> Any: ...
        @property
        def graph(self) -> NodeGraph | None: ...
        @property
        def geometry_ids(self) -> tuple[int, ...]: ...
        def updated(self, *change: Any) -> SceneState: ...
        def upper(self) -> Any: ...
        def lower(self, plan: Any, rays: RayBatch | None) -> wp.array: ...
        def chosen(self, index: Any) -> np.ndarray: ...
        def with_instances(self, instances: tuple[Instance, ...], graph: NodeGraph | None) -> SceneState: ...
        def with_nodes(self, nodes: Mapping[str, Any]) -> SceneState: ...

    @cached_property
    def accelerator(self) -> Accelerator:
        """The description of the tree."""
        return self.settings.accelerator

    @cached_property
    def triangle_test(self) -> str:
        """The triangle test of queries that name no other, or "auto"."""
        return self.settings.triangle_test

    @cached_property
    def device(self) -> wp.Device:
        """Where the scene lives."""
        return self.settings.device

    @cached_property
    def is_cpu(self) -> bool:
        """Whether the scene lives on a CPU."""
        return self.device.is_cpu

    @cached_property
    def num_threads(self) -> int | None:
        """Threads on the CPU; None for `wrt.get_num_threads()`."""
        return self.settings.num_threads

    @property
    def tree(self) -> Any:
        """The tree; if it is built lazily, the part that exists so far."""
        return self.built_tree if self.lazy_tree is None else self.lazy_tree.current.tree

    @property
    def geometry(self) -> Any:
        """What the scene was made of."""
        return self.instances or self.meshes

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all meshes."""
        return self.device_mesh.faces.shape[0]

    @property
    def slots(self) -> int:
        """Lanes of all blocks of the tree's leaves, in use or not."""
        return len(self.tree.primitive)

    @property
    def parts(self) -> tuple[SceneState, ...]:
        """The states of one level that this one is made of."""
        return (self,)

    @property
    def width(self) -> int:
        """Number of triangles tested at once."""
        return self.tree.width

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path from the root of a BVH to a leaf."""
        return self.tree.depth

    @property
    def shares_leaves(self) -> bool:
        """Whether a triangle may be in several leaves of the BVH."""
        return getattr(self.built_tree, "shared", False)

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the bounding box of all triangles."""
        return np.array([self.tree.low, self.tree.high], dtype=np.float64) + self.center

    @cached_property
    def facts(self) -> SceneFacts:
        """What plans depend on."""
        return SceneFacts(
            tree=self.accelerator.kind,
            width=self.width,
            triangles=self.triangle_count,
            instances=len(self.instances),
            is_cuda=self.device.is_cuda,
            own_spaces=self.only_single,
            is_lazy=self.lazy_tree is not None,
            shares_leaves=self.shares_leaves,
            by_area=self.area_trees is not None,
            triangle_test=self.triangle_test,
            few_rays=self.few_rays,
            has_masks=self.alpha_masks is not None,
        )

    @cached_property
    def changes_plans(self) -> bool:
        """Whether the plan of many rays depends on what came before: on how much of a tree is built, or on whether a wide form
        pays."""
        return self.facts.is_lazy or (self.is_cpu and self.facts.can_be_wide)

    @cached_property
    def shares_few_rays(self) -> bool:
        """Whether few rays are answered as in all other scenes of the kind: then they share plans and prepared queries."""
        alone = self.is_plain and self.accelerator.kind == "bvh" and self.lazy_tree is None and self.area_trees is None
        plain = not (self.only_single or self.shares_leaves) and self.alpha_masks is None
        return alone and plain and self.device.is_cpu

    @cached_property
    def few_rays(self) -> int:
        """Number of rays up to which each is traced on its own on the CPU, with as many threads as at the first query."""
        in_bvh = self.accelerator.kind == "bvh" and self.area_trees is None and not self.only_single
        return few_rays(self.triangle_count, in_bvh and not self.instances, get_num_threads())

    @cached_property
    def is_closed(self) -> bool:
        """Whether every mesh is closed."""
        return all(mesh.is_closed for mesh in self.meshes)

    @property
    def leaves_out(self) -> bool:
        """Whether rays pass through some of the triangles as a whole."""
        return self.hit_filter is not None and self.hit_filter.ignored is not None

    @cached_property
    def shown(self) -> tuple[wp.array, wp.array]:
        """Vertices and faces on the device as rays meet them: corners of triangles that are left out are NaN."""
        mesh = self.device_mesh
        if not self.leaves_out:
            return mesh.vertices, mesh.faces
        return shown_triangles(mesh, self.hit_filter.ignored)  # type: ignore[union-attr, arg-type]

    @cached_property
    def alpha_masks(self) -> Any:
        """The alpha masks that hits are decided by, as kernels read them; None for none."""
        if self.hit_filter is None or not self.hit_filter.alpha or not has_masks(self.meshes):
            return None
        return alpha_masks(self.hit_filter, self.meshes, getattr(self, "geometry_ids", ()), self.device_mesh.geometry_first)

    @cached_property
    def exact_vertices(self) -> wp.array:
        """(V,) vec3d on the device: the vertices of all meshes as they were given, for answers in float64.

        Raises:
            ValueError: the scene is of a kind that has none.
        """
        self.require("float64 vertices")
        vertices = np.concatenate([mesh.vertices for mesh in self.meshes])
        return wp.array(vertices.astype(np.float64), dtype=wp.vec3d, device=self.device)

    @property
    def record_bytes(self) -> int:
        """Bytes of the triangle records made so far, and of the tree in another layout (`QueryCache.binary`). Queries make what
        their triangle test and their traversal need."""
        wide = self.cache.wide
        known = [self.cache.records, *([] if wide is None else [wide.records])]
        nodes, triangles = self.cache.binary or (None, None)
        binary = 0 if nodes is None else nodes.nodes.capacity + triangles.corners.capacity
        return binary + sum(blocks.records.capacity for records in known for _, blocks in records.values())

    @property
    def bytes(self) -> int:
        """Memory of the tree and the triangles, and of the triangle records made so far."""
        mesh = self.device_mesh
        return self.tree.bytes + mesh.vertices.capacity + mesh.faces.capacity + self.record_bytes

    def contents(self) -> str:
        """What is in the scene, in words."""
        return f"{self.triangle_count} triangles"

    def require(self, feature: str) -> None:
        """Refuses a feature that scenes of this kind do not have.

        Raises:
            ValueError: it is one of `refused`; the message says what to do instead.
        """
        if feature in self.refused:
            raise ValueError(self.refused[feature])

    def require_whole(self, call: str) -> None:
        """Refuses a call that is about the whole surface.

        Raises:
            ValueError: rays pass through parts of it (`wrt.Scene.filtered`).
        """
        if self.hit_filter is not None:
            raise ValueError(f"{call} needs all triangles, and rays of this scene pass through some; use scene.filtered()")

    def require_opaque(self, call: str) -> None:
        """Refuses a call that does not decide hits one by one.

        Raises:
            ValueError: alpha masks count in this scene (`wrt.Scene.filtered`).
        """
        if self.alpha_masks is not None:
            raise ValueError(f"{call} does not look at alpha masks, which count in this scene; leave out alpha=True")

    def require_instances(self, call: str) -> None:
        """Refuses a call that needs instances.

        Raises:
            ValueError: there are none.
        """
        if not self.instances:
            raise ValueError(f"{call} needs instances, and this scene has none; make it from wrt.Instance(mesh)")

    def complete(self) -> None:
        """Builds the missing part of a lazily built tree, for code that cannot extend the tree while it walks it."""
        if self.lazy_tree is not None:
            with use_threads(self.num_threads):
                self.lazy_tree.finish()

    def distinct(self) -> SceneState:
        """The state without surfaces that repeat another exactly (`wrt.meshes.repeated_surfaces`), for queries that count
        surfaces; this one, if there are none. Found by the first call."""
        self.require_whole("an inside test")
        with self.cache.lock:
            if self.cache.distinct is None:
                other = self.find_distinct()
                self.cache.distinct = () if other is self else (other,)
            return self.cache.distinct[0].with_threads(self.num_threads) if self.cache.distinct else self

    def find_distinct(self) -> SceneState:
        """What `distinct` finds. Surfaces that nobody can repeat are distinct."""
        return self

    def over(self, tree: Bvh) -> SceneState:
        """A copy of the scene whose tree, on the same device, holds some of its triangles; it has no influence areas."""
        return replace(self, built_tree=tree, lazy_tree=None, area_trees=None, cache=QueryCache())

    def with_threads(self, num_threads: int | None) -> SceneState:
        """The same state for another number of threads."""
        return replace(self, settings=replace(self.settings, num_threads=num_threads))

    def flattened(self) -> TriangleMesh:
        """All meshes as one, with triangles in the order in which the scene numbers them."""
        return TriangleMesh.concatenate(self.meshes)
