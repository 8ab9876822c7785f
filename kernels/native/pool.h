// The native half of the thread pool: `wrt.kernels.runtime.job_queue` has the protocol. CPUs only.
#pragma once
#include "core_pinning.h"

#if !defined(__CUDA_ARCH__)

namespace wrt::pool {
namespace {

/// Nanoseconds after which a caller returns to Python, which then handles signals.
constexpr word TURN_NS = 20000000;

/// Number of sleeping helpers that a caller wakes, and that each woken helper wakes.
constexpr word WAKE = 2;

#if defined(__aarch64__)
enum { SYS_FUTEX = 98 };
#else
enum { SYS_FUTEX = 202 };
#endif
enum { FUTEX_WAIT_PRIVATE = 128, FUTEX_WAKE_PRIVATE = 129, CLOCK_MONOTONIC = 1 };

/// How the items of a job are divided among threads: `wrt.kernels.runtime.schedules`. The last two have queues.
enum class Schedule : word { GUIDED, FIXED, LOCKED, ROUND_ROBIN, STEALING };

/// What the caller of a slot does.
enum class Phase : word { IDLE, RUNNING, ENDING, BETWEEN };

/// Chunks of a thread, in two cache lines.
struct ChunkQueue {
    word next, end, owner, apart[13];
};

/// A launch: `wrt.kernels.runtime.job_queue.Job`.
struct Job {
    Entry entry;
    const void *bounds, *arguments;
    word argument_bytes, count, max_chunk, min_chunk, divisor, helpers;
    Schedule schedule;
    ChunkQueue* queues;
    word queue_count;
    const int* count_at;
    const Job* following;
    const int* while_at;
    word unused;
};

/// A job in the queue. generation: odd while it accepts helpers, each change ends or begins a job; active: helpers that work on
/// it; next: first item that no thread has claimed. What other threads write is apart from what they read.
struct JobSlot {
    word generation, apart_1[15];
    word active, apart_2[15];
    word next, lock, joined, apart_3[13];
    word caller_queue;
    Phase phase;
    const Job* current;
    word stopped;
    Job job;
    word apart_4[12];

    bool is_open(word known) const { return get(generation) == known; }
    bool is_strided() const { return job.schedule == Schedule::ROUND_ROBIN; }
};

/// Memory that all threads of a pool share. mask: bit s is set while slot s has a job; epoch: the futex on which helpers sleep;
/// sleeping, spinning: numbers of helpers; stays: whether a sleeping helper stays on its core.
struct JobQueue {
    static constexpr int SLOTS = 64;

