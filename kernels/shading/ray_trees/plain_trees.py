"""A step of trees of rays for W plain rays at once, on the CPU.

A ray is plain if it hits a mirror or smooth glass, or if it ends: in the last generation on such a surface, and where nothing
is hit under a sky of one colour. Further, its surface has no image, no colours of corners and emits nothing, nothing is
absorbed on its way, it enters glass from air, and the scene has no lamps with an area. Each plain ray gets the bits that
`wrt.kernels.shading.wavefront.tree_step` gives it. The others are left to it.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.shading.sampling import MIX_1
from wrt.kernels.shading.wavefront.lane_words import lane_words
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.plain_step import CONSTANTS, KINDS, POINTS, RECORDS
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.shading.wavefront.tree_step import TreeStep

_BEGIN = f"""
    const auto& materials = scene.materials;
    const auto& lights = scene.lights;
    const bool is_last = step.is_last, is_sobol = false;
    constexpr unsigned MIX_1 = {int(MIX_1)}u;
    if (scene.shaded.records.shape[0] == 0 || materials.has_color || lights.areas > 0) return 0;
"""

_END = """
    const V3 black = {all(0.0f), all(0.0f), all(0.0f)};
    const vi closed = ended & (~is_hit | is_dark & ((kind == MIRROR) | (kind == DIELECTRIC)));
    auto collect = [&](vi plain) {
        V3 found = black;
        if (has_sky && is_any(closed & ~is_hit)) found = pick3(~is_hit, weight * all3(sky.texels.data[0]), found);
        save3(rays.emitted.data + first, found);
        return bits_of(plain);
    };
    if (!is_last) __builtin_memset(goes_on.data + 2 * child, 0, 8 * W);
    if (!is_any(mirror | glass)) return is_any(closed) ? collect(closed) : 0;
