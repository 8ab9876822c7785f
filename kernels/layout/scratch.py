"""Memory of an item of a kernel that it writes before it reads, so that nothing need clear it.

`wp.zeros` in a kernel clears the array twice and copies it once for each item, which is slow for large arrays
(notebooks/records/2026-11-23-last-generation.md).
"""

import warp as wp


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 0;
#else
    return (uint64_t)__builtin_malloc((size_t)bytes);
#endif
""")
def take_scratch(bytes: int) -> wp.uint64:
    """Address of so much memory, on the CPU; it is aligned as any type needs."""


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    __builtin_free((void*)scratch);
#endif
""")
def leave_scratch(scratch: wp.uint64):
    """Gives memory of `take_scratch` back."""
