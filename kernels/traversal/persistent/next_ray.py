"""The counter from which the threads of a launch take rays.

Launches that may run at the same time have counters of their own: one for each stream of each thread. Launches of one thread on
one stream follow each other, so they share one, which is set to 0 before each. A launch that a graph captures gets a counter
that belongs to the graph.
"""

import threading

import warp as wp

from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.struct
class NextRay:
    """Where the number of the next ray is."""

    number: wp.array(dtype=int)
    """(1,), 0 when a launch begins; not used on the CPU."""


class _Counters(threading.local):
    """Of each thread: counters by device and stream."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, int], wp.array] = {}


_counters = _Counters()


def next_ray(device: wp.Device) -> wp.array:
    """The counter for the next launch on a device's current stream, 0 when that begins."""
    if device.is_cpu or device.is_capturing:
        return wp.zeros(1, dtype=int, device=device)
    key = device.alias, device.stream.cuda_stream
    counter = _counters.known.get(key)
    if counter is None:
        counter = _counters.known[key] = wp.empty(1, dtype=int, device=device)
    device.memset(counter.ptr, 0, 4)
    return counter