    word mask, apart_1[15];
    word epoch, apart_2[15];
    word sleeping, apart_3[15];
    word spinning, apart_4[15];
    word closed, max_spinning, spin_ns, stays, apart_5[60];
    JobSlot slots[SLOTS];
    Sleepers sleepers;
};

inline void relax()
{
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __builtin_arm_yield();  // Warp's Clang has no assembler: instructions are builtins
#endif
}

inline word now() { return clock_ns(CLOCK_MONOTONIC); }

inline void futex(JobQueue& job_queue, int operation, long value)
{
    wrt_syscall(SYS_FUTEX, &job_queue.epoch, operation, value, nullptr, nullptr, 0);
}

inline void wake(JobQueue& job_queue, word max_woken)
{
    if (max_woken <= 0 || get(job_queue.sleeping) == 0) return;
    if (get(job_queue.stays)) move_sleepers_away(job_queue.sleepers);
    __atomic_fetch_add((int*)&job_queue.epoch, 1, __ATOMIC_SEQ_CST);
    futex(job_queue, FUTEX_WAKE_PRIVATE, max_woken);
}

// -- chunks ---------------------------------------------------------------------------------------------------------------

/// The size of the next chunk, "guided" and "locked": a share of what is left.
inline word shrinking(const Job& job, word left)
{
    word n = left / job.divisor;
    n = n > job.max_chunk ? job.max_chunk : n;
    n = n < job.min_chunk ? job.min_chunk : n;
    return n < left ? n : left;
}

/// Takes a chunk of a queue, whose items lie `step` apart; false if it is empty.
inline bool take_from(const JobSlot& slot, ChunkQueue& queue, word& first, word& n)
{
    const word max_chunk = slot.job.max_chunk, end = queue.end;
    const word step = slot.is_strided() ? max_chunk * slot.job.queue_count : max_chunk;
    if (get(queue.next) >= end) return false;
    first = add(queue.next, step);
    if (first >= end) return false;
    n = end - first < max_chunk ? end - first : max_chunk;
    return true;
}

/// Whether the queues of all threads are empty: what others own ("round_robin") they must finish before the job ends.
inline bool all_empty(const Job& job)
{
    for (word q = 0; q < job.queue_count; ++q)
        if (get(job.queues[q].next) < job.queues[q].end) return false;
    return true;
}

/// A queue that has no owner yet; -1 if all have.
inline word own_queue(const Job& job)
{
    for (word q = 0; q < job.queue_count; ++q)
        if (swap_if(job.queues[q].owner, 0, 1)) return q;
    return -1;
}

inline bool claim_guided(JobSlot& slot, word& first, word& n)
{
    first = get(slot.next);
    for (;;) {
        if (first >= slot.job.count) return false;
        n = shrinking(slot.job, slot.job.count - first);
        if (swap_if(slot.next, first, first + n)) return true;
        first = get(slot.next);
    }
}

inline bool claim_fixed(JobSlot& slot, word& first, word& n)
{
    const word count = slot.job.count, max_chunk = slot.job.max_chunk;
    if (get(slot.next) >= count) return false;
    first = add(slot.next, max_chunk);
    n = count - first < max_chunk ? count - first : max_chunk;
    return first < count;
}

inline bool claim_locked(JobSlot& slot, word& first, word& n)
{
    for (int tries = 0; !swap_if(slot.lock, 0, 1);)
        if (++tries % 64) relax();
        else wrt_yield();
    first = slot.next;
    n = first < slot.job.count ? shrinking(slot.job, slot.job.count - first) : 0;
    slot.next = first + n;
    set(slot.lock, 0);
    return n > 0;
}

inline bool claim_queued(JobSlot& slot, word& mine, word& first, word& n)
{
    const Job& job = slot.job;
    for (;;) {
        if (mine < 0 && (mine = own_queue(job)) < 0) break;
        if (take_from(slot, job.queues[mine], first, n)) return true;
        mine = -1;
    }
    if (job.schedule == Schedule::STEALING)
        for (word q = 0; q < job.queue_count; ++q)
            if (take_from(slot, job.queues[q], first, n)) return true;
    return false;
}

/// Takes the next chunk; `mine` is the caller's queue, -1 before it has one. False if nothing is left for it.
inline bool claim(JobSlot& slot, word& mine, word& first, word& n)
{
    switch (slot.job.schedule) {
    case Schedule::GUIDED:
        return claim_guided(slot, first, n);
    case Schedule::FIXED:
        return claim_fixed(slot, first, n);
    case Schedule::LOCKED:
        return claim_locked(slot, first, n);
    default:
        return claim_queued(slot, mine, first, n);
    }
}

/// Runs chunks until none is left, the generation has changed, or the time is up; false in the last case.
template <class Bounds> inline bool drain(JobSlot& slot, word generation, word& mine, word until)
{
    Arguments arguments;
    arguments.copy(slot.job.arguments, slot.job.argument_bytes);
    Bounds bounds = *(const Bounds*)slot.job.bounds;
    const Entry entry = slot.job.entry;
    word first, n;
    while (slot.is_open(generation) && claim(slot, mine, first, n)) {
        set_items(bounds, n);
        arguments.number_at(0) = (int)first;
        entry(&bounds, arguments.bytes);
        if (until > 0 && now() > until) return false;
    }
    return true;
}

// -- helpers --------------------------------------------------------------------------------------------------------------

/// Whether a helper could be of use to a job.
inline bool wants_help(const JobSlot& slot, word generation)
{
    const Job& job = slot.job;
    if ((generation & 1) == 0 || get(slot.active) >= job.helpers) return false;
    return job.schedule >= Schedule::ROUND_ROBIN ? get(slot.joined) < job.helpers : get(slot.next) < job.count;
}

inline bool any_wants_help(const JobQueue& job_queue)
{
    for (unsigned long long mask = get(job_queue.mask); mask; mask &= mask - 1) {
        const JobSlot& slot = job_queue.slots[__builtin_ctzll(mask)];
        if (wants_help(slot, get(slot.generation))) return true;
    }
    return false;
}

/// Works on a job; false if it needs no help.
template <class Bounds> inline bool help(JobSlot& slot)
{
    const word generation = get(slot.generation);
    if (!wants_help(slot, generation)) return false;
    bool helped = false;
    const word before = add(slot.active, 1);
    if (slot.is_open(generation) && before < slot.job.helpers) {
        word mine = -1;
        add(slot.joined, 1);
        helped = true;
        drain<Bounds>(slot, generation, mine, 0);
    }
    add(slot.active, -1);
    return helped;
}

inline void sleep(JobQueue& job_queue, word helper)
{
    if (get(job_queue.stays)) pin(job_queue.sleepers, helper);
    const int epoch = __atomic_load_n((int*)&job_queue.epoch, __ATOMIC_SEQ_CST);
    add(job_queue.sleeping, 1);
    if (get(job_queue.closed) == 0 && !any_wants_help(job_queue)) futex(job_queue, FUTEX_WAIT_PRIVATE, epoch);
    add(job_queue.sleeping, -1);
    unpin(job_queue.sleepers, helper);
}

/// Waits awake until there is work, for a while; false if it is time to sleep.
inline bool spin(JobQueue& job_queue)
{
    if (add(job_queue.spinning, 1) >= job_queue.max_spinning) {
        add(job_queue.spinning, -1);
        return false;
    }
    const word until = now() + job_queue.spin_ns;
    bool found = false;
    do {
        for (int i = 0; i < 64 && !found; ++i) {
            relax();
            found = get(job_queue.mask) != 0;
        }
        found = found && (any_wants_help(job_queue) || get(job_queue.closed) != 0);
    } while (!found && get(job_queue.closed) == 0 && now() < until);
    add(job_queue.spinning, -1);
    return found;
}

/// The loop of a helper; returns when the job queue is closed.
template <class Bounds> inline void run_as_helper(JobQueue& job_queue, word helper)
{
    while (get(job_queue.closed) == 0) {
        bool helped = false;
        for (unsigned long long mask = get(job_queue.mask); mask; mask &= mask - 1)
            helped |= help<Bounds>(job_queue.slots[__builtin_ctzll(mask)]);
        if (helped || spin(job_queue)) continue;
        sleep(job_queue, helper);
        if (any_wants_help(job_queue)) wake(job_queue, WAKE);
    }
}

// -- callers --------------------------------------------------------------------------------------------------------------

inline void fill_queues(const JobSlot& slot)
{
    const Job& job = slot.job;
    const word share = job.queue_count > 0 ? (job.count + job.queue_count - 1) / job.queue_count : 0;
    for (word q = 0; q < job.queue_count; ++q) {
        ChunkQueue& queue = job.queues[q];
        const word end = (q + 1) * share < job.count ? (q + 1) * share : job.count;
        queue.next = slot.is_strided() ? q * job.max_chunk : q * share;
        queue.end = slot.is_strided() ? job.count : end;
        queue.owner = 0;
    }
}

/// Begins the current job of a slot, and wakes helpers for it.
inline void begin(JobQueue& job_queue, JobSlot& slot)
{
    Job& job = slot.job;
    __builtin_memcpy(&job, slot.current, sizeof(Job));
    if (job.count_at) job.count = *job.count_at;
    slot.next = slot.lock = slot.joined = 0;
    slot.caller_queue = -1;
    fill_queues(slot);
    slot.phase = Phase::RUNNING;
    set(slot.generation, slot.generation + 1);
    const word chunks = (job.count + job.min_chunk - 1) / job.min_chunk;
    if (job.helpers > 0 && chunks > 1) {
        __atomic_fetch_or(&job_queue.mask, 1ll << (&slot - job_queue.slots), __ATOMIC_SEQ_CST);
        const word wanted = (job.helpers < chunks - 1 ? job.helpers : chunks - 1) - get(job_queue.spinning);
        wake(job_queue, wanted < WAKE ? wanted : WAKE);
    }
}

/// Ends the generation of a slot's job, if it is open: no thread takes another chunk.
inline void end_generation(JobSlot& slot)
{
    if (slot.generation & 1) set(slot.generation, slot.generation + 1);
}

/// Works on the slot's job until all is claimed; false if the time is up.
template <class Bounds> inline bool run_job(JobQueue& job_queue, JobSlot& slot, word until)
{
    if ((slot.generation & 1) && !drain<Bounds>(slot, slot.generation, slot.caller_queue, until)) return false;
    while ((slot.generation & 1) && !all_empty(slot.job)) {
        wrt_yield();
        if (now() > until) return false;
    }
    __atomic_fetch_and(&job_queue.mask, ~(1ll << (&slot - job_queue.slots)), __ATOMIC_SEQ_CST);
    end_generation(slot);
    slot.phase = Phase::ENDING;
    return true;
}

/// Waits until all helpers have left; false if the time is up.
inline bool wait_for_helpers(const JobSlot& slot, word until)
{
    for (int tries = 0; get(slot.active) != 0;) {
        if (++tries % 256) {
            relax();
            continue;
        }
        wrt_yield();
        if (now() > until) return false;
    }
    return true;
}

/// A turn of a caller: begins a job in a slot, or goes on with the current one and those that follow it.
template <class Bounds> inline void run_as_caller(JobQueue& job_queue, JobSlot& slot, const Job* job)
{
    const word until = now() + TURN_NS;
    if (slot.phase == Phase::IDLE) {
        slot.current = job;
        slot.stopped = 0;
        slot.phase = Phase::BETWEEN;
    }
    for (;;) {
        if (slot.phase == Phase::BETWEEN && !slot.stopped) begin(job_queue, slot);
        else if (slot.phase == Phase::BETWEEN) break;
        if (slot.phase == Phase::RUNNING && !run_job<Bounds>(job_queue, slot, until)) return;
        if (!wait_for_helpers(slot, until)) return;
        const bool ends = slot.stopped || (slot.job.while_at && *slot.job.while_at == 0);
        slot.current = ends ? nullptr : slot.job.following;
        if (slot.current == nullptr) break;
        slot.phase = Phase::BETWEEN;
        if (now() > until) return;
    }
    slot.phase = Phase::IDLE;
}

/// Stops the job of a slot.
inline void stop(JobSlot& slot)
{
    slot.stopped = 1;
    if (slot.phase != Phase::IDLE) end_generation(slot);
}

/// Makes all helpers return.
inline void close(JobQueue& job_queue)
{
    set(job_queue.closed, 1);
    add(job_queue.epoch, 1);
    futex(job_queue, FUTEX_WAKE_PRIVATE, 1 << 30);
}

}  // namespace
}  // namespace wrt::pool
#endif
