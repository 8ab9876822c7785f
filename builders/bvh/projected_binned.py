"""Binned build of a bounding volume hierarchy for rays whose directions are known: projected areas, chosen axes.

**Problem.** The binned build weighs boxes by surface area and tries the planes of all axes (`binned`). For the rays of
influence areas, boxes have other weights (`wrt.builders.influence.projected_cost`), and some axes are rarely useful
(`split_axes`).

**Algorithm.** The loops are those of the binned build. For each axis that is tried, a sweep over its bins writes the boxes on
both sides of every plane, component by component. These are weighed in vector lanes, one box per lane, for every kind of area
and whether or not the window or the near plane cuts them. The collapse to wide nodes weighs each box once (`weigh_nodes`).

**Data.** That of the binned build; `KnownRays` has the weights of the nodes.

**Phases** of a node: those of the binned build, with `cheapest_by_projection` as search and `is_cheap_leaf` as an additional
stop rule.

**Complexity.** That of the binned build, times the number of influence areas.

**What we changed.** The published build handles one area and is recursive. Where no other axis is acceptable, it weighs the
planes of the longest side by surface area; see `split_axes`.

References: falcone-2024; wald-2007-sah.
"""

from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.bvh.binned_bvh import BinnedBuilder
from wrt.builders.bvh.bvh_config import MAX_BINS, BuildRules
from wrt.builders.bvh.known_rays_config import USED_FALLBACK, KnownRays, ProjectedConfig, known_rays
from wrt.builders.bvh.phases.bin_heuristic import Heuristic
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, halvings, split_cost
from wrt.builders.bvh.phases.bvh_bins import SLOT_BINS, Binning, Plane, Scratch, no_plane
from wrt.builders.bvh.phases.split_axes import axis_order, longest_axis
from wrt.builders.cost import leaf_cost
from wrt.builders.influence.projected_cost import Mixture, box_weight, facing, half_surface
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.influence.box_clipping import clipped_areas
from wrt.kernels.influence.box_projection import NEEDS_NEAR, NEEDS_WINDOW, whole_areas
from wrt.kernels.layout.unchecked import load_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY

SIDES = 2 * MAX_BINS
"""Boxes per axis: the union of all bins before each bin, and the union of each bin and all after it."""

BOX_FLOATS = 6 * SIDES


@wp.struct
class AxisSearch:
    """The best plane so far."""

    plane: Plane
    hits: float
    """Sum of the hit probabilities of its children, over the node's."""


@wp.func
def low_of(tree: BinaryTree, node: int):
    """Lower corner of a node's box."""
    return wp.vec3(tree.box[node * 8], tree.box[node * 8 + 1], tree.box[node * 8 + 2])


@wp.func
def high_of(tree: BinaryTree, node: int):
    """Upper corner of a node's box."""
    return -wp.vec3(tree.box[node * 8 + 4], tree.box[node * 8 + 5], tree.box[node * 8 + 6])


# -- search --------------------------------------------------------------------------------------------------------------


@native.func_native(
    "bins.h",
    f"const size_t base = (size_t)slot * {SLOT_BINS} + axis * bins;\n"
    "const int* counts = scratch.count.data + base;\n"
    "float* grid = scratch.box.data + base * 8;\n"
    "wrt::sweep_axis(grid, counts, scratch.left.data + base, bins, others, boxes.data, weights.data);",
)
def sweep_axis(
    scratch: Scratch,
    slot: int,
    axis: int,
    bins: int,
    others: float,
    boxes: wp.array(dtype=float),
    weights: wp.array(dtype=float),
):
    """Computes boxes and counts on both sides of the planes of an axis, and the surface-area part of their weights.

    boxes: lower x of all boxes, then lower y, lower z, upper x, upper y, upper z. First the boxes on the left of each bin, then
    the boxes from each bin on. The box of bin 0 and all bins after it is the node's."""


