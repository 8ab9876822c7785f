"""Bounds of the watertight test, and of what is built on it: see the package."""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp

from wrt.builders.core.clip import PAD
from wrt.kernels.query.open_segments import PLANE_TOLERANCE
from wrt.kernels.query.spawn import OFFSET
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import clamp_to_box, ray_slabs
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.watertight.woop import intersect, prepare, sheared

from .inputs import UNIT, Cases, cases, numbers, scales, triangles, weights

Vertices = wp.types.vector(length=9, dtype=wp.float32)
AREA_SCALES = 55
"""Powers of two, of both signs, of sizes of triangles and rays whose areas are normal numbers of float32."""


@cache
def woop_kernel() -> wp.Kernel:
    """A kernel that tests ray i against triangle i."""

    def test_triangles(
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        corners: wp.array2d(dtype=wp.vec3),
        reaches: wp.array(dtype=float),
        vertices: wp.array2d(dtype=wp.vec3),
        slopes: wp.array(dtype=wp.vec3),
        hits: wp.array(dtype=wp.vec3),
        accepted: wp.array(dtype=float),
    ):
        i = wp.tid()
        triangle = Corners()
        triangle.a = corners[i, 0]
        triangle.b = corners[i, 1]
        triangle.c = corners[i, 2]
        ray = prepare(origins[i], directions[i])
        vertices[i, 0] = sheared(ray, triangle.a)
        vertices[i, 1] = sheared(ray, triangle.b)
        vertices[i, 2] = sheared(ray, triangle.c)
        slopes[i] = ray.shear
        hit = intersect(ray, triangle)
        hits[i] = hit
        low = wp.min(wp.min(triangle.a, triangle.b), triangle.c)
        high = wp.max(wp.max(triangle.a, triangle.b), triangle.c)
        accepted[i] = clamp_to_box(ray_slabs(origins[i], directions[i], reaches[i]), low, high, hit[0])

    return wp.kernel(test_triangles, module="unique", enable_backward=False, module_options={"fuse_fp": False})


class Tested:
    """What the watertight test computes, in float64.

    Attributes:
        vertices: (N, 3, 3) sheared vertices: two coordinates across the ray, and the depth.
        slopes: (N, 3). hits: (N, 3) t, u, v; NaN for a miss.
        accepted: (N,) t by the consistency rule; NaN for no hit.
        turned_origin, turned_corners: in the ray's order of axes, exact.
        turned_direction: likewise.
    """

    def __init__(self, given: Cases) -> None:
        count = len(given.origin)
        vectors = [wp.array(array, dtype=wp.vec3, device="cpu") for array in (given.origin, given.direction, given.corners)]
        results = [wp.zeros((count, 3), dtype=wp.vec3, device="cpu")]
        results += [wp.zeros(count, dtype=kind, device="cpu") for kind in (wp.vec3, wp.vec3, float)]
        reaches = wp.array(given.reach.astype(np.float32), device="cpu")
        wp.launch(woop_kernel(), count, [*vectors, reaches, *results], device="cpu")
        self.vertices, self.slopes, self.hits, self.accepted = (result.numpy().astype(np.float64) for result in results)
        size = np.abs(given.direction)
        main = np.where(
            size[:, 0] >= size[:, 1], np.where(size[:, 0] >= size[:, 2], 0, 2), np.where(size[:, 1] >= size[:, 2], 1, 2)
        )
        order = (main[:, None] + [1, 2, 3]) % 3
        self.turned_origin = np.take_along_axis(given.origin.astype(np.float64), order, 1)
        self.turned_direction = np.take_along_axis(given.direction.astype(np.float64), order, 1)
        self.turned_corners = np.take_along_axis(given.corners.astype(np.float64), order[:, None, :].repeat(3, 1), 2)


def within(values: np.ndarray) -> np.ndarray:
    """The ratios, without those that are not numbers: cases beyond float32."""
    return np.where(np.isfinite(values), values, 0.0)


