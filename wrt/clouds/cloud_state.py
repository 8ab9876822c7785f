"""The state of a point cloud: points relative to their centre, and a BVH over their boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
import warp as wp

from wrt.builders import tree as common
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.engine.facts.scene_state import SceneState
from wrt.engine.memory import empty, memory_for
from wrt.kernels.clouds.cloud_test import BOX, DISC, SPHERE, CloudPoints, box_points, pack_points
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
from wrt.meshes.mesh_measures import extremes
from wrt.meshes.placement import MAX_COORDINATE, MAX_EXTENT
from wrt.scene.updates import MovedTriangles, TreeRecipe, UpdatePolicy, UpdateReport, move_tree

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.facts import SceneFacts
    from wrt.engine.facts.scene_settings import Settings

KINDS = {SPHERE: "spheres", DISC: "discs", BOX: "boxes"}

CHUNK = 2048
"""Points that are worth a chunk of their own."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudState(SceneState):
    """The state of a point cloud. Of a `SceneMesh`, it has what numbers and places points; it has no triangles.

    Attributes:
        points: on the device.
        last_update: what the last update did to the tree; None before the first.
    """

    refused: ClassVar[dict[str, str]] = {
        "float64 vertices": "points have no vertices, so hits on them have no gradients; make a wrt.Scene of triangles",
        "handle": "kernels trace rays through triangles, and points are none; make a wrt.Scene of triangles",
    }

    points: CloudPoints
    last_update: UpdateReport | None = None

    @property
    def triangle_count(self) -> int:
        """Number of points."""
        return len(self.points.centre)

    @property
    def slots(self) -> int:
        """Lanes of all blocks of points, in use or not."""
        return len(self.tree.primitive)

    @property
    def bytes(self) -> int:
        """Memory of the points, their tree and their records."""
        arrays = self.points.centre, self.points.radius, self.points.normal
        return self.tree.bytes + sum(array.capacity for array in arrays)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """What `place_cloud` makes the state of again."""
        points, kind = self.points, self.points.components
        radius, normals = points.normal if kind == BOX else points.radius, points.normal if kind == DISC else None
        return points.centre.numpy(), self.center, radius.numpy(), None if normals is None else normals.numpy()

    @cached_property
    def facts(self) -> SceneFacts:
        """What plans depend on."""
        return replace(super().facts, points=True, triangle_test=KINDS[self.points.components])

    def contents(self) -> str:
        """What is in the cloud, in words."""
        return f"{self.triangle_count} {self.facts.triangle_test}"

    def tangents(self, hits: DeviceHits) -> tuple[SceneMesh, wp.array, wp.array]:
        """Hits as triangles (`wrt.kernels.clouds.tangent_planes`), their numbers there, -1 for a miss, and weights of 0."""
        from wrt.kernels.clouds.tangent_planes import make_tangents

        device, own, mesh = self.device, self.device_mesh, SceneMesh()
        mesh.center, mesh.low, mesh.high = own.center, own.low, own.high
        mesh.vertices, mesh.faces = empty(3 * hits.count, wp.vec3, device), empty(hits.count, wp.vec3i, device)
        mesh.geometry_first = wp.array([0, hits.count], dtype=int, device=device)
        number, size = empty(hits.count, wp.int32, device), float(np.ptp(self.bounds, axis=0).max())
        inputs = [self.points, hits.primitive, hits.uv, size, mesh.vertices, mesh.faces, number]
        with use_threads(self.num_threads):
            launch(make_tangents, hits.count, inputs, device=device, chunk=CHUNK)
        return mesh, number, wp.zeros(hits.count, dtype=wp.vec2, device=device)


