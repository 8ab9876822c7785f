"""A CPU kernel whose arguments are packed once and that can be called repeatedly, for any range of items."""

import ctypes
from collections.abc import Callable, Container, Sequence
from functools import cache, partial
from typing import Any
from weakref import WeakKeyDictionary

import warp as wp


@cache
def arguments_type(types: tuple[type, ...]) -> type[ctypes.Structure]:
    """The struct in which compiled code receives arguments of these types: fields p0, p1, ..."""
    return type("Arguments", (ctypes.Structure,), {"_fields_": [(f"p{i}", kind) for i, kind in enumerate(types)]})


class Compiled:
    """A kernel's compiled code and the data for packing its arguments, cached from its first launch.

    Attributes:
        code: keeps the compiled code loaded.
        forward: the entry point.
        bounds, bounds_type: launch bounds of one item, as bytes, and their type.
        arguments: the struct of packed arguments.
        packers: of each parameter.
    """

    def __init__(self, kernel: wp.Kernel, launch: wp.Launch) -> None:
        self.code, self.forward = launch.module_exec, launch.hooks.forward
        self.bounds = bytes(launch.params[0])
        self.bounds_type = type(launch.params[0])
        self.arguments = arguments_type(tuple(map(type, launch.params[1:])))
        self.packers = packers_of(kernel, launch)

    def pack(self, inputs: Sequence[Any]) -> ctypes.Structure | None:
        """Packed arguments; None if a value does not have exactly its parameter's type, and Warp must convert or reject it."""
        if len(inputs) != len(self.packers):
            return None
        packed = [*map(pack_argument, inputs, self.packers)]
        return None if None in packed else self.arguments(*packed)


Packer = tuple[Any, type | None, type]
"""A parameter's declared type, the class of its values if it is a struct, and its packed type."""


def packers_of(kernel: wp.Kernel, launch: wp.Launch) -> list[Packer]:
    """Those of all parameters of a kernel, of which a launch was recorded."""
    declared = [argument.type for argument in kernel.adj.args]
    return [
        (kind, getattr(kind, "instance_type", None), type(packed))
        for kind, packed in zip(declared, launch.params[1:], strict=True)
    ]


def pack_argument(value: Any, packer: Packer) -> Any:
    """A packed argument; None if it does not have exactly its parameter's type."""
    declared, struct, kind = packer
    if struct is not None and isinstance(value, struct):
        return value.__ctype__()
    if type(value) is wp.array:
        if type(declared) is not wp.array or value.dtype is not declared.dtype or value.ndim != declared.ndim:
            return None
        return value.__ctype__()
    if (type(value) is int and kind in INTEGERS) or NUMBERS.get(type(value)) is kind:
        return kind(value)
    return value if type(value) is kind else None


def copied(struct: Any) -> Any:
    """A struct with the same values and arrays, which may be given others; faster than to fill one."""
    other, packed = object.__new__(type(struct)), struct.__ctype__()
    other.__dict__.update(struct.__dict__)
    other.__dict__["_ctype"] = type(packed).from_buffer_copy(packed)
    return other


@cache
def _blank(kind: Any) -> Any:
    return kind()


def blank(kind: Any) -> Any:
    """A new struct of a type, of zeros and arrays (0,); in a fraction of the time that its constructor takes."""
    return copied(_blank(kind))


INTEGERS = (ctypes.c_int32, ctypes.c_int64)
"""Packed types for which a Python int is accepted."""

NUMBERS = {float: ctypes.c_float, bool: ctypes.c_bool}
"""Those of other numbers of Python."""

_compiled: WeakKeyDictionary[wp.Kernel, Compiled] = WeakKeyDictionary()


class PackedKernel:
    """A CPU kernel's compiled code, its launch bounds and its packed arguments: an entry of a launch cache.

    Warp packs and checks the arguments of a kernel's first launch; later ones are packed here, in a fraction of the time
    (notebooks/records/2026-11-22-launches.md). The first parameter of a kernel that is called for ranges (`call_range`) is the
    number of the first item.

    Attributes:
        bounds: the launch bounds, of one item unless changed.
        arguments: the packed arguments; struct arguments can be modified in place (`argument`).
    """

    def __init__(self, kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device) -> None:
        self._inputs = inputs  # keeps the arrays alive; compared by `update`
        compiled = _compiled.get(kernel)
        arguments = compiled.pack(inputs) if compiled is not None else None
        if arguments is None:
            launch = wp.launch(kernel, dim=1, inputs=inputs, device=device, record_cmd=True, record_tape=False)
            compiled = Compiled(launch.kernel, launch)
            if launch.kernel is kernel:  # otherwise it is one overload of a generic kernel
                _compiled[kernel] = compiled
            arguments = compiled.arguments(*launch.params[1:])
        self._compiled, self._forward, self.arguments = compiled, compiled.forward, arguments
        self.bounds = compiled.bounds_type.from_buffer_copy(compiled.bounds)

    def update(self, inputs: Sequence[Any]) -> None:
        """Packs the arguments that are other objects than before. An object that is the same must have the same value.

        Raises:
            TypeError: a value does not have exactly its parameter's type.
        """
        for index, (old, new) in enumerate(zip(self._inputs, inputs, strict=True)):
            if new is not old:
                packed = pack_argument(new, self._compiled.packers[index])
                if packed is None:
                    raise TypeError(f"argument {index} is a {type(new).__name__}, which is not the type of its parameter")
                setattr(self.arguments, f"p{index}", packed)
        self._inputs = inputs

    def replace(self, index: int, struct: Any) -> None:
        """Packs another struct in the place of one."""
        self._inputs = [*self._inputs[:index], struct, *self._inputs[index + 1 :]]
        setattr(self.arguments, f"p{index}", struct.__ctype__())

    def forget(self, but: Container[int]) -> None:
        """Releases all arguments but objects of these identities; before the next call, `update` must replace them."""
        self._inputs = [value if id(value) in but else None for value in self._inputs]

    @property
    def entry(self) -> int:
        """Address of the compiled code."""
        return ctypes.cast(self._forward, ctypes.c_void_p).value

    def argument(self, index: int) -> Any:
        """The packed form of an argument. Values written to the fields of a struct take effect at the next call."""
        return getattr(self.arguments, f"p{index}")

    def prepared_call(self) -> Callable[[], None]:
        """A function that does what `call` does, as long as this object lives, without any code of Python's."""
        return partial(self._forward, ctypes.byref(self.bounds), ctypes.byref(self.arguments))

    def call(self) -> None:
        """Runs the kernel, without the interpreter lock."""
        self._forward(ctypes.byref(self.bounds), ctypes.byref(self.arguments))

    def call_own_range(self, first: int, count: int) -> None:
        """Same as `call_range`, for an object that one thread uses: no copies are made."""
        bounds, arguments = self.bounds, self.arguments
        bounds.shape[0] = bounds.size = count
        arguments.p0 = first
        self._forward(ctypes.byref(bounds), ctypes.byref(arguments))

    def call_range(self, first: int, count: int) -> None:
        """Runs the kernel for the items first .. first + count - 1.

        It works on copies of bounds and arguments, so several threads can call it at the same time.
        """
        bounds = type(self.bounds).from_buffer_copy(self.bounds)
        bounds.shape[0] = bounds.size = count
        arguments = type(self.arguments).from_buffer_copy(self.arguments)
        arguments.p0 = first
        self._forward(ctypes.byref(bounds), ctypes.byref(arguments))
