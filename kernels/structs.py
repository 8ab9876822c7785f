"""Structs that arrays are made of again and again.

Warp works out the NumPy layout of a struct anew whenever an array of them is made from NumPy's or read back: for nested structs
0.2 ms and more each time, on the host, which was a third of the time of building a small kd-tree.
"""

from functools import cache
from typing import Any

import numpy as np


def with_known_layout(struct: Any) -> Any:
    """The struct, whose NumPy dtype is worked out once; goes above `@wp.struct`."""
    find = struct.numpy_dtype
    struct.numpy_dtype = cache(lambda: np.dtype(find()))
    return struct
