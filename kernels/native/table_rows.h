// Rows of structured arrays: each thread writes the rows of a block of items, some rows at a time, column by column
// (wrt.kernels.sensors.table_rows).
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// Greatest number of items of a block.
constexpr int ROWS = 1024;

/// The items begin .. end - 1, in the order in which they are taken, that have a row.
struct RowItems {
    int item[ROWS];
    int count;
};

/// Sensors have `own` items each, in the same order; without an order, items are taken by number. An item with a negative id
/// has no row, unless there are no ids.
inline CUDA_CALLABLE void rows_of_block(const int* order, int own, const int* id, int begin, int end, RowItems& rows)
{
    rows.count = 0;
    int from = own > 0 ? begin - begin % own : 0;
    for (int i = begin; i < end; ++i) {
        if (i - from >= own) from += own;
        const int item = order ? from + order[i - from] : i;
        rows.item[rows.count] = item;
        rows.count += id == nullptr || id[item] >= 0;
    }
}

/// Number of the items that `rows_of_block` finds.
inline CUDA_CALLABLE int count_rows(const int* order, int own, const int* id, int begin, int end)
{
    const int n = end - begin;
    if (id == nullptr) return n;
    int count = 0;
    if (order == nullptr) {
        WRT_FOR (n, i) count += id[begin + i] >= 0;
        return count;
    }
    int from = own > 0 ? begin - begin % own : 0;
    for (int i = begin; i < end; ++i) {
        if (i - from >= own) from += own;
        count += id[from + order[i - from]] >= 0;
    }
    return count;
}

/// i / divisor, by a division only where that differs from the value before.
struct Quotient {
    int divisor, begin, value;

    inline CUDA_CALLABLE int of(int i)
    {
        if (unsigned(i - begin) >= unsigned(divisor)) {
            value = i / divisor;
            begin = value * divisor;
        }
        return value;
    }
};

/// COUNT neighbours as bytes of another type.
template <int COUNT, class Source, class Target> inline CUDA_CALLABLE void write_values(const char* from, char* to)
{
    Target values[COUNT];
    for (int k = 0; k < COUNT; ++k) values[k] = static_cast<Target>(reinterpret_cast<const Source*>(from)[k]);
#if defined(__CUDA_ARCH__)
    memcpy(to, values, sizeof(values));
#else
    __builtin_memcpy(to, values, sizeof(values));
#endif
}

/// Writes a column of the rows begin .. end - 1 of a block, the first of them at `to`.
template <int COUNT, class Source, class Target, class Column>
inline CUDA_CALLABLE void write_column(
    const Column& column, const RowItems& rows, int begin, int end, char* to, long long bytes)
{
    const char* from = reinterpret_cast<const char*>(column.data);
    const long long stride = column.stride;
    to += column.offset;
    if (column.divisor == 1 && column.modulus == 0) {
        for (int i = begin; i < end; ++i, to += bytes) write_values<COUNT, Source, Target>(from + rows.item[i] * stride, to);
        return;
    }
    Quotient divided {column.divisor, 0, 0}, whole {column.modulus, 0, 0};
    for (int i = begin; i < end; ++i, to += bytes) {
        int at = divided.of(rows.item[i]);
        if (column.modulus != 0) at -= whole.of(at) * column.modulus;
        write_values<COUNT, Source, Target>(from + at * stride, to);
    }
}

/// Rows that are written together: few enough to stay in the nearest cache until all of their columns are.
constexpr int ROWS_TOGETHER = 64;

/// Writes rows of `bytes` bytes, the first of them as row number `first`. Kinds are those of wrt.kernels.sensors.table_rows.
template <class Column>
inline CUDA_CALLABLE void write_columns(
    const Column* columns, int count, const RowItems& rows, unsigned char* table, long long first, long long bytes)
{
    for (int i = 0; i < rows.count; i += ROWS_TOGETHER) {
        const int end = i + ROWS_TOGETHER < rows.count ? i + ROWS_TOGETHER : rows.count;
        char* out = reinterpret_cast<char*>(table) + (first + i) * bytes;
        for (int c = 0; c < count; ++c) switch (columns[c].kind) {
            case 1:
                write_column<1, unsigned char, unsigned char>(columns[c], rows, i, end, out, bytes);
                break;
            case 2:
                write_column<1, unsigned short, unsigned short>(columns[c], rows, i, end, out, bytes);
                break;
            case 4:
                write_column<1, unsigned int, unsigned int>(columns[c], rows, i, end, out, bytes);
                break;
            case 8:
                write_column<1, unsigned long long, unsigned long long>(columns[c], rows, i, end, out, bytes);
                break;
            case 24:
                write_column<3, unsigned long long, unsigned long long>(columns[c], rows, i, end, out, bytes);
                break;
            case 30:
                write_column<1, double, float>(columns[c], rows, i, end, out, bytes);
                break;
            case 31:
                write_column<3, double, float>(columns[c], rows, i, end, out, bytes);
                break;
            default:
                write_column<1, int, unsigned short>(columns[c], rows, i, end, out, bytes);
            }
    }
}

}  // namespace
}  // namespace wrt
