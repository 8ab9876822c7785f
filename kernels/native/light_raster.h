// Conservative rasterisation of triangles onto the cube of directions around a point light: `wrt.builders.lights.light_raster`,
// which has the proof. Cells and entries: `wrt.kernels.layout.light_cells`.
#pragma once
#include "loops.h"
#include "square_root.h"

namespace wrt {
namespace {

/// Of u and v, and of depths: see `wrt.kernels.layout.light_cells`.
constexpr double CELL_SLACK = 0x1p-20, DEPTH_SLACK = 0x1p-20;

/// Bits of the float32 infinity.
constexpr int INFINITY_BITS = 0x7f800000;

/// The depths behind which cells are covered; the lengths of the lists; the lists.
enum class RasterStage { COVER, COUNT, FILL };

inline CUDA_CALLABLE int fetch_add(int* at, int value)
{
#if defined(__CUDA_ARCH__)
    return atomicAdd(at, value);
#else
    return __atomic_fetch_add(at, value, __ATOMIC_RELAXED);
#endif
}

inline CUDA_CALLABLE void lower(int* at, int value)
{
#if defined(__CUDA_ARCH__)
    atomicMin(at, value);
#else
    int known = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (value < known && !__atomic_compare_exchange_n(at, &known, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) { }
#endif
}

inline CUDA_CALLABLE double greater(double p, double q) { return p > q ? p : q; }
inline CUDA_CALLABLE double lesser(double p, double q) { return p < q ? p : q; }
inline CUDA_CALLABLE double size_of(double p) { return p < 0.0 ? -p : p; }
inline CUDA_CALLABLE double size_of(const double* p) { return size_of(p[0]) + size_of(p[1]) + size_of(p[2]); }
inline CUDA_CALLABLE double dot3(const double* p, const double* q) { return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]; }

inline CUDA_CALLABLE void cross3(const double* p, const double* q, double* r)
{
    r[0] = p[1] * q[2] - p[2] * q[1];
    r[1] = p[2] * q[0] - p[0] * q[2];
    r[2] = p[0] * q[1] - p[1] * q[0];
}

/// Squared distance of the origin from an edge.
inline CUDA_CALLABLE double from_edge(const double* p, const double* q)
{
    const double e[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]}, length = dot3(e, e);
    double at = length > 0.0 ? -dot3(p, e) / length : 0.0;
    at = at < 0.0 ? 0.0 : at > 1.0 ? 1.0 : at;
    const double r[3] = {p[0] + at * e[0], p[1] + at * e[1], p[2] + at * e[2]};
    return dot3(r, r);
}

/// A triangle seen from the light at the origin. edge: normals of the planes through the light and an edge; rho: lower bound of
/// the largest component of any point of the triangle, or of its box.
struct SeenTriangle {
    double vertex[3][3], slack;
    double normal[3], edge[3][3], volume, volume_low, volume_high;
    double box_low[3], box_high[3], rho;

    /// False for a triangle that turns its front to the light, if only backs count.
    template <bool BACKS_ONLY> CUDA_CALLABLE bool set_planes()
    {
        const auto& p = vertex;
        const double e[3] = {p[1][0] - p[0][0], p[1][1] - p[0][1], p[1][2] - p[0][2]};
        const double f[3] = {p[2][0] - p[0][0], p[2][1] - p[0][1], p[2][2] - p[0][2]};
        cross3(e, f, normal);
        for (int k = 0; k < 3; ++k) cross3(p[k], p[(k + 1) % 3], edge[k]);
        volume = dot3(normal, p[0]);
        if (BACKS_ONLY && volume < -2.0 * size_of(normal) * slack) return false;
        const bool turn = volume < 0.0;
        volume = turn ? -volume : volume;
        for (int k = 0; k < 3; ++k) {
            normal[k] = turn ? -normal[k] : normal[k];
            for (int a = 0; a < 3; ++a) edge[k][a] = turn ? -edge[k][a] : edge[k][a];
        }
        const double normal_size = size_of(normal);
        volume_low = volume - normal_size * slack;
        volume_high = volume + normal_size * slack;
        return true;
    }

