// Triangle tests in lanes: the watertight test, for one ray x W triangles and for pairs of a ray and a triangle, and the loops
// of tests that are written as steps (wrt.kernels.triangle.support.lane_form).
//
// The watertight test is described in wrt.kernels.triangle.watertight. F is float, a vector of floats, or double.
#pragma once
#include "lanes.h"

#if WRT_VECTORS
#define WRT_APART __attribute__((noinline))
#else
#define WRT_APART CUDA_CALLABLE
#endif

namespace wrt {
namespace {

/// Summed areas that are less than this part of their first products have lost digits that matter.
constexpr float THIN = 0.25f;

/// Smallest normal float: a smaller area may have lost some or all of its digits.
constexpr float SMALL_AREA = 1.1754944e-38f;

/// Brings areas that are too small for a float into its range.
constexpr double AREA_SCALE = 1.6069380442589903e60;

/// The vertices of a triangle, sheared so that the ray is the third axis: two coordinates across it, and the depth along it.
template <class F> struct Sheared {
    F x[3], y[3], depth[3];
};

/// Signed areas opposite the vertices a, b, c, which weigh these.
template <class F> struct Areas {
    F a, b, c;
};

template <class F> struct TriangleHit {
    F t, u, v;
};

/// from(vertex, axis): coordinates of the vertices less the ray's origin, in the ray's order of axes.
template <class F, class From> inline CUDA_CALLABLE Sheared<F> sheared(F slope_x, F slope_y, const From& from)
{
    Sheared<F> s;
    s.depth[0] = from(0, 2), s.depth[1] = from(1, 2), s.depth[2] = from(2, 2);
    s.x[0] = from(0, 0) - slope_x * s.depth[0], s.y[0] = from(0, 1) - slope_y * s.depth[0];
    s.x[1] = from(1, 0) - slope_x * s.depth[1], s.y[1] = from(1, 1) - slope_y * s.depth[1];
    s.x[2] = from(2, 0) - slope_x * s.depth[2], s.y[2] = from(2, 1) - slope_y * s.depth[2];
    return s;
}

template <class F> inline CUDA_CALLABLE Areas<F> areas_of(const Sheared<F>& s)
{
    return {s.x[2] * s.y[1] - s.y[2] * s.x[1], s.x[0] * s.y[2] - s.y[0] * s.x[2], s.x[1] * s.y[0] - s.y[1] * s.x[0]};
}

/// The areas in float64, in which products of floats are exact: their signs are those of the exact areas.
inline CUDA_CALLABLE Areas<double> exact_areas(const Sheared<float>& s)
{
    return areas_of<double>({{s.x[0], s.x[1], s.x[2]}, {s.y[0], s.y[1], s.y[2]}, {}});
}

inline CUDA_CALLABLE Areas<float> rounded(const Areas<double>& w) { return {(float)w.a, (float)w.b, (float)w.c}; }

template <class F> inline CUDA_CALLABLE F sum(const Areas<F>& w) { return (w.a + w.b) + w.c; }

/// The sum of the magnitudes of the areas' first products.
template <class F> inline CUDA_CALLABLE F size_of(const Sheared<F>& s)
{
    return (absolute(s.x[2] * s.y[1]) + absolute(s.x[0] * s.y[2])) + absolute(s.x[1] * s.y[0]);
}

/// What combined comparisons of F give: an int, or a vector of 0 and -1.
template <class F> using Mask = decltype((F() < F()) & (F() < F()));

/// Whether no two areas have opposite signs, without a branch.
template <class F> inline CUDA_CALLABLE Mask<F> on_one_side(const Areas<F>& w)
{
    return ((w.a >= 0.0f) & (w.b >= 0.0f) & (w.c >= 0.0f)) | ((w.a <= 0.0f) & (w.b <= 0.0f) & (w.c <= 0.0f));
}

template <class F> inline CUDA_CALLABLE Mask<F> some_zero(const Areas<F>& w)
{
    return (w.a == 0.0f) | (w.b == 0.0f) | (w.c == 0.0f);
}

/// Whether the weights of a triangle of this size are to be computed again.
template <class F> inline CUDA_CALLABLE Mask<F> is_thin(const Areas<F>& w, F size) { return absolute(sum(w)) < THIN * size; }

/// The areas of a thin triangle: those in float64, if float32 can hold them.
inline CUDA_CALLABLE Areas<float> precise_areas(const Sheared<float>& s, const Areas<float>& w)
{
    const Areas<float> fine = rounded(exact_areas(s));
    const bool fits = sum(fine) != 0.0f;
    return {fits ? fine.a : w.a, fits ? fine.b : w.b, fits ? fine.c : w.c};
}

/// t, u and v of a hit. along: 1 / direction along the main axis; it is multiplied last, as the product of all three may
/// overflow where t does not.
template <class F> inline CUDA_CALLABLE TriangleHit<F> weighed(const Areas<F>& w, const F& a, const F& b, const F& c, F along)
{
    const F scale = 1.0f / sum(w);
    return {along * (((w.a * a + w.b * b) + w.c * c) * scale), w.b * scale, w.c * scale};
}

/// The rule by which a triangle contains its edges. unsure: whether `decide` must find from exact areas if the line meets the
/// triangle, and its weights.
struct Inclusive {
    static constexpr bool ORIENTED = false;

