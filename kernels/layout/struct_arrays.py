"""Warp structs with a cached NumPy layout, for arrays of structs that are created often.

Warp computes the NumPy layout of a struct whenever an array of structs is converted from or to NumPy. For nested structs this
takes a large part of the time of a small build (notebooks/records/2026-11-22-launches.md).
"""

from functools import cache
from typing import Any

import numpy as np


def with_known_layout(struct: Any) -> Any:
    """Caches the NumPy dtype of a struct; a decorator to be written above `@wp.struct`."""
    find = struct.numpy_dtype
    struct.numpy_dtype = cache(lambda: np.dtype(find()))
    return struct
