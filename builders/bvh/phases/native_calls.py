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

from wrt.kernels.runtime import native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.job_queue import BOUNDS, on_cpu
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

STEP_WORDS = 3

CALLS = "(const wrt::Call*)steps.data"


@native.func_native("calls.h", on_cpu(f"for (int i = 0; i < (int)steps.shape[0] / {STEP_WORDS}; ++i) ({CALLS})[i].run();"))
def call_steps(steps: wp.array(dtype=wp.int64)) -> int:
    """Calls all steps, each for the items in its launch bounds."""
    ...


@native.func_native(
    "calls.h",
    on_cpu(
        f"static_assert(sizeof(wrt::Call) == 8 * {STEP_WORDS});\n"
        f"return wrt::collapse_steps<{BOUNDS}>({CALLS}, totals.data, level_first.data);"
    ),
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