@dataclass(frozen=True)
class CloudTree:
    """A BVH over points, with the interface that a scene needs of its tree.

    Attributes:
        tree: numbers points.
        records: (blocks * components * width,) points in the order of the leaves.
    """

    tree: common.Bvh
    records: wp.array

    @classmethod
    def build(cls, points: CloudPoints, settings: Settings) -> CloudTree:
        """Builds the tree of points that are on the CPU."""
        boxes, low, high = point_boxes(points)
        whole = TriangleBoxes(boxes, len(points.centre), low.min(axis=1), high.max(axis=1))
        return cls.of(cast("common.Bvh", settings.accelerator.build(whole, native_width(settings.device))), points, settings)

    def moved(self, points: CloudPoints, settings: Settings, policy: UpdatePolicy) -> tuple[CloudTree, UpdateReport]:
        """The tree of as many points that are elsewhere, on the CPU, and a report.

        Trees are moved with triangles. Those here have two equal corners, and the boxes of the points.
        """
        _, low, high = point_boxes(points)
        count, device, cpu = len(points.centre), settings.device, wp.get_device("cpu")
        corners = wp.array(np.concatenate([low.T, high.T]), dtype=wp.vec3, device=cpu)
        faces = wp.array(np.arange(count)[:, None] + [0, 0, count], dtype=wp.vec3i, device=cpu)
        moved = MovedTriangles(corners.to(device), faces.to(device), corners, faces, np.zeros(3), np.zeros(3))
        tree, report = move_tree(TreeRecipe(settings.accelerator, self.width, device), self.tree, moved, policy)
        return self.of(cast("common.Bvh", tree), points, settings), report

    @classmethod
    def of(cls, tree: common.Bvh, points: CloudPoints, settings: Settings) -> CloudTree:
        """A tree over points that are on the CPU."""
        records = pack(points, tree.primitive.to("cpu"), tree.width).to(settings.device)
        return cls(tree.to(settings.device), records)

    @property
    def width(self) -> int:
        """Children of a node, and points of a block."""
        return self.tree.width

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path."""
        return self.tree.depth

    @property
    def low(self) -> wp.vec3:
        """Lower corner of the box of all points."""
        return self.tree.low

    @property
    def high(self) -> wp.vec3:
        """Upper corner of the box of all points."""
        return self.tree.high

    @property
    def bytes(self) -> int:
        """Bytes of nodes, leaves and records."""
        return self.tree.bytes + self.records.capacity

    @property
    def primitive(self) -> wp.array:
        """(blocks * width,) numbers of the points in the order of the leaves; -1 in unused lanes."""
        return self.tree.primitive

    @property
    def kernels(self) -> dict[str, Callable[[Any], wp.Kernel]]:
        """What makes the kernels of traversals, from a `TraversalConfig`, that are not those of triangles."""
        from wrt.kernels.clouds.cloud_walk import make_brute_cloud_kernel, make_cloud_kernel

        return {"single": make_cloud_kernel, "brute": make_brute_cloud_kernel}

    @cached_property
    def blocks(self) -> TriangleBlocks:
        """The points as kernels read them."""
        made = TriangleBlocks()
        made.records, made.primitive = self.records, self.primitive
        return made

    def struct(self) -> Any:
        """The tree as kernels read it."""
        return self.tree.struct()


def point_boxes(points: CloudPoints) -> tuple[Boxes, np.ndarray, np.ndarray]:
    """The boxes of points that are on the CPU, and their (3, N) lower and upper corners."""
    count, boxes, components = len(points.centre), Boxes(), points.components
    alone = pack(points, wp.array(np.arange(count, dtype=np.int32), dtype=int, device="cpu"), 1)
    boxes.low, boxes.high = (wp.empty((3, count), dtype=float, device="cpu") for _ in range(2))
    launch(box_points, count, [alone, components, boxes.low, boxes.high], device=boxes.low.device, chunk=CHUNK)
    return boxes, boxes.low.numpy(), boxes.high.numpy()


def pack(points: CloudPoints, order: wp.array, width: int) -> wp.array:
    """Records of points on the CPU, in blocks of a width; `order`: their numbers, -1 for unused lanes."""
    records = wp.empty(len(order) * points.components, dtype=float, device="cpu")
    inputs = [points, order, width, points.components, records]
    launch(pack_points, len(order), inputs, device=records.device, chunk=CHUNK)
    return records


def build_cloud(
    points: np.ndarray, radius: np.ndarray, normals: np.ndarray | None, settings: Settings, move: Move | None = None
) -> CloudState:
    """The state of a cloud.

    Args:
        points: (N, 3) float64, finite.
        radius: (N,) or (1,) float32, positive; of boxes (N, 3), half their edges.
        normals: (N, 3) unit vectors of discs, or None.
        settings: of the cloud.
        move: as in `place_cloud`.

    Raises:
        ValueError: the cloud is too large, or too far away.
        MemoryError: there is too little memory for the tree.
    """
    farthest, (low, high) = float(radius.max()), extremes(points)
    low, high = low - farthest, high + farthest
    if max(-low.min(), high.max()) > MAX_COORDINATE or (high - low).max() > MAX_EXTENT:
        raise ValueError(
            f"points and their radius reach from {low} to {high}; a cloud may be {MAX_EXTENT:.3g} across, with coordinates up "
            f"to {MAX_COORDINATE:.3g}: remove coordinates that are errors, or scale the cloud down"
        )
    center = 0.5 * low + 0.5 * high
    with memory_for(f"the tree of {len(points):,} points", points.nbytes):
        own = None if normals is None else normals.astype(np.float32)
        return place_cloud((points - center).astype(np.float32), center, radius, own, settings, move)


Move = Callable[[CloudPoints, "Settings"], tuple[CloudTree, UpdateReport]]


def place_cloud(
    points: np.ndarray,
    center: np.ndarray,
    radius: np.ndarray,
    normals: np.ndarray | None,
    settings: Settings,
    move: Move | None = None,
) -> CloudState:
    """The state of points that are (N, 3) float32 relative to a centre; the other arguments as in `build_cloud`, in float32.

    move: makes the tree of the points on the CPU, and a report, of a tree that there is; None to build one.
    """
    device, host, own, mesh = settings.device, CloudPoints(), CloudPoints(), SceneMesh()
    host.centre = wp.array(points, dtype=wp.vec3, device="cpu")
    is_box = radius.ndim == 2
    host.radius = wp.array(np.zeros(1) if is_box else radius, dtype=float, device="cpu")
    across = radius if is_box else np.zeros((0, 3)) if normals is None else normals
    host.normal = wp.array(across, dtype=wp.vec3, device="cpu")
    host.components = own.components = BOX if is_box else SPHERE if normals is None else DISC
    with use_threads(settings.num_threads):
        tree, report = (CloudTree.build(host, settings), None) if move is None else move(host, settings)
    own.centre, own.radius, own.normal = host.centre.to(device), host.radius.to(device), host.normal.to(device)
    mesh.vertices, mesh.faces = own.centre, wp.zeros(1, dtype=wp.vec3i, device=device)  # not met by any ray
    mesh.center, mesh.low, mesh.high = wp.vec3d(*map(float, center)), wp.vec3(*tree.low), wp.vec3(*tree.high)
    mesh.geometry_first = wp.array([0, len(points)], dtype=int, device=device)
    return CloudState(
        settings=settings, meshes=(), center=center, built_tree=tree, device_mesh=mesh, points=own, last_update=report
    )
