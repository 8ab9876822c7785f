"""The native half of the thread pool: helper threads that stay in compiled code and take chunks of any CPU kernel.

Warp's entry point of a CPU kernel is a C function of two pointers, the launch bounds and the packed arguments. Native code can
therefore run any kernel for any range of items, without Python: it copies both, writes the first item and the number of items,
and calls the function. Two kernels do this, `serve` on each helper thread and `lead` on the calling thread (the leader). They
communicate through the *board*, an array of 64-bit words (schedules: see `wrt.kernels.runtime.schedules`):

    words               contents
    MASK                bit s is set while slot s has a job
    EPOCH               futex on which helpers sleep; changes when a job needs helpers
    SLEEPING            number of sleeping helpers
    SPINNING            number of spinning helpers
    CLOSED              1: helpers return
    MAX_SPINNING        greatest number of helpers that spin at a time
    SPIN_NS             nanoseconds for which a helper spins before it sleeps
    STAYS               1: a sleeping helper stays on its core
    slot s, from FIRST_SLOT + s * SLOT_WORDS on
      GENERATION        odd while the job accepts helpers; each change ends or begins a job
      ACTIVE            number of helpers that work on the job
      NEXT              first item that no thread has claimed ("guided", "fixed", "locked")
      LOCK, JOINED, LEADER_QUEUE, PHASE, CURRENT, STOPPED
      job               JOB_WORDS words, copied from the caller's `Job`
    SLEEPERS            of helpers that stay on their core (`wrt.kernels.runtime.own_core`)

**A job.** The leader copies the job into its slot, makes GENERATION odd, sets its bit in MASK, wakes helpers if any sleep, and
claims chunks like a helper. When no items are left it makes GENERATION even and waits until ACTIVE is 0. A helper increments
ACTIVE and then reads GENERATION again, so either the leader sees the helper or the helper sees the end (both operations are
sequentially consistent). A helper that is not scheduled by the system delays a job only if it holds a chunk.

**Programs.** A job may name a following job, a number in memory that gives its number of items, and a number that decides
whether to continue. A loop over the levels of a tree thus runs without Python. The end of a job is the barrier between the two.

**Interrupts.** `lead` returns to Python after at most `TURN_NS`, or after its current chunk, so that Python can handle signals.
It is called again until PHASE is IDLE. To abandon a job, the caller calls `stop`, and `lead` until all helpers have left.

**Waiting.** A helper without work spins for SPIN_NS, if at most MAX_SPINNING helpers do, and then sleeps on a futex. It
increments SLEEPING before it looks for jobs a last time; a leader sets MASK before it reads SLEEPING. One of the two therefore
sees the other. A leader wakes `WAKE` helpers, and each of them as many while chunks are left, which shares the system calls.

**Limits.** Needs Linux (futex).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.runtime.own_core import OWN_CORE, SLEEPER_WORDS, SLEEPERS_MOST

exact_module(__name__)

MASK, EPOCH, SLEEPING, SPINNING, CLOSED, MAX_SPINNING, SPIN_NS, STAYS = 0, 16, 32, 48, 64, 65, 66, 67
FIRST_SLOT, SLOT_WORDS, SLOTS = 128, 80, 64
GENERATION, ACTIVE, NEXT, LOCK, JOINED, LEADER_QUEUE, PHASE, CURRENT, STOPPED, JOB = 0, 16, 32, 33, 34, 48, 49, 50, 51, 52
JOB_WORDS = 16
"""Size of a `Job` in 64-bit words."""

SLEEPERS = FIRST_SLOT + SLOTS * SLOT_WORDS
BOARD_WORDS = SLEEPERS + SLEEPERS_MOST * SLEEPER_WORDS + 1

IDLE, RUNNING, ENDING, BETWEEN = 0, 1, 2, 3
"""Values of PHASE in a slot; only the leader of the slot uses it."""

MAX_ARGUMENT_BYTES = 8192
"""Greatest size of packed arguments; they are copied to the stack of each thread, and no kernel here has more."""

TURN_NS = 20_000_000
"""Nanoseconds after which a leader returns to Python, which then handles signals."""

WAKE = 2
"""Number of sleeping helpers that a leader wakes, and that each woken helper wakes."""

NATIVE = f"""
    typedef long long word;
    typedef void (*entry_t)(void*, void*);
    int wrt_clock(int, long*) __asm__("clock_gettime");
    int wrt_yield(void) __asm__("sched_yield");
    long wrt_syscall(long, void*, long, long, void*, void*, long) __asm__("syscall");
    enum {{ MASK = {MASK}, EPOCH = {EPOCH}, SLEEPING = {SLEEPING}, SPINNING = {SPINNING}, CLOSED = {CLOSED}, STAYS = {STAYS},
           MAX_SPINNING = {MAX_SPINNING}, SPIN_NS = {SPIN_NS}, FIRST_SLOT = {FIRST_SLOT}, SLOT_WORDS = {SLOT_WORDS},
           SLEEPERS = {SLEEPERS}, GENERATION = {GENERATION}, ACTIVE = {ACTIVE}, NEXT = {NEXT}, LOCK = {LOCK}, JOINED = {JOINED},
           LEADER_QUEUE = {LEADER_QUEUE}, PHASE = {PHASE}, CURRENT = {CURRENT}, STOPPED = {STOPPED}, JOB = {JOB} }};
    enum {{ ENTRY = JOB, BOUNDS, ARGUMENTS, BYTES, COUNT, LARGEST, SMALLEST, DIVISOR, HELPERS, SCHEDULE, QUEUES, QUEUE_COUNT,
           COUNT_AT, FOLLOWING, WHILE_AT }};
    enum {{ GUIDED, FIXED, LOCKED, ROUND_ROBIN, STEALING }};
    enum {{ QUEUE_NEXT, QUEUE_END, QUEUE_OWNER, QUEUE_WORDS = 16 }};
