// The level above the instances of a scene: where a walk begins, and the box of all instances
// (wrt.kernels.traversal.two_level.instance_single).
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// The place of an environment among those with instances of their own; -1 for others. `top`: an `InstanceTree`.
template <class Top> inline CUDA_CALLABLE int environment_at(const Top& top, int environment)
{
    int low = 0, high = top.environments.shape[0];
    if (environment < 0 || high == 0) return -1;
    if (environment < high && top.environments.data[environment] == environment) return environment;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        (top.environments.data[middle] <= environment ? low : high) = middle;
    }
    return top.environments.data[low] == environment ? low : -1;
}

/// The node above the instances that an environment sees, -1 if there are none; at: its place among the others.
template <class Top> inline CUDA_CALLABLE int root_of(const Top& top, int environment, int at)
{
    return environment < 0 ? top.root : at < 0 ? top.shared_root : top.roots.data[at];
}

template <class Top> inline CUDA_CALLABLE int root_of(const Top& top, int environment)
{
    return root_of(top, environment, environment_at(top, environment));
}

/// Bits of the word of a list that hold the number of its nodes (`InstanceForest.lists`).
constexpr int LIST_BITS = 5;

/// The nodes that hold the instances which an environment sees, in two runs: its own and the shared ones. None if they are too
/// many for a list.
struct ListedNodes {
    int own, shared, own_count, count;

    CUDA_CALLABLE int node(int k) const { return k < own_count ? own + k : shared + (k - own_count); }
};

/// Those of the environment at a place.
template <class Top> inline CUDA_CALLABLE ListedNodes listed_nodes(const Top& top, int at)
{
    const int number = top.lists.shape[0] - 1;
    if (at < 0 || number < 0) return {0, 0, 0, 0};
    const int own = top.lists.data[at], shared = top.lists.data[number], bits = (1 << LIST_BITS) - 1;
    if (own == 0) return {0, 0, 0, 0};
    return {own >> LIST_BITS, shared >> LIST_BITS, own & bits, (own & bits) + (shared & bits)};
}

struct Corner {
    float c[3];
};

/// The box of all instances, and the factor of a ray's reach for the slack of their boxes.
struct Extent {
    Corner low, high;
    float slack_scale;
};

/// That of a scene: in the arguments, or in the device's memory if a graph updates it.
template <class Top> inline CUDA_CALLABLE Extent extent_of(const Top& top)
{
    const bool is_updated = top.extent.shape[0] > 0;
    const float* const own = (const float*)top.extent.data;
    Extent found;
    for (int axis = 0; axis < 3; ++axis) {
        found.low.c[axis] = is_updated ? own[axis] : top.tree.low.c[axis];
        found.high.c[axis] = is_updated ? own[axis + 3] : top.tree.high.c[axis];
    }
    found.slack_scale = is_updated ? own[6] : top.slack_scale;
    return found;
}

}  // namespace
}  // namespace wrt
