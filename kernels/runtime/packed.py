"""A CPU kernel with its arguments packed once, to be called as often as wanted for any range of items."""

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import warp as wp


@cache
def arguments_type(types: tuple[type, ...]) -> type[ctypes.Structure]:
    """The struct by which compiled code gets arguments of these types: fields p0, p1, ..."""
    return type("Arguments", (ctypes.Structure,), {"_fields_": [(f"p{i}", kind) for i, kind in enumerate(types)]})


class PackedKernel:
    """A CPU kernel's compiled code, its launch bounds and its packed arguments.

    The first parameter of the kernel is the number of the first item if it is to be called for ranges (`call_range`).

    Attributes:
        bounds: the launch bounds, of one item unless changed.
        arguments: the packed arguments; those that are structs can be written in place (`argument`).
    """

    def __init__(self, kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device) -> None:
        launch = wp.launch(kernel, dim=1, inputs=inputs, device=device, record_cmd=True)
        self._code = launch.module_exec  # keeps the compiled code loaded
        self._inputs = inputs  # keeps the arrays alive
        self._forward = launch.hooks.forward
        self.bounds = launch.params[0]
        self.arguments = arguments_type(tuple(map(type, launch.params[1:])))(*launch.params[1:])

    @property
    def entry(self) -> int:
        """Address of the compiled code."""
        return ctypes.cast(self._forward, ctypes.c_void_p).value

    def argument(self, index: int) -> Any:
        """The packed form of an argument; what is written into a struct's fields holds for the next call."""
        return getattr(self.arguments, f"p{index}")

    def call(self) -> None:
        """Runs the kernel, without the interpreter lock."""
        self._forward(ctypes.byref(self.bounds), ctypes.byref(self.arguments))

    def call_range(self, first: int, count: int) -> None:
        """Runs the kernel for the items first .. first + count - 1, on copies: other threads may do so at the same time."""
        bounds = type(self.bounds).from_buffer_copy(self.bounds)
        bounds.shape[0] = bounds.size = count
        arguments = type(self.arguments).from_buffer_copy(self.arguments)
        arguments.p0 = first
        self._forward(ctypes.byref(bounds), ctypes.byref(arguments))
