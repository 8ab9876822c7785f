"""Scenes of instances: a tree for each mesh, and a tree of the places where they stand.

**What is held.** Each mesh, whatever the number of its instances, is a `wrt.Scene` of its own, with tree and triangle records
relative to its own centre. An instance takes 184 bytes for its maps and some 100 of the upper tree, which is a wide BVH over
the boxes of the instances. Moving instances builds the upper tree again, nothing else.

**Boxes of instances.** The box of a rotated box is too large by up to a factor of three in volume, and every ray that meets it
in vain walks a tree's first nodes. So a mesh is covered by the boxes of its vertices in the cells of an 8 x 8 x 8 grid, once,
and the corners of those are what is mapped: some thousand points, whatever the number of triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.kernels.layout.instance_maps import Geometry, Placement
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import kept, use_threads
from wrt.memory import keep_alive
from wrt.meshes.instance import Instance, as_instances, check_spread
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import check_index, find_center
from wrt.scene.scene import Scene
from wrt.scene.updates import UpdatePolicy, as_policy

if TYPE_CHECKING:
    from wrt.builders.tree import Bvh
    from wrt.execution.plan import Plan
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.traversal.two_level.instance_single import InstanceTree
    from wrt.scene.scene_statistics import SceneStatistics

CELLS = 8
"""Cells an axis of the grid that covers a mesh."""

MAPPED_AT_ONCE = 64
"""Instances whose points are mapped at a time: some megabytes."""

MAX_TRIANGLES = (1 << 31) - 1
"""Triangles of all instances together: each has a number of its own."""


class InstancedScene(Scene):
    """A scene of two levels, which `wrt.Scene` makes of instances; the same queries, and more.

    Triangles that instances share are held once. Hits tell the instance (`Hits.instance_id`), the mesh (`Hits.geometry_id`,
    index in `meshes`) and the triangle of the mesh as it was given; `uv` weigh that triangle's second and third vertex; `t`,
    `position` and `normal` are the scene's, `normal` on the outer side of mirrored instances too. Ties go to the smaller t,
    then to the earlier instance, then to the smaller triangle.

    Many rays on the CPU go in packets or streams, sorted by instance, if trees are BVHs. Few rays, lists of all hits, and rays
    whose work is counted (`counters=True`) go one by one (`Hits.plan`). Ray masks go with these scenes; triangle tests with
    records for one origin (`komatsu`, `benthin`) do not. What may run at the same time is as for any `wrt.Scene`.

    Args: as in `wrt.Scene`.

    Attributes:
        instances: tuple of `wrt.Instance`, in the order given; those of a trimesh.Scene in the order of its graph.
        meshes: tuple of `TriangleMesh`, each once, in the order of their first instances.
        geometry_ids: tuple of int, the mesh of each instance.

    Raises:
        TypeError, ValueError: as `wrt.Scene` and `wrt.Instance`; more than 2^31 - 1 triangles of all instances together; an
            instance smaller than 1e-12 of its distance from the scene's centre, unless its mask is 0.
    """

    def _make(self, geometry: Any, cache: Any) -> None:
        if isinstance(self.accelerator, RayAwareBvh):
            raise ValueError("influence areas go with scenes of one level; use wrt.Scene(scene.flattened(), accelerator)")
        instances = as_instances(geometry)
        shared: dict[int, int] = {}
        self.geometry_ids = tuple(shared.setdefault(id(instance.mesh), len(shared)) for instance in instances)
        given = {id(instance.mesh): instance.mesh for instance in instances}
        meshes = [mesh if isinstance(mesh, TriangleMesh) else TriangleMesh.from_trimesh(mesh) for mesh in given.values()]
        for number, mesh in enumerate(meshes):
            try:
                find_center((mesh,))
            except ValueError as error:
                raise ValueError(f"mesh {number} of the instances: {error}") from None
        check_spread(instances, self.geometry_ids, meshes)
        parts = tuple(
            Scene(
                mesh,
                self.accelerator,
                triangle_test=self.triangle_test,
                device=self.device,
                num_threads=self.num_threads,
                cache=cache,
            )
            for mesh in meshes
        )
        for part in parts:
            part.complete()  # nothing asks for more of a tree on the lower level
        self._place(instances, parts, tuple(map(cover, parts)))

    def _place(self, instances: tuple[Instance, ...], parts: tuple[Scene, ...], covers: tuple[np.ndarray, ...]) -> None:
        """Builds the upper level, then takes over everything."""
        counts = [parts[number].triangle_count for number in self.geometry_ids]
        first = np.cumsum([0, *counts])
        if first[-1] > MAX_TRIANGLES:
            raise ValueError(
                f"the instances have {int(first[-1]):,} triangles together, and a scene can number "
                f"{MAX_TRIANGLES:,}; make several scenes"
            )
        places = Places.of(instances, self.geometry_ids, parts, covers)
        center = (places.low.min(axis=0) + places.high.max(axis=0)) / 2
        tree = build_upper(places, center, max(parts[0].width, 2)).to(self.device)
        mesh = SceneMesh()
        mesh.center = wp.vec3d(*map(float, center))
        mesh.low, mesh.high = wp.vec3(*tree.low), wp.vec3(*tree.high)
        mesh.geometry_first = wp.array(first, dtype=int, device=self.device)
        table = places.table(center, self.geometry_ids, first[:-1], [instance.mask for instance in instances])
        mesh.placements = wp.array(table, dtype=Placement, device=self.device)
        mesh.geometries = geometry_table(parts, self.device)
        self.instances, self._parts, self._covers = instances, parts, covers
        self._stretch = places.stretch
        self._tables: dict[tuple[str, str], wp.array] = {}
        self._take_over(tuple(part.meshes[0] for part in parts), center, tree, mesh)

    def __repr__(self) -> str:
        kinds = f"{len(self.instances)} instances of {len(self.meshes)} meshes"
        return f"InstancedScene({kinds}, {self.accelerator}, device={str(self.device)!r})"

    def update(
        self,
        index: int | Sequence[int],
        *,
        vertices: Any = None,
        transform: Any = None,
        mask: int | None = None,
        rebuild: str | UpdatePolicy = "auto",
    ) -> None:
        """Moves instances, or the vertices of a mesh.

            scene.update(3, transform=matrix)                   # one instance
            scene.update(range(100), transform=matrices)        # many at once: the upper tree is built once
            scene.update(3, vertices=points)                    # the mesh of instance 3, in all its instances

        Args:
            index: of the instance, or of several for `transform` and `mask`.
            vertices: (V, 3) in the mesh's own space, as many as it has; its tree is kept or built again (`wrt.Scene.update`).
            transform: (4, 4), or (N, 4, 4) for N instances, as `wrt.Instance` takes it.
            mask: of the instance, or of all those of the index.
            rebuild: for `vertices`, as in `wrt.Scene.update`; `last_update` is of the mesh's tree.

        Raises:
            TypeError: a value is of a wrong type, or none was given.
            ValueError: no such instance, or a value as `wrt.Instance` refuses it. The scene is then as before.
        """
        if vertices is None and transform is None and mask is None:
            raise TypeError("there is nothing to update; pass vertices, transform or mask")
        rebuild = as_policy(rebuild)
        chosen = [check_index(one, len(self.instances), "instance") for one in np.atleast_1d(np.asarray(index)).tolist()]
        if not chosen:
            raise ValueError("index is empty; pass the index of an instance, or several")
        instances = self._replaced(chosen, transform, mask)
        parts, covers = self._parts, self._covers
        with use_threads(self.num_threads):
            if vertices is not None:
                number = self.geometry_ids[chosen[0]]
                if any(self.geometry_ids[one] != number for one in chosen):
                    raise ValueError("index names instances of several meshes; pass vertices for one of them at a time")
                part = copy(self._parts[number])
                part.update(0, vertices=vertices, rebuild=rebuild)
                part.complete()
                parts = (*parts[:number], part, *parts[number + 1 :])
                covers = (*covers[:number], cover(part), *covers[number + 1 :])
                instances = tuple(
                    Instance(part.meshes[0], one.transform, mask=one.mask) if own == number else one
                    for one, own in zip(instances, self.geometry_ids, strict=True)
                )
            check_spread(instances, self.geometry_ids, [part.meshes[0] for part in parts])
            self._place(instances, parts, covers)
            self.last_update = None if vertices is None else part.last_update

    def _replaced(self, chosen: list[int], transform: Any, mask: int | None) -> tuple[Instance, ...]:
        """The instances, those that were chosen with another transform or mask."""
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

    @property
    def triangle_count(self) -> int:
        """Triangles of all instances together."""
        return int(sum(self._parts[number].triangle_count for number in self.geometry_ids))

    @property
    def parts(self) -> tuple[Scene, ...]:
        """A scene for each of `meshes`, in its own space; to be left as it is."""
        return self._parts

    @property
    def width(self) -> int:
        """Triangles tested at once."""
        return self._parts[0].width

    @property
    def depth(self) -> int:
        """Most inner nodes on a path of a mesh's BVH."""
        return max(part.depth for part in self._parts)

    @property
    def record_bytes(self) -> int:
        """Memory of the triangle records made so far, of each mesh once."""
        return sum(part.record_bytes for part in self._parts)

    @property
    def bytes(self) -> int:
        """Memory of all trees, triangles and places, and of the records made so far."""
        shared = sum(part.tree.bytes + mesh_bytes(part.device_mesh) for part in self._parts)
        return shared + self.record_bytes + self.tree.bytes + self.device_mesh.placements.capacity

    def statistics(self) -> SceneStatistics:
        """Not of two levels at once: see the trees of the meshes.

        Raises:
            ValueError: always; the message says what to ask instead.
        """
        raise ValueError("a scene of instances has many trees; ask wrt.Scene(scene.meshes[0]).statistics() for one mesh's")

    @property
    def exact_vertices(self) -> wp.array:
        """Not of instances, whose vertices are nowhere as they are in the scene.

        Raises:
            ValueError: always; the message says what to do instead.
        """
        raise ValueError(
            "a scene of instances has no vertices in float64, which precise=True and gradients need; "
            "ask wrt.Scene(scene.flattened())"
        )

    def handle(self) -> Any:
        """Not of instances: `wrt.device` walks one tree.

        Raises:
            ValueError: always; the message says what to do instead.
        """
        raise ValueError("kernels get a handle of one tree, not of instances; ask for wrt.Scene(scene.flattened()).handle()")

    def flattened(self) -> TriangleMesh:
        """All instances as one mesh in float64, triangles in the order of instances; takes the memory of all of them."""
        meshes = [self.meshes[number] for number in self.geometry_ids]
        wide = (TriangleMesh(mesh.vertices.astype(np.float64), mesh.faces) for mesh in meshes)
        moved = [mesh.transformed(instance.transform) for mesh, instance in zip(wide, self.instances, strict=True)]
        return TriangleMesh.concatenate(moved)

    def upper(self) -> InstanceTree:
        """The upper level, for traversals."""
        from wrt.kernels.traversal.two_level.instance_single import InstanceTree

        top = InstanceTree()
        top.tree, top.order = self.tree.struct(), self.tree.primitive
        top.placements, top.stretch = self.device_mesh.placements, self._stretch
        return top

    def lower(self, plan: Plan, rays: RayBatch) -> wp.array:
        """The trees of the meshes and their records for the plan's triangle test, for traversals of `rays`; made once."""
        from wrt.kernels.traversal.two_level.instance_single import PARTS

        key = plan.accelerator, plan.triangle_test
        if key not in self._tables:
            kind, table, used = PARTS[plan.accelerator], [], []
            for scene in self._parts:
                part, blocks = kind(), scene.triangles(plan, rays)
                part.tree, part.triangles = scene.tree.struct(), blocks
                table.append(part)
                used.append((scene.tree, blocks))
            with kept(self.device):
                self._tables[key] = keep_alive(wp.array(table, dtype=kind, device=self.device), used)
        return self._tables[key]


