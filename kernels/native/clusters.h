// Triangles of lazily built trees: sorted into the cells of a grid, and chosen for a cell (`wrt.builders.kdtree.lazy`).
#pragma once
#include "reference.h"

namespace wrt {
namespace {

/// Counts the triangles of a cluster that are in a cell, and writes their ids if `writing`. pair: the cell and the cluster.
template <class Boxes, class Pair>
inline CUDA_CALLABLE int choose_triangles(const Boxes& boxes, const int* order, const Pair& pair, bool writing, int* ids)
{
    const size_t n = boxes.low.shape[1];
    int found = 0;
    for (int i = pair.begin; i < pair.end; ++i) {
        const size_t triangle = order[i];
        bool inside = true;
        for (int axis = 0; axis < 3; ++axis) {
            const float low = boxes.low.data[axis * n + triangle], high = boxes.high.data[axis * n + triangle];
            inside &= low == high ? (low >= pair.low.c[axis]) & (low < pair.planar_end.c[axis])
                                  : (low < pair.high.c[axis]) & (high > pair.low.c[axis]);
        }
        if (writing && inside) ids[pair.to + found] = (int)triangle;
        found += inside;
    }
    return found;
}

/// Writes the references of a node's ids, and computes their box within the node's.
template <class Boxes, class Frame>
inline CUDA_CALLABLE void gather_references(const Boxes& boxes, const int* ids, float* __restrict__ references, Frame& frame)
{
    const int begin = frame.first.c[0];
    float* __restrict__ to = references + (size_t)begin * 8;
    float bounds[8];
    set_empty(bounds);
    for (int i = begin; i < begin + frame.triangles; ++i, to += 8) {
        write_reference(boxes, ids[i], to);
        unite(bounds, to);
    }
    for (int axis = 0; axis < 3; ++axis) {
        const float low = bounds[axis], high = -bounds[4 + axis];
        frame.inner_low.c[axis] = low > frame.low.c[axis] ? low : frame.low.c[axis];
        frame.inner_high.c[axis] = high < frame.high.c[axis] ? high : frame.high.c[axis];
    }
}

/// The number of the cell of the grid in which the centre of a box, (low, -high), lies.
template <class Grid> inline CUDA_CALLABLE int grid_cell(const Grid& grid, const float* box)
{
    int cell = 0;
    for (int axis = 2; axis >= 0; --axis) {
        const float low = box[axis], high = -box[4 + axis], last = (float)(grid.cells.c[axis] - 1);
        float place = ((0.5f * low + 0.5f * high) - grid.low.c[axis]) * grid.scale.c[axis];
        place = place > 0.0f ? place : 0.0f;
        place = place < last ? place : last;
        cell = cell * grid.cells.c[axis] + (int)place;
    }
    return cell;
}

/// Computes the cells of the triangles ids[begin .. end - 1] and, per cell of the grid, their number and their box.
template <class Boxes, class Grid>
inline CUDA_CALLABLE void count_cells(const Boxes& boxes, const int* ids, int begin, int end, const Grid& grid, int* cell_of,
    int* __restrict__ counter, float* __restrict__ table, size_t cells)
{
    for (size_t c = 0; c < cells; ++c) {
        counter[c] = 0;
        for (int j = 0; j < 8; ++j) table[c * 8 + j] = WRT_INFINITY;
    }
    for (int i = begin; i < end; ++i) {
        float value[8] = {};
        read_box(boxes, ids[i], value);
        const int cell = grid_cell(grid, value);
        cell_of[i] = cell;
        ++counter[cell];
        unite(table + (size_t)cell * 8, value);
    }
}

/// The box of the triangles order[begin .. end - 1], and that of their centres: (low, -high) of both.
template <class Boxes>
inline CUDA_CALLABLE void box_of_range(const Boxes& boxes, const int* order, int begin, int end, float* __restrict__ to)
{
    const size_t n = boxes.low.shape[1];
    for (int j = 0; j < 12; ++j) to[j] = WRT_INFINITY;
    for (int i = begin; i < end; ++i) {
        const size_t triangle = order[i];
        for (int axis = 0; axis < 3; ++axis) {
            const float low = boxes.low.data[axis * n + triangle], high = boxes.high.data[axis * n + triangle];
            const float center = 0.5f * low + 0.5f * high;
            const float value[4] = {low, -high, center, -center};
            for (int j = 0; j < 4; ++j) to[3 * j + axis] = value[j] < to[3 * j + axis] ? value[j] : to[3 * j + axis];
        }
    }
}

}  // namespace
}  // namespace wrt
