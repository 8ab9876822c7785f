"""Structs that arrays are made of again and again.

Warp works out the NumPy layout of a struct anew whenever an array of them is made from NumPy's or read back: for nested structs
0.2 ms and more each time, on the host, which was a third of the time of building a small kd-tree.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import warp as wp


def with_known_layout(struct: Any) -> Any:
    """The struct, whose NumPy dtype is worked out once; goes above `@wp.struct`."""
    find = struct.numpy_dtype
    struct.numpy_dtype = cache(lambda: np.dtype(find()))
    return struct


def array_of_structs(items: Sequence[Any], struct: Any, device: wp.Device) -> wp.array:
    """An array of struct instances, whose struct has a known layout.

    Warp has NumPy work out the layout from the C type, which takes longer, and makes a RuntimeError of a Ctrl-C that comes
    meanwhile.
    """
    raw = b"".join(bytes(item.__ctype__()) for item in items)
    return wp.array(np.frombuffer(raw, dtype=struct.numpy_dtype()), dtype=struct, device=device)
