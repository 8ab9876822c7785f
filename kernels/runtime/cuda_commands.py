"""Launches on CUDA of kernels that were launched before: Warp's checks and conversions of the arguments are spared.

Each argument is packed as on the CPU (`wrt.kernels.runtime.argument_packing`) and written into a command that Warp recorded
once (notebooks/records/2026-11-23-instances.md).
"""

import ctypes
import threading
from collections.abc import Sequence
from typing import Any

import warp as wp

from wrt.kernels.runtime.argument_packing import Packer, pack_argument, packers_of


class _Commands(threading.local):
    """Of each thread: recorded launches and how their arguments are packed, by kernel and device."""

    def __init__(self) -> None:
        self.known: dict[tuple[wp.Kernel, str, int], tuple[wp.Launch, list[Packer]] | None] = {}


_commands = _Commands()


def launch_again(kernel: wp.Kernel, count: int, inputs: Sequence[Any], device: wp.Device, block: int) -> None:
    """Launches a kernel on the device's current stream, as `wp.launch` does, without a tape.

    Args:
        kernel: is loaded.
        count: number of items.
        inputs: all arguments, on the device.
        device, block: as in `wp.launch`.
    """
    key = kernel, device.alias, block
    if key not in _commands.known:
        command = wp.launch(kernel, dim=count, inputs=inputs, device=device, block_dim=block, record_cmd=True)
        command.fwd_args = None  # they keep arrays alive, and only a capture on the CPU reads them
        is_generic = command.kernel is not kernel  # the next arguments may need another overload
        _commands.known[key] = None if is_generic else (command, packers_of(kernel, command))
    known = _commands.known[key]
    packed = [*map(pack_argument, inputs, known[1])] if known is not None and not device.is_capturing else [None]
    if None in packed:  # Warp converts or refuses what has another type
        wp.launch(kernel, dim=count, inputs=inputs, device=device, block_dim=block, record_tape=False)
        return
    command = known[0]
    command.params[1:] = packed
    if command.params_addr is not None:  # on CUDA
        for place, value in enumerate(packed, 1):
            command.params_addr[place] = ctypes.c_void_p(ctypes.addressof(value))
    if command.bounds.size != count:
        command.set_dim(count)
    command.launch()
