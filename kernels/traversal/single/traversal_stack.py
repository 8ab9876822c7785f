"""The children that wait during a walk, each with the t at which it is entered: a stack of a ray's own.

On the CPU it lies in local memory. Warp clears local memory, which costs nothing beside a walk there, but on CUDA that is
hundreds of stores a ray, and took a third of a camera ray's time. There the stack lies in the block's shared memory, which
nobody clears, word by word for all threads of the block, so that neighbouring threads never meet in a bank.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SHARED_BYTES = 48 * 1024
"""Shared memory that a block has without asking."""


@dataclass(frozen=True)
class WaitingStack:
    """The functions of a stack.

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
    """Whether stacks of so many children for a block of so many threads fit into its shared memory."""
    return 0 < 8 * size * threads <= SHARED_BYTES


@cache
def waiting_stack(size: int, threads: int) -> WaitingStack:
    """A stack of up to `size` children; `threads` of a CUDA block, or 0 for local memory."""
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