    static CUDA_CALLABLE bool unsure(const Areas<float>& w) { return some_zero(w); }

    static CUDA_CALLABLE bool decide(const Sheared<float>& s, Areas<float>& w)
    {
        w = rounded(exact_areas(s));
        return on_one_side(w) & (sum(w) != 0.0f);
    }
};

/// The rule by which a line meets one of the triangles at an edge or a vertex, to count crossings.
struct Crossing {
    static constexpr bool ORIENTED = false;

    static CUDA_CALLABLE bool unsure(const Areas<float>& w)
    {
        const float a = absolute(w.a), b = absolute(w.b), c = absolute(w.c);
        return (a < SMALL_AREA) | (b < SMALL_AREA) | (c < SMALL_AREA);
    }

    /// Side of the edge p q on which the symbolically moved origin lies; 0 if p and q coincide.
    static CUDA_CALLABLE int side(double area, const Sheared<float>& s, int p, int q)
    {
        const float px = s.x[p], py = s.y[p], qx = s.x[q], qy = s.y[q];
        const int tie = py > qy ? 1 : py < qy ? -1 : qx > px ? 1 : qx < px ? -1 : 0;
        return area > 0.0 ? 1 : area < 0.0 ? -1 : tie;
    }

    static CUDA_CALLABLE bool decide(const Sheared<float>& s, Areas<float>& w)
    {
        const Areas<double> exact = exact_areas(s);
        const int first = side(exact.a, s, 2, 1);
        const bool hit = first != 0 && first == side(exact.b, s, 0, 2) && first == side(exact.c, s, 1, 0);
        const double total = sum(exact), scale = (total < 0.0 ? -total : total) < SMALL_AREA ? AREA_SCALE : 1.0;
        w = rounded({exact.a * scale, exact.b * scale, exact.c * scale});
        return hit;
    }
};

/// The same, with the sign of a crossing in place of u.
struct Oriented : Crossing {
    static constexpr bool ORIENTED = true;
};

/// 1 where a ray leaves through the triangle's front, -1 where it comes in: the areas of a triangle whose normal has a positive
/// component along the main axis are negative.
inline CUDA_CALLABLE float sign_of(const Areas<float>& w, float along)
{
    return (sum(w) < 0.0f) == (along > 0.0f) ? 1.0f : -1.0f;
}

/// A ray and the W triangles of a block, in the ray's order of axes.
template <int W> struct RayAndBlock {
    const float* axis[3];
    float origin[3], slope_x, slope_y;
#if defined(__CUDA_ARCH__)
    float row[9][W];
#endif

    template <class Ray>
    CUDA_CALLABLE RayAndBlock(const float* records, int block, const Ray& ray)
        : origin {ray.origin.c[0], ray.origin.c[1], ray.origin.c[2]}
        , slope_x(ray.shear.c[0])
        , slope_y(ray.shear.c[1])
    {
        const float* const corner = records + (size_t)block * (9 * W);
        axis[0] = corner + ray.x * W, axis[1] = corner + ray.y * W, axis[2] = corner + ray.z * W;
#if defined(__CUDA_ARCH__)
        for (int c = 0; c < 9; ++c) {
            WRT_LANES(values, axis[c % 3] + c / 3 * (3 * W));
            for (int i = 0; i < W; ++i) row[c][i] = values[i];
        }
#endif
    }

    CUDA_CALLABLE float corner(int vertex, int along, int i) const
    {
#if defined(__CUDA_ARCH__)
        return row[3 * vertex + along][i];
#else
        return axis[along][3 * W * vertex + i];
#endif
    }

    CUDA_CALLABLE Sheared<float> sheared(int i) const
    {
        return wrt::sheared<float>(
            slope_x, slope_y, [&](int vertex, int along) { return corner(vertex, along, i) - origin[along]; });
    }
};

/// `precise_areas` of a lane. Not inlined: this path runs for about one hit in a hundred and must not take registers from the
/// others.
template <int W> WRT_APART Areas<float> precise_lane(RayAndBlock<W> own, int i, Areas<float> w)
{
    return precise_areas(own.sheared(i), w);
}

/// The watertight test of one ray x the W triangles of a block: bits of those that the ray's line meets. WEIGHTS: whether t, u
/// and v of these are computed.
template <int W, class Rule, bool WEIGHTS, class Ray>
inline CUDA_CALLABLE unsigned woop_block(const float* records, int block, const Ray& ray, float* t, float* u, float* v)
{
    const RayAndBlock<W> own(records, block, ray);
    float area_a[W], area_b[W], area_c[W], depth_a[W], depth_b[W], depth_c[W], sizes[W];
    int within[W], edge[W];
    WRT_FOR_LANES (i) {
        const Sheared<float> s = own.sheared(i);
        const Areas<float> w = areas_of(s);
        area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
        depth_a[i] = s.depth[0], depth_b[i] = s.depth[1], depth_c[i] = s.depth[2];
        sizes[i] = size_of(s);
        within[i] = on_one_side(w) ? -1 : 0;
        edge[i] = Rule::unsure(w) ? -1 : 0;
    }
    unsigned mask = bits<W>(within), edges = bits<W>(edge);
    if (edges) {
        for (int i = 0; i < W; ++i) {
            if (!(edges >> i & 1u)) continue;
            Areas<float> w;
            const bool hit = Rule::decide(own.sheared(i), w);
            area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
            mask = (mask & ~(1u << i)) | (hit ? 1u << i : 0u);
        }
    }
    if (!WEIGHTS || !mask) return mask;
    int thin[W];
    WRT_FOR_LANES (i) {
        thin[i] = (is_thin<float>({area_a[i], area_b[i], area_c[i]}, sizes[i]) & (edge[i] == 0)) ? -1 : 0;
    }
    for (unsigned left = bits<W>(thin) & mask; left; left &= left - 1u) {
        const int i = lowest_bit(left);
        const Areas<float> w = precise_lane<W>(own, i, {area_a[i], area_b[i], area_c[i]});
        area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
    }
    const float along = ray.shear.c[2];
    WRT_FOR_LANES (i) {
        const Areas<float> w = {area_a[i], area_b[i], area_c[i]};
        const TriangleHit<float> hit = weighed(w, depth_a[i], depth_b[i], depth_c[i], along);
        t[i] = hit.t, u[i] = Rule::ORIENTED ? sign_of(w, along) : hit.u, v[i] = hit.v;
    }
    return mask;
}

/// The lanes in which no two areas have opposite signs. An area of zero has either sign: recomputed in float64, it may have
/// any, but the others keep theirs, because rounding is monotone. So these are all lanes that are hit, and few others. An area
/// is a NaN where its products overflow; it does not count here.
template <int W, class Ray> inline CUDA_CALLABLE unsigned woop_lines(const float* records, int block, const Ray& ray)
{
    const RayAndBlock<W> own(records, block, ray);
    int met[W];
    WRT_FOR_LANES (i) {
        const Sheared<float> s = own.sheared(i);
        const Areas<float> w = areas_of(s);
        float min_area = w.a < w.b ? w.a : w.b, max_area = w.a > w.b ? w.a : w.b;
        min_area = min_area < w.c ? min_area : w.c, max_area = max_area > w.c ? max_area : w.c;
        met[i] = (((min_area < 0.0f) & (max_area > 0.0f)) | (s.depth[0] != s.depth[0])) ? 0 : -1;  // a NaN in unused lanes
    }
    return bits<W>(met);
}

/// What streams keep of a ray for the watertight test (`ShearedRay`), in rows of lanes.
struct ShearedRows {
    enum { ORIGIN = 14, AXES = 17, SHEAR = 20, END = 23 };
};

/// The watertight test for L rays of a stream, and for L pairs of a ray and a triangle. words: the rows of the rays.
struct Woop {
    static constexpr bool PREPARES = true;

