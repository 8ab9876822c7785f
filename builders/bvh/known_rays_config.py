"""Configuration of a BVH build for known rays: costs, ray distribution, axes, and stop rules.

References: falcone-2024 (section 5.1).
"""

from dataclasses import dataclass, field

import warp as wp

from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.phases.split_axes import AxisChoice, AxisRules
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.influence.projected_cost import Mixture, RayDistribution
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH


@dataclass(frozen=True)
class NodeRules:
    """Rules that make a node a leaf, or split it without regard to the rays, before costs are compared.

    Attributes:
        leaf_cost, leaf_area, leaf_probability: thresholds. A node is a leaf if its cost as a leaf times its hit probability,
            its projected area (with several areas: its share of the scene's mean projected area), or its hit probability is at
            most the threshold, and a leaf may hold its triangles.
        max_depth: depth of the binary tree from which on nodes are halved, so that the tree is no deeper if possible; None for
            the depth that traversals support.
        aware_depth: depth of the binary tree from which on planes are chosen on the longest side, for rays in all directions;
            None for never.

    Raises:
        ValueError: a value is out of its range.
    """

    leaf_cost: float = 0.0
    leaf_area: float = 0.0
    leaf_probability: float = 0.0
    max_depth: int | None = None
    aware_depth: int | None = None

    def __post_init__(self) -> None:
        for name in ("leaf_cost", "leaf_area", "leaf_probability"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and not negative")
        if self.max_depth is not None and not 1 <= self.max_depth <= MAX_WIDE_DEPTH:
            raise ValueError(f"max_depth is {self.max_depth}; it must be None or from 1 to {MAX_WIDE_DEPTH}")
        if self.aware_depth is not None and self.aware_depth < 0:
            raise ValueError(f"aware_depth is {self.aware_depth}; it must be None or not negative")


@dataclass(frozen=True)
class ProjectedConfig:
    """Configuration of a build for known rays.

    Attributes:
        bvh: costs, bins, leaf size.
        rays: distribution of the rays.
        axes: axes of a node that are tried.
        nodes: early leaves and depths.
        spatial_splits: most additional references of spatial splits (`wrt.builders.bvh.spatial.spatial_build`), as a share of
            the triangles, from 0, which makes none, to MAX_SPATIAL_SPLITS.

    Raises:
        ValueError: spatial splits are out of range, or given together with a build on a subset.
    """

    bvh: BvhConfig
    rays: RayDistribution
    axes: AxisChoice = field(default_factory=AxisChoice)
    nodes: NodeRules = field(default_factory=NodeRules)
    spatial_splits: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.spatial_splits <= MAX_SPATIAL_SPLITS:
            raise ValueError(
                f"spatial_splits is {self.spatial_splits}; it must be from 0 to {MAX_SPATIAL_SPLITS}, additional references as "
                "a share of the triangles"
            )
        if self.spatial_splits > 0.0 and self.bvh.subset < 1.0:
            raise ValueError("spatial_splits and subset are both given; a build on a subset does not split triangles")

    @property
    def cost(self) -> SurfaceAreaCost:
        """The cost model."""
        return self.bvh.cost


MAX_SPATIAL_SPLITS = 4.0
"""Most additional references of spatial splits, as a share of the triangles."""

USED_FALLBACK = wp.constant(8)
"""Flag in `KnownRays.tried`: no axis of sufficient quality had an acceptable plane."""


@wp.struct
class KnownRays:
    """`ProjectedConfig` for a scene, for kernels."""

    mixture: Mixture
    axes: AxisRules
    leaf_cost: float
    leaf_probability: float
    max_depth: int
    aware_depth: int
    weight: wp.array(dtype=float)
    """(2 * triangles,) weight of each binary node, after the build of the binary tree."""
    parent_weight: wp.array(dtype=float)
    """(triangles,) weight of the node to which a pair belongs."""
    tried: wp.array(dtype=wp.uint8)
    """(2 * triangles,) for each binary node whose axes were chosen: bit k if axis k was tried, USED_FALLBACK; else 0."""


def known_rays(triangles: TriangleBoxes, config: ProjectedConfig, references: int | None = None) -> KnownRays:
    """Prepares the knowledge of the rays for a build; `references` are the most of its leaves, None for the triangles."""
    device, nodes = triangles.boxes.low.device, config.nodes
    count = triangles.count if references is None else references
    rays = KnownRays()
    rays.mixture = config.rays.mixture(triangles.low, triangles.high, triangles.center, device)
    rays.axes = config.axes.struct()
    rays.leaf_cost = nodes.leaf_cost
    rays.leaf_probability = nodes.leaf_probability
    if rays.mixture.area > 0.0:
        rays.leaf_probability = max(nodes.leaf_probability, nodes.leaf_area / rays.mixture.area)
    rays.max_depth = MAX_WIDE_DEPTH if nodes.max_depth is None else nodes.max_depth
    rays.aware_depth = MAX_WIDE_DEPTH + 1 if nodes.aware_depth is None else nodes.aware_depth
    rays.weight = wp.empty(2 * count, dtype=float, device=device)
    rays.parent_weight = wp.empty(count, dtype=float, device=device)
    rays.tried = wp.zeros(2 * count, dtype=wp.uint8, device=device)
    return rays
