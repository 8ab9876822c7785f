"""States of scenes of instances: a tree for each mesh, and a tree over the boxes of the instances.

**What is held.** Each mesh, whatever the number of its instances, has a state of its own, with tree and triangle records
relative to its own centre. An instance takes 184 bytes for its maps, some 300 of the host's, and some 100 of the upper level:
wide BVHs over the boxes of the instances (`wrt.builders.bvh.instance_forest`).

**Updates.** Moving instances gives their boxes to the nodes above them. Where trees of instances have several nodes, their
cost is measured whenever half of those instances have moved, and they are built again if it has grown. Adding and removing
instances builds the upper level again, which takes microseconds an instance; trees of meshes stay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.engine.facts.query_cache import QueryCache
from wrt.engine.facts.scene_state import SceneState, Settings, new_mark
from wrt.instances.device_moves import DeviceMoves, MovedInstances, fetched, move_on_device, transforms_on
from wrt.instances.few_moves import MAX_AT_ONCE, move_few
from wrt.instances.instance_boxes import Covers, InstanceBoxes, UpperTree, build_upper, cover, on_device, write_maps
from wrt.instances.instance_list import InstanceList
from wrt.instances.instance_tables import first_triangles, geometry_table, part_table, upper_struct
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.argument_packing import copied
from wrt.kernels.runtime.launch import kept, refuse_capture, use_threads
from wrt.meshes.instance import Instance, as_instances, check_environment, check_extent, check_mask, check_transforms
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.node_graph import NodeGraph
from wrt.meshes.placement import check_indices, find_center
from wrt.meshes.repeated_surfaces import distinct_instances
from wrt.scene.mesh_state import MeshState, build_state

if TYPE_CHECKING:
    from wrt.engine.plan.plan import Plan
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.traversal.two_level.instance_single import InstanceTree
    from wrt.scene.updates import UpdatePolicy, UpdateReport


@dataclass(frozen=True, eq=False, kw_only=True)
class InstancedState(SceneState):
    """The state of a scene of two levels.

    Attributes:
        geometry_ids: the mesh of each instance.
        numbers: (N,) int32, the same.
        mesh_states: the state of each mesh, in its own space.
        covers: for the meshes, points in whose convex hull their triangles are.
        boxes: the maps of the instances, and their boxes.
        table: (N,) `Placement` on the host.
        given: the mesh of each of `mesh_states` as the caller gave it.
        moved: instances that moved since the upper level was built or its cost measured, of those in trees of several nodes.
        last_update: of the tree of the mesh whose vertices the last update moved; None if it moved none.
        graph: the nodes on which instances hang; None if the scene was made without a graph.
        device_moves: the arrays of instances that moved on the device; then `table` is None.
        triangles: of all instances together.
    """

    refused: ClassVar[dict[str, str]] = {
        "statistics": "a scene of instances has many trees; call wrt.Scene(scene.meshes[0]).statistics() for one mesh",
    }

    geometry_ids: tuple[int, ...] = ()
    numbers: np.ndarray | None = None
    mesh_states: tuple[MeshState, ...] = ()
    covers: Covers | None = None
    boxes: InstanceBoxes | None = None
    table: np.ndarray | None = None
    given: tuple[Any, ...] = ()
    moved: int = 0
    last_update: UpdateReport | None = None
    graph: NodeGraph | None = None
    device_moves: DeviceMoves | None = None
    triangles: int = 0

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all instances together."""
        return self.triangles

    @property
    def parts(self) -> tuple[MeshState, ...]:
        """A state for each of `meshes`, in its own space."""
        return self.mesh_states

    @property
    def width(self) -> int:
        """Number of triangles tested at once."""
        return self.mesh_states[0].width

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path from the root of a mesh's BVH to a leaf."""
        return max(part.depth for part in self.mesh_states)

    @property
    def record_bytes(self) -> int:
        """Bytes of the triangle records made so far, counting each mesh once."""
        return sum(part.record_bytes for part in self.mesh_states)

    @property
    def bytes(self) -> int:
        """Memory of all trees, triangles and maps, and of the records made so far."""
        return sum(part.bytes for part in self.mesh_states) + self.tree.bytes + self.device_mesh.placements.capacity

    @property
    def exact_vertices(self) -> wp.array:
        """(V,) vec3d on the device: the vertices of all meshes, each once, in its own space; made once for these meshes."""
        key, tables = ("vertices", ""), self.cache.tables
        if key not in tables:
            vertices = np.concatenate([mesh.vertices for mesh in self.meshes]).astype(np.float64)
            with kept(self.device):
                tables[key] = wp.array(vertices, dtype=wp.vec3d, device=self.device)
        return tables[key]

    def contents(self) -> str:
        """What is in the scene, in words."""
        return f"{len(self.instances)} instances of {len(self.meshes)} meshes"

    def flattened(self) -> TriangleMesh:
        """All instances as one mesh in float64, triangles in the order of instances. Takes memory for every instance."""
        meshes = [self.meshes[number] for number in self.geometry_ids]
        wide = (TriangleMesh(mesh.vertices.astype(np.float64), mesh.faces, up=mesh.up) for mesh in meshes)
        moved = [mesh.transformed(instance.transform) for mesh, instance in zip(wide, self.instances, strict=True)]
        return TriangleMesh.concatenate(moved)

    def upper(self) -> InstanceTree:
        """The upper level, as traversals read it."""
        return upper_struct(self.tree, self.device_mesh, self.boxes.slack_scale)

    def lower(self, plan: Plan, rays: RayBatch) -> wp.array:
        """The trees of the meshes and their records for the plan's triangle test, as traversals of `rays` read them; cached."""
        key, tables = (plan.accelerator, plan.triangle_test), self.cache.tables
        if key not in tables:
            tables[key] = part_table(self.mesh_states, plan, rays, self.device)
        return tables[key]

    def find_distinct(self) -> InstancedState:
        """The state without repeated triangles of its meshes and without repeated instances; this one, if there are none."""
        parts = [part.distinct() for part in self.mesh_states]
        instances = distinct_instances(self.instances, self.geometry_ids, [part.meshes[0] for part in parts])
        if len(instances) == len(self.instances) and all(one is own for one, own in zip(parts, self.mesh_states, strict=True)):
            return self
        known: dict[int, Any] = {id(part.meshes[0]): (part, cover) for part, cover in zip(parts, self.covers.each, strict=True)}
        with use_threads(self.num_threads):
            return place_members(tuple(instances), self.settings, None, self.mark, known)

    def updated(
        self,
        index: Any,
        vertices: Any,
        transform: Any,
        mask: int | None,
        policy: UpdatePolicy | None,
        environment: int | None = None,
    ) -> InstancedState:
        """The state after instances, or the vertices of a mesh, have moved; as `wrt.Scene.update`."""
        if isinstance(index, Mapping):
            raise ValueError(
                "index is a mapping, which is for scenes of meshes; with instances, update the vertices of one mesh at a time: "
                "update(index, vertices=points)"
            )
        if vertices is None and transform is None and mask is None and environment is None:
            raise TypeError("there is nothing to update; pass vertices, transform, mask or environment")
        chosen = None if is_all(index, len(self.instances)) else self.chosen(index)
        chosen = None if chosen is not None and is_all(chosen, len(self.instances)) else chosen
        mask = None if mask is None else check_mask(mask)
        environment = None if environment is None else self._other_environment(chosen, environment)
        if vertices is None and transform is not None and environment is None:
            moved = self._moved_on_device(chosen, transform, mask)
            if moved is not None:
                return moved
        refuse_capture("such an update", self.device)
        if self.device_moves is not None:
            return self.on_host().updated(index, vertices, transform, mask, policy, environment)
        count = len(self.instances) if chosen is None else len(chosen)
        matrices = None if transform is None else check_transforms(transform, count)
        instances = self.instances.moved(chosen, matrices, mask, environment)
        with use_threads(self.num_threads):
            if vertices is not None:
                return self._bent(instances, range(count) if chosen is None else chosen.tolist(), vertices, policy)
            if environment is not None:
                return self.with_instances(instances[:], self.graph)
            return self._moved(instances, chosen if chosen is None or count == 1 else np.unique(chosen))

    def _other_environment(self, rows: np.ndarray | None, environment: Any) -> int | None:
        """The environment that instances get; None if all of them are in it already. rows: as in `_moved_on_device`."""
        number, own = check_environment(environment), self.instances.environments
        return None if ((own if rows is None else own[rows]) == number).all() else number

    def _moved_on_device(self, rows: np.ndarray | None, transform: Any, mask: int | None) -> InstancedState | None:
        """The state after instances have moved by transforms on its device; None if they go through the host.

        rows: (M,) the instances; None for all. mask: theirs; None for those they have.
        """
        count, device = len(self.instances) if rows is None else len(rows), self.device
        given = None if device.is_cpu and count <= MAX_AT_ONCE else transforms_on(device, transform, count)
        if given is None:
            return None
        is_known = rows is None or (self.device_moves is not None and self.device_moves.has_chosen(rows))
        if not is_known and len(np.unique(rows)) < count:
            return None
        forest = self.tree.forest
        moved = self.moved + (forest.layered_count if rows is None else int(np.count_nonzero(forest.layered[rows])))
        is_due = 2 * moved > forest.layered_count and not device.is_capturing
        with use_threads(self.num_threads):
            started = move_on_device(self, rows, given, is_due, mask)
            instances, mesh = MovedInstances(self.instances, started.moves, rows, mask), copied(self.device_mesh)
            mesh.placements = started.table
            state = successor(self, instances, None, started.tree, 0 if is_due else moved, mesh, started.moves)
            boxes = started.finish()  # the device was at work until here
            if boxes is None or not (device.is_capturing or boxes.are_resolved):
                return None
            settle(state, boxes)
            if is_due and state.tree.is_degraded:
                state = state.on_host()
                return place(state, state.instances, state.boxes, state.table, None, 0)
        return state

    def on_host(self) -> InstancedState:
        """This state with all that the host needs of it, if its instances moved on the device."""
        return self if self.device_moves is None else replace(self, **fetched(self))

    def chosen(self, index: Any) -> np.ndarray:
        """(M,) numbers of the instances that a caller means: an index, or several; errors as in `wrt.Scene.update`."""
        return check_indices(index, len(self.instances), "instance")

    def _bent(
        self, instances: InstanceList, chosen: Sequence[int], vertices: Any, policy: UpdatePolicy | None
    ) -> InstancedState:
        """The state after the vertices of a mesh have moved."""
        states, number = self.mesh_states, self.geometry_ids[chosen[0]]
        if any(self.geometry_ids[one] != number for one in chosen):
            raise ValueError("index names instances of several meshes; pass vertices for the instances of one mesh at a time")
        part: Any = states[number].updated(0, vertices, None, None, policy)
        part.complete()
        states = (*states[:number], part, *states[number + 1 :])
        covers = (*self.covers.each[:number], cover(part), *self.covers.each[number + 1 :])
        bent = tuple(
            Instance(part.meshes[0], one.transform, mask=one.mask, environment=one.environment) if own == number else one
            for one, own in zip(instances, self.geometry_ids, strict=True)
        )
        instances = InstanceList(bent)
        check_extent(*instances.some(None), self.geometry_ids, [part.meshes[0] for part in states])
        placed = place_instances(instances, self.geometry_ids, states, covers, self.settings, self.mark)
        placed = replace(placed, graph=self.graph, hit_filter=self.hit_filter)
        given = (*self.given[:number], part.meshes[0], *self.given[number + 1 :])
        return replace(placed, given=given, last_update=part.last_update)

    def _moved(self, instances: InstanceList, rows: np.ndarray | None) -> InstancedState:
        """The state after some instances have moved, or all: the nodes above them get new boxes."""
        forest = self.tree.forest
        moved = self.moved + (forest.layered_count if rows is None else int(np.count_nonzero(forest.layered[rows])))
        is_due = 2 * moved > forest.layered_count
        state = self._kept(instances, rows, 0 if is_due else moved)
        if is_due and state.tree.is_degraded:
            return place(self, instances, state.boxes, state.table, None, 0)
        return state

    def _kept(self, instances: InstanceList, rows: np.ndarray | None, moved: int) -> InstancedState:
        """The state after some instances have moved, or all, with the nodes of this one."""
        transforms, masks = instances.some(rows)
        if len(transforms) <= MAX_AT_ONCE:
            few = np.arange(len(instances)) if rows is None else rows
            found = move_few(self, few, transforms, masks)
            if found is not None:
                return assemble(self, instances, *found, moved)
        numbers = self.numbers if rows is None else self.numbers[rows]
        boxes, inverses = InstanceBoxes.of(transforms, numbers, self.covers)
        boxes = boxes if rows is None else self.boxes.with_rows(rows, boxes)
        if not boxes.are_resolved:
            check_extent(*instances.some(None), self.geometry_ids, [part.meshes[0] for part in self.mesh_states])
        table = self.table.copy()
        write_maps(table, slice(None) if rows is None else rows, transforms, inverses)
        table["mask"][slice(None) if rows is None else rows] = masks
        return place(self, instances, boxes, table, self.tree, moved, rows)

    def with_instances(self, instances: tuple[Instance, ...], graph: NodeGraph | None) -> InstancedState:
        """The state of other instances, on these nodes. Meshes that are here already keep their trees.

        Raises:
            ValueError: as `wrt.moving.InstancedScene`.
        """
        if self.device_moves is not None:
            return self.on_host().with_instances(instances, graph)
        known = {}
        for given, state, points in zip(self.given, self.mesh_states, self.covers.each, strict=True):
            known[id(given)] = known[id(state.meshes[0])] = state, points
        placed = place_members(instances, self.settings, None, self.mark, known)
        return replace(placed, graph=graph, hit_filter=self.hit_filter)

    def with_nodes(self, nodes: Mapping[str, Any]) -> InstancedState:
        """The state after nodes of the graph have moved, and with them what hangs on them; as `wrt.Scene.move`."""
        if self.graph is None:
            raise ValueError("the scene has no graph; make it from a trimesh.Scene, or move instances with update")
        graph, rows = self.graph.moved(nodes)
        if not len(rows):
            return replace(self, graph=graph)
        moved = self.updated(rows, None, graph.world[graph.node_of[rows]], None, None)
        return replace(moved, graph=graph)


