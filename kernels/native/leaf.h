// Blocks of W triangles, and one ray: the consistency rule, back faces, and mailboxes.
#pragma once
#include "ray.h"

namespace wrt {
namespace {

/// Components of a triangle's record that are its vertices.
constexpr int VERTEX_COMPONENTS = 9;

/// Writes the vertices of triangle `id` of a mesh to a record, `width` apart; `none` for those of an unused lane, id < 0.
inline CUDA_CALLABLE void copy_corners(const float* vertices, const int* faces, int id, int width, float none, float* to)
{
    if (id < 0) {
        for (int c = 0; c < VERTEX_COMPONENTS; ++c) to[c * width] = none;
        return;
    }
    const int* const face = faces + 3 * (size_t)id;
    for (int corner = 0; corner < 3; ++corner) {
        const float* const from = vertices + 3 * (size_t)face[corner];
        for (int axis = 0; axis < 3; ++axis) to[(3 * corner + axis) * width] = from[axis];
    }
}

/// Whether a ray comes from the side from which a triangle is wound counter-clockwise.
template <int W> inline CUDA_CALLABLE bool comes_from_front(const float* corner, const BoxRay& ray)
{
    double normal[3];
    face_normal<W>(corner, normal);
    return is_front(normal, ray.inverse[0], ray.inverse[1], ray.inverse[2]);
}

/// Clamps t to the triangles' own boxes; returns the lanes of `mask` that are hits, with t_min <= t <= t_max. CULLING: only
/// those from the front.
template <int W, int COMPONENTS, bool CULLING, class Slabs>
inline CUDA_CALLABLE unsigned clamp_block(
    const float* records, int block, const Slabs& slabs, unsigned mask, float* t, float t_min, float t_max)
{
    const float* const corner = records + (size_t)block * (COMPONENTS * W);
    const BoxRay ray = box_ray(slabs);
    int hit[W];
    WRT_FOR_LANES (i) {
        float low[3], high[3];
        vertex_box<W>(corner + i, low, high);
        const Interval own = meet_box(low, high, ray, -WRT_INFINITY, WRT_INFINITY);
        const float at = clamped(t[i], own);
        t[i] = at;
        hit[i] = ((own.enter <= own.leave) & (at >= t_min) & (at <= t_max)) ? -1 : 0;
    }
    unsigned kept = bits<W>(hit) & mask;
    if (CULLING) {
        for (int i = 0; i < W; ++i) {
            if (kept >> i & 1u) kept &= comes_from_front<W>(corner + i, ray) ? ~0u : ~(1u << i);
        }
    }
    return kept;
}

// Mailboxes (wrt.kernels.traversal.mailbox) remove the triangles that they know from a mask, and remember the others. id: those
// of a block. Entries are id + 1; 0 is an empty entry.

/// An array of PLACES entries, followed by their number.
template <int W, int PLACES> inline CUDA_CALLABLE unsigned plain_mailbox(const int* id, unsigned mask, int* mailbox)
{
    int known[W], count = mailbox[PLACES];
    WRT_FOR_LANES (i) {
        known[i] = id[i] < 0 ? 1 : 0;
    }
    for (int p = 0; p < count; ++p) {
        const int before = mailbox[p];
        WRT_FOR_LANES (i) {
            known[i] |= id[i] + 1 == before ? 1 : 0;
        }
    }
    unsigned fresh = 0;
    WRT_FOR_LANES (i) {
        fresh |= known[i] ? 0u : 1u << i;
    }
    fresh &= mask;
    for (int i = 0; i < W; ++i)
        if ((fresh >> i & 1u) && count < PLACES) mailbox[count++] = id[i] + 1;
    mailbox[PLACES] = count;
    return fresh;
}

/// A table of SLOTS entries, a power of two.
template <int W, int SLOTS> inline CUDA_CALLABLE unsigned hashed_mailbox(const int* id, unsigned mask, int* mailbox)
{
    unsigned fresh = 0;
    WRT_FOR_LANES (i) {
        fresh |= ((id[i] >= 0) & (mailbox[id[i] & (SLOTS - 1)] != id[i] + 1)) ? 1u << i : 0u;
    }
    fresh &= mask;
    for (int i = 0; i < W; ++i)
        if (fresh >> i & 1u) mailbox[id[i] & (SLOTS - 1)] = id[i] + 1;
    return fresh;
}

/// A ring of RING entries, followed by the position of the next one.
template <int W, int RING> inline CUDA_CALLABLE unsigned inverse_mailbox(const int* id, unsigned mask, int* mailbox)
{
    int ring[RING];
    for (int r = 0; r < RING; ++r) ring[r] = mailbox[r];
    unsigned fresh = 0;
    WRT_FOR_LANES (i) {
        int known = id[i] < 0 ? 1 : 0;
        for (int r = 0; r < RING; ++r) known |= ring[r] == id[i] + 1 ? 1 : 0;
        fresh |= known ? 0u : 1u << i;
    }
    fresh &= mask;
    int next = mailbox[RING];
    for (int i = 0; i < W; ++i)
        if (fresh >> i & 1u) {
            mailbox[next] = id[i] + 1;
            next = (next + 1) & (RING - 1);
        }
    mailbox[RING] = next;
    return fresh;
}

}  // namespace
}  // namespace wrt
