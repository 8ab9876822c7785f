// Queues of rays that are shaded: which are moved where, what is fetched ahead, and the sums of their samples.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// The octant of the direction of ray i.
template <class Queue> inline CUDA_CALLABLE int octant(const Queue& queue, int i)
{
    const int* d = (const int*)(queue.direction.data + i);
    return (int)((unsigned)d[0] >> 31 | (unsigned)d[1] >> 31 << 1 | (unsigned)d[2] >> 31 << 2);
}

template <class Queue> inline CUDA_CALLABLE void move_ray(const Queue& source, int i, const Queue& target, int to)
{
    target.origin.data[to] = source.origin.data[i];
    target.direction.data[to] = source.direction.data[i];
    target.weight.data[to] = source.weight.data[i];
    target.density.data[to] = source.density.data[i];
    target.slot.data[to] = source.slot.data[i];
    target.media.data[to] = source.media.data[i];
}

/// Copies the rays begin .. stop - 1 to another queue, in the order of their octants.
template <class Queue> inline CUDA_CALLABLE void order_rays(int begin, int stop, const Queue& source, const Queue& target)
{
    int next[9] = {};
    for (int i = begin; i < stop; ++i) ++next[octant(source, i) + 1];
    next[0] = begin;
    for (int k = 0; k < 8; ++k) next[k + 1] += next[k];
    for (int i = begin; i < stop; ++i) move_ray(source, i, target, next[octant(source, i)]++);
}

/// Moves the rays that are met to the front of their places and returns their number; copies the others, in the order of their
/// octants, if they are kept.
template <class Queue>
inline CUDA_CALLABLE int part_rays(
    int begin, int stop, const int* is_met, bool keeps_others, const Queue& source, const Queue& target)
{
    int next[9] = {}, kept = begin;
    for (int i = begin; i < stop; ++i) next[octant(source, i) + 1] += is_met[i] == 0;
    next[0] = begin;
    for (int k = 0; k < 8; ++k) next[k + 1] += next[k];
    for (int i = begin; i < stop; ++i) {
        if (is_met[i] != 0) move_ray(source, i, source, kept++);
        else if (keeps_others) move_ray(source, i, target, next[octant(source, i)]++);
    }
    return kept - begin;
}

/// Copies those of the rays 2 begin .. 2 end - 1 that go on to the places from `to` on; returns the first one after them.
/// Writes one place more.
template <class Queue, class Flags>
inline CUDA_CALLABLE int append_rays(
    int begin, int end, const Queue& scratch, const Flags& is_alive, const Queue& queue, int to)
{
    unsigned any = 0;
    for (int k = 2 * begin; k < 2 * end; ++k) any |= (unsigned)is_alive.data[k];
    if (!any) return to;
    for (int k = 2 * begin; k < 2 * end; ++k) {  // a branch would be taken at random: rays that end are overwritten
        queue.origin.data[to] = scratch.origin.data[k];
        queue.direction.data[to] = scratch.direction.data[k];
        queue.weight.data[to] = scratch.weight.data[k];
        queue.slot.data[to] = scratch.slot.data[k];
        queue.media.data[to] = scratch.media.data[k];
        to += is_alive.data[k];
    }
    return to;
}

/// Fetches the triangles of the hits begin .. end - 1: records, numbers of materials, normals.
template <class Scene, class Hits>
inline CUDA_CALLABLE void fetch_hits(const Scene& scene, const Hits& hits, int begin, int end)
{
#if !defined(__CUDA_ARCH__)
    if (scene.shaded.records.shape[0] < 256) return;  // 16 KB, or none
    for (int i = begin; i < end; ++i) {
        const int hit = hits.primitive.data[i], face = hit < 0 ? 0 : hit;  // a branch would be taken at random
        WRT_FETCH(scene.shaded.records.data + face);
        WRT_FETCH((const char*)(scene.shaded.records.data + face) + 60);
        WRT_FETCH(scene.materials.of_face.data + face * scene.materials.of_face_stride);
        if (scene.shaded.is_smooth) {
            const char* normals = (const char*)(scene.shaded.corner_normals.data + 3 * face);
            WRT_FETCH(normals);
            WRT_FETCH(normals + 35);
        }
    }
#endif
}