    /// Whether `ShearedRows` are the words of a ray's state, from row `first` on.
    template <class State> static constexpr CUDA_CALLABLE bool fits(int first)
    {
        return first == ShearedRows::ORIGIN && __builtin_offsetof(State, x) == 4 * (ShearedRows::AXES - ShearedRows::ORIGIN)
            && __builtin_offsetof(State, shear) == 4 * (ShearedRows::SHEAR - ShearedRows::ORIGIN)
            && sizeof(State) == 4 * (ShearedRows::END - ShearedRows::ORIGIN);
    }

    /// From directions and origins; the first three rows are 1 / directions.
    template <int L>
    static CUDA_CALLABLE void prepare(
        float (*words)[L], const float* dx, const float* dy, const float* dz, const float* ox, const float* oy, const float* oz)
    {
        WRT_FOR (L, k) {
            const float x = dx[k], y = dy[k], z = dz[k], px = ox[k], py = oy[k], pz = oz[k];
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            const float jx = words[0][k], jy = words[1][k], jz = words[2][k];
            const bool xy = size_x >= size_y, main_x = xy & (size_x >= size_z), main_y = !xy & (size_y >= size_z);
            const float major = main_x ? x : main_y ? y : z;
            words[ShearedRows::ORIGIN][k] = main_x ? py : main_y ? pz : px;
            words[ShearedRows::ORIGIN + 1][k] = main_x ? pz : main_y ? px : py;
            words[ShearedRows::ORIGIN + 2][k] = main_x ? px : main_y ? py : pz;
            ((int*)words[ShearedRows::AXES])[k] = main_x ? 1 : main_y ? 2 : 0;
            ((int*)words[ShearedRows::AXES + 1])[k] = main_x ? 2 : main_y ? 0 : 1;
            ((int*)words[ShearedRows::AXES + 2])[k] = main_x ? 0 : main_y ? 1 : 2;
            words[ShearedRows::SHEAR][k] = (main_x ? y : main_y ? z : x) / major;
            words[ShearedRows::SHEAR + 1][k] = (main_x ? z : main_y ? x : y) / major;
            words[ShearedRows::SHEAR + 2][k] = main_x ? jx : main_y ? jy : jz;
        }
    }