def search_sheared(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """Sheared vertices are those of a triangle whose depths are moved by at most u R and whose other coordinates by 4.5 u R."""
    given = cases(rng, count, most)
    with np.errstate(all="ignore"):
        tested = Tested(given)
        exact = tested.turned_corners - tested.turned_origin[:, None]
        unit = UNIT * np.abs(exact).max(axis=(1, 2))
        slopes = tested.turned_direction[:, :2] / tested.turned_direction[:, 2:]
        depth = tested.vertices[:, :, 2]
        across = exact[:, :, :2] - slopes[:, None] * depth[:, :, None]
        moved = np.abs(tested.vertices[:, :, :2] - across).max(axis=(1, 2)) / 4.5
        ratio = np.maximum(moved, np.abs(depth - exact[:, :, 2]).max(axis=1)) / unit
        return within(np.where(unit > 2.0**-120, ratio, 0.0))


def search_hits(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """A hit is at most 16 u R + 14 u D away from the point of its triangle that u and v tell."""
    given = cases(rng, count, min(most, AREA_SCALES))
    with np.errstate(all="ignore"):
        tested = Tested(given)
        t, u, v = (tested.hits[:, i, None] for i in range(3))
        a, b, c = (tested.turned_corners[:, i] for i in range(3))
        point = tested.turned_origin + t * tested.turned_direction
        distance = np.abs(point - (a + u * (b - a) + v * (c - a))).max(axis=1)
        reach = np.abs(tested.turned_corners - tested.turned_origin[:, None]).max(axis=(1, 2))
        extent = np.ptp(tested.vertices[:, :, :2], axis=1).max(axis=1)
        a, b, c = (tested.vertices[:, i] for i in range(3))
        areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])  # their sum
        normal = (areas >= 2.0**-120) & (areas * reach >= 2.0**-120)
        return within(np.where(normal, distance / (UNIT * (16.0 * reach + 14.0 * extent)), 0.0))


