"""Bounds of box tests: `wrt.kernels.simd.boxes`, `wrt.kernels.answers.exact_hit` and `kernels/native/interleaved.h`."""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, slab_interval

from .inputs import UNIT, numbers, rays_at, scales

Interval = wp.types.vector(length=2, dtype=wp.float32)


@native.func_native(
    "interleaved.h",
    """
    wrt::Slot slot;
    float inverse[4] = {slabs.inverse.c[0], slabs.inverse.c[1], slabs.inverse.c[2], 0.0f};
    float in[4] = {slabs.origin_in.c[0], slabs.origin_in.c[1], slabs.origin_in.c[2], 0.0f};
    float out[4] = {slabs.origin_out.c[0], slabs.origin_out.c[1], slabs.origin_out.c[2], 0.0f};
    wrt::set_boxes<1>(slot, inverse, in, out);
    const float box[6] = {low.c[0], low.c[1], low.c[2], high.c[0], high.c[1], high.c[2]};
    slot.t_min = t_min, slot.t_max = t_max;
    float entry[1];
    int met[1];
    wrt::meet<1>(slot, (const char*)box, entry, met);
    return wp::vec2(entry[0], met[0] ? 1.0f : 0.0f);
    """,
)
def fused_entry(slabs: RaySlabs, low: wp.vec3, high: wp.vec3, t_min: float, t_max: float) -> wp.vec2:
    """(entry, 1 if the box is met) by the box test of interleaved walks."""


@cache
def box_kernel() -> wp.Kernel:
    """A kernel that tests ray i against box i, by both tests."""

    def test_boxes(
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        reaches: wp.array(dtype=float),
        lows: wp.array(dtype=wp.vec3),
        highs: wp.array(dtype=wp.vec3),
        intervals: wp.array(dtype=wp.vec2),
        fused: wp.array(dtype=wp.vec2),
    ):
        i = wp.tid()
        slabs = ray_slabs(origins[i], directions[i], reaches[i])
        own = slab_interval(slabs, lows[i], highs[i])
        intervals[i] = own
        fused[i] = fused_entry(slabs, lows[i], highs[i], 0.0, 3.0e38)

    return wp.kernel(test_boxes, module="unique", enable_backward=False, module_options={"fuse_fp": False})


def outward(values: np.ndarray, end: float) -> np.ndarray:
    """The float32 next to each value, towards `end`."""
    near = values.astype(np.float32)
    inside = near > values if end < 0 else near < values
    return np.where(inside, np.nextafter(near, np.float32(end)), near).astype(np.float64)


class Boxes:
    """Rays in float64 with boxes that they meet at t, all of it rounded to float32, and what the box tests give.

    Attributes:
        origin, direction, low, high: float64, as a caller gives them.
        point: (N, 3) float64, of the box.
        t: (N,) float64: origin + t direction is the point.
    """

    def __init__(self, rng: np.random.Generator, count: int, exact: bool, most: int) -> None:
        size = scales(rng, count, most).astype(np.float64)
        ends = np.sort(numbers(rng, (count, 2, 3)), axis=1).astype(np.float64)
        flat = rng.random((count, 1)) < 0.2
        ends[:, 1] = np.where(flat, ends[:, 0] + rng.integers(0, 2, (count, 3)) * (ends[:, 1] - ends[:, 0]), ends[:, 1])
        share = np.choose(rng.integers(0, 3, (count, 3)), [0.0, 1.0, rng.random((count, 3))])
        point = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
        origin = numbers(rng, (count, 3)).astype(np.float64)
        direction = rays_at(rng, point, origin).astype(np.float64)
        if not exact:  # what the caller has is not in float32
            noise = 1.0 + UNIT * rng.uniform(-1.0, 1.0, (4, count, 3))
            origin, direction, ends = origin * noise[0], direction * noise[1], ends * noise[2:].transpose(1, 0, 2)
            ends = np.sort(ends, axis=1)
        # a point of the ray for certain: t from the largest component, and the box moved to it
        axis = np.abs(direction).argmax(axis=1)[:, None]
        away = np.take_along_axis(point - origin, axis, 1) / np.take_along_axis(direction, axis, 1)
        self.t = np.abs(away[:, 0])
        moved = origin + self.t[:, None] * direction
        ends[:, 0], ends[:, 1] = np.minimum(ends[:, 0], moved), np.maximum(ends[:, 1], moved)
        shut = rng.random((count, 3)) < 0.3  # faces through the point, one on each side
        ends[:, 0] = np.where(shut, moved, ends[:, 0])
        shut = rng.random((count, 3)) < 0.3
        ends[:, 1] = np.where(shut, moved, ends[:, 1])
        self.origin, self.direction, self.point = origin * size, direction, moved * size
        self.low, self.high = ends[:, 0] * size, ends[:, 1] * size
        self.t *= size[:, 0]
        if exact:
            self.low, self.high = outward(self.low, -np.inf), outward(self.high, np.inf)

    def run(self) -> tuple[np.ndarray, ...]:
        """(interval, entry by the fused test, whether that meets the box, reach, 1 / direction), each float64."""
        arrays = [array.astype(np.float32) for array in (self.origin, self.direction)]
        low, high = self.low.astype(np.float32), self.high.astype(np.float32)
        # the scene is the box and its mirror image, so that its centre is 0
        extent = np.maximum(np.abs(low), np.abs(high))
        reach = (extent + np.abs(arrays[0])).max(axis=1)
        count = len(low)
        results = [wp.zeros(count, dtype=wp.vec2, device="cpu") for _ in range(2)]
        inputs = [wp.array(array, dtype=wp.vec3, device="cpu") for array in arrays]
        boxes = [wp.array(array, dtype=wp.vec3, device="cpu") for array in (low, high)]
        wp.launch(box_kernel(), count, [*inputs, wp.array(reach, device="cpu"), *boxes, *results], device="cpu")
        interval, fused = (result.numpy() for result in results)
        with np.errstate(divide="ignore"):
            inverse = np.abs(1.0 / self.direction)
        return interval.astype(np.float64), fused[:, 0].astype(np.float64), fused[:, 1] > 0.0, reach.astype(np.float64), inverse