@native.func_native(
    "lanes.h",
    f"""
    bool by_window = false, by_near = false;
    for (int i = 0; i < count; ++i) {{
        by_window |= areas.data[i] == {float(NEEDS_WINDOW)}f;
        by_near |= areas.data[i] == {float(NEEDS_NEAR)}f;
    }}
    return by_near ? {float(NEEDS_NEAR)}f : by_window ? {float(NEEDS_WINDOW)}f : 0.0f;
""",
)
def areas_needed(areas: wp.array(dtype=float), count: int) -> float:
    """The most complete clipping that any of the boxes needs: NEEDS_NEAR, NEEDS_WINDOW, or 0.0 for none."""


@wp.func
def add_projected(mixture: Mixture, count: int, boxes: wp.array(dtype=float), weights: wp.array(dtype=float)):
    """Adds the projected areas of boxes in the layout of `sweep_axis` to their weights."""
    areas = wp.zeros(shape=(SIDES,), dtype=float)
    for v in range(mixture.weighed):
        view = mixture.views[v]
        factor = mixture.factor[v]
        whole_areas(view, boxes, count, areas)
        needed = areas_needed(areas, count)
        if needed < 0.0:
            clipped_areas(view, boxes, count, needed == NEEDS_NEAR, areas)
        for i in range(count):
            weights[i] += factor * areas[i]


@wp.func
def try_axis(
    rules: BuildRules,
    scratch: Scratch,
    slot: int,
    axis: int,
    bins: int,
    count: int,
    weights: wp.array(dtype=float),
    best: AxisSearch,
):
    """`best`, or the plane of least cost of an axis if that costs less; ties go to the smaller bin.

    weights: of the boxes on both sides of the planes, as in `sweep_axis` and `add_projected`."""
    first = slot * SLOT_BINS + axis * bins
    for b in range(1, bins):
        left = load_int(scratch.left, first + b)
        if left > 0 and left < count:
            cost = split_cost(weights[b], leaf_cost(rules.cost, left), weights[bins + b], leaf_cost(rules.cost, count - left))
            if cost < best.plane.cost:
                best.plane.cost = cost
                best.plane.axis = axis
                best.plane.bin = b
                best.plane.left = left
                best.hits = (weights[b] + weights[bins + b]) / weights[bins]
    return best


@wp.func
def mixture_at(rays: KnownRays, depth: int):
    """The mixture for a depth: surface areas alone from `aware_depth` on."""
    mixture = rays.mixture
    if depth >= rays.aware_depth:
        mixture.weighed = 0
        mixture.others = 1.0
    return mixture


@wp.func
def cheapest_by_projection(
    rules: BuildRules, rays: KnownRays, binning: Binning, scratch: Scratch, slot: int, tree: BinaryTree, frame: Frame
):
    """The plane of least cost on the axes that are tried (Falcone 2024, Algorithm 5.1)."""
    best = AxisSearch()
    best.plane = no_plane()
    if frame.depth + halvings(frame.count) < rays.max_depth:
        boxes = wp.zeros(shape=(BOX_FLOATS,), dtype=float)
        weights = wp.zeros(shape=(SIDES,), dtype=float)
        low = low_of(tree, frame.node)
        high = high_of(tree, frame.node)
        mixture = mixture_at(rays, frame.depth)
        order = axis_order(rays.axes, high - low, facing(mixture, 0.5 * (low + high)), frame.depth)
        longest = longest_axis(high - low)
        unaware = frame.depth >= rays.aware_depth
        tried = int(0)
        last = bool(False)
        i = int(0)
        while i < 6:  # the axes in their order; then all of them, if no plane has been found
            axis = wp.where(i < 3, order.axis[i % 3], i - 3)
            found = best.plane.cost < INFINITY
            if i < 3:
                last = unaware or order.quality[i] < rays.axes.least_quality
                axis = wp.where(last, longest, axis)
                done = found and (best.hits <= rays.axes.excellent or (last and best.hits <= rays.axes.acceptable))
                i = wp.where(done, 6, i)
            else:
                i = wp.where(found, 6, i)
            if i < 6 and (tried >> axis) & 1 == 0:
                sweep_axis(scratch, slot, axis, binning.bins, mixture.others, boxes, weights)
                add_projected(mixture, 2 * binning.bins, boxes, weights)
                best = try_axis(rules, scratch, slot, axis, binning.bins, frame.count, weights, best)
                tried |= 1 << axis
            if i < 3 and last:
                tried |= USED_FALLBACK
            i = wp.where(i < 3 and last, 3, i + 1)
        rays.tried[frame.node] = wp.uint8(tried)
    return best.plane


