// Rows of structured arrays: each thread writes the rows of a block of items, column by column
// (wrt.kernels.sensors.table_rows).
#pragma once

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

template <class Source, class Target, class Column>
inline CUDA_CALLABLE void write_column(const Column column, const RowItems& rows, char* out, long long bytes)
{
    const char* from = reinterpret_cast<const char*>(column.data);
    char* to = out + column.offset;
    const int count = rows.count;  // which the writes below would not change, though the compiler cannot know
    for (int i = 0; i < count; ++i, to += bytes) {
        int at = rows.item[i];
        if (column.divisor != 1) at /= column.divisor;
        if (column.modulus != 0) at %= column.modulus;
        const Target value = static_cast<Target>(*reinterpret_cast<const Source*>(from + at * column.stride));
#if defined(__CUDA_ARCH__)
        memcpy(to, &value, sizeof(Target));
#else
        __builtin_memcpy(to, &value, sizeof(Target));
#endif
    }
}

/// Writes rows of `bytes` bytes, the first of them as row number `first`. Kinds are those of wrt.kernels.sensors.table_rows.
template <class Column>
inline CUDA_CALLABLE void write_columns(
    const Column* columns, int count, const RowItems& rows, unsigned char* table, long long first, long long bytes)
{
    char* out = reinterpret_cast<char*>(table) + first * bytes;
    for (int c = 0; c < count; ++c) switch (columns[c].kind) {
        case 1:
            write_column<unsigned char, unsigned char>(columns[c], rows, out, bytes);
            break;
        case 2:
            write_column<unsigned short, unsigned short>(columns[c], rows, out, bytes);
            break;
        case 4:
            write_column<unsigned int, unsigned int>(columns[c], rows, out, bytes);
            break;
        case 8:
            write_column<unsigned long long, unsigned long long>(columns[c], rows, out, bytes);
            break;
        case 10:
            write_column<double, float>(columns[c], rows, out, bytes);
            break;
        default:
            write_column<int, unsigned short>(columns[c], rows, out, bytes);
        }
}

}  // namespace
}  // namespace wrt
