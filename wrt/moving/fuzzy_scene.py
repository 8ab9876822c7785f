"""Animations known in advance: one tree of fuzzy boxes for all frames (`wrt.kernels.traversal.two_level.fuzzy_boxes`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.builders import tree as common
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.facts.scene_state import Settings, new_mark
from wrt.kernels.layout.mesh_placement import relative_to
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.validation import as_int, as_numbers, host_array
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import check_index, find_center, moved_mesh, place_meshes
from wrt.scene.mesh_state import MeshState
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.builders.motion_clusters import Decomposition

MOTION_TOLERANCE = 1e-3
"""Share of the animation's extent: no cluster is added once the residual motion enlarges no triangle's box by more."""

BEST_REST, REST_CANDIDATES = "best", 8
"""Rest pose to be looked for, and how many frames are tried."""


class FuzzyScene(Scene):
    """A mesh whose motion is known: one tree, built once, for all frames.

        scene = wrt.moving.FuzzyScene(frames, faces)
        for number in range(len(frames)):
            scene.show(number)
            image = wrt.render(scene, camera)

    Triangles with nearly the same motion form a cluster. The tree of a cluster is built over fuzzy boxes, each of which
    contains its triangle in all frames, in a space that moves with the cluster. Showing a frame needs a map for each
    cluster and new triangle records, but no build. Hits are bit for bit those of a `wrt.Scene` of the frame's triangles.
    Rays are traced one at a time.

    Args:
        frames: (F, V, 3) vertices of each frame.
        faces: (T, 3) vertex indices, the same in all frames.
        clusters: largest number of clusters.
        transforms: (F, B, 4, 4) affine maps of the mesh's parts, such as the bones of a skinned mesh, from their rest pose
            to each frame. These are then the clusters; each triangle joins the bone in whose space it moves least.
        rest: the frame from which motion is measured, for `clusters`; or "best": of up to 8 frames, evenly spaced, the one
            that leaves the least residual motion. Looking for it takes as many times as long.
        accelerator: how the trees of clusters are built: a `wrt.Bvh`, or a `wrt.KdTree` as in the paper, without clipping.
        device, num_threads: as in `wrt.Scene`.

    Attributes:
        frame: int, the frame shown; 0 at first.
        labels: (T,) int, the cluster of each triangle.

    Raises:
        TypeError, ValueError: bad frames, faces, numbers or maps.

    References: guenther-2006-motion.
    """

    frame: int
    labels: np.ndarray

    def __init__(
        self,
        frames: ArrayLike,
        faces: ArrayLike,
        *,
        clusters: int = 16,
        transforms: ArrayLike | None = None,
        rest: int | str = 0,
        accelerator: Bvh | KdTree | None = None,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        settings = as_settings(accelerator or Bvh(), AUTO, device, num_threads)
        if not isinstance(settings.accelerator, Bvh):
            check_kdtree(settings.accelerator)
        with use_threads(settings.num_threads):
            self._meshes = as_frames(frames, faces)
            self._centers = np.array([find_center((mesh,)) for mesh in self._meshes])
            motion = find_motion(self._meshes, clusters, transforms, rest)
            self.labels = motion.labels
            self._fuzzy = FuzzyTree.build(self._meshes, self._centers, motion, settings.accelerator, settings.device)  # type: ignore[arg-type]
            self._show(0, settings, new_mark())

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self._meshes)

    def show(self, frame: int) -> None:
        """Shows a frame: later queries see the triangles as they are in it.

        Args:
            frame: index of the frame, 0 to F - 1.

        Raises:
            TypeError: not an int.
            ValueError: no such frame.
        """
        refuse_capture("showing another frame", self.device)
        with use_threads(self.num_threads):
            self._show(check_index(frame, len(self._meshes), "frame", "frame"), self.state.settings, self.state.mark)

    def _show(self, frame: int, settings: Settings, mark: str) -> None:
        placed, shown = place_meshes((self._meshes[frame],), settings.device), self._fuzzy.at(frame)
        self.state = FuzzyState(
            settings=settings,
            meshes=(self._meshes[frame],),
            center=placed.center,
            built_tree=shown,
            device_mesh=placed.fill_in(shown.low, shown.high),
            only_single=True,
            mark=mark,
        )
        self.frame = frame

    def __repr__(self) -> str:
        counts = f"{len(self._meshes)} frames of {self.triangle_count} triangles in {self.labels.max() + 1} clusters"
        return f"FuzzyScene({counts}, device={str(self.device)!r})"


@dataclass(frozen=True, eq=False, kw_only=True)
class FuzzyState(MeshState):
    """The state of a scene of fuzzy boxes, in one frame."""

    is_plain: ClassVar[bool] = False

    refused: ClassVar[dict[str, str]] = {
        "update": "the frames of this scene are fixed; call show(frame), or make a wrt.Scene to update",
        "statistics": "a scene of fuzzy boxes has several trees; use wrt.Scene(scene.meshes).statistics() for the frame shown",
        "float64 vertices": "precise=True and gradients need a scene with a single tree; use wrt.Scene(scene.meshes)",
        "save": "trees of fuzzy boxes cannot be saved; save the frames, and make the scene from them",
        "pickle": "trees of fuzzy boxes cannot be pickled; pickle the frames, and make the scene from them",
        "handle": "kernels need the handle of a single tree; use wrt.Scene(scene.meshes).handle()",
    }


def check_kdtree(accelerator: Any) -> None:
    """Refuses what cannot be built over fuzzy boxes.

    Raises:
        TypeError: it is no kd-tree.
        ValueError: it is lazy, or clips triangles.
    """
    if not isinstance(accelerator, KdTree):
        raise TypeError(f"accelerator must be a wrt.Bvh or a wrt.KdTree, not {accelerator!r}: fuzzy boxes overlap")
    if accelerator.is_lazy or accelerator.split_clipping:
        raise ValueError("kd-trees over fuzzy boxes cannot be lazy and cannot clip; leave builder and split_clipping out")


def find_motion(meshes: list[TriangleMesh], clusters: int, transforms: Any, rest: int | str) -> Decomposition:
    """The clusters of triangles and their motion; arguments and errors as in `FuzzyScene`."""
    from wrt.builders.motion_clusters import assign_triangles, decompose

    frames, faces = np.array([mesh.vertices for mesh in meshes], dtype=np.float64), meshes[0].faces
    if transforms is not None:
        return assign_triangles(frames, faces, *as_maps(transforms, len(frames)))
    clusters = as_int("clusters", clusters, 1)
    if isinstance(rest, str) and rest != BEST_REST:
        raise ValueError(f"rest is {rest!r}; it must be 'best' or the number of a frame, from 0 to {len(frames) - 1}")
    rest = rest if isinstance(rest, str) else as_int("rest", rest, 0, len(frames) - 1)
    bounds = np.array([mesh.bounds for mesh in meshes])
    extent = float((bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)).max())
    poses = np.unique(np.linspace(0, len(frames) - 1, REST_CANDIDATES).astype(int)) if rest == BEST_REST else [rest]
    found = [decompose(frames, faces, clusters, MOTION_TOLERANCE * extent, int(pose)) for pose in poses]
    return min(found, key=lambda motion: motion.residual.sum())


@dataclass(frozen=True)
class FrameTrees:
    """The trees of a frame, with the interface that a scene needs of its tree.

    Attributes:
        top: tree over the boxes of clusters in the scene.
        parts: the trees of all clusters, in their own spaces: BVHs, or kd-trees.
        clusters: (C,) `wrt.kernels.traversal.two_level.fuzzy_boxes.Cluster`.
        depth: largest number of inner nodes on a path of any of the trees.
    """

    top: common.Bvh
    parts: common.Bvh | common.KdTree
    clusters: wp.array
    depth: int

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, parts: Any, rows: np.ndarray, depth: int) -> FrameTrees:
        """The trees of a frame; only the upper one is built.

        Args:
            low, high: (C, 3) float32 boxes of the clusters in the scene.
            parts: as above.
            rows: (C,) of `clusters`, on the host.
            depth: largest number of inner nodes on a path of `parts`, if they are BVHs.
        """
        from wrt.builders.triangle_boxes import boxes_of
        from wrt.kernels.traversal.two_level.fuzzy_boxes import Cluster

        device, width = parts.primitive.device, max(parts.width, 2)
        top = Bvh(width=width, max_leaf_triangles=1).build(boxes_of(low, high), width).to(device)
        return cls(top, parts, wp.array(rows, dtype=Cluster, device=device), max(top.depth, depth))

    @property
    def primitive(self) -> wp.array:
        """Triangle ids in the order of the leaves."""
        return self.parts.primitive

    @property
    def width(self) -> int:
        """Triangles of a block, and children of a node."""
        return self.parts.width

    @property
    def low(self) -> wp.vec3:
        """Lower corner of the box of all triangles."""
        return self.top.low

    @property
    def high(self) -> wp.vec3:
        """Upper corner of the box of all triangles."""
        return self.top.high

    @property
    def bytes(self) -> int:
        """Bytes of nodes, leaf lists and maps."""
        return self.top.bytes + self.parts.bytes + self.clusters.capacity

    @property
    def kind(self) -> str:
        """Kind of the clusters' trees."""
        return "kdtree" if isinstance(self.parts, common.KdTree) else "bvh"

    @property
    def kernel_factory(self) -> Callable[[Any], wp.Kernel]:
        """Makes the kernel that walks the trees, from a `TraversalConfig`."""
        from wrt.kernels.traversal.two_level.fuzzy_boxes import make_fuzzy_kernel

        return partial(make_fuzzy_kernel, kind=self.kind)

    def struct(self) -> Any:
        """The trees as a traversal kernel reads them."""
        from wrt.kernels.traversal.two_level.fuzzy_boxes import TREES

        tree = TREES[self.kind]()
        tree.top, tree.order, tree.clusters = self.top.struct(), self.top.primitive, self.clusters
        if self.kind == "bvh":
            tree.parts = self.parts.struct()
        else:
            tree.parts.nodes = self.parts.nodes
        return tree