    template <bool BY_BOX> CUDA_CALLABLE void set_distance()
    {
        const auto& p = vertex;
        rho = 0.0;
        for (int a = 0; a < 3; ++a) {
            box_low[a] = lesser(p[0][a], lesser(p[1][a], p[2][a]));
            box_high[a] = greater(p[0][a], greater(p[1][a], p[2][a]));
            rho = greater(rho, greater(box_low[a], -box_high[a]));
        }
        if (!BY_BOX) {
            double far = lesser(from_edge(p[0], p[1]), lesser(from_edge(p[1], p[2]), from_edge(p[2], p[0])));
            // the foot of the perpendicular from the light is inside: it sees all edges from within
            const double steep = dot3(normal, normal);
            bool inside = steep > 0.0;
            for (int k = 0; k < 3; ++k) inside = inside & (dot3(edge[k], normal) > 0.0);
            if (inside) far = lesser(far, volume * volume / steep);
            rho = greater(rho, square_root(far) * 0.57735);
        }
        rho = rho * (1.0 - 1e-9) - slack;
    }
};

/// Axes of a face of the cube, and the sign of its first.
struct Face {
    int index, ax, ay, az;
    double sign;

    CUDA_CALLABLE explicit Face(int face)
        : index(face)
        , ax(face / 2)
        , ay((ax + 1) % 3)
        , az((ax + 2) % 3)
        , sign(face % 2 ? -1.0 : 1.0)
    {
    }
};

/// Bounds of a projection to a face.
struct Rectangle {
    double u_low = -1.0, u_high = 1.0, v_low = -1.0, v_high = 1.0;

    CUDA_CALLABLE void add_vertex(double x, double y, double z, double slack)
    {
        const double y0 = y - slack, y1 = y + slack, z0 = z - slack, z1 = z + slack, x0 = x - slack, x1 = x + slack;
        u_low = lesser(u_low, y0 / (y0 >= 0.0 ? x1 : x0));
        u_high = greater(u_high, y1 / (y1 >= 0.0 ? x0 : x1));
        v_low = lesser(v_low, z0 / (z0 >= 0.0 ? x1 : x0));
        v_high = greater(v_high, z1 / (z1 >= 0.0 ? x0 : x1));
    }

    /// That of a box between the depths `closest` and `front`.
    CUDA_CALLABLE void set_box(const SeenTriangle& seen, const Face& face, double closest, double front)
    {
        const double y0 = seen.box_low[face.ay] - seen.slack, y1 = seen.box_high[face.ay] + seen.slack;
        const double z0 = seen.box_low[face.az] - seen.slack, z1 = seen.box_high[face.az] + seen.slack;
        u_low = y0 / (y0 >= 0.0 ? front : closest);
        u_high = y1 / (y1 >= 0.0 ? closest : front);
        v_low = z0 / (z0 >= 0.0 ? front : closest);
        v_high = z1 / (z1 >= 0.0 ? closest : front);
    }

    CUDA_CALLABLE bool is_on_face() const
    {
        return u_low <= 1.0 + CELL_SLACK && u_high >= -1.0 - CELL_SLACK && v_low <= 1.0 + CELL_SLACK
            && v_high >= -1.0 - CELL_SLACK;
    }
};

/// Projects a triangle to a face; false if it is not seen there. closest: lower bound of its depth there.
template <bool BY_BOX>
inline CUDA_CALLABLE bool project(const SeenTriangle& seen, const Face& face, Rectangle& to, double& closest)
{
    const double slack = seen.slack, sign = face.sign;
    const double front = greater(sign * seen.box_low[face.ax], sign * seen.box_high[face.ax]) + slack;
    const double back = lesser(sign * seen.box_low[face.ax], sign * seen.box_high[face.ax]) - slack;
    if (!(front > 0.0)) return false;
    closest = greater(back, seen.rho);
    if (closest > front) return false;  // nearer to another face
    if (back > 0.0 && !BY_BOX) {
        to = {1e300, -1e300, 1e300, -1e300};
        for (int k = 0; k < 3; ++k) {
            const double* p = seen.vertex[k];
            to.add_vertex(sign * p[face.ax], p[face.ay], p[face.az], slack);
        }
    } else if (closest > 0.0) {
        to.set_box(seen, face, closest, front);
    }
    return to.is_on_face();
}

/// The planes of a triangle as functions of u and v on a face, c + cu u + cv v, the last of them its own. Over a cell they vary
/// by -+ span.
struct FacePlanes {
    double c[4], cu[4], cv[4], span[4], margin[3], inner[3], steepest;

