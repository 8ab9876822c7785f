"""Skins whose motion is not known in advance: fuzzy boxes from the limits of joints.

**Idea** (Guenther et al. 2006b). In the space of a bone, a triangle of the skin moves only by what its other bones do. They
are neighbours, and their joints have limits, so a box for all poses is small. Poses are sampled within the limits; each
triangle joins the bone in whose space it needs the smallest box, and a tree over the boxes of each bone serves all poses.

**What we changed.** Samples cannot show that no pose leaves a box. So every pose is checked: a triangle that leaves its box
enlarges it, and its bone's tree is built again. Hits are therefore right in every pose, even in one that no limit allows. Boxes
are enlarged by a margin, so that poses within the limits seldom leave them.

**Complexity.** Making: samples x triangles x bones. A pose: the skin and its boxes, linear in triangles.

References: guenther-2006-skinned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.facts.scene_state import Settings, new_mark
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.validation import as_int, as_numbers, as_real_array, first_bad
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import find_center, moved_mesh, place_meshes
from wrt.meshes.skeleton import Skeleton, skinned
from wrt.moving.fuzzy_scene import FrameTrees, FuzzyState, as_maps, check_kdtree, cluster_rows, join_parts, triangle_corners
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike

MARGIN = 0.05
"""Enlargement of a sampled box on each side, as a share of its longest side."""


class SkinnedScene(Scene):
    """A skin over bones: one tree for all poses that the limits of joints allow.

        skeleton = wrt.moving.Skeleton(parents, joints, limits)
        scene = wrt.moving.SkinnedScene(vertices, faces, weights, skeleton)
        scene.pose(skeleton.maps(angles))
        image = wrt.render(scene, camera)

    Hits are bit for bit those of a `wrt.Scene` of the skin in the pose. A pose that no limit allows is shown, too; the boxes of
    its triangles grow (`grown`). Rays are traced one at a time.

    Args:
        vertices: (V, 3) skin in the rest pose.
        faces: (T, 3) vertex indices.
        weights: (V, B) shares by which each vertex follows the bones; rows sum to 1.
        skeleton: the bones.
        samples: number of poses from which boxes are made.
        seed: of the samples.
        accelerator: a `wrt.Bvh` or `wrt.KdTree`: how the trees of bones are built.
        device, num_threads: as in `wrt.Scene`.

    Attributes:
        labels: (T,) int, the bone in whose tree each triangle is.
        grown: int, triangles that left their boxes in the last pose.

    Raises:
        TypeError, ValueError: bad vertices, faces, weights, samples, or an accelerator that does not fit.
    """

    labels: np.ndarray
    grown: int

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        weights: ArrayLike,
        skeleton: Skeleton,
        *,
        samples: int = 64,
        seed: int = 0,
        accelerator: Bvh | KdTree | None = None,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        settings = as_settings(accelerator or Bvh(), AUTO, device, num_threads)
        if not isinstance(settings.accelerator, Bvh):
            check_kdtree(settings.accelerator)
        samples, seed = as_int("samples", samples, 1), as_int("seed", seed, 0)
        self._rest, self._skeleton = TriangleMesh(vertices, faces), skeleton
        self._weights = check_weights(weights, self._rest.vertex_count, len(skeleton))
        with use_threads(settings.num_threads):
            self._boxes = SkinBoxes.of(self._rest, self._weights, skeleton.maps(skeleton.sample(samples, seed)))
            self.labels = self._boxes.labels
            self._trees: dict[int, Any] = {}
            self._pose(np.tile(np.eye(4), (len(skeleton), 1, 1)), settings, new_mark())

    def pose(self, maps: ArrayLike) -> None:
        """Shows a pose: later queries see the skin as it is in it.

        Args:
            maps: (B, 4, 4) maps of the bones from the rest pose, as `wrt.moving.Skeleton.maps` makes them.

        Raises:
            ValueError: a wrong shape, or maps that `wrt.Instance` refuses.
        """
        refuse_capture("showing another pose", self.device)
        matrices, origins = as_maps(as_real_array("maps", maps)[None], 1)
        if matrices.shape[1] != len(self._skeleton):
            raise ValueError(f"maps has {matrices.shape[1]} bones, but the skeleton has {len(self._skeleton)}")
        whole = np.zeros((len(self._skeleton), 4, 4))
        whole[:, :3, :3], whole[:, :3, 3], whole[:, 3, 3] = matrices[0], origins[0], 1.0
        with use_threads(self.num_threads):
            self._pose(whole, self.state.settings, self.state.mark)

    def _pose(self, maps: np.ndarray, settings: Settings, mark: str) -> None:
        mesh = moved_mesh(self._rest, skinned(self._rest.vertices.astype(np.float64), self._weights, maps))
        center = find_center((mesh,))
        corners, origins = triangle_corners(mesh, center), maps[:, :3, 3] - center
        self._boxes, grown, changed = self._boxes.grown(corners, maps[:, :3, :3], origins)
        shown = self._frame(corners, maps[:, :3, :3], origins, changed, settings)
        placed = place_meshes((mesh,), settings.device)
        self.grown = grown
        self.state = SkinnedState(
            settings=settings,
            meshes=(mesh,),
            center=placed.center,
            built_tree=shown,
            device_mesh=placed.fill_in(shown.low, shown.high),
            only_single=True,
            mark=mark,
        )

    def _frame(
        self, corners: np.ndarray, matrices: np.ndarray, origins: np.ndarray, changed: list[int], settings: Settings
    ) -> FrameTrees:
        """The trees in a pose. Those of bones whose boxes changed are built.

        Args:
            corners: (2, T, 3) of the triangles' boxes.
            matrices, origins: (B, 3, 3), (B, 3) relative to the scene's centre.
            changed: bones whose boxes changed, or that have no tree yet.
            settings: of the scene.
        """
        from wrt.builders.triangle_boxes import boxes_of

        used, width, device = self._boxes.used, native_width(settings.device), settings.device
        if changed or not self._trees:
            made = {bone: settings.accelerator.build(boxes_of(*self._boxes.of_bone(bone)), width) for bone in changed or used}
            self._trees = self._trees | made
            trees = [self._trees[bone] for bone in used]
            parts, roots = join_parts(trees, [np.flatnonzero(self.labels == bone) for bone in used])
            self._joined = parts.to(device), roots, max(getattr(tree, "depth", 0) for tree in trees)
        parts, roots, depth = self._joined
        rows = cluster_rows(matrices[used], origins[used])
        rows["root"] = roots
        bounds = [self._boxes.of_bone(bone) for bone in used]
        rows["low"], rows["high"] = [low.min(axis=0) for low, _ in bounds], [high.max(axis=0) for _, high in bounds]
        members = [self.labels == bone for bone in used]
        low = np.array([corners[0, own].min(axis=0) for own in members])
        high = np.array([corners[1, own].max(axis=0) for own in members])
        return FrameTrees.over(low, high, parts, rows, depth)


@dataclass(frozen=True, eq=False, kw_only=True)
class SkinnedState(FuzzyState):
    """The state of a skin in one pose."""

    refused: ClassVar[dict[str, str]] = FuzzyState.refused | {
        "update": "a skin follows its bones; call pose(maps), or make a wrt.Scene to update",
        "save": "trees of fuzzy boxes cannot be saved; save vertices, faces, weights and the skeleton",
        "pickle": "trees of fuzzy boxes cannot be pickled; pickle vertices, faces, weights and the skeleton",
    }


@dataclass
class SkinBoxes:
    """Fuzzy boxes of a skin.

    Attributes:
        labels: (T,) the bone of each triangle.
        low, high: (T, 3) float32 corners, each in the space of its triangle's bone.
    """

    labels: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, rest: TriangleMesh, weights: np.ndarray, maps: np.ndarray) -> SkinBoxes:
        """The boxes of sampled poses. maps: (S, B, 4, 4)."""
        from wrt.builders.motion_residuals import nearest_clusters

        frames = skinned(rest.vertices.astype(np.float64), weights, maps)
        labels, _ = nearest_clusters(frames, rest.faces, maps[..., :3, :3], maps[..., :3, 3])
        empty = np.full((len(labels), 3), np.inf, dtype=np.float32)
        boxes = cls(labels, empty, -empty)
        corners = frames[:, rest.faces]
        boxes._include(np.stack([corners.min(axis=2), corners.max(axis=2)], axis=1), maps[..., :3, :3], maps[..., :3, 3])
        margin = MARGIN * (boxes.high - boxes.low).max(axis=1, keepdims=True)
        boxes.low, boxes.high = boxes.low - margin, boxes.high + margin
        return boxes

    @property
    def used(self) -> list[int]:
        """The bones that have triangles."""
        return np.unique(self.labels).tolist()

    def of_bone(self, bone: int) -> tuple[np.ndarray, np.ndarray]:
        """The boxes of a bone's triangles."""
        own = self.labels == bone
        return self.low[own], self.high[own]

    def grown(self, corners: np.ndarray, matrices: np.ndarray, origins: np.ndarray) -> tuple[SkinBoxes, int, list[int]]:
        """The boxes with the triangles of a pose, how many were outside, and the bones to which those belong.

        Args:
            corners: (2, T, 3) of the triangles' boxes.
            matrices, origins: (B, 3, 3), (B, 3) of the bones.
        """
        larger = SkinBoxes(self.labels, self.low.copy(), self.high.copy())
        larger._include(corners[None].astype(np.float64), matrices[None], origins[None])
        outside = (larger.low < self.low).any(axis=1) | (larger.high > self.high).any(axis=1)
        return larger, int(outside.sum()), np.unique(self.labels[outside]).tolist()

    def _include(self, corners: np.ndarray, matrices: np.ndarray, origins: np.ndarray) -> None:
        """corners: (F, 2, T, 3); matrices, origins: (F, B, 3, 3), (F, B, 3)."""
        from wrt.builders.motion_clusters import fuzzy_boxes

        for bone in self.used:
            own = self.labels == bone
            low, high = fuzzy_boxes(corners[:, :, own], matrices[:, bone], origins[:, bone])
            self.low[own], self.high[own] = np.minimum(self.low[own], low), np.maximum(self.high[own], high)


def check_weights(weights: Any, vertices: int, bones: int) -> np.ndarray:
    """(V, B) float64.

    Raises:
        ValueError: another shape, negative weights or NaN, or rows that do not sum to 1.
    """
    weights = as_numbers("weights", weights, finite=False)
    if weights.shape != (vertices, bones):
        raise ValueError(f"weights must be of shape ({vertices}, {bones}), vertices by bones, not {weights.shape}")
    if bad := first_bad(~(weights >= 0.0), weights):
        raise ValueError(f"weights{bad}; weights must be at least 0")
    sums = weights.sum(axis=1)
    if bad := first_bad(~np.isclose(sums, 1.0, atol=1e-4), sums):
        raise ValueError(f"the sum of weights{bad}; weights must sum to 1 for each vertex")
    return weights
