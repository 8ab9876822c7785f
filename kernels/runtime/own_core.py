"""Helper threads that stay on their core while they sleep, for virtual machines.

**Problem.** Where virtual cores have been idle for some milliseconds, Linux was seen to put a thread that wakes on the core of
the thread that woke it, while others are idle. Both then share that core for longer than most jobs take: a query after a pause,
as in an interactive program, takes as long as with one thread.

**Idea.** A helper that goes to sleep restricts itself to the core on which it is, so it wakes there. No two sleepers have the
same one. Once awake a helper may run wherever it could before. If its cores are not those it has chosen, somebody else has
restricted it, and that remains.

**Making way.** A thread that wakes helpers may itself have come to a sleeper's core, where the sleeper would have to wait for
it. So it first moves that sleeper to its other cores. Meanwhile the sleeper's state is locked, so if it wakes it sees
whether it was moved.

**Limits.** For virtual machines of up to `MOST_CORES` cores: on 16 it gained nothing, and it is not for cores of the machine
itself, among which the system chooses well. A helper whose core is taken by another program starts late; its job then goes on
without it.

Figures: notebooks/records/2026-11-23-sleeping-helpers.md and 2026-11-24-making-way.md.
"""

MOST_CORES = 4
"""Most cores with which helpers stay. Measured with 2, where it helps, and with 16, where it does not."""

SLEEPER_WORDS, SLEEPERS_MOST = 2, 64
"""64-bit words of a sleeper on the board, and the greatest number of helpers that stay. A word with all their cores follows."""

OWN_CORE = f"""
    enum {{ SLEEPER_WORDS = {SLEEPER_WORDS}, SLEEPERS_MOST = {SLEEPERS_MOST} }};
#if defined(__aarch64__)
    enum {{ SYS_SET_CORES = 122, SYS_GET_CORES = 123, SYS_GET_CORE = 168, SYS_GET_THREAD = 178 }};
#else
    enum {{ SYS_SET_CORES = 203, SYS_GET_CORES = 204, SYS_GET_CORE = 309, SYS_GET_THREAD = 186 }};
#endif
    // A sleeper's first word is its state, 0 if it does not stay: its thread, its core, and one of the last three of these.
    // Its second word, ALL_CORES, has a bit for each core on which it may run.
    enum {{ CORE_SHIFT = 2, THREAD_SHIFT = 8, STAYING = 1, MOVED = 2, BEING_MOVED = 3, ALL_CORES = 1 }};
    enum {{ CORE_WORDS = 32 }};
    struct Cores {{ unsigned long long words[CORE_WORDS]; }};  // a bit each; the system refuses if it has more
    auto sleeper = [&](word index) {{ return b + SLEEPERS + index * SLEEPER_WORDS; }};
    auto core_of = [&](word state) {{ return state >> CORE_SHIFT & 63; }};
    word* const taken = b + SLEEPERS + SLEEPERS_MOST * SLEEPER_WORDS;  // a bit for each core on which a helper stays
    auto give_back = [&](word core) {{ __atomic_fetch_and(taken, ~(1ll << core), __ATOMIC_SEQ_CST); }};
    // The core of the calling thread; -1 if that is not one of the first 64.
    auto this_core = [&]() {{
        unsigned core = 0;
        const bool known = wrt_syscall(SYS_GET_CORE, &core, 0, 0, nullptr, nullptr, 0) == 0 && core < 64;
        return known ? (word)core : (word)-1;
    }};
    // The cores of a thread, 0 for the calling one; 0 if some are not among the first 64.
    auto get_cores = [&](word thread) {{
        Cores cores = {{}};
        if (wrt_syscall(SYS_GET_CORES, (void*)thread, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) <= 0) return (word)0;
        for (int i = 1; i < CORE_WORDS; ++i) if (cores.words[i]) return (word)0;
        return (word)cores.words[0];
    }};
    // Restricts a thread to some of the first 64 cores.
    auto set_cores = [&](word thread, word those) {{
        Cores cores = {{}};
        cores.words[0] = (unsigned long long)those;
        return wrt_syscall(SYS_SET_CORES, (void*)thread, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) == 0;
    }};
    // Before a helper sleeps: restricts it to its core, unless another sleeper has the same one.
    auto stay = [&](word index) {{
        const word all = get_cores(0), core = this_core();
        if (index >= SLEEPERS_MOST || core < 0 || !(all >> core & 1)) return;
        if (__atomic_fetch_or(taken, 1ll << core, __ATOMIC_SEQ_CST) >> core & 1) return;
        if (!set_cores(0, 1ll << core)) {{ give_back(core); return; }}
        const word thread = wrt_syscall(SYS_GET_THREAD, nullptr, 0, 0, nullptr, nullptr, 0);
        set(sleeper(index) + ALL_CORES, all);
        set(sleeper(index), thread << THREAD_SHIFT | core << CORE_SHIFT | STAYING);
    }};
    // After it: lifts the restriction, unless somebody else has set another.
    auto stay_no_longer = [&](word index) {{
        if (index >= SLEEPERS_MOST || get(sleeper(index)) == 0) return;
        word state = get(sleeper(index));
        while ((state & BEING_MOVED) == BEING_MOVED || !swap_if(sleeper(index), state, 0)) {{
            wrt_yield();
            state = get(sleeper(index));
        }}
        give_back(core_of(state));
        if ((state & BEING_MOVED) == MOVED || get_cores(0) == 1ll << core_of(state))
            set_cores(0, get(sleeper(index) + ALL_CORES));
    }};
    // Moves sleepers away from the core of the calling thread.
    auto make_way = [&]() {{
        const word core = this_core();
        for (word i = 0; i < SLEEPERS_MOST; ++i) {{
            const word state = get(sleeper(i));
            if ((state & BEING_MOVED) != STAYING || core_of(state) != core) continue;
            const word others = get(sleeper(i) + ALL_CORES) & ~(1ll << core);
            if (others == 0 || !swap_if(sleeper(i), state, state | BEING_MOVED)) continue;
            const word thread = state >> THREAD_SHIFT;
            const bool moved = get_cores(thread) == 1ll << core && set_cores(thread, others);
            set(sleeper(i), moved ? (state & ~(word)BEING_MOVED) | MOVED : state);
        }}
    }};
"""
"""C++ for the head of a native function, after the atomics of `wrt.kernels.runtime.board`: `stay` and `stay_no_longer` for
sleepers, `make_way` for those who wake them."""
