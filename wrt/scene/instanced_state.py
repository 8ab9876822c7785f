"""States of scenes of instances: a tree for each mesh, and a tree over the boxes of the instances.

**What is held.** Each mesh, whatever the number of its instances, has a state of its own, with tree and triangle records
relative to its own centre. An instance takes 184 bytes for its maps and some 100 of the upper tree, which is a wide BVH over
the boxes of the instances. Moving instances builds the upper tree again, nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.execution.triangle_records import records_of
from wrt.kernels.layout.instance_maps import Geometry, Placement
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import kept, use_threads
from wrt.memory import keep_alive
from wrt.meshes.instance import Instance, as_instances, check_extent
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import check_index, find_center
from wrt.scene.instance_boxes import InstanceBoxes, build_upper, cover
from wrt.scene.mesh_state import MeshState, build_state
from wrt.state.query_cache import QueryCache
from wrt.state.scene_state import SceneState, Settings, new_mark

if TYPE_CHECKING:
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.traversal.two_level.instance_single import InstanceTree
    from wrt.planning.plan import Plan
    from wrt.scene.updates import UpdatePolicy, UpdateReport

MAX_TRIANGLES = (1 << 31) - 1
"""Largest number of triangles of all instances together: each has its own number of 32 bits."""


@dataclass(frozen=True, eq=False, kw_only=True)
class InstancedState(SceneState):
    """The state of a scene of two levels.

    Attributes:
        geometry_ids: the mesh of each instance.
        mesh_states: the state of each mesh, in its own space.
        covers: for each mesh, points in whose convex hull its triangles are (`wrt.scene.instance_boxes.cover`).
        stretch: by what the slack of boxes grows for the worst of the maps.
        last_update: of the tree of the mesh whose vertices the last update moved; None if it moved none.
    """

    refused: ClassVar[dict[str, str]] = {
        "statistics": "a scene of instances has many trees; call wrt.Scene(scene.meshes[0]).statistics() for one mesh",
        "float64 vertices": "a scene of instances has no vertices in float64, which precise=True and gradients need; "
        "use wrt.Scene(scene.flattened())",
        "handle": "kernels need the handle of a single tree, not of instances; use wrt.Scene(scene.flattened()).handle()",
        "save": "a scene of instances cannot be saved; save one for each of its meshes, or pickle it",
    }

    geometry_ids: tuple[int, ...] = ()
    mesh_states: tuple[MeshState, ...] = ()
    covers: tuple[np.ndarray, ...] = ()
    stretch: float = 1.0
    last_update: UpdateReport | None = None

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all instances together."""
        return int(sum(self.mesh_states[number].triangle_count for number in self.geometry_ids))

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
        from wrt.kernels.traversal.two_level.instance_single import InstanceTree

        top = InstanceTree()
        top.tree, top.order = self.tree.struct(), self.tree.primitive
        top.placements, top.stretch = self.device_mesh.placements, self.stretch
        return top

    def lower(self, plan: Plan, rays: RayBatch) -> wp.array:
        """The trees of the meshes and their records for the plan's triangle test, as traversals of `rays` read them; cached."""
        from wrt.kernels.traversal.two_level.instance_single import PARTS

        key, tables = (plan.accelerator, plan.triangle_test), self.cache.tables
        if key not in tables:
            kind, table, used = PARTS[plan.accelerator], [], []
            for mesh in self.mesh_states:
                part, blocks = kind(), records_of(mesh, plan, rays)
                part.tree, part.triangles = mesh.tree.struct(), blocks
                table.append(part)
                used.append((mesh.tree, blocks))
            with kept(self.device):
                tables[key] = keep_alive(wp.array(table, dtype=kind, device=self.device), used)
        return tables[key]

    def updated(self, index: Any, vertices: Any, transform: Any, mask: int | None, policy: UpdatePolicy) -> InstancedState:
        """The state after instances, or the vertices of a mesh, have moved; as `wrt.Scene.update`."""
        if vertices is None and transform is None and mask is None:
            raise TypeError("there is nothing to update; pass vertices, transform or mask")
        chosen = [check_index(one, len(self.instances), "instance") for one in np.atleast_1d(np.asarray(index)).tolist()]
        if not chosen:
            raise ValueError("index is empty; pass the index of an instance, or several")
        instances = self._replaced(chosen, transform, mask)
        states, covers, report = self.mesh_states, self.covers, None
        with use_threads(self.num_threads):
            if vertices is not None:
                number = self.geometry_ids[chosen[0]]
                if any(self.geometry_ids[one] != number for one in chosen):
                    raise ValueError(
                        "index names instances of several meshes; pass vertices for the instances of one mesh at a time"
                    )
                part = states[number].updated(0, vertices, None, None, policy)
                part.complete()
                report = part.last_update
                states = (*states[:number], part, *states[number + 1 :])
                covers = (*covers[:number], cover(part), *covers[number + 1 :])
                instances = tuple(
                    Instance(part.meshes[0], one.transform, mask=one.mask) if own == number else one
                    for one, own in zip(instances, self.geometry_ids, strict=True)
                )
            check_extent(instances, self.geometry_ids, [part.meshes[0] for part in states])
            placed = place_instances(instances, self.geometry_ids, states, covers, self.settings, self.mark)
        return replace(placed, last_update=report)

    def _replaced(self, chosen: list[int], transform: Any, mask: int | None) -> tuple[Instance, ...]:
        """All instances, the chosen ones with the new transform or mask."""
        instances = list(self.instances)
        matrices = np.asarray(transform)
        if transform is not None and matrices.ndim == 3 and len(matrices) != len(chosen):
            raise ValueError(
                f"transform holds {len(matrices)} matrices for {len(chosen)} instances; pass one each, or one for all"
            )
        for place, number in enumerate(chosen):
            old = instances[number]
            matrix = old.transform if transform is None else matrices[place] if matrices.ndim == 3 else matrices
            instances[number] = Instance(old.mesh, matrix, mask=old.mask if mask is None else mask)
        return tuple(instances)


