// Triangles clipped to cells, and the loops of builders that do so (`wrt.builders.core.clip`).
//
// Mesh: a struct with `vertices` and `faces`, and `shrinks`, which says whether boxes get those of the parts.
#pragma once
#include "scan.h"

namespace wrt {
namespace {

/// A cell, which is enlarged by `pad` for clipping.
struct ClipCell {
    float low[3], high[3], pad;
};

template <class Vec3> inline CUDA_CALLABLE ClipCell cell_of(const Vec3& low, const Vec3& high, float pad)
{
    return {{low.c[0], low.c[1], low.c[2]}, {high.c[0], high.c[1], high.c[2]}, pad};
}

/// What is left of a triangle: a plane adds a corner at most.
struct TrianglePart {
    double corner[10][3];
    int corners;
};

/// The part of a polygon on the inner side of a plane (Sutherland and Hodgman 1974). sign: 1 if that is above the position.
inline CUDA_CALLABLE void cut(const TrianglePart& from, int axis, double sign, double position, TrianglePart& to)
{
    int left = 0;
    for (int i = 0; i < from.corners; ++i) {
        const double* a = from.corner[i];
        const double* b = from.corner[i + 1 < from.corners ? i + 1 : 0];
        const double from_a = sign * (a[axis] - position), from_b = sign * (b[axis] - position);
        if (from_a >= 0.0) {
            for (int j = 0; j < 3; ++j) to.corner[left][j] = a[j];
            ++left;
        }
        if ((from_a >= 0.0) != (from_b >= 0.0)) {
            const double s = from_a / (from_a - from_b);
            for (int j = 0; j < 3; ++j) to.corner[left][j] = a[j] + s * (b[j] - a[j]);
            to.corner[left++][axis] = position;
        }
    }
    to.corners = left;
}

/// Shrinks a box to that of a polygon, enlarged by `pad`.
inline CUDA_CALLABLE void shrink(float* box, const TrianglePart& polygon, float pad)
{
    for (int axis = 0; axis < 3; ++axis) {
        double lower = WRT_INFINITY, upper = -WRT_INFINITY;
        for (int i = 0; i < polygon.corners; ++i) {
            const double x = polygon.corner[i][axis];
            lower = x < lower ? x : lower;
            upper = x > upper ? x : upper;
        }
        const float a = (float)(lower - pad), b = -(float)(upper + pad);
        box[axis] = a > box[axis] ? a : box[axis];
        box[4 + axis] = b > box[4 + axis] ? b : box[4 + axis];
    }
}

/// False if no part of a triangle is in the cell; otherwise, and if the mesh says so, shrinks the box to that part.
template <class Mesh> inline CUDA_CALLABLE bool clip(const Mesh& mesh, const ClipCell& cell, int triangle, float* box)
{
    const auto& face = mesh.faces.data[triangle];
    TrianglePart polygons[2];
    polygons[0].corners = 3;
    for (int i = 0; i < 3; ++i)
        for (int axis = 0; axis < 3; ++axis) polygons[0].corner[i][axis] = mesh.vertices.data[face.c[i]].c[axis];
    for (int axis = 0; axis < 3; ++axis) {
        cut(polygons[0], axis, 1.0, cell.low[axis] - cell.pad, polygons[1]);
        cut(polygons[1], axis, -1.0, cell.high[axis] + cell.pad, polygons[0]);
    }
    if (mesh.shrinks) shrink(box, polygons[0], cell.pad);
    return polygons[0].corners > 0;
}

/// Clips the references of a range that extend beyond one end of a cell along an axis, drops those without a remaining part,
/// and moves the others together; returns their number, and their box.
template <class Mesh, class Vec3>
inline CUDA_CALLABLE int clip_range(const Mesh& mesh, const ClipCell& cell, float* const range, int count, int axis,
    bool beyond_high, Vec3& inner_low, Vec3& inner_high)
{
    float *from = range, *to = range;
    float bounds[8];
    set_empty(bounds);
    for (int i = 0; i < count; ++i, from += 8) {
        const bool inside = beyond_high ? -from[4 + axis] <= cell.high[axis] : from[axis] >= cell.low[axis];
        const int triangle = id_of(from);
        if (to != from) copy_box(to, from);
        if (inside || clip(mesh, cell, triangle, to)) {
            unite(bounds, to);
            to += 8;
        }
    }
    for (int j = 0; j < 3; ++j) {
        inner_low.c[j] = bounds[j];
        inner_high.c[j] = -bounds[4 + j];
    }
    return (int)((to - range) / 8);
}

/// Where the references of both sides go; nowhere if they are not `moving`.
struct SideTargets {
    bool moving;
    float *left, *right;
    float unwanted[8];

