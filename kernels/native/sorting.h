// Stable sorts by the bits of floats in the order of their values: `wrt.builders.radix_sort`, and the events of small tasks.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// A digit of the bits in the order of the values of floats: negative ones turned over, the others above them.
inline CUDA_CALLABLE unsigned digit_of(unsigned bits, int shift)
{
    return ((bits >> 31 ? ~bits : bits | 0x80000000u) >> shift) & 255u;
}

/// Counts the digits of a chunk. digit(i): of its key i; places: of the first digit, the others are `chunks` apart.
template <int DIGITS, class Digit>
inline CUDA_CALLABLE void count_digits(const Digit& digit, int count, int* places, int chunks)
{
    int counts[DIGITS];
    for (int i = 0; i < DIGITS; ++i) counts[i] = 0;
    for (int i = 0; i < count; ++i) ++counts[digit(i)];
    for (int i = 0; i < DIGITS; ++i) places[(size_t)i * chunks] = counts[i];
}

/// Moves the keys of a chunk to the places of their digits. move(i, place): key i and what belongs to it.
template <int DIGITS, class Digit, class Move>
inline CUDA_CALLABLE void move_digits(const Digit& digit, const Move& move, int count, const int* places, int chunks)
{
    int next[DIGITS];
    for (int i = 0; i < DIGITS; ++i) next[i] = places[(size_t)i * chunks];
    for (int i = 0; i < count; ++i) move(i, next[digit(i)]++);
}

/// Digits of 8 bits of floats.
struct FloatDigits {
    const float* keys;
    int shift;

    inline CUDA_CALLABLE unsigned operator()(int i) const { return digit_of(__builtin_bit_cast(unsigned, keys[i]), shift); }
};

/// Counts the digits of a chunk's keys.
inline CUDA_CALLABLE void count_digits(const float* keys, int count, int shift, int* places, int chunks)
{
    count_digits<256>(FloatDigits {keys, shift}, count, places, chunks);
}

/// Moves a chunk's keys and values.
inline CUDA_CALLABLE void move_digits(
    const float* keys, const int* values, int count, int shift, const int* places, int chunks, float* to_keys, int* to_values)
{
    const auto move = [&](int i, size_t to) { to_keys[to] = keys[i], to_values[to] = values[i]; };
    move_digits<256>(FloatDigits {keys, shift}, move, count, places, chunks);
}

/// Sorts pairs by their first words, the bits of floats. An equal amount of memory behind them is scratch.
template <class Pair> inline CUDA_CALLABLE void sort_pairs(Pair* from, int count)
{
    Pair* to = from + count;
    for (int shift = 0; shift < 32; shift += 8) {
        int place[256];
        for (int digit = 0; digit < 256; ++digit) place[digit] = 0;
        for (int i = 0; i < count; ++i) ++place[digit_of((unsigned)from[i].c[0], shift)];
        int before = 0;
        for (int digit = 0; digit < 256; ++digit) {
            const int here = place[digit];
            place[digit] = before;
            before += here;
        }
        for (int i = 0; i < count; ++i) to[place[digit_of((unsigned)from[i].c[0], shift)]++] = from[i];
        Pair* const sorted = to;
        to = from;
        from = sorted;
    }
}

}  // namespace
}  // namespace wrt
