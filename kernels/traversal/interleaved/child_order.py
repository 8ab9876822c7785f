"""Children that a ray meets, put on its stack with the nearest on top: a sort without branches.

**Problem.** A ray meets zero to W children of a node. Sorting them by a loop costs a branch per comparison, which the
processor cannot predict.

**Idea.** Keys and children are sorted in registers by Batcher's bitonic sorter, whose comparisons do not depend on the data.
A key is the bit pattern of the t at which the ray enters a child's box, with the child's lane in the lowest bits
(`wrt.kernels.simd.box_lanes`). It is -1 for a child that the ray misses. Keys are sorted in descending order, so the children
that the ray meets come first, the nearest last; all W are written, and the stack grows by the number of those met. With
AVX-512 the keys of the children met are first moved together (as in Fuetterling et al. 2017); if there are at most `FEW`,
which is nearly always the case, sorting so many lanes is enough. With AVX2, sorting all 8 lanes takes as long as moving them
(notebooks/records/2026-11-22-interleaved-rays.md).

References:
    K. E. Batcher: Sorting networks and their applications. AFIPS Spring Joint Computer Conference 1968.
    V. Fuetterling, C. Lojewski, F.-J. Pfreundt, A. Ebert: Accelerated single ray tracing for wide vector units. High
        Performance Graphics 2017.
"""

FEW = 4
"""Lanes that are sorted where few of 16 children are met."""


def sorter(lanes: int) -> str:
    """C++ of `wrt_sort<lanes>(v)`: a vector of so many ints, a power of two, in descending order."""
    steps, block = "", 2
    while block <= lanes:
        distance = block // 2
        while distance:
            partner = ", ".join(str(i ^ distance) for i in range(lanes))
            greater = [((i & block) == 0) == ((i & distance) == 0) for i in range(lanes)]
            chosen = ", ".join(str(i + lanes if greater[i] else i) for i in range(lanes))
            steps += f"""
        {{ const wrt_lanes{lanes} w = __builtin_shufflevector(v, v, {partner});
          v = __builtin_shufflevector(__builtin_elementwise_min(v, w), __builtin_elementwise_max(v, w), {chosen}); }}"""
            distance //= 2
        block *= 2
    return f"""
    typedef int wrt_lanes{lanes} __attribute__((ext_vector_type({lanes})));
    auto wrt_sort{lanes} = [](wrt_lanes{lanes} v) {{{steps}
        return v;
    }};
"""


_STORE = "__builtin_memcpy(to, &v, sizeof(v)); __builtin_memcpy(to + DEPTH, &c, sizeof(c));"

_SIXTEEN = f"""
#if defined(__AVX512F__) && defined(__clang__) && !defined(__CUDA_ARCH__)
{sorter(FEW)}{sorter(16)}
    auto wrt_push = [&](const int* key, unsigned mask, const int* child, int* to) {{
        wrt_lanes16 v, c;
        __builtin_memcpy(&v, key, sizeof(v)); __builtin_memcpy(&c, child, sizeof(c));
        const int count = __builtin_popcount(mask);
        v = __builtin_ia32_compresssi512_mask(v, (wrt_lanes16)(-1), (unsigned short)mask);
        const wrt_lanes{FEW} few = wrt_sort{FEW}(__builtin_shufflevector(v, v, {", ".join(map(str, range(FEW)))}));
        if (count > {FEW}) v = wrt_sort16(v);
        else v = __builtin_shufflevector(few, few, {", ".join(map(str, [*range(FEW), *[-1] * (16 - FEW)]))});
        c = __builtin_ia32_permvarsi512(c, v);
        {_STORE}
        return count;
    }};
#el"""

_EIGHT = f"""
#if defined(__AVX2__) && defined(__clang__) && !defined(__CUDA_ARCH__)
{sorter(8)}
    auto wrt_push = [&](const int* key, unsigned mask, const int* child, int* to) {{
        wrt_lanes8 v, c;
        __builtin_memcpy(&v, key, sizeof(v)); __builtin_memcpy(&c, child, sizeof(c));
        v = wrt_sort8(v);
        c = __builtin_ia32_permvarsi256(c, v);
        {_STORE}
        return __builtin_popcount(mask);
    }};
#el"""


