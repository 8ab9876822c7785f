// Vectors of lanes: bits of masks, compaction, sorting, transposition.
#pragma once
#include "loops.h"

#if defined(__clang__) && !defined(__CUDA_ARCH__)
#define WRT_VECTORS 1
#else
#define WRT_VECTORS 0
#endif

namespace wrt {
namespace {

inline CUDA_CALLABLE int lowest_bit(unsigned bits)
{
#if defined(__CUDA_ARCH__)
    return __ffs(bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
}

inline CUDA_CALLABLE int count_bits(unsigned bits)
{
#if defined(__CUDA_ARCH__)
    return __popc(bits);
#else
    return __builtin_popcount(bits);
#endif
}

/// Of numbers or vectors; the second, of a NaN and a number.
template <class T> inline CUDA_CALLABLE T larger(T a, T b) { return a > b ? a : b; }
template <class T> inline CUDA_CALLABLE T smaller(T a, T b) { return a < b ? a : b; }

/// Elements of the vectors in which lists of W lanes of a node or a block are compacted.
constexpr CUDA_CALLABLE int block_lanes(int width)
{
#if defined(__AVX512F__) && !defined(__CUDA_ARCH__)
    constexpr int MIN_WIDTH = 16;
#else
    constexpr int MIN_WIDTH = 8;
#endif
    return width > MIN_WIDTH ? (width + 7) / 8 * 8 : MIN_WIDTH;
}

#if WRT_VECTORS
template <class T, int N> struct VectorOf {
    typedef T type __attribute__((ext_vector_type(N)));
};
template <class T, int N> using Vector = typename VectorOf<T, N>::type;

template <class V> inline V load(const void* from)
{
    V v;
    __builtin_memcpy(&v, from, sizeof(v));
    return v;
}

template <class V> inline void save(void* to, V v) { __builtin_memcpy(to, &v, sizeof(v)); }
#endif

template <class T, int N> inline CUDA_CALLABLE void copy(T* to, const T (&from)[N])
{
#if WRT_VECTORS
    __builtin_memcpy(to, from, sizeof(from));
#else
    memcpy(to, from, sizeof(from));
#endif
}

/// The same object, at a place of which the compiler knows nothing else: it reads what is used where it is used.
template <class T> inline CUDA_CALLABLE T& read_in_place(T& object)
{
#if WRT_VECTORS
    T* volatile place = &object;
    return *place;
#else
    return object;
#endif
}

/// One bit for each of N flags that is not 0: one comparison; a loop that collects bits by |= becomes a chain of shuffles.
template <int N> inline CUDA_CALLABLE unsigned bits(const int* flags)
{
    unsigned mask = 0;
#if WRT_VECTORS
    const auto set = __builtin_convertvector(load<Vector<int, N>>(flags) != 0, Vector<bool, N>);
    __builtin_memcpy(&mask, &set, sizeof(set));
    return mask & ((1u << N) - 1u);
#else
    for (int i = 0; i < N; ++i) mask |= flags[i] ? 1u << i : 0u;
    return mask;
#endif
}

#if WRT_VECTORS && defined(__AVX2__)
/// The lanes of each mask of 8, a byte each: the first or the last in the lowest byte, 0 in the bytes left over.
struct MaskLanes {
    unsigned long long of[256];

    constexpr explicit MaskLanes(bool reversed)
        : of()
    {
        for (int mask = 0; mask < 256; ++mask)
            for (int j = 0, place = 0; j < 8; ++j) {
                const int lane = reversed ? 7 - j : j;
                if (mask >> lane & 1) of[mask] |= (unsigned long long)lane << 8 * place++;
            }
    }
};
constexpr MaskLanes FIRST_LANES_FIRST(false), LAST_LANES_FIRST(true);

/// The lanes of a mask in a row of `MaskLanes`.
inline Vector<int, 8> lanes_in(unsigned long long row)
{
    return __builtin_convertvector(__builtin_bit_cast(Vector<unsigned char, 8>, row), Vector<int, 8>);
}

/// The lanes `which` (0 to 7) of v.
inline Vector<int, 8> permuted(Vector<int, 8> v, Vector<int, 8> which) { return __builtin_ia32_permvarsi256(v, which); }

/// The lanes of v that a mask selects come first, in order; what is in the others is not said.
inline Vector<int, 8> compressed(Vector<int, 8> v, unsigned mask) { return permuted(v, lanes_in(FIRST_LANES_FIRST.of[mask])); }
#endif

#if WRT_VECTORS && defined(__AVX512F__)
/// The lanes `which` (0 to 15) of v.
inline Vector<int, 16> permuted(Vector<int, 16> v, Vector<int, 16> which) { return __builtin_ia32_permvarsi512(v, which); }

/// The lanes of v that a mask selects come first, in order; the others are those of `rest`.
inline Vector<int, 16> compressed(Vector<int, 16> v, unsigned mask, Vector<int, 16> rest)
{
    return __builtin_ia32_compresssi512_mask(v, rest, (unsigned short)mask);
}

inline Vector<int, 16> compressed(Vector<int, 16> v, unsigned mask) { return compressed(v, mask, v); }
#endif

/// Appends those of N numbers that the mask selects, one by one and without a branch, in order or the last first; returns how
/// many. Writes up to N numbers.
template <int N, bool REVERSED = false> inline CUDA_CALLABLE int append_one_by_one(int* to, const int* from, unsigned mask)
{
    int size = 0;
    for (int j = 0; j < N; ++j) {
        const int i = REVERSED ? N - 1 - j : j, value = from[i];
        to[size] = value;
        size += mask >> i & 1u;
    }
    return size;
}

/// Appends those of L numbers that the mask selects, in order, and returns how many. L is a multiple of 8, and 16 with
/// AVX-512. Writes L numbers.
template <int L> inline CUDA_CALLABLE int append(int* to, const int* from, unsigned mask)
{
#if WRT_VECTORS && defined(__AVX512F__)
    static_assert(L == 16, "one register");
    save(to, compressed(load<Vector<int, 16>>(from), mask));
    return count_bits(mask);
#elif WRT_VECTORS && defined(__AVX2__)
    int size = 0;
    for (int i = 0; i < L; i += 8) {
        const unsigned own = mask >> i & 255u;
        save(to + size, compressed(load<Vector<int, 8>>(from + i), own));
        size += count_bits(own);
    }
    return size;
#else
    return append_one_by_one<L>(to, from, mask);
#endif
}

#if WRT_VECTORS
template <class T, T... I> struct Numbers { };
template <int N> using Lanes = __make_integer_seq<Numbers, int, N>;

/// A step of Batcher's bitonic sorter: lanes i and i ^ Distance are ordered, descending where i & Block is 0.
template <int Block, int Distance, class V, int... I> inline V sort_step(V v, Numbers<int, I...>)
{
    const V w = __builtin_shufflevector(v, v, (I ^ Distance)...);
    return __builtin_shufflevector(__builtin_elementwise_min(v, w), __builtin_elementwise_max(v, w),
        (((I & Block) == 0) == ((I & Distance) == 0) ? I + (int)sizeof...(I) : I)...);
}

/// The lanes in descending order.
template <int N, int Block = 2, int Distance = 1> inline Vector<int, N> sort(Vector<int, N> v)
{
    v = sort_step<Block, Distance>(v, Lanes<N>());
    if constexpr (Distance > 1) return sort<N, Block, Distance / 2>(v);
    else if constexpr (Block < N) return sort<N, 2 * Block, Block>(v);
    else return v;
}
#endif

// The greatest float of each of several rows of W lanes, all rows at once.
//
// Reducing one row takes log2 W rounds of a shuffle and a maximum, each waiting for the one before, and most of the lanes are
// idle in the last rounds. Here two registers are folded into one in every round: two shuffles collect one half of the lanes of
// each row in one register and the other half in another, and one maximum leaves both rows in half as many lanes. R rows take
// about 2 R shuffles and R maxima in all, whatever W is. Halves are runs of four lanes as long as a row has several, then lanes
// of a run, because shuffles between runs of four move whole runs.

/// Lanes of a register that are folded by themselves, where its rows have `left` lanes each.
constexpr CUDA_CALLABLE int folded_run(int width, int left) { return left > 4 || width < 4 ? width : 4; }

/// The lane of row `row` after all rounds, in register row / W.
constexpr CUDA_CALLABLE int folded_place(int width, int row)
{
    int place = 0;
    for (int left = width; left > 1; left /= 2, row /= 2) {
        const int run = folded_run(width, left);
        place = place / run * run + (row & 1) * (run / 2) + place % run / left * (left / 2);
    }
    return place;
}

#if WRT_VECTORS
/// Where lane j of a half comes from, of two registers whose rows have `left` lanes each. half: 0 or 1.
constexpr int folded_lane(int width, int left, int half, int j)
{
    const int run = folded_run(width, left), within = j % run, own = within % (run / 2);
    const int lane = j / run * run + own / (left / 2) * left + half * (left / 2) + own % (left / 2);
    return within < run / 2 ? lane : lane + width;
}

template <int W, int LEFT, int... I> inline Vector<float, W> fold(Vector<float, W> v, Vector<float, W> w, Numbers<int, I...>)
{
    const Vector<float, W> a = __builtin_shufflevector(v, w, folded_lane(W, LEFT, 0, I)...);
    const Vector<float, W> b = __builtin_shufflevector(v, w, folded_lane(W, LEFT, 1, I)...);
    return a > b ? a : b;
}

/// N registers whose rows have LEFT lanes each; an odd one is folded with itself.
template <int W, int N, int LEFT = W> inline void fold_rows(Vector<float, W>* rows)
{
    if constexpr (LEFT > 1) {
        constexpr int HALF = (N + 1) / 2;
        WRT_UNROLLED
        for (int j = 0; j < HALF; ++j)
            rows[j] = fold<W, LEFT>(rows[2 * j], rows[2 * j + 1 < N ? 2 * j + 1 : 2 * j], Lanes<W>());
        fold_rows<W, HALF, LEFT / 2>(rows);
    }
}
#endif

/// results[j] becomes the greatest of the W floats of row j, none of them NaN. W is a power of two.
template <int N, int W> inline CUDA_CALLABLE void row_maxima(const float (*rows)[W], float* results)
{
#if WRT_VECTORS
    Vector<float, W> registers[N];
    WRT_UNROLLED
    for (int j = 0; j < N; ++j) registers[j] = load<Vector<float, W>>(rows[j]);
    fold_rows<W, N>(registers);
    WRT_UNROLLED
    for (int j = 0; j < N; ++j) results[j] = registers[j / W][folded_place(W, j % W)];
#else
    for (int j = 0; j < N; ++j) {
        results[j] = rows[j][0];
        for (int i = 1; i < W; ++i) results[j] = rows[j][i] > results[j] ? rows[j][i] : results[j];
    }
#endif
}

// Transposes 16 records of floats to lanes and back.
//
// A record that is read as a whole has its words in sequence; numbers that are computed 16 at a time have their lanes in
// sequence. Converting between the two needs one gather or scatter per word, which is slow. 16 records of 16 words are a
// matrix: 16 vector loads, 64 shuffles (four rounds of exchanges between rows 1, 2, 4 and 8 apart) and 16 stores transpose it.
//
// References:
//     J. O. Eklundh: A fast computer method for matrix transposing. IEEE Transactions on Computers C-21(7), 1972.

#if WRT_VECTORS
using Row = Vector<float, 16>;

/// Exchanges blocks between two rows that are Distance apart.
template <int Distance, class V, int... I> inline void exchange(V& upper, V& lower, Numbers<int, I...>)
{
    constexpr int N = sizeof...(I);
    const V a = upper, b = lower;
    upper = __builtin_shufflevector(a, b, (I & Distance ? I - Distance + N : I)...);
    lower = __builtin_shufflevector(a, b, (I & Distance ? I + N : I + Distance)...);
}

/// Transposes N rows of N numbers, by Eklundh's steps from `Distance` on.
template <int N, int Distance = 1, class V> inline void transpose(V* rows)
{
    WRT_UNROLLED
    for (int i = 0; i < N; ++i)
        if (!(i & Distance)) exchange<Distance>(rows[i], rows[i + Distance], Lanes<N>());
    if constexpr (2 * Distance < N) transpose<N, 2 * Distance>(rows);
}
#endif

/// Writes 16 words each of the records whose bits are set in `kept`, one after the other, which begin at `to` and are `words`
/// apart. columns: 16 columns of 16 lanes, word c of record k in columns[c * 16 + k].
inline CUDA_CALLABLE void write_records(const float* columns, float* to, int words, unsigned kept)
{
#if WRT_VECTORS
    Row rows[16];
    for (int c = 0; c < 16; ++c) rows[c] = load<Row>(columns + c * 16);
    transpose<16>(rows);
    if (kept == 0xffffu) {
        WRT_UNROLLED
        for (int k = 0; k < 16; ++k) save(to + k * words, rows[k]);
    } else {
        WRT_UNROLLED
        for (int k = 0; k < 16; ++k) {
            if (kept >> k) save(to, rows[k]);  // the next one overwrites what is not kept
            to += kept >> k & 1u ? words : 0;
        }
    }
#else
    for (int k = 0; kept >> k; ++k) {
        for (int c = 0; c < 16; ++c) to[c] = columns[c * 16 + k];
        to += kept >> k & 1u ? words : 0;
    }
#endif
}

/// Reads words first .. first + 15 of the 16 records at `from` into 16 columns of 16 lanes.
inline CUDA_CALLABLE void read_records(const float* const* from, int first, float* columns)
{
#if WRT_VECTORS
    Row rows[16];
    WRT_UNROLLED
    for (int k = 0; k < 16; ++k) rows[k] = load<Row>(from[k] + first);
    transpose<16>(rows);
    for (int c = 0; c < 16; ++c) save(columns + c * 16, rows[c]);
#else
    for (int k = 0; k < 16; ++k)
        for (int c = 0; c < 16; ++c) columns[c * 16 + k] = from[k][first + c];
#endif
}

template <class F> inline CUDA_CALLABLE F absolute(F x)
{
#if WRT_VECTORS
    return __builtin_elementwise_abs(x);
#else
    return WRT_ABS(x);
#endif
}

#if WRT_VECTORS
// Vectors of W lanes, for what plain loops over lanes cannot say: vectors stay in registers between two steps, and lanes can be
// permuted. `mask ? a : b` selects lane by lane.

template <int W> using Floats = Vector<float, W>;
template <int W> using Ints = Vector<int, W>;

/// A bit for each lane that is not 0.
template <class M> inline unsigned bits_of(M mask)
{
    constexpr int N = sizeof(M) / sizeof(int);
    const auto set = __builtin_convertvector(mask != 0, Vector<bool, N>);
    unsigned own = 0;
    __builtin_memcpy(&own, &set, sizeof(set));
    return own & ((1u << N) - 1u);
}

/// Saves those lanes of v whose mask is not 0. Without AVX-512 the other lanes are read as volatile: Clang would make a masked
/// store of it, which takes tens of cycles on AMD's CPUs (notebooks/records/2026-11-26-masked-stores.md).
template <int W, class V> inline void replace(void* to, Ints<W> mask, V v)
{
    typedef int Unaligned __attribute__((ext_vector_type(W), aligned(4)));
#if defined(__AVX512F__)
    const Ints<W> before = *(const Unaligned*)to;
#else
    const Ints<W> before = *(const volatile Unaligned*)to;
#endif
    *(Unaligned*)to = mask ? __builtin_bit_cast(Ints<W>, v) : before;
}

/// Whether the CPU permutes and packs lanes of W numbers by an instruction or two.
template <int W> constexpr bool can_pack()
{
#if defined(__AVX512F__)
    if (W == 16) return true;
#endif
#if defined(__AVX2__)
    if (W == 8) return true;
#endif
    return false;
}

/// The lanes `which` (0 to W - 1) of the W floats at `row`.
template <int W> inline Floats<W> chosen(const void* row, Ints<W> which)
{
    if constexpr (can_pack<W>()) return (Floats<W>)permuted(load<Ints<W>>(row), which);
    Floats<W> v;
    WRT_SCALAR
    for (int i = 0; i < W; ++i) v[i] = ((const float*)row)[which[i]];
    return v;
}

/// The lanes of v that a mask selects come first, in order, where `can_pack`; what is in the others is not said.
template <class V> inline V packed(V v, unsigned mask)
{
    constexpr int W = sizeof(V) / sizeof(int);
    if constexpr (can_pack<W>()) return __builtin_bit_cast(V, compressed(__builtin_bit_cast(Ints<W>, v), mask));
    return v;
}

template <int W, int... I> inline Ints<W> numbered(Numbers<int, I...>) { return Ints<W> {I...}; }

/// 0 .. W - 1, and the bit of each lane.
template <int W> inline Ints<W> lane_numbers() { return numbered<W>(Lanes<W>()); }
template <int W> inline Ints<W> lane_bits() { return Ints<W>(1) << lane_numbers<W>(); }

/// a b + c, rounded once where the CPU can.
template <class V> inline V sum_of_product(V a, V b, V c)
{
#if defined(__FMA__) || defined(__ARM_FEATURE_FMA)
    return __builtin_elementwise_fma(a, b, c);
#else
    return a * b + c;
#endif
}
#endif

}  // namespace
}  // namespace wrt
