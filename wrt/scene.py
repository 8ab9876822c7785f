"""A scene: meshes, a tree over their triangles, and the records of these that triangle tests read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerator import Accelerator, resolve_accelerator
from wrt.instances import Instance, has_instances
from wrt.kernels.hits import SceneMesh
from wrt.kernels.launch import check_num_threads, use_threads
from wrt.mesh import TriangleMesh
from wrt.plan import AUTO, Plan
from wrt.queries import Queries
from wrt.rays import shared_origin
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.builders.common import Bvh, KdTree
    from wrt.kernels.rays import RayBatch
    from wrt.kernels.triangle.records import Record, TriangleBlocks
    from wrt.statistics import SceneStatistics

Origin = tuple[float, float, float]
"""A point relative to the scene's centre."""


class Scene(Queries):
    """Triangle meshes that rays can be shot at.

    The tree is built at once. A scene may be used from several threads, as long as none of them calls `update`: that changes
    the scene in one step, at its end or not at all, but a query under way may see a part of it before and a part after.
    Results that were made before keep the geometry that they were made with.

    Args:
        geometry: a `TriangleMesh`, a trimesh.Trimesh or trimesh.Scene, a `wrt.Instance`, or a sequence of such. Each mesh of a
            sequence is a geometry of its own (`Hits.geometry_id`), in one tree with the others. With an instance or a
            trimesh.Scene in it, a `wrt.InstancedScene` is made, of two levels: each node of the graph is an instance.
        accelerator: "auto", "bvh", "kdtree", or a description such as `wrt.KdTree(builder="in_place")`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`: the test of all queries that ask for none of
            their own. Only the default one counts (`count`, `intersect_all`, `contains`) exactly, and stays in charge of that.
        device: a Warp device or its name, such as "cpu" or "cuda:0"; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.

    Raises:
        TypeError: `geometry`, `accelerator` or `num_threads` is of a wrong type.
        ValueError: unknown names, no such device, an empty sequence.
    """

    instances: tuple[Instance, ...] = ()
    """What a `wrt.InstancedScene` is made of; none in a scene of meshes."""

    def __new__(cls, geometry: Any = None, *args: Any, **options: Any) -> Scene:
        if cls is Scene and has_instances(geometry):
            from wrt.instanced_scene import InstancedScene

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
    ) -> None:
        self.accelerator = resolve_accelerator(accelerator)
        self.triangle_test = _as_test(triangle_test)
        self.device = as_device(device)
        self.num_threads = None if num_threads is None else check_num_threads(num_threads, "num_threads")
        with use_threads(self.num_threads):
            self._make(geometry)

    def _make(self, geometry: Any) -> None:
        self._set(_as_meshes(geometry), None)

    def _set(self, meshes: tuple[TriangleMesh, ...], old: KdTree | Bvh | None) -> None:
        """Takes over the meshes; the tree is refitted if there is an old one that can be, else built."""
        from wrt.builders.bvh.refit import refit
        from wrt.builders.common import Bvh

        vertices, faces, first = _join(meshes)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        center = (low.astype(np.float64) + high) / 2
        host = wp.get_device("cpu")
        host_vertices = wp.array((vertices - center).astype(np.float32), dtype=wp.vec3, device=host, copy=False)
        host_faces = wp.array(faces, dtype=wp.vec3i, device=host, copy=False)
        mesh = SceneMesh()
        mesh.vertices = host_vertices.to(self.device)
        mesh.faces = host_faces.to(self.device)
        can_refit = isinstance(old, Bvh)
        tree = refit(old, mesh.vertices, mesh.faces) if can_refit else self._build(host_vertices, host_faces, center)
        mesh.center = wp.vec3d(*map(float, center))
        mesh.low, mesh.high = wp.vec3(*tree.low), wp.vec3(*tree.high)
        mesh.geometry_first = wp.array(first, dtype=int, device=self.device)
        self._take_over(meshes, center, tree, mesh)

    def _build(self, vertices: wp.array, faces: wp.array, center: np.ndarray) -> KdTree | Bvh:
        from wrt.builders.triangles import triangle_boxes
        from wrt.kernels.lanes import native_width

        # Subtrees are built by one thread each, which suits cores: the tree is built on the CPU and copied.
        boxes = triangle_boxes(vertices, faces, center)
        return self.accelerator.build(boxes, native_width(self.device)).to(self.device)

    def _take_over(self, meshes: tuple[TriangleMesh, ...], center: np.ndarray, tree: KdTree | Bvh, mesh: SceneMesh) -> None:
        """The only place where a scene changes; nothing here can fail."""
        self.meshes, self.tree = meshes, tree
        self.center = center
        """(3,) float64; geometry is held in float32 relative to this point."""
        self.device_mesh = mesh
        """All triangles on the device, for kernels."""
        self._blocks: dict[tuple[str, Record], tuple[Origin | None, TriangleBlocks]] = {}
        self.__dict__.pop("is_closed", None)

    def update(self, index: int, *, vertices: Any = None, transform: Any = None, mask: int | None = None) -> None:
        """Moves the vertices of a mesh; its triangles stay the same.

        A BVH is refitted, which is faster than a build; it answers more slowly the further triangles move apart that were
        close. A kd-tree is built again.

        Args:
            index: of the mesh (`Hits.geometry_id`).
            vertices: (V, 3), as many as the mesh has.
            transform, mask: for scenes of instances (`wrt.InstancedScene.update`).

        Raises:
            TypeError: a value is of a wrong type.
            ValueError: no such mesh, a wrong number of vertices, NaN or infinite ones, a transform or a mask. The scene is then
                as before.
        """
        if transform is not None or mask is not None:
            raise ValueError("transform and mask go with instances, and this scene has none; make it of wrt.Instance(mesh)")
        index = check_index(index, len(self.meshes), "mesh")
        moved = moved_mesh(self.meshes[index], vertices)
        with use_threads(self.num_threads):
            self._set((*self.meshes[:index], moved, *self.meshes[index + 1 :]), self.tree)

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
        return sum(blocks.records.capacity for _, blocks in self._blocks.values())

    def flattened(self) -> TriangleMesh:
        """All meshes as one, triangles in the order in which the scene numbers them."""
        return TriangleMesh.concatenate(self.meshes)

    def statistics(self) -> SceneStatistics:
        """Counts, histograms, costs and times of the mesh, the tree and its build."""
        from wrt.statistics import scene_statistics

        return scene_statistics(self)

    def handle(self) -> Any:
        """The scene for kernels of your own: what the functions of `wrt.device` take.

        A struct that refers to the scene's arrays and keeps them alive; made in some 0.1 ms.
        """
        from wrt.device import handle_of

        return handle_of(self)

    def triangles(self, plan: Plan, rays: RayBatch | None) -> TriangleBlocks:
        """The triangles in the order of the tree's leaves ("none": of their ids), as the plan's triangle test stores them.

        Made once; records that depend on the rays' shared origin are made again when it has changed. Others need no rays.
        """
        from wrt.kernels.triangle import TRIANGLE_TESTS
        from wrt.kernels.triangle.packing import pack_blocks

        tree, record = plan.accelerator, TRIANGLE_TESTS[plan.triangle_test].record
        origin = shared_origin(rays) if record.per_origin else None
        made_for, blocks = self._blocks.get((tree, record), (None, None))
        if blocks is None or made_for != origin:
            primitive = self.tree.primitive
            if tree == "none":
                count, width = self.triangle_count, self.tree.width
                ids = np.full(-(-count // width) * width, -1, dtype=np.int32)
                ids[:count] = np.arange(count)
                primitive = wp.array(ids, dtype=int, device=self.device)
            mesh, width = self.device_mesh, self.tree.width
            blocks = pack_blocks(record, mesh.vertices, mesh.faces, primitive, width, origin or (0.0, 0.0, 0.0))
            self._blocks[tree, record] = origin, blocks
        return blocks


def _as_meshes(geometry: Any) -> tuple[TriangleMesh, ...]:
    if isinstance(geometry, TriangleMesh):
        return (geometry,)
    if isinstance(geometry, Sequence) and not isinstance(geometry, (str, bytes)):
        if not geometry:
            raise ValueError("geometry is an empty sequence; pass at least one mesh")
        return tuple(mesh for item in geometry for mesh in _as_meshes(item))
    if hasattr(geometry, "to_geometry") or hasattr(geometry, "faces"):
        return (TriangleMesh.from_trimesh(geometry),)
    raise TypeError(
        f"geometry must be a wrt.TriangleMesh, a trimesh object or a sequence of them, not {type(geometry).__name__}; "
        "make a mesh of a file with wrt.TriangleMesh.load(path)"
    )


def check_index(index: Any, count: int, what: str) -> int:
    """An index of a mesh or instance, 0 to count - 1.

    Raises:
        TypeError: not an int.
        ValueError: there is none of that index.
    """
    if isinstance(index, (bool, np.bool_)) or not isinstance(index, (int, np.integer)):
        raise TypeError(f"index must be an int, not {type(index).__name__}")
    if not 0 <= index < count:
        raise ValueError(f"index is {index}, but the scene's {what} indices go from 0 to {count - 1}")
    return int(index)


def moved_mesh(mesh: TriangleMesh, vertices: Any) -> TriangleMesh:
    """The mesh with its vertices elsewhere; they are copied.

    Raises:
        TypeError: vertices are missing, or no real numbers.
        ValueError: another number of vertices, NaN or infinite ones.
    """
    if vertices is None:
        raise TypeError("vertices is missing; pass an array of as many points as the mesh has vertices")
    points = np.array(vertices)
    if points.ndim and len(points) != mesh.vertex_count:
        raise ValueError(
            f"vertices has {len(points)} points, but the mesh has {mesh.vertex_count}; for other triangles, make a new scene"
        )
    return TriangleMesh(points, mesh.faces, name=mesh.name)


def _as_test(name: str) -> str:
    if name == AUTO:
        return name
    from wrt.kernels.triangle import TRIANGLE_TESTS

    return lookup(TRIANGLE_TESTS, name, "triangle_test").name


def as_device(device: str | wp.Device | None) -> wp.Device:
    """The device of that name; Warp's default device for None.

    Raises:
        ValueError: it is not there.
    """
    wp.init()
    try:
        return wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(str(d) for d in wp.get_devices())
        raise ValueError(f"device {device!r} is not there ({error}); choose from {names}") from None


def _join(meshes: tuple[TriangleMesh, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and each mesh's first triangle, of all meshes in one."""
    counts = np.cumsum([0] + [mesh.triangle_count for mesh in meshes])
    if len(meshes) == 1:
        return meshes[0].vertices, meshes[0].faces, counts
    offsets = np.cumsum([0] + [mesh.vertex_count for mesh in meshes])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)])
    return vertices, faces.astype(np.int32), counts
