"""The options with which kernels are compiled, and why.

**No fused multiply-add** (`fuse_fp`). A compiler that may fuse a product and a sum rounds once where the source rounds twice,
and it may fuse in one form of an expression and not in another. The scalar form of a triangle test and its lane form, a
traversal and brute force, the CPU and CUDA would then give hits that differ in the last bits, and a watertight test could let
a ray slip between two triangles. Without it, equal expressions give equal bits.

**No gradients** (`enable_backward`). Searches have no useful derivative (`wrt.kernels.query.hit_gradients` says what has one),
and code for backward passes would only take time to compile.

**No code for sums of structs** (`UNUSED`). Warp writes two functions for each struct that only backward passes call, and by
their linkage Clang must generate code for them.

Importing this module chooses the CPU target (`wrt.kernels.compilation.target`), before the first kernel is defined.
"""

from collections.abc import Callable
from weakref import WeakKeyDictionary

import warp as wp

from wrt.kernels.compilation import target

target.apply_environment()
target.quiet_warp()

UNUSED = "#undef CUDA_CALLABLE\n#define CUDA_CALLABLE __attribute__((internal_linkage))\n"
"""C++ before the structs of a module for the CPU: what Warp declares by this macro, and nothing calls, is dropped before it is
optimised. The macro is empty otherwise."""

EXACT = {"fuse_fp": False, "extra_build_options": wp.ModuleBuildOptions(extra_cpu_preamble=UNUSED)}
"""Module options of all device code, with gradients or without."""


def exact_module(name: str, gradients: bool = False) -> None:
    """Sets the options of all kernels of a Warp module.

    Args:
        name: name of the module.
        gradients: whether the kernels have backward passes.
    """
    wp.set_module_options(EXACT | {"enable_backward": gradients}, name)


def exact_kernel(function: Callable) -> wp.Kernel:
    """The kernel of a function, in the Warp module of its Python module, as `wp.kernel` makes it, but with the options above.

    Functions need no such decorator: they are compiled with the options of the kernel that calls them.
    """
    exact_module(function.__module__)
    return wp.kernel(function)


def named_kernel(function: Callable, name: str) -> wp.Kernel:
    """The kernel of a function that a factory made, in the Warp module of its Python module, beside the others there.

    Args:
        function: the function of the kernel.
        name: of the kernel, another one for each.
    """
    function.__qualname__ = name
    return exact_kernel(function)


CUDA_BLOCK = 128
"""Threads per block on CUDA, unless a kernel has bounds of its own."""

_blocks: WeakKeyDictionary[wp.Kernel, int] = WeakKeyDictionary()


def cuda_block(kernel: wp.Kernel) -> int:
    """Threads per block of a kernel on CUDA."""
    return _blocks.get(kernel, CUDA_BLOCK)


def specialised_kernel(
    function: Callable, gradients: bool = False, bounds: tuple[int, int] | None = None, beside: str = ""
) -> wp.Kernel:
    """The kernel of a function that a factory made, in a Warp module of its own, with the options of `exact_kernel`.

    Specialisations of one function differ in the values that they capture (`wp.static`). In a module of its own, each is
    compiled when it is first launched, and making another does not compile it again.

    Args:
        function: the function of the kernel.
        gradients: whether the kernel has a backward pass.
        bounds: on CUDA, threads per block, and the blocks of a multiprocessor for which its registers must suffice; None for
            blocks of `CUDA_BLOCK` threads and any number of registers.
        beside: names a Warp module, below the name of the Python module, for kernels that are always needed together: compiling
            them takes less time than one by one. All of them must be made before one is loaded; empty for a module of its own.
    """
    module = f"{function.__module__}.{beside}" if beside else "unique"
    if beside:
        exact_module(module, gradients)
    options = None if beside else EXACT
    kernel = wp.kernel(function, module=module, enable_backward=gradients, module_options=options, launch_bounds=bounds)
    if bounds is not None:
        _blocks[kernel] = bounds[0]
    return kernel
