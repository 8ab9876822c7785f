"""The top level of influence areas: an octree over their regions, and the triangles that touch each region.

**Octree** (Falcone 2024, section 5.5.2; `wrt.builders.influence.area_octree`). A leaf lists the areas whose regions touch it,
so a look-up misses no area. Near the surface of a region, a leaf also lists it for points outside. The thesis accepts these
points; here the look-up tests the region itself, because the hits depend on it. A depth of 0 gives the thesis' other structure:
an array of the regions with their boxes. A kd-tree (`wrt.builders.influence.area_kdtree`) may take the octree's place. A full
octree of d levels below the root has (8^(d + 1) - 1) / 7 cells.

**Triangles of an area.** All triangles whose boxes touch the region moved outward by `triangle_margin`; see
`wrt.kernels.influence.area_assignment` for the reason. The list contains every triangle that has a vertex, an edge or an
interior point in the region, and some of which only the box reaches into it.

References: falcone-2024 (sections 3.2, 3.3, 5.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.influence.area_kdtree import FacePlanes, cut_at
from wrt.builders.influence.area_octree import build_octree, cut_cells
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea
from wrt.builders.influence.regions import Frustum, Obb, Region, classify_boxes
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.influence.area_assignment import AreaTree, list_points
from wrt.kernels.influence.region_tests import DISJOINT
from wrt.kernels.influence.region_tests import Region as RegionStruct
from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime.launch import launch

MAX_AREAS = (1 << 16) - 2
"""Most influence areas of a scene: their numbers, and one value for none, have 16 bits."""

MAX_DEPTH = 8
"""Greatest depth of the octree: up to 19 million cells."""

MARGIN = 2.0**-17
"""Widening of a region for its triangles, relative to the greatest reach of a ray that starts in it: eight times the ray's
slack."""

LOOKUP_MARGIN = 2.0**-20
"""Rounding of a ray's origin, relative to the largest coordinate of the scene and of the point through which the rays pass."""


