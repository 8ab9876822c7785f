// Signs of determinants of points in float64, without an error.
//
// A determinant is computed in float64 first. If it is smaller than a bound of its error, it is computed again as a sum of
// numbers that do not overlap (Shewchuk 1997). Coordinates between 1e-75 and 1e75, and 0, keep products in the range of
// float64.
#pragma once
#include "loops.h"

// What is rarely called, or from many places, is a function of its own, so that it is compiled once.
#if defined(__CUDA_ARCH__)
#define WRT_SEPARATE inline
#else
#define WRT_SEPARATE inline __attribute__((noinline))
#endif

namespace wrt {
namespace {
namespace pairs {

struct Place {
    double x, y, z;
};

inline CUDA_CALLABLE Place operator-(const Place& p, const Place& q) { return {p.x - q.x, p.y - q.y, p.z - q.z}; }
inline CUDA_CALLABLE double dot(const Place& p, const Place& q) { return (p.x * q.x + p.y * q.y) + p.z * q.z; }

inline CUDA_CALLABLE Place cross(const Place& p, const Place& q)
{
    return {p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x};
}

inline CUDA_CALLABLE double coordinate(const Place& p, int axis) { return axis == 0 ? p.x : axis == 1 ? p.y : p.z; }
inline CUDA_CALLABLE double size_of(double x) { return x < 0.0 ? -x : x; }
inline CUDA_CALLABLE int sign_of(double x) { return (x > 0.0) - (x < 0.0); }

/// A sum of at most N numbers, exact: parts that do not overlap, none of them 0, the smallest first.
template <int N> struct ExactSum {
    double part[N];
    int size = 0;

    inline CUDA_CALLABLE void add(double number)
    {
        int kept = 0;
        for (int i = 0; i < size; ++i) {
            const double sum = number + part[i], other = sum - number;
            const double error = (number - (sum - other)) + (part[i] - other);
            if (error != 0.0) part[kept++] = error;
            number = sum;
        }
        if (number != 0.0) part[kept++] = number;
        size = kept;
    }

    inline CUDA_CALLABLE int sign() const { return size > 0 ? sign_of(part[size - 1]) : 0; }
};

/// A product and its error (Dekker 1971).
struct ExactProduct {
    double value, error;

    CUDA_CALLABLE ExactProduct(double p, double q)
    {
        const double ps = 134217729.0 * p, qs = 134217729.0 * q, ph = ps - (ps - p), qh = qs - (qs - q), pl = p - ph,
                     ql = q - qh;
        value = p * q;
        error = ((ph * ql - (value - ph * qh)) + pl * qh) + pl * ql;
    }
};

template <int N> WRT_SEPARATE CUDA_CALLABLE void add_product(ExactSum<N>& sum, double p, double q)
{
    const ExactProduct product(p, q);
    sum.add(product.error), sum.add(product.value);
}

/// Adds p q r, exactly.
template <int N> inline CUDA_CALLABLE void add_product(ExactSum<N>& sum, double p, double q, double r)
{
    const ExactProduct product(p, q);
    add_product(sum, product.error, r), add_product(sum, product.value, r);
}

/// Adds the determinant of three rows, times a sign.
template <int N>
inline CUDA_CALLABLE void add_volume(ExactSum<N>& sum, const Place& p, const Place& q, const Place& r, double sign)
{
    const double x = sign * p.x, y = sign * p.y, z = sign * p.z;
    add_product(sum, x, q.y, r.z), add_product(sum, -x, q.z, r.y);
    add_product(sum, y, q.z, r.x), add_product(sum, -y, q.x, r.z);
    add_product(sum, z, q.x, r.y), add_product(sum, -z, q.y, r.x);
}

/// The same determinant of the differences from d, exactly.
WRT_SEPARATE CUDA_CALLABLE int exact_side(const Place& a, const Place& b, const Place& c, const Place& d)
{
    ExactSum<96> sum;
    add_volume(sum, a, b, c, 1.0), add_volume(sum, a, b, d, -1.0);
    add_volume(sum, a, c, d, 1.0), add_volume(sum, b, c, d, -1.0);
    return sum.sign();
}

/// On which side of the plane through a, b and c the point d is: the sign of det(a - d, b - d, c - d).
inline CUDA_CALLABLE int side_of(const Place& a, const Place& b, const Place& c, const Place& d)
{
    const Place p = a - d, q = b - d, r = c - d;
    const double xy = q.x * r.y, yx = q.y * r.x, yz = q.y * r.z, zy = q.z * r.y, zx = q.z * r.x, xz = q.x * r.z;
    const double volume = (p.x * (yz - zy) + p.y * (zx - xz)) + p.z * (xy - yx);
    const double magnitude = (size_of(p.x) * (size_of(yz) + size_of(zy)) + size_of(p.y) * (size_of(zx) + size_of(xz)))
        + size_of(p.z) * (size_of(xy) + size_of(yx));
    // eight roundings of 2^-53 on the way, and as much again for the bound itself
    if (size_of(volume) > 1.8e-15 * magnitude + 1e-280) return sign_of(volume);
    return exact_side(a, b, c, d);
}

/// On which side of the line through a and b the point c is, seen along an axis.
WRT_SEPARATE CUDA_CALLABLE int side_in_plane(const Place& a, const Place& b, const Place& c, int axis)
{
    const int u = axis == 2 ? 0 : axis + 1, v = u == 2 ? 0 : u + 1;
    const double au = coordinate(a, u), av = coordinate(a, v), bu = coordinate(b, u), bv = coordinate(b, v);
    const double cu = coordinate(c, u), cv = coordinate(c, v);
    const double left = (au - cu) * (bv - cv), right = (av - cv) * (bu - cu);
    if (size_of(left - right) > 1.8e-15 * (size_of(left) + size_of(right)) + 1e-280) return sign_of(left - right);
    ExactSum<12> sum;
    add_product(sum, au, bv), add_product(sum, -av, bu);
    add_product(sum, bu, cv), add_product(sum, -bv, cu);
    add_product(sum, cu, av), add_product(sum, -cv, au);
    return sum.sign();
}

}  // namespace pairs
}  // namespace
}  // namespace wrt
