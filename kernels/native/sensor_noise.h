// Noise of returns, and random words by a counter (wrt.kernels.sensors.philox, which says what is computed): loops over blocks.
#pragma once
#include "loops.h"
#include "square_root.h"

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

/// Logarithm of that number, 2^exponent m with m from sqrt(1/2) to sqrt(2): log m = 2 artanh s by its series, where
/// s = (m - 1) / (m + 1). Loops vectorise it, and it has the same bits wherever it is compiled, unlike a library function.
inline CUDA_CALLABLE double log_of_unit(unsigned word)
{
    constexpr double LOG_2 = 0.6931471805599453;
    constexpr int SQRT_HALF = 0x3FE6A09E;  // the high word of its bits
    const long long bits = __builtin_bit_cast(long long, unit_number(word));
    const int exponent = (int(bits >> 32) - SQRT_HALF) >> 20;
    const double m = __builtin_bit_cast(double, bits - exponent * 0x10000000000000ll);
    const double s = (m - 1.0) / (m + 1.0), z = s * s;
    double series = 1.0 / 21.0;
    WRT_UNROLLED
    for (int odd = 19; odd > 1; odd -= 2) series = 1.0 / odd + z * series;
    return exponent * LOG_2 + (2.0 * s + 2.0 * s * (z * series));
}

/// Cosine and sine of an angle.
struct CosineSine {
    double cosine, sine;
};

/// Those of that number of turns: by the series within an eighth of a turn of the nearest quarter.
inline CUDA_CALLABLE CosineSine turn_by_unit(unsigned word)
{
    constexpr double ANGLE = 6.283185307179586 * 0x1p-32;
    const unsigned quarter = (word + 0x20000000u) >> 30;
    const double x = (double(int(word - (quarter << 30))) + 0.5) * ANGLE, z = x * x;
    double cosine = 1.0, sine = 1.0;
    WRT_UNROLLED
    for (int n = 16; n > 0; n -= 2) {
        cosine = 1.0 - z * cosine * (1.0 / (n * (n - 1)));
        sine = 1.0 - z * sine * (1.0 / (n * (n + 1)));
    }
    sine *= x;
    const bool across = quarter & 1u;
    const double c = across ? sine : cosine, s = across ? cosine : sine;
    return {(quarter + 1u) & 2u ? -c : c, quarter & 2u ? -s : s};
}

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
    for (int first = begin; first < end; first += NOISY) {
        const int n = end - first < NOISY ? end - first : NOISY;
        words.draw(first, n, 0u, noise.key.c[0], noise.key.c[1]);
        const auto is_seen = [&](int i) { return range[first + i] < none && unit_number(words.c[2][i]) >= noise.dropout; };
        if (intensity)
            WRT_FOR (n, i) intensity[first + i] = is_seen(i) ? intensity[first + i] : 0.0f;
        WRT_FOR (n, i) {
            const double radius = square_root(-2.0 * log_of_unit(words.c[0][i]));
            const double moved = double(range[first + i]) + noise.range * (radius * turn_by_unit(words.c[1][i]).cosine);
            const double far = is_seen(i) ? (moved < 0.0 ? 0.0 : moved) : double(none);
            distance[first + i] = far;
            range[first + i] = float(far);
        }
    }
}

}  // namespace
}  // namespace wrt