def is_all(index: Any, count: int) -> bool:
    """Whether an index, a range or an array, names all instances in their order."""
    if isinstance(index, np.ndarray):
        return len(index) == count and bool((index == np.arange(count)).all())
    return type(index) is range and index == range(count)


def build_instanced_state(geometry: Any, settings: Settings, cache: Any) -> InstancedState:
    """The state of a scene of instances; arguments and errors as in `wrt.Scene` and `wrt.moving.InstancedScene`."""
    if isinstance(settings.accelerator, RayAwareBvh):
        raise ValueError("influence areas need a scene of one level; use wrt.Scene(scene.flattened(), accelerator)")
    if isinstance(settings.accelerator, ProjectedBvh) and settings.accelerator.spatial_splits > 0.0:
        raise ValueError("trees of instances cannot have spatial splits; leave spatial_splits out of the accelerator")
    graph = NodeGraph.of_geometry(geometry)
    return replace(place_members(as_instances(geometry), settings, cache, new_mark(), {}), graph=graph)


def place_members(
    instances: tuple[Instance, ...],
    settings: Settings,
    cache: Any,
    mark: str,
    known: Mapping[int, tuple[MeshState, np.ndarray]],
) -> InstancedState:
    """The state of instances. Builds the trees of meshes that are not known.

    Args:
        instances: the instances.
        settings, cache, mark: of the scene.
        known: state and cover of meshes that have trees already, by their id.
    """
    shared: dict[int, int] = {}
    geometry_ids = tuple(shared.setdefault(id(instance.mesh), len(shared)) for instance in instances)
    given = {id(instance.mesh): instance.mesh for instance in instances}
    meshes = []
    for number, (key, mesh) in enumerate(given.items()):
        if key in known:
            meshes.append(known[key][0].meshes[0])
            continue
        meshes.append(mesh if isinstance(mesh, TriangleMesh) else TriangleMesh.from_trimesh(mesh))
        try:
            find_center((meshes[-1],))
        except ValueError as error:
            raise ValueError(f"mesh {number} of the instances: {error}") from None
    listed = InstanceList(instances)
    check_extent(*listed.some(None), geometry_ids, meshes)
    states, covers = [], []
    for key, mesh in zip(given, meshes, strict=True):
        state, points = known.get(key) or (build_state((mesh,), settings, cache), None)
        state.complete()  # trees of the lower level cannot grow during a query
        states.append(state)
        covers.append(cover(state) if points is None else points)
    placed = place_instances(listed, geometry_ids, tuple(states), tuple(covers), settings, mark)
    return replace(placed, given=tuple(given.values()))


