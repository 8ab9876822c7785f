"""What scans and images share: layers that kernels make of the hits of rays, when they are first read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp

from wrt.engine.host_arrays import HostArray, as_array
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
        arrays: the layers that are made: flat arrays by their name, Warp's or a `HostArray`.
        device: where they are.
        labels: (I,) int32 of each instance, or (0,).
    """

    KINDS: ClassVar[dict[str, Any]]
    """Types of layers by their name, in the order in which they are made."""

    APART: ClassVar[Sequence[tuple[str, ...]]]
    """Layers that have kernels of their own, which make those of a group together. One kernel makes all others."""

    def __init__(self, found: Sequence[TracedSlice], count: int, labels: wp.array, num_threads: int | None) -> None:
        self.found, self.count, self.labels, self.num_threads = found, count, labels, num_threads
        self.device = labels.device
        self.arrays: dict[str, wp.array | HostArray] = {}

    def __getstate__(self) -> dict[str, Any]:
        """What tables need beside the layers that were read: pickles leave out the hits."""
        return {"found": (), "count": self.count, "labels": as_host(self.labels), "num_threads": self.num_threads}

    def make(self, names: Iterable[str]) -> None:
        """Makes the layers of some names that are not made yet."""
        wanted = [name for name in self.KINDS if name in names and name not in self.arrays]
        if not wanted:
            return
        groups = [[name for name in wanted if name in group] for group in self.APART]
        with use_threads(self.num_threads):
            if together := [name for name in wanted if not any(name in group for group in groups)]:
                self.make_together(together)
            for group in groups:
                if group:
                    self.make_apart(group)

    @contextmanager
    def new_arrays(self, struct: Any, names: Iterable[str]) -> Iterator[Any]:
        """Gives a struct of the kernels arrays for layers of some names, which are made when the `with` block ends."""
        kinds = {name: self.KINDS[name] for name in names}
        arrays = outputs_of(struct, kinds, self.count, self.device)
        yield struct
        self.arrays |= {name: arrays[name] for name in kinds}

    def make_together(self, names: Sequence[str]) -> None:
        """Makes layers that are in no group of `APART`."""
        raise NotImplementedError

    def make_apart(self, names: Sequence[str]) -> None:
        """Makes layers of one group of `APART`."""
        raise NotImplementedError

    def beside(self, name: str) -> set[str]:
        """All layers that the kernel of one makes."""
        apart = {name: group for group in self.APART for name in group}
        return set(apart[name]) if name in apart else set(self.KINDS) - set(apart)

    def companions(self, name: str) -> Sequence[str]:
        """Layers that are made when one is read and none were chosen: itself, and what comes with it for nothing."""
        return (name,)


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
        self._chosen, self._is_chosen = tuple(layers.KINDS) if chosen is None else tuple(chosen), chosen is not None
        if to_warp:
            layers.make(self._chosen)
            if layers.device.is_capturing:
                for values in layers.arrays.values():  # the graph reads what they are made of whenever it is launched
                    keep_alive(values, (values.used, layers))  # type: ignore[arg-type, attr-defined]

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

    def _make_ready(self, names: Iterable[str]) -> None:
        """Makes layers together that are read next, but for those that were not chosen, which are refused then."""
        self._layers.make([name for name in names if name in self._chosen and public_name(name) not in vars(self)])

    def _out(self, name: str) -> Any:
        return self._shaped(self._layer(name))

    def _layer(self, name: str) -> wp.array | HostArray:
        """A layer as a flat array; made now, along with the other chosen ones, if some were chosen."""
        if name not in self._chosen:
            public = public_name(name)
            raise ValueError(f"{public} is none of the layers that were chosen; add it: layers=(..., {public!r})")
        if name not in self._layers.arrays:
            refuse_capture("a layer of a sensor that is read for the first time", self._layers.device)
            beside, lone = self._layers.beside(name), self._layers.companions(name)
            self._layers.make(beside & set(self._chosen) if self._is_chosen else lone)
        return self._layers.arrays[name]

    def _shaped(self, values: wp.array | HostArray | None) -> Any:
        """A flat array in the form of results; None stays None."""
        if values is None or self._to_warp:
            return values if values is None else as_array(values).reshape(self.shape)
        array = values.numpy()
        return array.reshape(self.shape + array.shape[1:])
