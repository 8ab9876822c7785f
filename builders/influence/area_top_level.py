"""The top level of influence areas: an octree over their regions, and which triangles touch each.

**Octree** (Falcone 2024, section 5.5.2; `wrt.builders.influence.area_octree`). A leaf lists the areas whose regions touch it,
so no area is ever missing. Near the surface of a region a leaf lists it for points outside too; the thesis lets them pass, here
the look-up tests the region itself, on which the hits depend. A depth of 0 is the thesis' other structure, an array of the
regions with a box around each. A full tree of d levels below the root has (8^(d + 1) - 1) / 7 cells.

**Triangles of an area.** All whose boxes touch the region moved outward by `margin_of`; see
`wrt.kernels.influence.area_assignment` for why. A triangle with a vertex, an edge or its interior in the region is among them,
and some whose box alone reaches in.

References:
    L. Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing. MSc thesis,
        Politecnico di Milano, 2024 (sections 3.2, 3.3, 5.5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wrt.builders.influence.area_octree import build_octree
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea
from wrt.builders.influence.regions import Frustum, Obb, Region, classify_boxes
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.influence.area_assignment import AreaTree, list_points
from wrt.kernels.influence.region_tests import APART
from wrt.kernels.influence.region_tests import Region as RegionStruct
from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime.launch import launch

MAX_AREAS = (1 << 16) - 2
"""Areas of a scene: their numbers, and one for none, are 16 bits."""

MAX_DEPTH = 8
"""Greatest depth of the octree: up to 19 million cells."""

MARGIN = 2.0**-17
"""By which regions are widened, as a share of the greatest reach of a ray that starts in them: eight times its slack."""

TOUCH = 2.0**-20
"""Rounding of a ray's origin, as a share of the largest coordinate of the scene and of the point that rays go through."""


def region_of(area: InfluenceArea, low: np.ndarray, high: np.ndarray) -> Region:
    """Where the rays of an area start: its cuboid, or its frustum from the apex on, as rays of cameras start there.

    An area without an end ends behind the scene.

    Args:
        low, high: corners of the scene's box, in the scene's coordinates.
    """
    forward, up = area.frame[2], tuple(area.frame[1])
    corners = np.where(forward > 0.0, high, low)  # the farthest
    behind = float(forward @ (corners - area.position)) + float(np.linalg.norm(high - low))
    if isinstance(area, PlaneInfluenceArea):
        depth = min(area.depth, max(behind, 0.0))
        center = np.array(area.position) + depth / 2 * forward
        half = (area.width / 2, area.height / 2, depth / 2)
        return Obb(center=tuple(center), half_size=half, forward=tuple(forward), up=up)
    far = min(area.far, max(behind, area.near * 2))
    return Frustum(eye=area.position, forward=tuple(forward), fov_x=area.fov[0], fov_y=area.fov[1], near=0.0, far=far, up=up)


def touch_of(areas: Sequence[InfluenceArea], center: np.ndarray) -> float:
    """By how much regions are widened for the look-up, so that no rounding of its origin takes a ray out of its area."""
    return TOUCH * float(max(np.abs(center).max(), *(np.abs(area.position).max() for area in areas)))


def margin_of(region: Region, touch: float, low: np.ndarray, high: np.ndarray) -> float:
    """How far from the region a triangle's box may lie which a ray that is still inside can meet, rounding included.

    Args:
        touch: by how much the look-up widens the region.
        low, high: corners of the scene's box, in the scene's coordinates.
    """
    corners = region.frame.widened(touch).corners
    return touch + MARGIN * float(np.abs([corners - low, corners - high]).max())


def triangles_in(region: Region, touch: float, triangles: TriangleBoxes) -> np.ndarray:
    """Ids, ascending, of the triangles whose boxes touch the widened region.

    Args:
        touch: by how much the look-up widens the region.
        triangles: on the CPU.
    """
    low, high = triangles.low + triangles.center, triangles.high + triangles.center
    struct = region.struct(triangles.center, margin_of(region, touch, low, high))
    result = classify_boxes([struct], triangles.boxes.low.numpy().T, triangles.boxes.high.numpy().T)
    return np.flatnonzero(result[:, 0] != APART).astype(np.int32)


