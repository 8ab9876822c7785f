// The surface area heuristic: `wrt.builders.cost`, whose structs these functions take.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

template <class Cost> inline CUDA_CALLABLE float leaf_cost(const Cost& cost, int triangles)
{
    return cost.block * (float)((triangles + (1 << cost.unit_bits) - 1) >> cost.unit_bits);
}

/// Cost of a split into children with these numbers of triangles.
template <class Cost, class Frame>
inline CUDA_CALLABLE float plane_cost(const Cost& cost, const Frame& frame, float position, int left, int right)
{
    const float area_left = (frame.face + (position - frame.low) * frame.perimeter) * frame.inverse_area;
    const float area_right = (frame.face + (frame.high - position) * frame.perimeter) * frame.inverse_area;
    const float split_cost = frame.base + (area_left * leaf_cost(cost, left) + area_right * leaf_cost(cost, right));
    return left == 0 || right == 0 ? split_cost * cost.empty_factor : split_cost;
}

}  // namespace
}  // namespace wrt