#if defined(__aarch64__)
    enum {{ SYS_FUTEX = 98 }};
#else
    enum {{ SYS_FUTEX = 202 }};
#endif
    enum {{ FUTEX_WAIT_PRIVATE = 128, FUTEX_WAKE_PRIVATE = 129 }};

    word* const b = board.data;
    auto get = [&](const word* at) {{ return __atomic_load_n(at, __ATOMIC_SEQ_CST); }};
    auto set = [&](word* at, word value) {{ __atomic_store_n(at, value, __ATOMIC_SEQ_CST); }};
    auto add = [&](word* at, word value) {{ return __atomic_fetch_add(at, value, __ATOMIC_SEQ_CST); }};
    auto swap_if = [&](word* at, word expected, word value) {{
        return __atomic_compare_exchange_n(at, &expected, value, false, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST);
    }};
    auto relax = [&]() {{
#if defined(__x86_64__)
        __builtin_ia32_pause();
#elif defined(__aarch64__)
        __builtin_arm_yield();  // Warp's Clang has no assembler: instructions are builtins
#endif
    }};
    auto now = [&]() {{
        long t[2];
        wrt_clock(1, t);  // CLOCK_MONOTONIC: seconds, nanoseconds
        return (word)t[0] * 1000000000 + (word)t[1];
    }};
    {OWN_CORE}
    auto wake = [&](word most) {{
        if (most <= 0 || get(b + SLEEPING) == 0) return;
        if (get(b + STAYS)) make_way();
        __atomic_fetch_add((int*)(b + EPOCH), 1, __ATOMIC_SEQ_CST);
        wrt_syscall(SYS_FUTEX, b + EPOCH, FUTEX_WAKE_PRIVATE, most, nullptr, nullptr, 0);
    }};

    // The next chunk of a job, "guided" and "locked": a share of what is left.
    auto shrinking = [&](const word* s, word left) {{
        word n = left / s[DIVISOR];
        n = n > s[LARGEST] ? s[LARGEST] : n;
        n = n < s[SMALLEST] ? s[SMALLEST] : n;
        return n < left ? n : left;
    }};
    // Takes a chunk of the queue q, whose items lie `stride` chunks apart; false if it is empty.
    auto take_from = [&](const word* s, word q, word* first, word* n) {{
        word* const queue = (word*)s[QUEUES] + q * QUEUE_WORDS;
        const bool strided = s[SCHEDULE] == ROUND_ROBIN;
        const word step = strided ? s[LARGEST] * s[QUEUE_COUNT] : s[LARGEST], end = queue[QUEUE_END];
        if (get(queue + QUEUE_NEXT) >= end) return false;
        *first = add(queue + QUEUE_NEXT, step);
        if (*first >= end) return false;
        *n = end - *first < s[LARGEST] ? end - *first : s[LARGEST];
        return true;
    }};
    // Whether the queues of all threads are empty: what others own ("round_robin") they must finish before the job ends.
    auto all_empty = [&](const word* s) {{
        for (word q = 0; q < s[QUEUE_COUNT]; ++q) {{
            const word* queue = (const word*)s[QUEUES] + q * QUEUE_WORDS;
            if (get(queue + QUEUE_NEXT) < queue[QUEUE_END]) return false;
        }}
        return true;
    }};
    // A queue that has no owner yet; -1 if all have.
    auto own_queue = [&](const word* s) {{
        for (word q = 0; q < s[QUEUE_COUNT]; ++q)
            if (swap_if((word*)s[QUEUES] + q * QUEUE_WORDS + QUEUE_OWNER, 0, 1)) return q;
        return (word)-1;
    }};
    // Takes the next chunk; `mine` is the caller's queue, -1 before it has one. False if nothing is left for it.
    auto claim = [&](word* s, word* mine, word* first, word* n) {{
        const word count = s[COUNT];
        if (s[SCHEDULE] == GUIDED) {{
            *first = get(s + NEXT);
            for (;;) {{
                if (*first >= count) return false;
                *n = shrinking(s, count - *first);
                if (swap_if(s + NEXT, *first, *first + *n)) return true;
                *first = get(s + NEXT);
            }}
        }}
        if (s[SCHEDULE] == FIXED) {{
            if (get(s + NEXT) >= count) return false;
            *first = add(s + NEXT, s[LARGEST]);
            *n = count - *first < s[LARGEST] ? count - *first : s[LARGEST];
            return *first < count;
        }}
        if (s[SCHEDULE] == LOCKED) {{
            for (int tries = 0; !swap_if(s + LOCK, 0, 1);) if (++tries % 64) relax(); else wrt_yield();
            *first = s[NEXT];
            *n = *first < count ? shrinking(s, count - *first) : 0;
            s[NEXT] = *first + *n;
            set(s + LOCK, 0);
            return *n > 0;
        }}
        for (;;) {{
            if (*mine < 0 && (*mine = own_queue(s)) < 0) break;
            if (take_from(s, *mine, first, n)) return true;
            *mine = -1;
        }}
        if (s[SCHEDULE] == STEALING)
            for (word q = 0; q < s[QUEUE_COUNT]; ++q) if (take_from(s, q, first, n)) return true;
        return false;
    }};
    // Runs chunks until none is left, the generation has changed, or the time is up; false in the last case.
    auto drain = [&](word* s, word generation, word* mine, word until) {{
        alignas(64) unsigned char arguments[{MAX_ARGUMENT_BYTES}];
        __builtin_memcpy(arguments, (const void*)s[ARGUMENTS], (size_t)s[BYTES]);
        wp::launch_bounds_t<1> bounds = *(const wp::launch_bounds_t<1>*)s[BOUNDS];
        const entry_t entry = (entry_t)s[ENTRY];
        word first, n;
        while (get(s + GENERATION) == generation && claim(s, mine, &first, &n)) {{
            bounds.shape[0] = (uint32_t)n;
            bounds.size = (size_t)n;
            *(int*)arguments = (int)first;
            entry(&bounds, arguments);
            if (until > 0 && now() > until) return false;
        }}
        return true;
    }};
    // Whether a helper could be of use to the job in slot s.
    auto wants_help = [&](const word* s, word generation) {{
        if ((generation & 1) == 0 || get(s + ACTIVE) >= s[HELPERS]) return false;
        return s[SCHEDULE] >= ROUND_ROBIN ? get(s + JOINED) < s[HELPERS] : get(s + NEXT) < s[COUNT];
    }};