def boxes_of(triangles: TriangleBoxes, ids: np.ndarray) -> TriangleBoxes:
    """The boxes of some triangles, at least one."""
    boxes, device = Boxes(), triangles.boxes.low.device
    low, high = (np.ascontiguousarray(a.numpy()[:, ids]) for a in (triangles.boxes.low, triangles.boxes.high))
    boxes.low, boxes.high = (wp.array(a, dtype=float, device=device) for a in (low, high))
    return TriangleBoxes(boxes, len(ids), low.min(axis=1), high.max(axis=1), triangles.center)


def renumber(tree: Bvh, ids: np.ndarray, triangles: TriangleBoxes) -> Bvh:
    """A tree over some triangles, with their numbers among all and the box of all.

    Ascending ids keep the order of hits at the same t; the box keeps each ray's slack, and with it every bit of a hit.
    """
    local = tree.primitive.numpy()
    primitive = np.where(local < 0, -1, ids[local]).astype(np.int32)
    device = tree.primitive.device
    low, high = wp.vec3(*triangles.low), wp.vec3(*triangles.high)
    primitives = wp.array(primitive, dtype=int, device=device)
    return Bvh(tree.bounds, tree.child, primitives, low, high, tree.width, tree.level_first, tree.stats)


class TopLevel:
    """Finds the influence areas of a point or a ray.

    Attributes:
        cells: cells of all levels of the octree.
        lists: different lists of areas.
        struct: for kernels.

    Args:
        areas: in the order in which they are to be found.
        regions: of the areas, in the scene's coordinates.
        touch: by how much regions are widened.
        depth: levels of the octree below its root at most; 0 for an array.
        sine: of the greatest angle between an affine ray and the area's ray through its origin.
        center: of the scene.
        device: where rays will look areas up.
    """

    def __init__(
        self,
        areas: Sequence[InfluenceArea],
        regions: Sequence[Region],
        touch: float,
        depth: int,
        sine: float,
        center: np.ndarray,
        device: wp.Device,
    ) -> None:
        self.center, self.device = center, device
        structs = [region.struct(center, touch) for region in regions]
        low, high = np.min([struct.low for struct in structs], axis=0), np.max([struct.high for struct in structs], axis=0)
        size = (high - low).max() * (1.0 + MARGIN)  # the faces of regions are inside, not on the cube's
        child, lists = build_octree(structs, low, low + size, depth)
        self.cells, self.lists = len(child), lists
        tree = AreaTree()
        tree.regions = wp.array(structs, dtype=RegionStruct, device=device)
        tree.views = wp.array([area.view(center) for area in areas], dtype=AreaView, device=device)
        tree.sine = sine
        tree.touch = touch
        tree.low, tree.cells, tree.depth = wp.vec3d(*low), 2.0**depth / size, depth
        tree.child = wp.array(child, dtype=int, device=device)
        tree.begin = wp.array(np.cumsum([0] + [len(entry) for entry in lists]), dtype=int, device=device)
        tree.area = wp.array(np.concatenate(lists), dtype=int, device=device)
        self.struct = tree

    @property
    def bytes(self) -> int:
        """Memory of the cells and lists."""
        return sum(array.capacity for array in (self.struct.child, self.struct.begin, self.struct.area))

    def candidates(self, points: np.ndarray) -> np.ndarray:
        """(N, areas) bool for (N, 3) points: which areas the leaf around each lists."""
        flat = wp.array(points - self.center, dtype=wp.vec3d, device=self.device)
        numbers = wp.empty(len(points), dtype=int, device=self.device)
        launch(list_points, len(points), [self.struct, flat, numbers], device=self.device, chunk=4096)
        table = np.zeros((len(self.lists) + 1, len(self.struct.regions)), dtype=bool)
        for row, areas in zip(table, self.lists, strict=False):
            row[areas] = True
        return table[numbers.numpy()]  # -1, for outside the root, is the last row
