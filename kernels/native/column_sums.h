// Sums of weights, in groups, of what is true: columns of booleans in tiles of neighbours (wrt.kernels.fields.column_sums).
#pragma once

namespace wrt {
namespace {

/// Columns of a tile.
constexpr int SUM_TILE = 256;

/// Rows that are copied at a time where the values of a column are neighbours: a cache line of each.
constexpr int SUM_ROWS = 64;

/// Adds the weights of some rows to the sums of a tile. `values`: rows of the tile, `stride` bytes apart.
template <class Rows>
inline CUDA_CALLABLE void add_rows(
    const unsigned char* values, long long stride, int begin, int end, int count, const Rows& rows, double* sums, long long all)
{
    double ones[SUM_TILE];
    for (int d = begin; d < end; ++d, values += stride) {
        const int first = rows.begins.data[d], last = rows.begins.data[d + 1];
        if (first == last) continue;
        for (int i = 0; i < count; ++i) ones[i] = static_cast<double>(values[i]);
        for (int k = first; k < last; ++k) {
            const double weight = rows.weights.data[k];
            double* sum = sums + rows.groups.data[k] * all;
            for (int i = 0; i < count; ++i) sum[i] += weight * ones[i];
        }
    }
}

/// Writes the sums of the columns of a tile: sums[g * all + i] for its column i.
template <class Rows>
inline CUDA_CALLABLE void sum_tile(const unsigned char* values, long long row_stride, long long column_stride, int count,
    const Rows& rows, double* sums, long long all)
{
    for (int g = 0; g < rows.count; ++g)
        for (int i = 0; i < count; ++i) sums[g * all + i] = 0.0;
    const int length = rows.begins.shape[0] - 1;
    if (column_stride == 1) {
        add_rows(values, row_stride, 0, length, count, rows, sums, all);
        return;
    }
    unsigned char part[SUM_ROWS * SUM_TILE];
    for (int begin = 0; begin < length; begin += SUM_ROWS) {
        const int own = length - begin < SUM_ROWS ? length - begin : SUM_ROWS;
        for (int i = 0; i < count; ++i)
            for (int d = 0; d < own; ++d) part[d * SUM_TILE + i] = values[i * column_stride + (begin + d) * row_stride];
        add_rows(part, SUM_TILE, begin, begin + own, count, rows, sums, all);
    }
}

}  // namespace
}  // namespace wrt