/// Adds the light of the shadow rays begin .. stop - 1 that nothing blocks to their samples.
template <class Flags, class Rays, class Slots>
inline CUDA_CALLABLE void gather_paths(int begin, int stop, const Flags& blocked, const Rays& rays, const Slots& lit_slot)
{
    for (int i = begin; i < stop; ++i) {
        const auto& lit = rays.lit.data[i];
        auto& sum = rays.radiance.data[lit_slot.data[i]];
        const float x = sum.c[0] + lit.c[0], y = sum.c[1] + lit.c[1], z = sum.c[2] + lit.c[2];
        const bool is_free = !blocked.data[i];  // a branch would be taken at random
        sum.c[0] = is_free ? x : sum.c[0];
        sum.c[1] = is_free ? y : sum.c[1];
        sum.c[2] = is_free ? z : sum.c[2];
    }
}

template <class Vec> inline CUDA_CALLABLE void add_light(Vec& sum, const Vec& light)
{
    sum.c[0] += light.c[0], sum.c[1] += light.c[1], sum.c[2] += light.c[2];
}

/// Adds the light of the rays begin .. stop - 1 of trees to their samples: what they collect, then of each light what the
/// shadow rays bring that nothing blocks, in as many passes as `gather` of wrt.kernels.shading.wavefront.ray_queue makes.
template <class Slots, class Flags, class Rays, class Listed>
inline CUDA_CALLABLE void gather_trees(int begin, int stop, int shadows, int first_light, int lights, const Slots& slot,
    const Flags& blocked, const Rays& rays, const Listed& listed)
{
    const int shadow_end = begin + shadows;
    int shadow = begin;
    for (int i = begin; i < stop;) {
        const int own = slot.data[i];
        int end = i;
        const int first_shadow = shadow;
        while (end < stop && slot.data[end] == own) ++end;
        while (shadow < shadow_end && listed.ray.data[shadow] < end) ++shadow;
        auto sum = rays.radiance.data[own];
        if (first_shadow == shadow) {
            for (int j = i; j < end; ++j) add_light(sum, rays.emitted.data[j]);
        } else {
            for (int light = 0; light < lights; ++light) {
                for (int j = i, k = first_shadow; j < end; ++j) {
                    if (light == 0) add_light(sum, rays.emitted.data[j]);
                    for (; k < shadow && listed.ray.data[k] == j; ++k)
                        if (listed.light.data[k] == first_light + light && !blocked.data[k]) add_light(sum, rays.lit.data[k]);
                }
            }
        }
        rays.radiance.data[own] = sum;
        i = end;
    }
}

/// The greater one; the number, of a number and a NaN.
inline CUDA_CALLABLE float max_number(float a, float b) { return a > b || b != b ? a : b; }

/// Adds samples, no component of which is above `limit`, to a sum, and the squares of their luminance to another.
template <class Vec>
inline CUDA_CALLABLE void add_samples(const Vec* radiance, int samples, float limit, Vec& total, float& squares)
{
    const float* value = (const float*)radiance;
    float r = total.c[0], g = total.c[1], b = total.c[2], square = squares;
    for (int sample = 0; sample < samples; ++sample, value += 3) {
        float x = value[0], y = value[1], z = value[2];
        const float brightest = max_number(x, max_number(y, z));
        if (brightest > limit) {
            const float share = limit / brightest;
            x *= share, y *= share, z *= share;
        }
        r += x, g += y, b += z;
        const float brightness = 0.2126f * x + 0.7152f * y + 0.0722f * z;
        square += brightness * brightness;
    }
    total.c[0] = r, total.c[1] = g, total.c[2] = b;
    squares = square;
}

}  // namespace
}  // namespace wrt
