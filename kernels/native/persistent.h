// One ray a thread through trees of 64-byte nodes, by persistent threads (wrt.kernels.traversal.persistent): one tree, or those
// of instances below a tree of their boxes. On the CPU an item traces one ray, by the same steps.
#pragma once
#include "packed_exact.h"
#include "persistent_threads.h"
#include "upper_level.h"

namespace wrt {
namespace {

struct WalkWork {
    int nodes, leaves, triangles;
};

/// What rays go through: the tree of a scene, of `Tree` and `Triangles`.
template <class Tree, class Triangles> struct OneTree {
    static constexpr bool NESTED = false;
    const Tree& tree;
    const Triangles& triangles;
};

/// Or the instances of meshes. top: `InstanceTree` of width 2; parts: an array of structs of a mesh's tree and triangles.
template <class Top, class Parts> struct InstanceTrees {
    static constexpr bool NESTED = true;
    const Top& top;
    const Parts& parts;
};

/// The same with the vertices of triangles in float64, by which they are tested: of the mesh, or of those that instances share.
template <class Tree, class Triangles, class Mesh> struct WideTree : OneTree<Tree, Triangles> {
    const Mesh& mesh;
};

template <class Top, class Parts, class Geometries> struct WideInstances : InstanceTrees<Top, Parts> {
    const Geometries& geometries;
};

template <class Tree, class Triangles, class Mesh>
inline CUDA_CALLABLE WideTree<Tree, Triangles, Mesh> wide_tree(const Tree& tree, const Triangles& triangles, const Mesh& mesh)
{
    return {{tree, triangles}, mesh};
}

template <class Top, class Parts, class Geometries>
inline CUDA_CALLABLE WideInstances<Top, Parts, Geometries> wide_instances(
    const Top& top, const Parts& parts, const Geometries& geometries)
{
    return {{top, parts}, geometries};
}

template <class Exact, class Batch, class Vec>
inline CUDA_CALLABLE WideRays<Exact, Batch, Vec> wide_rays(const Exact& rays, const Batch& seen, const Vec& center)
{
    return {rays, seen, center, seen.count};
}

template <class Tree, class Triangles>
inline CUDA_CALLABLE OneTree<Tree, Triangles> one_tree(const Tree& tree, const Triangles& triangles)
{
    return {tree, triangles};
}

template <class Top, class Parts>
inline CUDA_CALLABLE InstanceTrees<Top, Parts> instance_trees(const Top& top, const Parts& parts)
{
    return {top, parts};
}

/// A kernel's arguments and options. LEVELS: places of the stack; SKIPPING: whether ray i ignores triangle skipped[i % its
/// length].
template <int LEVELS_, class Answer_, bool CULLING_, bool SKIPPING_, bool COUNTING_, class Space, class Rays, class Hits,
    class Rows, class Skipped>
struct Walks {
    using Answer = Answer_;
    static constexpr int LEVELS = LEVELS_;
    static constexpr bool CULLING = CULLING_, SKIPPING = SKIPPING_, COUNTING = COUNTING_, NESTED = Space::NESTED;
    const Space space;
    const Rays& rays;
    const Hits& hits;
    const Rows& rows;
    const Skipped& skipped;
};

/// The arguments of a kernel with its options.
template <int LEVELS, class Answer, bool CULLING, bool SKIPPING, bool COUNTING, class Space, class Rays, class Hits, class Rows,
    class Skipped>
inline CUDA_CALLABLE Walks<LEVELS, Answer, CULLING, SKIPPING, COUNTING, Space, Rays, Hits, Rows, Skipped> walks_of(
    const Space& space, const Rays& rays, const Hits& hits, const Rows& rows, const Skipped& skipped)
{
    return {space, rays, hits, rows, skipped};
}

/// The walk of one ray. Its stack, LEVELS words, is apart: of a struct with an array that is indexed by a variable, nothing
/// would be in registers. FROM_ZERO: whether t_min is 0 for all rays, as in most calls; that saves two registers. instance: in
/// which the ray is, or was last, -1 for none; nodes: of its tree; of scenes without instances, neither is used.
///
/// Where an environment has few instances, `begin` tests the boxes of all (`list_instances`), and those that the ray meets wait
/// on the stack, the nearest last: for each the bits of its child's word and of the t of entry.
template <class All, bool FROM_ZERO> struct Walk {
    static constexpr bool MOVES = All::NESTED;
    int top, node, number, instance;
    const float* nodes;
    float own_t_min;
    FilterRay filter;
    TurnedRay turned_ray;
    PackedHit best;
    typename All::Answer::State wide;
    WalkWork work;

    CUDA_CALLABLE float t_min() const { return FROM_ZERO ? 0.0f : own_t_min; }

    CUDA_CALLABLE bool is_inner() const { return (unsigned)node < (unsigned)NEXT; }

    CUDA_CALLABLE bool is_leaf() const { return node < 0 || (All::NESTED && (node == BACK || node == NEXT)); }

    /// Whether the ray goes into or out of an instance next; else, at a leaf, it tests triangles.
    CUDA_CALLABLE bool moves() const { return All::NESTED && (node == BACK || node == NEXT || (node < 0 && instance < 0)); }

    /// Makes the filter for the ray from which boxes are tested; scale: of its reach.
    CUDA_CALLABLE void aim(const GivenRay& ray, float scale)
    {
        filter = filter_ray(ray.direction[0], ray.direction[1], ray.direction[2], ray.origin[0], ray.origin[1], ray.origin[2],
            scale * ray.reach, t_min(), best.t);
    }

    /// Aims ray i at the upper level.
    CUDA_CALLABLE GivenRay aim_above(const All& all, int i)
    {
        const Extent above = extent_of(all.space.top);
        const GivenRay given = given_ray(above, all.rays, i);
        aim(given, above.slack_scale);
        return given;
    }

    static CUDA_CALLABLE bool is_valid(const GivenRay& ray, float t_min, float t_max)
    {
        return is_ray(
            ray.direction[0], ray.direction[1], ray.direction[2], ray.origin[0], ray.origin[1], ray.origin[2], t_min, t_max);
    }

    CUDA_CALLABLE void begin(const All& all, int i, int* stack)
    {
        own_t_min = first_t(all.rays, i);
        best = {last_t(all.rays, i), 0.0f, 0.0f, -1};
        number = i, instance = -1, top = 1, stack[0] = DONE;
        work = {0, 0, 0};
        if constexpr (All::Answer::WIDE) wide = {end_of(all.rays, i), 0.0, 0.0};
        if constexpr (All::NESTED) {
            const auto& upper = all.space.top;
            const GivenRay given = aim_above(all, i);
            const int environment = environment_of(all.rays, i), at = environment_at(upper, environment);
            const int root = root_of(upper, environment, at);
            node = root >= 0 && is_valid(given, t_min(), best.t) ? root : DONE;
            const ListedNodes listed = listed_nodes(upper, at);
            if (node != DONE && listed.count > 0) list_instances(all, listed, stack);
        } else {
            const GivenRay given = given_ray(all.space.tree, all.rays, i);
            turned_ray = turned(given);
            aim(given, 1.0f);
            node = is_valid(given, t_min(), best.t) ? 0 : DONE;
        }
    }

    /// Lets the instances wait whose boxes, in the nodes of a list, the ray meets.
    CUDA_CALLABLE void list_instances(const All& all, const ListedNodes& listed, int* stack)
    {
        const auto& upper = all.space.top.tree;
        for (int k = 0; k < listed.count; ++k) {
            const TwoBoxes at = load_wide_boxes((const float*)upper.bounds.data, upper.child.data, listed.node(k));
            const Quad &p = at.first, &q = at.second, &r = at.both;
            if (All::COUNTING) ++work.nodes;
            wait(filtered<FROM_ZERO>(filter, p.x, p.y, p.z, p.w, r.x, r.y), at.left, stack);
            wait(filtered<FROM_ZERO>(filter, q.x, q.y, q.z, q.w, r.z, r.w), at.right, stack);
        }
        node = NEXT;
    }

    /// Puts an instance among those that wait, if its box is met and its lane is used.
    CUDA_CALLABLE void wait(const Bits& met, int word, int* stack)
    {
        if (met.enter > met.leave || !holds_instance(~word)) return;
        int place = top;
        for (; place > 1 && stack[place - 1] < met.enter; place -= 2)
            stack[place + 1] = stack[place - 1], stack[place] = stack[place - 2];
        stack[place] = word, stack[place + 1] = met.enter;
        top += 2;
    }

    /// Of an unused lane, whose box is met, too, it is not.
    static CUDA_CALLABLE bool holds_instance(int word) { return (word & ((1 << LEAF_BITS) - 1)) != 0; }

    CUDA_CALLABLE TwoBoxes boxes(const All& all) const
    {
        if constexpr (All::NESTED) {
            const auto& upper = all.space.top.tree;
            return instance < 0 ? load_wide_boxes((const float*)upper.bounds.data, upper.child.data, node)
                                : load_boxes(nodes, node);
        } else {
            return load_boxes((const float*)all.space.tree.nodes.data, node);
        }
    }

    /// From an inner node to the nearer child, or to what waits.
    CUDA_CALLABLE void step(const All& all, int* stack)
    {
        const NearAndFar met = meet_children<FROM_ZERO>(boxes(all), filter);
        if (All::COUNTING) ++work.nodes;
        if (met.both) stack[top++] = met.far;
        node = met.near;
        if (!met.any) node = stack[--top];
    }

    /// From a leaf of the instances' tree, or the next instance of a list, to the root of a mesh's tree, if the ray sees the
    /// instance; else to what waits.
    CUDA_CALLABLE void go_in(const All& all, int* stack)
    {
        const auto& upper = all.space.top;
        const bool is_listed = node == NEXT;
        int word = ~node;
        if (is_listed) {
            node = DONE;
            if (top == 1) return;
            const GivenRay given = given_ray(extent_of(upper), all.rays, number);
            const int enter = stack[--top];
            word = ~stack[--top];
            const float scale = scale_of(given.direction[0], given.direction[1], given.direction[2]);
            if (enter > bound_of(best.t, scale)) return;  // as all that still wait
            node = NEXT;
        } else {
            node = stack[--top];
            if (!holds_instance(word)) return;
        }
        const int found = upper.order.data[2 * (size_t)(word >> LEAF_BITS)];
        const auto& place = upper.placements.data[found];
        if (!(place.mask & mask_of(all.rays, number))) return;
        const auto& part = all.space.parts.data[place.geometry];
        const GivenRay given = given_within(part.tree, place, all.rays, number);
        if (!is_valid(given, 0.0f, 0.0f)) return;
        instance = found;
        nodes = (const float*)part.tree.nodes.data;
        turned_ray = turned(given);
        aim(given, 1.0f);
        if (!is_listed) stack[top++] = node;
        if (!is_listed || top > 1) stack[top++] = is_listed ? NEXT : BACK;
        node = 0;
    }

    /// Tests the triangles of a leaf, or goes into or out of an instance, and goes on with what waits.
    CUDA_CALLABLE void leaf(const All& all, int* stack)
    {
        const int word = ~node;
        if constexpr (All::NESTED) {
            if (node == BACK) {
                node = stack[--top];
                instance = -1;
                aim_above(all, number);
            } else if (moves()) {
                go_in(all, stack);
            } else {
                node = stack[--top];
                const auto& place = all.space.top.placements.data[instance];
                const auto& part = all.space.parts.data[place.geometry];
                const auto given = [&]() { return given_within(part.tree, place, all.rays, number); };
                if constexpr (All::Answer::WIDE) {
                    const auto& geometry = all.space.geometries.data[place.geometry];
                    const WideRay ray = wide_within(place, geometry.center, all.rays, number);
                    test_wide(all, word, part.triangles, place.first, given(), ray, geometry.mesh);
                } else {
                    test(all, word, part.triangles, place.first, given);
                }
            }
        } else {
            node = stack[--top];
            const auto given = [&]() { return given_ray(all.space.tree, all.rays, number); };
            if constexpr (All::Answer::WIDE)
                test_wide(all, word, all.space.triangles, 0, given(), wide_ray(all.rays, number), all.space.mesh);
            else test(all, word, all.space.triangles, 0, given);
        }
    }

    /// Tests the triangles of the leaf `word`, which are numbered from `first` on.
    template <class Triangles, class Given>
    CUDA_CALLABLE void test(const All& all, int word, const Triangles& triangles, int first, const Given& given)
    {
        using Answer = typename All::Answer;
        const int count = word & ((1 << LEAF_BITS) - 1), begin = 2 * (word >> LEAF_BITS), end = begin + count;
        const float* const corners = (const float*)triangles.corners.data;
        if (All::COUNTING) ++work.leaves, work.triangles += count;
        for (int slot = begin; slot < end; ++slot) {
            LoadedTriangle triangle = load_triangle(corners, slot, turned_ray);
            if constexpr (
                All::NESTED) {  // hits take the given ray again, which is mapped: threads of a warp come there together
                while (surely_misses(areas_of(triangle.s)) && ++slot < end) triangle = load_triangle(corners, slot, turned_ray);
                if (slot == end) break;
            }
            const auto take = [&](PackedHit hit, const GivenRay& ray) {
                hit.id += first;
                if constexpr (All::SKIPPING) {
                    if (all.skipped.data[number % all.skipped.shape[0]] == hit.id) return false;
                }
                if (!Answer::take(all.hits, number, hit, best)) return false;
                if (Answer::SHORTENS)
                    filter.t_max = bound_of(best.t, scale_of(ray.direction[0], ray.direction[1], ray.direction[2]));
                return true;
            };
            const bool taken
                = meet_triangle<typename Answer::Rule, All::CULLING>(triangle, turned_ray, t_min(), best.t, given, take);
            if (Answer::ENDS && taken) {
                node = DONE;
                break;
            }
        }
    }

    /// The same in float64: those of the triangles whose boxes the rounded ray meets.
    template <class Triangles, class Mesh>
    CUDA_CALLABLE void test_wide(const All& all, int word, const Triangles& triangles, int first, const GivenRay& given,
        const WideRay& ray, const Mesh& mesh)
    {
        const int count = word & ((1 << LEAF_BITS) - 1), begin = 2 * (word >> LEAF_BITS);
        const BoxRay boxes = given.boxes();
        const double from = all.rays.rays.t_min.data[(size_t)number * all.rays.rays.t_min_stride];
        if (All::COUNTING) ++work.leaves, work.triangles += count;
        for (int slot = begin; slot < begin + count; ++slot) {
            const float* const at = (const float*)triangles.corners.data + TRIANGLE_WORDS * (size_t)slot;
            const Quad a = load_quad(at), b = load_quad(at + 4), c = load_quad(at + 8);
            const float corners[9] = {a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z};
            float low[3], high[3];
            vertex_box<1>(corners, low, high);
            const Interval own = meet_box(low, high, boxes, -WRT_INFINITY, WRT_INFINITY);
            const float t = clamped(t_min(), own);
            if (!((own.enter <= own.leave) & (t >= t_min()) & (t <= best.t))) continue;
            WideHit hit;
            const int id = first + int_of(a.w);
            if (!meet_exactly(mesh, int_of(a.w), ray, from, hit)) continue;
            if (!(hit.t < wide.t || (hit.t == wide.t && (best.id < 0 || id < best.id)))) continue;
            wide = hit;
            best.id = id;
            best.t = smaller(best.t, (float)hit.t);
            filter.t_max = bound_of(best.t, scale_of(given.direction[0], given.direction[1], given.direction[2]));
        }
    }

    CUDA_CALLABLE void store(const All& all) const
    {
        if constexpr (All::Answer::WIDE) All::Answer::store(all.hits, number, best, wide);
        else All::Answer::store(all.hits, number, best);
        if constexpr (All::COUNTING) {
            auto& row = all.rows.rows.data[number];
            row.nodes = work.nodes, row.leaves = work.leaves, row.triangles = work.triangles;
        }
    }
};

/// The walk of a ray by a thread that does nothing else.
template <class All, bool FROM_ZERO> inline CUDA_CALLABLE void walk_alone(const All& all, Walk<All, FROM_ZERO>& walk, int i)
{
    int stack[All::LEVELS];
    walk.begin(all, i, stack);
    while (walk.node != DONE) {
        while (walk.is_inner()) walk.step(all, stack);
        if (walk.is_leaf()) walk.leaf(all, stack);
    }
}

/// On CUDA the rays of a launch, by all of its threads; else ray i.
template <int FETCH, int KEEP, int STEPS, bool FROM_ZERO, class All>
inline CUDA_CALLABLE void walk_rays(const All& all, int* next, int threads, int i)
{
#if defined(__CUDA_ARCH__)
    (void)i;
    walk_all<FETCH, KEEP, STEPS, Walk<All, FROM_ZERO>>(all, all.rays.count, next, threads);
#else
    (void)next, (void)threads;
    Walk<All, FROM_ZERO> walk;
    walk_alone(all, walk, i);
    walk.store(all);
#endif
}

template <class All, class Best> inline CUDA_CALLABLE void answer_alone(const All& all, Best& best)
{
    Walk<All, false> walk;
    walk_alone(all, walk, 0);
    best.t = walk.best.t, best.primitive = walk.best.id, best.u = walk.best.u, best.v = walk.best.v;
}

/// The answer to a ray of a user's kernel, a checked `Ray`, becomes `best`, a `BestHit`. hits: what the answer's `take` gets;
/// origin: of the ray, in float64; mask, environment: what it sees of instances.
template <int LEVELS, class Answer, class Space, class Ray, class Hits, class Origin, class Best>
inline CUDA_CALLABLE void walk_one(
    const Space& space, const Ray& ray, const Hits& hits, const Origin& origin, unsigned mask, int environment, Best& best)
{
    const OneRay<Ray, Origin> own = {ray, origin, mask, environment};
    answer_alone(walks_of<LEVELS, Answer, false, false, false>(space, own, hits, hits, hits), best);
}

}  // namespace
}  // namespace wrt
