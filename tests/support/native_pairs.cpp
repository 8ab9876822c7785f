// Instantiates the headers of kernels/pairs; see native_headers.cpp.
using word = long long;

#include "pairs.h"

template <class T, int N> struct vec_t {
    T c[N];
};

template <class T> struct array_t {
    T* data;
    int shape[4];
};

struct mat33 {
    double data[3][3];
};

struct Tree {
    array_t<float> bounds;
    array_t<int> child;
    vec_t<float, 3> low, high;
};

struct Body {
    Tree nodes;
    array_t<int> primitive;
    array_t<vec_t<double, 3>> vertices;
    array_t<vec_t<int, 3>> faces;
    mat33 linear;
    vec_t<double, 3> origin, center;
};

struct PairWork {
    array_t<vec_t<int, 2>> boxes;
    array_t<double> square, max_square;
    double limit, slack, near_slack;
};

struct NearestPairs {
    array_t<double> square;
    array_t<vec_t<int, 2>> triangles;
    array_t<vec_t<double, 3>> first, second;
};

struct PairLists {
    array_t<int> count;
    array_t<word> begin;
    array_t<vec_t<int, 2>> pairs;
};

void nearest(const Body& a, const Body& b, const PairWork& work, const NearestPairs& found)
{
    wrt::pairs::nearest_below<WIDTH>(a, b, work, found, 0);
}

void meeting(const Body& a, const Body& b, const PairWork& work, const PairLists& lists)
{
    wrt::pairs::meeting_below<WIDTH>(a, b, work, lists, 0);
}
