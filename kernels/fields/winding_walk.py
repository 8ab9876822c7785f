"""The kernel that computes winding numbers by a walk of a wide BVH; the walk is in kernels/native/winding.h."""

from functools import cache

import warp as wp

from wrt.kernels.fields.cluster_moments import MOMENTS, RADIUS
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, WideNodes
from wrt.kernels.layout.ray_batch import is_finite
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@wp.struct
class Clusters:
    """The triangles below each child of each node, seen from afar."""

    moments: wp.array(dtype=float)
    """(nodes * MOMENTS * W,) as `wrt.kernels.fields.cluster_moments` stores them."""
    far: wp.array(dtype=float)
    """(nodes * W,) squared distance from the centre from which the moments do; -1 in unused lanes."""
    scale: float
    """By which lengths are multiplied in both."""


MIN_FAR = wp.constant(1e-24)
"""Least squared distance from which moments do: from there on, its power of -3/2 is in the range of float32."""


@exact_kernel
def set_far(first: int, width: int, factor: float, clusters: Clusters):
    """Squared distances from which moments do: `factor` radii. Item: a lane."""
    lane = first + wp.tid()
    radius = clusters.moments[((lane // width) * MOMENTS + RADIUS) * width + lane % width]
    clusters.far[lane] = wp.where(radius >= 0.0, wp.max(radius * radius * factor * factor * 1.00001, MIN_FAR), -1.0)


@cache
def make_winding_kernel(width: int) -> wp.Kernel:
    """The kernel for trees of a width. Item: a point."""

    @native.func_native(
        "winding.h",
        f"""static_assert(wrt::winding::MOMENTS == {MOMENTS} && wrt::winding::DEPTH == {MAX_WIDE_DEPTH});
            return wrt::winding::number_at<{width}>(tree, triangles, clusters, {{point.c[0], point.c[1], point.c[2]}});""",
    )
    def winding_at(tree: WideNodes, triangles: TriangleBlocks, clusters: Clusters, point: wp.vec3) -> float: ...

    def winding_numbers(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        clusters: Clusters,
        points: wp.array(dtype=wp.vec3),
        order: wp.array(dtype=int),
        found: wp.array(dtype=float),
    ):
        i = first + wp.tid()
        if order.shape[0] > 0:
            i = order[i]
        number = wp.nan
        if is_finite(points[i]):
            number = winding_at(tree, triangles, clusters, points[i])
        found[i] = number

    return specialised_kernel(winding_numbers)
