"""Numbers of sensors, as those of their rays."""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def repeat_numbers(first: int, each: int, numbers: wp.array(dtype=wp.uint32), repeated: wp.array(dtype=wp.uint32)):
    """Writes the number of a ray's sensor. Item: a ray. `each`: rays of a sensor."""
    i = first + wp.tid()
    repeated[i] = numbers[i / each]
