"""The state of a point cloud: points relative to their centre, and a BVH over their boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
import warp as wp

from wrt.builders import tree as common
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.engine.facts.scene_state import SceneState
from wrt.engine.memory import empty, memory_for
from wrt.kernels.clouds.cloud_test import DISC, SPHERE, CloudPoints, box_points, pack_points
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.placement import MAX_COORDINATE, MAX_EXTENT

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_settings import Settings

CHUNK = 2048
"""Points that are worth a chunk of their own."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudState(SceneState):
    """The state of a point cloud. Of a `SceneMesh`, it has what numbers and places points; it has no triangles.

    Attributes:
        points: on the device.
    """

    refused: ClassVar[dict[str, str]] = {
        "float64 vertices": "points have no vertices, so hits on them have no gradients; make a wrt.Scene of triangles",
        "handle": "kernels trace rays through triangles, and points are none; make a wrt.Scene of triangles",
    }

    points: CloudPoints

    @property
    def triangle_count(self) -> int:
        """Number of points."""
        return len(self.points.centre)

    @property
    def slots(self) -> int:
        """Lanes of all blocks of points, in use or not."""
        return len(self.tree.tree.primitive)

    @property
    def bytes(self) -> int:
        """Memory of the points, their tree and their records."""
        arrays = self.points.centre, self.points.radius, self.points.normal
        return self.tree.bytes + sum(array.capacity for array in arrays)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """What `place_cloud` makes the state of again."""
        points, normals = self.points, self.points.normal
        return points.centre.numpy(), self.center, points.radius.numpy(), normals.numpy() if len(normals) else None

    def contents(self) -> str:
        """What is in the cloud, in words."""
        return f"{self.triangle_count} {'discs' if len(self.points.normal) else 'spheres'}"

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
        components: `SPHERE` or `DISC`.
        primitive: no triangles, in blocks of `width`: leaves list points.
        brute_force: whether rays are tested against every point.
    """

    tree: common.Bvh
    records: wp.array
    components: int
    primitive: wp.array
    brute_force: bool = False

    @classmethod
    def build(cls, points: CloudPoints, settings: Settings) -> CloudTree:
        """Builds the tree of points that are on the CPU."""
        device, width = settings.device, native_width(settings.device)
        components = DISC if len(points.normal) else SPHERE
        count, boxes = len(points.centre), Boxes()
        alone = pack(points, wp.array(np.arange(count, dtype=np.int32), dtype=int, device="cpu"), 1, components)
        boxes.low, boxes.high = (wp.empty((3, count), dtype=float, device="cpu") for _ in range(2))
        launch(box_points, count, [alone, components, boxes.low, boxes.high], device=boxes.low.device, chunk=CHUNK)
        del alone
        low, high = boxes.low.numpy().min(axis=1), boxes.high.numpy().max(axis=1)
        tree = cast("common.Bvh", settings.accelerator.build(TriangleBoxes(boxes, count, low, high), width))
        records = pack(points, tree.primitive, width, components).to(device)
        return cls(tree.to(device), records, components, wp.array(np.full(width, -1), dtype=int, device=device))

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
    def kernel_factory(self) -> Callable[[Any], wp.Kernel]:
        """Makes the kernel that answers, from a `TraversalConfig`."""
        from wrt.kernels.clouds.cloud_walk import make_brute_cloud_kernel, make_cloud_kernel

        return partial(make_brute_cloud_kernel if self.brute_force else make_cloud_kernel, components=self.components)

    def struct(self) -> Any:
        """The tree as kernels read it."""
        from wrt.kernels.clouds import cloud_walk

        made = cloud_walk.CloudTree()
        made.nodes, made.records, made.primitive = self.tree.struct(), self.records, self.tree.primitive
        return made


def pack(points: CloudPoints, order: wp.array, width: int, components: int) -> wp.array:
    """Records of points on the CPU, in blocks of a width; `order`: their numbers, -1 for unused lanes."""
    records = wp.empty(len(order) * components, dtype=float, device="cpu")
    launch(pack_points, len(order), [points, order, width, components, records], device=records.device, chunk=CHUNK)
    return records


def build_cloud(points: np.ndarray, radius: np.ndarray, normals: np.ndarray | None, settings: Settings) -> CloudState:
    """The state of a cloud.

    Args:
        points: (N, 3) float64, finite.
        radius: (N,) or (1,) float32, positive.
        normals: (N, 3) unit vectors, or None for spheres.
        settings: of the cloud.

    Raises:
        ValueError: the cloud is too large, or too far away.
        MemoryError: there is too little memory for the tree.
    """
    low, high = points.min(axis=0) - float(radius.max()), points.max(axis=0) + float(radius.max())
    if max(-low.min(), high.max()) > MAX_COORDINATE or (high - low).max() > MAX_EXTENT:
        raise ValueError(
            f"points and their radius reach from {low} to {high}; a cloud may be {MAX_EXTENT:.3g} across, with coordinates up "
            f"to {MAX_COORDINATE:.3g}: remove coordinates that are errors, or scale the cloud down"
        )
    center = 0.5 * low + 0.5 * high
    with memory_for(f"the tree of {len(points):,} points", points.nbytes):
        own = None if normals is None else normals.astype(np.float32)
        return place_cloud((points - center).astype(np.float32), center, radius, own, settings)


def place_cloud(
    points: np.ndarray, center: np.ndarray, radius: np.ndarray, normals: np.ndarray | None, settings: Settings
) -> CloudState:
    """The state of points that are (N, 3) float32 relative to a centre; the other arguments as in `build_cloud`, in float32."""
    device, host, own, mesh = settings.device, CloudPoints(), CloudPoints(), SceneMesh()
    host.centre = wp.array(points, dtype=wp.vec3, device="cpu")
    host.radius = wp.array(radius, dtype=float, device="cpu")
    host.normal = wp.array(np.zeros((0, 3)) if normals is None else normals, dtype=wp.vec3, device="cpu")
    with use_threads(settings.num_threads):
        tree = CloudTree.build(host, settings)
    own.centre, own.radius, own.normal = host.centre.to(device), host.radius.to(device), host.normal.to(device)
    mesh.vertices, mesh.faces = own.centre, wp.zeros(1, dtype=wp.vec3i, device=device)  # not met by any ray
    mesh.center, mesh.low, mesh.high = wp.vec3d(*map(float, center)), wp.vec3(*tree.low), wp.vec3(*tree.high)
    mesh.geometry_first = wp.array([0, len(points)], dtype=int, device=device)
    return CloudState(
        settings=settings, meshes=(), center=center, built_tree=tree, device_mesh=mesh, points=own, only_single=True
    )
