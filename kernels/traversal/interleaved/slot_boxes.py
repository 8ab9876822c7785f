"""The box test of interleaved walks: one fused multiply-add a plane, with margins that keep it conservative.

**Problem.** The box test of `wrt.kernels.simd.boxes` subtracts and multiplies for each of six planes.

**Idea.** t = plane * inverse + c, where c = -origin * inverse is computed once a ray. Its rounding is relative to origin *
inverse, not to t. So c is moved outwards by more than all roundings, those of the test that it stands for included: a ray that
meets a widened box by `slab_interval` meets it here, and enters it no later. Nothing else is asked of a box test
(`wrt.kernels.simd.boxes`, the consistency rule): hits are found by the triangles' own boxes.

**Margins.** Let e = 2^-24, o the origin, in and out the moved origins (`RaySlabs`), apart = |in - out|, and r the reach of the
ray. All planes are within o + r. Roundings of in and out included, r <= 2^19 apart + 2^-4 |o|. In units of 1 / direction, the
roundings of c, of the multiply-add (fused or not) and of `slab_interval` add up to at most e (3 |o| + 5 r) <= 0.16 apart +
2^-22 |o|. The margin is apart / 4 + 2^-20 |o|, more than that by at least 2^-23 r. 2^-126 is added to distances and to t, for
numbers that are not normal.

**Axes along which a ray hardly moves.** 1 / direction may be infinite, and c would be a NaN. |1 / direction| is limited to 2^30
times that of the largest component. If the origin is between the widened planes, the ray then leaves them at 2^30 2^-23 r /
|largest component| or later, after it has left the scene along the largest. If not, the sign of t is right, and t is no later
than it was. Where products would overflow, both planes of an axis are at infinity: such rays (directions shorter than 2^-90 of
the origin's distance) visit boxes that they miss.

Empty children have planes at infinity and are never met, because 1 / direction is neither 0 nor infinite here.
"""

SLOT = """
#if defined(__clang__) && !defined(__CUDA_ARCH__)
#define WRT_COPY(to, from) __builtin_memcpy(to, from, sizeof(from))
#else
#define WRT_COPY(to, from) memcpy(to, from, sizeof(from))
#endif
    struct Slot { float inverse[4], near[4], far[4]; unsigned near_at[4], far_at[4]; float t_min, t_max; int top, ray; };
"""
"""C++: what a slot keeps of a ray. inverse, near, far: t of a near plane is plane * inverse + near, and of a far plane plane
* inverse + far; near_at, far_at: where these planes are in a node, in bytes. The fourth element of each fills a vector. top:
its stack; ray: its number."""

SLOT_WORDS = 5 * 4 + 4
"""Words of a slot."""

SET_SLOT = """
    auto wrt_set_boxes = [](Slot& slot, const float* inverse, const float* in, const float* out) {
        constexpr float TINY = 1.1754944e-38f, GREATEST = 3.4028235e38f, LARGE = 4.0564819e31f;
        const float size_x = WRT_ABS(inverse[0]), size_y = WRT_ABS(inverse[1]), size_z = WRT_ABS(inverse[2]);
        float least = size_x < size_y ? size_x : size_y; least = least < size_z ? least : size_z;
        const float limit = least * 1073741824.0f;
        float kept[4], near[4], far[4], margins[4];
        unsigned near_at[4], far_at[4];
        WRT_FOR(4, a) {  // the fourth is not used
            const float whole = WRT_ABS(inverse[a]), size = whole < limit ? whole : limit;
            const float i = inverse[a] < 0.0f ? -size : size, apart = WRT_ABS(in[a] - out[a]);
            const float margin = ((apart * 0.25f + TINY) + WRT_ABS(in[a]) * 9.5367432e-7f) * size + TINY;
            const unsigned low = 4 * W * (unsigned)a, other = inverse[a] < 0.0f ? 12 * W : 0;
            kept[a] = i; near[a] = -(in[a] * i) - margin; far[a] = margin - out[a] * i; margins[a] = margin;
            near_at[a] = low + other; far_at[a] = (low + 12 * W) - other;
        }
        float most = margins[0] > margins[1] ? margins[0] : margins[1]; most = margins[2] > most ? margins[2] : most;
        if (!(most < LARGE)) {
            for (int a = 0; a < 3; ++a) {
                if (margins[a] < LARGE) continue;
                kept[a] = inverse[a] < 0.0f ? -TINY : TINY; near[a] = -GREATEST; far[a] = GREATEST;
            }
        }
        WRT_COPY(slot.inverse, kept); WRT_COPY(slot.near, near); WRT_COPY(slot.far, far);
        WRT_COPY(slot.near_at, near_at); WRT_COPY(slot.far_at, far_at);
    };
"""
"""C++ of `wrt_set_boxes(slot, inverse, in, out)`, from the numbers of `RaySlabs`; four of each must be readable. LARGE is
2^105: a margin below it says that (|origin| + reach) / direction is below 2^126."""

MEET = """
#if (defined(__FMA__) || defined(__ARM_FEATURE_FMA)) && defined(__clang__) && !defined(__CUDA_ARCH__)
#define WRT_PLANE(plane, inverse, c) __builtin_fmaf(plane, inverse, c)
#else
#define WRT_PLANE(plane, inverse, c) ((plane) * (inverse) + (c))
#endif
    auto wrt_meet = [](const Slot& slot, const char* box, float* entry, int* met) {
        const float *near_x = (const float*)(box + slot.near_at[0]), *far_x = (const float*)(box + slot.far_at[0]);
        const float *near_y = (const float*)(box + slot.near_at[1]), *far_y = (const float*)(box + slot.far_at[1]);
        const float *near_z = (const float*)(box + slot.near_at[2]), *far_z = (const float*)(box + slot.far_at[2]);
        const float ix = slot.inverse[0], iy = slot.inverse[1], iz = slot.inverse[2], t_min = slot.t_min, t_max = slot.t_max;
        const float in_x = slot.near[0], in_y = slot.near[1], in_z = slot.near[2];
        const float out_x = slot.far[0], out_y = slot.far[1], out_z = slot.far[2];
        WRT_FOR_LANES(i) {
            float enter = t_min, leave = t_max, t;
            t = WRT_PLANE(near_x[i], ix, in_x); enter = t > enter ? t : enter;
            t = WRT_PLANE(near_y[i], iy, in_y); enter = t > enter ? t : enter;
            t = WRT_PLANE(near_z[i], iz, in_z); enter = t > enter ? t : enter;
            t = WRT_PLANE(far_x[i], ix, out_x); leave = t < leave ? t : leave;
            t = WRT_PLANE(far_y[i], iy, out_y); leave = t < leave ? t : leave;
            t = WRT_PLANE(far_z[i], iz, out_z); leave = t < leave ? t : leave;
            entry[i] = enter;
            met[i] = enter <= leave ? -1 : 0;
        }
    };
"""
"""C++ of `wrt_meet(slot, box, entry, met)`: the W boxes of the node at `box`. met: -1 for those that the ray meets, else 0."""