"""
"""C++: the light of rays that end, and the way out if none goes on."""

_SEND = """
    const vi single = mirror | glass;
    const V3 out = direction * -1.0f;
    const vf cosine = dot(out, normal), size = size_of(cosine);
    const vf ratio = pick(is_front, 1.0f / index, index);
    const vf beyond = 1.0f - ratio * ratio * (1.0f - size * size), other = root(beyond);
    const vf parallel = (size - ratio * other) / (size + ratio * other);
    const vf perpendicular = (ratio * size - other) / (ratio * size + other);
    const vf reflected = pick(beyond > 0.0f, 0.5f * (parallel * parallel + perpendicular * perpendicular), all(1.0f));
    const vf under = 1.0f - ratio * ratio * larger(all(0.0f), 1.0f - cosine * cosine);
    const V3 bent = pick3(under > 0.0f, normal * (ratio * cosine - root(under)) - out * ratio, black);
    vi branch = (vi)0;
    bool knows_branch = false;
    auto find_branches = [&]() {  // numbers of rays among those of their sample
        int before = 0;
        for (int i = first; i > begin && queue.slot.data[i - 1] == queue.slot.data[first]; --i) ++before;
        int numbers[W];
        for (int i = 0; i < W; ++i) {
            if (i > 0) before = queue.slot.data[first + i] == queue.slot.data[first + i - 1] ? before + 1 : 0;
            numbers[i] = before;
        }
        branch = load_ints(numbers);
        knows_branch = true;
    };
    auto send = [&](vi sends, V3 toward, const V3& part, bool is_transmitted, V3& share) {
        share = weight * part;
        const vf most = larger(share.x, larger(share.y, share.z));
        const V3 rest = share - share;
        vi alive = sends & (most > 0.0f) & (rest.x == 0.0f) & (rest.y == 0.0f) & (rest.z == 0.0f);
        alive = alive & (dot(toward, toward) > 0.5f);
        const vi dim = alive & (most < step.threshold);
        if (is_any(dim)) {
            if (step.roulette) {
                if (!knows_branch) find_branches();
                const vu own = pixel + (vu)branch * MIX_1;
                const vf chance = single_number(own, sample, 3 * step.generation + (is_transmitted ? 1 : 0));
                alive = alive & ~(dim & ~(chance * step.threshold < most));
                share = pick3(dim, share * (step.threshold / most), share);
            } else alive = alive & ~dim;
        }
        return alive;
    };
    auto kept_above = [&](const V3& toward, bool is_transmitted) {
        const vf rise = dot(toward, face_normal);
        const vi wrong = is_transmitted ? ~(rise < 0.0f) : (rise < 0.0f);
        return pick3(wrong, toward - face_normal * (2.0f * rise), toward);
    };
    const V3 back = normal * (2.0f * cosine) - out;
    V3 share_back, share_on;
    const vi glances = send(single, back, pick3(glass, color * reflected, color), false, share_back);
    const vi passes = send(glass, bent, color * ((1.0f - reflected) * ratio * ratio), true, share_on);
    const V3 shift = face_normal * offset;
    auto mingle = [&](void* to, const auto& a, const auto& b) {
        save(to, MINGLE_LOW(a, b));
        save((float*)to + W, MINGLE_HIGH(a, b));
    };
    auto mingle3 = [&](wp::vec3* to, const V3& a, const V3& b) {
        save3(to, V3{MINGLE_LOW(a.x, b.x), MINGLE_LOW(a.y, b.y), MINGLE_LOW(a.z, b.z)});
        save3(to + W, V3{MINGLE_HIGH(a.x, b.x), MINGLE_HIGH(a.y, b.y), MINGLE_HIGH(a.z, b.z)});
    };
    const int at = 2 * child;
    mingle(goes_on.data + at, -glances, -passes);
    mingle(scratch.slot.data + at, slot, slot);
    mingle3(scratch.origin.data + at, position + shift, position - shift);
    mingle3(scratch.direction.data + at, kept_above(back, false), kept_above(bent, true));
    mingle3(scratch.weight.data + at, share_back, share_on);
    int within[2 * W];
    mingle(within, media, is_front & (number + 1));
    for (int i = 0; i < 2 * W; ++i) scratch.media.data[at + i] = (unsigned long long)(unsigned)within[i];
    return collect(closed | single);
"""
"""C++: `send_children`: the reflected and the refracted rays, side by side."""


def _mingle(width: int) -> str:
    """C++: the lower and the upper half of two vectors whose elements take turns."""

    def half(first: int) -> str:
        return ", ".join(f"{first + i // 2 + (i % 2) * width}" for i in range(width))

    low, high = half(0), half(width // 2)
    return (
        f"\n#define MINGLE_LOW(a, b) __builtin_shufflevector(a, b, {low})"
        f"\n#define MINGLE_HIGH(a, b) __builtin_shufflevector(a, b, {high})\n"
    )


@cache
def make_shade_plain_trees(width: int) -> Any:
    """`shade_plain_trees` for so many lanes."""
    head = f"#if defined(__CUDA_ARCH__)\nreturn 0;\n#else\nconstexpr int W = {width};\n{_mingle(width)}"
    parts = (CONSTANTS, _BEGIN, lane_words(width), KINDS, RECORDS, _END, POINTS, _SEND)

    @native.func_native("lanes.h", f"{head}{''.join(parts)}\n#undef MINGLE_LOW\n#undef MINGLE_HIGH\n#endif\n")
    def shade_plain_trees(
        first: int,
        begin: int,
        child: int,
        step: TreeStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        scratch: RayQueue,
        goes_on: wp.array(dtype=int),
    ) -> wp.uint32:
        """Does the step of the plain ones among the rays first .. first + width - 1 of a queue that begins at `begin`, and
        returns one bit for each. The rays that follow go to the places from 2 `child` on. What it writes for the others is to
        be overwritten.
        """
        ...

    return shade_plain_trees


WIDTH = wp.constant(lane_width())
shade_plain_trees = make_shade_plain_trees(lane_width())
