"""The phases of a build of few triangles as calls from compiled code: one call from Python in place of a dozen.

For a thousand triangles, a call from Python takes as long as most of the kernels
(notebooks/records/2026-11-23-small-scenes.md). A step is a kernel with packed arguments
(`wrt.kernels.runtime.argument_packing.PackedKernel`): three words of 64 bits, which are its entry point, and the addresses of
its launch bounds and of its arguments.
"""

import ctypes
from collections.abc import Sequence

import numpy as np
import warp as wp

from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.board import on_cpu
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

STEP_WORDS = 3

_HEAD = f"""
    typedef void (*entry_t)(void*, void*);
    const auto call = [&](int step) {{
        const long long* words = (const long long*)steps.data + step * {STEP_WORDS};
        ((entry_t)words[0])((void*)words[1], (void*)words[2]);
    }};
"""


@wp.func_native(on_cpu(_HEAD + f"for (int step = 0; step < (int)steps.shape[0] / {STEP_WORDS}; ++step) call(step);"))
def call_steps(steps: wp.array(dtype=wp.int64)) -> int:
    """Calls all steps, each for the items in its launch bounds."""
    ...


@wp.func_native(
    on_cpu(
        _HEAD
        + f"""
    const auto call_for = [&](int step, int items) {{
        const long long* words = (const long long*)steps.data + step * {STEP_WORDS};
        auto* bounds = (wp::launch_bounds_t<1>*)words[1];
        bounds->shape[0] = (uint32_t)items;
        bounds->size = (size_t)items;
        call(step);
    }};
    const auto arguments = [&](int step) {{ return (int*)((const long long*)steps.data)[step * {STEP_WORDS} + 2]; }};
    call(0);
    int first = 0, nodes = 1, level = 0;
    totals.data[0] = 1;
    totals.data[1] = 0;
    level_first.data[0] = 0;
    while (first < nodes) {{
        arguments(1)[1] = arguments(2)[1] = arguments(3)[1] = first;
        arguments(2)[2] = nodes;
        call_for(1, nodes - first);
        call_for(2, 1);
        call_for(3, nodes - first);
        first = nodes;
        nodes = totals.data[0];
        level_first.data[++level] = first;
    }}
    return level;
"""
    )
)
def collapse_steps(steps: wp.array(dtype=wp.int64), totals: wp.array(dtype=int), level_first: wp.array(dtype=int)) -> int:
    """The levels of `wrt.builders.bvh.phases.collapse`: solve, and for each level pick, scan and list. Returns their number."""
    ...


@wp.kernel
def run_steps(first: int, steps: wp.array(dtype=wp.int64)):
    """One item: calls all steps."""
    call_steps(steps)


@wp.kernel
def run_collapse(
    first: int,
    steps: wp.array(dtype=wp.int64),
    totals: wp.array(dtype=int),
    level_first: wp.array(dtype=int),
    levels: wp.array(dtype=int),
):
    """One item: finds the wide nodes.

    totals: (2,) wide nodes and blocks. level_first: first node of each level, and the end. levels: (1,) their number."""
    levels[0] = collapse_steps(steps, totals, level_first)


def steps_of(kernels: Sequence[PackedKernel]) -> wp.array:
    """The steps of kernels, which the caller keeps alive."""
    words = [[one.entry, ctypes.addressof(one.bounds), ctypes.addressof(one.arguments)] for one in kernels]
    return wp.array(np.array(words, dtype=np.int64).ravel(), dtype=wp.int64, device="cpu")
