// Random numbers of W samples, and what is made of them: wrt.kernels.shading.sampling, .wavefront.pixel_samples and .bsdf.ggx.
#pragma once
#include "shading_vectors.h"

#if WRT_VECTORS
namespace wrt {
namespace {

constexpr int RANDOM = 1, SOBOL = 4;
constexpr unsigned MIX_1 = 0x9E3779B1u;
constexpr int FILTER = 0, FIRST_BOUNCE = 2, PER_BOUNCE = 2;

template <class U> inline U mix(U value, U salt)
{
    U h = value * MIX_1 + salt;
    h = (h ^ (h >> 16)) * 0x85EBCA6Bu;
    h = (h ^ (h >> 13)) * 0xC2B2AE35u;
    return h ^ (h >> 16);
}

template <class U> inline U reversed(U x) { return __builtin_elementwise_bitreverse(x); }

template <class U> inline U scrambled(U x, U seed)
{
    U r = x + seed;
    r = r ^ (r * 0x6C50B47Cu);
    r = r ^ (r * 0xB82F1E52u);
    r = r ^ (r * 0xC7AFE638u);
    return r ^ (r * 0x8D22F6E6u);
}

template <int W> inline Floats<W> to_unit(Words<W> x)
{
    return __builtin_convertvector((Ints<W>)(x >> 8), Floats<W>) * 0x1p-24f;
}

/// `spread_point`.
template <int W> inline void sobol_point(Words<W> sample, Words<W> seed, Floats<W>& x, Floats<W>& y)
{
    using U = Words<W>;
    const U index = scrambled(reversed(sample), seed);
    U r = index;
    r = r ^ (r << 16);
    r = r ^ ((r & 0x00FF00FFu) << 8);
    r = r ^ ((r & 0x0F0F0F0Fu) << 4);
    r = r ^ ((r & 0x33333333u) << 2);
    r = r ^ ((r & 0x55555555u) << 1);
    x = to_unit<W>(reversed(scrambled(reversed(index), mix(seed, (U)1u))));
    y = to_unit<W>(reversed(scrambled(reversed(r), mix(seed, (U)2u))));
}

/// What the random numbers of W samples follow from: hashes of their pixels, and their numbers. The sampler is "sobol" or
/// "random".
template <int W> struct SampleKeys {
    using F = Floats<W>;
    using U = Words<W>;
    bool is_sobol;
    U pixel, sample;

    /// `pixel_point`.
    void point(int dimension, F& x, F& y) const
    {
        const U own = mix(pixel, (U)(unsigned)dimension);
        if (is_sobol) sobol_point<W>(sample, own, x, y);
        else {
            const U salt = mix(own, sample);
            x = to_unit<W>(salt);
            y = to_unit<W>(mix(salt, (U)3u));
        }
    }

    /// `single_number`.
    F number(int dimension) const { return to_unit<W>(mix(mix(pixel, (U)(unsigned)(0x10000 + dimension)), sample)); }
};

/// The keys of the samples of a wave in these slots, and their pixels.
template <int W, class Source, class Wave>
inline SampleKeys<W> sample_keys(const Source& source, const Wave& wave, Ints<W> slot, Ints<W>& pixel)
{
    using U = Words<W>;
    const Ints<W> place = quotient<W>(slot, wave.samples);
    int pixel_of[W];
    save(pixel_of, place);
    WRT_SCALAR
    for (int i = 0; i < W; ++i) pixel_of[i] = wave.order.data[wave.first_pixel + pixel_of[i]];
    pixel = load<Ints<W>>(pixel_of);
    return {source.sampler == SOBOL, mix((U)pixel, (U)source.seed), (U)(wave.first_sample + slot - place * wave.samples)};
}

/// Cosine and sine of angles in turns.
template <int W> inline void direction_of(Floats<W> u, Floats<W>& cosine, Floats<W>& sine)
{
    using F = Floats<W>;
    using I = Ints<W>;
    const F q = __builtin_elementwise_floor(4.0f * u + 0.5f);
    const F a = (4.0f * u - q) * 1.5707963267948966f, z = a * a;
    const F s = ((-1.9515295891e-4f * z + 8.3321608736e-3f) * z - 1.6666654611e-1f) * z * a + a;
    const F fourth = (2.443315711809948e-5f * z - 1.388731625493765e-3f) * z + 4.166664568298827e-2f;
    const F c = fourth * z * z - 0.5f * z + 1.0f;
    const I quarter = __builtin_convertvector(q, I) & 3;
    const I swaps = (quarter & 1) != 0;
    const F first = pick(swaps, s, c), second = pick(swaps, c, s);
    cosine = pick((quarter == 1) | (quarter == 2), -first, first);
    sine = pick(quarter >= 2, -second, second);
}

/// Unit vectors orthogonal to unit vectors.
template <int W> inline V3<W> tangent_of(const V3<W>& n)
{
    using F = Floats<W>;
    const F sign = pick(n.z < 0.0f, all<W>(-1.0f), all<W>(1.0f));
    const F a = -1.0f / (sign + n.z);
    return {1.0f + sign * n.x * n.x * a, sign * n.x * n.y * a, -sign * n.x};
}

/// Directions about unit normals, with a density proportional to the cosine to them.
template <int W> inline V3<W> cosine_direction(const V3<W>& n, Floats<W> x, Floats<W> y)
{
    using F = Floats<W>;
    const F sign = pick(n.z < 0.0f, all<W>(-1.0f), all<W>(1.0f));
    const F a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    const V3<W> tangent = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
    const V3<W> bitangent = {b, sign + n.y * n.y * a, -n.y};
    const F radius = root(x), height = root(larger(1.0f - x, all<W>(0.0f)));
    F c, s;
    direction_of<W>(y, c, s);
    return tangent * (radius * c) + bitangent * (radius * s) + n * height;
}

}  // namespace
}  // namespace wrt
#endif
