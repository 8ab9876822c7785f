"""Work arrays and packed launches that are kept from one job to the next.

**Problem.** A job of a few launches on a thousand items takes 0.1 ms of work, and several times that to allocate its arrays and
to pack the arguments of its launches. A job on a hundred thousand takes a quarter of its time for the page faults of fresh
memory, which threads hardly share (notebooks/records/2026-11-22-small-builds.md).

**Idea.** A job asks a `Workspace` for its arrays and launches by name. A new one makes what it is asked for. One that is kept
has most of it from the job before: the arrays are large enough, and of a launch's arguments only those that are other objects
are packed again. A job cannot tell the difference, as long as it writes what it reads.

**Limits.** The process keeps `MAX_KEPT` workspaces, and callers keep those of jobs up to some size only. None is kept after an
exception, since helpers may still work on its arrays.
"""

import ctypes
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, launch
from wrt.kernels.runtime.launch_loop import LaunchLoop, Step, has_native_loop, launch_loop

Made = TypeVar("Made")


class Workspace:
    """What one job works with at a time.

    Args:
        device: where.
        is_kept: whether other jobs follow. Arrays then have room for more elements than were asked for.
    """

    def __init__(self, device: wp.Device, is_kept: bool = False) -> None:
        self.device, self.is_kept = device, is_kept
        self._made: dict[str, tuple[int, Any]] = {}
        self._launches: dict[tuple[wp.Kernel, str], PreparedLaunch] = {}
        self._loops: dict[str, LaunchLoop] = {}

    def make(self, name: str, size: int, factory: Callable[[int], Made]) -> Made:
        """What the factory made for this size, or, if it is kept, for a larger one. Kernels must not depend on its contents."""
        known = self._made.get(name)
        if known is None or known[0] < size:
            if self.is_kept:  # room for a little more, so that a job that grows does not make it again each time
                grain = 1 << max(size.bit_length() - 7, 0)
                size = -(-size // grain) * grain
            known = self._made[name] = size, factory(size)
        return known[1]

    def empty(self, name: str, count: int, dtype: Any) -> wp.array:
        """An array of at least `count` elements."""
        return self.make(name, count, lambda size: wp.empty(size, dtype=dtype, device=self.device))

    def launch(self, kernel: wp.Kernel, count: int, inputs: Sequence[Any], *, name: str = "", **chunks: int) -> None:
        """`wrt.kernels.runtime.launch.launch`; `name` tells launches of one kernel with different arrays apart."""
        if not self.is_kept or not self.device.is_cpu or self.device.is_capturing:
            launch(kernel, count, inputs, device=self.device, **chunks)
        elif count > 0:
            prepared = self._launches.get((kernel, name))
            if prepared is None:
                prepared = self._launches[kernel, name] = PreparedLaunch(kernel, inputs, self.device)
            else:
                prepared.update(inputs)
            prepared.run(count, Chunks(**chunks))

    def loop(self, name: str, turns: Sequence[Sequence[Step]], numbers: wp.array) -> None:
        """`wrt.kernels.runtime.launch_loop.launch_loop`."""
        if not self.is_kept or not has_native_loop(self.device):
            launch_loop(turns, numbers, self.device)
            return
        loop = self._loops.get(name)
        if loop is None or loop.numbers is not numbers:
            loop = self._loops[name] = LaunchLoop(turns, numbers, self.device)
        else:
            loop.update(turns)
        loop.run()

    def forget(self) -> None:
        """Releases arguments that the workspace did not make: they belong to the job."""
        made = {id(value) for _, value in self._made.values()}
        for used in (*self._launches.values(), *self._loops.values()):
            used.forget(made)


class HostNumbers:
    """Numbers that kernels write, or that are copied, and that the host reads: in memory of the host that a CUDA device sees.

    Attributes:
        own: as an array of the host.
        sent: the same, as kernels of the device see it.
        values: the same in NumPy.
    """

    def __init__(self, count: int, dtype: Any, device: wp.Device) -> None:
        self.device = device
        self.own = wp.empty(count, dtype=dtype, device="cpu", pinned=device.is_cuda)
        self.sent = part_of(self.own, 0, count, dtype, device)
        self.values = self.own.numpy()

    def fetch(self) -> np.ndarray:
        """The numbers, when the work of the device's current stream is done."""
        if self.device.is_cuda:
            wp.synchronize_stream(self.device.stream)
        return self.values


def part_of(
    memory: wp.array, begin: int, shape: int | tuple[int, ...], dtype: Any, device: wp.Device | None = None
) -> wp.array:
    """An array from a byte of other memory on, which it keeps alive: an allocation on CUDA takes far longer.

    device: None for that of the memory.
    """
    part = wp.array(ptr=(memory.ptr or 0) + begin, dtype=dtype, shape=shape, device=device or memory.device)
    part.used = memory  # type: ignore[attr-defined]
    return part


def write(array: wp.array, values: np.ndarray) -> None:
    """Copies values, of the layout of the array's elements, to its beginning."""
    if array.device.is_cpu:
        ctypes.memmove(array.ptr, values.ctypes.data, values.nbytes)
    else:
        count = values.nbytes // wp.types.type_size_in_bytes(array.dtype)
        wp.copy(array, wp.array(values, dtype=array.dtype, device=array.device), count=count)


def host_view(values: np.ndarray, dtype: Any, begin: int = 0, count: int | None = None) -> wp.array:
    """A flat Warp array on the CPU of the memory of a contiguous NumPy array, without Warp's checks.

    Args:
        values: what the memory belongs to; the view keeps it alive.
        dtype: of the view's elements, as they lie in memory.
        begin: byte at which the view begins.
        count: number of elements; None for the rows of `values`.
    """
    begin += values.__array_interface__["data"][0]
    count = len(values) if count is None else count
    common, size = _attributes(dtype)
    if common is None:
        view = wp.array(ptr=begin, dtype=dtype, shape=count, device=_cpu())
        view.used = values
        return view
    view = object.__new__(wp.array)
    own = {"ptr": begin, "shape": (count,), "size": count, "capacity": count * size, "used": values}
    view.__dict__.update(common, **own)
    return view


@cache
def _attributes(dtype: Any) -> tuple[dict[str, Any] | None, int]:
    """What all flat views of a type have in common, and the bytes of an element.

    None for the first if views of Warp's making differ in other ways than those that `host_view` knows.
    """
    size = wp.types.type_size_in_bytes(dtype)
    made = [vars(wp.array(ptr=64 * count, dtype=dtype, shape=count, device=_cpu())) for count in (1, 3)]
    for count, attributes in zip((1, 3), made, strict=True):
        known = {"ptr": 64 * count, "shape": (count,), "size": count, "capacity": count * size}
        if any(attributes.pop(name, None) != value for name, value in known.items()):
            return None, size
    return (made[0] if made[0] == made[1] else None), size


def set_flat(struct: Any, name: str, view: wp.array) -> None:
    """Sets a field of a struct to a flat array on the CPU of the field's type, without Warp's checks."""
    struct.__dict__[name] = view
    packed = getattr(struct.__ctype__(), name)
    packed.data, packed.ndim, packed.shape[0], packed.strides[0] = view.ptr or 0, 1, view.size, view.strides[0]


@cache
def _cpu() -> wp.Device:
    return wp.get_device("cpu")


def read_ints(array: wp.array, count: int) -> list[int]:
    """The first numbers of an array of int32, or of vectors of them; on CUDA, a round trip."""
    if array.device.is_cpu:
        return (ctypes.c_int32 * count).from_address(array.ptr)[:]
    return array.numpy().ravel()[:count].tolist()


MAX_KEPT = 4
"""Workspaces that the process keeps: of two builds, and what a small scene needs besides."""

_kept: deque[tuple[Hashable, Any]] = deque(maxlen=MAX_KEPT)


@contextmanager
def kept_workspace(kind: Hashable, device: wp.Device) -> Iterator[Workspace]:
    """A workspace for a job of a kind, kept for the next one; the caller's alone. A new one if none of the kind is free."""
    work = take(kind) or Workspace(device, is_kept=True)
    yield work
    work.forget()
    give_back(kind, work)


def give_back(kind: Hashable, work: Any) -> None:
    """Keeps a workspace, or what a job uses in place of one, for the next job of its kind."""
    _kept.append((kind, work))


def take(kind: Hashable) -> Any | None:
    """Takes the workspace of a kind out of those that are kept; None if there is none."""
    for entry in tuple(_kept):
        if entry[0] == kind:
            try:
                _kept.remove(entry)
            except (ValueError, IndexError):  # another thread took it, or changed the queue meanwhile
                continue
            return entry[1]
    return None


def release() -> None:
    """Frees the workspaces that are kept."""
    _kept.clear()
