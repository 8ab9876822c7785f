"""The words in which a step shades W rays in lanes: vectors of floats, of points, random numbers. CPU only.

Clang's extended vectors have the operators of floats, and `mask ? a : b` selects lane by lane. So lane code reads as the scalar
functions do whose bits it gives: each operation is that of the scalar function, in the same order, and no two are fused. `V3`
is W vectors of three components.
"""

from wrt.kernels.simd.lane_vectors import vector_words


def lane_words(width: int) -> str:
    """C++: types and functions for `width` lanes, a power of two up to 16. Needs `W`, an int constant of that value."""
    return vector_words(width) + _TYPES + _moves(width) + _NUMBERS


_TYPES = """
    typedef unsigned vu __attribute__((ext_vector_type(W)));
    typedef double vd __attribute__((ext_vector_type(W)));
    struct V3 {
        vf x, y, z;
        V3 operator+(const V3& o) const { return {x + o.x, y + o.y, z + o.z}; }
        V3 operator-(const V3& o) const { return {x - o.x, y - o.y, z - o.z}; }
        V3 operator*(const V3& o) const { return {x * o.x, y * o.y, z * o.z}; }
        V3 operator*(vf s) const { return {x * s, y * s, z * s}; }
        V3 operator/(vf s) const { return {x / s, y / s, z / s}; }
    };
    auto all = [](float x) { return (vf)x; };
    auto all3 = [](const wp::vec3& v) { return V3{(vf)v.c[0], (vf)v.c[1], (vf)v.c[2]}; };
    auto dot = [](const V3& a, const V3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; };
    auto cross = [](const V3& a, const V3& b) {
        return V3{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    };
    auto root = [](vf a) { return __builtin_elementwise_sqrt(a); };
    auto size_of = [](vf a) { return __builtin_elementwise_abs(a); };
    auto larger = [](vf a, vf b) { return a > b ? a : b; };
    auto smaller = [](vf a, vf b) { return a < b ? a : b; };
    auto pick = [](vi mask, vf a, vf b) { return mask ? a : b; };
    auto pick3 = [](vi mask, const V3& a, const V3& b) { return V3{mask ? a.x : b.x, mask ? a.y : b.y, mask ? a.z : b.z}; };
    auto pick_ints = [](vi mask, vi a, vi b) { return mask ? a : b; };
    auto as_float = [](vi a) { return __builtin_convertvector(a, vf); };
    auto is_any = [](vi mask) { return __builtin_reduce_or(mask) != 0; };
    auto for_each_value = [&](vi values, vi lanes, auto act) {  // act(value, its lanes)
        while (is_any(lanes)) {
            const int value = values[__builtin_ctz(bits_of(lanes))];
            const vi own = lanes & (values == value);
            act(value, own);
            lanes = lanes & ~own;
        }
    };
    auto quotient = [](vi a, int by) {  // a / by for a >= 0: no CPU divides vectors of integers
        return __builtin_convertvector((__builtin_convertvector(a, vd) + 0.5) * (1.0 / by), vi);
    };
"""

