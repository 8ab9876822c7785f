"""The native half of the thread pool: helper threads that stay in compiled code and take chunks of any CPU kernel.

Warp's entry point of a CPU kernel is a C function of two pointers, the launch bounds and the packed arguments. Native code can
therefore run any kernel for any range of items, without Python: it copies both, writes the first item and the number of items,
and calls the function. Two kernels do this, `run_as_helper` on each helper thread and `run_as_caller` on the calling thread
(the caller). They communicate through the job queue, the struct `JobQueue` of kernels/native/pool.h, which has a slot for each
caller (schedules: see `wrt.kernels.runtime.schedules`). Python knows the places of some of its 64-bit words; the compiler
checks them.

**A job.** The caller copies the job into its slot, makes `generation` odd, sets its bit in `mask`, wakes helpers if any sleep,
and claims chunks like a helper. When no items are left it makes `generation` even and waits until `active` is 0. A helper
increments `active` and then reads `generation` again, so either the caller sees the helper or the helper sees the end (both
operations are sequentially consistent). A helper that is not scheduled by the system delays a job only if it holds a chunk.

**Programs.** A job may name a following job, a number in memory that gives its number of items, and a number that decides
whether to continue. A loop over the levels of a tree thus runs without Python. The end of a job is the barrier between the two.

**Interrupts.** `run_as_caller` returns to Python after at most `TURN_NS`, or after its current chunk, so that Python can handle
signals. It is called again until `phase` is IDLE. To abandon a job, the caller calls `stop`, and `run_as_caller` until all
helpers have left.

**Waiting.** A helper without work spins for `spin_ns`, if at most `max_spinning` helpers do, and then sleeps on a futex. It
increments `sleeping` before it looks for jobs a last time; a caller sets `mask` before it reads `sleeping`. One of the two
therefore sees the other. A caller wakes `WAKE` helpers, and each of them as many while chunks are left, which shares the system
calls.

**Limits.** Needs Linux (futex).
"""

import ctypes

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.core_pinning import MAX_SLEEPERS, SLEEPER_WORDS
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.runtime.schedules import SCHEDULES

MAX_SPINNING, SPIN_NS, STAYS, FIRST_SLOT = 65, 66, 67, 128
"""Words of the job queue: greatest number of helpers that spin at a time; nanoseconds for which a helper spins before it
sleeps; 1 if a sleeping helper stays on its core; the first slot."""

SLOTS, SLOT_WORDS, ACTIVE, PHASE = 64, 80, 16, 49
"""Slots, the words of each, and two of these: the number of helpers that work on its job, and what its caller does."""

SLEEPERS = FIRST_SLOT + SLOTS * SLOT_WORDS
JOB_QUEUE_WORDS = SLEEPERS + MAX_SLEEPERS * SLEEPER_WORDS + 1

IDLE = 0
"""Value of `PHASE` in a slot without a job."""

CHUNK_QUEUE_WORDS = 16
"""64-bit words per queue, for schedules with queues: two cache lines."""

MAX_ARGUMENT_BYTES = 8192
"""Greatest size of packed arguments; they are copied to the stack of each thread, and no kernel here has more."""

BOUNDS = "wp::launch_bounds_t<1>"
"""C++ type of Warp's launch bounds of one dimension."""


class Job(ctypes.Structure):
    """The description of a launch for native code; all addresses must stay valid until the job has ended."""

    _fields_ = (
        ("entry", ctypes.c_int64),  # compiled code of the kernel
        ("bounds", ctypes.c_int64),  # address of its launch bounds
        ("arguments", ctypes.c_int64),  # address of its packed arguments
        ("argument_bytes", ctypes.c_int64),
        ("count", ctypes.c_int64),  # items
        ("max_chunk", ctypes.c_int64),  # greatest number of items per chunk
        ("min_chunk", ctypes.c_int64),  # least number of items per chunk
        ("divisor", ctypes.c_int64),  # a chunk is the remaining items / divisor, within these limits
        ("helpers", ctypes.c_int64),  # greatest number of threads besides the caller's
        ("schedule", ctypes.c_int64),  # `Schedule.code`
        ("queues", ctypes.c_int64),  # address of the queues, for schedules with queues
        ("queue_count", ctypes.c_int64),
        ("count_at", ctypes.c_int64),  # address of an int32 that replaces `count`, or 0
        ("following", ctypes.c_int64),  # address of the following job, or 0
        ("while_at", ctypes.c_int64),  # address of an int32; no job follows if it is 0 when this job ends; or 0
        ("unused", ctypes.c_int64),
    )