"""
"""C++ shared by all functions: names of the words, atomics, futex calls, claiming of chunks."""

SERVE = (
    NATIVE
    + f"""
    auto any_wants_help = [&]() {{
        for (unsigned long long mask = get(b + MASK); mask; mask &= mask - 1) {{
            const word* s = b + FIRST_SLOT + (word)__builtin_ctzll(mask) * SLOT_WORDS;
            if (wants_help(s, get(s + GENERATION))) return true;
        }}
        return false;
    }};
    auto help = [&](word* s) {{
        const word generation = get(s + GENERATION);
        if (!wants_help(s, generation)) return false;
        bool helped = false;
        const word before = add(s + ACTIVE, 1);
        if (get(s + GENERATION) == generation && before < s[HELPERS]) {{
            word mine = -1;
            add(s + JOINED, 1);
            helped = true;
            drain(s, generation, &mine, 0);
        }}
        add(s + ACTIVE, -1);
        return helped;
    }};
    auto sleep = [&]() {{
        if (get(b + STAYS)) stay(helper);
        const int epoch = __atomic_load_n((int*)(b + EPOCH), __ATOMIC_SEQ_CST);
        add(b + SLEEPING, 1);
        if (get(b + CLOSED) == 0 && !any_wants_help())
            wrt_syscall(SYS_FUTEX, b + EPOCH, FUTEX_WAIT_PRIVATE, epoch, nullptr, nullptr, 0);
        add(b + SLEEPING, -1);
        stay_no_longer(helper);
    }};
    // Waits awake until there is work, for a while; false if it is time to sleep.
    auto spin = [&]() {{
        if (add(b + SPINNING, 1) >= b[MAX_SPINNING]) {{ add(b + SPINNING, -1); return false; }}
        const word until = now() + b[SPIN_NS];
        bool found = false;
        do {{
            for (int i = 0; i < 64 && !found; ++i) {{ relax(); found = get(b + MASK) != 0; }}
            found = found && (any_wants_help() || get(b + CLOSED) != 0);
        }} while (!found && get(b + CLOSED) == 0 && now() < until);
        add(b + SPINNING, -1);
        return found;
    }};
    while (get(b + CLOSED) == 0) {{
        bool helped = false;
        for (unsigned long long mask = get(b + MASK); mask; mask &= mask - 1)
            helped |= help(b + FIRST_SLOT + (word)__builtin_ctzll(mask) * SLOT_WORDS);
        if (helped || spin()) continue;
        sleep();
        if (any_wants_help()) wake({WAKE});
    }}
    return 0;
