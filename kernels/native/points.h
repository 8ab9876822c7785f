// Nearest triangles of points: the distance of a point from a triangle, W triangles at a time, and walks of trees.
//
// wrt.kernels.points has the formulas and the bounds of their rounding, and point_triangle.py the same operations in plain Warp.
// Everything is relative to the point, which is the origin.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// A triangle whose doubled area squared is less than this part of its edges' product has its weights computed in float64.
constexpr float FLAT = 0.0009765625f;

/// The same for areas outside of this range, in which float32 keeps all digits.
constexpr float LEAST_AREA = 1e-30f, GREATEST_AREA = 1e30f;

/// A foot on the face is nearer than all edges, so it is taken although rounding makes it farther, by no more than this part of its
/// squared distance and this part of that of the triangle's first vertex.
constexpr float FACE_SHARE = 1.000003814697265625f, FACE_SLACK = 3.637978807091713e-12f;

/// Distances of boxes and of triangles may be wrong by this part of the distance of the farthest point of the scene.
constexpr float POINT_SLACK = 1.9073486328125e-6f;

/// Squares of distances below this are no normal numbers.
constexpr float LEAST_DISTANCE = 1e-18f;

/// Greatest number of inner nodes on a path from the root.
constexpr int TREE_DEPTH = 64;

struct Offset {
    float x, y, z;
};

inline CUDA_CALLABLE Offset operator-(const Offset& p, const Offset& q) { return {p.x - q.x, p.y - q.y, p.z - q.z}; }
inline CUDA_CALLABLE float dot(const Offset& p, const Offset& q) { return (p.x * q.x + p.y * q.y) + p.z * q.z; }

inline CUDA_CALLABLE Offset cross(const Offset& p, const Offset& q)
{
    return {p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x};
}

inline CUDA_CALLABLE Offset moved(const Offset& p, float t, const Offset& e)
{
    return {p.x + t * e.x, p.y + t * e.y, p.z + t * e.z};
}

/// The nearest point of an edge: the square of its distance, and its place from the nearer end, whichever that is.
struct OnEdge {
    float square, place;
    bool from_second;
};

/// pp, qq: squared lengths of the ends p and q. Both triangles at an edge get the same square.
inline CUDA_CALLABLE OnEdge nearest_on_edge(const Offset& p, const Offset& q, float pp, float qq)
{
    const bool second = qq < pp;
    const Offset d = q - p, base = {second ? q.x : p.x, second ? q.y : p.y, second ? q.z : p.z};
    const Offset e = {second ? -d.x : d.x, second ? -d.y : d.y, second ? -d.z : d.z};
    float t = -dot(base, e) / dot(e, e);
    t = t > 0.0f ? t : 0.0f;
    t = t < 1.0f ? t : 1.0f;
    const Offset at = moved(base, t, e);
    return {dot(at, at), t, second};
}

/// The nearest point of a triangle: the square of its distance, the weights of b and c, and the dimension of what it is on.
struct OnTriangle {
    float square, u, v;
    int feature;
};

/// Weights of b and c at the foot of the perpendicular on the plane. The triangle has no area: NaN, or an infinity.
struct Foot {
    float u, v;
    bool flat;
};

inline CUDA_CALLABLE Foot foot_on_plane(const Offset& a, const Offset& ab, const Offset& ac)
{
    const Offset n = cross(ab, ac);
    const float area = dot(n, n);
    const bool sure = (area >= FLAT * (dot(ab, ab) * dot(ac, ac))) & (area > LEAST_AREA) & (area < GREATEST_AREA);
    return {dot(n, cross(ac, a)) / area, dot(n, cross(a, ab)) / area, !sure};
}

/// The same in float64, for triangles without much of an area.
inline CUDA_CALLABLE Foot exact_foot(const Offset& a, const Offset& ab, const Offset& ac)
{
    const double ax = a.x, ay = a.y, az = a.z, bx = ab.x, by = ab.y, bz = ab.z, cx = ac.x, cy = ac.y, cz = ac.z;
    const double nx = by * cz - bz * cy, ny = bz * cx - bx * cz, nz = bx * cy - by * cx;
    const double area = (nx * nx + ny * ny) + nz * nz;
    const double b = (nx * (cy * az - cz * ay) + ny * (cz * ax - cx * az)) + nz * (cx * ay - cy * ax);
    const double c = (nx * (ay * bz - az * by) + ny * (az * bx - ax * bz)) + nz * (ax * by - ay * bx);
    return {(float)(b / area), (float)(c / area), false};
}

