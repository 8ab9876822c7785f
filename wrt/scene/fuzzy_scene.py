"""Animations known in advance: one tree of fuzzy boxes for all frames (`wrt.kernels.traversal.two_level.fuzzy_boxes`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.kernels.layout.mesh_placement import relative_to
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import check_index, find_center, moved_mesh, place_meshes
from wrt.scene.mesh_state import MeshState
from wrt.scene.scene import Scene
from wrt.state.query_kinds import AUTO
from wrt.state.scene_settings import as_settings
from wrt.state.scene_state import Settings, new_mark

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.builders.motion_clusters import Decomposition
    from wrt.kernels.traversal.two_level.fuzzy_boxes import FuzzyNodes

MOTION_TOLERANCE = 1e-3
"""Share of the animation's extent: no cluster is added once the residual motion enlarges no triangle's box by more."""


class FuzzyScene(Scene):
    """A mesh whose motion is known: one tree, built once, for all frames.

        scene = wrt.FuzzyScene(frames, faces)
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
        rest: the frame from which motion is measured, for `clusters`.
        accelerator: a `wrt.Bvh`: how the trees of clusters are built.
        device, num_threads: as in `wrt.Scene`.

    Attributes:
        frame: int, the frame shown; 0 at first.
        labels: (T,) int, the cluster of each triangle.

    Raises:
        TypeError, ValueError: bad frames, faces, numbers or maps.

    References:
        J. Guenther, H. Friedrich, I. Wald, H.-P. Seidel, P. Slusallek: Ray tracing animated scenes using motion
        decomposition. Computer Graphics Forum 25(3), 2006.
    """

    frame: int
    labels: np.ndarray

    def __init__(
        self,
        frames: Any,
        faces: Any,
        *,
        clusters: int = 16,
        transforms: Any = None,
        rest: int = 0,
        accelerator: Bvh | None = None,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        settings = as_settings(accelerator or Bvh(), AUTO, device, num_threads)
        if not isinstance(settings.accelerator, Bvh):
            raise TypeError(f"accelerator must be a wrt.Bvh, not {settings.accelerator!r}: fuzzy boxes overlap")
        with use_threads(settings.num_threads):
            self._meshes = as_frames(frames, faces)
            self._centers = np.array([find_center((mesh,)) for mesh in self._meshes])
            motion = find_motion(self._meshes, clusters, transforms, rest)
            self.labels = motion.labels
            self._fuzzy = FuzzyTree.build(self._meshes, self._centers, motion, settings.accelerator, settings.device)
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
        with use_threads(self.num_threads):
            self._show(check_index(frame, len(self._meshes), "frame"), self.state.settings, self.state.mark)

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

    refused: ClassVar[dict[str, str]] = {
        "update": "the frames of this scene are fixed; call show(frame), or make a wrt.Scene to update",
        "statistics": "a scene of fuzzy boxes has several trees; use wrt.Scene(scene.meshes).statistics() for the frame shown",
        "float64 vertices": "precise=True and gradients need a scene with a single tree; use wrt.Scene(scene.meshes)",
        "save": "trees of fuzzy boxes cannot be saved; save the frames, and make the scene from them",
        "pickle": "trees of fuzzy boxes cannot be pickled; pickle the frames, and make the scene from them",
        "handle": "kernels need the handle of a single tree; use wrt.Scene(scene.meshes).handle()",
    }


def find_motion(meshes: list[TriangleMesh], clusters: int, transforms: Any, rest: int) -> Decomposition:
    """The clusters of triangles and their motion; arguments and errors as of `FuzzyScene`."""
    from wrt.builders.motion_clusters import assign_triangles, decompose

    frames, faces = np.array([mesh.vertices for mesh in meshes], dtype=np.float64), meshes[0].faces
    if transforms is not None:
        return assign_triangles(frames, faces, *as_maps(transforms, len(frames)))
    if not (isinstance(clusters, (int, np.integer)) and clusters >= 1):
        raise ValueError(f"clusters is {clusters!r}; it must be a whole number of at least 1")
    if not (isinstance(rest, (int, np.integer)) and 0 <= rest < len(frames)):
        raise ValueError(f"rest is {rest!r}; it must be the number of a frame, from 0 to {len(frames) - 1}")
    bounds = np.array([mesh.bounds for mesh in meshes])
    extent = float((bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)).max())
    return decompose(frames, faces, clusters, MOTION_TOLERANCE * extent, rest)


@dataclass(frozen=True)
class FrameTrees:
    """The trees of a frame, with the interface that a scene needs of its tree.

    Attributes:
        top: tree over the boxes of clusters in the scene.
        parts: the trees of all clusters, in their own spaces.
        clusters: (C,) `wrt.kernels.traversal.two_level.fuzzy_boxes.Cluster`.
        depth: largest number of inner nodes on a path of any of the trees.
    """

    top: common.Bvh
    parts: common.Bvh
    clusters: wp.array
    depth: int

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

    def struct(self) -> FuzzyNodes:
        """The trees as a traversal kernel reads them."""
        from wrt.kernels.traversal.two_level.fuzzy_boxes import FuzzyNodes

        tree = FuzzyNodes()
        tree.top, tree.order, tree.parts = self.top.struct(), self.top.primitive, self.parts.struct()
        tree.clusters = self.clusters
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

    parts: common.Bvh
    depth: int
    table: np.ndarray
    boxes: np.ndarray

    @classmethod
    def build(
        cls, meshes: list[TriangleMesh], centers: np.ndarray, motion: Decomposition, accelerator: Bvh, device: wp.Device
    ) -> FuzzyTree:
        """Builds a tree over the fuzzy boxes of each cluster's triangles."""
        from wrt.builders.bvh.update.bvh_grafting import join_trees
        from wrt.builders.motion_clusters import fuzzy_boxes
        from wrt.builders.triangle_boxes import boxes_of
        from wrt.kernels.traversal.two_level.fuzzy_boxes import Cluster

        width, count = native_width(device), motion.matrices.shape[1]
        origins = motion.origins - centers[:, None]
        table = np.zeros((len(meshes), count), dtype=Cluster.numpy_dtype())
        inverse = np.linalg.inv(motion.matrices)
        table["to_cluster"], table["origin"] = inverse, origins
        table["stretch"] = 1.001 * np.abs(inverse).sum(axis=-1).max(axis=-1)
        boxes, trees, members = np.empty((len(meshes), 2, count, 3), dtype=np.float32), [], []
        corners = np.array([triangle_corners(mesh, center) for mesh, center in zip(meshes, centers, strict=True)])
        for c in range(count):
            own = np.flatnonzero(motion.labels == c)
            boxes[:, 0, c], boxes[:, 1, c] = corners[:, 0, own].min(axis=1), corners[:, 1, own].max(axis=1)
            low, high = fuzzy_boxes(corners[:, :, own].astype(np.float64), motion.matrices[:, c], origins[:, c])
            trees.append(accelerator.build(boxes_of(low, high), width))
            table["low"][:, c], table["high"][:, c] = low.min(axis=0), high.max(axis=0)
            members.append(own)
        parts, roots = join_trees(trees, members)
        table["root"] = roots
        return cls(parts.to(device), max(tree.depth for tree in trees), table, boxes)

    def at(self, frame: int) -> FrameTrees:
        """The trees of a frame; only the upper one is built."""
        from wrt.builders.triangle_boxes import boxes_of
        from wrt.kernels.traversal.two_level.fuzzy_boxes import Cluster

        device, width = self.parts.bounds.device, self.parts.width
        top = Bvh(width=width, max_leaf_triangles=1).build(boxes_of(*self.boxes[frame]), width).to(device)
        clusters = wp.array(self.table[frame], dtype=Cluster, device=device)
        return FrameTrees(top, self.parts, clusters, max(top.depth, self.depth))


def as_frames(frames: Any, faces: Any) -> list[TriangleMesh]:
    """A mesh for each frame; all share their faces.

    Raises:
        TypeError, ValueError: as `TriangleMesh`; not an (F, V, 3) array, or no frame.
    """
    frames = np.asarray(frames)
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

    maps = np.asarray(transforms, dtype=np.float64)
    if maps.ndim != 4 or maps.shape[0] != frames or not maps.shape[1] or maps.shape[2:] != (4, 4):
        raise ValueError(f"transforms must be of shape ({frames}, B, 4, 4) for {frames} frames and B bones, not {maps.shape}")
    maps = np.array([check_transform(one, "transforms") for one in maps.reshape(-1, 4, 4)]).reshape(maps.shape)
    return maps[..., :3, :3], maps[..., :3, 3]


def triangle_corners(mesh: TriangleMesh, center: np.ndarray) -> np.ndarray:
    """(2, T, 3) float32: the corners of the triangles' boxes, rounded as in a `Scene`."""
    a, b, c = relative_to(center, mesh.vertices)[mesh.faces.T]
    return np.array([np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)])