def last_lanes_first(mask: int) -> int:
    """Indices of the bits that are set in a mask of 8, one a byte, the last in the lowest byte; 0 in the bytes left over."""
    return sum(lane << 8 * place for place, lane in enumerate(lane for lane in reversed(range(8)) if mask >> lane & 1))


_REVERSED = ", ".join(f"{last_lanes_first(mask):#x}ull" for mask in range(256))

_REVERSED_EIGHT = f"""
#if defined(__AVX2__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    static const unsigned long long WRT_LAST_LANES_FIRST[256] = {{{_REVERSED}}};
    auto wrt_push = [](int* to, const int* child, unsigned mask) {{
        typedef int ints __attribute__((ext_vector_type(8)));
        typedef unsigned char bytes __attribute__((ext_vector_type(8)));
        ints c; __builtin_memcpy(&c, child, sizeof(c));
        bytes lane; __builtin_memcpy(&lane, WRT_LAST_LANES_FIRST + mask, sizeof(lane));
        c = __builtin_ia32_permvarsi256(c, __builtin_convertvector(lane, ints));
        __builtin_memcpy(to, &c, sizeof(c));
    }};
#el"""

_REVERSED_SIXTEEN = """
#if defined(__AVX512F__) && defined(__clang__) && !defined(__CUDA_ARCH__)
    auto wrt_push = [](int* to, const int* child, unsigned mask) {
        typedef int ints __attribute__((ext_vector_type(16)));
        ints c; __builtin_memcpy(&c, child, sizeof(c));
        const int first = child[__builtin_ctz(mask | 32768u)], others = __builtin_popcount(mask) - 1;
        c = __builtin_ia32_compresssi512_mask(c, c, (unsigned short)(mask & (mask - 1u)));
        __builtin_memcpy(to, &c, sizeof(c));
        to[mask ? others : 15] = first;
    };
#el"""


def push_reversed(width: int) -> str:
    """C++ of `wrt_push(to, child, mask)`: writes the children in the mask to `to`, the one with the lowest lane last. The
    others are in any order. Writes W words.

    Constants of the snippet: W, the width.
    """
    with_permutations = {16: _REVERSED_SIXTEEN, 8: _REVERSED_EIGHT}.get(width, "\n#")
    return f"""{with_permutations}if 1
    auto wrt_push = [](int* to, const int* child, unsigned mask) {{
        int count = 0;
        for (int i = W - 1; i >= 0; --i) {{ to[count] = child[i]; count += mask >> i & 1u; }}
    }};
#endif
"""


def push_sorted(width: int) -> str:
    """C++ of `wrt_push(key, mask, child, to)`: writes the keys of the children in the mask to `to`, and their words DEPTH words
    behind, in descending order of the keys; returns how many. Writes W words to each.

    Constants of the snippet: W, the width, and DEPTH. `key`: W keys, -1 outside the mask.
    """
    with_permutations = {16: _SIXTEEN, 8: _EIGHT}.get(width, "\n#")
    return f"""{with_permutations}if defined(__clang__) && !defined(__CUDA_ARCH__)
{sorter(width)}
    auto wrt_push = [&](const int* key, unsigned mask, const int* child, int* to) {{
        wrt_lanes{width} v;
        __builtin_memcpy(&v, key, sizeof(v));
        v = wrt_sort{width}(v);
        for (int i = 0; i < W; ++i) {{ to[i] = v[i]; to[DEPTH + i] = child[v[i] < 0 ? 0 : v[i] & (W - 1)]; }}
        return __builtin_popcount(mask);
    }};
#else
    auto wrt_push = [&](const int* key, unsigned mask, const int* child, int* to) {{
        int count = 0;
        for (int i = 0; i < W; ++i) {{
            if (!(mask >> i & 1u)) continue;
            int j = count++;
            for (; j > 0 && to[j - 1] < key[i]; --j) {{ to[j] = to[j - 1]; to[DEPTH + j] = to[DEPTH + j - 1]; }}
            to[j] = key[i]; to[DEPTH + j] = child[i];
        }}
        return count;
    }};
#endif
"""
