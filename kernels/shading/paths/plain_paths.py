"""The step of `wrt.kernels.shading.wavefront.plain_step` for W plain rays at once, which appends what it sends out.

The lanes of paths that go on, or of shadow rays that may bring light, are moved together by one permutation for each number of
a ray, and stored W at a time. The next rays overwrite what was stored beyond the last of them.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.shading.wavefront.lane_words import lane_words
from wrt.kernels.shading.wavefront.path_step import PathStep
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.plain_lamps import GATHER, LAMPS
from wrt.kernels.shading.wavefront.plain_step import BEGIN, COLLECT, CONSTANTS, CROSSED, ENDS, KINDS, POINTS, RECORDS, SCATTER
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene

_STEP = """
    const int generation = step.generation, roulette = step.roulette;
    const bool is_last = step.is_last, samples_lights = step.samples_lights;
"""

_END = """
    if (!is_any(matte | mirror | glass)) {
        collect(ended);
        return bits_of(ended);
    }
"""
"""C++: the way out where no path goes on."""

_PERMUTATION = {
    16: """
#if defined(__AVX512F__) && defined(__clang__)
    auto order_of = [](unsigned mask) {  // the lanes in the mask, then others
        vi order;
        WRT_UNROLLED for (int i = 0; i < W; ++i) order[i] = i;
        return (vi)__builtin_ia32_compresssi512_mask(order, order, (unsigned short)mask);
    };
    auto packed = [](auto v, vi order) { return (decltype(v))__builtin_ia32_permvarsi512((vi)v, order); };
#el""",
    8: """
#if defined(__AVX2__) && defined(__clang__)
    auto order_of = [](unsigned mask) {
        return __builtin_convertvector(wrt::load<wrt::Vector<unsigned char, 8>>(wrt::FIRST_LANES_FIRST.of + mask), vi);
    };
    auto packed = [](auto v, vi order) { return (decltype(v))__builtin_ia32_permvarsi256((vi)v, order); };
#el""",
}
"""C++: the instructions that move so many lanes, where the target has them."""


def pack_words(width: int) -> str:
    """C++ of `packed(v, order_of(mask))`, the lanes of v in the mask moved to the front, after `lane_words(width)`.

    The instruction is chosen by the width, and used if the target has it: the two are independent.
    """
    with_permutation = _PERMUTATION.get(width, "\n#")
    return f"""{with_permutation}if 1
    auto order_of = [](unsigned mask) {{
        vi order = 0;
        int count = 0;
        for (int i = 0; i < W; ++i) if (mask >> i & 1u) order[count++] = i;
        return order;
    }};
    auto packed = [](auto v, vi order) {{
        auto moved = v;
        for (int i = 0; i < W; ++i) moved[i] = v[order[i]];
        return moved;
    }};
#endif
    auto packed3 = [&](const V3& v, vi order) {{ return V3{{packed(v.x, order), packed(v.y, order), packed(v.z, order)}}; }};
"""


_APPEND = """
    const unsigned on = bits_of(alive);
    if (on) {
        const vi order = order_of(on);
        save3(following.origin.data + to, packed3(origin, order));
        save3(following.direction.data + to, packed3(toward, order));
        save3(following.weight.data + to, packed3(share, order));
        save(following.density.data + to, packed(density, order));
        save(following.slot.data + to, packed(slot, order));
        save(following.media.data + to, __builtin_convertvector((vu)packed(media_beyond, order), vl));
        to += __builtin_popcount(on);
    }
    const unsigned listed = bits_of(plain & ((lit.x != 0.0f) | (lit.y != 0.0f) | (lit.z != 0.0f)));
    if (listed) {
        const vi order = order_of(listed);
        save3(rays.lit.data + entry, packed3(lit, order));
        save3(rays.shadow_origin.data + entry, packed3(lit_origin, order));
        save3(rays.shadow_direction.data + entry, packed3(segment, order));
        save(lit_slot.data + entry, packed(slot, order));
        entry += __builtin_popcount(listed);
    }
    return bits_of(plain);
"""


@cache
def make_shade_plain_paths(width: int) -> Any:
    """`shade_plain_paths` for so many lanes."""
    head = f"#if defined(__CUDA_ARCH__)\nreturn 0;\n#else\nconstexpr int W = {width};\n"
    parts = (CONSTANTS, _STEP, BEGIN, lane_words(width), KINDS, RECORDS, CROSSED, COLLECT, _END, POINTS, LAMPS, GATHER, SCATTER)

    @native.func_native("lanes.h", f"{head}{''.join(parts)}{ENDS}{pack_words(width)}{_APPEND}\n#endif\n")
    def shade_plain_paths(
        first: int,
        step: PathStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        lit_slot: wp.array(dtype=int),
        following: RayQueue,
        to: wp.ref[int],
        entry: wp.ref[int],
    ) -> wp.uint32:
        """Does the step of the plain ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. Appends paths that go on to `following` at place `to`, and shadow rays to `rays` at place `entry`; both places are
        moved on, and up to width places from there on are written.
        """
        ...

    return shade_plain_paths


WIDTH = wp.constant(lane_width())
shade_plain_paths = make_shade_plain_paths(lane_width())