    template <class Sides> CUDA_CALLABLE void write(const float* box, OnSides on, Sides& sides)
    {
        if (moving) {
            copy_box(on.left ? left + (size_t)sides.left * 8 : unwanted, box);
            copy_box(on.right ? right + (size_t)sides.right * 8 : unwanted, box);
        }
        sides.left += on.left;
        sides.right += on.right;
    }
};

/// Clips the straddlers of a range to the cells on both sides of a plane, counts the references of both, and computes their
/// boxes; see `wrt.builders.kdtree.scan.reference_chunks.clip_chunk`.
template <class Mesh, class Split, class Sides>
inline CUDA_CALLABLE void clip_sides(const Mesh& mesh, const ClipCell& left, const ClipCell& right, const float* from,
    int count, const Split& split, SideTargets targets, Sides& sides)
{
    float low_side[8], high_side[8];
    set_empty(low_side);
    set_empty(high_side);
    sides.left = 0;
    sides.right = 0;
    for (int i = 0; i < count; ++i, from += 8) {
        const OnSides on = classify(from, split.axis, split.position, split.planar_left);
        const bool both = on.left & on.right;
        for (int side = 0; side < (both ? 2 : 1); ++side) {
            float reference[8];
            copy_box(reference, from);
            if (both && !clip(mesh, side ? right : left, id_of(from), reference)) continue;
            const OnSides here = both ? OnSides {!side, side} : on;
            grow_sides(low_side, high_side, reference, here);
            targets.write(reference, here, sides);
        }
    }
    store_sides(low_side, high_side, sides);
}

/// Writes the parts of `count` references in a cell behind one another; returns the number of nonempty ones. ids: triangles by
/// the references' ids.
template <class Mesh>
inline CUDA_CALLABLE int clip_straddlers(
    const Mesh& mesh, const ClipCell& cell, const float* from, int count, const int* ids, float* const target)
{
    float* to = target;
    for (int i = 0; i < count; ++i, from += 8) {
        copy_box(to, from);
        if (clip(mesh, cell, ids[id_of(from)], to)) to += 8;
    }
    return (int)((to - target) / 8);
}

/// Writes the box of a reference's part in a cell; false if there is none.
template <class Mesh, class Boxes>
inline CUDA_CALLABLE bool clip_part(
    const Mesh& mesh, const ClipCell& cell, const Boxes& boxes, int triangle, int source, int target)
{
    const size_t n = boxes.low.shape[1];
    float box[8] = {};
    read_box(boxes, source, box);
    if (!clip(mesh, cell, triangle, box)) return false;
    for (size_t axis = 0; axis < 3; ++axis) {
        boxes.low.data[axis * n + target] = box[axis];
        boxes.high.data[axis * n + target] = -box[4 + axis] + 0.0f;
    }
    return true;
}

/// Finds what a leaf of `wrt.builders.classics.kdtree.postprocess` contains: the triangles that meet its cell, all of them if
/// they are not `tested`, and the box within the cell of these triangles, or of their parts.
template <class Mesh, class Boxes, class Leaves>
inline CUDA_CALLABLE void measure_leaf(const Mesh& mesh, const Boxes& boxes, const Leaves& leaves, int leaf, bool tested)
{
    const ClipCell cell = cell_of(leaves.low.data[leaf], leaves.high.data[leaf], mesh.pad);
    const int* triangles = leaves.primitive.data + leaves.begin.data[leaf];
    unsigned char* keeps = leaves.keeps.data + leaves.begin.data[leaf];
    float bounds[8];
    set_empty(bounds);
    int kept = 0;
    for (int i = 0; i < leaves.count.data[leaf]; ++i) {
        float box[8] = {};
        read_box(boxes, triangles[i], box);
        const bool meets = !tested || clip(mesh, cell, triangles[i], box);
        if (meets) unite(bounds, box);
        keeps[i] = meets;
        kept += meets;
    }
    leaves.kept.data[leaf] = kept;
    auto& low = leaves.inner_low.data[leaf];
    auto& high = leaves.inner_high.data[leaf];
    for (int axis = 0; axis < 3; ++axis) {
        low.c[axis] = bounds[axis] > cell.low[axis] ? bounds[axis] : cell.low[axis];
        high.c[axis] = -bounds[4 + axis] < cell.high[axis] ? -bounds[4 + axis] : cell.high[axis];
    }
}

// -- spatial splits: `wrt.builders.bvh.spatial.part_splits`, of which `Slabs` is ----------------------------------------------

template <class Slabs> inline CUDA_CALLABLE int slab_of(const Slabs& slabs, float x)
{
    float t = (x - slabs.low) * slabs.scale;
    t = t > 0.0f ? t : 0.0f;
    t = t < (float)(slabs.count - 1) ? t : (float)(slabs.count - 1);
    return (int)t;
}

/// Shrinks the box of a reference to its part between two planes; false if it has none.
template <class Mesh> inline CUDA_CALLABLE bool part_between(const Mesh& mesh, float* box, int axis, float from, float to)
{
    ClipCell cell = {{box[0], box[1], box[2]}, {-box[4], -box[5], -box[6]}, mesh.pad};
    cell.low[axis] = from > cell.low[axis] ? from : cell.low[axis];
    cell.high[axis] = to < cell.high[axis] ? to : cell.high[axis];
    return clip(mesh, cell, id_of(box), box);
}

/// Bins the parts of a range of triangles along an axis: boxes, numbers of entering and of leaving triangles.
template <class Mesh, class Slabs>
inline CUDA_CALLABLE void bin_parts(
    const Mesh& mesh, const float* from, int count, const Slabs& slabs, float* grid, int* enter, int* leave)
{
    const int axis = slabs.axis;
    for (int b = 0; b < slabs.count; ++b) {
        set_empty(grid + b * 8);
        enter[b] = 0;
        leave[b] = 0;
    }
    const float width = 1.0f / slabs.scale;
    for (int i = 0; i < count; ++i, from += 8) {
        const int b0 = slab_of(slabs, from[axis]), b1 = slab_of(slabs, -from[4 + axis]);
        ++enter[b0];
        ++leave[b1];
        for (int b = b0; b <= b1; ++b) {
            float part[8];
            copy_box(part, from);
            if (b0 < b1) {
                const float at = b == b0 ? -WRT_INFINITY : slabs.low + (float)b * width;
                const float end = b == b1 ? WRT_INFINITY : slabs.low + (float)(b + 1) * width;
                if (!part_between(mesh, part, axis, at, end)) continue;
            }
            unite(grid + b * 8, part);
        }
    }
}

/// Moves a range to the sides of the plane before slab `plane`, in order, and straddlers to both, with the boxes of their
/// parts. Returns the numbers of both sides.
template <class Vec2i, class Mesh, class Slabs>
inline CUDA_CALLABLE Vec2i divide_parts(
    const Mesh& mesh, const float* from, int count, const Slabs& slabs, int plane, float* left, float* right)
{
    const float at = slabs.low + (float)plane / slabs.scale;
    const int axis = slabs.axis;
    int lefts = 0, rights = 0;
    for (int i = 0; i < count; ++i, from += 8) {
        const bool on_left = slab_of(slabs, from[axis]) < plane, on_right = slab_of(slabs, -from[4 + axis]) >= plane;
        if (!(on_left && on_right)) {
            copy_box(on_left ? left + (size_t)lefts * 8 : right + (size_t)rights * 8, from);
            lefts += on_left;
            rights += !on_left;
            continue;
        }
        float a[8], b[8];
        copy_box(a, from);
        copy_box(b, from);
        const bool second = part_between(mesh, b, axis, at, WRT_INFINITY);
        const bool first = part_between(mesh, a, axis, -WRT_INFINITY, at);
        if (first) copy_box(left + (size_t)lefts++ * 8, a);
        if (second) copy_box(right + (size_t)rights++ * 8, b);
    }
    return Vec2i(lefts, rights);
}

}  // namespace
}  // namespace wrt
