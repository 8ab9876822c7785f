"""The traversal stack of a single ray: children to be visited, each with its t of entry.

On the CPU the stack is in local memory. Warp clears local memory, which is negligible there, but on CUDA it is hundreds of
stores per ray (notebooks/records/2026-11-21-single-rays.md). There the stack is in the block's shared memory, which is not
cleared, interleaved word by word for all threads of the block, so that neighbouring threads use different banks.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

SHARED_BYTES = 48 * 1024
"""Shared memory in bytes that a block can use by default."""


@dataclass(frozen=True)
class WaitingStack:
    """The functions of a traversal stack.

    Attributes:
        local: ints of local memory that it needs.
        open: `wp.func(local memory) -> stack`.
        push: `wp.func(stack, place, child, entry)`.
        pop: `wp.func(stack, place, entry) -> child`, `entry` by reference.
    """

    local: int
    open: wp.Function
    push: wp.Function
    pop: wp.Function


def fits(size: int, threads: int) -> bool:
    """Whether the stacks of `threads` threads, of `size` children each, fit into the shared memory of a block."""
    return 0 < 8 * size * threads <= SHARED_BYTES


@cache
def waiting_stack(size: int, threads: int) -> WaitingStack:
    """A stack of up to `size` children; `threads`: threads per CUDA block, or 0 for local memory."""
    if fits(size, threads):
        local, step = 1, threads
        place = f"__shared__ int words[{2 * size * threads}]; return (unsigned long long)(words + threadIdx.x);"
    else:
        local, step = 2 * size, 1
        place = "return (unsigned long long)memory.data;"

    @wp.func_native(place)
    def open_stack(memory: wp.array(dtype=int)) -> wp.uint64: ...

    @wp.func_native(f"""
        int* words = (int*)stack + 2 * place * {step};
        words[0] = child; words[{step}] = __builtin_bit_cast(int, entry);
    """)
    def push(stack: wp.uint64, place: int, child: int, entry: float): ...

    @wp.func_native(f"""
        const int* words = (const int*)stack + 2 * place * {step};
        entry = __builtin_bit_cast(float, words[{step}]);
        return words[0];
    """)
    def pop(stack: wp.uint64, place: int, entry: wp.ref[float]) -> int: ...

    return WaitingStack(local, open_stack, push, pop)