PLACES = {
    "JobQueue": {"max_spinning": MAX_SPINNING, "spin_ns": SPIN_NS, "stays": STAYS, "slots": FIRST_SLOT, "sleepers": SLEEPERS},
    "JobSlot": {"active": ACTIVE, "phase": PHASE},
    "Job": {name: getattr(Job, name).offset // 8 for name, _ in Job._fields_},
}
"""Places of members in structs of the header, in words."""

SIZES = {"JobQueue": JOB_QUEUE_WORDS, "JobSlot": SLOT_WORDS, "Job": ctypes.sizeof(Job) // 8, "ChunkQueue": CHUNK_QUEUE_WORDS}
"""Words of structs of the header."""

VALUES = {f"Schedule::{schedule.name.upper()}": schedule.code for schedule in SCHEDULES.values()}
VALUES |= {"Phase::IDLE": IDLE, "JobQueue::SLOTS": SLOTS}
"""Constants of the header."""


def layout_checks() -> str:
    """C++ that compiles if the header has the layout and the constants of this module."""
    places = [(f"wrt::pool::{kind}", name, at) for kind, names in PLACES.items() for name, at in names.items()]
    equal = [f"__builtin_offsetof({kind}, {name}) == 8 * {at}" for kind, name, at in places]
    equal += [f"sizeof(wrt::pool::{kind}) == 8 * {words}" for kind, words in SIZES.items()]
    equal += [f"(int)wrt::pool::{name} == {value}" for name, value in VALUES.items()]
    return "".join(f"static_assert({each});\n" for each in [*equal, f"wrt::MAX_ARGUMENT_BYTES == {MAX_ARGUMENT_BYTES}"])


def on_cpu(code: str) -> str:
    """Code that is compiled for CPUs only; on CUDA, which does not use the pool, it is empty."""
    return f"#if !defined(__CUDA_ARCH__)\n{code}\n#endif\n    return 0;\n"


JOBS = "auto& b = *(wrt::pool::JobQueue*)job_queue.data;\n"


@native.func_native("pool.h", on_cpu(f"{JOBS}wrt::pool::run_as_helper<{BOUNDS}>(b, helper);"))
def run_as_helper_native(job_queue: wp.array(dtype=wp.int64), helper: wp.int64) -> int:
    """The loop of the helper with a number; returns when the job queue is closed."""


RUN_AS_CALLER = f"wrt::pool::run_as_caller<{BOUNDS}>(b, b.slots[slot], (const wrt::pool::Job*)job);"


@native.func_native("pool.h", on_cpu(f"{layout_checks()}{JOBS}{RUN_AS_CALLER}"))
def run_as_caller_native(job_queue: wp.array(dtype=wp.int64), slot: wp.int64, job: wp.int64) -> int:
    """Begins the job at address `job` in a slot, or continues the current one and those that follow it."""


@native.func_native("pool.h", on_cpu(f"{JOBS}wrt::pool::stop(b.slots[slot]);"))
def stop_native(job_queue: wp.array(dtype=wp.int64), slot: wp.int64) -> int:
    """Stops the job of a slot: no thread takes another chunk."""


@native.func_native("pool.h", on_cpu(f"{JOBS}wrt::pool::close(b);"))
def close_native(job_queue: wp.array(dtype=wp.int64)) -> int:
    """Makes all helpers return."""


@exact_kernel
def run_as_helper(job_queue: wp.array(dtype=wp.int64), helper: wp.int64):
    """Runs a helper thread. One item."""
    run_as_helper_native(job_queue, helper)


@exact_kernel
def run_as_caller(job_queue: wp.array(dtype=wp.int64), slot: wp.int64, job: wp.int64):
    """Runs one turn of the caller of a slot's job. One item. job: address of a `Job`."""
    run_as_caller_native(job_queue, slot, job)


@exact_kernel
def stop(job_queue: wp.array(dtype=wp.int64), slot: wp.int64):
    """Stops the job of a slot. One item."""
    stop_native(job_queue, slot)


@exact_kernel
def close(job_queue: wp.array(dtype=wp.int64)):
    """Closes the job queue. One item."""
    close_native(job_queue)
