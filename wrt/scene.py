"""A scene: meshes, a tree over their triangles, and the rays that are asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerator import Accelerator, resolve_accelerator
from wrt.hits import Hits, shaped
from wrt.kernels.hits import SceneMesh
from wrt.kernels.launch import check_num_threads, use_threads
from wrt.mesh import TriangleMesh
from wrt.plan import ALL, ANY, AUTO, CLOSEST, COUNT, Plan, make_plan
from wrt.rays import Rays, shared_origin, to_device
from wrt.tables import lookup
from wrt.tracing import trace

if TYPE_CHECKING:
    from wrt.all_hits import AllHits
    from wrt.kernels.rays import RayBatch
    from wrt.kernels.triangle.records import Record, TriangleBlocks
    from wrt.statistics import SceneStatistics
    from wrt.verification import Verification

Origin = tuple[float, float, float]
"""A point relative to the scene's centre."""


class Scene:
    """Triangle meshes that rays can be shot at.

    The tree is built at once; a scene does not change afterwards and may be used from several threads.

    Args:
        geometry: a `TriangleMesh`, a trimesh.Trimesh or trimesh.Scene, or a sequence of such; each mesh of a sequence is a
            geometry of its own (`Hits.geometry_id`), a trimesh.Scene is one.
        accelerator: "auto", "bvh", "kdtree", or a description such as `wrt.KdTree(builder="in_place")`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`: the test of all queries that ask for none of
            their own. Only the default one counts (`count`, `intersect_all`, `contains`) exactly, and stays in charge of that.
        device: a Warp device or its name, such as "cpu" or "cuda:0"; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.

    Raises:
        TypeError: `geometry`, `accelerator` or `num_threads` is of a wrong type.
        ValueError: unknown names, no such device, an empty sequence.
    """

    def __init__(
        self,
        geometry: Any,
        accelerator: str | Accelerator = AUTO,
        *,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        self.meshes = _as_meshes(geometry)
        self.accelerator = resolve_accelerator(accelerator)
        self.triangle_test = _as_test(triangle_test)
        self.device = _as_device(device)
        self.num_threads = None if num_threads is None else check_num_threads(num_threads, "num_threads")
        vertices, faces, first = _join(self.meshes)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.center = (low.astype(np.float64) + high) / 2
        """(3,) float64; geometry is held in float32 relative to this point."""
        centered = (vertices - self.center).astype(np.float32)
        with use_threads(self.num_threads):
            self._build(centered, faces, first)

    def _build(self, vertices: np.ndarray, faces: np.ndarray, geometry_first: np.ndarray) -> None:
        from wrt.builders.triangles import triangle_boxes
        from wrt.kernels.lanes import native_width

        # Subtrees are built by one thread each, which suits cores: the tree is built on the CPU and copied.
        host = wp.get_device("cpu")
        host_vertices = wp.array(vertices, dtype=wp.vec3, device=host, copy=False)
        host_faces = wp.array(faces, dtype=wp.vec3i, device=host, copy=False)
        boxes = triangle_boxes(host_vertices, host_faces)
        self.tree = self.accelerator.build(boxes, native_width(self.device)).to(self.device)
        self.device_mesh = SceneMesh()
        """All triangles on the device, for kernels."""
        self.device_mesh.vertices = host_vertices.to(self.device)
        self.device_mesh.faces = host_faces.to(self.device)
        self.device_mesh.center = wp.vec3d(*map(float, self.center))
        self.device_mesh.low, self.device_mesh.high = wp.vec3(*self.tree.low), wp.vec3(*self.tree.high)
        self.device_mesh.geometry_first = wp.array(geometry_first, dtype=int, device=self.device)
        self._blocks: dict[tuple[str, Record], tuple[Origin | None, TriangleBlocks]] = {}

    def __repr__(self) -> str:
        return f"Scene({self.triangle_count} triangles, {self.accelerator}, device={str(self.device)!r})"

    @property
    def triangle_count(self) -> int:
        """Triangles of all meshes."""
        return self.device_mesh.faces.shape[0]

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the box of all triangles."""
        return np.array([self.tree.low, self.tree.high], dtype=np.float64) + self.center

    def intersect(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        counters: bool = False,
    ) -> Hits:
        """Closest hits.

        Among hits at the same t, the smaller geometry, then the smaller triangle wins: neither the tree, the traversal
        nor the number of threads shows in the result. A ray with a NaN or an infinity, or with a direction of zero, misses.

        Args:
            origins: (..., 3) or a `wrt.Rays` (then leave the next three out).
            directions: (..., 3), of any length; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; a hit counts if t_min <= t <= t_max. 0 <= t_min < inf.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a whole `Plan`, such as `explain` returns;
                the plan's triangle test then counts.
            triangle_test: "auto", the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            counters: whether to count each ray's work (`Hits.counters`).

        Raises:
            TypeError: an argument is of a wrong type.
            ValueError: wrong shapes, a range that is negative or NaN, unknown names, arrays on another device.
        """
        rays = _as_rays(origins, directions, t_min, t_max)
        with use_threads(self.num_threads):
            buffers = to_device(rays, self.device, self.center)
            plan = make_plan(self, buffers, traversal, triangle_test)
            batch, work = trace(self, plan, buffers, CLOSEST, counters)
        return Hits(batch, buffers, self.device_mesh, plan, work, self.num_threads)

    def occluded(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Any:
        """Whether anything is hit: (...) bool, a NumPy array if the rays were, else a Warp array.

        Arguments and errors as in `intersect`; the search ends at the first hit that it finds.
        """
        rays = _as_rays(origins, directions, t_min, t_max)
        with use_threads(self.num_threads):
            buffers = to_device(rays, self.device, self.center)
            plan = make_plan(self, buffers, traversal, triangle_test)
            batch, _ = trace(self, plan, buffers, ANY)
        return shaped(batch.occluded, buffers)

    def intersect_all(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        max_hits: int | None = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> AllHits:
        """All hits of each ray, sorted by t, then geometry, then triangle.

        Each crossing of a surface is one hit: a ray that meets an edge or a vertex hits exactly one of the triangles that it
        passes into there, so that the line through a closed surface has an even number of hits. Coincident triangles are hit
        each; a triangle that is seen edge-on is not. (`intersect` may name another of the triangles at an edge.)

        Args:
            origins, directions, t_min, t_max, traversal, triangle_test: as in `intersect`; not every traversal and triangle
                test answers this.
            max_hits: keep only so many of the nearest hits of each ray, at least 1; None for all. That saves memory, not
                time: all are found.

        Raises:
            TypeError: an argument is of a wrong type.
            ValueError: as `intersect`; a traversal or triangle test that does not answer this; more than 2^31 - 1 hits.
        """
        from wrt.all_hits import AllHits, check_max_hits, find_all

        bound, rays = check_max_hits(max_hits), _as_rays(origins, directions, t_min, t_max)
        with use_threads(self.num_threads):
            buffers = to_device(rays, self.device, self.center)
            plan = make_plan(self, buffers, traversal, triangle_test, ALL)
            batch, offsets = find_all(self, plan, buffers.batch, bound)
        return AllHits(batch, offsets, buffers, self.device_mesh, plan, self.num_threads)

    def count(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Any:
        """Number of hits of each ray: (...) int32, a NumPy array if the rays were, else a Warp array.

        What `intersect_all` would list, counted; arguments and errors as there.
        """
        rays = _as_rays(origins, directions, t_min, t_max)
        with use_threads(self.num_threads):
            buffers = to_device(rays, self.device, self.center)
            plan = make_plan(self, buffers, traversal, triangle_test, COUNT)
            batch, _ = trace(self, plan, buffers, COUNT)
        return shaped(batch.counts, buffers)

    def contains(self, points: Any, *, traversal: str | Plan = AUTO) -> Any:
        """Which points are inside: (...) bool, a NumPy array if the points were, else a Warp array.

        By parity: inside are those from which a ray crosses the surface an odd number of times. If every mesh is closed
        (`TriangleMesh.is_closed`), that does not depend on the ray's direction. If one is not, two of three directions
        decide, which is a guess near its holes. Of several meshes, or shells within each other, a point is inside if it is
        inside an odd number of them. Points nearer to the surface than float32 tells, relative to the scene's centre, may
        count as either; a point with a NaN or an infinity is outside.

        Args:
            points: (..., 3).
            traversal: as in `count`.

        Raises:
            TypeError: points are no array of real numbers.
            ValueError: wrong shape, an array on another device, a traversal that does not count.
        """
        from wrt.inside import contains

        return contains(self, points, traversal)

    def visible(self, points_a: Any, points_b: Any) -> Any:
        """Which pairs of points see each other: (...) bool, a NumPy array if both points were, else a Warp array.

            matrix = scene.visible(points[:, None], points[None, :])

        A pair is visible if no triangle crosses the open segment between the two. The points may lie on surfaces: a triangle
        whose plane passes through one of them within rounding (float32 relative to the scene's centre, float32 of the points
        themselves if they are given so) does not hide it from the other. So two points in one flat wall see each other, and
        what is on a wall is seen from both its sides. A point sees itself; one with a NaN or an infinity sees nothing.

        Args:
            points_a, points_b: (..., 3); leading shapes broadcast. Pairs go through memory in blocks.

        Raises:
            TypeError: points are no arrays of real numbers.
            ValueError: wrong shapes, shapes that do not broadcast, an array on another device.
        """
        from wrt.visibility import visible

        return visible(self, points_a, points_b)

    def verify(self, samples: int = 1000, seed: int = 0) -> Verification:
        """Checks `intersect` and `occluded` against brute force in float64, on this mesh and this machine.

            report = scene.verify()
            print(report)
            assert report.ok

        A quarter of the rays each is random, aimed at vertices, aimed at edges, and grazing. The reference tests every
        triangle, one ray at a time on one core: some 25 ms a ray for a million triangles; it takes 550 bytes a triangle.

        Args:
            samples: number of rays, at least 4.
            seed: of the rays, at least 0.

        Raises:
            TypeError: samples or seed is no int.
            ValueError: it is too small.
        """
        from wrt.verification import verify

        return verify(self, samples, seed)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every mesh is closed."""
        return all(mesh.is_closed for mesh in self.meshes)

    def explain(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        query: str = CLOSEST,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Plan:
        """How these rays would be answered, and why; nothing is traced.

        Args:
            query: "closest" (`intersect`), "any" (`occluded`), "count" or "all" (`intersect_all`).
            origins, directions, t_min, t_max, traversal, triangle_test: as in `intersect`.
        """
        rays = _as_rays(origins, directions, t_min, t_max)
        lookup(dict.fromkeys((CLOSEST, ANY, COUNT, ALL)), query, "query")
        with use_threads(self.num_threads):
            return make_plan(self, to_device(rays, self.device, self.center), traversal, triangle_test, query)

    @property
    def record_bytes(self) -> int:
        """Memory of the triangle records made so far: queries make those that their triangle test needs."""
        return sum(blocks.records.capacity for _, blocks in self._blocks.values())

    def statistics(self) -> SceneStatistics:
        """Counts, histograms, costs and times of the mesh, the tree and its build."""
        from wrt.statistics import scene_statistics

        return scene_statistics(self)

    def triangles(self, plan: Plan, rays: RayBatch) -> TriangleBlocks:
        """The triangles in the order of the tree's leaves ("none": of their ids), as the plan's triangle test stores them.

        Made once; records that depend on the rays' shared origin are made again when it has changed.
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


def _as_test(name: str) -> str:
    if name == AUTO:
        return name
    from wrt.kernels.triangle import TRIANGLE_TESTS

    return lookup(TRIANGLE_TESTS, name, "triangle_test").name


def _as_device(device: str | wp.Device | None) -> wp.Device:
    wp.init()
    try:
        return wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(str(d) for d in wp.get_devices())
        raise ValueError(f"device {device!r} is not there ({error}); choose from {names}") from None


def _as_rays(origins: Any, directions: Any, t_min: Any, t_max: Any) -> Rays:
    if isinstance(origins, Rays):
        if directions is not None:
            raise TypeError("pass either a wrt.Rays, or origins and directions, not both")
        return origins
    if directions is None:
        raise TypeError("directions is missing; pass origins and directions, or a wrt.Rays")
    return Rays(origins, directions, t_min, t_max)


def _join(meshes: tuple[TriangleMesh, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and each mesh's first triangle, of all meshes in one."""
    counts = np.cumsum([0] + [mesh.triangle_count for mesh in meshes])
    if len(meshes) == 1:
        return meshes[0].vertices, meshes[0].faces, counts
    offsets = np.cumsum([0] + [mesh.vertex_count for mesh in meshes])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)])
    return vertices, faces.astype(np.int32), counts