def lost(interval: np.ndarray, t: np.ndarray) -> np.ndarray:
    """2 where a box is entered after float32(t), or left before it; else 0. Hits beyond float32 do not count."""
    with np.errstate(over="ignore"):
        rounded = t.astype(np.float32)
    outside = ~((interval[:, 0] <= rounded) & (rounded <= interval[:, 1]))
    return np.where(outside & np.isfinite(rounded), 2.0, 0.0)


def slab_roundings(boxes: Boxes, interval: np.ndarray, reach: np.ndarray, inverse: np.ndarray, allowed: float) -> np.ndarray:
    """Roundings u R / |direction| by which the interval of a box falls short of the slack, over those allowed.

    Only along the axis that decides, where that is the largest component: elsewhere the interval may end earlier for another
    axis.
    """
    unit = UNIT * reach * inverse.min(axis=1)
    # -16 units without any rounding; t itself has steps of 2^-149
    early = np.maximum(interval[:, 0] - boxes.t, boxes.t - interval[:, 1]) - 2.0**-149
    ratio = (16.0 + early / unit) / allowed
    return np.where(np.isfinite(ratio) & np.isfinite(boxes.t.astype(np.float32)), ratio, 0.0)


def search_slab(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """A box is entered no later, and left no earlier, than a point of it that the ray passes: four roundings of sixteen."""
    boxes = Boxes(rng, count, True, most)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        interval, _, _, reach, inverse = boxes.run()
        return np.maximum(lost(interval, boxes.t), slab_roundings(boxes, interval, reach, inverse, 4.01))


def search_exact(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """The same for a ray and a box in float64 that have been rounded to float32: seven roundings of sixteen."""
    boxes = Boxes(rng, count, False, most)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        interval, _, _, reach, inverse = boxes.run()
        return np.maximum(lost(interval, boxes.t), slab_roundings(boxes, interval, reach, inverse, 7.01))


def search_fused(rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    """A box that the slab test meets is met by the box test of interleaved walks, and entered earlier by 2^-23 R / |direction|
    at least; also boxes that rays graze."""
    boxes = Boxes(rng, count, True, most)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        shift = rng.choice([0.0, 2.0**-20, 2.0**-19, 2.0**-18], (count, 3)) * rng.choice([-1.0, 1.0], (count, 3))
        far = np.maximum(np.abs(boxes.low), np.abs(boxes.high)) + np.abs(boxes.origin)
        shift *= far.max(axis=1, keepdims=True)
        boxes.low, boxes.high = boxes.low + shift, boxes.high + shift
        interval, entry, met, reach, inverse = boxes.run()
        enter = np.maximum(interval[:, 0], 0.0)
        meets = (enter <= interval[:, 1]) & (enter <= 3e38)
        needed = 2.0**-23 * reach * inverse.min(axis=1)
        earlier = np.where((entry > 0.0) & (reach > 2.0**-90) & (enter > 2.0**-100), needed / (enter - entry), 0.0)
        return np.where(meets & ~(met & (entry <= enter)), 2.0, np.where(meets, earlier, 0.0))