def search_spawned(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """Rounding moves the plane of a triangle, as the watertight test sees it, and a point in float64 by less than an offset."""
    given = cases(rng, count, most)
    size = np.abs(given.corners).max(axis=(1, 2)).astype(np.float64)[:, None]
    start = (weights(rng, count)[:, :, None] * given.corners).sum(axis=1)  # of the triangle, in float64
    moved = start + rng.uniform(-1.0, 1.0, (count, 3)) * UNIT * 8.0 * size
    given.origin[:] = moved.astype(np.float32)
    with np.errstate(all="ignore"):
        tested = Tested(given)
        reach = np.maximum(np.abs(given.corners - moved[:, None]).max(axis=(1, 2)), 2.0 * np.abs(moved).max(axis=1))
        edges = tested.turned_corners[:, 1:] - tested.turned_corners[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        exact = tested.turned_corners - tested.turned_origin[:, None]
        slopes = tested.turned_direction[:, :2] / tested.turned_direction[:, 2:]
        depth = tested.vertices[:, :, 2:]
        seen = np.concatenate([tested.vertices[:, :, :2] + slopes[:, None] * depth, depth], axis=2)
        out = np.abs(((seen - exact) * normal[:, None]).sum(axis=2)).max(axis=1)
        rounding = np.abs(given.origin - moved)  # of any direction: the order of axes does not matter to the sum below
        own = rounding.max(axis=1) * np.abs(normal).sum(axis=1)
        return within(np.where(reach > 2.0**-90, (out + own) / (float(OFFSET) * reach), 0.0))


def search_planes(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """A point of a triangle is within `PLANE_TOLERANCE` of its plane, though point and vertices are rounded. Triangles that are
    so thin that float64 does not find the plane do not count."""
    corners = triangles(rng, count).astype(np.float64)
    corners *= 1.0 + UNIT * rng.uniform(-1.0, 1.0, corners.shape)
    corners *= scales(rng, count, min(most, AREA_SCALES)).astype(np.float64)[:, :, None]
    point = (weights(rng, count)[:, :, None] * corners).sum(axis=1).astype(np.float32).astype(np.float64)
    rounded = corners.astype(np.float32).astype(np.float64)
    with np.errstate(all="ignore"):
        edges = rounded[:, 1:] - rounded[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        area = np.linalg.norm(normal, axis=1)
        has_plane = area >= 2.0**-22 * np.linalg.norm(edges, axis=2).prod(axis=1)
        normal /= area[:, None]
        distance = np.abs(((point - rounded[:, 0]) * normal).sum(axis=1))
        size = np.maximum(np.abs(rounded).max(axis=(1, 2)), np.abs(point).max(axis=1))
        return within(np.where(has_plane, distance / (float(PLANE_TOLERANCE) * size), 0.0))


@native.func_native(
    "packet_leaves.h",
    """
    #if WRT_VECTORS
    struct { wp::vec3 origin_in, origin_out; int passes; float slack; } bounds;
    for (int a = 0; a < 3; ++a) bounds.origin_in.c[a] = point.c[a] + half, bounds.origin_out.c[a] = point.c[a] - half;
    bounds.passes = 1, bounds.slack = half;
    float block[9 * 4];
    for (int c = 0; c < 9; ++c) for (int i = 0; i < 4; ++i) block[4 * c + i] = corners.data[9 * i0 + c];
    const wrt::ConvergingLines lines(bounds);
    const wrt::EdgeFunctions<4> functions(lines, 1, block);
    for (int c = 0; c < 9; ++c) edges.data[10 * i0 + c] = functions.edges[c][0];
    edges.data[10 * i0 + 9] = lines.half;
    const auto met = functions.may_meet(0, (wrt::Floats<4>)sx, (wrt::Floats<4>)sy);
    return functions.errors[0] < 0.0f ? -1.0f : met[0] ? functions.errors[0] : -functions.errors[0];
    #else
    return 0.0f;
    #endif
    """,
)
def edge_functions(
    corners: wp.array(dtype=float), i0: int, point: wp.vec3, half: float, sx: float, sy: float, edges: wp.array(dtype=float)
) -> float:
    """Writes the nine coefficients of a triangle and the half size of the box; returns e, negative if the pair is left out."""


@cache
def edge_kernel() -> wp.Kernel:
    """A kernel that computes the edge functions of triangle i, for a ray of main axis x."""

    def find_edges(
        corners: wp.array(dtype=float),
        points: wp.array(dtype=wp.vec3),
        halves: wp.array(dtype=float),
        slopes: wp.array(dtype=wp.vec3),
        edges: wp.array(dtype=float),
        errors: wp.array(dtype=float),
    ):
        i = wp.tid()
        errors[i] = edge_functions(corners, i, points[i], halves[i], slopes[i][0], slopes[i][1], edges)

    return wp.kernel(find_edges, module="unique", enable_backward=False, module_options={"fuse_fp": False})


def search_edges(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """Edge functions differ by at most e from the areas of the watertight test, for hits that their box accepts."""
    given = cases(rng, count, min(most, 40))
    main = np.abs(given.direction).argmax(axis=1)
    order = (main[:, None] + [0, 1, 2]) % 3  # so that the main axis is the first, as of equal ones
    origin, direction = (np.take_along_axis(array, order, 1) for array in (given.origin, given.direction))
    corners = np.ascontiguousarray(np.take_along_axis(given.corners, order[:, None, :].repeat(3, 1), 2))
    # the point through which the line passes: at the origin, or at another place of the ray
    away = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-0.5, 1.5, count)) * given.reach
    along = direction.astype(np.float64) / np.abs(direction).max(axis=1, keepdims=True)
    through = origin + away[:, None] * along
    size = np.maximum(np.abs(corners - through[:, None]).max(axis=(1, 2)), np.abs(through).max(axis=1))
    reach = np.maximum(given.reach, size)
    half = (2.0**-20 * reach * np.where(rng.random(count) < 0.5, 1.001, rng.uniform(1.0, 4.0, count))).astype(np.float32)
    corner = rng.choice([-1.0, 1.0], (count, 3)) * np.where(rng.random((count, 1)) < 0.5, 0.999, rng.random((count, 3)))
    point = (through + half[:, None] * corner).astype(np.float32)
    with np.errstate(all="ignore"):
        tested = Tested(Cases(origin, direction, corners, reach))
        edges, errors = wp.zeros(10 * count, dtype=float, device="cpu"), wp.zeros(count, dtype=float, device="cpu")
        slopes = tested.slopes.astype(np.float32)
        inputs = [corners.ravel(), point, half, slopes]
        kinds = [float, wp.vec3, float, wp.vec3]
        arrays = [wp.array(array, dtype=kind, device="cpu") for array, kind in zip(inputs, kinds, strict=True)]
        wp.launch(edge_kernel(), count, [*arrays, edges, errors], device="cpu")
        found, bound = edges.numpy().astype(np.float64).reshape(count, 10), errors.numpy().astype(np.float64)
        a, b, c = (tested.vertices[:, i].astype(np.float32) for i in range(3))
        pairs = [(c, b), (a, c), (b, a)]
        areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in pairs], axis=1).astype(np.float64)
        linear = found[:, 0:9:3] + found[:, 1:9:3] * tested.slopes[:, :1] + found[:, 2:9:3] * tested.slopes[:, 1:2]
        ratio = np.abs(linear - areas).max(axis=1) / np.abs(bound)
        # the point must be inside the box for certain, and the triangle be accepted
        inside = np.abs(point.astype(np.float64) - through).max(axis=1) <= found[:, 9]
        ratio = np.where(bound < 0.0, 2.0, ratio)
        return within(np.where(np.isfinite(tested.hits[:, 0]) & np.isfinite(tested.accepted) & inside, ratio, 0.0))


@native.func_native(
    "packet_culling.h",
    """
    struct Bounds {
        int main_axes;
        float plane, t_min, t_max;
        wp::vec2 through_low, through_high, slope_low, slope_high;
        wp::vec3 inverse_large, inverse_small, origin_in, origin_out, origin_low, origin_high;
        wp::vec3i backward;
    } bounds = {};
    bounds.main_axes = 1, bounds.t_min = -WRT_INFINITY, bounds.t_max = WRT_INFINITY;
    const float plane = bounds.plane = 0.5f * (one.c[0] + other.c[0]);
    for (int a = 0; a < 2; ++a) {
        const float s = one_slopes.c[a], r = other_slopes.c[a];
        const float p = one.c[1 + a] - s * (one.c[0] - plane), q = other.c[1 + a] - r * (other.c[0] - plane);
        bounds.through_low.c[a] = (p < q ? p : q) - slack, bounds.through_high.c[a] = (p > q ? p : q) + slack;
        bounds.slope_low.c[a] = s < r ? s : r, bounds.slope_high.c[a] = s > r ? s : r;
    }
    bounds.inverse_large = bounds.inverse_small = wp::vec3(1.0f, 1.0f, 1.0f);
    float block[9 * 4];
    for (int c = 0; c < 9; ++c) for (int i = 0; i < 4; ++i) block[4 * c + i] = corners.data[9 * i0 + c];
    return (wrt::vertex_mask<4>(block, bounds) & 1u) != 0;
    """,
)
def keeps_vertices(
    corners: wp.array(dtype=float),
    i0: int,
    one: wp.vec3,
    other: wp.vec3,
    one_slopes: wp.vec3,
    other_slopes: wp.vec3,
    slack: float,
) -> bool:
    """Whether vertex culling keeps triangle i0 for a packet of two rays, whose main axis is x."""


@cache
def vertex_kernel() -> wp.Kernel:
    """A kernel that culls triangle i for two rays, with `SHARES` of the slack."""

    def cull_vertices(
        corners: wp.array(dtype=float),
        origins: wp.array(dtype=wp.vec3),
        others: wp.array(dtype=wp.vec3),
        slopes: wp.array(dtype=wp.vec3),
        other_slopes: wp.array(dtype=wp.vec3),
        slacks: wp.array(dtype=float),
        kept: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        kept[i] = keeps_vertices(corners, i, origins[i], others[i], slopes[i], other_slopes[i], slacks[i])

    return wp.kernel(cull_vertices, module="unique", enable_backward=False, module_options={"fuse_fp": False})


SHARES = (0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1.0)
"""Parts of the slack with which vertex culling is tried: the largest with which it loses a hit is what it needs."""


def search_vertices(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """Vertex culling keeps what a ray of a packet with different origins meets; the ratio is the share of the slack with which
    it does not, and a little more than 0 if it does with all of it."""
    given = cases(rng, count, min(most, AREA_SCALES))
    main = np.abs(given.direction).argmax(axis=1)
    order = (main[:, None] + [0, 1, 2]) % 3
    origin, direction = (np.take_along_axis(array, order, 1) for array in (given.origin, given.direction))
    corners = np.ascontiguousarray(np.take_along_axis(given.corners, order[:, None, :].repeat(3, 1), 2))
    near = np.exp2(-rng.uniform(0.0, 30.0, (count, 1))) * rng.uniform(-1.0, 1.0, (count, 3)) * given.reach[:, None]
    other = np.where(rng.random((count, 1)) < 0.5, origin, origin + near).astype(np.float32)
    other[:, 0] = (origin[:, 0] + given.reach * rng.uniform(-1.0, 1.0, count)).astype(np.float32)
    reach = np.maximum(given.reach, np.abs(corners - other[:, None].astype(np.float64)).max(axis=(1, 2)))
    reach = np.maximum(reach, 2.0 * np.abs(other.astype(np.float64)).max(axis=1))
    with np.errstate(all="ignore"):
        tested = Tested(Cases(origin, direction, corners, reach))
        slopes = tested.slopes.astype(np.float32)
        turn = rng.choice([0.0, 0.0, 2.0**-23, 0.1], (count, 1)) * rng.uniform(-1.0, 1.0, (count, 3))
        turned = np.clip(slopes + turn, -1.0, 1.0).astype(np.float32)
        ratio = np.zeros(count)
        for share in SHARES:
            slack = (share * 2.0**-20 * reach).astype(np.float32)
            kinds = [float, wp.vec3, wp.vec3, wp.vec3, wp.vec3, float]
            inputs = zip([corners.ravel(), origin, other, slopes, turned, slack], kinds, strict=True)
            kept = wp.zeros(count, dtype=wp.bool, device="cpu")
            arrays = [wp.array(array, dtype=kind, device="cpu") for array, kind in inputs]
            wp.launch(vertex_kernel(), count, [*arrays, kept], device="cpu")
            ratio = np.where(kept.numpy(), ratio, 2.0 if share == 1.0 else max(share, 0.01))
        return np.where(np.isfinite(tested.hits[:, 0]) & np.isfinite(tested.accepted), np.maximum(ratio, 0.001), 0.0)


@native.func_native(
    "clip.h",
    """
    struct Vertex { float c[3]; };
    struct Face { int c[3]; };
    struct { const Vertex* data; } vertices = {(const Vertex*)corners.data + 3 * i0};
    const Face face = {{0, 1, 2}};
    struct Mesh { decltype(vertices) vertices; struct { const Face* data; } faces; bool shrinks; };
    const Mesh mesh = {vertices, {&face}, true};
    const float infinite = WRT_INFINITY;
    float own[8] = {-infinite, -infinite, -infinite, -infinite, -infinite, -infinite, -infinite, -infinite};
    const bool left = wrt::clip(mesh, wrt::cell_of(low, high, pad), 0, own);
    for (int a = 0; a < 3; ++a) box.data[6 * i0 + a] = own[a], box.data[6 * i0 + 3 + a] = -own[4 + a];
    return left;
    """,
)
def clip_to_cell(
    corners: wp.array(dtype=float), i0: int, low: wp.vec3, high: wp.vec3, pad: float, box: wp.array(dtype=float)
) -> bool:
    """Whether triangle i0 is in a cell; writes the box of its part there."""


@cache
def clip_kernel() -> wp.Kernel:
    """A kernel that clips triangle i to cell i."""

    def clip_all(
        corners: wp.array(dtype=float),
        lows: wp.array(dtype=wp.vec3),
        highs: wp.array(dtype=wp.vec3),
        pads: wp.array(dtype=float),
        boxes: wp.array(dtype=float),
        left: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        left[i] = clip_to_cell(corners, i, lows[i], highs[i], pads[i], boxes)

    return wp.kernel(clip_all, module="unique", enable_backward=False, module_options={"fuse_fp": False})


def search_clip(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """A triangle is in every cell that comes as close to it as the pad, but for rounding of the cell, and the box of its part
    there is the pad away from each of its points that does, but for a rounding."""
    corners = triangles(rng, count) * scales(rng, count, min(most, 90))[:, :, None]
    pad = (PAD * 2.0 * np.abs(corners).max(axis=(1, 2)) * np.exp2(rng.uniform(0.0, 4.0, count))).astype(np.float32)
    point = (weights(rng, count)[:, :, None] * corners.astype(np.float64)).sum(axis=1)
    width = np.ptp(corners, axis=1).max(axis=1, keepdims=True) * np.exp2(-rng.uniform(0.0, 20.0, (count, 3)))
    share = np.choose(rng.integers(0, 3, (count, 3)), [-0.9994, 0.9994, rng.uniform(-1.0, 1.0, (count, 3))])
    edge = point + share * pad[:, None]  # the near face of the cell, at most the pad away
    side = rng.choice([-1.0, 1.0], (count, 3))
    low, high = (
        np.where(side > 0, edge, edge - width).astype(np.float32),
        np.where(side > 0, edge + width, edge).astype(np.float32),
    )
    beyond = np.maximum(low - point, point - high).max(axis=1)
    boxes, left = wp.zeros(6 * count, dtype=float, device="cpu"), wp.zeros(count, dtype=wp.bool, device="cpu")
    inputs = [(corners.ravel(), float), (low, wp.vec3), (high, wp.vec3), (pad, float)]
    arrays = [wp.array(array, dtype=kind, device="cpu") for array, kind in inputs]
    wp.launch(clip_kernel(), count, [*arrays, boxes, left], device="cpu")
    box = boxes.numpy().reshape(count, 6).astype(np.float64)
    # the box is enlarged by the pad: it holds the point with as much to spare, but for a rounding
    short = np.maximum(box[:, :3] + pad[:, None] - point, point - (box[:, 3:] - pad[:, None])).max(axis=1)
    size = np.abs(corners).max(axis=(1, 2)) + pad
    ratio = np.where(left.numpy(), np.maximum(short, 0.0) / (4.0 * UNIT * size), 2.0)
    return within(np.where((beyond < 0.9995 * pad) & (pad > 2.0**-120), ratio, 0.0))


def search_ends(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """The end of a ray, computed in float32 from 1 / direction, is at most seven roundings of the largest coordinate off."""
    size = scales(rng, count, min(most, AREA_SCALES))
    origin, end = numbers(rng, (count, 3)) * size, numbers(rng, (count, 3)) * size
    direction = (end.astype(np.float64) - origin) * np.exp2(rng.integers(-8, 9, (count, 1)))
    direction = direction.astype(np.float32)
    with np.errstate(all="ignore"):
        axis = np.abs(direction).argmax(axis=1)[:, None]
        t = np.abs(np.take_along_axis(end.astype(np.float64) - origin, axis, 1) / np.take_along_axis(direction, axis, 1))
        t = t.astype(np.float32)
        one = np.float32(1.0)
        found = origin + t * (one / (one / direction))
        exact = origin + t.astype(np.float64) * direction
        largest = np.maximum(np.abs(origin), np.abs(exact)).max(axis=1)
        return within(np.abs(found - exact).max(axis=1) / (7.001 * UNIT * largest))