_NUMBERS = """
    auto mix = [](vu value, vu salt) {
        vu h = value * 0x9E3779B1u + salt;
        h = (h ^ (h >> 16)) * 0x85EBCA6Bu;
        h = (h ^ (h >> 13)) * 0xC2B2AE35u;
        return h ^ (h >> 16);
    };
    auto reversed = [](vu x) { return __builtin_elementwise_bitreverse(x); };
    auto scrambled = [](vu x, vu seed) {
        vu r = x + seed;
        r = r ^ (r * 0x6C50B47Cu);
        r = r ^ (r * 0xB82F1E52u);
        r = r ^ (r * 0xC7AFE638u);
        return r ^ (r * 0x8D22F6E6u);
    };
    auto to_unit = [](vu x) { return __builtin_convertvector((vi)(x >> 8), vf) * 0x1p-24f; };
    auto sobol_point = [&](vu sample, vu seed, vf& x, vf& y) {  // `spread_point`
        const vu index = scrambled(reversed(sample), seed);
        vu r = index;
        r = r ^ (r << 16);
        r = r ^ ((r & 0x00FF00FFu) << 8);
        r = r ^ ((r & 0x0F0F0F0Fu) << 4);
        r = r ^ ((r & 0x33333333u) << 2);
        r = r ^ ((r & 0x55555555u) << 1);
        x = to_unit(reversed(scrambled(reversed(index), mix(seed, (vu)1u))));
        y = to_unit(reversed(scrambled(reversed(r), mix(seed, (vu)2u))));
    };
    auto pixel_point = [&](vu pixel, vu sample, int dimension, vf& x, vf& y) {
        const vu own = mix(pixel, (vu)(unsigned)dimension);
        if (is_sobol) sobol_point(sample, own, x, y);
        else {
            const vu salt = mix(own, sample);
            x = to_unit(salt); y = to_unit(mix(salt, (vu)3u));
        }
    };
    auto single_number = [&](vu pixel, vu sample, int dimension) {
        return to_unit(mix(mix(pixel, (vu)(unsigned)(0x10000 + dimension)), sample));
    };
    auto turned = [&](vf u, vf& cosine, vf& sine) {
        const vf q = __builtin_elementwise_floor(4.0f * u + 0.5f);
        const vf a = (4.0f * u - q) * 1.5707963267948966f, z = a * a;
        const vf s = ((-1.9515295891e-4f * z + 8.3321608736e-3f) * z - 1.6666654611e-1f) * z * a + a;
        const vf fourth = (2.443315711809948e-5f * z - 1.388731625493765e-3f) * z + 4.166664568298827e-2f;
        const vf c = fourth * z * z - 0.5f * z + 1.0f;
        const vi quarter = __builtin_convertvector(q, vi) & 3;
        const vi swaps = (quarter & 1) != 0;
        const vf first = pick(swaps, s, c), second = pick(swaps, c, s);
        cosine = pick((quarter == 1) | (quarter == 2), -first, first);
        sine = pick(quarter >= 2, -second, second);
    };
    auto tangent_of = [&](const V3& n) {
        const vf sign = pick(n.z < 0.0f, all(-1.0f), all(1.0f));
        const vf a = -1.0f / (sign + n.z);
        return V3{1.0f + sign * n.x * n.x * a, sign * n.x * n.y * a, -sign * n.x};
    };
    auto cosine_direction = [&](const V3& n, vf x, vf y) {
        const vf sign = pick(n.z < 0.0f, all(-1.0f), all(1.0f));
        const vf a = -1.0f / (sign + n.z), b = n.x * n.y * a;
        const V3 tangent = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
        const V3 bitangent = {b, sign + n.y * n.y * a, -n.y};
        const vf radius = root(x), height = root(larger(1.0f - x, all(0.0f)));
        vf c, s;
        turned(y, c, s);
        return tangent * (radius * c) + bitangent * (radius * s) + n * height;
    };
"""
"""C++: the functions of `wrt.kernels.shading.sampling`, `.wavefront.pixel_samples` and `.bsdf.ggx` that have the same names.
Needs `is_sobol`, whether the sampler is "sobol"; if not, it is "random"."""


def _moves(width: int) -> str:
    """C++: loads and stores of W vectors side by side in memory."""
    lanes = range(width)

    def shuffle(a: str, b: str, indices: list[int]) -> str:
        return f"__builtin_shufflevector({a}, {b}, {', '.join(map(str, indices))})"

    def component(k: int) -> str:
        places = [3 * i + k for i in lanes]
        two = shuffle("a", "b", [p if p < 2 * width else -1 for p in places])
        return shuffle(two, "c", [i if p < 2 * width else p - width for i, p in enumerate(places)])

    def part(m: int) -> str:
        places = [divmod(m * width + j, 3) for j in lanes]
        two = shuffle("v.x", "v.y", [i + k * width if k < 2 else -1 for i, k in places])
        return shuffle(two, "v.z", [j if k < 2 else width + i for j, (i, k) in enumerate(places)])

    turns, distance = "", 1
    while distance < width:  # as `wrt.kernels.simd.transpose`
        low = [j if not j & distance else j - distance + width for j in lanes]
        high = [j + distance if not j & distance else j + width for j in lanes]
        for i in (i for i in lanes if not i & distance):
            a, b = f"r[{i}]", f"r[{i + distance}]"
            turns += f"""
            {{ const vf a = {a}, b = {b}; {a} = {shuffle("a", "b", low)}; {b} = {shuffle("a", "b", high)}; }}"""
        distance *= 2

    return f"""
    auto load3 = [&](const wp::vec3* from) {{
        const vf a = load(from), b = load((const float*)from + W), c = load((const float*)from + 2 * W);
        return V3{{{component(0)},
                  {component(1)},
                  {component(2)}}};
    }};
    auto load2 = [&](const wp::vec2* from, vf& x, vf& y) {{
        const vf a = load(from), b = load((const float*)from + W);
        x = {shuffle("a", "b", [2 * i for i in lanes])};
        y = {shuffle("a", "b", [2 * i + 1 for i in lanes])};
    }};
    auto save3 = [&](wp::vec3* to, const V3& v) {{
        save(to, {part(0)});
        save((float*)to + W, {part(1)});
        save((float*)to + 2 * W, {part(2)});
    }};
    auto load_records = [&](auto record, vf* words) {{  // W records of 16 floats; record(i): address of one
        WRT_UNROLLED for (int first = 0; first < 16; first += W) {{
            vf* const r = words + first;
            WRT_UNROLLED for (int i = 0; i < W; ++i) r[i] = load((const float*)record(i) + first);{turns}
        }}
    }};
"""
