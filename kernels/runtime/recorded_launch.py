"""Launches that Warp records once and repeats: one command with packed arguments, on CUDA for the device's current stream.

On the CPU the calling thread runs all items; `wrt.kernels.runtime.launch.PreparedLaunch` divides them among threads.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from wrt.kernels.runtime.launch import Chunks, load
from wrt.kernels.runtime.options import cuda_block


def record(kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device) -> wp.Launch:
    """Records a launch for repeated use; on the CPU the calling thread runs it.

    `set_dim` of the result sets the number of items, which begin at 0.

    Args:
        kernel, inputs, device: as in `launch`.
    """
    load([kernel], device)
    block = cuda_block(kernel) if device.is_cuda else None
    return wp.launch(kernel, dim=1, inputs=[0, *inputs], device=device, block_dim=block, record_cmd=True)


class RecordedLaunch:
    """A launch on CUDA that was recorded once, with the interface of `PreparedLaunch`.

    Arguments are copied when it runs, so the next caller may write others while the device still works.

    Args:
        kernel, inputs, device: as in `launch`.
        structs: places among `inputs`, the number of the first item counted, of structs and arrays whose packed form `argument`
            gives.
    """

    def __init__(self, kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device, structs: Sequence[int]) -> None:
        self._launch = record(kernel, inputs, device)
        self._inputs = [0, *inputs]
        self._structs = {index: [0, *inputs][index].__ctype__() for index in structs}
        for index, packed in self._structs.items():
            self._launch.set_param_at_index_from_ctype(index, packed)
        self._count = 1

    def argument(self, index: int) -> Any:
        """The packed form of a struct or an array among the arguments: what is written there holds for the next run."""
        return self._structs[index]

    def replace(self, index: int, struct: Any) -> None:
        """Replaces an argument that is a struct; `index` as in `argument`."""
        self._inputs[index] = struct  # keeps the arrays alive
        self._launch.set_param_at_index_from_ctype(index, struct.__ctype__())
        if index in self._structs:
            self._structs[index] = struct.__ctype__()

    def run(self, count: int, chunks: Chunks, used: Any = None, threads: int | None = None) -> None:
        """Runs the kernel for the items 0 .. count - 1, on the device's current stream; arguments as in `PreparedLaunch`."""
        if count != self._count:
            self._launch.set_dim(count)
            self._count = count
        self._launch.launch()