"""
)
"""C++ of the loop of a helper."""

LEAD = (
    NATIVE
    + f"""
    word* const s = b + FIRST_SLOT + slot * SLOT_WORDS;
    const word until = now() + {TURN_NS};
    auto begin = [&]() {{
        __builtin_memcpy(s + JOB, (const void*)s[CURRENT], {JOB_WORDS} * sizeof(word));
        if (s[COUNT_AT]) s[COUNT] = *(const int*)s[COUNT_AT];
        s[NEXT] = s[LOCK] = s[JOINED] = 0;
        s[LEADER_QUEUE] = -1;
        const word share = s[QUEUE_COUNT] > 0 ? (s[COUNT] + s[QUEUE_COUNT] - 1) / s[QUEUE_COUNT] : 0;
        for (word q = 0; q < s[QUEUE_COUNT]; ++q) {{
            word* const queue = (word*)s[QUEUES] + q * QUEUE_WORDS;
            const word end = (q + 1) * share < s[COUNT] ? (q + 1) * share : s[COUNT];
            queue[QUEUE_NEXT] = s[SCHEDULE] == ROUND_ROBIN ? q * s[LARGEST] : q * share;
            queue[QUEUE_END] = s[SCHEDULE] == ROUND_ROBIN ? s[COUNT] : end;
            queue[QUEUE_OWNER] = 0;
        }}
        s[PHASE] = {RUNNING};
        set(s + GENERATION, s[GENERATION] + 1);
        const word chunks = (s[COUNT] + s[SMALLEST] - 1) / s[SMALLEST];
        if (s[HELPERS] > 0 && chunks > 1) {{
            __atomic_fetch_or(b + MASK, 1ll << slot, __ATOMIC_SEQ_CST);
            const word wanted = (s[HELPERS] < chunks - 1 ? s[HELPERS] : chunks - 1) - get(b + SPINNING);
            wake(wanted < {WAKE} ? wanted : {WAKE});
        }}
    }};
    // The job to go on with: 0 at the end.
    auto following = [&]() {{
        const bool ends = s[STOPPED] || (s[WHILE_AT] && *(const int*)s[WHILE_AT] == 0);
        return ends ? (word)0 : s[FOLLOWING];
    }};
    if (s[PHASE] == {IDLE}) {{
        s[CURRENT] = job;
        s[STOPPED] = 0;
        s[PHASE] = {BETWEEN};
    }}
    for (;;) {{
        if (s[PHASE] == {BETWEEN}) {{
            if (s[STOPPED]) {{ s[PHASE] = {IDLE}; return 0; }}
            begin();
        }}
        if (s[PHASE] == {RUNNING}) {{
            if ((s[GENERATION] & 1) && !drain(s, s[GENERATION], s + LEADER_QUEUE, until)) return 0;
            while ((s[GENERATION] & 1) && !all_empty(s)) {{ wrt_yield(); if (now() > until) return 0; }}
            __atomic_fetch_and(b + MASK, ~(1ll << slot), __ATOMIC_SEQ_CST);
            if (s[GENERATION] & 1) set(s + GENERATION, s[GENERATION] + 1);
            s[PHASE] = {ENDING};
        }}
        for (int tries = 0; get(s + ACTIVE) != 0;) {{
            if (++tries % 256) {{ relax(); continue; }}
            wrt_yield();
            if (now() > until) return 0;
        }}
        s[CURRENT] = following();
        if (s[CURRENT] == 0) {{ s[PHASE] = {IDLE}; return 0; }}
        s[PHASE] = {BETWEEN};
        if (now() > until) return 0;
    }}
