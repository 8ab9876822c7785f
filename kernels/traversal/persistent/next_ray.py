"""The counter from which the persistent threads of a launch fetch rays.

It is 0 before a launch, and the last threads of the launch set it to 0 again. Launches on one stream follow each other, so they
share one; those on other streams, which may run at the same time, have their own. A launch that a graph captures gets a counter
that belongs to the graph.
"""

import warp as wp


@wp.struct
class NextRay:
    """Where the number of the next ray is, and what rays ignore."""

    number: wp.array(dtype=int)
    """(2,), the next ray, and the threads that are done; both are 0 before and after a launch. Not used on the CPU."""
    threads: int
    """Threads of the launch."""
    skipped: wp.array(dtype=int)
    """(n,) the triangle that ray i ignores, at i % n, if rays ignore any: `wrt.kernels.answers.skipped_triangle`."""


_counters: dict[tuple[str, int], wp.array] = {}
"""By device and stream. They are kept: a stream's handle may be given to another one, for which its counter is good, too."""


def counter_of(device: wp.Device) -> wp.array:
    """The counter for the next launch on a device's current stream."""
    return wp.zeros(2, dtype=int, device=device) if device.is_cpu or device.is_capturing else kept_counter(device)


def kept_counter(device: wp.Device) -> wp.array:
    """The same on CUDA while no graph is captured."""
    key = device.alias, device.stream.cuda_stream
    counter = _counters.get(key)
    if counter is None:
        counter = _counters.setdefault(key, wp.zeros(2, dtype=int, device=device))  # another thread may have been first
    return counter