def place_instances(
    instances: InstanceList,
    geometry_ids: tuple[int, ...],
    states: tuple[MeshState, ...],
    covers: tuple[np.ndarray, ...],
    settings: Settings,
    mark: str,
) -> InstancedState:
    """The state of instances of meshes: builds the upper level; errors as in `first_triangles`."""
    first = first_triangles(states, geometry_ids)
    known, numbers = Covers.of(covers, states), np.array(geometry_ids, dtype=np.int32)
    boxes, inverses = InstanceBoxes.of(instances.transforms, numbers, known)
    table: Any = np.zeros(len(instances), dtype=Placement.numpy_dtype())  # type: ignore[attr-defined]
    write_maps(table, slice(None), instances.transforms, inverses)
    table["geometry"], table["first"], table["mask"] = numbers, first[:-1], instances.masks
    mesh = SceneMesh()
    mesh.geometry_first = wp.array(first, dtype=int, device=settings.device)
    mesh.geometries = geometry_table(states, settings.device)
    blank = InstancedState(
        settings=settings,
        meshes=tuple(state.meshes[0] for state in states),
        center=np.zeros(3),
        built_tree=None,
        device_mesh=mesh,
        instances=instances,
        mark=mark,
        geometry_ids=geometry_ids,
        numbers=numbers,
        mesh_states=states,
        covers=known,
        boxes=boxes,
        table=table,
        given=tuple(state.meshes[0] for state in states),
        triangles=int(first[-1]),
    )
    return place(blank, instances, boxes, table, None, 0)