"""
)
"""C++ of a turn of a leader."""


def on_cpu(code: str) -> str:
    """Code that is compiled for CPUs only; on CUDA, which does not use the pool, it is empty."""
    return f"#if !defined(__CUDA_ARCH__)\n{code}\n#endif\n    return 0;\n"


@wp.func_native(on_cpu(SERVE))
def serve_native(board: wp.array(dtype=wp.int64), helper: wp.int64) -> int:
    """The loop of the helper with a number; returns when the board is closed."""
    ...


@wp.func_native(on_cpu(LEAD))
def lead_native(board: wp.array(dtype=wp.int64), slot: wp.int64, job: wp.int64) -> int:
    """Begins the job at address `job` in a slot, or continues the current one and those that follow it."""
    ...


@wp.func_native(
    on_cpu(
        NATIVE
        + """
    word* const s = b + FIRST_SLOT + slot * SLOT_WORDS;
    s[STOPPED] = 1;
    if (s[PHASE] != 0 && (s[GENERATION] & 1)) set(s + GENERATION, s[GENERATION] + 1);
"""
    )
)
def stop_native(board: wp.array(dtype=wp.int64), slot: wp.int64) -> int:
    """Stops the job of a slot: no thread takes another chunk."""
    ...


@wp.func_native(
    on_cpu(
        NATIVE
        + """
    set(b + CLOSED, 1);
    add((word*)(b + EPOCH), 1);
    wrt_syscall(SYS_FUTEX, b + EPOCH, FUTEX_WAKE_PRIVATE, 1 << 30, nullptr, nullptr, 0);
"""
    )
)
def close_native(board: wp.array(dtype=wp.int64)) -> int:
    """Makes all helpers return."""
    ...


@wp.kernel
def serve(board: wp.array(dtype=wp.int64), helper: wp.int64):
    """Runs a helper thread. One item."""
    serve_native(board, helper)


@wp.kernel
def lead(board: wp.array(dtype=wp.int64), slot: wp.int64, job: wp.int64):
    """Runs one turn of the leader of a slot's job. One item. job: address of a `Job` (`wrt.kernels.runtime.pool`)."""
    lead_native(board, slot, job)


@wp.kernel
def stop(board: wp.array(dtype=wp.int64), slot: wp.int64):
    """Stops the job of a slot. One item."""
    stop_native(board, slot)


@wp.kernel
def close(board: wp.array(dtype=wp.int64)):
    """Closes the board. One item."""
    close_native(board)
