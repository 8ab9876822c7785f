// Helper threads that stay on their core while they sleep: `wrt.kernels.runtime.core_pinning`. CPUs only.
#pragma once
#include "calls.h"

#if !defined(__CUDA_ARCH__)

extern "C" int wrt_yield(void) __asm__("sched_yield");
extern "C" long wrt_syscall(long, void*, long, long, void*, void*, long) __asm__("syscall");

namespace wrt::pool {
namespace {

inline word get(const word& at) { return __atomic_load_n(&at, __ATOMIC_SEQ_CST); }
inline void set(word& at, word value) { __atomic_store_n(&at, value, __ATOMIC_SEQ_CST); }
inline word add(word& at, word value) { return __atomic_fetch_add(&at, value, __ATOMIC_SEQ_CST); }
inline bool swap_if(word& at, word expected, word value)
{
    return __atomic_compare_exchange_n(&at, &expected, value, false, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST);
}

#if defined(__aarch64__)
enum { SYS_SET_CORES = 122, SYS_GET_CORES = 123, SYS_GET_CORE = 168, SYS_GET_THREAD = 178 };
#else
enum { SYS_SET_CORES = 203, SYS_GET_CORES = 204, SYS_GET_CORE = 309, SYS_GET_THREAD = 186 };
#endif

/// A helper that may stay on its core. state: 0 if it does not; else its thread, its core, and what becomes of it. all_cores: a
/// bit for each core on which it may run.
struct Sleeper {
    word state, all_cores;
};

enum : word { STAYING = 1, MOVED = 2, BEING_MOVED = 3 };
constexpr int CORE_SHIFT = 2, THREAD_SHIFT = 8;

constexpr int MAX_SLEEPERS = 64;

/// All sleepers. taken: a bit for each core on which one stays.
struct Sleepers {
    Sleeper of[MAX_SLEEPERS];
    word taken;
};

inline word core_of(word state) { return state >> CORE_SHIFT & 63; }
inline void give_back(Sleepers& all, word core) { __atomic_fetch_and(&all.taken, ~(1ll << core), __ATOMIC_SEQ_CST); }

/// The core of the calling thread; -1 if that is not one of the first 64.
inline word this_core()
{
    unsigned core = 0;
    const bool known = wrt_syscall(SYS_GET_CORE, &core, 0, 0, nullptr, nullptr, 0) == 0 && core < 64;
    return known ? (word)core : (word)-1;
}

/// A bit for each core; the system refuses if it has more.
struct Cores {
    static constexpr int WORDS = 32;
    unsigned long long words[WORDS];
};

/// The cores of a thread, 0 for the calling one; 0 if some are not among the first 64.
inline word get_cores(word thread)
{
    Cores cores = {};
    if (wrt_syscall(SYS_GET_CORES, (void*)thread, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) <= 0) return 0;
    for (int i = 1; i < Cores::WORDS; ++i)
        if (cores.words[i]) return 0;
    return (word)cores.words[0];
}

/// Restricts a thread to some of the first 64 cores.
inline bool set_cores(word thread, word those)
{
    Cores cores = {};
    cores.words[0] = (unsigned long long)those;
    return wrt_syscall(SYS_SET_CORES, (void*)thread, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) == 0;
}

/// Before a helper sleeps: restricts it to its core, unless another sleeper has the same one.
inline void pin(Sleepers& all, word index)
{
    const word cores = get_cores(0), core = this_core();
    if (index >= MAX_SLEEPERS || core < 0 || !(cores >> core & 1)) return;
    if (__atomic_fetch_or(&all.taken, 1ll << core, __ATOMIC_SEQ_CST) >> core & 1) return;
    if (!set_cores(0, 1ll << core)) {
        give_back(all, core);
        return;
    }
    const word thread = wrt_syscall(SYS_GET_THREAD, nullptr, 0, 0, nullptr, nullptr, 0);
    set(all.of[index].all_cores, cores);
    set(all.of[index].state, thread << THREAD_SHIFT | core << CORE_SHIFT | STAYING);
}

/// After it: lifts the restriction, unless somebody else has set another.
inline void unpin(Sleepers& all, word index)
{
    if (index >= MAX_SLEEPERS || get(all.of[index].state) == 0) return;
    Sleeper& own = all.of[index];
    word state = get(own.state);
    while ((state & BEING_MOVED) == BEING_MOVED || !swap_if(own.state, state, 0)) {
        wrt_yield();
        state = get(own.state);
    }
    give_back(all, core_of(state));
    if ((state & BEING_MOVED) == MOVED || get_cores(0) == 1ll << core_of(state)) set_cores(0, get(own.all_cores));
}

/// Moves sleepers away from the core of the calling thread.
inline void move_sleepers_away(Sleepers& all)
{
    const word core = this_core();
    for (Sleeper& other : all.of) {
        const word state = get(other.state);
        if ((state & BEING_MOVED) != STAYING || core_of(state) != core) continue;
        const word others = get(other.all_cores) & ~(1ll << core);
        if (others == 0 || !swap_if(other.state, state, state | BEING_MOVED)) continue;
        const word thread = state >> THREAD_SHIFT;
        const bool moved = get_cores(thread) == 1ll << core && set_cores(thread, others);
        set(other.state, moved ? (state & ~(word)BEING_MOVED) | MOVED : state);
    }
}

}  // namespace
}  // namespace wrt::pool
#endif
