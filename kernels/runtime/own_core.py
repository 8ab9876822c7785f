"""Helper threads that stay on their core while they sleep, for virtual machines.

**Problem.** Where virtual cores have been idle for some milliseconds, Linux was seen to put a thread that wakes on the core of
the thread that woke it, while others are idle. Both then share that core for longer than most jobs take: a query after a pause,
as in an interactive program, takes as long as with one thread.

**Idea.** A helper that goes to sleep restricts itself to the core on which it is, so it wakes there. Once awake it may run
wherever it could before. If its cores are not those it has chosen, somebody else has restricted it, and that remains. A helper
whose core is taken by another thread starts late; its job then goes on without it. So this is not for cores of the machine
itself, among which the system chooses well.

Figures: notebooks/records/2026-11-23-sleeping-helpers.md.
"""

OWN_CORE = """
#if defined(__aarch64__)
    enum { SYS_SET_CORES = 122, SYS_GET_CORES = 123, SYS_GET_CORE = 168 };
#else
    enum { SYS_SET_CORES = 203, SYS_GET_CORES = 204, SYS_GET_CORE = 309 };
#endif
    enum { CORE_WORDS = 32 };
    struct Cores { unsigned long long words[CORE_WORDS]; };  // a bit each; the system refuses if it has more
    auto get_cores = [&](Cores& cores) {
        return wrt_syscall(SYS_GET_CORES, nullptr, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) > 0;
    };
    auto set_cores = [&](const Cores& cores) {
        return wrt_syscall(SYS_SET_CORES, nullptr, sizeof(Cores), (long)&cores, nullptr, nullptr, 0) == 0;
    };
    // Restricts this thread to the core on which it is, `own`; false if it still may run on `all`. Both are zero before.
    auto stay = [&](Cores& all, Cores& own) {
        unsigned core = 0;
        if (!get_cores(all) || wrt_syscall(SYS_GET_CORE, &core, 0, 0, nullptr, nullptr, 0) != 0) return false;
        if (core >= 64 * CORE_WORDS) return false;
        own.words[core / 64] = all.words[core / 64] & 1ull << core % 64;
        return own.words[core / 64] != 0 && set_cores(own);
    };
    // Ends that, unless somebody else has restricted the thread since.
    auto stay_no_longer = [&](const Cores& all, const Cores& own) {
        Cores found = {};
        if (!get_cores(found)) return;
        for (int i = 0; i < CORE_WORDS; ++i) if (found.words[i] != own.words[i]) return;
        set_cores(all);
    };
"""
"""C++ for the head of a native function, after `wrt_syscall` of `wrt.kernels.runtime.board`: `Cores`, `stay` and
`stay_no_longer`."""