    /// corner: the nine components of the triangles. t is a NaN for a pair that is no hit.
    template <int W>
    static CUDA_CALLABLE void test(const float (*words)[W], const float (*corner)[W], float* t, float* u, float* v)
    {
        float x[3][W], y[3][W], depth[3][W], area_a[W], area_b[W], area_c[W];
        int hits[W], edges[W];
        const int* main_axis = (const int*)words[ShearedRows::AXES + 2];
        // selected bit by bit: of selects between loads, the compiler makes gathers from selected addresses
        const auto along = [&](int i, int vertex, int turn) {
            const int x_first = main_axis[i] == 0 ? -1 : 0, y_first = main_axis[i] == 1 ? -1 : 0;
            const int same = __builtin_bit_cast(int, corner[3 * vertex + turn][i]) & ~(x_first | y_first);
            const int next = __builtin_bit_cast(int, corner[3 * vertex + (turn + 1) % 3][i]) & x_first;
            const int last = __builtin_bit_cast(int, corner[3 * vertex + (turn + 2) % 3][i]) & y_first;
            return __builtin_bit_cast(float, same | next | last);
        };
        WRT_FOR_LANES (i) {
            const Sheared<float> s = sheared<float>(words[ShearedRows::SHEAR][i], words[ShearedRows::SHEAR + 1][i],
                [&](int vertex, int turn) { return along(i, vertex, turn) - words[ShearedRows::ORIGIN + turn][i]; });
            const Areas<float> w = areas_of(s);
            x[0][i] = s.x[0], x[1][i] = s.x[1], x[2][i] = s.x[2];
            y[0][i] = s.y[0], y[1][i] = s.y[1], y[2][i] = s.y[2];
            depth[0][i] = s.depth[0], depth[1][i] = s.depth[1], depth[2][i] = s.depth[2];
            area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
            hits[i] = on_one_side(w) ? -1 : 0;
            edges[i] = (some_zero(w) | ((hits[i] != 0) & is_thin(w, size_of(s)))) ? -1 : 0;
        }
        for (unsigned left = bits<W>(edges); left; left &= left - 1u) {
            const int i = lowest_bit(left);
            const Sheared<float> s = {{x[0][i], x[1][i], x[2][i]}, {y[0][i], y[1][i], y[2][i]}, {}};
            Areas<float> w = {area_a[i], area_b[i], area_c[i]};
            if (some_zero(w)) hits[i] = Inclusive::decide(s, w) ? -1 : 0;
            else w = precise_areas(s, w);
            area_a[i] = w.a, area_b[i] = w.b, area_c[i] = w.c;
        }
        WRT_FOR_LANES (i) {
            const Areas<float> w = {area_a[i], area_b[i], area_c[i]};
            const TriangleHit<float> hit
                = weighed<float>(w, depth[0][i], depth[1][i], depth[2][i], words[ShearedRows::SHEAR + 2][i]);
            t[i] = hits[i] ? hit.t : WRT_NAN;
            u[i] = hit.u, v[i] = hit.v;
        }
    }
};

/// One ray x W triangles by steps, each a function of the lane that tells whether the ray still meets its triangle: bits of the
/// lanes that pass all. The next step runs if a lane is left.
template <int W, class Step, class... Later>
inline CUDA_CALLABLE unsigned block_steps(unsigned mask, const Step& step, const Later&... later)
{
    int passed[W];
    WRT_FOR_LANES (i) {
        passed[i] = step(i) ? -1 : 0;
    }
    mask &= bits<W>(passed);
    if constexpr (sizeof...(later) > 0) return mask ? block_steps<W>(mask, later...) : 0u;
    else return mask;
}

/// W rays x one triangle by steps, likewise. inside: 1 for the lanes that pass all. Returns whether there are any. FIRST:
/// whether `inside` is not yet set.
template <int W, bool FIRST = true, class Step, class... Later>
inline CUDA_CALLABLE bool packet_steps(int* inside, const Step& step, const Later&... later)
{
    int some = 0;
    WRT_FOR_LANES (i) {
        const bool passes = step(i);
        inside[i] = FIRST ? passes : (inside[i] != 0) & passes;
        some |= inside[i];
    }
    if constexpr (sizeof...(later) > 0) return some && packet_steps<W, false>(inside, later...);
    else return some != 0;
}

}  // namespace
}  // namespace wrt
