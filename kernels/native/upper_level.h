// The level above the instances of a scene: where a walk begins, and the box of all instances
// (wrt.kernels.traversal.two_level.instance_single).
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// The node above the instances that an environment sees, -1 if there are none. `top`: an `InstanceTree`.
template <class Top> inline CUDA_CALLABLE int root_of(const Top& top, int environment)
{
    if (environment < 0) return top.root;
    int low = 0, high = top.environments.shape[0];
    if (environment < high && top.environments.data[environment] == environment) return top.roots.data[environment];
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        (top.environments.data[middle] <= environment ? low : high) = middle;
    }
    return high > low && top.environments.data[low] == environment ? top.roots.data[low] : top.shared_root;
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
