"""What scans and images share: layers that kernels make of the hits of rays, when they are first read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp

from wrt.engine.memory import keep_alive, outputs_of
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.sensors.outputs.row_tables import as_host
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.sensors.time_slices import TracedSlice


IDS = ("instance", "geometry", "primitive", "semantic")
"""Layers whose public names end with "_id"."""


def public_name(name: str) -> str:
    """Of a layer by its name in kernels."""
    return f"{name}_id" if name in IDS else name


class TracedLayers:
    """Rays that were traced, and the layers that were made of them. Scenes that change later do not change them.

    Attributes:
        found: the hits, slice by slice.
        arrays: the layers that are made: flat arrays by their name.
        device: where they are.
        labels: (I,) int32 of each instance, or (0,).
    """

    KINDS: ClassVar[dict[str, Any]]
    """Types of layers by their name, in the order in which they are made."""

    TOGETHER: ClassVar[Sequence[tuple[str, ...]]]
    """Layers that one kernel makes of the same work: who reads one of them gets all that were chosen."""

    def __init__(self, found: Sequence[TracedSlice], count: int, labels: wp.array, num_threads: int | None) -> None:
        self.found, self.count, self.labels, self.num_threads = found, count, labels, num_threads
        self.device = labels.device
        self.arrays: dict[str, wp.array] = {}

    def __getstate__(self) -> dict[str, Any]:
        """What tables need beside the layers that were read: pickles leave out the hits."""
        return {"found": (), "count": self.count, "labels": as_host(self.labels), "num_threads": self.num_threads}

    def make(self, names: Iterable[str]) -> None:
        """Makes the layers of some names that are not made yet."""
        wanted = [name for name in self.KINDS if name in names and name not in self.arrays]
        if not wanted:
            return
        with use_threads(self.num_threads):
            for group in self.TOGETHER:
                if chosen := {name: self.KINDS[name] for name in group if name in wanted}:
                    self._make(group, chosen)

    def _make(self, group: tuple[str, ...], chosen: Mapping[str, Any]) -> None:
        struct = self.new_struct()
        arrays = outputs_of(struct, chosen, self.count, self.device)
        self.fill(group, struct)
        self.arrays |= {name: arrays[name] for name in chosen}

    def new_struct(self) -> Any:
        """The layers as kernels see them, none of them asked for."""
        raise NotImplementedError

    def fill(self, group: tuple[str, ...], struct: Any) -> None:
        """Runs the kernel of a group of `TOGETHER`; the struct has the arrays of those layers that are wanted."""
        raise NotImplementedError


def as_layers(layers: Any, known: Iterable[str]) -> tuple[str, ...] | None:
    """The layers to be made, by their names in kernels; None for all.

    Args:
        layers: public names, or None.
        known: all layers, by their names in kernels.

    Raises:
        TypeError: not a sequence of names.
        ValueError: an unknown name.
    """
    if layers is None:
        return None
    if isinstance(layers, str):
        raise TypeError(f"layers must be a sequence of names, not one name; pass layers=({layers!r},)")
    try:
        names = tuple(layers)
    except TypeError:
        raise TypeError(f"layers must be a sequence of names, not {type(layers).__name__}") from None
    table = {public_name(name): name for name in known}
    return tuple(dict.fromkeys(lookup(table, name, "layers") for name in names))


class HitOutputs:
    """The base of `wrt.sensors.LidarScan` and `wrt.sensors.CameraImages`, which say what the layers hold.

    Args:
        layers: makes them.
        shape: leading shape of the results.
        to_warp: whether results are Warp arrays on the device, which are made at once, else NumPy arrays.
        chosen: names of the layers that can be read; None for all.
    """

    def __init__(
        self, layers: TracedLayers, shape: tuple[int, ...], to_warp: bool, chosen: Sequence[str] | None = None
    ) -> None:
        self._layers, self.shape, self._to_warp = layers, shape, to_warp
        self._chosen = tuple(layers.KINDS) if chosen is None else tuple(chosen)
        if to_warp:
            layers.make(self._chosen)
            if layers.device.is_capturing:
                for values in layers.arrays.values():  # the graph reads what they are made of whenever it is launched
                    keep_alive(values, (values.used, layers))  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        return f"{type(self).__name__}(shape={self.shape})"

    def __copy__(self) -> HitOutputs:
        """Results that share the layers."""
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Pickles hold all layers that can be read, without the hits of which they are made.

        Raises:
            TypeError: layers are Warp arrays.
        """
        if self._to_warp:
            raise TypeError(f"a {type(self).__name__} of Warp arrays cannot be pickled; pickle layers by their .numpy()")
        for name in self._chosen:
            getattr(self, public_name(name))
        return dict(vars(self))

    @cached_property
    def position(self) -> Any:
        return self._out("position")

    @cached_property
    def normal(self) -> Any:
        return self._out("normal")

    @cached_property
    def instance_id(self) -> Any:
        return self._out("instance")

    @cached_property
    def geometry_id(self) -> Any:
        return self._out("geometry")

    @cached_property
    def primitive_id(self) -> Any:
        return self._out("primitive")

    @cached_property
    def semantic_id(self) -> Any:
        return self._out("semantic")

    def _out(self, name: str) -> Any:
        return self._shaped(self._layer(name))

    def _layer(self, name: str) -> wp.array:
        """A layer as a flat array; made now, with those chosen ones that the same kernel makes."""
        if name not in self._chosen:
            public = public_name(name)
            raise ValueError(f"{public} is none of the layers that were chosen; add it: layers=(..., {public!r})")
        if name not in self._layers.arrays:
            refuse_capture("a layer of a sensor that is read for the first time", self._layers.device)
            group = next(group for group in self._layers.TOGETHER if name in group)
            self._layers.make(set(group) & set(self._chosen))
        return self._layers.arrays[name]

    def _shaped(self, values: wp.array | None) -> Any:
        """A flat array in the form of results; None stays None."""
        if values is None or self._to_warp:
            return values if values is None else values.reshape(self.shape)
        array = values.numpy()
        return array.reshape(self.shape + array.shape[1:])