@wp.func
def is_cheap_leaf(rules: BuildRules, rays: KnownRays, tree: BinaryTree, frame: Frame):
    """Whether a node is a leaf by `NodeRules`."""
    stops = bool(False)
    if frame.count <= rules.max_leaf and (rays.leaf_probability > 0.0 or rays.leaf_cost > 0.0):
        boxes = wp.zeros(shape=(6,), dtype=float)
        weights = wp.zeros(shape=(1,), dtype=float)
        low = low_of(tree, frame.node)
        high = high_of(tree, frame.node)
        for axis in range(3):
            boxes[axis] = low[axis]
            boxes[3 + axis] = high[axis]
        weights[0] = rays.mixture.others * half_surface(low, high)
        add_projected(rays.mixture, 1, boxes, weights)
        weight = weights[0]
        stops = weight <= rays.leaf_probability or weight * leaf_cost(rules.cost, frame.count) <= rays.leaf_cost
    return stops


# -- collapse ------------------------------------------------------------------------------------------------------------


@wp.func
def weight_of(rays: KnownRays, tree: BinaryTree, node: int):
    """A node's weight."""
    return rays.weight[node]


@wp.func
def weight_of_parent(rays: KnownRays, tree: BinaryTree, pair: int):
    """The weight of a pair's parent."""
    return rays.parent_weight[pair]


@exact_kernel
def weigh_nodes(first: int, rays: KnownRays, tree: BinaryTree, pairs: wp.array(dtype=wp.vec2i)):
    """Item: a range of pairs. Writes the weights of their nodes, and the parent weights of these nodes' own pairs."""
    item = first + wp.tid()
    for node in range(2 * pairs[item][0], 2 * pairs[item][1]):
        weight = box_weight(rays.mixture, low_of(tree, node), high_of(tree, node))
        rays.weight[node] = weight
        rays.parent_weight[tree.pair[node]] = weight  # for leaves this writes entry LEAF, which belongs to no pair
    if item == 0:
        rays.weight[0] = 1.0
        rays.parent_weight[tree.pair[0]] = 1.0


PROJECTED = Heuristic(KnownRays, cheapest_by_projection, is_cheap_leaf, weight_of, weight_of_parent)
"""The projected area heuristic."""


class ProjectedBuilder(BinnedBuilder):
    """The state of one build for known rays."""

    def __init__(self, triangles: TriangleBoxes, config: ProjectedConfig) -> None:
        super().__init__(triangles, config.bvh, PROJECTED, known_rays(triangles, config))
        self.projected = config

    def over(self, triangles: TriangleBoxes) -> BinnedBuilder:
        """A builder of the same kind for other triangles, all of them."""
        return ProjectedBuilder(triangles, replace(self.projected, bvh=replace(self.config, subset=1.0)))

    def kernels(self) -> list[wp.Kernel]:
        """One kernel of each module."""
        return [*super().kernels(), weigh_nodes]

    def result(self) -> BinaryBuild:
        """The finished binary tree, and the weights of its nodes."""
        pairs = self.subtrees.numpy()
        if self.top is not None:
            pairs = np.concatenate([pairs, self.top.numpy()[:, None] + [[0, 1]]])
        ranges = wp.array(pairs, dtype=wp.vec2i, device=self.device)
        launch(weigh_nodes, len(ranges), [self.rays, self.tree, ranges], device=self.device, chunk=1)
        return super().result()


def build(triangles: TriangleBoxes, config: ProjectedConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes."""
    return ProjectedBuilder(triangles, config).build()