def region_of(area: InfluenceArea, low: np.ndarray, high: np.ndarray) -> Region:
    """The set of ray origins of an area: its cuboid, or its frustum extended to the apex, because rays of cameras start there.

    An area of infinite depth ends behind the scene.

    Args:
        area: the influence area.
        low, high: (3,) corners of the scene's box, in the scene's coordinates.
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


def lookup_margin(areas: Sequence[InfluenceArea], center: np.ndarray) -> float:
    """Widening of regions for the look-up, so that rounding its origin never takes a ray out of its area."""
    return LOOKUP_MARGIN * float(max(np.abs(center).max(), *(np.abs(area.position).max() for area in areas)))


def triangle_margin(region: Region, touch: float, low: np.ndarray, high: np.ndarray) -> float:
    """Greatest distance from the region to the box of a triangle that a ray inside it can meet, rounding included.

    Args:
        region: the region, not widened.
        touch: distance by which the look-up widens the region.
        low, high: (3,) corners of the scene's box, in the scene's coordinates.
    """
    corners = region.frame.widened(touch).corners
    return touch + MARGIN * float(np.abs([corners - low, corners - high]).max())


def triangles_in(region: Region, touch: float, triangles: TriangleBoxes) -> np.ndarray:
    """Ids, ascending, of the triangles whose boxes touch the widened region.

    Args:
        region: the region, not widened.
        touch: distance by which the look-up widens the region.
        triangles: boxes of all triangles, on the CPU.
    """
    low, high = triangles.low + triangles.center, triangles.high + triangles.center
    struct = region.struct(triangles.center, triangle_margin(region, touch, low, high))
    result = classify_boxes([struct], triangles.boxes.low.numpy().T, triangles.boxes.high.numpy().T)
    return np.flatnonzero(result[:, 0] != DISJOINT).astype(np.int32)


def select_boxes(triangles: TriangleBoxes, ids: np.ndarray) -> TriangleBoxes:
    """The boxes of the triangles `ids`, at least one."""
    boxes, device = Boxes(), triangles.boxes.low.device
    low, high = (np.ascontiguousarray(a.numpy()[:, ids]) for a in (triangles.boxes.low, triangles.boxes.high))
    boxes.low, boxes.high = (wp.array(a, dtype=float, device=device) for a in (low, high))
    faces = triangles.faces
    if faces is not None:
        faces = wp.array(faces.numpy()[ids], dtype=wp.vec3i, device=faces.device)
    corners = low.min(axis=1), high.max(axis=1)
    return TriangleBoxes(boxes, len(ids), *corners, triangles.center, triangles.vertices, faces, triangles.scene_size)


def renumber(tree: Bvh, ids: np.ndarray, triangles: TriangleBoxes) -> Bvh:
    """Renumbers a tree over the triangles `ids` to the ids and the box of the whole scene.

    Ascending ids keep the order of hits at equal t. The scene's box keeps each ray's slack, and therefore every bit of a hit.
    """
    local = tree.primitive.numpy()
    primitive = np.where(local < 0, -1, ids[local]).astype(np.int32)
    device = tree.primitive.device
    low, high = wp.vec3(*triangles.low), wp.vec3(*triangles.high)
    primitives = wp.array(primitive, dtype=int, device=device)
    return replace(tree, primitive=primitives, low=low, high=high)


class TopLevel:
    """Finds the influence areas of a point or a ray.

    Attributes:
        cells: number of cells of all levels of the octree.
        lists: number of distinct lists of areas.
        struct: the structure for kernels.

    Args:
        areas: influence areas in order of precedence: a look-up returns the first that matches.
        regions: their regions, in the scene's coordinates.
        touch: distance by which regions are widened.
        depth: most levels of the octree below its root; 0 for an array. A kd-tree has up to three times as many.
        sine: sine of the greatest angle between a ray that belongs to the area and the area's ray through its origin.
        center: (3,) the scene's centre.
        device: device on which rays look areas up.
        is_kdtree: whether cells are cut in two (`wrt.builders.influence.area_kdtree`) and not into octants.
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
        is_kdtree: bool = False,
    ) -> None:
        self.center, self.device = center, device
        structs = [region.struct(center, touch) for region in regions]
        low, high = np.min([struct.low for struct in structs], axis=0), np.max([struct.high for struct in structs], axis=0)
        size = (high - low).max() * (1.0 + MARGIN)  # keeps the faces of regions strictly inside the cube
        planes, high = np.empty(0), low + size
        if is_kdtree and depth > 0:
            cuts = FacePlanes(structs)
            child, lists = build_octree(structs, low, high, depth * cuts.steps, cuts)
            planes = np.concatenate(cuts.planes)
        else:
            child, lists = build_octree(structs, low, high, depth)
        self.cells, self.lists = len(child), lists
        tree = AreaTree()
        tree.regions = wp.array(structs, dtype=RegionStruct, device=device)
        tree.views = wp.array([area.view(center) for area in areas], dtype=AreaView, device=device)
        tree.sine = sine
        tree.touch = touch
        tree.low, tree.cells, tree.depth = wp.vec3d(*low), 2.0**depth / size, depth
        tree.high, tree.plane = wp.vec3d(*high), wp.array(planes, dtype=wp.float64, device=device)
        tree.child = wp.array(child, dtype=int, device=device)
        tree.begin = wp.array(np.cumsum([0] + [len(entry) for entry in lists]), dtype=int, device=device)
        tree.area = wp.array(np.concatenate(lists), dtype=int, device=device)
        self.struct = tree

    @property
    def bytes(self) -> int:
        """Bytes of the cells and lists."""
        return sum(array.capacity for array in (self.struct.child, self.struct.plane, self.struct.begin, self.struct.area))

    @property
    def is_kdtree(self) -> bool:
        """Whether cells are cut in two."""
        return len(self.struct.plane) > 0

    @property
    def root(self) -> tuple[np.ndarray, np.ndarray]:
        """(1, 3) corners of the root, relative to the scene's centre."""
        return np.array(self.struct.low)[None], np.array(self.struct.high)[None]

    def divide(self, cells: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The children of inner cells, given with their corners, (N, 3), and their corners, in the order of the parents."""
        words = self.struct.child.numpy()[cells]
        if not self.is_kdtree:
            return (words[:, None] + np.arange(8)).ravel(), *cut_cells(low, high)
        planes = self.struct.plane.numpy()[cells]
        return ((words >> 2)[:, None] + np.arange(2)).ravel(), *cut_at(low, high, words & 3, planes)

    def candidates(self, points: np.ndarray) -> np.ndarray:
        """(N, areas) bool for (N, 3) points: the areas that the leaf around each point lists."""
        flat = wp.array(points - self.center, dtype=wp.vec3d, device=self.device)
        numbers = wp.empty(len(points), dtype=int, device=self.device)
        launch(list_points, len(points), [self.struct, flat, numbers], device=self.device, chunk=4096)
        table = np.zeros((len(self.lists) + 1, len(self.struct.regions)), dtype=bool)
        for row, areas in zip(table, self.lists, strict=False):
            row[areas] = True
        return table[numbers.numpy()]  # -1, for points outside the root, selects the last row
