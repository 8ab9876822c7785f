"""Answers of N rays in device memory: what every query writes, and what `wrt.Hits` reads."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_memory import DeviceBlock, take_block
from wrt.engine.facts.query_kinds import FEW_RAYS
from wrt.engine.host_arrays import HostArray, write_flat
from wrt.engine.memory import empty, empty_host, keep_alive
from wrt.kernels.answers import ANSWERS
from wrt.kernels.answers.answer_kind import COLUMNS, HIT_COLUMNS
from wrt.kernels.layout.ray_batch import HitBatch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from wrt.engine.rays.rays import ResultForm

DTYPES = {name: column.dtype for name, column in COLUMNS.items()}
"""Arrays of answers, and what they hold."""

BLOCK = {"uv": 0, "t": 8, "primitive": 12, "occluded": 0, "counts": 0}
"""Where each array begins in the block of a query's answers, in bytes a ray."""

BLOCK_BYTES = {
    name: sum(wp.types.type_size_in_bytes(DTYPES[each]) for each in kind.stored.columns) for name, kind in ANSWERS.items()
}
"""Bytes a ray of that block."""


class DeviceHits:
    """Answers of N rays: those arrays that the query writes, as `wrt.kernels.layout.ray_batch.HitBatch` explains them.

    A Warp array is made when it is first read. Answers of few rays in NumPy arrays are NumPy's from the start, other answers
    on the CPU lie in a `wrt.engine.host_arrays.HostArray`, and answers on CUDA are cut from one block
    (`wrt.engine.device_memory`), so that neither a device nor many cores wait for Python.

    Attributes:
        count: N.
        device: where the arrays are.
        t, primitive, uv, occluded, counts: (N,) arrays; None if the query does not write them.
        room, begins: of lists of all hits; 0 and None in other answers.
    """

    def __init__(self, count: int, device: wp.Device) -> None:
        self.count, self.device = count, device
        self.room = 0
        self.begins: wp.array | None = None
        self._block: wp.array | DeviceBlock | None = None
        self._in_block: tuple[str, ...] = ()
        self._host: dict[str, np.ndarray | HostArray] = {}

    @classmethod
    def new(cls, query: str, count: int, device: wp.Device) -> DeviceHits:
        """Memory for the answers to a query."""
        hits = cls(count, device)
        names = ANSWERS[query].stored.columns
        if device.is_cuda and count > 0 and names and not device.is_capturing:
            return cls.new_on_cuda(query, count, device)
        if names == HIT_COLUMNS and count > 0 and (count <= FEW_RAYS or device.is_cuda):
            hits._block, hits._in_block = empty(count, wp.vec4, device), names
        elif device.is_cpu and not device.is_capturing:
            return cls.new_on_host(query, count, device)
        else:
            hits.__dict__.update({name: empty(count, DTYPES[name], device) for name in names})
        return hits

    @classmethod
    def new_on_host(cls, query: str, count: int, device: wp.Device) -> DeviceHits:
        """The same on the CPU, while no graph is captured."""
        hits = cls(count, device)
        names = ANSWERS[query].stored.columns
        hits._host = dict(zip(names, empty_host(count, *map(DTYPES.__getitem__, names)), strict=True))
        return hits

    @classmethod
    def new_on_cuda(cls, query: str, count: int, device: wp.Device) -> DeviceHits:
        """The same for some rays on CUDA, while no graph is captured."""
        hits = cls(count, device)
        hits._block, hits._in_block = take_block(BLOCK_BYTES[query] * count, device), ANSWERS[query].stored.columns
        return hits

    @classmethod
    def of_host(cls, count: int, device: wp.Device, arrays: dict[str, Any]) -> DeviceHits:
        """Answers that are in NumPy arrays; `device` is the CPU."""
        hits = cls(count, device)
        hits._host = arrays
        return hits

    @classmethod
    def lists(cls, rays: int, hits: int, room: int, device: wp.Device) -> DeviceHits:
        """Memory for all hits of rays: this many hits together, of which each ray has room for `room`."""
        made = cls(hits, device)
        made.__dict__.update({name: empty(hits, DTYPES[name], device) for name in HIT_COLUMNS})
        made.counts, made.room = empty(rays, wp.int32, device), room
        return made

    def part(self, begin: int, count: int) -> DeviceHits:
        """Some of the answers, in the same memory; of those of `new_on_host`."""
        part = DeviceHits(count, self.device)
        for name in self._host:
            values: Any = self._host[name]
            begins = values.ptr + begin * wp.types.type_size_in_bytes(values.dtype)
            part._host[name] = HostArray(begins, count, values.dtype, values)
        return part

    @cached_property
    def t(self) -> wp.array | None:
        return self._array("t")

    @cached_property
    def primitive(self) -> wp.array | None:
        return self._array("primitive")

    @cached_property
    def uv(self) -> wp.array | None:
        return self._array("uv")

    @cached_property
    def occluded(self) -> wp.array | None:
        return self._array("occluded")

    @cached_property
    def counts(self) -> wp.array | None:
        return self._array("counts")

    def _array(self, name: str) -> wp.array | None:
        """An array that was not made with the others."""
        if name in self._host:
            values = self._host[name]
            if type(values) is HostArray:
                return values.array
            return wp.array(values, dtype=DTYPES[name], device=self.device, copy=False)  # type: ignore[arg-type]
        if self._block is None or name not in self._in_block:
            return None
        begin = self._block.ptr + BLOCK[name] * self.count
        part = wp.array(ptr=begin, dtype=DTYPES[name], shape=self.count, device=self.device)
        return keep_alive(part, self._block)

    def struct(self) -> HitBatch:
        """The arrays for kernels."""
        batch = HitBatch()
        for name in DTYPES:
            if (array := getattr(self, name)) is not None:
                setattr(batch, name, array)
        batch.room = self.room
        if self.begins is not None:
            batch.begins = self.begins
        return batch

    def clear(self, query: str) -> None:
        """Sets the answers to a query to those of rays that miss."""
        for name in ANSWERS[query].stored.columns:
            getattr(self, name).fill_(COLUMNS[name].miss)

    def write_to(self, arguments: Any, query: str) -> None:
        """Writes addresses and lengths of a query's arrays into the packed form of a `HitBatch` that has such arrays."""
        host = None if self._block is not None else self._host
        for name in ANSWERS[query].stored.columns:
            field, values = getattr(arguments, name), host and host.get(name)
            field.data = values.ptr if type(values) is HostArray else self.address(name)
            field.shape[0] = self.count

    def point_to(self, struct: Any, names: Sequence[str]) -> None:
        """Writes the addresses of some arrays into the packed form of a struct that has such fields, and keeps them alive with
        it."""
        if self.device.is_capturing:  # a graph on the CPU is made of arrays
            for name in names:
                setattr(struct, name, getattr(self, name))
            return
        packed = struct.__ctype__()
        for name in names:
            write_flat(getattr(packed, name), self.address(name), self.count, DTYPES[name])
        struct.__dict__["owner"] = self

    def address(self, name: str) -> int:
        """Of the first element of an array."""
        if self._block is not None:
            return self._block.ptr + BLOCK[name] * self.count
        values = self._host.get(name)
        return values.ptr if type(values) is HostArray and name not in self.__dict__ else getattr(self, name).ptr

    def values(self, query: str, form: ResultForm) -> Any:
        """The answers to a query of one array, as in `result`."""
        (name,) = ANSWERS[query].stored.columns
        return self.result(name, form)

    def result(self, name: str, form: ResultForm) -> Any:
        """An array in the leading shape of the rays: a NumPy array, or a Warp array if the rays were."""
        if form.is_warp:
            return shaped(getattr(self, name), form)
        values = self._host[name] if name in self._host and name not in self.__dict__ else getattr(self, name)
        if type(values) is not np.ndarray:
            values = values.numpy()
        shape = form.shape + values.shape[1:]
        return values if values.shape == shape else values.reshape(shape)


def shaped(values: wp.array, form: ResultForm) -> Any:
    """Results (N,) in the leading shape of the rays, as a NumPy array or, if the rays were one, as a Warp array."""
    if form.is_warp:
        return values if values.shape == form.shape else values.reshape(form.shape or (1,))
    array = values.numpy()
    return array.reshape(form.shape + array.shape[1:])