@dataclass(frozen=True)
class Places:
    """The maps of all N instances, and their boxes in the scene's coordinates; all float64.

    Attributes:
        to_scene, to_object: (N, 3, 3), inverse to each other.
        origin: (N, 3), where the centre of each one's mesh goes.
        low, high: (N, 3).
        stretch: by what the slack of boxes grows for the worst of them (`wrt.kernels.traversal.two_level.instance_single`).
    """

    to_scene: np.ndarray
    to_object: np.ndarray
    origin: np.ndarray
    low: np.ndarray
    high: np.ndarray
    stretch: float

    @classmethod
    def of(
        cls, instances: Sequence[Instance], geometry_ids: Sequence[int], parts: Sequence[Scene], covers: Sequence[np.ndarray]
    ) -> Places:
        """Computes them; covers: what `cover` gave for each mesh."""
        transforms = np.array([instance.transform for instance in instances])
        to_scene, numbers = transforms[:, :3, :3], np.array(geometry_ids)
        to_object = np.linalg.inv(to_scene)
        centers = np.array([part.center for part in parts])[numbers]
        origin = (to_scene @ centers[:, :, None])[:, :, 0] + transforms[:, :3, 3]
        low, high = np.empty_like(origin), np.empty_like(origin)
        for number, points in enumerate(covers):
            own = np.flatnonzero(numbers == number)
            for chosen in np.array_split(own, -(-len(own) // MAPPED_AT_ONCE)):
                moved = to_scene[chosen] @ points.T
                low[chosen], high[chosen] = moved.min(axis=2) + origin[chosen], moved.max(axis=2) + origin[chosen]
        norms = np.abs(to_scene).sum(axis=2).max(axis=1) * np.abs(to_object).sum(axis=2).max(axis=1)
        return cls(to_scene, to_object, origin, low, high, 2.0 * float(norms.max()))

    def table(self, center: np.ndarray, geometry: Sequence[int], first: np.ndarray, mask: Sequence[int]) -> np.ndarray:
        """(N,) `Placement` for kernels."""
        table = np.zeros(len(self.origin), dtype=Placement.numpy_dtype())
        table["to_scene"], table["to_object"], table["origin"] = self.to_scene, self.to_object, self.origin - center
        table["geometry"], table["first"], table["mask"] = geometry, first, mask
        return table


def cover(part: Scene) -> np.ndarray:
    """(P, 3) float64 points relative to a mesh's centre in whose convex hull all its triangles are; few, if it is large."""
    mesh = part.device_mesh
    points = mesh.vertices.numpy()[part.meshes[0].referenced]
    low, high = points.min(axis=0), points.max(axis=0)
    if len(points) <= CELLS**3:
        return points.astype(np.float64)
    cell = ((points - low) / np.maximum(high - low, np.finfo(np.float32).tiny) * CELLS).astype(np.int64).clip(0, CELLS - 1)
    cell = (cell[:, 0] * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
    order = np.argsort(cell, kind="stable")
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    ranked = points[order].astype(np.float64)
    corners = np.stack([np.minimum.reduceat(ranked, begins), np.maximum.reduceat(ranked, begins)])
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8)
    return np.concatenate([np.stack([corners[c, :, axis] for axis, c in enumerate(choice)], axis=1) for choice in choices.T])


def build_upper(places: Places, center: np.ndarray, width: int) -> Bvh:
    """The tree of the instances' boxes, rounded outwards, one instance a leaf."""
    from wrt.accelerators.accelerator import Bvh
    from wrt.builders.triangle_boxes import Boxes, TriangleBoxes

    low, high = places.low - center, places.high - center
    rounding = 4.0 * np.finfo(np.float64).eps * (np.abs(low).max() + np.abs(high).max() + np.abs(center).max())
    low = np.nextafter((low - rounding).astype(np.float32), np.float32(-np.inf))
    high = np.nextafter((high + rounding).astype(np.float32), np.float32(np.inf))
    boxes = Boxes()
    boxes.low = wp.array(np.ascontiguousarray(low.T), dtype=float, device="cpu")
    boxes.high = wp.array(np.ascontiguousarray(high.T), dtype=float, device="cpu")
    triangles = TriangleBoxes(boxes, len(low), low.min(axis=0), high.max(axis=0))
    return Bvh(width=width, max_leaf_triangles=1).build(triangles, width)


def geometry_table(parts: tuple[Scene, ...], device: wp.Device) -> wp.array:
    """What kernels read of the meshes."""
    table, used, first = [], [], 0
    for part in parts:
        geometry = Geometry()
        geometry.vertices, geometry.faces = part.device_mesh.vertices, part.device_mesh.faces
        geometry.first_face = first
        table.append(geometry)
        used.append(part.device_mesh)
        first += part.triangle_count
    return keep_alive(wp.array(table, dtype=Geometry, device=device), used)


def mesh_bytes(mesh: SceneMesh) -> int:
    """Memory of vertices and faces."""
    return mesh.vertices.capacity + mesh.faces.capacity
