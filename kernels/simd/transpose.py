"""Transposes 16 records of floats to lanes and back.

A record that is read as a whole has its words in sequence; numbers that are computed 16 at a time have their lanes in sequence.
Converting between the two needs one gather or scatter per word, which is slow. 16 records of 16 words are a matrix: 16 vector
loads, 64 shuffles (four rounds of exchanges between rows 1, 2, 4 and 8 apart) and 16 stores transpose it.

References:
    J. O. Eklundh: A fast computer method for matrix transposing. IEEE Transactions on Computers C-21(7), 1972.
"""


def _turn(distance: int) -> str:
    """C++ of one step of Eklundh's transposition: swaps blocks of rows `distance` apart."""
    low = ", ".join(str(j if not j & distance else j - distance + 16) for j in range(16))
    high = ", ".join(str(j + distance if not j & distance else j + 16) for j in range(16))
    return "".join(
        f"""
        {{ const wrt_row a = r[{i}], b = r[{i + distance}];
          r[{i}] = __builtin_shufflevector(a, b, {low}); r[{i + distance}] = __builtin_shufflevector(a, b, {high}); }}"""
        for i in range(16)
        if not i & distance
    )


TRANSPOSE = f"""
#if defined(__clang__) && !defined(__CUDA_ARCH__)
    typedef float wrt_row __attribute__((ext_vector_type(16)));
    auto wrt_turn = [](wrt_row* r) {{
        {_turn(1)}{_turn(2)}{_turn(4)}{_turn(8)}
    }};
    auto wrt_write = [&](const float* columns, float* to, int words, unsigned kept) {{
        wrt_row r[16];
        for (int c = 0; c < 16; ++c) __builtin_memcpy(&r[c], columns + c * 16, sizeof(wrt_row));
        wrt_turn(r);
        if (kept == 0xffffu) {{
            WRT_UNROLLED for (int k = 0; k < 16; ++k) __builtin_memcpy(to + k * words, &r[k], sizeof(wrt_row));
        }} else {{
            WRT_UNROLLED for (int k = 0; k < 16; ++k) {{
                if (kept >> k) __builtin_memcpy(to, &r[k], sizeof(wrt_row));  // the next one overwrites what is not kept
                to += kept >> k & 1u ? words : 0;
            }}
        }}
    }};
    auto wrt_read = [&](const float* const* from, int first, float* columns) {{
        wrt_row r[16];
        WRT_UNROLLED for (int k = 0; k < 16; ++k) __builtin_memcpy(&r[k], from[k] + first, sizeof(wrt_row));
        wrt_turn(r);
        for (int c = 0; c < 16; ++c) __builtin_memcpy(columns + c * 16, &r[c], sizeof(wrt_row));
    }};
#else
    auto wrt_write = [&](const float* columns, float* to, int words, unsigned kept) {{
        for (int k = 0; kept >> k; ++k) {{
            for (int c = 0; c < 16; ++c) to[c] = columns[c * 16 + k];
            to += kept >> k & 1u ? words : 0;
        }}
    }};
    auto wrt_read = [&](const float* const* from, int first, float* columns) {{
        for (int k = 0; k < 16; ++k) for (int c = 0; c < 16; ++c) columns[c * 16 + k] = from[k][first + c];
    }};
#endif
"""
"""C++, after `wrt.kernels.simd.lanes.FOR_LANES`. `columns`: 16 columns of 16 lanes, word c of record k in columns[c * 16 + k].

`wrt_write(columns, to, words, kept)`: 16 words each of the records whose bits are set in `kept`, one after the other, which
begin at `to` and are `words` apart.
`wrt_read(from, first, columns)`: words first .. first + 15 of the 16 records at `from`."""
