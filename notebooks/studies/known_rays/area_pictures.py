"""What the figures 6.15, 6.19, 6.20 and 6.23 of Falcone 2024 show, as polygons in the window of an influence area.

projected    the hull of a box as the area's rays see it
shared       6.20: what two hulls share, whose area is the overlap of siblings
uneven_node  6.19: a node that was split into a tiny and a huge child, which overlap
missed       6.15: where the rays are that leave an area without a hit
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from studies.known_rays.ray_cases import Case
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea
from wrt.known_rays.tree_analysis import TreeAnalysis
from wrt.scene.scene import Scene

LEAST = 24
"""Triangles below a node that is looked at for `uneven_node`."""


def hull(points: np.ndarray) -> np.ndarray:
    """(K, 2) corners of the convex hull of (N, 2) points, counter-clockwise (Andrew's chains)."""
    ordered = np.unique(points, axis=0)
    chains = []
    for run in (ordered, ordered[::-1]):
        chain: list[np.ndarray] = []
        for point in run:
            while len(chain) > 1 and turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains)


def turn(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
    """Twice the signed area of a triangle; above 0 to the left."""
    return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))


def polygon_area(polygon: np.ndarray) -> float:
    """Area of a polygon (K, 2), counter-clockwise; 0 of none."""
    if len(polygon) < 3:
        return 0.0
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def projected(area: InfluenceArea, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(K, 2) hull of a box in the plane of the area's window, of a point area at depth 1; the box is in front of it."""
    corners = np.array([np.where([k & 1, k & 2, k & 4], high, low) for k in range(8)])
    seen = (corners - np.array(area.position)) @ area.frame.T
    return hull(seen[:, :2] if isinstance(area, PlaneInfluenceArea) else seen[:, :2] / seen[:, 2:])


def shared(polygon: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(K, 2) what two convex polygons share, by Sutherland and Hodgman; empty if nothing."""
    for p, q in zip(other, np.roll(other, -1, axis=0), strict=True):
        kept: list[np.ndarray] = []
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            inside, next_inside = turn(p, q, a), turn(p, q, b)
            if inside >= 0.0:
                kept.append(a)
            if (inside >= 0.0) != (next_inside >= 0.0):
                kept.append(a + (b - a) * inside / (inside - next_inside))
        if not kept:
            return np.empty((0, 2))
        polygon = np.array(kept)
    return polygon


@dataclass(frozen=True)
class Siblings:
    """A node and its two children: numbers of boxes in `TreeAnalysis.boxes`, and the triangles in each child."""

    node: int
    small: int
    big: int
    triangles: tuple[int, int]


def triangles_below(found: TreeAnalysis) -> np.ndarray:
    """(boxes,) triangles of all leaves in each box."""
    boxes = found.boxes
    totals = boxes.triangles.astype(np.int64)
    for box in np.argsort(-boxes.level, kind="stable"):
        if boxes.parent[box] >= 0:
            totals[boxes.parent[box]] += totals[box]
    return totals


def uneven_node(found: TreeAnalysis) -> Siblings:
    """The node of at least `LEAST` triangles whose children differ the most in triangles times overlap; of a binary tree.

    Raises:
        ValueError: the tree has no such node.
    """
    boxes, totals = found.boxes, triangles_below(found)
    best, most = None, 0.0
    for node in np.flatnonzero(~boxes.is_leaf & (totals >= LEAST)):
        pair = np.flatnonzero(boxes.parent == node)
        if len(pair) == 2 and np.isfinite(boxes.overlap[node]):
            small, big = sorted(pair.tolist(), key=lambda box: totals[box])
            worth = float(boxes.overlap[node]) * totals[big] / totals[small]
            if worth > most:
                best, most = Siblings(int(node), small, big, (int(totals[small]), int(totals[big]))), worth
    if best is None:
        raise ValueError(f"no node of the tree has {LEAST} triangles and two children that overlap")
    return best


def missed(case: Case, reach: float, count: int = 4096) -> tuple[np.ndarray, np.ndarray, float]:
    """Rays of an area that ends within the scene.

    Args:
        case: whose area is shortened.
        reach: its end, as a share of the way through the scene and behind it.
        count: rays.

    Returns:
        (count, 2) where rays cross the window, of a point area at depth 1; (count,) 0 for a hit within the area, 1 for one
        behind it, which the whole scene's tree finds, 2 for none; and the share of the first.
    """
    area = case.area
    name, end = ("depth", area.depth) if case.kind == "plane" else ("far", area.far)
    short = replace(area, **{name: reach * end})
    scene = Scene(case.mesh, RayAwareBvh(areas=[short], whole=Bvh(width=2)), device="cpu")
    rays = case.rays(count)
    hits = scene.intersect(rays)
    points = np.broadcast_to(rays.origins, rays.directions.shape)
    ahead = (points - area.position) @ area.frame.T
    along = rays.directions @ area.frame.T
    across = ahead[:, :2] if case.kind == "plane" else along[:, :2] / along[:, 2:]
    depth = ahead[:, 2] + hits.t * along[:, 2]
    state = np.where(~hits.is_hit, 2, np.where(depth <= reach * end, 0, 1))
    return across, state, float((state == 0).mean())
