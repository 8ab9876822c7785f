"""Contracts of the device code in kernels/ and builders/."""

from __future__ import annotations

import warp as wp
from support.device_modules import device_modules


def test_kernels_are_compiled_without_fused_multiply_add():
    """A kernel of another decorator gets Warp's options: fused arithmetic, and hits that differ in the last bits."""
    kernels = [value for module in device_modules() for value in vars(module).values() if isinstance(value, wp.Kernel)]
    assert len(kernels) > 50
    for kernel in kernels:
        assert kernel.module.options["fuse_fp"] is False, f"{kernel.key}: its decorator is @exact_kernel"
        assert kernel.module.options["enable_backward"] is False, f"{kernel.key}: compiled with gradients"