@dataclass(frozen=True)
class FuzzyTree:
    """The trees of all frames, built once.

    Attributes:
        parts: the trees of all clusters, in their own spaces.
        depth: largest number of inner nodes on a path of `parts`.
        table: (F, C) `Cluster`, origins relative to the scene's centre in each frame.
        boxes: (F, 2, C, 3) float32 lower and upper corners of the clusters, relative to the centre in each frame.
    """

    parts: common.Bvh | common.KdTree
    depth: int
    table: np.ndarray
    boxes: np.ndarray

    @classmethod
    def build(
        cls,
        meshes: list[TriangleMesh],
        centers: np.ndarray,
        motion: Decomposition,
        accelerator: Bvh | KdTree,
        device: wp.Device,
    ) -> FuzzyTree:
        """Builds a tree over the fuzzy boxes of each cluster's triangles."""
        from wrt.builders.motion_clusters import fuzzy_boxes
        from wrt.builders.triangle_boxes import boxes_of

        width, count = native_width(device), motion.matrices.shape[1]
        origins = motion.origins - centers[:, None]
        table = cluster_rows(motion.matrices, origins)
        boxes, trees, members = np.empty((len(meshes), 2, count, 3), dtype=np.float32), [], []
        corners = np.array([triangle_corners(mesh, center) for mesh, center in zip(meshes, centers, strict=True)])
        for c in range(count):
            own = np.flatnonzero(motion.labels == c)
            boxes[:, 0, c], boxes[:, 1, c] = corners[:, 0, own].min(axis=1), corners[:, 1, own].max(axis=1)
            low, high = fuzzy_boxes(corners[:, :, own].astype(np.float64), motion.matrices[:, c], origins[:, c])
            trees.append(accelerator.build(boxes_of(low, high), width))
            table["low"][:, c], table["high"][:, c] = low.min(axis=0), high.max(axis=0)
            members.append(own)
        parts, table["root"] = join_parts(trees, members)
        depth = 0 if isinstance(parts, common.KdTree) else max(tree.depth for tree in trees)
        return cls(parts.to(device), depth, table, boxes)

    def at(self, frame: int) -> FrameTrees:
        """The trees of a frame; only the upper one is built."""
        return FrameTrees.over(*self.boxes[frame], self.parts, self.table[frame], self.depth)  # type: ignore[call-arg]