/// The squared distance of the foot if it is inside the face; infinity if not.
inline CUDA_CALLABLE float square_of_foot(const Offset& a, const Offset& ab, const Offset& ac, const Foot& foot)
{
    const Offset at = moved(moved(a, foot.u, ab), foot.v, ac);
    const bool within = (foot.u > 0.0f) & (foot.v > 0.0f) & (foot.u + foot.v < 1.0f);
    return within ? dot(at, at) : WRT_INFINITY;
}

/// The nearest point of one triangle.
inline CUDA_CALLABLE OnTriangle nearest_on_triangle(const Offset& a, const Offset& b, const Offset& c)
{
    const float aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
    const OnEdge ab = nearest_on_edge(a, b, aa, bb), bc = nearest_on_edge(b, c, bb, cc), ca = nearest_on_edge(c, a, cc, aa);
    const float from_a = 1.0f - ab.place, from_b = 1.0f - bc.place, from_c = 1.0f - ca.place;
    OnTriangle found = {ab.square, ab.from_second ? from_a : ab.place, 0.0f, 0};
    float place = ab.place;
    if (bc.square < found.square) {
        found = {bc.square, bc.from_second ? bc.place : from_b, bc.from_second ? from_b : bc.place, 0};
        place = bc.place;
    }
    if (ca.square < found.square) {
        found = {ca.square, 0.0f, ca.from_second ? ca.place : from_c, 0};
        place = ca.place;
    }
    found.feature = ((place > 0.0f) & (place < 1.0f)) ? 1 : 0;
    const Offset e1 = b - a, e2 = c - a;
    Foot foot = foot_on_plane(a, e1, e2);
    if (foot.flat) foot = exact_foot(a, e1, e2);
    const float square = square_of_foot(a, e1, e2, foot);
    if (square <= found.square * FACE_SHARE + aa * FACE_SLACK) found = {square, foot.u, foot.v, 2};
    return found;
}

/// The best triangle so far. slot: where it is in the blocks; limit: no box whose squared distance is greater is searched.
struct NearestTriangle {
    float square;
    int primitive, slot;
    float limit;
};

/// A point, the distance beyond which it does not search, and that of the farthest point of the scene.
struct SearchPoint {
    float x, y, z, most, slack;
};

inline CUDA_CALLABLE float square_root(float x)
{
#if defined(__CUDA_ARCH__)
    return sqrtf(x);
#else
    return __builtin_sqrtf(x);
#endif
}

/// The greatest squared distance of a box that may hold a triangle as near as `distance`, as both are computed.
inline CUDA_CALLABLE float limit_of(float distance, const SearchPoint& point)
{
    const float wide = distance + point.slack;
    return wide * wide * 1.000001f;
}

inline CUDA_CALLABLE void keep_nearer(NearestTriangle& best, float square, int primitive, int slot, const SearchPoint& point)
{
    const bool nearer = (square < best.square) | ((square == best.square) & (primitive < best.primitive));
    if (!nearer) return;
    const float distance = square_root(square);
    best.square = square, best.primitive = primitive, best.slot = slot;
    best.limit = limit_of(distance < point.most ? distance : point.most, point);
}

/// The vertex of a record, less the point.
template <int W> inline CUDA_CALLABLE Offset vertex_at(const float* record, int vertex, const SearchPoint& point)
{
    const float* const from = record + 3 * W * vertex;
    return {from[0] - point.x, from[W] - point.y, from[2 * W] - point.z};
}

/// The W triangles of a block. record: the vertices, in rows of W lanes.
template <int W>
inline CUDA_CALLABLE void search_block(
    const float* records, const int* ids, int block, const SearchPoint& point, NearestTriangle& best)
{
    const float* const record = records + (size_t)block * (9 * W);
    float square[W];
    int flat[W], near[W];
    const float bound = best.square;
    WRT_FOR_LANES (i) {
        const Offset a = vertex_at<W>(record + i, 0, point), b = vertex_at<W>(record + i, 1, point);
        const Offset c = vertex_at<W>(record + i, 2, point);
        const float aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
        const float ab = nearest_on_edge(a, b, aa, bb).square, bc = nearest_on_edge(b, c, bb, cc).square;
        const float ca = nearest_on_edge(c, a, cc, aa).square;
        float least = bc < ab ? bc : ab;
        least = ca < least ? ca : least;
        const Offset e1 = b - a, e2 = c - a;
        const Foot foot = foot_on_plane(a, e1, e2);
        const float face = square_of_foot(a, e1, e2, foot);
        flat[i] = (foot.flat & (least == least)) ? -1 : 0;
        least = ((face <= least * FACE_SHARE + aa * FACE_SLACK) & !foot.flat) ? face : least;
        square[i] = least;
        near[i] = least <= bound ? -1 : 0;
    }
    unsigned left = bits<W>(near);
    for (unsigned thin = bits<W>(flat); thin; thin &= thin - 1u) {
        const int i = lowest_bit(thin);
        const Offset a = vertex_at<W>(record + i, 0, point), b = vertex_at<W>(record + i, 1, point);
        square[i] = nearest_on_triangle(a, b, vertex_at<W>(record + i, 2, point)).square;
        left |= square[i] <= bound ? 1u << i : 0u;
    }
    for (; left; left &= left - 1u) {
        const int i = lowest_bit(left), slot = block * W + i;
        keep_nearer(best, square[i], ids[slot], slot, point);
    }
}