def place(
    old: InstancedState,
    instances: InstanceList,
    boxes: InstanceBoxes,
    table: np.ndarray,
    tree: UpperTree | None,
    moved: int,
    rows: np.ndarray | None = None,
) -> InstancedState:
    """The state of instances whose meshes are those of another state.

    Args:
        old: the other state.
        instances, boxes: the instances, and where they are.
        table: their placements, without origins.
        tree: whose nodes are kept; None to build the upper level.
        moved: as in `InstancedState`.
        rows: instances that are elsewhere, if a tree is given; None for all.
    """
    center, device = np.array(boxes.frame[0]), old.settings.device
    if tree is not None and rows is not None and old.boxes.frame == boxes.frame:
        table["origin"][rows] = boxes.origin[rows] - center
        corners = tuple(values.copy() for values in tree.corners)
        corners[0][rows], corners[1][rows] = boxes.rounded(rows)
    else:
        table["origin"], rows, corners = boxes.origin - center, None, boxes.rounded()
    if tree is None:
        depth = max(getattr(state.tree, "depth", 0) for state in old.mesh_states)  # stacks for kd-trees have one size
        environments = instances.environments.astype(np.int32)
        tree = build_upper(corners, environments, max(old.mesh_states[0].width, 2), depth, device)  # type: ignore[arg-type]
    else:
        tree = tree.with_boxes(*corners, rows)  # type: ignore[call-arg]
    return assemble(old, instances, boxes, table, tree, moved)


