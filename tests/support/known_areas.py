"""Areas that all rays come from, and rays from them."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from support.built_bvhs import arrays_of
from wrt.builders.bvh import projected_binned as projected
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.known_rays_config import NodeRules, ProjectedConfig
from wrt.builders.bvh.phases.split_axes import AXIS_CHOICES, AxisChoice
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.influence.influence_area import InfluenceArea, PointInfluenceArea
from wrt.builders.influence.projected_cost import RayDistribution
from wrt.builders.triangle_boxes import triangle_boxes


def window(area: InfluenceArea) -> tuple[float, float]:
    """Half its width and height, where pictures are measured."""
    return area.tangents if isinstance(area, PointInfluenceArea) else (area.width / 2, area.height / 2)


def picture(area: InfluenceArea, low: np.ndarray, high: np.ndarray):
    """A box's picture by the library, in float64: convex hull of its corners, and of its edges' ends at the near plane."""
    corners = np.array([[(high if c >> axis & 1 else low)[axis] for axis in range(3)] for c in range(8)], dtype=np.float64)
    seen = (corners - area.position) @ area.frame.T
    near = getattr(area, "near", 0.0)
    points = [p for p in seen if p[2] >= near]
    for a in range(8):
        for b in (a | 1, a | 2, a | 4):
            if (seen[a, 2] >= near) != (seen[b, 2] >= near):
                share = (near - seen[a, 2]) / (seen[b, 2] - seen[a, 2])
                points.append(np.append((seen[a] + share * (seen[b] - seen[a]))[:2], near))
    flat = [p[:2] / p[2] if isinstance(area, PointInfluenceArea) else p[:2] for p in points]
    shapely = pytest.importorskip("shapely", reason="shapely is not installed: pip install 'wrt[test-all]'")
    return shapely.MultiPoint(flat).convex_hull


AREA_KINDS = ("plane along an axis", "plane", "point", "point inside")


def area_of(mesh: wrt.TriangleMesh, kind: str):
    """An influence area that sees most of a mesh, or, from the inside, a part of it."""
    low, high = mesh.bounds
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    if kind.startswith("plane"):
        direction = np.array((0.0, 0.0, -1.0) if kind.endswith("axis") else (0.4, -0.5, -0.8))
        start = middle - direction * size
        return wrt.known_rays.PlaneInfluenceArea(
            position=start, direction=direction, width=0.6 * size, height=0.7 * size, depth=3 * size
        )
    if kind == "point":
        start = middle + size * np.array([0.3, -0.9, 0.5])
        return wrt.known_rays.PointInfluenceArea(
            position=start, direction=middle - start, fov=(50, 40), near=0.1 * size, far=3 * size
        )
    direction = (1.0, 0.2, -0.3)
    return wrt.known_rays.PointInfluenceArea(
        position=middle, direction=direction, fov=(120, 100), near=0.02 * size, far=3 * size
    )


def rays_of(area, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays of an area, spread evenly over its window: origins and directions, float64."""
    right, up, forward = area.frame
    half = np.array(window(area))
    across = np.random.default_rng(seed).uniform(-half, half, (count, 2)) @ np.array([right, up])
    if isinstance(area, wrt.known_rays.PointInfluenceArea):
        return np.array(area.position) + area.near * (across + forward), across + forward
    return np.array(area.position) + across, np.broadcast_to(forward, (count, 3)).copy()


def config_of(areas, axes: str | AxisChoice = "all", width: int = 8, others: float = 1e-3, shares=None, **options):
    nodes = NodeRules(**{k: options.pop(k) for k in tuple(options) if k in NodeRules.__dataclass_fields__})
    bvh = BvhConfig(SurfaceAreaCost(width=width), **options)
    axes = AXIS_CHOICES[axes] if isinstance(axes, str) else axes
    return ProjectedConfig(bvh, RayDistribution(areas, shares, others), axes, nodes)


def build(mesh: wrt.TriangleMesh, *args, **options):
    config = config_of(*args, **options)
    return projected.build(triangle_boxes(*arrays_of(mesh)), config), config


def random_areas(count: int, low: np.ndarray, high: np.ndarray, seed: int = 0) -> list:
    """Plane and point areas of all sizes about a box."""
    rng = np.random.default_rng(seed)
    size = np.ptp([low, high], axis=0).max()
    areas = []
    for number in range(count):
        position, direction = rng.uniform(low - 0.2 * size, high + 0.2 * size), rng.normal(size=3)
        if number % 2:
            width, height, depth = size * rng.uniform(0.1, 0.8, 3)
            areas.append(
                wrt.known_rays.PlaneInfluenceArea(
                    position=position, direction=direction, width=width, height=height, depth=depth
                )
            )
        else:
            fov, far = rng.uniform(10, 140, 2), size * rng.uniform(0.2, 1)
            areas.append(
                wrt.known_rays.PointInfluenceArea(position=position, direction=direction, fov=fov, near=0.1 * far, far=far)
            )
    return areas


def areas_of(mesh) -> list:
    """A light from above with an edge through the middle of the mesh, a lamp beside it, a lamp in it, and one far away."""
    low, high = mesh.bounds
    center, size = (low + high) / 2, high - low
    extent = float(size.max())
    sun = wrt.known_rays.PlaneInfluenceArea(
        position=center + size * (0.25, 0, 1),
        direction=(0, 0, -1),
        width=size[0] / 2,
        height=extent,
        depth=1.2 * size[2],
    )
    lamp = wrt.known_rays.PointInfluenceArea(
        position=center + extent * np.array([-1, 0.1, 1]), direction=(1, 0, -1), fov=(40, 70), near=0.1 * extent, far=np.inf
    )
    inner = wrt.known_rays.PointInfluenceArea(
        position=center, direction=(0.2, 1, 0.1), fov=(120, 90), near=1e-3 * extent, far=0.4 * extent
    )
    nowhere = wrt.known_rays.PointInfluenceArea(position=high + 9 * extent, direction=(1, 1, 1), fov=(9, 9), near=1.0, far=2.0)
    return [sun, lamp, nowhere, inner]


def described(mesh: wrt.TriangleMesh, kind: str = "point", share: float = 0.5, **options) -> wrt.known_rays.ProjectedBvh:
    """A tree for known rays with spatial splits."""
    return wrt.known_rays.ProjectedBvh(areas=area_of(mesh, kind), width=8, spatial_splits=share, **options)