/// Squared distance along an axis, of an interval.
inline CUDA_CALLABLE float outside(float low, float high, float x)
{
    const float below = low - x, above = x - high, most = below > above ? below : above;
    return most > 0.0f ? most : 0.0f;
}

/// Keys of the children of a node that may hold something nearer: the squared distance, whose lowest bits name the child; -1 for
/// others. Returns how many there are.
template <int W> inline CUDA_CALLABLE int child_keys(const float* box, const SearchPoint& point, float limit, int* key)
{
    int near[W];
    WRT_FOR_LANES (i) {
        const float x = outside(box[i], box[3 * W + i], point.x), y = outside(box[W + i], box[4 * W + i], point.y);
        const float z = outside(box[2 * W + i], box[5 * W + i], point.z), square = (x * x + y * y) + z * z;
        const bool meets = (square <= limit) & (square < WRT_INFINITY);
        near[i] = meets ? -1 : 0;
        key[i] = meets ? (__builtin_bit_cast(int, square) & ~(W - 1)) | i : -1;
    }
    return count_bits(bits<W>(near));
}

/// Sorts keys, the greatest first.
template <int W> inline CUDA_CALLABLE void sort_keys(int* key)
{
#if WRT_VECTORS
    save(key, sort<W>(load<Vector<int, W>>(key)));
#else
    for (int i = 1; i < W; ++i)
        for (int j = i; j > 0 && key[j] > key[j - 1]; --j) {
            const int other = key[j];
            key[j] = key[j - 1], key[j - 1] = other;
        }
#endif
}

/// The nearest triangle in a wide BVH. Children wait on a stack, those of a node sorted, the nearest on top.
template <int W, class Tree, class Triangles>
inline CUDA_CALLABLE void walk_boxes(
    const Tree& tree, const Triangles& triangles, const SearchPoint& point, NearestTriangle& best)
{

    int keys[TREE_DEPTH * (W - 1) + 1 + W], nodes[TREE_DEPTH * (W - 1) + 1 + W], size = 0, node = 0;
    const float* const bounds = tree.bounds.data;
    const int* const child = tree.child.data;
    while (true) {
        const int count = child_keys<W>(bounds + (size_t)node * (6 * W), point, best.limit, keys + size);
        if (count > 1) sort_keys<W>(keys + size);
        else if (count == 1) {
            int only = -1;
            for (int i = 0; i < W; ++i) only = keys[size + i] > only ? keys[size + i] : only;
            keys[size] = only;
        }
        for (int i = 0; i < W; ++i) nodes[size + i] = node;
        size += count;
        node = -1;
        while (size > 0 && node < 0) {
            --size;
            if (!(__builtin_bit_cast(float, keys[size] & ~(W - 1)) <= best.limit)) continue;
            const int word = child[nodes[size] * W + (keys[size] & (W - 1))];
            if (word >= 0) node = word;
            else {
                int block = ~word >> 6;
                for (int left = ~word & 63; left > 0; left -= W)
                    search_block<W>(triangles.records.data, triangles.primitive.data, block++, point, best);
            }
        }
        if (node < 0) return;
    }
}

/// A cell that waits, with its distance from the point along each axis.
struct WaitingCell {
    int node;
    float away[3];
};

