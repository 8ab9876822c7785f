"""A scene: meshes, a tree over their triangles, and the records of these that triangle tests read."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerator import Accelerator, KdTree, resolve_accelerator
from wrt.kernels.hits import SceneMesh
from wrt.kernels.launch import check_num_threads, use_threads
from wrt.mesh import TriangleMesh
from wrt.plan import AUTO, Plan
from wrt.queries import Queries
from wrt.ray_aware_bvh import RayAwareBvh
from wrt.rays import shared_origin
from wrt.tables import lookup

if TYPE_CHECKING:
    from pathlib import Path

    from wrt.builders import common
    from wrt.builders.triangles import TriangleBoxes
    from wrt.few_rays import Desk
    from wrt.kernels.rays import RayBatch
    from wrt.kernels.triangle.records import Record, TriangleBlocks
    from wrt.statistics import SceneStatistics
    from wrt.storage import TreeSource

Origin = tuple[float, float, float]
"""A point relative to the scene's centre."""


class Scene(Queries):
    """Triangle meshes that rays can be shot at.

    The tree is built at once, or as far as rays ask for it (`wrt.KdTree(builder="lazy")`); else a scene does not change
    afterwards, and it may be used from several threads.

    Args:
        geometry: a `TriangleMesh`, a trimesh.Trimesh or trimesh.Scene, or a sequence of such; each mesh of a sequence is a
            geometry of its own (`Hits.geometry_id`), a trimesh.Scene is one.
        accelerator: "auto", "bvh", "kdtree", or a description such as `wrt.KdTree(builder="in_place")`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`: the test of all queries that ask for none of
            their own. Only the default one counts (`count`, `intersect_all`, `contains`) exactly, and stays in charge of that.
        device: a Warp device or its name, such as "cpu" or "cuda:0"; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.
        cache: path of a folder in which to look for the tree, by a hash of all that it depends on; one that is not there is
            built and written there. Trees of any number of scenes share a folder. None: no file is read or written.

    Raises:
        TypeError: `geometry`, `accelerator`, `num_threads` or `cache` is of a wrong type.
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
        cache: str | Path | TreeSource | None = None,
    ) -> None:
        self.meshes = _as_meshes(geometry)
        self.accelerator = resolve_accelerator(accelerator)
        self.triangle_test = _as_test(triangle_test)
        self.device = as_device(device)
        self.num_threads = None if num_threads is None else check_num_threads(num_threads, "num_threads")
        vertices, faces, first = _join(self.meshes)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.center = (low.astype(np.float64) + high) / 2
        """(3,) float64; geometry is held in float32 relative to this point."""
        centered = (vertices - self.center).astype(np.float32)
        with use_threads(self.num_threads):
            self._build(centered, faces, first, cache)

    def _build(self, vertices: np.ndarray, faces: np.ndarray, geometry_first: np.ndarray, cache: Any) -> None:
        # What queries need is imported here: `wrt.kernels.traversal` and its parts import one another, and threads that enter
        # such a package from two ends at a time fail.
        import wrt.kernels.traversal  # noqa: F401
        from wrt.builders.triangles import triangle_boxes
        from wrt.local_trees import build_local_trees

        # Subtrees are built by one thread each, which suits cores: the tree is built on the CPU and copied.
        host = wp.get_device("cpu")
        host_vertices = wp.array(vertices, dtype=wp.vec3, device=host, copy=False)
        host_faces = wp.array(faces, dtype=wp.vec3i, device=host, copy=False)
        boxes = triangle_boxes(host_vertices, host_faces, self.center)
        self._find_tree(boxes, vertices, faces, cache)
        self.device_mesh = SceneMesh()
        """All triangles on the device, for kernels."""
        self.device_mesh.vertices = host_vertices.to(self.device)
        self.device_mesh.faces = host_faces.to(self.device)
        self.device_mesh.center = wp.vec3d(*map(float, self.center))
        self.device_mesh.low, self.device_mesh.high = wp.vec3(*self.tree.low), wp.vec3(*self.tree.high)
        self.device_mesh.geometry_first = wp.array(geometry_first, dtype=int, device=self.device)
        self.desks: dict[str, deque[Desk]] = {}
        """Those that are free, for each query; see `wrt.few_rays`."""
        self._blocks: dict[tuple[str, Record], tuple[Origin | None, TriangleBlocks]] = {}
        self.local_trees = build_local_trees(self, boxes) if isinstance(self.accelerator, RayAwareBvh) else None
        """The trees of influence areas, where there are any."""

    def _find_tree(self, boxes: TriangleBoxes, vertices: np.ndarray, faces: np.ndarray, cache: Any) -> None:
        """Takes the tree from where trees are kept, or builds it, or begins to."""
        from wrt.kernels.lanes import native_width
        from wrt.storage import as_source, is_kept, tree_key

        width, source = native_width(self.device), as_source(cache)
        lazy = isinstance(self.accelerator, KdTree) and self.accelerator.is_lazy
        self.growing = self.accelerator.start(boxes, width, self.device) if lazy else None
        """The tree that is built lazily; None if it is all there."""
        self._tree = None
        if source is not None and is_kept(self.accelerator):
            key = tree_key(vertices, faces, self.accelerator, width)
            self._tree = source.tree(key, len(faces), lambda: self.accelerator.build(boxes, width)).to(self.device)
        elif not lazy:
            self._tree = self.accelerator.build(boxes, width).to(self.device)

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
        when it is complete.

        Raises:
            OSError: the file cannot be written.
            ValueError: the tree is built lazily, or for influence areas: such trees are not kept.
        """
        from wrt.storage import save_scene

        save_scene(self, path)

    @classmethod
    def load(cls, path: str | Path, *, device: str | wp.Device | None = None, num_threads: int | None = None) -> Scene:
        """Reads a scene that was saved. Its answers are the same to the bit.

        The tree is built again if it is not the one that would be built here: another version of wrt wrote it, or for a
        device with vectors of another width. Nothing in a file is run, so those of strangers are safe to read.

        Args:
            path: of the file.
            device, num_threads: as of the constructor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is no scene that wrt saved, or it is damaged; no such device.
        """
        from wrt.storage import load_scene

        return load_scene(path, device, num_threads)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles take the tree along."""
        from wrt.storage import reduce_scene

        return reduce_scene(self)

    def __copy__(self) -> Scene:
        """A scene of its own with the same meshes and tree, where they are."""
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__ | {"desks": {}, "_blocks": dict(self._blocks)}
        return other

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

        Made once; records that depend on the rays' shared origin are made again when it has changed. Others need no rays. Those
        of a tree that has grown are made for what is new.
        """
        from wrt.kernels.triangle import TRIANGLE_TESTS
        from wrt.kernels.triangle.packing import pack_blocks

        tree, record = plan.accelerator, TRIANGLE_TESTS[plan.triangle_test].record
        origin = shared_origin(rays) if record.per_origin else None
        made_for, blocks = self._blocks.get((tree, record), (None, None))
        primitive = self.tree.primitive
        if made_for != origin:
            blocks = None
        if blocks is None or (tree != "none" and len(blocks.primitive) < len(primitive)):
            if tree == "none":
                count, width = self.triangle_count, self.tree.width
                ids = np.full(-(-count // width) * width, -1, dtype=np.int32)
                ids[:count] = np.arange(count)
                primitive = wp.array(ids, dtype=int, device=self.device)
            mesh, width = self.device_mesh, self.tree.width
            blocks = pack_blocks(record, mesh.vertices, mesh.faces, primitive, width, origin or (0.0, 0.0, 0.0), blocks)
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