def cluster_rows(matrices: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """(..., C) rows of `wrt.kernels.traversal.two_level.fuzzy_boxes.Cluster`, without roots and boxes.

    Args:
        matrices, origins: (..., C, 3, 3), (..., C, 3), relative to the scene's centre.
    """
    from wrt.kernels.traversal.two_level.fuzzy_boxes import Cluster

    rows: Any = np.zeros(origins.shape[:-1], dtype=Cluster.numpy_dtype())  # type: ignore[attr-defined]
    inverse = np.linalg.inv(matrices)
    rows["to_cluster"], rows["origin"] = inverse, origins
    rows["norm"] = 1.001 * np.abs(inverse).sum(axis=-1).max(axis=-1)
    return rows


def join_parts(trees: list[Any], members: list[np.ndarray]) -> tuple[common.Bvh | common.KdTree, np.ndarray]:
    """The trees of clusters side by side, and the root of each. members: as in `join_trees`."""
    from wrt.builders.bvh.update.bvh_grafting import join_trees
    from wrt.builders.convert.kdtree_links import pool_kdtrees

    if not isinstance(trees[0], common.KdTree):
        return join_trees(trees, members)
    pool, first = pool_kdtrees(trees, members), trees[0]
    nodes, primitive = wp.array(pool.nodes, dtype=wp.vec2i, device="cpu"), wp.array(pool.primitive, dtype=int, device="cpu")
    return replace(first, nodes=nodes, primitive=primitive), pool.roots


def as_frames(frames: Any, faces: Any) -> list[TriangleMesh]:
    """A mesh for each frame; all share their faces.

    Raises:
        TypeError, ValueError: as `TriangleMesh`; not an (F, V, 3) array, or no frame.
    """
    frames = host_array("frames", frames)
    if frames.ndim != 3 or not len(frames):
        raise ValueError(f"frames must be of shape (F, V, 3) with at least one frame, not {frames.shape}")
    first = TriangleMesh(frames[0], faces)
    return [first, *(moved_mesh(first, vertices) for vertices in frames[1:])]


def as_maps(transforms: Any, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """(F, B, 3, 3) and (F, B, 3) from matrices as `FuzzyScene` takes them.

    Raises:
        ValueError: a wrong shape, or maps that `wrt.Instance` refuses.
    """
    from wrt.meshes.instance import check_transform

    maps = as_numbers("transforms", transforms, finite=False)
    if maps.ndim != 4 or maps.shape[0] != frames or not maps.shape[1] or maps.shape[2:] != (4, 4):
        raise ValueError(f"transforms must be of shape ({frames}, B, 4, 4) for {frames} frames and B bones, not {maps.shape}")
    maps = np.array([check_transform(one, "transforms") for one in maps.reshape(-1, 4, 4)]).reshape(maps.shape)
    return maps[..., :3, :3], maps[..., :3, 3]


def triangle_corners(mesh: TriangleMesh, center: np.ndarray) -> np.ndarray:
    """(2, T, 3) float32: the corners of the triangles' boxes, rounded as in a `Scene`."""
    a, b, c = relative_to(center, mesh.vertices)[mesh.faces.T]
    return np.array([np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)])