def assemble(
    old: InstancedState,
    instances: InstanceList,
    boxes: InstanceBoxes,
    table: np.ndarray | None,
    tree: UpperTree,
    moved: int,
) -> InstancedState:
    """As `place`; the table has origins, and the tree is around the boxes."""
    return settle(successor(old, instances, table, tree, moved), boxes)


def settle(state: InstancedState, boxes: InstanceBoxes) -> InstancedState:
    """Gives a state that nobody has yet the boxes of its instances; returns it."""
    mesh, tree = state.device_mesh, state.tree
    mesh.center, mesh.low, mesh.high = wp.vec3d(*boxes.center), tree.low, tree.high
    state.__dict__.update(boxes=boxes, center=np.array(boxes.center))
    return state


def successor(
    old: InstancedState,
    instances: InstanceList,
    table: np.ndarray | None,
    tree: UpperTree,
    moved: int,
    mesh: SceneMesh | None = None,
    device_moves: DeviceMoves | None = None,
) -> InstancedState:
    """The state after a motion, but for `boxes` and the centre. Without a table, a mesh has the placements."""
    if mesh is None:
        mesh = SceneMesh()
        mesh.geometry_first, mesh.geometries = old.device_mesh.geometry_first, old.device_mesh.geometries
        mesh.placements = on_device(table, Placement, old.settings.device)
    if old.built_tree is not None and old.tree.forest is tree.forest:
        cache = old.cache.of_moved()
    else:
        cache = QueryCache()
        cache.tables.update(old.cache.tables)  # of the meshes alone
    return old.changed(
        built_tree=tree,
        device_mesh=mesh,
        instances=instances,
        table=table,
        moved=moved,
        cache=cache,
        last_update=None,
        device_moves=device_moves,
    )
