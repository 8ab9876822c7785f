"""Vectors of W lanes in native functions, for Clang on the CPU: what plain loops over lanes cannot say.

Clang's extended vectors have the operators of floats, and `mask ? a : b` selects lane by lane. A plain loop keeps its results
in arrays, which are stored and loaded again between two loops; vectors stay in registers. And no loop compiles to a permutation
of lanes: Clang makes a gather of it.
"""


def vector_words(width: int) -> str:
    """C++ for `width` lanes, a power of two: the types `vf` and `vi` of W floats and W ints, and functions of them.

    `load`, `load_ints` and `save` move W values side by side in memory. `replace(to, mask, v)` saves those lanes of v whose
    mask is not 0. `chosen(row, which)` has the lanes `which` (0 to W - 1) of the W floats at `row`: one permutation where W
    floats are a register of x86-64. `bits_of(mask)` has a bit for each lane that is not 0. `sum_of_product(a, b, c)` is a b +
    c, rounded once where the CPU can.

    Without AVX-512 `replace` reads the other lanes as volatile: Clang would make a masked store of it, which takes tens of
    cycles on AMD's CPUs (notebooks/records/2026-11-26-masked-stores.md).
    """
    bits = 32 * width
    feature = {256: "__AVX2__", 512: "__AVX512F__"}.get(bits, "__NO_PERMUTATION__")
    return f"""
    typedef float vf __attribute__((ext_vector_type({width})));
    typedef int vi __attribute__((ext_vector_type({width})));
    auto load = [](const void* from) {{ vf v; __builtin_memcpy(&v, from, sizeof(v)); return v; }};
    auto load_ints = [](const void* from) {{ vi v; __builtin_memcpy(&v, from, sizeof(v)); return v; }};
    auto save = [](void* to, auto v) {{ __builtin_memcpy(to, &v, sizeof(v)); }};
    auto replace = [](void* to, vi mask, auto v) {{
        typedef int row __attribute__((ext_vector_type({width}), aligned(4)));
#if defined(__AVX512F__)
        const vi before = *(const row*)to;
#else
        const vi before = *(const volatile row*)to;
#endif
        *(row*)to = mask ? __builtin_bit_cast(vi, v) : before;
    }};
    auto bits_of = [](vi mask) {{
        typedef bool vb __attribute__((ext_vector_type({width})));
        const vb set = __builtin_convertvector(mask != 0, vb);
        unsigned bits = 0;
        __builtin_memcpy(&bits, &set, sizeof(set));
        return bits & ((1u << {width}) - 1u);
    }};
#if defined({feature})
    auto chosen = [](const void* row, vi which) {{
        vi v;
        __builtin_memcpy(&v, row, sizeof(v));
        return (vf)__builtin_ia32_permvarsi{bits}(v, which);
    }};
#else
    auto chosen = [](const void* row, vi which) {{
        vf v;
        WRT_SCALAR for (int i = 0; i < {width}; ++i) v[i] = ((const float*)row)[which[i]];
        return v;
    }};
#endif
#if defined(__FMA__) || defined(__ARM_FEATURE_FMA)
    auto sum_of_product = [](vf a, vf b, vf c) {{ return __builtin_elementwise_fma(a, b, c); }};
#else
    auto sum_of_product = [](vf a, vf b, vf c) {{ return a * b + c; }};
#endif
"""