def build_instanced_state(geometry: Any, settings: Settings, cache: Any) -> InstancedState:
    """The state of a scene of instances; arguments and errors as of `wrt.Scene` and `wrt.InstancedScene`."""
    if isinstance(settings.accelerator, RayAwareBvh):
        raise ValueError("influence areas need a scene of one level; use wrt.Scene(scene.flattened(), accelerator)")
    instances = as_instances(geometry)
    shared: dict[int, int] = {}
    geometry_ids = tuple(shared.setdefault(id(instance.mesh), len(shared)) for instance in instances)
    given = {id(instance.mesh): instance.mesh for instance in instances}
    meshes = [mesh if isinstance(mesh, TriangleMesh) else TriangleMesh.from_trimesh(mesh) for mesh in given.values()]
    for number, mesh in enumerate(meshes):
        try:
            find_center((mesh,))
        except ValueError as error:
            raise ValueError(f"mesh {number} of the instances: {error}") from None
    check_extent(instances, geometry_ids, meshes)
    states = tuple(build_state((mesh,), settings, cache) for mesh in meshes)
    for state in states:
        state.complete()  # trees of the lower level cannot grow during a query
    return place_instances(instances, geometry_ids, states, tuple(map(cover, states)), settings, new_mark())


def place_instances(
    instances: tuple[Instance, ...],
    geometry_ids: tuple[int, ...],
    states: tuple[MeshState, ...],
    covers: tuple[np.ndarray, ...],
    settings: Settings,
    mark: str,
) -> InstancedState:
    """The state of instances of meshes: builds the upper level.

    Raises:
        ValueError: more than `MAX_TRIANGLES` triangles.
    """
    counts = [states[number].triangle_count for number in geometry_ids]
    first = np.cumsum([0, *counts])
    if first[-1] > MAX_TRIANGLES:
        raise ValueError(
            f"the instances have {int(first[-1]):,} triangles together, and a scene can number "
            f"{MAX_TRIANGLES:,}; make several scenes"
        )
    device = settings.device
    boxes = InstanceBoxes.of(instances, geometry_ids, [state.center for state in states], covers)
    center = (boxes.low.min(axis=0) + boxes.high.max(axis=0)) / 2
    tree = build_upper(boxes, center, max(states[0].width, 2)).to(device)
    mesh = SceneMesh()
    mesh.center = wp.vec3d(*map(float, center))
    mesh.low, mesh.high = wp.vec3(*tree.low), wp.vec3(*tree.high)
    mesh.geometry_first = wp.array(first, dtype=int, device=device)
    table = boxes.table(center, geometry_ids, first[:-1], [instance.mask for instance in instances])
    mesh.placements = wp.array(table, dtype=Placement, device=device)
    mesh.geometries = geometry_table(states, device)
    return InstancedState(
        settings=settings,
        meshes=tuple(state.meshes[0] for state in states),
        center=center,
        built_tree=tree,
        device_mesh=mesh,
        instances=instances,
        mark=mark,
        geometry_ids=geometry_ids,
        mesh_states=states,
        covers=covers,
        stretch=boxes.stretch,
        cache=QueryCache(),
    )


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
