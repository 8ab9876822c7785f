"""Values of many sensors or instances on the scene's device, and what of a scan a graph cannot repeat."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.runtime.launch import launch, refuse_capture
from wrt.sensors.trajectory import Trajectory


def stays_on(device: wp.Device, values: Any, dtype: type, shape: tuple[int, ...]) -> bool:
    """Whether values are a Warp array that kernels on a device can read as it is."""
    return isinstance(values, wp.array) and values.device == device and values.dtype is dtype and values.shape == shape


def refuse_host_values(name: str, values: Any, dtype: type, device: wp.Device) -> None:
    """Refuses values of many sensors or instances that would be copied to a device while a graph is captured.

    Raises:
        RuntimeError: they would.
    """
    if device.is_capturing and np.ndim(values):
        raise RuntimeError(
            f"{name} must be one number or a Warp array of {dtype.__name__} on {device}, a value for each, while a graph is "
            "captured; copy it there before the capture"
        )


def repeated(numbers: wp.array, each: int) -> wp.array:
    """(sensors each,) the number of its sensor for each ray."""
    from wrt.kernels.sensors.repeated_numbers import repeat_numbers

    found = empty(numbers.size * each, numbers.dtype, numbers.device)
    flat = numbers.flatten()
    words = [wp.array(ptr=one.ptr, dtype=wp.uint32, shape=one.size, device=one.device) for one in (flat, found)]
    launch(repeat_numbers, found.size, [each, *words], device=found.device, chunk=4096)
    return found


def refuse_captured_scan(device: wp.Device, path: Any, motions: Any, to_warp: bool) -> None:
    """Refuses what a graph cannot repeat: what is computed on the host, or copied to it or from it.

    Raises:
        RuntimeError: a graph is being captured, and there is such a thing.
    """
    if device.is_cuda and wp.get_device("cpu").is_capturing:
        refuse_capture("a scan on CUDA", device)
    if not device.is_capturing:
        return
    if not to_warp:
        refuse_part("results in NumPy arrays", "pass poses as a Warp array of wp.transform, or to_warp=True")
    if not (path.is_still and (isinstance(path, Trajectory) or path.key is None)):
        refuse_part(
            "poses that change, or those of many sensors in a NumPy array,", "pass them as a Warp array of wp.transform"
        )
    if motions:
        refuse_part("trajectories of instances", "move them by Scene.update(..., transform=...), with a Warp array")


def refuse_part(what: str, instead: str) -> NoReturn:
    """What to do where a part of a scan cannot be in a graph.

    Raises:
        RuntimeError: always.
    """
    raise RuntimeError(f"{what} cannot be part of a graph; {instead}, or make the call before or after the capture")
