"""What scans and images share: arrays that a kernel wrote for each ray, made available when they are first read."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import warp as wp


class HitOutputs:
    """The base of `wrt.sensors.LidarScan` and `wrt.sensors.CameraImages`, which say what the arrays hold.

    Args:
        outputs: a flat array for each output, by its name.
        shape: leading shape of the results.
        to_warp: whether results are Warp arrays on the device, else NumPy arrays.
    """

    def __init__(self, outputs: Any, shape: tuple[int, ...], to_warp: bool) -> None:
        self._outputs, self.shape, self._to_warp = outputs, shape, to_warp

    def __repr__(self) -> str:
        return f"{type(self).__name__}(shape={self.shape})"

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

    def _out(self, name: str) -> Any:
        return self._shaped(self._outputs[name])

    def _shaped(self, values: wp.array | None) -> Any:
        """A flat array in the form of results; None stays None."""
        if values is None or self._to_warp:
            return values if values is None else values.reshape(self.shape)
        array = values.numpy()
        return array.reshape(self.shape + array.shape[1:])
