// Compiled kernels called from compiled code: by their addresses, for any number of items. CPUs only.
//
// Warp's entry point of a CPU kernel is a C function of two pointers, the launch bounds and the packed arguments, of which the
// first is the number of the first item. Bounds: Warp's launch bounds of one dimension.
#pragma once

#if !defined(__CUDA_ARCH__)

extern "C" int wrt_clock(int, long*) __asm__("clock_gettime");

namespace wrt {
namespace {

typedef long long word;
typedef void (*Entry)(void* bounds, void* arguments);

/// Greatest size of packed arguments.
constexpr int MAX_ARGUMENT_BYTES = 8192;

/// Packed arguments on the stack of a thread.
struct Arguments {
    alignas(64) unsigned char bytes[MAX_ARGUMENT_BYTES];

    void copy(const void* from, word size) { __builtin_memcpy(bytes, from, (size_t)size); }
    int& number_at(word at) { return *(int*)(bytes + at); }
};

/// Nanoseconds by a clock of the system.
inline word clock_ns(int clock)
{
    long t[2];
    wrt_clock(clock, t);  // seconds, nanoseconds
    return (word)t[0] * 1000000000 + (word)t[1];
}

template <class Bounds> inline void set_items(Bounds& bounds, word items)
{
    bounds.shape[0] = (unsigned)items;
    bounds.size = (size_t)items;
}

// -- chains ---------------------------------------------------------------------------------------------------------------

/// A kernel that does a stage of `wrt.kernels.runtime.launch_chain`. end_at: where the end is in the arguments, or 0; spent:
/// nanoseconds of all threads; items: of the tiles that it has done; counts: the stage's own numbers of items, or 0.
struct Alternative {
    Entry entry;  // 0: there is none
    const void *bounds, *arguments;
    word argument_bytes, end_at, grain, spent, items;
    const int* counts;
};

/// Whether a tile takes the second of two alternatives: the one that has taken less time for an item, once both are tried.
template <int TRIED_ITEMS, int TRIED_TILE> inline bool takes_other(const Alternative& one, const Alternative& other, int tile)
{
    const double items = (double)one.items, other_items = (double)other.items;
    bool is_other = (double)other.spent * items < (double)one.spent * other_items;
    if (tile % TRIED_TILE == TRIED_TILE - 1) is_other = !is_other;
    if (other_items < TRIED_ITEMS) is_other = items >= other_items;
    else if (items < TRIED_ITEMS) is_other = false;
    return is_other;
}

/// Runs the stages begin .. end - 1 for a tile of `size` items, as long as items are left. stages: two alternatives each.
template <class Bounds, int CLOCK, int TRIED_ITEMS, int TRIED_TILE>
inline void run_stages(Alternative* stages, int begin, int end, const int* counts, int size, int tile)
{
    word before = clock_ns(CLOCK);
    Arguments arguments;
    for (int s = begin; s < end; ++s) {
        Alternative* chosen = stages + 2 * s;
        const bool has_own = chosen->counts != nullptr;
        const int left = ((const volatile int*)(has_own ? chosen->counts : counts))[tile];
        if (left <= 0 && has_own) continue;
        if (left <= 0) break;
        if (chosen[1].entry && takes_other<TRIED_ITEMS, TRIED_TILE>(chosen[0], chosen[1], tile)) ++chosen;
        arguments.copy(chosen->arguments, chosen->argument_bytes);
        const int grain = (int)chosen->grain;
        arguments.number_at(0) = tile * (size / grain);
        if (chosen->end_at > 0) arguments.number_at(chosen->end_at) = tile * size + left;
        Bounds bounds = *(const Bounds*)chosen->bounds;
        set_items(bounds, (left + grain - 1) / grain);
        chosen->entry(&bounds, arguments.bytes);
        const word after = clock_ns(CLOCK);
        __atomic_fetch_add(&chosen->spent, after - before, __ATOMIC_RELAXED);
        __atomic_fetch_add(&chosen->items, (word)left, __ATOMIC_RELAXED);
        before = after;
    }
}

// -- steps of a build -----------------------------------------------------------------------------------------------------

/// A kernel with its arguments: a step of `wrt.builders.bvh.small_mesh_build`.
struct Call {
    Entry entry;
    void *bounds, *arguments;

    void run() const { entry(bounds, arguments); }
    int* numbers() const { return (int*)arguments; }
    template <class Bounds> void run_for(int items) const
    {
        set_items(*(Bounds*)bounds, items);
        run();
    }
};

/// Finds the wide nodes level by level: `steps` solve, pick, scan and list (`wrt.builders.bvh.phases.collapse`). Returns the
/// number of levels.
template <class Bounds> inline int collapse_steps(const Call* steps, int* totals, int* level_first)
{
    const Call &pick = steps[1], &scan = steps[2], &list = steps[3];
    steps[0].run();
    int first = 0, nodes = 1, level = 0;
    totals[0] = 1;
    totals[1] = 0;
    level_first[0] = 0;
    while (first < nodes) {
        pick.numbers()[1] = scan.numbers()[1] = list.numbers()[1] = first;
        scan.numbers()[2] = nodes;
        pick.run_for<Bounds>(nodes - first);
        scan.run_for<Bounds>(1);
        list.run_for<Bounds>(nodes - first);
        first = nodes;
        nodes = totals[0];
        level_first[++level] = first;
    }
    return level;
}

}  // namespace
}  // namespace wrt
#endif
