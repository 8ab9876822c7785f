// Instantiates the headers of kernels/fields that need no tree; see
// native_headers.cpp.
#include "column_sums.h"
#include "lit_points.h"

template <class T> struct Array {
    T* data;
    int shape[1];
};
struct Rows {
    int count;
    Array<int> begins, groups;
    Array<double> weights;
};

bool ahead(unsigned mask, const float* t) { return wrt::some_ahead<8>(mask, t); }

void sum(const unsigned char* values, const Rows& rows, double* sums)
{
    wrt::sum_tile(values, 64, 1, wrt::SUM_TILE, rows, sums, wrt::SUM_TILE);
    wrt::sum_tile(values, 1, 64, wrt::SUM_TILE, rows, sums, wrt::SUM_TILE);
}