    CUDA_CALLABLE FacePlanes(const SeenTriangle& seen, const Face& face, double half)
    {
        const double slack = seen.slack, rho = seen.rho;
        for (int k = 0; k < 4; ++k) {
            const double* n = k < 3 ? seen.edge[k] : seen.normal;
            c[k] = face.sign * n[face.ax];
            cu[k] = n[face.ay];
            cv[k] = n[face.az];
            span[k] = (size_of(cu[k]) + size_of(cv[k])) * half;
        }
        for (int k = 0; k < 3; ++k) {
            const double *p = seen.vertex[k], *q = seen.vertex[(k + 1) % 3];
            const double sizes = size_of(p[0]) + size_of(p[1]) + size_of(p[2]) + size_of(q[0]) + size_of(q[1]) + size_of(q[2]);
            margin[k] = rho > 0.0 ? (size_of(c[k]) + size_of(cu[k]) + size_of(cv[k])) * slack / rho : 1e300;
            inner[k] = 2.0 * slack * (sizes + 2.0 * slack);
        }
        steepest = rho > 0.0 ? seen.volume_high / rho : 1e300;
    }

    /// Whether a shadow ray of the cell around (u, v) can hit; raises the least depth of such hits, and says whether all do,
    /// and the depth by which they have.
    CUDA_CALLABLE bool sees(const SeenTriangle& seen, double u, double v, double& depth, bool& covers, double& end) const
    {
        double value[4];
        bool seen_here = true;
        for (int k = 0; k < 4; ++k) value[k] = c[k] + cu[k] * u + cv[k] * v;
        for (int k = 0; k < 3; ++k) {
            seen_here = seen_here & (value[k] + span[k] >= -margin[k]);
            covers = covers & (value[k] - span[k] >= inner[k]);
        }
        seen_here = seen_here & (value[3] - span[3] <= steepest);
        if (seen.volume_low > 0.0) seen_here = seen_here & (value[3] + span[3] > 0.0);
        if (!seen_here) return false;
        if (seen.volume_low > 0.0) depth = greater(depth, seen.volume_low / (value[3] + span[3]));
        covers = covers & (seen.volume_low > 0.0) & (value[3] - span[3] > 0.0);
        if (covers) end = seen.volume_high / (value[3] - span[3]);
        return true;
    }
};

inline CUDA_CALLABLE int bits_of(double depth) { return __builtin_bit_cast(int, (float)depth); }

/// What a stage does for a triangle in a cell, between the depths of which `near` and `far` are the bits.
template <RasterStage STAGE>
inline CUDA_CALLABLE void emit(int* cell, unsigned long long* entries, int near, int far, bool covers, int triangle)
{
    if (STAGE == RasterStage::COVER) {
        if (covers) lower(cell + 2, far);
    } else if (near <= cell[2]) {
        if (STAGE == RasterStage::COUNT) fetch_add(cell + 1, 1);
        else entries[fetch_add(cell, 1)] = (unsigned long long)(unsigned)near << 32 | (unsigned)triangle;
    }
}

inline CUDA_CALLABLE int cell_at(double w, int resolution)
{
    const double place = (w + 1.0) * (0.5 * resolution);
    return place <= 0.0 ? 0 : place >= resolution - 1 ? resolution - 1 : (int)place;
}

/// One stage of the build for the part of a triangle on a face.
template <RasterStage STAGE, bool BY_BOX, bool COVERING>
inline CUDA_CALLABLE void rasterise_face(
    const SeenTriangle& seen, const Face& face, int resolution, int triangle, int* words, unsigned long long* entries)
{
    Rectangle rectangle;
    double closest;
    if (!project<BY_BOX>(seen, face, rectangle, closest)) return;
    const int i0 = cell_at(rectangle.u_low - 2.0 * CELL_SLACK, resolution);
    const int i1 = cell_at(rectangle.u_high + 2.0 * CELL_SLACK, resolution);
    const int j0 = cell_at(rectangle.v_low - 2.0 * CELL_SLACK, resolution);
    const int j1 = cell_at(rectangle.v_high + 2.0 * CELL_SLACK, resolution);
    const FacePlanes planes(seen, face, 1.0 / resolution + CELL_SLACK);
    for (int j = j0; j <= j1; ++j)
        for (int i = i0; i <= i1; ++i) {
            const double u = (2 * i + 1) * (1.0 / resolution) - 1.0, v = (2 * j + 1) * (1.0 / resolution) - 1.0;
            double depth = greater(closest, 0.0), end = 0.0;
            bool covers = COVERING;
            if (!BY_BOX && !planes.sees(seen, u, v, depth, covers, end)) continue;
            const int near = bits_of(depth * (1.0 - DEPTH_SLACK));
            const int far = covers ? bits_of(end * (1.0 + DEPTH_SLACK)) : INFINITY_BITS;
            int* const cell = words + 4 * (size_t)((face.index * resolution + j) * resolution + i);
            emit<STAGE>(cell, entries, near, far, covers, triangle);
        }
}

/// One stage of the build for the triangle a, b, c, relative to the light.
template <RasterStage STAGE, bool BY_BOX, bool COVERING, bool BACKS_ONLY, class Vec3d>
inline CUDA_CALLABLE void rasterise(const Vec3d& a, const Vec3d& b, const Vec3d& c, int triangle, int resolution, double slack,
    int* words, unsigned long long* entries)
{
    static_assert(!(BY_BOX && COVERING), "a box covers no cell");
    SeenTriangle seen;
    seen.slack = slack;
    for (int k = 0; k < 3; ++k) {
        seen.vertex[0][k] = a.c[k];
        seen.vertex[1][k] = b.c[k];
        seen.vertex[2][k] = c.c[k];
    }
    if (!seen.set_planes<BACKS_ONLY>()) return;
    seen.set_distance<BY_BOX>();
    for (int face = 0; face < 6; ++face)
        rasterise_face<STAGE, BY_BOX, COVERING>(seen, Face(face), resolution, triangle, words, entries);
}

/// Moves an entry down a heap.
inline CUDA_CALLABLE void sink(unsigned long long* list, int place, int end)
{
    const unsigned long long value = list[place];
    while (2 * place + 1 < end) {
        int child = 2 * place + 1;
        if (child + 1 < end && list[child + 1] > list[child]) ++child;
        if (list[child] <= value) break;
        list[place] = list[child];
        place = child;
    }
    list[place] = value;
}

/// Sorts a list in place: by insertion, long ones by heapsort.
inline CUDA_CALLABLE void sort_entries(unsigned long long* list, int count)
{
    if (count <= 16) {
        for (int i = 1; i < count; ++i) {
            const unsigned long long value = list[i];
            int place = i;
            for (; place > 0 && list[place - 1] > value; --place) list[place] = list[place - 1];
            list[place] = value;
        }
        return;
    }
    for (int i = count / 2 - 1; i >= 0; --i) sink(list, i, count);
    for (int end = count - 1; end > 0; --end) {
        const unsigned long long value = list[0];
        list[0] = list[end];
        list[end] = value;
        sink(list, 0, end);
    }
}

}  // namespace
}  // namespace wrt