/// The nearest triangle in a kd-tree: the nearer child first.
template <int W, class Tree, class Triangles>
inline CUDA_CALLABLE void walk_cells(
    const Tree& tree, const Triangles& triangles, const SearchPoint& point, NearestTriangle& best)
{

    const float at[3] = {point.x, point.y, point.z};
    WaitingCell stack[TREE_DEPTH + 1], cell = {tree.root, {}};
    for (int a = 0; a < 3; ++a) cell.away[a] = outside(tree.low.c[a], tree.high.c[a], at[a]);
    int size = 0;
    stack[size++] = cell;
    while (size > 0) {
        cell = stack[--size];
        const float square = (cell.away[0] * cell.away[0] + cell.away[1] * cell.away[1]) + cell.away[2] * cell.away[2];
        if (!(square <= best.limit)) continue;
        int first = tree.nodes.data[cell.node].c[0], second = tree.nodes.data[cell.node].c[1];
        while ((second & 3) != 3) {
            const int axis = second & 3, right = second >> 2;
            const float away = at[axis] - __builtin_bit_cast(float, first);
            WaitingCell far = cell;
            far.node = away < 0.0f ? right : cell.node + 1;
            const float own = WRT_ABS(away);
            far.away[axis] = own > cell.away[axis] ? own : cell.away[axis];
            cell.node = away < 0.0f ? cell.node + 1 : right;
            stack[size++] = far;
            first = tree.nodes.data[cell.node].c[0], second = tree.nodes.data[cell.node].c[1];
        }
        for (int left = second >> 2; left > 0; left -= W)
            search_block<W>(triangles.records.data, triangles.primitive.data, first++, point, best);
    }
}

/// The trees, as `nearest_of_group` walks them.
struct BoxTree {
    template <int W, class Tree, class Triangles>
    static CUDA_CALLABLE void walk(const Tree& tree, const Triangles& triangles, const SearchPoint& p, NearestTriangle& best)
    {
        walk_boxes<W>(tree, triangles, p, best);
    }
};

struct CellTree {
    template <int W, class Tree, class Triangles>
    static CUDA_CALLABLE void walk(const Tree& tree, const Triangles& triangles, const SearchPoint& p, NearestTriangle& best)
    {
        walk_cells<W>(tree, triangles, p, best);
    }
};

/// What a point searches; `slack` is a NaN for one that finds nothing.
template <class Tree, class Points> inline CUDA_CALLABLE SearchPoint search_point(const Tree& tree, const Points& points, int i)
{
    const auto& given = points.position.data[i];
    const float most = points.most.data[(size_t)i * points.most_stride];
    float reach = 0.0f;
    for (int a = 0; a < 3; ++a) {
        const float below = WRT_ABS(tree.low.c[a] - given.c[a]), above = WRT_ABS(tree.high.c[a] - given.c[a]);
        reach += below > above ? below : above;
    }
    const bool valid = (reach - reach == 0.0f) & (most >= 0.0f);
    return {given.c[0], given.c[1], given.c[2], most, valid ? reach * POINT_SLACK + LEAST_DISTANCE : WRT_NAN};
}

/// The answer of a point: of a triangle in `slot`, whose distance must not be greater than the point allows.
template <int W, class Triangles, class Found>
inline CUDA_CALLABLE void store_nearest(
    const Triangles& triangles, const SearchPoint& point, const NearestTriangle& best, const Found& found, int i)
{
    const float distance = square_root(best.square);
    OnTriangle at = {0.0f, 0.0f, 0.0f, -1};
    const bool is_found = (best.slot >= 0) & (distance <= point.most);
    if (is_found) {
        const float* const record = triangles.records.data + (size_t)(best.slot / W) * (9 * W) + best.slot % W;
        const Offset a = vertex_at<W>(record, 0, point), b = vertex_at<W>(record, 1, point);
        at = nearest_on_triangle(a, b, vertex_at<W>(record, 2, point));
    }
    found.distance.data[i] = is_found ? distance : WRT_INFINITY;
    found.primitive.data[i] = is_found ? best.primitive : -1;
    found.uv.data[i].c[0] = at.u, found.uv.data[i].c[1] = at.v;
    found.feature.data[i] = (signed char)at.feature;
}

/// The answers of GROUP points from number `first` of the order on. Each begins with the triangles that were nearest to the
/// point before it.
template <class Kind, int W, int GROUP, class Tree, class Triangles, class Points, class Found>
inline CUDA_CALLABLE void nearest_of_group(
    const Tree& tree, const Triangles& triangles, const Points& points, const Found& found, int first)
{
    int block = -1;
    for (int place = first; place < first + GROUP && place < points.count; ++place) {
        const int i = points.order.shape[0] ? points.order.data[place] : place;
        const SearchPoint point = search_point(tree, points, i);
        NearestTriangle best = {WRT_INFINITY, -1, -1, limit_of(point.most, point)};
        if (point.slack == point.slack) {
            if (block >= 0) search_block<W>(triangles.records.data, triangles.primitive.data, block, point, best);
            Kind::template walk<W>(tree, triangles, point, best);
        }
        if (best.slot >= 0) block = best.slot / W;
        store_nearest<W>(triangles, point, best, found, i);
    }
}

}  // namespace
}  // namespace wrt
