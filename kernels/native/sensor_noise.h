// Noise of returns, and random words by a counter (wrt.kernels.sensors.philox, which says what is computed): loops over blocks.
#pragma once
#include "loops.h"
#include "square_root.h"

#if defined(__CUDA_ARCH__)
#define WRT_MATH(name) name
#else
#define WRT_MATH(name) __builtin_##name
#endif

namespace wrt {
namespace {

/// Four random words.
struct PhiloxWords {
    unsigned c[4];
};

/// Those of a counter and a key, by the multiplication of the high and the low word in each of ten rounds.
inline CUDA_CALLABLE PhiloxWords philox(PhiloxWords counter, unsigned key_0, unsigned key_1)
{
    unsigned c0 = counter.c[0], c1 = counter.c[1], c2 = counter.c[2], c3 = counter.c[3];
    WRT_UNROLLED
    for (int round = 0; round < 10; ++round) {
        const unsigned long long product_0 = 0xD2511F53ull * c0, product_1 = 0xCD9E8D57ull * c2;
        c0 = unsigned(product_1 >> 32) ^ c1 ^ key_0;
        c1 = unsigned(product_1);
        c2 = unsigned(product_0 >> 32) ^ c3 ^ key_1;
        c3 = unsigned(product_0);
        key_0 += 0x9E3779B9u;
        key_1 += 0xBB67AE85u;
    }
    return {{c0, c1, c2, c3}};
}

/// A word as a number in (0, 1).
inline CUDA_CALLABLE double unit_number(unsigned word) { return (double(word) + 0.5) * 0x1p-32; }

constexpr double TWO_PI = 6.283185307179586;

/// Largest number of returns of a block.
#if defined(__CUDA_ARCH__)
constexpr int NOISY = 1;
#else
constexpr int NOISY = 256;
#endif

/// The words of the returns begin .. begin + n - 1, n <= NOISY; `use` tells different noises of a return apart.
struct NoiseWords {
    unsigned c[3][NOISY];

    inline CUDA_CALLABLE void draw(int begin, int n, unsigned use, unsigned key_0, unsigned key_1)
    {
        WRT_FOR (n, i) {
            const PhiloxWords words = philox({{unsigned(begin + i), use, 0u, 0u}}, key_0, key_1);
            c[0][i] = words.c[0];
            c[1][i] = words.c[1];
            c[2][i] = words.c[2];
        }
    }
};

/// Whether a sensor has any noise.
template <class Noise> inline CUDA_CALLABLE bool is_noisy(const Noise& noise)
{
    return noise.range > 0.0 || noise.angle > 0.0 || noise.dropout > 0.0;
}

/// Ranges with noise of the returns begin .. end - 1, whose ranges without noise are in `range`, inf for none. `distance` and
/// `intensity` are null if they are not asked for, the first of which noise needs.
template <class Noise>
inline CUDA_CALLABLE void write_ranges(
    const Noise& noise, int begin, int end, float* __restrict range, float* __restrict intensity, double* __restrict distance)
{
    const float none = WRT_INFINITY;
    if (!is_noisy(noise)) {
        if (distance == nullptr) return;
        const int n = end - begin;
        WRT_FOR (n, i) {
            const double far = double(range[begin + i]);
            distance[begin + i] = far < 0.0 ? 0.0 : far;
        }
        return;
    }
    NoiseWords words;
    double logarithm[NOISY], cosine[NOISY];
    for (int first = begin; first < end; first += NOISY) {
        const int n = end - first < NOISY ? end - first : NOISY;
        words.draw(first, n, 0u, noise.key.c[0], noise.key.c[1]);
        for (int i = 0; i < n; ++i) {  // calls, which are not vectorised, apart from what is
            const bool drawn = noise.range != 0.0 && range[first + i] < none;
            logarithm[i] = drawn ? WRT_MATH(log)(unit_number(words.c[0][i])) : 0.0;
            cosine[i] = drawn ? WRT_MATH(cos)(TWO_PI * unit_number(words.c[1][i])) : 0.0;
        }
        const auto is_seen = [&](int i) { return range[first + i] < none && unit_number(words.c[2][i]) >= noise.dropout; };
        if (intensity)
            WRT_FOR (n, i) intensity[first + i] = is_seen(i) ? intensity[first + i] : 0.0f;
        WRT_FOR (n, i) {
            const double moved = double(range[first + i]) + noise.range * (square_root(-2.0 * logarithm[i]) * cosine[i]);
            const double far = is_seen(i) ? (moved < 0.0 ? 0.0 : moved) : double(none);
            distance[first + i] = far;
            range[first + i] = float(far);
        }
    }
}

}  // namespace
}  // namespace wrt
